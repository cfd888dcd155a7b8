"""`imgloc batch`: every map in a folder with every file of scans in another, nothing lost."""

import contextlib
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from imgloc.cli import options as opt
from imgloc.cli.command import Given, Only, Without
from imgloc.cli.console import FAILED_ROWS, LACKS, emit, instead, is_terminal, progress, say
from imgloc.doors import JOBS
from imgloc.errors import ConfigError
from imgloc.io.files import display, is_there
from imgloc.options import (
    NAMED,
    TOLERANCES,
    Bytes,
    Cell,
    Chosen,
    Known,
    Logs,
    Mounting,
    Options,
    Sure,
)
from imgloc.ranges import OneOf, Within, declared, option
from imgloc.texts import byte_count

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from imgloc.runs.jobs import Item, Job
    from imgloc.runs.opening import Means

_EVERY = 60.0  # seconds between lines of progress without a terminal
_GROUPS: Mapping[str, tuple[type, ...]] = {
    "scans": (Logs, Chosen, Mounting), "options": (Options,), "known": (Known,),
}  # fmt: skip
#: Which field of a job an option is for, if it is not called as the option.
_FIELDS = {
    field.flag: name
    for name, kinds in _GROUPS.items()
    for kind in kinds
    for field in declared(kind)
}


def batch(
    *,
    context: typer.Context,
    given: Given,
    maps: Path = option(
        ...,
        "Folder tree of maps (images without a YAML with --resolution), a map, or a CSV of pairs "
        "with the columns map,scans.",
        "MAPS",
        # A CSV here is one of pairs.
        parse=lambda path: (
            opt.find_file(path) if path.suffix.lower() == ".csv" else opt.find_map(path)
        ),
    ),
    out: Path = option(..., "Folder of the results.", metavar="DIR"),
    mounting: Mounting,
    reading: opt.MapSize,
    logs: Annotated[Logs, Without("fov")],
    chosen: Chosen,
    search: Annotated[Options, Only("method", "top", "theta_step", "max_speed", "max_turn")],
    known: Annotated[Known, Only("heading", "clearance")],
    scans: Path | None = option(None, "Folder tree of files of scans, or one file.", "[SCANS]"),
    job: Annotated[str, OneOf(*JOBS)] = option(
        "localize",
        "Command whose work is done with each map and file of scans.",
    ),
    cell: Cell = 0.1,
    tolerance: opt.ToleranceOf = TOLERANCES[-1],
    sure: Sure = NAMED,
    pictures: Annotated[str, OneOf("none", "doubtful", "all")] = option(
        "none", "Answers of which pictures are kept."
    ),
    workers: opt.Workers = None,
    dask: str | None = option(
        None,
        "Run on the Dask cluster at tcp://host:port, or on one that is started here: local. "
        "[default: processes of this machine]",
        metavar="ADDRESS",
    ),
    timeout: Annotated[float, Within(0.1, 1e7, "seconds")] = option(
        3600.0, "Seconds that one item may take."
    ),
    memory_limit: Bytes | None = option(
        None,
        "Memory that one worker may take, such as 512M or 2G. [default: its share of half of "
        "what is available]",
        parse=byte_count,
    ),
    resume: bool = option(False, "Go on with the results in DIR: what is done stays."),
    retry_failed: bool = option(False, "Go on with the results in DIR, and do failed items again."),
    dry_run: bool = option(False, "Only print what would be done."),
    as_json: opt.AsJson = False,
    kept: opt.Kept,
) -> None:
    """Run one job on every pair of map and scan file: one row each.

    DIR gets results.jsonl (a row for each item, whatever happens to it), summary.json, run.json and
    pictures. An item that fails, takes too long, or kills its worker costs itself alone; the exit
    code is then 5. An interrupted run goes on with --resume. Options of other jobs are
    refused. See also imgloc report, imgloc export.

    Examples
    --------
    imgloc batch floors --job check --out checked
    imgloc batch floors scans --out found --pictures doubtful
    imgloc batch floors scans --job which --out named --workers 8
    imgloc batch pairs.csv --out found --resume
    imgloc batch images scans --resolution 0.05 --out found --dask tcp://10.0.0.5:8786
    """
    many = opt.count_threads(workers)
    limits: dict[str, Any] = {"timeout": timeout, "memory_limit": memory_limit}
    pool = None if dask or dry_run else _pool(context, many, limits)
    from imgloc.cli import inputs
    from imgloc.model import to_json
    from imgloc.output.tables import batch_text
    from imgloc.runs.batch import find_items, run_batch
    from imgloc.runs.cluster import cluster
    from imgloc.runs.jobs import job_class

    kind = job_class(job)
    _refuse(given, job)
    offered: dict[str, Any] = {
        "maps": inputs.map_files(reading, many=True),
        "scans": inputs.as_recorded(logs, chosen, mounting, many=True),
        "options": replace(search, theta_step=None).stepped(search.theta_step),
        "cell": cell,
        "known": known,
        "tolerance": tolerance,
        "sure": sure,
        "pictures": pictures,
    }
    names = {field.name for field in fields(kind)}
    what = kind(**{name: value for name, value in offered.items() if name in names})
    means = _means(memory_limit, 0 if dask else many, kept)
    again = resume or retry_failed
    items = find_items(maps, scans, what, out=out)
    todo, said = _plan(items, what, out if again else None, retry_failed=retry_failed)
    (emit if dry_run else say)(said)
    if dry_run:
        return
    elsewhere = cluster(dask, workers=workers, **limits) if dask else contextlib.nullcontext()
    with elsewhere as there, _progress(todo) as advance:
        try:
            summary = run_batch(
                maps, scans, out, what, means=means, executor=there or pool, resume=again,
                retry_failed=retry_failed, items=todo,
                on_row=lambda row: advance(row["status"] != "ok"),
            )  # fmt: skip
        except KeyboardInterrupt:
            say(f"what is done is kept in {display(out)}; --resume goes on")
            raise
    text = instead(batch_text(summary, display(out)), context.meta[LACKS])
    emit(to_json(summary.as_row()) if as_json else text)
    if summary.failed:
        raise typer.Exit(FAILED_ROWS)


