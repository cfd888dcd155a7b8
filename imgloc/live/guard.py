"""Who may ask a service, and how: hosts, origins, the token, bodies, and what answers may do.

A page of another site that somebody has open in a browser may ask whatever listens on this
machine, also by a name that it makes lead here (DNS rebinding). So the Host of a request must be
this service's own, and the Origin, where there is one, must be the same.
"""

import asyncio
import base64
import binascii
import hmac
import ipaddress
import re
import socket
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import anyio
from starlette.datastructures import Headers
from starlette.types import Receive, Scope

from imgloc.errors import ConfigError
from imgloc.live.problems import Refused

_LOCAL = ("127.0.0.1", "localhost", "::1")
_SHORTEST = 16  # characters of a token
_PROTOCOL = "bearer."  # and the token as base64: browsers give a WebSocket no other header
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; "
    "connect-src 'self'; manifest-src 'self'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'; require-trusted-types-for 'script'; trusted-types 'none'"
)
HEADERS: Mapping[str, str] = {
    "Cache-Control": "no-cache",
    "Content-Security-Policy": POLICY,
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}
"""Of every answer: a page loads nothing from elsewhere, is framed by nobody and runs no text."""


@dataclass(frozen=True)
class Access:
    """Who may ask a service at `host`, which is also called by other `names`.

    Requests must carry the `token`, if there is one. A ConfigError if it has less than 16 visible
    characters, or if there is none and others than this machine reach the host.

    Examples
    --------
    >>> Access().admits("localhost:8080"), Access().admits("evil.example:8080")
    (True, False)
    >>> Access("0.0.0.0")
    Traceback (most recent call last):
        ...
    imgloc.errors.ConfigError: host: got 0.0.0.0, which others can reach: expected a token, too
    """

    host: str = "127.0.0.1"
    token: str | None = None
    names: Sequence[str] = ()

    def __post_init__(self) -> None:
        if self.token is None and not self.loopback:
            found = f"got {self.host}, which others can reach"
            raise ConfigError(f"host: {found}: expected a token, too")
        if self.token is not None and not re.fullmatch(rf"[!-~]{{{_SHORTEST},}}", self.token):
            expected = f"at least {_SHORTEST} visible ASCII characters without a space"
            raise ConfigError(f"token: expected {expected}")

    @property
    def loopback(self) -> bool:
        """True if only this machine reaches the service."""
        local = _is_address(self.host) and ipaddress.ip_address(self.host).is_loopback
        return self.host == "localhost" or local

    def admits(self, host: str) -> bool:
        """Return whether the Host of a request is this service."""
        name = host_name(host)
        known = {*_LOCAL, self.host, *(given.lower() for given in self.names)}
        if not self.loopback:  # no address can be rebound, only a name
            known |= {socket.gethostname().lower()}
            return name in known or _is_address(name)
        return name in known

    def check(self, scope: Scope, *, guarded: bool) -> None:
        """Refuse a request from elsewhere, or without the token if the route is `guarded`."""
        headers = Headers(scope=scope)
        hosts, origins = headers.getlist("host"), headers.getlist("origin")
        if len(hosts) != 1 or not self.admits(hosts[0]):
            some = ", ".join(hosts)[:100] or "none"
            hint = "its address, localhost, or a name that it was given"
            raise Refused("forbidden", f"Host: got {some}, expected {hint}")
        if origins and [origin_host(origin) for origin in origins] != [hosts[0].lower()]:
            some = ", ".join(origins)[:100]
            raise Refused("forbidden", f"Origin: got {some}, expected that of this page")
        if guarded and headers.get("sec-fetch-site") in ("cross-site", "same-site"):
            raise Refused("forbidden", "Sec-Fetch-Site: a page of another site asks")
        if guarded and self.token is not None and not self._has_token(scope, headers):
            hint = "Authorization: Bearer TOKEN"
            raise Refused("unauthorized", f"the token is missing or wrong, expected {hint}")

    def _has_token(self, scope: Scope, headers: Headers) -> bool:
        said = headers.getlist("authorization")
        given = [text[7:].strip() for text in said if text[:7].lower() == "bearer "]
        for protocol in scope.get("subprotocols", []):
            if protocol.startswith(_PROTOCOL):
                text = protocol.removeprefix(_PROTOCOL)
                try:
                    padded = text + "=" * (-len(text) % 4)
                    given.append(base64.urlsafe_b64decode(padded).decode("ascii"))
                except (binascii.Error, ValueError):
                    return False
        known = (self.token or "").encode()
        return any(hmac.compare_digest(one.encode(), known) for one in given)


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def host_name(host: str) -> str:
    """The name in a Host header, without its port, in small letters; empty if it is none.

    Examples
    --------
    >>> host_name("LocalHost:80"), host_name("[::1]:80"), host_name("a@b:80")
    ('localhost', '::1', '')
    """
    found = re.fullmatch(r"(?:\[([0-9a-f:.]+)\]|([a-z0-9._-]+))(?::\d{1,5})?", host.lower())
    return "" if found is None else (found[1] or found[2]).removesuffix(".")


def origin_host(origin: str) -> str:
    """The host and port in an Origin; empty if it is none, as ``null``."""
    found = re.fullmatch(r"https?://([^/@\s]+)", origin.lower())
    return "" if found is None else found[1]


class Bodies:
    """The memory that the bodies of all requests take together."""

    def __init__(self, most: int) -> None:
        self.most, self.held = most, 0

    def take(self, count: int) -> None:
        """Count some bytes more; they are refused if these are too many."""
        if self.held + count > self.most:
            found = "the bodies of other requests fill the memory"
            raise Refused("busy", f"{found}; come back in a second", retry=1)
        self.held += count


def ending() -> Refused:
    """Refusal for whoever asks while the service ends."""
    return Refused("stopping", "the service ends; ask another one", retry=5)


async def read_body(
    scope: Scope, receive: Receive, bodies: Bodies, stopping: asyncio.Event, *, limit: int,
    seconds: float,
) -> bytes:  # fmt: skip
    """The body of a request, of at most `limit` bytes, if it comes within so many seconds.

    Its bytes are counted in `bodies` and, to be given back, under ``body`` of the scope.
    """
    expected = f"expected a body of at most {limit:,} bytes"
    said = int(Headers(scope=scope).get("content-length", "0"))
    if said > limit:
        raise Refused("too-large", f"{said:,} bytes, {expected}")
    data, size, ended = list[bytes](), 0, False
    stop = asyncio.ensure_future(stopping.wait())
    try:
        with anyio.fail_after(seconds):
            while not ended:
                part = asyncio.ensure_future(receive())
                await asyncio.wait((part, stop), return_when=asyncio.FIRST_COMPLETED)
                if not part.done():
                    part.cancel()
                    raise ending()
                message = part.result()
                if message["type"] == "http.disconnect":
                    raise Gone
                some = message.get("body", b"")
                size += len(some)
                if size > limit:
                    raise Refused("too-large", expected)
                bodies.take(len(some))
                scope["body"] = size
                data.append(some)
                ended = not message.get("more_body", False)
    except TimeoutError:
        found = f"{size:,} bytes came in {seconds:g} s"
        raise Refused("too-slow", f"{found}, expected the whole body") from None
    finally:
        stop.cancel()
    return await asyncio.to_thread(b"".join, data)  # a copy of what is large takes its time


class Gone(Exception):  # noqa: N818 (nothing is wrong)
    """The client has closed the connection: there is nobody to answer."""
