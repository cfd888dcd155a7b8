"""Problem documents (RFC 9457): the answers to requests that the service refuses.

>>> from imgloc.errors import MapError
>>> kind, answer = problem_of(MapError("office.yaml: resolution: missing"))
>>> kind, answer.status_code, answer.body.decode()[-44:]
('bad-map', 422, '"detail":"office.yaml: resolution: missing"}')
"""

from collections.abc import Mapping

from starlette.responses import JSONResponse

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


def problem_of(error: Exception) -> tuple[str, JSONResponse]:
    """The kind of an error, and its document; of one that is a defect nothing but its kind."""
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
    about["detail"] = " ".join(detail.split())
    return kind, JSONResponse(about, status, headers, MEDIA)
