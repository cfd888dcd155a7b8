"""Arrays that took a while to compute, kept on disk under a key of their sources.

An entry is an NPZ without compression, written beside its place and renamed, so that processes
that share a folder see whole entries only. Its arrays are aligned and mapped into memory, not read:
processes share them. It is used with suspicion: whatever is wrong with it, the caller gets None and
computes anew. Beyond a limit the entries used longest ago go first.
"""

import contextlib
import hashlib
import json
import logging
import os
import re
import secrets
import time
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt
import platformdirs

from imgloc.__about__ import __version__
from imgloc.errors import ConfigError, OutputError
from imgloc.io.files import PathLike, display, open_file, reason
from imgloc.io.own import map_arrays, write_arrays
from imgloc.model import OccupancyGrid

LOG = logging.getLogger("imgloc")
Arrays = Mapping[str, npt.NDArray[Any]]
LIMIT_MIB = 2048
"""MiB that the entries of a folder may take, unless the environment has ``IMGLOC_CACHE_MIB``."""
_FORMAT = 3  # of an entry
_ENTRY = "cache entry"
_MOST = (1 << 31) - (1 << 20)  # bytes of an entry: a larger archive has another form
_MAKER = 8  # digits of a key that name the version of the program
_NAME = re.compile(r"[0-9a-f]{40}\.npz|\.imgloc-cache-[0-9a-f]{16}\.tmp")
_HEAD = 37  # bytes in which an archive says that its first member is key.npy
# Nobody writes this long, and a version that has not been used for so long is not used beside this.
_ORPHANED = 3600.0  # seconds


class CacheInfo(NamedTuple):
    """Bytes that a folder of the cache holds, and that it may hold."""

    entries: int
    bytes: int
    limit: int
    folder: Path


def cache_folder() -> Path:
    """The user's, on Linux ``$XDG_CACHE_HOME/imgloc``; OutputError if the user has no home."""
    with contextlib.suppress(RuntimeError):
        folder = platformdirs.user_cache_path("imgloc", appauthor=False)
        if folder.is_absolute():
            return folder
    missing = "no home folder (or absolute XDG_CACHE_HOME) for the map cache"
    raise OutputError(f"{missing}: pass `cache`")


def cache_limit() -> int:
    """Bytes that a folder may take: :data:`LIMIT_MIB`, or the value in the environment.

    ConfigError if that is no number.
    """
    given = os.environ.get("IMGLOC_CACHE_MIB", "")
    if given and not re.fullmatch(r"\d{1,12}", given, re.ASCII):
        expected = f"a whole number of MiB, such as {LIMIT_MIB}, or that it is not set"
        raise ConfigError(f"IMGLOC_CACHE_MIB: got {given!r:.60}, expected {expected}")
    return int(given or LIMIT_MIB) << 20


def cache_info(folder: PathLike | None = None) -> CacheInfo:
    """Look at what is in `folder`, which need not exist; default :func:`cache_folder`."""
    folder = cache_folder() if folder is None else Path(folder)
    if folder.exists() and not folder.is_dir():
        raise ConfigError(f"{display(folder)}: is no folder, expected that of prepared maps")
    files = list(_files(folder))
    entries = sum(path.suffix == ".npz" for path, _ in files)
    return CacheInfo(entries, sum(about.st_size for _, about in files), cache_limit(), folder)


def clear_cache(folder: PathLike | None = None) -> int:
    """Remove what this program, of any version, keeps in `folder`; return how many files."""
    folder = cache_folder() if folder is None else Path(folder)
    return sum(_removed(path) for path, _ in _files(folder))


