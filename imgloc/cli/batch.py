"""`imgloc batch`: every map of a folder with every file of scans of another, nothing lost."""

import contextlib
import math
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from imgloc.cli import options as opt
from imgloc.cli.console import bar_of, emit, say
from imgloc.cli.options import flag, option
from imgloc.errors import ConfigError
from imgloc.io.files import display, is_there

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from imgloc.runs.jobs import Item

FAILED_ROWS = 5
_EVERY = 60.0  # seconds between lines of progress without a terminal
JobName = StrEnum("JobName", ("LOCALIZE", "EVALUATE", "CHECK", "WHICH", "ATLAS"))
Pictures = StrEnum("Pictures", ("NONE", "DOUBTFUL", "ALL"))


_SCANS = ("localize", "which", "evaluate with SCANS")
_SIMULATED = ("evaluate without SCANS", "atlas")
_EVALUATE = ("evaluate with SCANS", "evaluate without SCANS")
#: Of which jobs options are that others would not notice.
_OF = {
    **dict.fromkeys(("method", "theta_step_deg", "tolerance"), ("localize", *_EVALUATE)),
    **dict.fromkeys(("index", "sample", "sample_seed"), _SCANS),
    **dict.fromkeys(("topic", "range_scale", "range_max", "sensor", "flipped"), _SCANS),
    **dict.fromkeys(("rays", "fov_deg", "sigma", "outliers", "dropped", "mount"), _SIMULATED),
    **dict.fromkeys(("reach", "seed"), _SIMULATED),
    **dict.fromkeys(("step", "headings"), ("atlas",)),
    **dict.fromkeys(("top", "near"), ("localize",)),
    "heading": ("localize", "which"),
    "clearance": ("localize", "which", *_SIMULATED),
    "sure": ("which",),
    "count": ("evaluate without SCANS",),
    "cell": ("localize", "which", *_EVALUATE, "atlas"),
    "pictures": ("localize", "which", "check", "atlas"),
}  # fmt: skip


