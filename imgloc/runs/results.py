"""The folder that a batch writes: rows that are never lost, and nothing else touched.

``results.jsonl`` has a row for each item, appended and flushed to the disk before the next; of
several with one map and scan file the last counts. ``run.json`` has what decided them, and
``summary.json`` what they come to; ``pictures`` is beside them.
"""

import contextlib
import itertools
import json
import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import IO, Any

from imgloc.errors import ConfigError, OutputError
from imgloc.io.files import (
    PathLike,
    display,
    open_regular,
    reason,
    write_bytes_atomic,
    write_text_atomic,
)
from imgloc.io.own import parse_json, read_json, same_file

RESULTS, RUN, SUMMARY, PICTURES = "results.jsonl", "run.json", "summary.json", "pictures"
LOCK = ".imgloc-batch.lock"
_FORMAT = 1
_FOLDER = "folder of results of 'imgloc batch'"
_LOCKED = "lock of a batch"
_BEGINNING = b'{"map": '  # of a row as it is written
_MAX_ABOUT = 16 << 20  # bytes of run.json, and of summary.json
_MAX_ROW = 1 << 30  # bytes of a row: a scan takes two thousand
_PART = 1 << 20  # bytes of a row that are read at a time
_HELD = re.compile(rb"(\d{1,20}\n)?")
_MAYBE = (float, None)
_POSE = {"x": float, "y": float, "theta": float}
#: of a picture, within the folder of pictures: another place would be taken into a page
_PICTURE = re.compile(r"[\w.-]+\.png", re.ASCII)
_PAGE = re.compile(r"[\w.-]+\.html", re.ASCII)  # beside them, explains an answer
_ANSWER = {
    "verdict?": str, "pictures?": [_PICTURE], "page?": _PAGE, "truth?": _POSE, "hit?": bool,
    "error?": {"position": _MAYBE, "heading": _MAYBE},
}  # fmt: skip
_HYPOTHESIS = {
    **_POSE, "mass": _MAYBE, "log_likelihood": _MAYBE, "covariance": [[_MAYBE] * 3] * 3,
}  # fmt: skip
_EVIDENCE = {
    "misfit": _MAYBE, "temperature": _MAYBE, "readings": int, "found": int, "scale?": float,
    "thinner?": float, "bent?": float, "floor?": _MAYBE, "floor_distance?": _MAYBE,
    "floor_direction?": _MAYBE,
}  # fmt: skip
#: what the answers of each job have, of that which a page, a table or a summary looks at
_ANSWERS: Mapping[str, Mapping[str, Any]] = {
    "localize": {
        **_ANSWER, "index": int, "verdict": str, "hypotheses": [_HYPOTHESIS],
        "evidence": _EVIDENCE, "explained": _MAYBE, "entropy": _MAYBE, "elsewhere": _MAYBE,
        "complete": bool, "protection?": [{"share": float, "metres": _MAYBE, "radians": _MAYBE}],
    },
    "which": {
        **_ANSWER, "index": int, "verdict": str, "none": _MAYBE,
        "maps": [{"map": str, "probability": _MAYBE}],
    },
    "check": {
        **_ANSWER, "width": int, "height": int, "resolution": _MAYBE, "free_area": _MAYBE,
        "warnings": [{"code": str}],
    },
}  # fmt: skip
#: what a row has, whatever became of its item; and by the job
_ROW: Mapping[str, Any] = {
    "map": str, "scans": (str, None), "message": (str, None), "code": (str, int, None),
    "status": frozenset({"ok", "failed", "crashed", "timeout"}), "key": str, "version": str,
    "answers": [{str: object}],
    "hashes?": {"map": (str, None), "scans": (str, None), "parameters": str},
    "cost": {"seconds?": float, "attempts?": int, "ms?": [float]},
}  # fmt: skip
_ROWS = {job: {**_ROW, "answers": [answer]} for job, answer in _ANSWERS.items()}
_RUN: Mapping[str, Any] = {
    "job": str,
    "maps?": str,
    "scans?": (str, None),
    "parameters": {str: {str: object}},
}
_SUMMARY = {"hints?": [{"hint": str, "items": int, "of": int, "first": [str]}]}
Row = dict[str, Any]
Id = tuple[str, str | None]


def id_of(row: Mapping[str, Any]) -> Id:
    """Which item a row is of."""
    return row["map"], row["scans"]


