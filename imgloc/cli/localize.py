"""`imgloc localize`: the poses of scans in a map."""

import logging
import math
from pathlib import Path

import typer

from imgloc.cli import options as opt
from imgloc.cli.console import LOG, NOT_UNIQUE, emit, progress, say, width
from imgloc.cli.options import flag, option
from imgloc.errors import ConfigError, as_options
from imgloc.io.files import display, write_text_atomic

_MANY = 5  # scans whose verdicts one does not count oneself
_WIDE = 112  # columns of a line with the poses of the sensor and of the base


@opt.with_options(
    opt.known, opt.mounting, opt.reading, opt.logs, opt.chosen, opt.taken, opt.console
)
def localize(
    map_path: opt.MapPath,
    scans_paths: opt.ScansPaths,
    known: opt.Known,
    mounting: opt.Mounting,
    reading: "opt.Reading",
    logs: opt.Logs,
    chosen: "opt.Chosen",
    taken: opt.Resources,
    method: opt.MethodName = typer.Option(
        opt.MethodName.FUSED,
        help="How: fused searches and re-scores, the others are the paper's stacks.",
    ),
    top: opt.Top = None,
    as_json: opt.AsJson = False,
    picture: Path | None = option(
        None, "PNG", "Draw the scan at each hypothesis; several scans: NAME-0003.png and so on."
    ),
    explain: Path | None = option(
        None, "HTML", "Say why, ray by ray, on a page of its own; several scans: NAME-0003.html."
    ),
    strict: bool = flag("--strict", "Exit with 6 unless every scan is unique."),
    range_max: opt.Cut = None,
    theta_step_deg: opt.StepDeg = None,
    cell: opt.Cell = 0.1,
    engine: opt.EngineName = typer.Option(
        opt.EngineName.AUTO, help="Of the correlations of cbml and cbml-o."
    ),
    exact_argmax: bool = flag(
        "--exact-argmax",
        "Branch and bound: the best poses of cbml without its stack; to fused, more proposals.",
    ),
    time_budget: float | None = option(
        None,
        "S",
        "Seconds for each scan: then the best so far, marked as not complete. Such "
        "answers depend on the machine.",
        within=(0.001, 1e6, "seconds"),
    ),
    cache: opt.CacheDir = None,
    no_cache: opt.NoCache = False,
    force: opt.Force = False,
    allow_lossy: opt.AllowLossy = False,
) -> None:
    """Find the pose of each scan in a map, without an initial guess.

    Verdicts: unique (one pose holds nearly all of the mass), ambiguous (several fit), no-match (the
    best pose does not explain the scan), invalid (too few readings). Poses are those of the sensor,
    in the map frame. Look at the mass of the second hypothesis before trusting the first.
    """
    from imgloc.answers.diagnose import Doubt, doubts
    from imgloc.cli import inputs
    from imgloc.io.calibration import calibrated
    from imgloc.io.maps import SWAPPED
    from imgloc.model import Evidence, LaserScan, Pose2D, to_json
    from imgloc.options import Options
    from imgloc.output.pictures import draw
    from imgloc.output.rows import answer_row
    from imgloc.output.tables import (
        answer_header,
        answer_line,
        answer_text,
        difference,
        run_words,
        times_words,
    )
    from imgloc.pipeline import localize as locate
    from imgloc.search.asked import check_options

    folder = inputs.kept_in(cache, wanted=not no_cache)
    if engine != opt.EngineName.AUTO and method not in (opt.MethodName.CBML, opt.MethodName.CBML_O):
        raise ConfigError(f"--engine: {method.value} does not correlate; use cbml or cbml-o")
    read = [*inputs.files_of(map_path), *([] if known.region is None else [known.region])]
    outputs = ((picture, ".png", read), (explain, ".html", list[Path]()))
    for path, ending, sources in outputs:
        inputs.check_target(path, ending, force=force, inputs=sources)
    if list(map(str, scans_paths)).count("-") > 1:
        raise ConfigError("-: got it more than once, but standard input can be read only once")
    grid = inputs.load_grid(
        map_path, taken.memory_budget, allow_lossy=allow_lossy, usable=False, **reading
    )
    step = None if theta_step_deg is None else math.radians(theta_step_deg)
    fused = method == opt.MethodName.FUSED
    options = Options(
        method=method.value,
        top=top,
        engine=engine.value,
        threads=taken.threads,
        memory_budget=taken.memory_budget,
        time_budget=time_budget,
        exact=exact_argmax,
        prior=inputs.prior_of(known, grid, allow_lossy=allow_lossy),
    )
    options = calibrated(options.stepped(step), map_path, grid)
    sets = [inputs.load_set(path, taken.memory_budget, logs) for path in scans_paths]
    for scans in sets:
        mounting.check(scans.scans)
    every = [scan for scans in sets for scan in scans.scans]
    features = inputs.open_features(
        grid, display(map_path), folder, options,
        scans=every, cell=cell, threads=taken.threads,
    )  # fmt: skip
    # Of each scan that is asked for: its file, the set, its index in it.
    queue = [
        (inputs.name_of(path), scans, k)
        for path, scans in zip(scans_paths, sets, strict=True)
        for k in chosen.of(len(scans), inputs.name_of(path))
    ]
    many, several = len(queue) > 1, len(sets) > 1
    # Files are numbered through all sets, as two of these may have the same index.
    numbers = range(len(queue)) if several else [k for _, _, k in queue]
    targets, pages = inputs.numbered(picture, numbers), inputs.numbered(explain, numbers)
    for files, (_, ending, sources) in zip((targets, pages), outputs, strict=True):
        for path in files.values():
            inputs.check_target(path, ending, force=force, inputs=sources)
    LOG.info("%s: %d x %d cells of %g m", display(map_path), *grid.info.shape, grid.resolution)
    LOG.info(
        "%s: %d of %d scans", ", ".join(map(inputs.name_of, scans_paths)), len(queue), len(every)
    )
    inputs.check_prior(known, features, options)
    check_options(features, options)
    on_robot = any(scan.T_base_laser is not None for scan in every) or mounting.sensor is not None
    narrow = (width() or _WIDE) < _WIDE
    if many and not as_json:
        emit(answer_header(on_robot and not narrow))
    looked_at, said = list[LaserScan](), list[tuple[str, Evidence]]()
    errors, shown, hints = list[tuple[float, float]](), "", list[Doubt]()

    def wrong(some: list[LaserScan], said: list[tuple[str, Evidence]]) -> list[Doubt]:
        if not fused or time_budget is not None:
            return []
        return doubts(
            features, some, said, options, flipped=mounting.flipped, range_scale=logs.scale
        )

    with progress("localize", len(queue)) as advance:
        for n, (file, scans, k) in zip(numbers, queue, strict=True):
            scan = mounting.mount(inputs.cut_scan(scans[k], range_max))
            answer = locate(features, scan, options)
            truth = None if scans.poses is None else Pose2D(*scans.poses[k])
            looked_at.append(scan)
            said.append((answer.verdict, answer.evidence))
            if answer.best is not None and truth is not None:
                errors.append(difference(answer.best, truth))
            LOG.info("%s, scan %d: %s, %s", file, k, answer.verdict, times_words(answer))
            if n in targets or n in pages:
                hints = wrong([scan], said[-1:])
            if n in targets:
                short = as_options("; ".join(hint.short for hint in hints))
                image = draw(grid, answer, scan, truth=truth, note=short)
                image.save(targets[n], force=force)
            if n in pages:
                from imgloc.answers.explain import explain as reasons
                from imgloc.output.pages import render_explanation

                reason = reasons(features, scan, answer, options)
                title = f"{Path(file).name}, scan {k}, on {display(map_path.name)}"
                html = render_explanation(
                    reason, title, truth=truth, hints=[as_options(hint.text) for hint in hints]
                )
                write_text_atomic(pages[n], html, force=force)
            advance()
            if several and not as_json and file != shown:
                emit(f"{file}:")
                shown = file
            if as_json:
                about = {"scans": file} if several else {}
                row = answer_row(
                    answer, scan, k, sensor=mounting.pose, flipped=mounting.flipped, about=about
                )
                emit(to_json(row))
            elif many:
                emit(answer_line(k, answer, narrow=narrow))
            else:
                emit(answer_text(f"scan {k}", answer, truth))
    inputs.keep_features(features, folder)
    verdicts = [verdict for verdict, _ in said]
    if len(queue) >= _MANY and not as_json:
        say(run_words(verdicts, errors))
    for files in (targets, pages):
        if written := [display(path) for path in files.values()]:
            LOG.log(
                logging.INFO if as_json or len(written) == 1 else logging.WARNING,
                "wrote %s",
                written[0] if len(written) == 1
                else f"{len(written)} files, {written[0]} to {written[-1]}",
            )  # fmt: skip
    # Rows that are all invalid say why themselves, to a program.
    if not (as_json and set(verdicts) == {"invalid"}):
        if many or not (targets or pages):
            hints = wrong(looked_at, said)
        for hint in hints:
            if hint.text != SWAPPED:  # is said when the map is read
                LOG.warning("%s", hint.text)
    if strict and set(verdicts) != {"unique"}:
        raise typer.Exit(NOT_UNIQUE)
