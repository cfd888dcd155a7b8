"""What a method costs: time, and memory counted in bytes of the arrays themselves."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass
from typing import Any

import numpy as np

from imgloc.experiments.runs import Trial
from imgloc.features.mapfeatures import MapFeatures


@dataclass(frozen=True)
class Spread:
    """Median and 99th percentile of the trials; NaN where nothing was measured."""

    median: float
    p99: float


@dataclass(frozen=True)
class Cost:
    """What it took; the only part of a summary that two runs do not share.

    Parameters
    ----------
    ms : Spread
        The whole answer for a scan.
    stack_ms : Spread
        Of that, the likelihood stack.
    ns_per_unit : float
        Median over the trials: nanoseconds per pose and reading, or per pair of points.
    first_ms : float
        An answer that found no features of the map ready.
    max_rss_bytes : int or None
        The process's greatest so far, by all that it has done; None where it is not known.
    """

    ms: Spread
    stack_ms: Spread
    ns_per_unit: float
    first_ms: float
    max_rss_bytes: int | None


def cost_of(trials: Sequence[Trial], first_ms: float = float("nan")) -> Cost:
    """Make a :class:`Cost` of the trials' times."""
    return Cost(
        ms=_spread([t.ms for t in trials]),
        stack_ms=_spread([t.stack_ms for t in trials]),
        ns_per_unit=_spread([1e6 * t.stack_ms / t.work for t in trials if t.work]).median,
        first_ms=first_ms,
        max_rss_bytes=max_rss_bytes(),
    )


def bytes_of(features: MapFeatures) -> int:
    """Bytes of the arrays that the features of a map hold by now, without the map itself.

    Examples
    --------
    >>> from imgloc.model import OccupancyGrid
    >>> wall = np.eye(10, dtype=bool)
    >>> features = MapFeatures(OccupancyGrid(wall, ~wall, 0.1))
    >>> before = bytes_of(features)
    >>> before, features.bmap.shape, bytes_of(features) > 400
    (0, (10, 10), True)
    """
    given = {f.name for f in fields(features)}
    return sum(_nbytes(value) for key, value in vars(features).items() if key not in given)


def _nbytes(value: Any) -> int:
    if isinstance(value, np.ndarray):
        return value.nbytes
    if is_dataclass(value):
        return sum(_nbytes(getattr(value, f.name)) for f in fields(value))
    if isinstance(value, tuple | list):
        return sum(map(_nbytes, value))
    return 0


def max_rss_bytes() -> int | None:
    """Greatest resident memory of this process so far; None where the system does not tell."""
    try:
        import resource
    except ImportError:
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(peak if sys.platform == "darwin" else 1024 * peak)


def _spread(values: Sequence[float]) -> Spread:
    if not len(values) or np.isnan(values).any():
        return Spread(float("nan"), float("nan"))
    median, p99 = np.percentile(values, (50, 99))
    return Spread(float(median), float(p99))