class Results:
    """A folder of results, held by one run at a time.

    Parameters
    ----------
    folder : path
        Made if it does not exist, but not what it is in.
    about : mapping
        What decides the rows, as plain values: the ``job``, and the ``parameters`` by their hash.
    resume : bool
        Whether the folder may hold results already; they stay.

    Raises
    ------
    OutputError
        If it holds results and is not to be gone on with, or those of another job; if another run
        holds it, whose process is named; if it cannot be written.
    """

    def __init__(self, folder: PathLike, about: Mapping[str, Any], *, resume: bool = False) -> None:
        self.folder, self.name = Path(folder), display(folder)
        self.path = self.folder / RESULTS
        #: key and status of the last row of each item
        self.known: dict[Id, tuple[str, str]] = {}
        self._lines = 0
        try:
            self.folder.mkdir(exist_ok=True)
        except FileNotFoundError:
            parent = display(self.folder.parent)
            raise OutputError(f"{self.name}: there is no folder {parent}") from None
        except FileExistsError:
            raise OutputError(f"{self.name}: is a file, expected a folder to write to") from None
        except OSError as e:
            raise self._failed(e) from None
        self._lock = _hold(self.folder / LOCK, self.name)
        try:
            self._open(about, resume)
        except BaseException:
            self._lock.close()
            raise

    def _open(self, about: Mapping[str, Any], resume: bool) -> None:
        if os.path.lexists(self.path):
            before = read_run(self.folder)
            if not resume:
                raise OutputError(
                    f"{self.name}: contains results already; pass `resume=True` to go on with "
                    "them, or another `out`"
                )
            if before["job"] != about["job"]:
                raise OutputError(
                    f"{self.name}: contains results of the job {before['job']}, not of "
                    f"{about['job']}; expected another `out`"
                )
            merged = {**before["parameters"], **about["parameters"]}
            about = {**about, "parameters": merged}
        elif os.path.lexists(self.folder / RUN):
            read_run(self.folder)  # a run that was stopped before its first row, or not ours
        elif os.path.lexists(self.folder / SUMMARY):
            raise OutputError(
                f"{self.name}: has a {SUMMARY} of another program; expected another `out`"
            )
        text = json.dumps({"format": _FORMAT, **about}, indent=1, allow_nan=False) + "\n"
        write_text_atomic(self.folder / RUN, text, force=True)
        fd = open_regular(self.path, OutputError, "file of rows", follow=False, write=True)
        self._file = os.fdopen(fd, "r+b", buffering=0)
        try:
            end = 0
            for line in _lines(self._file, self.name):
                if not line.endswith(b"\n"):  # a stop has torn it, or somebody else has written it
                    if line[: len(_BEGINNING)] != _BEGINNING[: len(line)]:
                        raise _no_row(self.name, self._lines, "not the beginning of one")
                    break
                row = _parse(line, self._lines, self.name, about["job"])
                self.known[id_of(row)] = row["key"], row["status"]
                end += len(line)
                self._lines += 1
            self._file.truncate(end)
            self._file.seek(end)
        except BaseException as e:
            self._file.close()
            raise self._failed(e) if isinstance(e, OSError) else e from None

    def __enter__(self) -> "Results":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, _e: BaseException | None, _t: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                self._compact()
        finally:
            self._file.close()
            self._lock.close()

    def add(self, row: Row, pictures: Mapping[str, bytes]) -> None:
        """Append a row, after its pictures are there; then neither can be lost."""
        self.look()
        if pictures:
            try:
                _pictures(self.folder).mkdir(exist_ok=True)
            except OSError as e:
                raise self._failed(e) from None
            for name, data in pictures.items():
                write_bytes_atomic(self.folder / PICTURES / name, data, force=True)
        line = json.dumps(row, allow_nan=False).encode() + b"\n"
        start = self._file.tell()
        try:
            rest = memoryview(line)
            while rest:
                rest = rest[self._file.write(rest) :]
            os.fsync(self._file.fileno())
        except OSError as e:
            with contextlib.suppress(OSError):
                self._file.truncate(start)  # half a row is none
            raise self._failed(e) from None
        self.known[id_of(row)] = row["key"], row["status"]
        self._lines += 1

    def look(self) -> None:
        """Raise an OutputError if the folder has been deleted or moved: rows would go nowhere."""
        if not same_file(self._file.fileno(), self.path):
            raise OutputError(
                f"{self.name}: {RESULTS} has been deleted or moved while a batch writes it; "
                "put it back, and `resume=True` goes on"
            )

    def summarise(self, summary: Mapping[str, Any]) -> None:
        """Write what the rows come to."""
        text = json.dumps(summary, indent=1, allow_nan=False) + "\n"
        write_text_atomic(self.folder / SUMMARY, text, force=True)

    def _compact(self) -> None:
        """Leave one row of each item, if there are more."""
        if self._lines == len(self.known):
            return
        rows = (json.dumps(row, allow_nan=False) + "\n" for row in read_rows(self.folder))
        write_text_atomic(self.path, "".join(rows), force=True)

    def _failed(self, error: OSError) -> OutputError:
        return OutputError(f"{self.name}: results cannot be written: {reason(error)}")


def read_run(folder: PathLike) -> Row:
    """The run that decided the rows of a folder; OutputError if it is damaged.

    ConfigError if the folder is not one of a batch.
    """
    path = Path(folder) / RUN
    if not os.path.lexists(path):
        missing = f"no {RUN}" if os.path.lexists(folder) else "no such folder"
        raise ConfigError(f"{display(folder)}: {missing}, expected a {_FOLDER}")
    about = read_json(path, _RUN, limit=_MAX_ABOUT, what=RUN, version=_FORMAT)
    return {"maps": "", "scans": None, **about}


