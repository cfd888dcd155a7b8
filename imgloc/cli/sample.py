"""`imgloc sample`: poses drawn from p(x | z), where a particle filter may start again."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from imgloc.cli.console import LOG, progress, say
from imgloc.cli.files import check_target
from imgloc.cli.options import (
    AllowLossy,
    Flipped,
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
from imgloc.cli.values import check_range
from imgloc.errors import ConfigError

if TYPE_CHECKING:
    import numpy as np

    from imgloc.features.mapfeatures import MapFeatures
    from imgloc.model import FloatArray, LaserScan
    from imgloc.options import Options

_MOST = 10_000_000  # poses in all
_LISTED = 20  # hypotheses of fused that are drawn from


@with_options(reading, console)
def sample(
    map_path: MapPath,
    scans_path: ScansPath,
    reading: Reading,
    out: Annotated[Path, typer.Option(metavar="CSV", help="File to write.", show_default=False)],
    count: Annotated[
        int, typer.Option("-n", "--count", min=1, metavar="N", help="Poses for each scan.")
    ] = 500,
    seed: Annotated[int, typer.Option(min=0, metavar="N", help="Of the draws.")] = 0,
    method: Annotated[
        MethodName, typer.Option(help="Whose posterior; fused draws around its hypotheses.")
    ] = MethodName.FUSED,
    index: Annotated[
        int | None, typer.Option("--index", min=0, metavar="I", help="Only scan I, counted from 0.")
    ] = None,
    range_max: Annotated[
        float | None, typer.Option(metavar="M", help="Cut readings at M metres: there, no return.")
    ] = None,
    flipped: Flipped = False,
    theta_step_deg: Annotated[
        float | None,
        typer.Option(metavar="DEG", help="Step of a stack's headings. [default: the method's]"),
    ] = None,
    cell: Annotated[float, typer.Option(metavar="M", help="Cell of the poses, metres.")] = 0.1,
    threads: Threads = None,
    memory_budget: MemoryBudget = None,
    force: Force = False,
    allow_lossy: AllowLossy = False,
) -> None:
    """Draw poses from the calibrated posterior p(x | z) of each scan.

    A particle filter that has lost the robot puts some of its particles there (sensor resetting).
    The CSV has the columns scan, x, y, theta: the sensor in the map frame, metres and radians.
    Poses are uniform inside a cell of a stack. The same seed gives the same poses.
    """
    check_range("--range-max", range_max, 1e-3, 1e6, "metres")
    check_range("--theta-step-deg", theta_step_deg, 0.05, 180, "degrees")
    check_range("--cell", cell, 0.001, 10, "metres")
    if theta_step_deg is not None and method == MethodName.FUSED:
        raise ConfigError("--theta-step-deg: fused has no stack of headings")
    check_target(out, ".csv", force=force, inputs=[scans_path])

    import cv2
    import numpy as np

    from imgloc.cli.budgets import fixed_budget
    from imgloc.cli.loading import load_set, load_usable
    from imgloc.cli.prepared import open_features
    from imgloc.io.calibration import calibration_path, load_calibrations
    from imgloc.io.files import display, write_text_atomic
    from imgloc.options import Options

    workers = count_threads(threads)
    memory_budget = fixed_budget(memory_budget)
    cv2.setNumThreads(workers)
    grid = load_usable(map_path, memory_budget, allow_lossy=allow_lossy, **reading)
    scans = load_set(scans_path, memory_budget)
    if index is not None and index >= len(scans):
        raise ConfigError(f"--index: got {index}, expected 0 to {len(scans) - 1}")
    chosen = range(len(scans)) if index is None else range(index, index + 1)
    if count * len(chosen) > _MOST:
        raise ConfigError(f"-n: {count:,} poses of {len(chosen):,} scans are more than {_MOST:,}")
    options = Options(
        method=method.value, top=_LISTED, threads=workers, memory_budget=memory_budget
    )
    step = None if theta_step_deg is None else float(np.deg2rad(theta_step_deg))
    calibration = load_calibrations(calibration_path(map_path), grid).get(method.value)
    options = replace(options, theta_step=step, calibration=calibration)
    features = open_features(
        grid, display(map_path), None, options, scans=scans.scans, cell=cell, threads=workers
    )
    lines = ["scan,x,y,theta"]
    with progress("sample", len(chosen)) as advance:
        for k in chosen:
            # Each scan has draws of its own, whichever others are drawn from.
            rng = np.random.default_rng((seed, k))
            scan = cut_scan(scans[k], range_max, flipped=flipped)
            if scan.directions < options.trust.readings:
                say(f"scan {k}: invalid, too few readings: its poses are drawn from everywhere")
            poses = _draw(features, scan, options, count, rng)
            lines += [f"{k},{x:.6f},{y:.6f},{theta:.6f}" for x, y, theta in poses.tolist()]
            advance()
    write_text_atomic(out, "\n".join(lines) + "\n", force=force)
    LOG.info("seed %d", seed)
    say(f"wrote {display(out)}: {count} poses for each of {len(chosen)} scans")


def _draw(
    features: "MapFeatures",
    scan: "LaserScan",
    options: "Options",
    count: int,
    rng: "np.random.Generator",
) -> "FloatArray":
    from imgloc.geometry import transform_poses
    from imgloc.likelihood.draws import draw_near, draw_poses
    from imgloc.model import Localization
    from imgloc.options import FUSED
    from imgloc.pipeline import likelihood, localize, posterior_of

    lattice = features.lattice
    enough = scan.directions >= options.trust.readings
    if enough and options.method != FUSED:
        stack = likelihood(features, scan, options)
        probability = posterior_of(features, scan, stack, options)
        if probability.any():
            poses = draw_poses(probability, stack.thetas, lattice, count, rng)
            return transform_poses(features.grid.origin, poses)
        answer = Localization((), "no-match", 0.0, 0.0)  # a stack without evidence: anywhere
    else:
        answer = localize(features, scan, options)
    return draw_near(answer, features.free, lattice, count, rng)
