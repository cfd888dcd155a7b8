"""Files behind an address, such as https://, s3:// or zip://, for reading: by fsspec.

>>> is_address("s3://maps/a.yaml"), is_address("zip://a.yaml::b.zip"), is_address("C:/a.yaml")
(True, True, False)
"""

import contextlib
import re
import tempfile
import time
from functools import cache
from pathlib import Path
from typing import Any

from imgloc.errors import ImglocError, MapError, ScanError
from imgloc.io.files import COPIES, PathLike, reason
from imgloc.io.mapyaml import image_named

MOST_BYTES, MOST_SECONDS = 1 << 30, 120.0
"""What one file may have, and how long it may take."""
_BLOCK = 1 << 20  # bytes
_FOUND: dict[str, Path] = {}
_ADDRESS = re.compile(r"[a-z][a-z0-9+]+:/+[^/]")


def is_address(path: PathLike) -> bool:
    """Return whether `path` names a file that is not on this machine, or in an archive."""
    return bool(_ADDRESS.match(str(path)))


def local(path: PathLike, error: type[ImglocError] = ScanError) -> Path:
    """The file `path` itself, or a copy of what an address names, which lasts as long as Python.

    With a map's YAML comes the image that it names beside it. An `error` if fsspec is missing,
    or the file is, or it has more than 1 GiB, or does not arrive within two minutes.

    Examples
    --------
    >>> local("a.yaml").name
    'a.yaml'
    """
    if not is_address(path):
        return Path(path)
    if str(path) not in _FOUND:
        _FOUND[str(path)] = _copy(str(path), error)
    return _FOUND[str(path)]


def beside(path: Path, name: str, error: type[ImglocError]) -> Path:
    """The file that a list at `path` calls `name`: an address, or relative to the list.

    Examples
    --------
    >>> beside(Path("/a/list.csv"), "b/map.yaml", MapError).as_posix()
    '/a/b/map.yaml'
    """
    if is_address(name) or str(path) not in COPIES:
        return local(name, error) if is_address(name) else path.absolute().parent / name
    return local(_address_beside(COPIES[str(path)], name), error)


def _address_beside(address: str, name: str) -> str:
    head, chain, archive = address.partition("::")
    return f"{head.rpartition('/')[0]}/{name}{chain}{archive}"


def _copy(address: str, error: type[ImglocError]) -> Path:
    address = re.sub(r"([a-z][a-z0-9+]+):/+", r"\1://", address)  # a Path has one stroke of them
    address = address.replace("file://", "file:///")
    name = re.split(r"[?#]|::", address)[0].rstrip("/").rpartition("/")[2] or "file"
    target = Path(tempfile.mkdtemp(dir=_folder().name)) / name
    _fetch(address, target, error)
    with contextlib.suppress(MapError):  # else it is no map's YAML
        image = image_named(target) if target.suffix in (".yaml", ".yml") else target
        if image.is_relative_to(target.parent) and ".." not in image.parts and image != target:
            there = image.relative_to(target.parent).as_posix()
            _fetch(_address_beside(address, there), image, error)
    return target


@cache
def _folder() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="imgloc-")


def _fetch(address: str, target: Path, error: type[ImglocError]) -> None:
    """Copy the file at an address; of an archive at an address all of it comes first."""
    try:
        import fsspec
    except ImportError:
        hint = "pip install 'imgloc[remote]'"
        raise error(f"{address}: reading what is not a file needs fsspec: {hint}") from None
    COPIES[str(target)] = address
    member, chain, archive = address.partition("::")
    source = f"{member}{chain}{local(archive, error)}" if chain else address
    end, size = time.monotonic() + MOST_SECONDS, 0
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with fsspec.open(source, "rb", **_limits(source)) as opened, target.open("wb") as copy:
            while block := opened.read(_BLOCK):
                size += copy.write(block)
                if size > MOST_BYTES or time.monotonic() > end:
                    much = f"{MOST_BYTES:,} bytes and {MOST_SECONDS:g} s"
                    raise error(f"{address}: expected a file of at most {much}")
    except ImglocError:
        raise
    except Exception as e:  # of fsspec, of what it reads with, of the network
        lost = isinstance(e, FileNotFoundError) and not isinstance(e.__cause__, OSError)
        why = "no such file" if lost else f"cannot be read: {reason(e.__cause__ or e)}"
        raise error(f"{address}: {why}") from None


def _limits(address: str) -> dict[str, Any]:
    """Seconds of silence of a server, for fsspec; what it has is read from the first byte on."""
    if not address.startswith("http"):
        return {}
    from aiohttp import ClientTimeout

    timeout = ClientTimeout(total=MOST_SECONDS, connect=20.0, sock_read=20.0)
    return {"client_kwargs": {"timeout": timeout}, "block_size": 0}
