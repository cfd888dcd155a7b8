"""Every map with every file of scans: one row each, whatever happens to them.

>>> from tempfile import TemporaryDirectory
>>> from imgloc.io.maps import bundled_maps
>>> from imgloc.runs.jobs import make_job
>>> with TemporaryDirectory() as folder:
...     found = run_batch(bundled_maps() / "curved.yaml", None, f"{folder}/out", make_job("check"))
...     found.statuses
{'ok': 1}
"""

import contextlib
import csv
import logging
import os
import queue
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, Executor, Future
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2

from imgloc.__about__ import __version__
from imgloc.choice.choose import NO_MAP, names_of
from imgloc.errors import ConfigError, ImglocError, MapError, OutputError, ScanError
from imgloc.io.badlines import warned
from imgloc.io.contents import content_hash, files_of
from imgloc.io.files import PathLike, display, is_folder, is_there, read_file
from imgloc.io.folders import files_in, find_maps
from imgloc.io.images import IMAGE_ENDINGS, LOSSY_ENDINGS
from imgloc.io.mapyaml import YAML_ENDINGS
from imgloc.io.remote import beside, local
from imgloc.io.scans import SCAN_ENDINGS, why_no_scans
from imgloc.model import plain
from imgloc.runs.hints import Doubtful, hints_of
from imgloc.runs.jobs import Answer, Item, Job, hash_of, make_job
from imgloc.runs.localize import Localize
from imgloc.runs.opening import Means
from imgloc.runs.results import RESULTS, Results, Row, read_rows, read_summary
from imgloc.runs.workers import LOST, CrashError, OverdueError, Supervised

TIMEOUT = 3600.0  #: seconds that an item may take
ATTEMPTS = 2  #: how often an item is begun whose worker dies
_AT_ONCE = 512  # items that an executor is given beyond those that are done
_CODES = {MapError: "map", ScanError: "scan", ConfigError: "config", OutputError: "output"}
_MAX_PAIRS = 256 << 20  # bytes
_LOG = logging.getLogger("imgloc")
_OF_MAPS = (*IMAGE_ENDINGS, *LOSSY_ENDINGS, *YAML_ENDINGS)  # which may lie among scans, unsaid
_WARNED = 20  # different warnings that a run passes on


@dataclass
class BatchSummary:
    """The rows of a batch, counted."""

    items: int = 0
    statuses: dict[str, int] = field(default_factory=dict)
    verdicts: dict[str, int] = field(default_factory=dict)  #: of the answers of all scans
    known: int = 0  #: answers to scans whose pose is known
    hits: int = 0  #: of these, those that are right
    unique_wrong: int = 0  #: and those that are wrong, but ``unique``
    #: pairs of a map with a file that has poses, which hold for the map that the file is from
    pairs: int = 0
    files: int = 0  #: files with known poses
    #: why items failed: `status`, `code`, `message`, how many `items`, and the `first`
    failures: list[dict[str, Any]] = field(default_factory=list)
    #: what was warned of: the `warning` that came first for a file, and in how many `items`
    warnings: list[dict[str, Any]] = field(default_factory=list)
    hints: list[dict[str, Any]] = field(default_factory=list)  #: see :mod:`imgloc.runs.hints`
    _files: set[str] = field(default_factory=set)
    new: int = 0  #: rows that this run has added
    seconds: float = 0.0  #: what it took, all in all

    @property
    def failed(self) -> int:
        """Items without an answer."""
        return self.items - self.statuses.get("ok", 0)

    def as_row(self) -> Row:
        """The row of ``summary.json``."""
        return {name: value for name, value in vars(self).items() if name != "_files"}

    def add(self, row: Row) -> None:
        """Count a row."""
        self.items += 1
        if row["scans"] is not None and any("hit" in answer for answer in row["answers"]):
            self.pairs += 1
            self._files.add(row["scans"])
            self.files = len(self._files)
        self.statuses[row["status"]] = self.statuses.get(row["status"], 0) + 1
        name = f"{row['map']}" if row["scans"] is None else f"{row['scans']} on {row['map']}"
        if row["status"] != "ok":
            why = str(row["message"]).split(": ", 1)[-1]  # without the file, which comes first
            about = {"status": row["status"], "code": row["code"], "message": why}
            _count(self.failures, about, name)
        for text in row["cost"].get("warnings", ()):
            _count(self.warnings, {"warning": text}, name)
        for answer in row["answers"]:
            if "verdict" in answer:
                verdict = answer["verdict"]
                if "maps" in answer and verdict not in NO_MAP:
                    verdict = "named"  # `which` says a map
                self.verdicts[verdict] = self.verdicts.get(verdict, 0) + 1
            if "hit" in answer:
                self.known += 1
                self.hits += answer["hit"]
                self.unique_wrong += answer.get("verdict") == "unique" and not answer["hit"]


