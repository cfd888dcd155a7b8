"""Problem documents (RFC 9457): the answers to requests that the service refuses.

>>> from imgloc.errors import MapError
>>> problem_of(MapError("office.yaml: resolution: missing")).document
{'type': 'urn:imgloc:problem:bad-map', 'title': 'The map cannot be used', 'status': 422, \
'detail': 'office.yaml: resolution: missing'}
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from imgloc.errors import ConfigError, ImglocError, MapError, ScanError
from imgloc.live.line import Dropped

MEDIA = "application/problem+json"

#: Status and title by the last word of the type.
KINDS: Mapping[str, tuple[int, str]] = {
    "bad-parameter": (400, "A parameter is wrong"),
    "bad-request": (400, "The request cannot be read"),
    "unauthorized": (401, "A token is needed"),
    "forbidden": (403, "The request comes from elsewhere"),
    "not-found": (404, "Not found"),
    "method-not-allowed": (405, "Method not allowed"),
    "too-slow": (408, "The body did not come in time"),
    "name-taken": (409, "The name is taken"),
    "in-use": (409, "The map is in use"),
    "too-large": (413, "The body is too large"),
    "unsupported-media": (415, "The body is of another kind"),
    "bad-map": (422, "The map cannot be used"),
    "bad-scan": (422, "The scan cannot be used"),
    "bad-options": (422, "The options do not go together"),
    "internal": (500, "The service has a defect"),
    "busy": (503, "The service is busy"),
    "not-ready": (503, "The maps are being prepared"),
    "stopping": (503, "The service ends"),
    "out-of-time": (504, "The answer took too long"),
}
_DROPPED = {"closed": "stopping", "preparing": "not-ready", "late": "out-of-time"}


class Refused(ImglocError):  # noqa: N818 (as Dropped)
    """A request that is refused, as one of :data:`KINDS`.

    Parameters
    ----------
    kind, detail : str
    retry : int, optional
        Seconds after which it may be sent again.
    allow : str
        Methods that there are, with commas between.
    """

    def __init__(
        self, kind: str, detail: str, *, retry: int | None = None, allow: str = ""
    ) -> None:
        super().__init__(detail)
        self.kind, self.headers = kind, dict[str, str]()
        if retry is not None:
            self.headers["Retry-After"] = str(retry)
        if allow:
            self.headers["Allow"] = allow
        if kind == "unauthorized":
            self.headers["WWW-Authenticate"] = "Bearer"


@dataclass(frozen=True)
class Problem:
    """A problem document with its headers."""

    document: Mapping[str, Any]
    headers: Mapping[str, str] = field(default_factory=dict)

    @property
    def status(self) -> int:
        """The HTTP status."""
        return int(self.document["status"])

    @property
    def body(self) -> bytes:
        """The document as JSON."""
        return json.dumps(dict(self.document)).encode()

    @property
    def raw_headers(self) -> list[tuple[bytes, bytes]]:
        """All headers, as ASGI has them."""
        given = {"Content-Type": MEDIA, "Content-Length": str(len(self.body)), **self.headers}
        return [(key.lower().encode(), text.encode("latin-1")) for key, text in given.items()]


def problem_of(error: Exception) -> Problem:
    """The document of an error; of one that is a defect nothing but its kind."""
    kinds = ((MapError, "bad-map"), (ScanError, "bad-scan"), (ConfigError, "bad-options"))
    headers: dict[str, str] = {}
    if isinstance(error, Refused):
        kind, detail, headers = error.kind, str(error), error.headers
    elif isinstance(error, Dropped):
        kind, detail = _DROPPED.get(error.why, "busy"), str(error)
        headers["Retry-After"] = "1"
    elif isinstance(error, MemoryError):
        kind, detail = "busy", "out of memory; a smaller map or larger cells need less"
        headers["Retry-After"] = "5"
    else:
        kind = next((kind for cls, kind in kinds if isinstance(error, cls)), "internal")
        detail = str(error) if isinstance(error, ImglocError) else type(error).__name__
    status, title = KINDS[kind]
    about = {"type": f"urn:imgloc:problem:{kind}", "title": title, "status": status}
    return Problem({**about, "detail": " ".join(detail.split())}, headers)
