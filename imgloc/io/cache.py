"""Arrays that took a while to compute, kept on disk under a key that says from what.

An entry is a folder's file, an NPZ without compression. It is written beside its place and
renamed, so that processes that share a folder see whole entries only; and it is read with
suspicion: whatever is wrong with it, the caller gets None and computes the arrays again.
"""

import contextlib
import hashlib
import json
import logging
import os
import re
import secrets
import tokenize
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

import imgloc
from imgloc.errors import ImglocError, OutputError
from imgloc.io.files import PathLike, display, refuse_irregular
from imgloc.model import OccupancyGrid

LOG = logging.getLogger(__name__)

Arrays = Mapping[str, npt.NDArray[Any]]

_FORMAT = 1  # of an entry
_KEY = re.compile(r"[0-9a-f]{40}")
_NAME = "key.npy"
# What reading a file that is not what it says can end in.
_DAMAGE = (
    ImglocError,
    OSError,
    ValueError,
    EOFError,
    KeyError,
    MemoryError,
    RuntimeError,
    SyntaxError,
    TypeError,
    tokenize.TokenError,
    zipfile.BadZipFile,
    zlib.error,
)


def default_folder() -> Path:
    """The user's cache folder: ``$XDG_CACHE_HOME/imgloc`` or ``~/.cache/imgloc``.

    Raises
    ------
    OutputError
        If the user has no home.
    """
    base = os.environ.get("XDG_CACHE_HOME", "")
    if os.path.isabs(base):  # noqa: PTH117  # the specification: ignore a relative one
        return Path(base) / "imgloc"
    try:
        return Path.home() / ".cache" / "imgloc"
    except RuntimeError:
        raise OutputError("no home folder for the map cache: pass --cache DIR") from None


def cache_key(grid: OccupancyGrid, parameters: Mapping[str, object]) -> str:
    """Name what is computed from a map with `parameters`, by this version of the program.

    Parameters
    ----------
    grid : OccupancyGrid
        Its cells and resolution count. Where the map lies in the world does not: features
        are in the grid frame.
    parameters : mapping
        Everything else that decides the arrays: numbers, texts, None.

    Returns
    -------
    str
        40 hexadecimal digits.

    Examples
    --------
    >>> walls = np.eye(3, dtype=bool)
    >>> grid = OccupancyGrid(walls, ~walls, 0.1)
    >>> cache_key(grid, {"sigma": 0.1}) == cache_key(grid, {"sigma": 0.2})
    False
    """
    about = {
        "format": _FORMAT,
        "imgloc": imgloc.__version__,
        # The same call of another version may round in another way.
        "libraries": [np.__version__, cv2.__version__],
        "shape": grid.occupied.shape,
        "resolution": float(grid.resolution).hex(),
        "parameters": dict(parameters),
    }
    digest = hashlib.blake2b(json.dumps(about, sort_keys=True).encode(), digest_size=20)
    for mask in (grid.occupied, grid.free):
        digest.update(np.packbits(mask).tobytes())
    return digest.hexdigest()


def entry_path(folder: PathLike, key: str) -> Path:
    """The file of an entry.

    Raises
    ------
    ValueError
        If `key` is not one of :func:`cache_key`.
    """
    if not _KEY.fullmatch(key):
        raise ValueError(f"not a key of the cache: {key!r}")
    return Path(folder) / f"{key}.npz"


def load_entry(folder: PathLike, key: str) -> dict[str, npt.NDArray[Any]] | None:
    """Read an entry.

    Parameters
    ----------
    folder : path
        Need not exist.
    key : str
        Of :func:`cache_key`.

    Returns
    -------
    dict of str to array, or None
        None if there is no entry, or a damaged one, which is removed with a warning. The
        caller checks shapes and types: they are those of whoever stored the entry.
    """
    path = entry_path(folder, key)
    if not os.path.lexists(path):
        return None
    try:
        refuse_irregular(path, error=OutputError, what="cache entry")
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            if members[:1] and members[0].filename != _NAME:
                raise ValueError("the entry does not say what it holds")
            arrays = {m.filename.removesuffix(".npy"): _read(archive, m) for m in members}
        if str(arrays.pop(_NAME.removesuffix(".npy"))) != key:
            raise ValueError("the entry is another one's")
    except FileNotFoundError:
        return None  # another process has removed it since
    except _DAMAGE as e:
        discard_entry(path, e)
        return None
    return arrays


def entry_names(folder: PathLike, key: str) -> frozenset[str]:
    """Names of the arrays of an entry, without reading them; none if there is no entry."""
    try:
        with zipfile.ZipFile(entry_path(folder, key)) as archive:
            names = archive.namelist()
    except _DAMAGE:
        return frozenset()
    return frozenset(name.removesuffix(".npy") for name in names if name != _NAME)


def store_entry(folder: PathLike, key: str, arrays: Arrays) -> bool:
    """Write an entry, in place of the one that may be there.

    Failing to is not an error, as nothing but time is lost: a warning is logged.

    Parameters
    ----------
    folder : path
        Made if it does not exist, for the user alone.
    key : str
        Of :func:`cache_key`.
    arrays : mapping of str to array
        Of numbers; objects are refused.

    Returns
    -------
    bool
        Whether it was written.
    """
    path = entry_path(folder, key)
    temporary = path.with_name(f".imgloc-{secrets.token_hex(8)}.tmp")
    try:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        # No fsync, which takes longer than computing the arrays: members carry checksums,
        # and an entry that a power failure has torn is computed again.
        with zipfile.ZipFile(temporary, "x", zipfile.ZIP_STORED) as archive:
            for name, array in {_NAME.removesuffix(".npy"): np.array(key), **arrays}.items():
                with archive.open(zipfile.ZipInfo(f"{name}.npy"), "w", force_zip64=True) as file:
                    np.lib.format.write_array(
                        file, np.asarray(array, order="C"), allow_pickle=False
                    )
        temporary.replace(path)
    except (OSError, ValueError) as e:
        LOG.warning("%s: the map cache cannot be written: %s", display(path), _reason(e))
        return False
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
    return True


def discard_entry(path: Path, error: BaseException) -> None:
    """Log that an entry cannot be used and why, and remove it if it is a file."""
    LOG.warning("%s: bad cache entry, built anew: %s", display(path), _reason(error))
    with contextlib.suppress(OSError):
        if path.is_file() and not path.is_symlink():
            path.unlink()


def _read(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> npt.NDArray[Any]:
    """One array; nothing is inflated, so that it cannot be larger than the file."""
    if member.compress_type != zipfile.ZIP_STORED:
        raise ValueError(f"{member.filename} is compressed")
    with archive.open(member) as file:
        array = np.lib.format.read_array(file, allow_pickle=False)
        if file.read(1):
            raise ValueError(f"{member.filename} is longer than its header says")
    array.flags.writeable = False
    return np.asarray(array)


def _reason(error: BaseException) -> str:
    text = (error.strerror if isinstance(error, OSError) else None) or str(error)
    return " ".join(text.split()) or type(error).__name__