def _count(found: list[dict[str, Any]], about: Row, name: str) -> None:
    """Count an item of this name under the facts `about` it; a few kinds are kept, in order."""
    kind = next((kind for kind in found if about.items() <= kind.items()), None)
    if kind is not None:
        kind["items"] += 1
        kind["first"] = min(kind["first"], name)
    elif len(found) < _WARNED:
        found.append({**about, "items": 1, "first": name})
    found.sort(key=lambda kind: (-kind["items"], kind["first"]))


def run_batch(
    maps: PathLike, scans: PathLike | None, out: PathLike, job: Job | None = None, *,
    workers: int | None = None, executor: Executor | None = None, timeout: float | None = TIMEOUT,
    memory_limit: int | None = None, means: Means | None = None, resume: bool = False,
    retry_failed: bool = False, items: Sequence[Item] | None = None,
    on_row: Callable[[Row], None] | None = None,
) -> BatchSummary:  # fmt: skip
    """Do a job with every map and every file of scans, and write a row for each.

    Parameters
    ----------
    maps, scans : path
        As of :func:`find_items`.
    out : path
        Folder of the results, see :mod:`imgloc.runs.results`.
    job : Job, optional
        By default `localize`.
    workers : int, optional
        Processes of this machine; by default as many as it has processors.
    executor : concurrent.futures.Executor, optional
        Instead of them: whatever can call a function elsewhere. The limits below are its own.
    timeout, memory_limit : float and int, optional
        Seconds that an item may take, bytes that a worker may; None is without a limit.
    means : Means, optional
        What the workers have to work with.
    resume : bool
        Go on with results that are there: what has a row with the same contents, parameters and
        version is not done again; what has `failed`, with `retry_failed`, is.
    items : sequence of Item, optional
        Instead of what :func:`find_items` finds.
    on_row : callable
        Called with each new row once it is on the disk.

    Returns
    -------
    BatchSummary
        Of all rows in the folder. What goes wrong with an item is in its row.

    Raises
    ------
    ConfigError, OutputError
        If there is nothing to do, or the folder is not to be written to.

    Examples
    --------
    See the head of this module.
    """
    job, means, start = job or make_job(), means or Means(), time.monotonic()
    if means.memory_budget is None:  # an executor may know what each of its tasks can have
        means = replace(means, memory_budget=getattr(executor, "memory_share", None))
    found = list(find_items(maps, scans, job, out=out) if items is None else items)
    digest = job.digest
    about = {
        "imgloc": __version__,
        "job": job.name,
        "maps": display(maps),
        "scans": None if scans is None else display(scans),
        "parameters": {digest: job.parameters},
    }
    new, warned = 0, set[str]()
    with Results(out, about, resume=resume or retry_failed) as results:
        todo = remaining(found, job, results.known, retry_failed=retry_failed)
        with contextlib.ExitStack() as stack:
            if executor is None:
                count = workers or os.cpu_count() or 1
                executor = Supervised(count, timeout=timeout, memory_limit=memory_limit)
                stack.callback(executor.shutdown)
            try:
                for row, pictures in rows_of(todo, job, executor, means):
                    results.add(row, pictures)
                    new += 1
                    _warn(row["cost"].get("warnings", ()), warned)
                    if on_row is not None:
                        on_row(row)
                results.look()
                doubtful = Doubtful()
                rows = read_rows(out)
                summary = summarise(doubtful.noting(rows) if isinstance(job, Localize) else rows)
                if not todo:  # they are those of the run before
                    summary.hints = read_summary(out).get("hints", [])
                else:
                    summary.hints = hints_of(doubtful.of(found), job, executor, means)
            except BaseException:
                executor.shutdown(wait=False, cancel_futures=True)
                stack.pop_all()  # an interrupt does not wait for anybody
                raise
        summary.new, summary.seconds = new, round(time.monotonic() - start, 3)
        results.summarise(summary.as_row())
    return summary