def read_summary(folder: PathLike) -> Row:
    """The summary by the last run that came to its end; empty if none has.

    OutputError if it is not what a batch has written.
    """
    path = Path(folder) / SUMMARY
    if not os.path.lexists(path):
        return {}
    return read_json(path, _SUMMARY, limit=_MAX_ABOUT, what=SUMMARY)


def read_rows(folder: PathLike) -> Iterator[Row]:
    """Rows of a folder, the last one of each item; what a stop has torn is left out.

    Each has the keys of :data:`_ROWS`. OutputError if the file cannot be read, ConfigError if there
    is none.
    """
    name, path = display(folder), Path(folder) / RESULTS
    if not os.path.lexists(path):
        raise ConfigError(f"{name}: no {RESULTS}, expected a {_FOLDER}")
    job = read_run(folder)["job"]
    try:
        with os.fdopen(open_regular(path, OutputError, "file of rows"), "rb") as file:
            last: dict[object, int] = {}
            for k, line in enumerate(_lines(file, name)):
                if line.endswith(b"\n"):
                    last[_beginning(line, k, name, job)] = k
            kept = set(last.values())
            for k, line in enumerate(_lines(file, name)):
                if k in kept:
                    yield _parse(line, k, name, job)
    except OSError as e:
        raise OutputError(f"{name}: {RESULTS} cannot be read: {reason(e)}") from None


def read_picture(folder: PathLike, name: str, limit: int) -> bytes | None:
    """A picture of a row, of at most `limit` bytes; None if it is not there.

    OutputError if it is a link, or lies in one: that would lead to files of others.
    """
    path = _pictures(Path(folder)) / name
    if not os.path.lexists(path):
        return None
    with os.fdopen(open_regular(path, OutputError, "picture", follow=False), "rb") as file:
        return file.read(limit)


def _pictures(folder: Path) -> Path:
    """The folder of the pictures; OutputError if it is a link to another."""
    path = folder / PICTURES
    if path.is_symlink():
        raise OutputError(f"{display(path)}: is a link, expected a folder of pictures")
    return path


def _beginning(line: bytes, k: int, name: str, job: str) -> object:
    """A key of the item of a row, without parsing a row as it was written."""
    head, status, _ = line.partition(b', "status": ')  # in a text the quote would be escaped
    return head if status and head.startswith(_BEGINNING) else id_of(_parse(line, k, name, job))


def _lines(file: IO[bytes], name: str) -> Iterator[bytes]:
    """Lines from the first; the file may have no buffer of its own."""
    file.seek(0)
    with open(os.dup(file.fileno()), "rb") as buffered:  # noqa: PTH123
        for k in itertools.count():
            parts = list[bytes]()
            while not (parts and parts[-1].endswith(b"\n")) and (part := buffered.readline(_PART)):
                parts.append(part)
                if len(parts) * _PART > _MAX_ROW or b"\0" in part:  # a hole is endless zeros
                    raise _no_row(name, k, "too long, or no text")
            if not parts:
                return
            yield b"".join(parts)


def _parse(line: bytes, k: int, name: str, job: str) -> Row:
    try:
        row: Row = parse_json(line, _ROWS.get(job, _ROW))
    except ValueError as e:
        raise _no_row(name, k, reason(e)) from None
    return row


def _no_row(name: str, k: int, why: str) -> OutputError:
    return OutputError(
        f"{name}: {RESULTS}, line {k + 1}: no row of a batch ({why}); restore the file"
    )


def _hold(path: Path, name: str) -> IO[bytes]:
    """Lock a file until it is closed, or the process has ended in whatever way."""
    # Not filelock's: the number of the process that holds it, and the refusal of a file that is
    # something else, which are most of this, would stay.
    fd = open_regular(path, OutputError, _LOCKED, follow=False, write=True)
    file = os.fdopen(fd, "r+b", buffering=0)
    try:
        try:
            _lock(file)
            taken = False
        except OSError:
            taken = True
        file.seek(0)
        held = file.read(22)
        if not _HELD.fullmatch(held):
            raise OutputError(f"{display(path)}: is no {_LOCKED}, and stays as it is; remove it")
        if taken:
            pid = held.decode().strip()
            raise OutputError(
                f"{name}: another run writes here, process {pid}; wait for it, or choose another "
                "`out`"
            )
        file.seek(0)
        file.truncate(0)
        file.write(b"%d\n" % os.getpid())
    except BaseException as e:
        file.close()
        if isinstance(e, OSError):
            raise OutputError(f"{name}: results cannot be written: {reason(e)}") from None
        raise
    return file


def _lock(file: IO[bytes]) -> None:
    """Raise an OSError if another process has it."""
    try:
        import fcntl
    except ImportError:  # Windows: bytes beyond the end, so that the first can be read
        import msvcrt

        file.seek(1 << 30)
        msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]
    else:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
