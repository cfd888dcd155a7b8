"""Bytes from and onto disk: nothing hangs, nothing is half written, no file of others is lost."""

import contextlib
import difflib
import json
import os
import secrets
import stat
from collections.abc import Iterator, Mapping
from io import BufferedReader
from pathlib import Path

from imgloc.errors import ImglocError, OutputError, printable

PathLike = str | os.PathLike[str]
TEMPORARY = ".imgloc-{}.tmp"
"""Name of a file that is being written, with 16 random hexadecimal digits."""
OTHERS: Mapping[str, Mapping[str, str]] = json.loads(
    Path(__file__).with_name("others.json").read_text("utf-8")
)
"""What files are that people take for maps or for scans, and what makes such of them.

By the endings of their names; of images by how they begin, of texts by patterns of that.
"""
COPIES: dict[str, str] = {}
"""Addresses of what was copied onto this machine, see :mod:`imgloc.io.remote`, by the copy."""


def display(path: PathLike | bytes) -> str:
    r"""Return `path` as text that can be printed, whatever bytes its name is made of.

    Examples
    --------
    >>> display(b"caf\xe9.png")
    'caf\\xe9.png'
    """
    text = os.fsencode(path).decode("utf-8", "backslashreplace")
    return printable(COPIES.get(text, text), keep="")


def map_name(path: PathLike) -> str:
    """Return the name of a map for people: that of its folder if the file is just called map.

    Examples
    --------
    >>> map_name("maps/attic.yaml"), map_name("cellar/map.yaml")
    ('attic', 'cellar')
    """
    file = Path(path)
    return display((file.stem == "map" and file.absolute().parent.name) or file.stem)


@contextlib.contextmanager
def open_file(
    path: PathLike, *, limit: int, error: type[ImglocError], what: str
) -> Iterator[tuple[BufferedReader, int]]:
    """Open a file for reading, of 1 to `limit` bytes, as :func:`open_regular`; yield its length."""
    name = display(path)
    with os.fdopen(open_regular(path, error, what), "rb") as file:
        size = os.fstat(file.fileno()).st_size
        if size > limit:
            raise error(f"{name}: {size:,} bytes, expected a {what} of at most {limit:,}")
        try:
            if not file.peek(1):
                raise error(f"{name}: the file is empty, expected a {what}")
            yield file, size
        except OSError as e:
            raise error(f"{name}: cannot be read: {e.strerror}") from None


def read_file(path: PathLike, *, limit: int, error: type[ImglocError], what: str) -> bytes:
    """Return the bytes of a regular file; parameters and errors are those of :func:`open_file`."""
    with open_file(path, limit=limit, error=error, what=what) as (file, size):
        data = file.read(size + 1)  # room for all that is asked for is taken at once
        if len(data) > size:  # files under /proc claim a size of 0
            data += file.read(limit + 1 - len(data))
    if len(data) > limit:
        raise error(f"{display(path)}: expected a {what} of at most {limit:,} bytes")
    return data


def open_regular(
    path: PathLike, error: type[ImglocError], what: str, *, follow: bool = True, write: bool = False
) -> int:
    """Open a regular file; return its descriptor.

    All else is refused, with `error`, before it is read: a FIFO would block, /dev/zero never ends.

    Parameters
    ----------
    path : path
        The file.
    error : type
        Class of the error that names the file and what it is.
    what : str
        What the file should be, for the message.
    follow : bool
        Whether a link leads to the file; else a link is refused. Where imgloc writes, a link that
        somebody has planted would lead to a file of the user.
    write : bool
        Open it for reading and writing, and make it if there is none. Nothing is truncated.
    """
    name = display(path)
    flags = os.O_RDWR | os.O_CREAT if write else os.O_RDONLY
    flags |= 0 if follow else getattr(os, "O_NOFOLLOW", 0)
    try:
        # O_NONBLOCK: opening a FIFO without a writer would wait for one.
        more = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
        fd = os.open(path, flags | more, 0o666)
    except FileNotFoundError:
        raise error(f"{name}: no such file{neighbour_hint(path)}") from None
    except IsADirectoryError:  # asked for writing
        raise error(f"{name}: is a folder, expected a {what} (a regular file)") from None
    except OSError as e:
        if not follow and os.path.islink(path):  # noqa: PTH114 (it never raises)
            raise error(f"{name}: is a link, expected a {what} (a regular file)") from None
        raise error(f"{name}: cannot be opened: {e.strerror}") from None
    except ValueError:
        raise error(f"{name}: not a file name (it contains a null byte)") from None
    mode = os.fstat(fd).st_mode
    if stat.S_ISREG(mode):
        return fd
    os.close(fd)
    found = "folder" if stat.S_ISDIR(mode) else "pipe or device"
    raise error(f"{name}: is a {found}, expected a {what} (a regular file){_inside_hint(path)}")


