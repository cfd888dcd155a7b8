"""Connections that cost nothing: a head that does not come, and too many of them."""

import asyncio
import json
from typing import Any, ClassVar

from uvicorn.protocols.http.h11_impl import H11Protocol

from imgloc.live.problems import MEDIA, Refused, problem_of
from imgloc.live.requests import Bounds


class _Connection(H11Protocol):
    """A connection that is closed if no head of a request comes in time.

    If there are too many, the one that has waited longest for a head is closed.
    """

    bounds: ClassVar[Bounds]
    _head: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._arm()
        others = [c for c in self.connections if isinstance(c, _Connection) and c is not self]
        if len(self.connections) <= self.bounds.connections:
            return
        idle = [c for c in others if c.idle and c._head is not None]
        if idle:
            min(idle, key=lambda c: c._head.when() if c._head else 0.0).transport.abort()
        else:
            transport.write(_full())
            transport.close()

    def connection_lost(self, exc: Exception | None) -> None:
        self._disarm()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        if not self.idle or self.transport.get_protocol() is not self:  # a WebSocket by now
            self._disarm()
        elif self._head is None:
            self._arm()

    @property
    def idle(self) -> bool:
        """Whether no request is being answered."""
        return self.cycle is None or self.cycle.response_complete

    def on_response_complete(self) -> None:
        super().on_response_complete()
        if self.idle and not self.transport.is_closing():
            self._arm()

    def _arm(self) -> None:
        self._disarm()
        self._head = self.loop.call_later(self.bounds.patience, self._late)

    def _disarm(self) -> None:
        if self._head is not None:
            self._head.cancel()
            self._head = None

    def _late(self) -> None:
        self._head = None
        if self.idle and not self.transport.is_closing():
            self.transport.abort()

    def handle_websocket_upgrade(self, event: Any) -> None:
        self._disarm()
        super().handle_websocket_upgrade(event)

    def send_400_response(self, msg: str) -> None:  # noqa: ARG002 (of the base)
        problem = problem_of(Refused("bad-request", "this is no HTTP request"))
        self.transport.write(_raw("400 Bad Request", dict(problem.document)))
        self.transport.close()


def protocol_of(bounds: Bounds) -> type[H11Protocol]:
    """The class of connections within some bounds, for uvicorn."""
    return type("Connection", (_Connection,), {"bounds": bounds})


def _full() -> bytes:
    problem = problem_of(Refused("busy", "too many connections", retry=1))
    return _raw("503 Service Unavailable", dict(problem.document), "Retry-After: 1\r\n")


def _raw(status: str, document: dict[str, Any], more: str = "") -> bytes:
    body = json.dumps(document).encode()
    head = f"HTTP/1.1 {status}\r\nContent-Type: {MEDIA}\r\n{more}"
    return f"{head}Content-Length: {len(body)}\r\nConnection: close\r\n\r\n".encode() + body
