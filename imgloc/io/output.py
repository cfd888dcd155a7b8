"""Results onto disk: whole or not at all, and never over somebody else's file."""

import contextlib
import os
import secrets
import stat
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from imgloc.errors import OutputError
from imgloc.io.files import PathLike, display


def refuse_existing(path: PathLike) -> None:
    """Refuse a path at which there is something already.

    Raises
    ------
    OutputError
        Also for a dangling symbolic link.
    """
    if os.path.lexists(path):
        raise OutputError(f"{display(path)}: exists already; pass --force to overwrite it")


def write_bytes_atomic(path: PathLike, data: bytes, *, force: bool = False) -> None:
    """Write `data` to `path` so that a reader sees the old file or the new one, never half.

    The bytes go to a temporary file in the same folder, are flushed to the disk, and the
    file is then given its name in one step.

    Parameters
    ----------
    path : path
        Its folder must exist.
    data : bytes
        The whole content.
    force : bool
        Replace an existing regular file. Without it an existing one is an error, also if
        it appears while this function runs.

    Raises
    ------
    OutputError
        The file exists, the folder does not, the disk is full, or permission is missing.
    """
    name = display(path)
    target = Path(path)
    if not force:
        refuse_existing(target)
    elif os.path.lexists(target) and not stat.S_ISREG(target.lstat().st_mode):
        raise OutputError(f"{name}: is not a regular file and will not be replaced")
    temporary = target.with_name(f".imgloc-{secrets.token_hex(8)}.tmp")
    try:
        # Mode 0o666 under the user's umask, as any other program creates its files.
        fd = os.open(
            temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o666
        )
    except (OSError, ValueError) as e:
        raise OutputError(f"{name}: cannot be written: {_reason(e, target)}") from None
    try:
        with os.fdopen(fd, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        if force:
            temporary.replace(target)
        else:
            _name_if_new(temporary, target)
    except FileExistsError:
        raise OutputError(f"{name}: exists already; pass --force to overwrite it") from None
    except (OSError, ValueError) as e:
        raise OutputError(f"{name}: cannot be written: {_reason(e, target)}") from None
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
    _sync_folder(target.parent)


def write_text_atomic(path: PathLike, text: str, *, force: bool = False) -> None:
    """Write `text` as UTF-8; see :func:`write_bytes_atomic`.

    Raises
    ------
    OutputError
        As :func:`write_bytes_atomic`.
    """
    write_bytes_atomic(path, text.encode("utf-8", "surrogateescape"), force=force)


def encode_png(image: npt.NDArray[Any]) -> bytes:
    r"""Encode an image as PNG, in memory.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) uint8 array
        Top row first; grey or BGR.

    Returns
    -------
    bytes

    Raises
    ------
    ValueError
        Another shape or type.
    OutputError
        OpenCV cannot encode it.

    Examples
    --------
    >>> encode_png(np.zeros((2, 3), np.uint8))[:4]
    b'\x89PNG'
    """
    shaped = image.ndim == 2 or (image.ndim == 3 and image.shape[2] == 3)
    if image.dtype != np.uint8 or not shaped or 0 in image.shape:
        raise ValueError(f"image {image.shape} {image.dtype} must be uint8, grey or BGR")
    try:
        ok, buffer = cv2.imencode(".png", np.ascontiguousarray(image))
    except cv2.error as e:
        raise OutputError(f"a picture of {image.shape} cannot be encoded: {e}") from None
    if not ok:
        raise OutputError(f"a picture of {image.shape} cannot be encoded")
    return buffer.tobytes()


def _name_if_new(temporary: Path, target: Path) -> None:
    """Give the file its name unless something has that name: rename would overwrite."""
    try:
        target.hardlink_to(temporary)
    except FileExistsError:
        raise
    except (OSError, NotImplementedError):  # a file system without hard links
        refuse_existing(target)
        temporary.rename(target)


def _reason(e: OSError | ValueError, target: Path) -> str:
    if isinstance(e, FileNotFoundError):
        return f"there is no folder {display(target.parent)}"
    return (e.strerror if isinstance(e, OSError) else None) or str(e)


def _sync_folder(folder: Path) -> None:
    """Flush the rename itself; file systems that cannot are not an error."""
    with contextlib.suppress(OSError):
        fd = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(fd)
        finally:
            os.close(fd)