def is_there(path: PathLike) -> bool:
    """Return whether a path leads to anything; no also if it may not be looked at or is too long.

    :meth:`pathlib.Path.exists` raises for those, as do its companions.

    Examples
    --------
    >>> is_there("a" * 300), is_folder("/"), is_file("/")
    (False, True, False)
    """
    return os.path.exists(path)  # noqa: PTH110


def is_folder(path: PathLike) -> bool:
    """Return whether a path leads to a folder, as :func:`is_there`."""
    return os.path.isdir(path)  # noqa: PTH112


def is_file(path: PathLike) -> bool:
    """Return whether a path leads to a regular file, as :func:`is_there`."""
    return os.path.isfile(path)  # noqa: PTH113


def neighbour_hint(path: PathLike) -> str:
    """Name the files of the same stem, or nearly so: the usual slip is the ending, or a letter."""
    wanted = Path(path)
    with contextlib.suppress(OSError):
        stem, files = wanted.stem.lower(), list(wanted.parent.iterdir())
        near = difflib.get_close_matches(stem, [p.stem.lower() for p in files], cutoff=0.8)
        same = (p for p in files if p.stem.lower() in {stem, *near})
        if there := sorted(display(p.name) for p in same if p.is_file()):
            return f"; beside it there is {', '.join(there[:3])}"
    return ""


def _inside_hint(path: PathLike) -> str:
    """Name some files of a folder."""
    with contextlib.suppress(OSError):
        if there := sorted(display(p.name) for p in Path(path).iterdir() if p.is_file()):
            return f"; in it there is {', '.join(there[:3])}"
    return ""


def reason(error: BaseException) -> str:
    """One-line message of an error, shortened: libraries may quote a whole file."""
    text = (error.strerror if isinstance(error, OSError) else None) or str(error)
    line = " ".join(text[:2000].split()) or type(error).__name__
    return line if len(line) <= 200 else f"{line[:200]}..."


def refuse_existing(path: PathLike) -> None:
    """Raise :class:`OutputError` if there is something at `path`, be it a dangling link."""
    if os.path.lexists(path):
        raise OutputError(f"{display(path)}: exists already; pass `force=True` to overwrite it")


def write_bytes_atomic(path: PathLike, data: bytes, *, force: bool = False) -> None:
    """Write `data` to `path` so that a reader sees the old file or the new one, never half.

    OutputError if the file exists (without `force`; also if it appears while this runs) or is not
    a regular one, the folder does not exist, the disk is full, or permission is missing.
    """
    name, target = display(path), Path(path)
    if not force:
        refuse_existing(target)
    elif os.path.lexists(target) and not stat.S_ISREG(target.lstat().st_mode):
        raise OutputError(f"{name}: is not a regular file and will not be replaced")
    temporary = target.with_name(TEMPORARY.format(secrets.token_hex(8)))
    try:
        try:
            # Mode 0o666 under the user's umask, as any other program creates its files.
            with temporary.open("xb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            if force:
                temporary.replace(target)
            else:  # a rename would overwrite what has appeared since
                try:
                    target.hardlink_to(temporary)
                except (OSError, NotImplementedError):  # it has, or there are no hard links
                    refuse_existing(path)
                    temporary.rename(target)
        finally:
            with contextlib.suppress(OSError, ValueError):
                temporary.unlink(missing_ok=True)
    except FileNotFoundError:
        folder = display(target.parent)
        raise OutputError(f"{name}: cannot be written: there is no folder {folder}") from None
    except (OSError, ValueError) as e:
        raise OutputError(f"{name}: cannot be written: {reason(e)}") from None
    with contextlib.suppress(OSError):  # the rename itself, where the file system can flush it
        fd = os.open(target.parent, os.O_RDONLY)
        try:
            os.fsync(fd)
        finally:
            os.close(fd)


def write_text_atomic(path: PathLike, text: str, *, force: bool = False) -> None:
    """Write `text` as UTF-8, in all else as :func:`write_bytes_atomic`."""
    write_bytes_atomic(path, text.encode("utf-8", "surrogateescape"), force=force)