def cache_key(grid: OccupancyGrid, parameters: Mapping[str, object], *, code: str = "") -> str:
    """Name what is computed from a map by this version of the program: 40 hexadecimal digits.

    Cells and resolution count, but not the origin: features are in the grid frame. `parameters`
    is all else that decides the arrays (numbers, texts, None), and `code` distinguishes versions
    beside their number. Entries of other versions go when they have not been used for an hour.
    """
    # The same call of another version of a library may round in another way.
    maker = [_FORMAT, __version__, np.__version__, cv2.__version__, code]
    made_by = hashlib.blake2b(json.dumps(maker).encode(), digest_size=_MAKER // 2)
    side, shape = float(grid.resolution).hex(), grid.occupied.shape
    about = {"shape": shape, "resolution": side, "parameters": dict(parameters)}
    return made_by.hexdigest() + cells_digest(grid, about, 20 - _MAKER // 2)


def cells_digest(grid: OccupancyGrid, about: object, size: int) -> str:
    """Digest, of so many bytes, for the cells of a map and `about` (as JSON)."""
    digest = hashlib.blake2b(json.dumps(about, sort_keys=True).encode(), digest_size=size)
    for mask in (grid.occupied, grid.free):
        digest.update(np.packbits(mask).tobytes())
    return digest.hexdigest()


def entry_path(folder: PathLike, key: str) -> Path:
    """The file of an entry; ValueError if `key` is not one of :func:`cache_key`."""
    if not _NAME.fullmatch(f"{key}.npz"):
        raise ValueError(f"not a key of the cache: {key!r}")
    return Path(folder) / f"{key}.npz"


def load_entry(folder: PathLike, key: str) -> dict[str, npt.NDArray[Any]] | None:
    """Map an entry: None if there is none, or a damaged one, which is removed with a warning.

    The caller checks shapes and types: they are those of whoever stored the entry.
    """
    path = entry_path(folder, key)
    if not os.path.lexists(path):
        return None
    try:
        arrays, _ = map_arrays(path, limit=_MOST, what=_ENTRY)
        if str(arrays.pop("key")) != key:
            raise ValueError("the entry belongs to another key")
    except Exception as e:  # a file that is not what it says can end in anything
        if not isinstance(e.__context__, FileNotFoundError):  # another process has removed it since
            discard_entry(path, e)
        return None
    with contextlib.suppress(OSError):
        os.utime(path)  # the time of its use
    return arrays


def entry_names(folder: PathLike, key: str) -> frozenset[str]:
    """Names of the arrays of an entry, without reading them; none if there is no entry."""
    try:
        path = entry_path(folder, key)
        with open_file(path, limit=_MOST, error=OutputError, what=_ENTRY) as (file, _):
            names = zipfile.ZipFile(file).namelist()
        return frozenset(name.removesuffix(".npy") for name in names) - {"key"}
    except Exception:  # a file that is not what it says can end in anything
        return frozenset()


def store_entry(folder: PathLike, key: str, arrays: Arrays, *, limit: int | None = None) -> bool:
    """Write an entry, in place of the one that may be there, tidy the folder; whether it was done.

    Failing to is not an error, as nothing but time is lost: a warning is logged. `folder` is made
    if it does not exist, for the user alone, and holds at most `limit` bytes, by default those of
    :func:`cache_limit`. Arrays of objects are refused.
    """
    path, limit = entry_path(folder, key), cache_limit() if limit is None else limit
    temporary = path.with_name(f".imgloc-cache-{secrets.token_hex(8)}.tmp")
    content: dict[str, Any] = {"key": np.array(key)}
    content |= {name: np.asarray(array, order="C") for name, array in arrays.items()}
    if (size := sum(array.nbytes for array in content.values())) > min(limit, _MOST):
        LOG.info("%s: %d MiB are more than the cache may hold", display(path), size >> 20)
        return False
    try:
        if any(array.dtype.hasobject for array in content.values()):
            raise ValueError("objects are not stored")
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        # No fsync, which takes longer than computing the arrays: members carry checksums,
        # and an entry that a power failure has torn is computed again.
        with temporary.open("xb") as file:
            write_arrays(file, content)
        temporary.replace(path)
    except (OSError, ValueError) as e:
        LOG.warning("%s: the map cache cannot be written: %s", display(path), reason(e))
        return False
    finally:
        _removed(temporary)
    _tidy(path, limit)
    return True


def discard_entry(path: Path, error: BaseException) -> None:
    """Log that an entry cannot be used and why, and remove it if it is a file."""
    LOG.warning("%s: bad cache entry, built anew: %s", display(path), reason(error))
    if path.is_file() and not path.is_symlink():
        _removed(path)


def _files(folder: Path) -> Iterator[tuple[Path, os.stat_result]]:
    """Files in `folder` that this program has written: entries, and what is left of some."""
    with contextlib.suppress(OSError), os.scandir(folder) as there:
        for item in there:
            with contextlib.suppress(OSError):  # gone since
                if _NAME.fullmatch(item.name) and item.is_file(follow_symlinks=False):
                    path = Path(item.path)
                    with path.open("rb") as file:
                        head = file.read(_HEAD)
                    # Others name files by digests, too.
                    ours = head.startswith(b"PK\3\4") and head.endswith(b"key.npy")
                    if path.suffix == ".tmp" or ours:
                        yield path, item.stat(follow_symlinks=False)


def _tidy(stored: Path, limit: int) -> None:
    """Remove orphans from the folder of an entry, and of the rest what is beyond `limit` bytes."""
    now, rest = time.time(), []
    for path, about in _files(stored.parent):
        if path.name[:_MAKER] != stored.name[:_MAKER] and now - about.st_mtime >= _ORPHANED:
            _removed(path)
        elif path.suffix == ".npz":  # else somebody is writing it
            rest.append((about.st_mtime, about.st_size, path))
    total = sum(size for _, size, _ in rest)
    for _, size, path in sorted(rest):
        if total > limit and path != stored and _removed(path):
            total -= size


def _removed(path: Path) -> bool:
    """Remove a file; whether that was done, and not by another process."""
    try:
        path.unlink()
    except OSError:
        return False
    return True