def _means(memory_limit: int | None, workers: int, kept: opt.Kept) -> "Means":
    """The means of each of so many workers; 0 of them are elsewhere, and know their own."""
    from imgloc.cli import inputs
    from imgloc.features.budget import MIB, default_budget
    from imgloc.output.drawings import DRAWINGS
    from imgloc.runs.opening import Means

    budget = memory_limit or (default_budget() // workers if workers else None)
    if budget is not None and budget < MIB:
        raise ConfigError(f"--memory-limit: got {budget} bytes, expected at least 1M")
    return Means(budget, inputs.kept_in(kept), DRAWINGS)


def _plan(
    items: "list[Item]", job: "Job", out: Path | None, *, retry_failed: bool
) -> "tuple[list[Item], str]":
    """The work that is left, beside the rows that are in `out` already, and this in words."""
    from imgloc.runs.batch import remaining
    from imgloc.runs.results import RESULTS, id_of, read_rows

    found = read_rows(out) if out is not None and is_there(out / RESULTS) else ()
    rows = {id_of(row): (row["key"], row["status"]) for row in found}
    todo = remaining(items, job, rows, retry_failed=retry_failed)
    maps = len({path for item in items for _, path in item.maps})
    files = len({item.scans_path for item in items if item.scans_path is not None})
    said = f"{len(items):,} items: {maps:,} maps, {files:,} files of scans"
    if len(todo) < len(items):
        said += f"; {len(items) - len(todo):,} are done"
    if anew := sum(rows.get(item.id, ("", ""))[1] == "ok" for item in todo):
        said += f"; {anew:,} were done with other options, files or versions, and are done anew"
    return todo, said


def _refuse(given: Given, job: str) -> None:
    """Refuse an option that is for other jobs alone."""
    from imgloc.runs.jobs import job_class

    def notices(kind: "type[Job]", flag: str) -> bool:
        name = _FIELDS.get(flag, flag.removeprefix("--").replace("-", "_"))
        return any(field.name == name for field in fields(kind))

    kinds = {name: job_class(name) for name in JOBS}
    of = {flag: [name for name, kind in kinds.items() if notices(kind, flag)] for flag in given}
    opt.refuse_others(given, {flag: theirs for flag, theirs in of.items() if theirs}, {job})


def _pool(context: typer.Context, workers: int, limits: dict[str, Any]) -> "Executor":
    """Workers of this machine until the command ends; one starts while the command does."""
    from imgloc.runs.workers import Supervised

    pool = Supervised(workers, module="imgloc.runs.batch", **limits)
    context.call_on_close(lambda: pool.shutdown(cancel_futures=True))
    return pool


@contextlib.contextmanager
def _progress(todo: "list[Item]") -> Iterator[Callable[[bool], None]]:
    """A bar with items/s and failures on a terminal; elsewhere a line a minute."""
    start = said = time.monotonic()
    done = failed = 0
    with progress("batch", len(todo), lines=False) as show:

        def advance(bad: bool) -> None:
            nonlocal done, failed, said
            failed, done, now = failed + bad, done + 1, time.monotonic()
            rate = done / max(now - start, 1e-3)
            show(so := f"{failed:,} failed, {rate:.2g} items/s")
            if now - said >= _EVERY and not is_terminal(sys.stderr):
                said, left = now, (len(todo) - done) / rate / 60
                say(f"{done:,} of {len(todo):,} items, {so}, {left:.0f} min left")

        yield advance
