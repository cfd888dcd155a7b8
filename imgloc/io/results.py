"""The folder that a batch writes: rows that are never lost, and nothing else touched.

``results.jsonl`` has a row for each item, appended and flushed to the disk before the next; of
several with one map and scan file the last counts. ``run.json`` says what decided them, and
``summary.json`` what they come to; ``pictures`` is beside them.
"""

import contextlib
import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import IO, Any

from imgloc.errors import OutputError
from imgloc.io.files import PathLike, display, reason, write_bytes_atomic, write_text_atomic

RESULTS, RUN, SUMMARY, PICTURES = "results.jsonl", "run.json", "summary.json", "pictures"
LOCK = ".imgloc-batch.lock"
_FORMAT = 1
_FOLDER = "folder of results of 'imgloc batch'"
#: what a row has, whatever became of its item
_KEYS = {"map", "scans", "status", "code", "message", "answers", "key", "version", "cost"}
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
                    f"{self.name}: holds results already; pass --resume to go on with them, or "
                    "another --out"
                )
            if before["job"] != about["job"]:
                raise OutputError(
                    f"{self.name}: holds results of the job {before['job']}, not of "
                    f"{about['job']}; expected another --out"
                )
            merged = {**before["parameters"], **about["parameters"]}
            about = {**about, "parameters": merged}
        elif os.path.lexists(self.folder / RUN):
            read_run(self.folder)  # a run that was stopped before its first row, or not ours
        elif os.path.lexists(self.folder / SUMMARY):
            raise OutputError(f"{self.name}: has a {SUMMARY} of others; expected another --out")
        text = json.dumps({"format": _FORMAT, **about}, indent=1, allow_nan=False) + "\n"
        write_text_atomic(self.folder / RUN, text, force=True)
        try:
            self._file = self.path.open("r+b" if self.path.exists() else "x+b", buffering=0)
        except OSError as e:
            raise self._failed(e) from None
        try:
            end = 0
            for line in _lines(self._file):
                if not line.endswith(b"\n"):
                    break  # a stop has torn it
                row = _parse(line, self._lines, self.name)
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
        if pictures:
            try:
                (self.folder / PICTURES).mkdir(exist_ok=True)
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
    """What decided the rows of a folder; OutputError if it is not one of a batch."""
    name = display(folder)
    try:
        about = json.loads((Path(folder) / RUN).read_bytes())
        if (
            isinstance(about, dict)
            and about.get("format") == _FORMAT
            and isinstance(about.get("parameters"), dict)
            and isinstance(about.get("job"), str)
        ):
            return about
    except FileNotFoundError:
        pass
    except (OSError, ValueError) as e:
        raise OutputError(f"{name}: {RUN} cannot be read: {reason(e)}") from None
    raise OutputError(f"{name}: no {RUN} of this version, expected a {_FOLDER}")


def read_summary(folder: PathLike) -> Row:
    """What the last run that came to its end said of the rows; empty if none has."""
    try:
        found = json.loads((Path(folder) / SUMMARY).read_bytes())
    except (OSError, ValueError):
        return {}
    return found if isinstance(found, dict) else {}


def read_rows(folder: PathLike) -> Iterator[Row]:
    """Rows of a folder, the last one of each item; what a stop has torn is left out.

    OutputError if there are none, or the file cannot be read.
    """
    name = display(folder)
    try:
        with (Path(folder) / RESULTS).open("rb") as file:
            last: dict[object, int] = {}
            for k, line in enumerate(_lines(file)):
                if line.endswith(b"\n"):
                    last[_beginning(line, k, name)] = k
            kept = set(last.values())
            for k, line in enumerate(_lines(file)):
                if k in kept:
                    yield _parse(line, k, name)
    except FileNotFoundError:
        raise OutputError(f"{name}: no {RESULTS}, expected a {_FOLDER}") from None
    except OSError as e:
        raise OutputError(f"{name}: {RESULTS} cannot be read: {reason(e)}") from None


def _beginning(line: bytes, k: int, name: str) -> object:
    """What tells the item of a row from others, without parsing a row as it was written."""
    head, status, _ = line.partition(b', "status": ')  # in a text the quote would be escaped
    return head if status and head.startswith(b'{"map": ') else id_of(_parse(line, k, name))


def _lines(file: IO[bytes]) -> Iterator[bytes]:
    """Lines from the first; the file may have no buffer of its own."""
    file.seek(0)
    with open(os.dup(file.fileno()), "rb") as buffered:  # noqa: PTH123
        yield from buffered


def _parse(line: bytes, k: int, name: str) -> Row:
    try:
        row = json.loads(line)
        if isinstance(row, dict) and row.keys() >= _KEYS:
            return row
    except ValueError:
        pass
    raise OutputError(f"{name}: {RESULTS}, line {k + 1}: no row of a batch; restore the file")


def _hold(path: Path, name: str) -> IO[bytes]:
    """Lock a file until it is closed, or the process has ended in whatever way."""
    try:
        file = path.open("a+b")
    except OSError as e:
        raise OutputError(f"{name}: results cannot be written: {reason(e)}") from None
    try:
        _lock(file)
    except OSError:
        with file:
            file.seek(0)
            pid = file.read(20).decode("ascii", "replace").strip()
        raise OutputError(
            f"{name}: another run writes here, process {pid}; wait for it, or choose another --out"
        ) from None
    file.truncate(0)
    file.write(b"%d\n" % os.getpid())
    file.flush()
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
