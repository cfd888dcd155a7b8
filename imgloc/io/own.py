"""Files that imgloc writes and reads again: by then edited, damaged or planted.

A *kind* describes what such a file has to hold; it is checked once, when the file is read:

- ``str``, ``bool``, ``int``, ``float`` (a finite number), ``None``; ``object`` is anything
- a frozenset: one of its texts; a pattern: a text that matches it from end to end
- a tuple: one of several kinds
- ``[kind]``: a list of any length, ``[kind, kind]``: a list of as many
- ``{str: kind}``: an object with keys of any name
- ``{"name": kind, "other?": kind}``: an object with these keys, the second if it is there, and
  perhaps more
"""

import json
import mmap
import os
import re
import reprlib
import struct
import zipfile
import zlib
from collections.abc import Mapping
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from imgloc.errors import OutputError
from imgloc.io.files import PathLike, display, open_file, read_file, reason

_DEPTH = 40  # levels; imgloc writes less than ten
_MOST = 1e300  # imgloc writes no number as large
_WHOLE = 1 << 63  # nor a whole one, of which neither a float nor a column of a table may be made
_SHOWN = 60  # characters of where something is
_HEAD, _FIELD = 30, 0x4C49  # of a member of an archive: bytes, and the name of a field of ours
_NAMES = {
    str: "a text", bool: "true or false", int: "a whole number", float: "a number", None: "null",
    object: "a plain value",
}  # fmt: skip


class _WrongError(ValueError):
    """A fault and its place: names and places from the outside in."""

    def __init__(self, what: str) -> None:
        super().__init__(what)
        self.where: list[str] = []

    def __str__(self) -> str:
        at = ".".join(reversed(self.where))
        at = at if len(at) <= _SHOWN else f"{at[:_SHOWN]}..."
        return f"{at}: {self.args[0]}" if at else str(self.args[0])


def parse_json(data: bytes, kind: Any = object, *, strict: bool = False) -> Any:
    """The value of a JSON text of some kind; what JSON has not (NaN, Infinity) is null.

    ValueError, with the place and what was expected, for whatever is not as imgloc writes it; if
    `strict`, also for what JSON has not.

    Examples
    --------
    >>> parse_json(b'{"ms": [1, 2.5]}', {"ms": [float], "hits?": int})
    {'ms': [1, 2.5]}
    >>> parse_json(b'{"ms": [1, 1e999]}', {"ms": [float]})
    Traceback (most recent call last):
        ...
    ValueError: ms.1: got inf, expected a number
    """
    try:  # no kind admits what `float` makes of these
        value = json.loads(data, parse_constant=float if strict else lambda _: None)
    except (json.JSONDecodeError, UnicodeDecodeError) as e:
        raise ValueError(f"not JSON: {e}") from None
    except ValueError:  # Python would say how to read it unsafely
        raise ValueError("a number of thousands of digits") from None
    except RecursionError:
        raise ValueError("nested too deeply") from None
    except MemoryError:
        raise ValueError("too large") from None
    _expect(value, kind)
    return value


def read_json(
    path: PathLike, kind: Any, *, limit: int, what: str, version: int | None = None,
    strict: bool = False,
) -> dict[str, Any]:  # fmt: skip
    """Read a file that is a JSON object of some kind, and has this `version` as its ``format``.

    OutputError, which names the file, if it cannot be read, is longer than `limit` bytes or no
    regular file, or is not what imgloc writes: if `strict`, also one with NaN or Infinity.
    """
    data = read_file(path, limit=limit, error=OutputError, what=what)
    try:
        value: dict[str, Any] = parse_json(data, {str: object}, strict=strict)
        if version is None or value.get("format") == version:
            _expect(value, kind)
            return value
    except ValueError as e:
        raise OutputError(f"{display(path)}: is no {what}: {reason(e)}") from None
    raise OutputError(f"{display(path)}: is no {what} of this version (format {version})")


def _expect(value: Any, kind: Any) -> None:
    """Raise a ValueError with the place where a value is not of a kind."""
    try:
        _check(value, kind, _DEPTH)
    except _WrongError as e:
        raise ValueError(str(e)) from None


def _check(value: Any, kind: Any, depth: int) -> None:
    """Raise a ValueError for a value that is not of a kind, or deeper than so many levels."""
    if depth < 0:
        raise _WrongError("nested too deeply")
    if kind is object and isinstance(value, dict | list):
        kind = {str: object} if isinstance(value, dict) else [object]
    if isinstance(kind, list):
        if not isinstance(value, list) or (len(kind) > 1 and len(kind) != len(value)):
            raise _WrongError(_told(value, kind))
        for k, item in enumerate(value):
            wanted = kind[k if len(kind) > 1 else 0]
            if not _is_fine(item, wanted):
                _inside(item, wanted, k, depth)
    elif isinstance(kind, dict):
        if not isinstance(value, dict):
            raise _WrongError(_told(value, kind))
        for name, wanted in kind.items():
            if name is not str and not name.endswith("?") and name not in value:
                raise _WrongError(f"no {name}, expected {_named(wanted)}")
        rest = kind.get(str, object)
        for name, item in value.items():
            wanted = kind.get(name) or kind.get(f"{name}?", rest)
            if not (name.isascii() and _is_fine(item, wanted)):
                _inside(item, wanted, name, depth)
    elif not any(_is(value, one) for one in (kind if isinstance(kind, tuple) else (kind,))):
        raise _WrongError(_told(value, kind))


