"""`imgloc batch`: every map of a folder with every file of scans of another, nothing lost."""

import contextlib
import math
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import fields, replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from imgloc.cli import options as opt
from imgloc.cli.console import bar_of, emit, say
from imgloc.cli.options import flag, option
from imgloc.doors import JOBS
from imgloc.errors import ConfigError
from imgloc.io.files import display, is_there

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from imgloc.runs.jobs import Item, Job
    from imgloc.runs.opening import Means

FAILED_ROWS = 5
_EVERY = 60.0  # seconds between lines of progress without a terminal
JobName = StrEnum("JobName", list(JOBS))  # type: ignore[misc]
Pictures = StrEnum("Pictures", ("NONE", "DOUBTFUL", "ALL"))
#: Which field of a job an option is for, if it is not called as the option.
_FIELDS = {
    **dict.fromkeys(("topic", "range_scale", "range_max", "sensor", "flipped"), ("scans",)),
    **dict.fromkeys(("index", "sample", "sample_seed"), ("scans",)),
    **dict.fromkeys(("rays", "fov_deg", "sigma", "outliers", "dropped"), ("sensor",)),
    **dict.fromkeys(("mount", "reach"), ("sensor",)),
    "method": ("options", "method"),
    "theta_step_deg": ("options", "theta_step"),
    "top": ("options",),
    "near": ("known",),
    "heading": ("known",),
    "clearance": ("known", "sensor"),
    "tolerance": ("tolerance", "tolerances"),
}


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
    job: JobName = typer.Option(JobName("localize"), help="Whose work is done with each."),
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
    many = opt.count_threads(workers)
    pool = None if dask or dry_run else _pool(context, many, timeout, memory_limit)
    from imgloc.model import to_json
    from imgloc.options import TOLERANCES, Options
    from imgloc.output.tables import batch_text
    from imgloc.runs.batch import find_items, run_batch
    from imgloc.runs.jobs import job_class
    from imgloc.runs.opening import MapFiles, ScanFiles
    from imgloc.search.priors import Known

    kind = job_class(job.value)
    given = _given(context, kind, scans is not None, maps)
    opt.check_known(near, heading)
    angle = None if theta_step_deg is None else math.radians(theta_step_deg)
    within = TOLERANCES[-1] if tolerance is None else opt.tolerance_of(tolerance)
    offered: dict[str, Any] = {
        "maps": MapFiles(reading, allow_lossy),
        "scans": ScanFiles(
            topic, None, range_scale, range_max, chosen, mounting.flipped, mounting.pose
        ),
        "options": Options(method=method.value, top=top).stepped(angle),
        "method": method.value,
        "theta_step": angle,
        "cell": cell,
        # Of simulated robots a clearance is another matter.
        "known": Known(near, heading, sensor.clearance if "clearance" in given else None),
        "tolerance": within,
        "tolerances": (*TOLERANCES, within),
        "sure": sure,
        "sensor": replace(sensor, range_max=reach),
        "count": count,
        "seed": seed,
        "step": step,
        "headings": headings,
        "pictures": pictures.value,
    }
    names = {field.name for field in fields(kind)}
    what = kind(**{name: value for name, value in offered.items() if name in names})
    means = _means(memory_limit, 0 if dask else many, cached=not no_cache)
    again = resume or retry_failed
    items = find_items(maps, scans, what, out=out)
    todo, said = _plan(items, what, out if again else None, retry_failed=retry_failed)
    if near is not None and (known := len({path for item in items for _, path in item.maps})) > 1:
        raise ConfigError(f"--near: is about one map, not about {known:,}")
    (emit if dry_run else say)(said)
    if dry_run:
        return
    limits = {"timeout": timeout, "memory_limit": memory_limit}
    with _cluster(dask, workers, limits) as there, _progress(todo) as advance:
        try:
            summary = run_batch(
                maps, scans, out, what, means=means, executor=there or pool, resume=again,
                retry_failed=retry_failed, fail_fast=fail_fast, items=todo,
                on_row=lambda row: advance(row["status"] != "ok"),
            )  # fmt: skip
        except KeyboardInterrupt:
            say(f"what is done is kept in {display(out)}; --resume goes on")
            raise
    emit(to_json(summary.as_row()) if as_json else batch_text(summary, display(out)))
    if summary.failed:
        raise typer.Exit(FAILED_ROWS)


def _means(memory_limit: int | None, workers: int, *, cached: bool) -> "Means":
    """What each of so many workers has; 0 of them are elsewhere, and say themselves."""
    from imgloc.cli import inputs
    from imgloc.features.budget import MIB, default_budget
    from imgloc.output.drawings import DRAWINGS
    from imgloc.runs.opening import Means

    budget = memory_limit or (default_budget() // workers if workers else None)
    if budget is not None and budget < MIB:
        raise ConfigError(f"--memory-limit: got {budget} bytes, expected at least 1M")
    return Means(budget, inputs.kept_in(None, wanted=cached), DRAWINGS)


def _plan(
    items: "list[Item]", job: "Job", out: Path | None, *, retry_failed: bool
) -> "tuple[list[Item], str]":
    """What is left to do, beside the rows that are in `out` already, and this in words."""
    from imgloc.runs.batch import remaining
    from imgloc.runs.results import RESULTS, id_of, read_rows

    there = out is not None and is_there(out / RESULTS)
    rows = {
        id_of(row): (row["key"], row["status"]) for row in (read_rows(out) if out and there else ())
    }
    todo = remaining(items, job, rows, retry_failed=retry_failed)
    maps = len({path for item in items for _, path in item.maps})
    files = len({item.scans_path for item in items if item.scans_path is not None})
    said = f"{len(items):,} items: {maps:,} maps, {files:,} files of scans"
    if len(todo) < len(items):
        said += f"; {len(items) - len(todo):,} are done"
    if anew := sum(rows.get(item.id, ("", ""))[1] == "ok" for item in todo):
        said += f"; {anew:,} were done with other options, files or versions, and are done anew"
    return todo, said


def _given(context: typer.Context, kind: "type[Job]", with_scans: bool, maps: Path) -> set[str]:
    """Names of the options that were given; one that is of other jobs alone is refused."""
    from imgloc.runs.jobs import job_class

    def ways_of(other: "type[Job]", option: str) -> list[str]:
        wanted = {option} if option in other.refused else {*_FIELDS.get(option, (option,))}
        return [way for way, names in other.ways().items() if names & wanted]

    options = [p.name or "" for p in context.command.params if p.opts[0].startswith("-")]
    of = {name: [way for job in JOBS for way in ways_of(job_class(job), name)] for name in options}
    ways = list(kind.ways())
    if len(ways) > 1 and maps.suffix.lower() != ".csv":  # whose lines may have scans
        ways = [
            way for way in ways if way.endswith("with SCANS" if with_scans else "without SCANS")
        ]
    return opt.given(context, {name: theirs for name, theirs in of.items() if theirs}, set(ways))


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
    dask: str | None, workers: int | None, limits: dict[str, Any]
) -> "Iterator[Executor | None]":
    """Workers elsewhere, if they are wanted."""
    if dask is None:
        yield None
        return
    from imgloc.runs.cluster import cluster

    with cluster(dask, workers=workers, **limits) as executor:
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
