"""Scans that are still being recorded: lines from a pipe, or from a file that grows."""

import io
import logging
import os
import re
import stat
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import BinaryIO

from imgloc.errors import ScanError
from imgloc.io.carmen import CarmenLines
from imgloc.io.files import display, is_there, open_regular, reason
from imgloc.io.scanset import ScanSet
from imgloc.io.textscans import MAX_LINE, read_jsonl_line

_LOG = logging.getLogger("imgloc")
_JSON = re.compile(rb"(?:\xef\xbb\xbf)?\s*\{")
_CARMEN = re.compile(
    rb"(?:\s*#[^\n]*\n)*\s*"
    rb"(?i:# ?CARMEN|(?:PARAM|ODOM|SYNC|[FR]LASER|ROBOTLASER\d|Odometry|Laser)\b)"
)
_PAUSE = 0.05  # seconds between two looks at the end of a file


def is_pipe(path: Path) -> bool:
    """Return whether a path is a named pipe."""
    try:
        return stat.S_ISFIFO(path.stat().st_mode)
    except (OSError, ValueError):
        return False


def comes_in_lines(stream: BinaryIO) -> bool:
    """Return whether a stream is to be read line by line, by the beginning; it is not consumed.

    So are JSON lines, and a CARMEN log that comes through a pipe: of one that is there as a whole
    more is known.
    """
    head = stream.peek(1) if isinstance(stream, io.BufferedReader) else b""
    if _JSON.match(head):
        return True
    return bool(_CARMEN.match(head)) and not stat.S_ISREG(os.fstat(stream.fileno()).st_mode)


def scans_of(
    lines: Iterator[bytes], name: str, *, topic: str | None = None, fov: float | None = None,
    max_bad: float = 0.0,
) -> Iterator[tuple[float, ScanSet]]:  # fmt: skip
    """Each scan of JSON lines or a CARMEN log, as soon as its line is there, and when that was.

    Times are those of :func:`time.perf_counter`. Lines are those of
    :func:`~imgloc.io.textscans.read_jsonl` or, by the first one, of
    :class:`~imgloc.io.carmen.CarmenLines`; blank ones are left out, as is a last one that ends in
    the middle. Any other line is broken: it is left out with a warning, or a ScanError with
    its number if more than a share of the lines so far are.

    Parameters
    ----------
    lines : iterator of bytes
    name : str
        What error messages call the source.
    topic, fov : str, float
        As of :func:`~imgloc.io.carmen.read_carmen`.
    max_bad : float
        Share of the lines so far, 0 to 1, that may be broken.
    """
    take: Callable[[str, str], ScanSet | None] | None = None
    bad = 0
    for number, line in enumerate(lines, 1):
        now, where = time.perf_counter(), f"{name}: line {number}"
        try:
            text = _text_of(line, where, first=number == 1)
            if not text:
                continue
            if take is None and _CARMEN.match(text.encode()):
                take = CarmenLines(topic, fov).take
            take = take or partial(read_jsonl_line, topic=topic)
            scan = take(text, where)
        except ScanError as error:
            if take is not None and not line.endswith(b"\n") and len(line) <= MAX_LINE:
                return
            bad += 1
            if take is None or bad > max_bad * number:
                raise
            _LOG.warning("%s; the line is left out", error)
            continue
        if scan is not None:
            yield now, scan


def _text_of(line: bytes, where: str, *, first: bool) -> str:
    """The text of a line; a ScanError if it is too long, or none."""
    if len(line) > MAX_LINE:
        raise ScanError(f"{where}: expected at most {MAX_LINE:,} characters for a scan")
    try:
        return line.decode("utf-8-sig" if first else "utf-8").strip()
    except UnicodeDecodeError as e:
        raise ScanError(f"{where}: byte {e.start} is not UTF-8 text") from None


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
    return os.fdopen(open_regular(path, ScanError, "log of lines"), "rb")


def _is_other(file: BinaryIO, path: Path) -> bool:
    here, there = os.fstat(file.fileno()), path.stat()
    return (here.st_dev, here.st_ino) != (there.st_dev, there.st_ino) or there.st_size < file.tell()