def _is_fine(value: Any, kind: Any) -> bool:
    """Return whether a value is of its kind; the most frequent kinds are checked first."""
    if type(value) is float:
        number = kind in (float, object) or (isinstance(kind, tuple) and float in kind)
        return number and -_MOST < value < _MOST
    return type(value) is str and kind in (str, object) and value.isascii()


def _inside(item: Any, kind: Any, name: str | int, depth: int) -> None:
    """Check what has a name or place in something else."""
    try:
        if isinstance(name, str) and not _is(name, str):
            raise _WrongError("a name that is no text")
        _check(item, kind, depth - 1)
    except _WrongError as e:
        e.where.append(ascii(name)[1:-1] if isinstance(name, str) else str(name))
        raise


def _is(value: Any, kind: Any) -> bool:
    """Return whether a value is of a kind that has no others in it."""
    if kind is object:
        return value is None or _is(value, type(value))
    if kind is None:
        return value is None
    if kind is float:
        return (type(value) is float and abs(value) < _MOST) or _is(value, int)
    if kind is int:
        return type(value) is int and abs(value) < _WHOLE
    if not isinstance(value, str):
        return kind is bool and isinstance(value, bool)
    if isinstance(kind, frozenset):
        return value in kind
    if isinstance(kind, re.Pattern):
        return kind.fullmatch(value) is not None
    try:  # half of a pair is no character; bytes of names that are not UTF-8 are
        return kind is str and (value.isascii() or bool(value.encode("utf-8", "surrogateescape")))
    except UnicodeEncodeError:
        return False


def _told(value: Any, kind: Any) -> str:
    """The value that was got, on one line, and what was expected."""
    return f"got {reprlib.repr(value)}, expected {_named(kind)}"


def _named(kind: Any) -> str:
    """The name of a kind."""
    if isinstance(kind, tuple):
        return " or ".join(map(_named, kind))
    if isinstance(kind, frozenset):
        return f"one of {', '.join(sorted(kind))}"
    if isinstance(kind, list):
        return "a list" if len(kind) == 1 else f"a list of {len(kind)}"
    if isinstance(kind, dict):
        keys = ", ".join(key.removesuffix("?") for key in kind if isinstance(key, str))
        return f"an object with {keys}" if keys else "an object"
    return f"a name like {kind.pattern}" if isinstance(kind, re.Pattern) else _NAMES[kind]


def write_arrays(file: BinaryIO, arrays: Mapping[str, npt.NDArray[Any]]) -> None:
    """Write arrays as :func:`numpy.savez` does, each at a multiple of 64 bytes, with its check."""
    with zipfile.ZipFile(file, "w") as archive:
        for name, array in arrays.items():
            member = zipfile.ZipInfo(f"{name}.npy")
            member.file_size = array.nbytes  # decides how its size is written
            # A field of our own has the check and fills up; NumPy's header is a multiple, too.
            size = 4 + -(file.tell() + _HEAD + len(member.filename.encode()) + 8) % 64
            check = _check_of(array.reshape(-1).view(np.uint8)).to_bytes(size, "little")
            member.extra = struct.pack("<HH", _FIELD, size) + check
            with archive.open(member, "w") as out:
                np.lib.format.write_array(out, array, allow_pickle=False)


def map_arrays(path: PathLike, *, limit: int, what: str) -> tuple[dict[str, npt.NDArray[Any]], int]:
    """Map the arrays of a file of :func:`write_arrays` into memory, read-only; and its bytes.

    OutputError for a file above `limit` bytes. Whatever else is wrong with it raises any exception:
    an array whose bytes are not those that were written is a ValueError.
    """
    out = {}
    with open_file(path, limit=limit, error=OutputError, what=what) as (file, size):
        # Windows neither removes nor replaces a file that is mapped.
        many = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) if os.name != "nt" else None
        whole = np.frombuffer(many or file.read(), np.uint8)
        for member in zipfile.ZipFile(file).infolist():
            file.seek(member.header_offset + _HEAD - 4)
            file.seek(sum(struct.unpack("<HH", file.read(4))), os.SEEK_CUR)
            end = file.tell() + member.file_size
            np.lib.format.read_magic(file)
            shape, _, dtype = np.lib.format.read_array_header_1_0(file)
            found = whole[file.tell() : end]
            # Former versions, and NumPy, write no field of ours.
            if member.extra and _check_of(found) != int.from_bytes(member.extra[4:], "little"):
                raise ValueError(f"{member.filename}: its bytes have changed")
            out[member.filename.removesuffix(".npy")] = found.view(dtype).reshape(shape)
    return out, size


def _check_of(data: npt.NDArray[np.uint8]) -> int:
    """A checksum of bytes, several times as fast as :func:`zlib.crc32`: of their sums both ways."""
    whole = len(data) // 4096 * 4096
    rows = data[:whole].view(np.uint64).reshape(-1, 512)
    sums = rows.sum(axis=0).tobytes() + rows.sum(axis=1).tobytes()
    return zlib.crc32(data[whole:].tobytes(), zlib.crc32(sums))


def same_file(descriptor: int, path: PathLike) -> bool:
    """Return whether a file that is open is what a path leads to still."""
    try:
        return os.path.samestat(os.fstat(descriptor), os.lstat(path))
    except (OSError, ValueError):
        return False
