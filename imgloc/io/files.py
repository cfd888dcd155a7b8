"""Reading bytes from disk without hanging, crashing or filling the memory."""

import contextlib
import os
import stat
from collections.abc import Iterator
from io import BufferedReader
from pathlib import Path

from imgloc.errors import ImglocError

PathLike = str | os.PathLike[str]


def display(path: PathLike | bytes) -> str:
    r"""Return `path` as text that can be printed, whatever bytes its name is made of.

    Examples
    --------
    >>> display(b"caf\xe9.png")
    'caf\\xe9.png'
    """
    text = os.fsencode(path).decode("utf-8", "backslashreplace")
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


def read_file(path: PathLike, *, limit: int, error: type[ImglocError], what: str) -> bytes:
    """Return the bytes of the regular file at `path`.

    Pipes, devices and folders are refused before anything is read (a FIFO would block, and
    ``/dev/zero`` never ends); so is a file of more than `limit` bytes.

    Parameters
    ----------
    path : path
        Any path, also one whose name is not valid UTF-8.
    limit : int
        Bytes; one more is an error.
    error : type
        The class of :class:`ImglocError` to raise.
    what : str
        What the file should be, for the message: ``"map image"``.

    Raises
    ------
    ImglocError
        Of class `error`: missing, not a regular file, unreadable or too long.
    """
    with open_file(path, limit=limit, error=error, what=what) as (file, size):
        data = file.read(size + 1)  # room for all that is asked for is taken at once
        if len(data) > size:  # files under /proc claim a size of 0
            data += file.read(limit + 1 - len(data))
    if len(data) > limit:
        raise error(f"{display(path)}: expected a {what} of at most {limit:,} bytes")
    return data


@contextlib.contextmanager
def open_file(
    path: PathLike, *, limit: int, error: type[ImglocError], what: str
) -> Iterator[tuple[BufferedReader, int]]:
    """Open the regular file at `path`, to read some of it; and say how many bytes it has.

    Parameters and errors are those of :func:`read_file`.
    """
    name = display(path)
    with os.fdopen(_open_regular(path, error, what), "rb") as file:
        size = os.fstat(file.fileno()).st_size
        if size > limit:
            raise error(f"{name}: {size:,} bytes, expected a {what} of at most {limit:,}")
        try:
            if not file.peek(1):
                raise error(f"{name}: the file is empty, expected a {what}")
            yield file, size
        except OSError as e:
            raise error(f"{name}: cannot be read: {e.strerror}") from None


def refuse_irregular(path: PathLike, *, error: type[ImglocError], what: str) -> None:
    """Refuse a path that :func:`read_file` could not read, without reading it.

    Raises
    ------
    ImglocError
        Of class `error`.
    """
    os.close(_open_regular(path, error, what))


def _open_regular(path: PathLike, error: type[ImglocError], what: str) -> int:
    """Open a regular file for reading; return its descriptor."""
    name = display(path)
    try:
        # O_NONBLOCK: opening a FIFO without a writer would wait for one.
        fd = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    except FileNotFoundError:
        raise error(f"{name}: no such file{_neighbour_hint(path)}") from None
    except OSError as e:
        raise error(f"{name}: cannot be opened: {e.strerror}") from None
    except ValueError:
        raise error(f"{name}: not a file name (it contains a null byte)") from None
    mode = os.fstat(fd).st_mode
    if stat.S_ISREG(mode):
        return fd
    os.close(fd)
    found = "folder" if stat.S_ISDIR(mode) else "pipe or device"
    raise error(f"{name}: is a {found}, expected a {what} (a regular file)")


def _neighbour_hint(path: PathLike) -> str:
    """Name the files of the same stem that do exist: the usual slip is the ending."""
    wanted = Path(path)
    with contextlib.suppress(OSError):
        there = sorted(
            display(p.name)
            for p in wanted.parent.iterdir()
            if p.stem.lower() == wanted.stem.lower() and p.is_file()
        )
        if there:
            return f"; beside it there is {', '.join(there[:3])}"
    return ""
