"""A crowd that a service has to bear beside its clients: each member does one thing all the time.

Slow heads, half bodies, readers that do not read, robots that say nothing, bursts of connections,
large bodies, large regions. `python -m tools.load --crowd 60` measures what others notice of it.
"""

import contextlib
import http.client
import io
import json
import math
import socket
import threading
import time
from collections.abc import Iterator
from functools import partial

_SCAN = {"ranges": [2.0] * 90, "angle_min": -1.5, "angle_increment": 0.03}


class Crowd:
    """Those who ask a service at `host` (an address and a port), until they are told to stop."""

    def __init__(self, host: str) -> None:
        self.host = host
        self.name, _, port = host.partition(":")
        self.port, self.stop = int(port), threading.Event()

    def run(self, seconds: float) -> None:
        """Be there for some time."""
        members = (
            partial(self.slow_heads, 30), partial(self.half_bodies, 30),
            partial(self.mute_readers, 20), partial(self.silent_robots, 16),
            self.bursts, self.large_bodies, self.large_regions, self.regions,
        )  # fmt: skip
        threads = [threading.Thread(target=member, daemon=True) for member in members]
        for thread in threads:
            thread.start()
        self.stop.wait(seconds)
        self.stop.set()
        for thread in threads:
            thread.join(30)

    @contextlib.contextmanager
    def _sockets(self, count: int) -> Iterator[list[socket.socket]]:
        """Some connections, as far as there are any to be had."""
        with contextlib.ExitStack() as stack:
            some = list[socket.socket]()
            for _ in range(count):
                with contextlib.suppress(OSError):
                    one = stack.enter_context(socket.socket())
                    one.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
                    one.settimeout(5)
                    one.connect((self.name, self.port))
                    some.append(one)
            yield some

    def _head(self, method: str, path: str, length: int = 0) -> bytes:
        body = f"Content-Type: application/json\r\nContent-Length: {length}\r\n" if length else ""
        return f"{method} {path} HTTP/1.1\r\nHost: {self.host}\r\n{body}\r\n".encode()

    def slow_heads(self, count: int) -> None:
        """Send a byte of a head each second."""
        head = self._head("GET", "/v1/maps")[:-2] + b"X-Slow: " + b"x" * 1000
        while not self.stop.is_set():
            with self._sockets(count) as some:
                for k in range(20):
                    for one in some:
                        with contextlib.suppress(OSError):
                            one.send(head[k : k + 1])
                    if self.stop.wait(1):
                        return

    def half_bodies(self, count: int) -> None:
        """Send a head and a byte of its body, again each four seconds."""
        while not self.stop.is_set():
            with self._sockets(count) as some:
                for one in some:
                    with contextlib.suppress(OSError):
                        one.sendall(self._head("POST", "/v1/localize", 1000) + b"{")
                self.stop.wait(4)

    def mute_readers(self, count: int) -> None:
        """Ask a hundred times, and never read."""
        while not self.stop.is_set():
            with self._sockets(count) as some:
                for one in some:
                    one.setblocking(False)
                    with contextlib.suppress(OSError):
                        one.send(self._head("GET", "/page.css") * 700)
                self.stop.wait(20)

    def silent_robots(self, count: int) -> None:
        """Be followed, and say nothing."""
        from websockets.exceptions import WebSocketException
        from websockets.sync.client import connect

        url = f"ws://{self.host}/v1/track"
        while not self.stop.is_set():
            with contextlib.ExitStack() as stack:
                for _ in range(count):
                    with contextlib.suppress(OSError, WebSocketException):
                        stack.enter_context(connect(url, open_timeout=10))
                self.stop.wait(20)

    def bursts(self) -> None:
        """Open three hundred connections at once."""
        while not self.stop.wait(5):
            with contextlib.ExitStack() as stack:
                for _ in range(300):
                    with contextlib.suppress(OSError):
                        one = stack.enter_context(socket.socket())
                        one.setblocking(False)
                        one.connect((self.name, self.port))
                time.sleep(0.5)

    def _ask(self, method: str, path: str, body: bytes | None = None) -> bytes:
        link = http.client.HTTPConnection(self.host, timeout=60)
        with contextlib.closing(link):
            try:
                link.request(method, path, body, {"Content-Type": "application/json"})
                return link.getresponse().read()
            except (OSError, http.client.HTTPException):
                self.stop.wait(0.1)
                return b""

    def large_bodies(self) -> None:
        """Send files that contain no scans."""
        body = b"1," * (4 << 20)
        while not self.stop.wait(0.2):
            self._ask("POST", "/v1/scans?name=a.csv", body)

    def large_regions(self) -> None:
        """Ask for a region of a hundred corners, of a map of four million cells."""
        import numpy as np
        from PIL import Image

        image = io.BytesIO()
        Image.fromarray(np.full((2000, 2000), 254, np.uint8)).save(image, "png")
        corners = ",".join(
            f"{50 + 45 * f(k * math.tau / 100):.2f}"
            for k in range(100)
            for f in (math.cos, math.sin)
        )
        id_ = ""
        while not self.stop.wait(0.2):
            if not id_:
                sent = self._ask("POST", "/v1/maps?name=a&resolution=0.05", image.getvalue())
                id_ = json.loads(sent or b"{}").get("id", "")
            if b"not-found" in self._ask("GET", f"/v1/layers/region?map={id_}&region={corners}"):
                id_ = ""

    def regions(self) -> None:
        """Ask where a scan is in a region, on the map of all."""
        body = json.dumps(_SCAN).encode()
        while not self.stop.wait(0.2):
            self._ask("POST", "/v1/localize?region=1,1,4,1,4,4,1,4", body)


def be_there(host: str, seconds: float) -> None:
    """Be a crowd, in a process of its own."""
    Crowd(host).run(seconds)
