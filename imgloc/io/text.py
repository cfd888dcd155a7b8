"""Files of text as they come: packed by gzip or not, with a byte-order mark or without."""

import codecs
import contextlib
import csv
import gzip
import io
import zlib
from collections.abc import Iterable, Iterator
from typing import IO, Any

from imgloc.errors import ScanError
from imgloc.io.files import PathLike, display, open_file
from imgloc.io.scanset import MAX_READINGS

MAX_TEXT = 8 * MAX_READINGS
"""Bytes of a file of text, unpacked."""
# Bytes that gzip may unpack to: a part of that, and a multiple of the file. Logs shrink to a tenth.
_ROOM, _RATIO = 16 << 20, 100
_GZIP = b"\x1f\x8b"
_UTF16 = codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE


@contextlib.contextmanager
def open_text(path: PathLike) -> Iterator[tuple[Any, int]]:
    """Open a file of scans, unpacked if it is packed by gzip; yield the bytes that are on disk.

    ScanError if it is damaged, or unpacks to more than 16 MiB and 100 times its size.
    """
    with open_file(path, limit=MAX_TEXT, error=ScanError, what="scan file") as (file, size):
        if not file.peek(2).startswith(_GZIP):
            yield file, size
            return
        name = display(path)
        try:
            with gzip.GzipFile(fileobj=file) as unpacked:
                yield _Counted(unpacked, min(MAX_TEXT, _ROOM + _RATIO * size), name), size
        except (gzip.BadGzipFile, EOFError, zlib.error):
            raise ScanError(f"{name}: damaged gzip file; copy it again, or unpack it") from None


def read_bytes(path: PathLike) -> bytes:
    """Return the bytes of a file of scans, as :func:`open_text` unpacks it."""
    with open_text(path) as (file, _):
        data: bytes = file.read(MAX_TEXT + 1)
    if len(data) > MAX_TEXT:
        raise ScanError(f"{display(path)}: expected a scan file of at most {MAX_TEXT:,} bytes")
    return data


def read_text(path: PathLike, *, errors: str = "strict", other: str = "") -> str:
    """Return the text of a file: UTF-8, UTF-16 with a byte-order mark, or else in the `other` form.

    ScanError for bytes that are none of these, unless `errors` is "replace".
    """
    data = read_bytes(path)
    try:
        return decoded(data, errors)
    except UnicodeDecodeError as e:
        with contextlib.suppress(UnicodeDecodeError, LookupError):
            if b"\0" not in data:
                return data.decode(other)
        raise ScanError(f"{display(path)}: byte {e.start} is not UTF-8 text") from None


def decoded(data: bytes, errors: str = "strict") -> str:
    r"""The text of some bytes, without the byte-order mark that they may begin with.

    Examples
    --------
    >>> decoded(b"\xff\xfea\x00"), decoded(b"\xef\xbb\xbfa"), decoded(b"a")
    ('a', 'a', 'a')
    """
    return data.decode("utf-16" if data.startswith(_UTF16) else "utf-8-sig", errors)


def unmarked(data: bytes) -> bytes:
    """The first bytes of a file, as those of UTF-8 without a byte-order mark."""
    if data.startswith(_UTF16):
        return decoded(data, "replace").encode()
    return data.removeprefix(codecs.BOM_UTF8)


class _Counted:
    """A packed file that is open, of which there is an end."""

    def __init__(self, file: IO[bytes] | gzip.GzipFile, most: int, name: str) -> None:
        self._file, self._left, self._name = file, most, name

    def read(self, size: int = -1) -> bytes:
        wanted = self._left + 1 if size < 0 else min(size, self._left + 1)
        data = self._file.read(wanted)
        self._left -= len(data)
        if self._left < 0:
            hint = f"expected at most {_RATIO} times its size; unpack it"
            raise ScanError(f"{self._name}: gzip unpacks to too much, {hint}")
        return data

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)


def csv_text(rows: Iterable[Iterable[object]]) -> str:
    r"""Rows of cells as the text of a CSV.

    Examples
    --------
    >>> csv_text([("x", "words"), (1.5, "a, b")])
    'x,words\n1.5,"a, b"\n'
    """
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows(rows)
    return out.getvalue()
