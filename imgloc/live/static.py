"""The files of the page, read once: what a client asks for is a name in a table, never a path."""

import hashlib
from importlib.resources import files
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from importlib.resources.abc import Traversable

_MEDIA = {
    ".html": "text/html; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".mjs": "text/javascript; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".svg": "image/svg+xml",
    ".png": "image/png",
    ".json": "application/json",
    ".webmanifest": "application/manifest+json",
}


class File(NamedTuple):
    """A file of the page."""

    media: str
    data: bytes
    tag: str  #: of its contents, an ETag


def page_files() -> dict[str, File]:
    """The files of the page by the paths at which they are served; ``/`` is its HTML."""
    found: dict[str, File] = {}

    def walk(folder: "Traversable", path: str) -> None:
        for one in sorted(folder.iterdir(), key=lambda f: f.name):
            if one.is_dir():
                walk(one, f"{path}{one.name}/")
                continue
            media = _MEDIA.get("." + one.name.rpartition(".")[2].lower())
            if media is not None:
                data = one.read_bytes()
                tag = f'"{hashlib.sha256(data).hexdigest()[:32]}"'
                found[path + one.name] = File(media, data, tag)

    here = files("imgloc.live") / "page"
    if here.is_dir():
        walk(here, "/")
    if "/index.html" in found:
        found["/"] = found["/index.html"]
    return found
