"""Counters of a service, as Prometheus reads them."""

from prometheus_client import CollectorRegistry, Counter, Gauge, Histogram, generate_latest

_SECONDS = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 30.0)


class Metrics:
    """Counts of one service."""

    def __init__(self) -> None:
        registry = self._registry = CollectorRegistry()
        self.requests = Counter(
            "imgloc_requests", "Requests, by status.", ["status"], registry=registry
        )
        self.answers = Counter(
            "imgloc_answers", "Scans that were answered, by verdict.", ["kind", "verdict"],
            registry=registry,
        )  # fmt: skip
        self.seconds = Histogram(
            "imgloc_answer_seconds", "From a request's last byte to its answer.", ["kind"],
            buckets=_SECONDS, registry=registry,
        )  # fmt: skip
        self.refused = Counter(
            "imgloc_refused", "Requests that were refused, by problem.", ["problem"],
            registry=registry,
        )  # fmt: skip
        self.queue = Gauge(
            "imgloc_queue", "Requests under way, by lane.", ["lane"], registry=registry
        )
        self.dropped = Gauge(
            "imgloc_dropped", "Scans that were dropped before they were looked at.",
            registry=registry,
        )  # fmt: skip
        self.maps = Gauge("imgloc_maps", "Maps that are held.", registry=registry)
        self.sockets = Gauge("imgloc_sockets", "Robots that are followed.", registry=registry)

    def text(self) -> bytes:
        """All of it, in Prometheus' text format."""
        return generate_latest(self._registry)
