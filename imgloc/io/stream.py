"""Scans that are still being recorded: JSON lines from a pipe, or from a file that grows."""

import io
import os
import stat
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO

from imgloc.errors import ScanError
from imgloc.io.files import display, is_there, open_regular, reason
from imgloc.io.scanset import ScanSet
from imgloc.io.textscans import MAX_LINE, read_jsonl_line

_PAUSE = 0.05  # seconds between two looks at the end of a file


def is_pipe(path: Path) -> bool:
    """Whether a path is a named pipe."""
    try:
        return stat.S_ISFIFO(path.stat().st_mode)
    except (OSError, ValueError):
        return False


def begins_as_json(stream: BinaryIO) -> bool:
    """Whether the next thing in a stream is an object of JSON; nothing is taken from it."""
    head = stream.peek(1) if isinstance(stream, io.BufferedReader) else b""
    return head.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"{")


def scans_of(lines: Iterator[bytes], name: str) -> Iterator[tuple[float, ScanSet]]:
    """Each scan of JSON lines, as soon as its line is there, with the time when that was.

    Times are those of :func:`time.perf_counter`. Lines are those of
    :func:`~imgloc.io.textscans.read_jsonl`; blank ones are left out, as is a last one that ends in
    the middle. Any other line is a ScanError that says its number.
    """
    for number, line in enumerate(lines, 1):
        now, where = time.perf_counter(), f"{name}: line {number}"
        if len(line) > MAX_LINE:
            raise ScanError(f"{where}: expected at most {MAX_LINE:,} characters for a scan")
        try:
            text = line.decode("utf-8-sig" if number == 1 else "utf-8").strip()
        except UnicodeDecodeError as e:
            raise ScanError(f"{where}: byte {e.start} is not UTF-8 text") from None
        if not text:
            continue
        try:
            scan = read_jsonl_line(text, where)
        except ScanError:
            if not line.endswith(b"\n"):
                return
            raise
        yield now, scan


def lines_of(stream: BinaryIO) -> Iterator[bytes]:
    """The lines of a stream as they come, those that are too long cut."""
    return iter(lambda: stream.readline(MAX_LINE + 1), b"")


def piped(path: Path) -> Iterator[bytes]:
    """The lines of a named pipe, until all who write to it have closed it."""
    try:
        with path.open("rb") as file:
            yield from lines_of(file)
    except OSError as e:
        raise ScanError(f"{display(path)}: cannot be read: {reason(e)}") from None


def growing(path: Path, ended: Callable[[], bool]) -> Iterator[bytes]:
    """The lines of a file from its beginning, and those that are added, until it has `ended`.

    A file that is replaced by another of its name, or made shorter, is begun again; one that is
    gone is waited for. What is not a whole line yet is waited for, too.
    """
    file, rest = _opened(path), b""
    try:
        while not ended():
            part = file.readline(MAX_LINE + 1)
            rest += part
            if rest.endswith(b"\n") or len(rest) > MAX_LINE:
                yield rest
                rest = b""
            elif not part:
                time.sleep(_PAUSE)
                if is_there(path) and _is_other(file, path):
                    file.close()
                    file, rest = _opened(path), b""
    finally:
        file.close()


def _opened(path: Path) -> BinaryIO:
    return os.fdopen(open_regular(path, ScanError, "log of JSON lines"), "rb")


def _is_other(file: BinaryIO, path: Path) -> bool:
    here, there = os.fstat(file.fileno()), path.stat()
    return (here.st_dev, here.st_ino) != (there.st_dev, there.st_ino) or there.st_size < file.tell()