def _warn(texts: Iterable[str], warned: set[str]) -> None:
    """Pass on what workers have warned of, once each."""
    for text in texts:
        if text not in warned and len(warned) <= _WARNED:
            warned.add(text)
            more = f"more warnings are in cost.warnings of the rows of {RESULTS}"
            _LOG.warning("%s", text if len(warned) <= _WARNED else more)


def summarise(rows: Iterable[Row]) -> BatchSummary:
    """Count rows."""
    summary = BatchSummary()
    for row in rows:
        summary.add(row)
    return summary


def remaining(
    items: Sequence[Item], job: Job, known: Mapping[tuple[str, str | None], tuple[str, str]], *,
    retry_failed: bool = False,
) -> list[Item]:  # fmt: skip
    """The items that have no row of the same key; `known` are keys and statuses of rows."""
    digest = job.digest

    def settled(item: Item) -> bool:
        key, status = known.get(item.id, ("", ""))
        done = status == "ok" if retry_failed else bool(key)
        return done and key == key_of(hashes_of(item), digest)

    return [item for item in items if not settled(item)]


def rows_of(
    items: Iterable[Item], job: Job, executor: Executor, means: Means
) -> Iterator[tuple[Row, dict[str, bytes]]]:
    """Rows of items as they are done, each with its pictures; whatever happens, one for each."""
    waiting, finished = iter(items), queue.SimpleQueue[Future[Any]]()
    running: dict[Future[Any], tuple[Item, int, float]] = {}

    def begin(item: Item, attempt: int) -> None:
        future = executor.submit(work, item, job, means)
        running[future] = item, attempt, time.monotonic()
        future.add_done_callback(finished.put)

    while True:
        while len(running) < _AT_ONCE and (item := next(waiting, None)) is not None:
            begin(item, 1)
        if not running:
            return
        try:
            future = finished.get(timeout=0.2)  # so that an interrupt is noticed
        except queue.Empty:
            continue
        item, attempt, begun = running.pop(future)
        try:
            row, pictures = future.result()
        except CancelledError:  # by nobody here: it has no answer, and needs another run
            raise OutputError(LOST) from None
        except BaseException as error:  # a worker that died; a cluster has exceptions of its own
            if attempt < ATTEMPTS:
                begin(item, attempt + 1)
                continue
            row, pictures = _lost(item, job, error), dict[str, bytes]()
            row["cost"]["seconds"] = round(time.monotonic() - begun, 3)
        row["cost"]["attempts"] = attempt
        yield row, pictures


def work(item: Item, job: Job, means: Means | None = None) -> tuple[Row, dict[str, bytes]]:
    """Do a job with an item, in a worker: its row and its pictures by their names."""
    start, means = time.perf_counter(), means or Means()
    row = _row(item, job)
    cost, pictures = row["cost"], dict[str, bytes]()
    with warned() as heard:
        try:
            kept, ms = list[Row](), list[float]()
            cost["ms"] = ms
            for answer in job.open(item, means.desk()):
                kept.append(_keep(answer, cost))
                ms += [] if answer.ms is None else [round(answer.ms, 3)]
                if job.pictures == "all" or (job.pictures == "doubtful" and answer.doubtful):
                    made = _drawn(item, answer, means)
                    pictures |= made
                    shown = [name for name in made if name.endswith(".png")]
                    kept[-1] |= {"pictures": shown} if shown else {}
                    page = next((name for name in made if name.endswith(".html")), None)
                    kept[-1] |= {} if page is None else {"page": page}
        except Exception as error:
            row["status"] = "failed"
            row["code"], row["message"] = _reason(error)
            cost.clear()
            pictures.clear()
        else:
            row["answers"] = plain(kept)
            cost |= plain(cost)
    cost |= {"warnings": list(heard)} if heard else {}
    cost["seconds"] = round(time.perf_counter() - start, 3)
    return row, pictures