@opt.with_options(opt.mounting, opt.reading, opt.sensor, opt.chosen, opt.console)
def batch(
    context: typer.Context,
    maps: Annotated[
        Path,
        typer.Argument(
            metavar="MAPS",
            # A CSV here is one of pairs.
            callback=lambda path: path if path.suffix.lower() == ".csv" else opt.find_map(path),
            help="Folder tree of maps (images without a YAML with --resolution), a map, or a CSV "
            "of pairs with the columns map,scans.",
        ),
    ],
    out: Annotated[Path, option(..., "DIR", "Folder of the results.", show_default=False)],
    mounting: opt.Mounting,
    reading: "opt.Reading",
    sensor: "opt.Sensor",
    chosen: "opt.Chosen",
    scans: Annotated[
        Path | None,
        typer.Argument(metavar="[SCANS]", help="Folder tree of files of scans, or one."),
    ] = None,
    job: JobName = typer.Option(JobName.LOCALIZE, help="Whose work is done with each."),
    method: opt.MethodName = typer.Option(opt.MethodName.FUSED, help="As of localize, evaluate."),
    top: opt.Top = None,
    cell: opt.Cell = 0.1,
    theta_step_deg: opt.StepDeg = None,
    near: Any = opt.NEAR,
    heading: Any = opt.HEADING,
    topic: str | None = option(None, "NAME", "Of logs with several lasers, this one."),
    range_scale: float = opt.RANGE_SCALE,
    range_max: opt.Cut = None,
    tolerance: str | None = option(
        None, "M,DEG", "How near a known pose is a hit. [default: 0.5,10]"
    ),
    sure: float = option(
        0.5, "P", "For which: probability a map needs.", within=(0.5, 1, "a probability")
    ),
    count: int = option(100, "N", "For evaluate without SCANS: scans simulated.", "-n", min=1),
    seed: opt.Seed = 0,
    step: float = option(
        0.5, "M", "For atlas: metres between places.", within=(0.02, 1000, "metres")
    ),
    headings: int = option(4, "K", "For atlas: headings at each place.", min=1, max=72),
    reach: opt.Reach = 30.0,
    pictures: Pictures = typer.Option(Pictures.NONE, help="Of which answers pictures are kept."),
    workers: int | None = option(
        None, "N", "Processes; no row depends on it. [default: all processors]", min=1
    ),
    dask: str | None = option(
        None, "ADDRESS", "Run on a Dask cluster, tcp://host:port, or one started here: local."
    ),
    timeout: float = option(
        3600.0, "S", "Seconds that an item may take.", within=(0.1, 1e7, "seconds")
    ),
    memory_limit: Any = option(
        None,
        "BYTES",
        "What a worker may take, such as 512M or 2G. [default: its share of half of what is "
        "available]",
        parser=opt.byte_count,
    ),
    resume: bool = flag("--resume", "Go on with the results in DIR: what is done stays."),
    retry_failed: bool = flag("--retry-failed", "Go on, and do what has failed again."),
    fail_fast: bool = flag("--fail-fast", "Stop at the first item that fails."),
    dry_run: bool = flag("--dry-run", "Only say what would be done."),
    as_json: opt.AsJson = False,
    no_cache: bool = flag("--no-cache", "Prepare the maps anew and keep nothing."),
    allow_lossy: opt.AllowLossy = False,
) -> None:
    """Do a command's work with every map and every file of scans: one row each.

    DIR gets results.jsonl (a row for each item, whatever happens to it), summary.json, run.json and
    pictures. An item that fails, takes too long, or kills its worker costs itself alone; the exit
    code is then 5. An interrupted run goes on with --resume. An option that is of other jobs alone
    is refused. See also imgloc report, imgloc export.
    """
    given = _given(context, job.value, scans is not None, maps)
    many = opt.count_threads(workers)
    pool = None if dask or dry_run else _pool(context, many, timeout, memory_limit)
    from imgloc.cli import inputs
    from imgloc.features.budget import MIB, default_budget
    from imgloc.model import to_json
    from imgloc.options import TOLERANCES, Options
    from imgloc.output.drawings import DRAWINGS
    from imgloc.output.tables import batch_text
    from imgloc.runs.batch import find_items, remaining, run_batch
    from imgloc.runs.jobs import Job
    from imgloc.search.priors import Known

    opt.check_known(near, heading)
    # Of simulated robots a clearance is another matter.
    cleared = "clearance" in given and job in (JobName.LOCALIZE, JobName.WHICH)
    angle = None if theta_step_deg is None else math.radians(theta_step_deg)
    budget = memory_limit or (None if dask else default_budget() // many)
    if budget is not None and budget < MIB:
        raise ConfigError(f"--memory-limit: got {budget} bytes, expected at least 1M")
    what = Job(
        job.value,
        Options(method=method.value, top=top).stepped(angle),
        reading=reading,
        allow_lossy=allow_lossy,
        cell=cell,
        topic=topic,
        range_scale=range_scale,
        range_max=range_max,
        chosen=chosen,
        flipped=mounting.flipped,
        mount=mounting.pose,
        known=Known(near, heading, sensor.clearance if cleared else None),
        tolerance=TOLERANCES[-1] if tolerance is None else opt.tolerance_of(tolerance),
        sure=sure,
        sensor=replace(sensor, range_max=reach),
        count=count,
        seed=seed,
        step=step,
        headings=headings,
        pictures=pictures.value,
        drawings=DRAWINGS,
        memory_budget=budget,
        cache=inputs.kept_in(None, wanted=not no_cache),
    )
    items = find_items(maps, scans, what, out=out)
    again = resume or retry_failed
    rows = _rows(out) if again else {}
    todo = remaining(items, what, rows, retry_failed=retry_failed)
    known = len({path for item in items for _, path in item.maps})
    if near is not None and known > 1:
        raise ConfigError(f"--near: is about one map, not about {known:,}")
    files = len({item.scans_path for item in items if item.scans_path is not None})
    said = f"{len(items):,} items: {known:,} maps, {files:,} files of scans"
    if len(todo) < len(items):
        said += f"; {len(items) - len(todo):,} are done"
    if anew := sum(rows.get(item.id, ("", ""))[1] == "ok" for item in todo):
        said += f"; {anew:,} were done with other options, files or versions, and are done anew"
    if dry_run:
        emit(said)
        return
    say(said)
    with _cluster(dask, workers, timeout, memory_limit) as there, _progress(todo) as advance:
        try:
            summary = run_batch(
                maps,
                scans,
                out,
                what,
                executor=there or pool,
                resume=again,
                retry_failed=retry_failed,
                fail_fast=fail_fast,
                items=todo,
                on_row=lambda row: advance(row["status"] != "ok"),
            )
        except KeyboardInterrupt:
            say(f"what is done is kept in {display(out)}; --resume goes on")
            raise
    emit(to_json(summary.as_row()) if as_json else batch_text(summary, display(out)))
    if summary.failed:
        raise typer.Exit(FAILED_ROWS)


def _given(context: typer.Context, job: str, with_scans: bool, maps: Path) -> set[str]:
    """Names of the options that were given; one that is of other jobs alone is refused."""
    ways = {job}
    if job == "evaluate":
        ways = {"evaluate with SCANS" if with_scans else "evaluate without SCANS"}
        if maps.suffix.lower() == ".csv":  # whose lines may have scans
            ways = set(_EVALUATE)
    return opt.given(context, _OF, ways)


def _rows(out: Path) -> dict[tuple[str, str | None], tuple[str, str]]:
    """Keys and statuses of the rows that are there, by their items."""
    from imgloc.runs.results import RESULTS, id_of, read_rows

    if not is_there(out / RESULTS):
        return {}
    return {id_of(row): (row["key"], row["status"]) for row in read_rows(out)}


def _pool(
    context: typer.Context, workers: int, timeout: float, memory_limit: int | None
) -> "Executor":
    """Workers of this machine until the command ends; one starts while the command does."""
    from imgloc.runs.workers import Supervised

    limits: dict[str, Any] = {"timeout": timeout, "memory_limit": memory_limit}
    pool = Supervised(workers, module="imgloc.runs.batch", **limits)
    context.call_on_close(lambda: pool.shutdown(cancel_futures=True))
    return pool


@contextlib.contextmanager
def _cluster(
    dask: str | None, workers: int | None, timeout: float, memory_limit: int | None
) -> "Iterator[Executor | None]":
    """Workers elsewhere, if they are wanted."""
    if dask is None:
        yield None
        return
    from imgloc.runs.cluster import cluster

    limits = {"timeout": timeout, "memory_limit": memory_limit}
    with cluster(dask, workers=workers, **limits) as executor:  # type: ignore[arg-type]
        yield executor


@contextlib.contextmanager
def _progress(todo: "list[Item]") -> Iterator[Callable[[bool], None]]:
    """A bar with items/s, failures and time left on a terminal; elsewhere a line a minute."""
    start = said = time.monotonic()
    done = failed = 0
    with contextlib.ExitStack() as stack:
        bar = None
        if sys.stderr is not None and sys.stderr.isatty():
            from rich.progress import BarColumn, MofNCompleteColumn, TextColumn
            from rich.progress import TimeRemainingColumn as Remaining

            columns = (
                BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[rate]}"),
                TextColumn("{task.fields[failed]:,} failed,"), Remaining(compact=True),
                TextColumn("left"),
            )  # fmt: skip
            bar = stack.enter_context(bar_of(*columns))
            task = bar.add_task("batch", total=len(todo), failed=0, rate="")

        def advance(bad: bool) -> None:
            nonlocal done, failed, said
            failed, done, now = failed + bad, done + 1, time.monotonic()
            rate = done / max(now - start, 1e-3)
            if bar is not None:
                bar.update(task, advance=1, failed=failed, rate=f"{rate:.1f} items/s,")
            elif now - said >= _EVERY:
                said, left = now, (len(todo) - done) / rate / 60
                say(
                    f"{done:,} of {len(todo):,} items, {failed:,} failed, {rate:.2g} items/s, "
                    f"{left:.0f} min left"
                )

        yield advance
