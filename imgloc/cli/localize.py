"""`imgloc localize`: the poses of scans in a map."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from imgloc.cli.console import LOG, NOT_UNIQUE, emit, progress
from imgloc.cli.files import check_target, files_of
from imgloc.cli.hints import MIRRORED, hint_at_mirrored
from imgloc.cli.options import (
    AllowLossy,
    AsJson,
    EngineName,
    Force,
    MapPath,
    MemoryBudget,
    MethodName,
    Reading,
    ScansPath,
    Threads,
    console,
    count_threads,
    cut_scan,
    reading,
    with_options,
)
from imgloc.cli.priors import Known, Mounting, known, mounting, prior_of
from imgloc.cli.values import check_range
from imgloc.errors import ConfigError

if TYPE_CHECKING:
    from imgloc.io.scanset import ScanSet
    from imgloc.model import Pose2D
    from imgloc.options import Options


@with_options(known, mounting, reading, console)
def localize(
    map_path: MapPath,
    scans_path: ScansPath,
    known: Known,
    mounting: Mounting,
    reading: Reading,
    method: Annotated[
        MethodName,
        typer.Option(help="How: fused searches and re-scores, the others are the paper's stacks."),
    ] = MethodName.FUSED,
    top: Annotated[int, typer.Option(min=1, metavar="N", help="Hypotheses listed for a scan.")] = 5,
    as_json: AsJson = False,
    picture: Annotated[
        Path | None,
        typer.Option(
            metavar="PNG",
            help="Draw the scan at each hypothesis; several scans: NAME-0003.png and so on.",
        ),
    ] = None,
    explain: Annotated[
        Path | None,
        typer.Option(
            metavar="HTML",
            help="Say why, ray by ray, on a page of its own; several scans: NAME-0003.html.",
        ),
    ] = None,
    index: Annotated[
        int | None, typer.Option("--index", min=0, metavar="I", help="Only scan I, counted from 0.")
    ] = None,
    strict: Annotated[
        bool, typer.Option("--strict", help="Exit with 6 unless every scan is unique.")
    ] = False,
    range_max: Annotated[
        float | None,
        typer.Option(metavar="M", help="Cut readings at M metres: there, no return."),
    ] = None,
    theta_step_deg: Annotated[
        float | None,
        typer.Option(metavar="DEG", help="Step of the headings. [default: the method's own]"),
    ] = None,
    cell: Annotated[float, typer.Option(metavar="M", help="Cell of the poses, metres.")] = 0.1,
    engine: Annotated[
        EngineName, typer.Option(help="Of the correlations of cbml and cbml-o.")
    ] = EngineName.AUTO,
    exact_argmax: Annotated[
        bool,
        typer.Option(
            "--exact-argmax",
            help="Branch and bound: the best poses of cbml without its stack; to fused, more "
            "proposals.",
        ),
    ] = False,
    threads: Threads = None,
    memory_budget: MemoryBudget = None,
    time_budget: Annotated[
        float | None,
        typer.Option(
            metavar="S",
            help="Seconds for each scan: then the best so far, marked as not complete. Such "
            "answers depend on the machine.",
        ),
    ] = None,
    cache: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Where prepared maps are kept. [default: the user's cache folder]"
        ),
    ] = None,
    no_cache: Annotated[
        bool, typer.Option("--no-cache", help="Prepare the map anew and keep nothing.")
    ] = False,
    force: Force = False,
    allow_lossy: AllowLossy = False,
) -> None:
    """Find the pose of each scan in a map, without an initial guess.

    Verdicts: unique (one pose holds nearly all of the mass), ambiguous (several fit), no-match (the
    best pose does not explain the scan), invalid (too few readings). Poses are those of the sensor,
    in the map frame. Look at the mass of the second hypothesis before trusting the first.
    """
    check_range("--range-max", range_max, 1e-3, 1e6, "metres")
    check_range("--theta-step-deg", theta_step_deg, 0.05, 180, "degrees")
    check_range("--cell", cell, 0.001, 10, "metres")
    check_range("--time-budget", time_budget, 0.001, 1e6, "seconds")
    if cache is not None and no_cache:
        raise ConfigError("--cache and --no-cache: expected one of them")
    if engine != EngineName.AUTO and method not in (MethodName.CBML, MethodName.CBML_O):
        raise ConfigError(f"--engine: {method.value} does not correlate; use cbml or cbml-o")
    inputs = [*files_of(map_path), *([] if known.region is None else [known.region])]
    if picture is not None:
        check_target(picture, ".png", force=force, inputs=inputs)
    if explain is not None:
        check_target(explain, ".html", force=force)

    import cv2

    from imgloc.cli import answers
    from imgloc.cli.budgets import fixed_budget
    from imgloc.cli.explanations import write_explanation
    from imgloc.cli.loading import load_grid, load_set
    from imgloc.cli.pictures import picture_name, write_hypotheses
    from imgloc.cli.prepared import cache_folder, keep_features, open_features
    from imgloc.io.calibration import calibration_path, load_calibrations
    from imgloc.io.files import display
    from imgloc.pipeline import check_options
    from imgloc.pipeline import localize as locate

    workers = count_threads(threads)
    memory_budget = fixed_budget(memory_budget)
    cv2.setNumThreads(workers)
    options = _options(method, top, theta_step_deg, engine, workers)
    grid = load_grid(map_path, memory_budget, allow_lossy=allow_lossy, **reading)
    options = replace(
        options,
        memory_budget=memory_budget,
        time_budget=time_budget,
        exact=exact_argmax,
        prior=prior_of(known, grid, allow_lossy=allow_lossy),
        calibration=load_calibrations(calibration_path(map_path), grid).get(method.value),
    )
    folder = cache_folder(cache, wanted=not no_cache)
    scans = load_set(scans_path, memory_budget)
    features = open_features(
        grid, display(map_path), folder, options, scans=scans.scans, cell=cell, threads=workers
    )
    chosen = _choose(scans, index, display(scans_path))
    many, mount = len(chosen) > 1, mounting.pose
    targets = {k: picture_name(picture, k, many) for k in chosen} if picture is not None else {}
    for target in targets.values():
        check_target(target, ".png", force=force, inputs=inputs)
    pages = {k: picture_name(explain, k, many) for k in chosen} if explain is not None else {}
    for page in pages.values():
        check_target(page, ".html", force=force)
    LOG.info("%s: %d x %d cells of %g m", display(map_path), *grid.info.shape, grid.resolution)
    LOG.info("%s: %d of %d scans", display(scans_path), len(chosen), len(scans))
    check_options(features, options)
    if many and not as_json:
        emit(answers.header(mount))
    doubtful = []
    with progress("localize", len(chosen)) as advance:
        for k in chosen:
            scan = mounting.mount(cut_scan(scans[k], range_max))
            answer = locate(features, scan, options)
            truth = _truth(scans, k)
            if answer.verdict != "unique":
                doubtful.append(k)
            LOG.info("scan %d: %s, %s", k, answer.verdict, dict(answer.timings_ms))
            if k in targets:
                write_hypotheses(targets[k], grid, scan, answer, truth, force=force)
                LOG.info("wrote %s", display(targets[k]))
            if k in pages:
                write_explanation(
                    pages[k],
                    features,
                    scan,
                    answer,
                    options,
                    title=f"{display(scans_path.name)}, scan {k}, on {display(map_path.name)}",
                    truth=truth,
                    mount=mount,
                    force=force,
                )
                LOG.info("wrote %s", display(pages[k]))
            advance()
            if as_json:
                about = {"range_max": scan.range_max, **mounting.about}
                emit(answers.as_json(k, answer, about, mount))
            elif many:
                emit(answers.as_line(k, answer, mount))
            else:
                emit(answers.as_text(f"scan {k}", answer, truth, mount))
    if folder is not None:
        keep_features(features, folder)
    if method == MethodName.FUSED and time_budget is None and 2 * len(doubtful) > len(chosen):
        few = [mounting.mount(cut_scan(scans[k], range_max)) for k in doubtful[:MIRRORED]]
        hint_at_mirrored(few, features, options, flipped=mounting.flipped)
    if strict and doubtful:
        raise typer.Exit(NOT_UNIQUE)


def _options(
    method: MethodName, top: int, step_deg: float | None, engine: EngineName, threads: int
) -> "Options":
    import numpy as np

    from imgloc.options import Options

    options = Options(method=method.value, top=top, engine=engine.value, threads=threads)
    if step_deg is None:
        return options
    step = float(np.deg2rad(step_deg))
    if method == MethodName.FUSED:
        return replace(options, fused=replace(options.fused, theta_step=step))
    return replace(options, theta_step=step)


def _choose(scans: "ScanSet", index: int | None, name: str) -> range:
    """Indices of the scans asked for."""
    if index is None:
        return range(len(scans))
    if index >= len(scans):
        raise ConfigError(
            f"--index: got {index}, expected 0 to {len(scans) - 1}: {name} has {len(scans)} scans"
        )
    return range(index, index + 1)


def _truth(scans: "ScanSet", k: int) -> "Pose2D | None":
    """Pose recorded with scan `k`, in the map frame."""
    from imgloc.model import Pose2D

    return None if scans.poses is None else Pose2D(*scans.poses[k])