def _keep(answer: Answer, cost: dict[str, Any]) -> Row:
    """The part of an answer that a row has; what two runs do not share goes to its cost."""
    row = {**answer.row, **answer.beside}
    for name in ("parameters", "timings_ms"):
        row.pop(name, None)
    if "cost" in row:
        cost["summary"] = row.pop("cost")
    return row


def _drawn(item: Item, answer: Answer, means: Means) -> dict[str, bytes]:
    """The pictures of an answer by their names, if there is something that draws them."""
    kind, *what = answer.drawn or ("",)
    if kind not in means.drawings:
        return {}
    made = means.drawings[kind](*what).items()
    stem = f"{picture_stem(item)}-{answer.index:04d}"
    return {f"{stem}-{name}{'' if '.' in name else '.png'}": data for name, data in made}


def _row(item: Item, job: Job) -> Row:
    hashes, digest = hashes_of(item), job.digest
    return {
        "map": item.map,
        "scans": item.scans,
        "status": "ok",
        "code": None,
        "message": None,
        "answers": [],
        "key": key_of(hashes, digest),
        "hashes": {**hashes, "parameters": digest},
        "version": __version__,
        "cost": {},
    }


def _lost(item: Item, job: Job, error: BaseException) -> Row:
    """The row of an item whose worker has died each time."""
    row = _row(item, job)
    row["status"], row["message"] = "crashed", " ".join(str(error).split()) or repr(error)
    if isinstance(error, OverdueError):
        row["status"] = "timeout"
    elif isinstance(error, CrashError):
        row["code"] = error.signal if error.signal is not None else error.code
        row["cost"]["last_words"] = error.last_words
    return row


def _reason(error: Exception) -> tuple[str, str]:
    """Code and message of what a job has raised."""
    message = " ".join(str(error).split())
    if isinstance(error, ImglocError):
        return next((c for kind, c in _CODES.items() if isinstance(error, kind)), "error"), message
    if isinstance(error, MemoryError) or (
        isinstance(error, cv2.error) and getattr(error, "code", 0) == cv2.Error.StsNoMem
    ):
        return "memory", "out of memory: a smaller map, or a larger `memory_limit`"
    return "internal", f"{type(error).__name__}: {message}"


def hashes_of(item: Item) -> dict[str, str | None]:
    """Hashes of what an item is made of; None for what cannot be read, or is not there."""
    paths = [file for _, path in item.maps for file in files_of(path)]
    scans = None if item.scans_path is None else content_hash((item.scans_path,))
    return {"map": content_hash(paths), "scans": scans}


def key_of(hashes: Mapping[str, str | None], parameters: str) -> str:
    """Key of a row: the same contents, parameters and version give the same row."""
    return hash_of([hashes["map"], hashes["scans"], parameters, __version__])


def picture_stem(item: Item) -> str:
    """Beginning of the names of an item's pictures: readable, and no other item's.

    Examples
    --------
    >>> picture_stem(Item("a/attic", "run 1.npz", ()))
    'a-attic--run-1.npz-63f19f06'
    """
    words = f"{item.map}--{item.scans or ''}"
    plainly = "".join(c if c.isascii() and (c.isalnum() or c in "-.") else "-" for c in words)
    return f"{plainly[:100]}-{hash_of(item.id)[:8]}"


def find_items(
    maps: PathLike, scans: PathLike | None, job: Job, *, out: PathLike | None = None
) -> list[Item]:
    """Every map with every file of scans, in the order of their names, by map.

    Parameters
    ----------
    maps : path
        A map, a folder tree of them (map_server YAML; with a resolution in the job's reading also
        images that no YAML names), or a CSV of pairs with the columns ``map`` and ``scans``,
        relative to itself.
    scans : path, optional
        A file of scans or a folder tree of them; none for jobs that look at maps alone, and with
        pairs.
    out : path, optional
        Nothing in this folder is looked at.

    Raises
    ------
    ConfigError
        If there is none, or scans are missing or of no use.
    MapError, ScanError
        If `maps` or `scans` leads nowhere.
    """
    maps, scans = local(maps, MapError), scans and local(scans)
    for path, error in ((maps, MapError), (scans, ScanError)):
        if path is not None and not is_there(path):
            raise error(f"{display(path)}: no such file or folder")
    if maps.suffix.lower() == ".csv":
        if scans is not None:
            found = "its pairs name the scans, expected no other file of scans"
            raise ConfigError(f"{display(maps)}: {found}")
        return _pairs(maps, job)
    if scans is not None and not job.with_scans:
        raise ConfigError(f"the job {job.name} looks at maps alone: expected no scans")
    if scans is None and job.with_scans:
        raise ConfigError(f"the job {job.name} needs scans: a file, or a folder of them")
    named_maps = list(_maps_in(maps, job, out))
    named_scans = [(None, None)] if scans is None else list(_scans_in(Path(scans), out))
    for named in (named_maps, named_scans):
        _check_names([name for name, _ in named])
    groups = [(display(maps.resolve().name), tuple(named_maps))]
    if not job.all_maps:
        groups = [(name, ((name, path),)) for name, path in named_maps]
    return [Item(name, s, some, path) for name, some in groups for s, path in named_scans]


