"""The process around a service: its socket, when it is ready, and its end by a signal.

SIGTERM and Ctrl-C end what runs, and refuse the rest; after five seconds nothing is left of it.
"""

import asyncio
import contextlib
import gc
import logging
import math
import os
import queue
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from logging.handlers import QueueHandler, QueueListener
from typing import Any

import uvicorn

from imgloc.errors import ConfigError
from imgloc.live.connections import Gate
from imgloc.live.openapi import TRACK
from imgloc.live.service import Service

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_ANSWERED, _SENT, _ENDED = 3, 4, 4.6  # seconds from a signal until what runs is given up, is cut
_UNREAD = 1 << 16  # bytes of answers that a client has not read yet
_SWITCH = 5e-4  # seconds after which the loop has its turn while a thread computes in Python
_LINES = 100  # of a log that nobody reads
_TURNS, _TURN = 20, 0.02  # looks, and seconds between two, for what is still to be logged


class _Server(uvicorn.Server):
    """uvicorn, with an own way to accept connections, and an end that is ours."""

    service: Service
    signal: int | None = None
    _gate: "list[asyncio.Future[Any]]"

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        before = {number: signal.signal(number, self.handle_exit) for number in _SIGNALS}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    def handle_exit(self, sig: int, frame: Any) -> None:
        self.signal = self.signal or sig
        if not self.should_exit:
            self.service.stop()
            self.asked.set()
        super().handle_exit(sig, frame)

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets=[])
        gate, (one,) = Gate(self, self.service.bounds), sockets or [socket.socket()]
        if sys.platform == "linux":  # who says nothing yet is kept by the system: no descriptor
            patience = math.ceil(self.service.bounds.patience)
            one.setsockopt(socket.IPPROTO_TCP, socket.TCP_DEFER_ACCEPT, patience)
        one.listen(self.config.backlog)
        one.setblocking(False)
        self._gate = [asyncio.ensure_future(gate.accept(one)), asyncio.ensure_future(gate.watch())]

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        for task in self._gate:
            task.cancel()
        self.service.stop()
        asyncio.get_running_loop().call_later(_ANSWERED, self.service.give_up)
        await super().shutdown(sockets)

    def end_at_last(self, asked: threading.Event) -> None:
        """End the process some seconds after a signal, whatever keeps it: a pipe, a long answer."""
        self.asked = asked

        def wait() -> None:
            asked.wait()
            time.sleep(_ENDED)
            os._exit(128 + signal.SIGINT if self.signal == signal.SIGINT else 0)

        threading.Thread(target=wait, name="imgloc end", daemon=True).start()


class _Aside(QueueHandler):
    """Hands what is logged to a thread of its own, unless too much waits there."""

    def enqueue(self, record: logging.LogRecord) -> None:
        with contextlib.suppress(queue.Full):
            self.queue.put_nowait(record)


@contextlib.contextmanager
def _logged_aside() -> Iterator[None]:
    """Let no log hold up the loop: standard error may be a pipe that nobody reads."""
    lines: queue.Queue[Any] = queue.Queue(_LINES)
    logs = [logging.getLogger(name) for name in ("imgloc", "asyncio")]
    before = [list(log.handlers) for log in logs]
    ours = before[0] or [logging.StreamHandler()]
    QueueListener(lines, *ours, respect_handler_level=True).start()
    for log in logs:
        log.handlers[:] = [_Aside(lines)]
    try:
        yield
    finally:
        for log, handlers in zip(logs, before, strict=True):
            log.handlers[:] = handlers
        for _ in range(_TURNS):  # for the last words, if somebody reads them
            if lines.empty():
                break
            time.sleep(_TURN)


def bound(host: str, port: int) -> socket.socket:
    """A socket that listens nowhere yet; port 0 is any that is free. It is a ConfigError if taken.

    Examples
    --------
    >>> with bound("127.0.0.1", 0) as one:
    ...     one.getsockname()[1] > 0
    True
    """
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, proto=socket.IPPROTO_TCP
        )[0]
        # asyncio sends at once (TCP_NODELAY) only where the socket names its protocol. Otherwise
        # the body of an answer waits some 40 ms until the client acknowledges the head.
        one = socket.socket(family, kind, protocol)
    except OSError as error:
        raise ConfigError(f"host: got {host}, which is no address: {error.strerror}") from None
    one.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    # Else the system takes megabytes of answers for a client that asks again and never reads.
    one.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _UNREAD)
    try:
        one.bind(address)
    except OSError as error:
        one.close()
        hint = "expected one that is free; 0 takes any"
        raise ConfigError(f"port: got {host}:{port}: {error.strerror}; {hint}") from None
    return one


def address_of(one: socket.socket) -> str:
    """The address of a socket as a browser takes it."""
    host, port = one.getsockname()[:2]
    return f"http://{f'[{host}]' if ':' in host else host}:{port}"


def serve(service: Service, one: socket.socket, ready: Callable[[], object]) -> int | None:
    """Serve on a socket until a signal comes; return its number.

    The process ends five seconds after the signal, whatever it does by then.

    Parameters
    ----------
    service : Service
    one : socket
        Of :func:`bound`; it is closed in the end.
    ready : callable
        Called in a thread once the socket listens. It may wait for the maps; what it raises ends
        the service and is raised here.
    """
    bounds = service.bounds
    config = uvicorn.Config(
        service, http="h11", ws="websockets-sansio", loop="asyncio",
        lifespan="off", log_config=None, log_level="critical", access_log=False,
        server_header=False, proxy_headers=False, ws_max_size=getattr(bounds, TRACK.limit),
        ws_per_message_deflate=False, timeout_keep_alive=math.ceil(bounds.patience), backlog=4096,
        h11_max_incomplete_event_size=1 << 16, timeout_graceful_shutdown=_SENT,
    )  # fmt: skip
    server = _Server(config)
    server.service = service
    server.end_at_last(threading.Event())
    sys.setswitchinterval(_SWITCH)
    failed: list[BaseException] = []

    async def watch() -> None:
        while not server.started:
            await asyncio.sleep(0.01)
        try:
            await asyncio.to_thread(ready)
            gc.freeze()  # the collector holds all threads up, 40 ms for what stays anyway
        except BaseException as error:
            failed.append(error)
            server.should_exit = True

    async def run() -> None:
        watching = asyncio.ensure_future(watch())
        try:
            await server.serve(sockets=[one])
        finally:
            watching.cancel()
            service.stop()
            service.core.close()

    try:
        with _logged_aside():
            asyncio.run(run())
    except asyncio.CancelledError:  # by Ctrl-C, before signals were the server's
        raise KeyboardInterrupt from None
    finally:
        one.close()
    if failed:
        raise failed[0]
    return server.signal
