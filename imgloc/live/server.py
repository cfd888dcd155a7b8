"""The process around a service: its socket, when it is ready, and its end by a signal.

SIGTERM and Ctrl-C end what runs, within the time of an answer, and refuse the rest.
"""

import asyncio
import contextlib
import signal
import socket
from collections.abc import Callable, Iterator
from typing import Any

import uvicorn

from imgloc.errors import ConfigError
from imgloc.live.connections import protocol_of
from imgloc.live.service import Service

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_FIRST, _LAST = 0, 65_535  #: ports


class _Server(uvicorn.Server):
    """uvicorn, with an end that is ours."""

    ended: "Callable[[], None]"
    signal: int | None = None

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
            self.ended()
        super().handle_exit(sig, frame)


def bound(host: str, port: int) -> socket.socket:
    """A socket that listens nowhere yet; port 0 is any that is free. It is a ConfigError if taken.

    Examples
    --------
    >>> with bound("127.0.0.1", 0) as one:
    ...     one.getsockname()[1] > 0
    True
    """
    if not _FIRST <= port <= _LAST:
        raise ConfigError(f"port: got {port}, expected {_FIRST} to {_LAST}")
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

    Parameters
    ----------
    service : Service
    one : socket
        Of :func:`bound`; it is closed in the end.
    ready : callable
        Called in a thread once the socket listens. It may wait for the maps; what it raises ends
        the service and is raised here.
    """
    config = uvicorn.Config(
        service, http=protocol_of(service.bounds), ws="websockets-sansio", loop="asyncio",
        lifespan="off", log_config=None, log_level="critical", access_log=False,
        server_header=False, proxy_headers=False, ws_max_size=service.bounds.message,
        ws_per_message_deflate=False, timeout_keep_alive=5, backlog=256,
        h11_max_incomplete_event_size=1 << 16,
        timeout_graceful_shutdown=int(service.bounds.seconds) + 1,
    )  # fmt: skip
    server = _Server(config)
    server.ended = service.stop
    failed: list[BaseException] = []

    async def watch() -> None:
        while not server.started:
            await asyncio.sleep(0.01)
        try:
            await asyncio.to_thread(ready)
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
        asyncio.run(run())
    finally:
        one.close()
    if failed:
        raise failed[0]
    return server.signal
