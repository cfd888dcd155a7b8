"""`imgloc sample`: poses drawn from p(x | z), where a particle filter may start again."""

import math
from pathlib import Path
from typing import Annotated

import typer

from imgloc.cli.console import LOG, progress, say
from imgloc.cli.inputs import check_target, choose, cut_scan, load_grid, load_set, open_features
from imgloc.cli.options import (
    AllowLossy,
    Cell,
    Cut,
    Flipped,
    Force,
    Index,
    MapPath,
    MethodName,
    Reading,
    ScansPath,
    Take,
    check_range,
    console,
    reading,
    resources,
    with_options,
)
from imgloc.errors import ConfigError

_MOST = 10_000_000  # poses in all
_LISTED = 20  # hypotheses of fused that are drawn from


@with_options(reading, resources, console)
def sample(
    map_path: MapPath,
    scans_path: ScansPath,
    reading: Reading,
    resources: Take,
    out: Annotated[Path, typer.Option(metavar="CSV", help="File to write.", show_default=False)],
    count: Annotated[
        int, typer.Option("-n", "--count", min=1, metavar="N", help="Poses for each scan.")
    ] = 500,
    seed: Annotated[int, typer.Option(min=0, metavar="N", help="Of the draws.")] = 0,
    method: Annotated[
        MethodName, typer.Option(help="Whose posterior; fused draws around its hypotheses.")
    ] = MethodName.FUSED,
    index: Index = None,
    range_max: Cut = None,
    flipped: Flipped = False,
    theta_step_deg: Annotated[
        float | None,
        typer.Option(metavar="DEG", help="Step of a stack's headings. [default: the method's]"),
    ] = None,
    cell: Cell = 0.1,
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

    import numpy as np

    from imgloc.io.calibration import calibration_path, load_calibrations
    from imgloc.io.files import display, write_text_atomic
    from imgloc.options import Options
    from imgloc.sample import sample_poses

    taken = resources()
    grid = load_grid(map_path, taken.memory_budget, allow_lossy=allow_lossy, **reading)
    scans = load_set(scans_path, taken.memory_budget)
    chosen = choose(len(scans), index, display(scans_path))
    if count * len(chosen) > _MOST:
        raise ConfigError(f"-n: {count:,} poses of {len(chosen):,} scans are more than {_MOST:,}")
    options = Options(
        method=method.value,
        top=_LISTED,
        threads=taken.threads,
        memory_budget=taken.memory_budget,
        theta_step=None if theta_step_deg is None else math.radians(theta_step_deg),
        calibration=load_calibrations(calibration_path(map_path), grid).get(method.value),
    )
    features = open_features(
        grid, display(map_path), None, options,
        scans=scans.scans, cell=cell, threads=taken.threads,
    )  # fmt: skip
    lines = ["scan,x,y,theta"]
    with progress("sample", len(chosen)) as advance:
        for k in chosen:
            # Each scan has draws of its own, whichever others are drawn from.
            rng = np.random.default_rng((seed, k))
            scan = cut_scan(scans[k], range_max, flipped=flipped)
            if scan.directions < options.trust.readings:
                say(f"scan {k}: invalid, too few readings: its poses are drawn from everywhere")
            poses = sample_poses(features, scan, count, rng, options).tolist()
            lines += [f"{k},{x:.6f},{y:.6f},{theta:.6f}" for x, y, theta in poses]
            advance()
    write_text_atomic(out, "\n".join(lines) + "\n", force=force)
    LOG.info("seed %d", seed)
    say(f"wrote {display(out)}: {count} poses for each of {len(chosen)} scans")