def _check_names(names: Sequence[str | None]) -> None:
    """Refuse two files that are shown by one name, which rows and `resume` would confuse."""
    for name, count in Counter(names).items():
        if count > 1:
            raise ConfigError(
                f"{name}: {count} files are shown by this name, as it stands for letters that "
                "cannot be printed; expected other names"
            )


def _maps_in(maps: Path, job: Job, out: PathLike | None) -> Iterator[tuple[str, Path]]:
    if not is_folder(maps):
        yield display(maps.name), maps.absolute()
        return
    found = find_maps(maps, images=job.maps.reading.get("resolution") is not None, aside=out)
    for name, path in zip(names_of(found, maps), found, strict=True):
        yield display(name), path.absolute()


def _scans_in(scans: Path, out: PathLike | None) -> Iterator[tuple[str, Path]]:
    if not is_folder(scans):
        yield display(scans.name), scans.absolute()
        return
    # Beside a map there may be what was calibrated for it.
    files = [p for p in files_in(scans, out) if not p.name.endswith(".calibration.json")]
    why = {path: why_no_scans(path) for path in files}
    left, found = defaultdict[str, list[str]](list), [path for path in files if not why[path]]
    for path in files:
        if why[path] and path.suffix.lower() not in _OF_MAPS:
            left[why[path]].append(display(path.name))
    for reason, names in left.items():
        more = f" and {len(names) - 1:,} more" if names[1:] else ""
        _LOG.warning("%s: left out %s%s: %s", display(scans), names[0], more, reason)
    if not found:
        raise ConfigError(f"{display(scans)}: no scans, expected {', '.join(SCAN_ENDINGS)}")
    for path in found:
        yield display(path.relative_to(scans).as_posix()), path.absolute()


def _pairs(path: Path, job: Job) -> list[Item]:
    name = display(path)
    if job.all_maps:
        raise ConfigError(f"{name}: the job {job.name} compares all maps of a folder, expected one")
    data = read_file(path, limit=_MAX_PAIRS, error=ConfigError, what="CSV of pairs")
    reader = csv.DictReader(data.decode("utf-8-sig", "surrogateescape").splitlines())
    columns = {"map", "scans"} if job.with_scans else {"map"}
    try:
        there, rows = reader.fieldnames or (), [(reader.line_num, row) for row in reader]
    except csv.Error as error:
        line = reader.line_num + 1
        raise ConfigError(f"{name}: line {line}: {error}, expected map,scans") from None
    if not columns <= set(there):
        found = ", ".join(there) or "nothing"
        raise ConfigError(f"{name}: got the columns {found}, expected map,scans")
    items: dict[tuple[str, str | None], Item] = {}
    for line, row in rows:
        map_name, scans = row["map"], (job.with_scans and row.get("scans")) or None
        if not map_name or (scans is None and job.with_scans):
            raise ConfigError(f"{name}: line {line}: expected a map and scans")
        at = beside(path, map_name, MapError)
        taken = None if scans is None else beside(path, scans, ScanError)
        item = Item(display(map_name), None if scans is None else display(scans),
                    ((display(map_name), at),), taken)  # fmt: skip
        if items.setdefault(item.id, item) != item:
            _check_names([item.map if scans is None else item.scans] * 2)
    if not items:
        raise ConfigError(f"{name}: no pair, expected a line for each")
    return sorted(items.values(), key=lambda item: (item.map, item.scans or ""))
