"""Connections: each state of one has a time, and there are never more than the bound.

A client that is waited for, be it for a head, for a body or until it takes an answer, has so many
seconds. If there are too many connections, the one whose client has been waited for longest makes
room; if there is none, the next ones wait to be accepted. Some more are accepted all the same:
those that ask whether the service runs are answered, the others are refused.
"""

import asyncio
import socket
from typing import Any

import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

from imgloc.live.bounds import Bounds
from imgloc.live.problems import MEDIA, Refused, problem_of

FULL = "full"  #: in the state of a scope: the connection is one too many
_ROOM = 8  # connections beyond the bound
_FRESH = 0.01  # seconds that a client has at least until it has to make room
_LOOK = 0.25  # seconds between two looks at all connections
_PAUSE = 0.005
_MANY = 64  # connections accepted at most in a turn of the loop
_NEXT = 0.1  # seconds until the next request of a client that asks again before it has an answer


class _Connection(H11Protocol):
    """A connection that knows since when its client is waited for."""

    gate: "Gate"
    since = 0.0
    served = extra = gone = False  # one answer is complete; one too many; told to go

    @property
    def state(self) -> str:
        """State of it: waits for a ``head``, a ``body``, ``send``, or ``work``: nothing."""
        if self.flow.write_paused or self.transport.is_closing():
            return "send"
        if self.cycle is None or self.cycle.response_complete:
            return "head"
        return "body" if self.cycle.more_body else "work"

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self.since = self.loop.time()
        self.extra = not self.gate.make_room(self)

    def data_received(self, data: bytes) -> None:
        self.extra = self.extra and not self.gate.make_room(self)
        self.app_state[FULL] = self.extra
        before = self.state
        super().data_received(data)
        if not before == "head" == self.state:  # a head that comes bit by bit is waited for
            self.since = self.loop.time()

    def on_response_complete(self) -> None:
        self.since, self.served = self.loop.time(), True
        if self.conn.trailing_data[0]:  # who asks a hundred times at once has not all turns
            self.loop.call_later(_NEXT, super().on_response_complete)
        else:
            super().on_response_complete()

    def pause_writing(self) -> None:
        super().pause_writing()
        self.since = self.loop.time()

    def send_400_response(self, msg: str) -> None:  # noqa: ARG002 (of the base)
        body = bytes(problem_of(Refused("bad-request", "this is no HTTP request"))[1].body)
        head = f"HTTP/1.1 400 Bad Request\r\nContent-Type: {MEDIA}\r\nConnection: close\r\n"
        self.transport.write(f"{head}Content-Length: {len(body)}\r\n\r\n".encode() + body)
        self.transport.close()


def has_gone(client: socket.socket) -> bool:
    """Return whether a client has closed its connection and has sent nothing."""
    try:
        return not client.recv(1, socket.MSG_PEEK)
    except OSError as error:
        return not isinstance(error, BlockingIOError)


class Gate:
    """Accepts connections of a server, and closes those whose time is over.

    Parameters
    ----------
    server : uvicorn.Server
        It has started, without a socket.
    bounds : Bounds
    """

    def __init__(self, server: uvicorn.Server, bounds: Bounds) -> None:
        self._server, self._bounds = server, bounds
        self._there: Any = server.server_state.connections
        self._loop, self._closing = asyncio.get_running_loop(), dict[Any, float]()
        self._held_up, self._coming = asyncio.Event(), set[asyncio.Future[Any]]()

    async def accept(self, one: socket.socket) -> None:
        """Accept who comes to a socket that does not block, for ever."""
        try:
            while True:
                self._loop.add_reader(one, self._let_in, one)
                await self._held_up.wait()
                self._loop.remove_reader(one)
                self._held_up.clear()
                full = self._room <= 0 and self.make_room()
                await asyncio.sleep(0 if full else _PAUSE)
        finally:
            self._loop.remove_reader(one)

    @property
    def _room(self) -> int:
        return self._bounds.connections + _ROOM - len(self._there) - len(self._coming)

    def _let_in(self, one: socket.socket) -> None:
        """Accept all who are there: a turn of the loop may wait for a thread that computes."""
        try:
            for _ in range(min(self._room, _MANY)):
                client = one.accept()[0]
                client.setblocking(False)
                if has_gone(client):  # a burst of these is not to hold up the next one
                    client.close()
                    continue
                made = self._loop.connect_accepted_socket(self._made, client)
                coming = asyncio.gather(made, return_exceptions=True)
                self._coming.add(coming)
                coming.add_done_callback(self._coming.discard)
            if self._room <= 0:
                self._held_up.set()
        except BlockingIOError:
            pass
        except OSError:  # there is no descriptor, or the client has gone
            self._held_up.set()

    def _made(self) -> _Connection:
        made = _Connection(self._server.config, self._server.server_state, {}, self._loop)
        made.gate = self
        return made

    def make_room(self, for_: _Connection | None = None) -> bool:
        """Close whom we wait for longest, if there are too many; whether that is enough."""
        there = [one for one in self._there if not getattr(one, "gone", False)]
        if len(there) <= self._bounds.connections:
            return True
        late = self._loop.time() - _FRESH
        idle = [one for one in there if isinstance(one, _Connection) and one is not for_
                and one.state != "work" and one.since < late]  # fmt: skip
        many = len(there) - self._bounds.connections
        for one in sorted(idle, key=lambda one: (one.served, one.since))[:many]:
            one.gone = True
            one.transport.abort()
        return len(idle) >= many

    async def watch(self) -> None:
        """Close, again and again, connections whose client has let us wait for too long."""
        while True:
            await asyncio.sleep(_LOOK)
            now = self._loop.time()
            late, there = now - self._bounds.patience, list(self._there)
            shut = [one for one in there if one.transport.is_closing()]
            self._closing = {one: self._closing.get(one, now) for one in shut}
            for one in there:
                since = self._closing.get(one, now)
                if isinstance(one, _Connection) and one.state in ("head", "send"):
                    since = min(since, one.since)
                if since < late:
                    one.transport.abort()
