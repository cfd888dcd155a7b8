"""`imgloc sample`: poses drawn from p(x | z), where a particle filter may start again."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

from imgloc.cli import options as opt
from imgloc.cli.command import Only
from imgloc.cli.console import LOG, progress, say
from imgloc.errors import ConfigError
from imgloc.io.files import display, write_text_atomic
from imgloc.options import FUSED, Cell, Chosen, Count, Options, Seed
from imgloc.ranges import option

_MOST = 10_000_000  # poses in all


def sample(
    *,
    map_path: opt.MapPath,
    scans_path: opt.ScansPath,
    out: Path = option(..., "File of the poses that is written.", metavar="CSV"),
    search: Annotated[Options, Only("method", "theta_step")],
    chosen: Annotated[Chosen, Only("index")],
    taken: opt.Resources,
    count: Count = option(500, "Poses that are drawn for each scan.", "-n", "--count"),
    seed: Seed = 0,
    cell: Cell = 0.1,
    force: opt.Force = False,
) -> None:
    """Draw poses from the calibrated posterior p(x | z) of each scan.

    A particle filter that has lost the robot puts some of its particles there (sensor resetting).
    The CSV has the columns scan, x, y, theta: the sensor in the map frame, metres and radians.
    Poses are uniform inside a cell of a stack. The same seed gives the same poses.

    Examples
    --------
    imgloc sample office.yaml scans.npz --out particles.csv
    imgloc sample office.yaml scans.npz --scans-index 3 -n 2000 --seed 7 --out a.csv
    """
    import numpy as np

    from imgloc.answers.sample import sample_poses
    from imgloc.cli import inputs
    from imgloc.io.calibration import calibrated

    if search.theta_step is not None and search.method == FUSED:
        raise ConfigError("--theta-step-deg: fused has no stack of headings")
    inputs.check_target(out, ".csv", force=force, inputs=[scans_path])
    desk = inputs.desk_of(**vars(taken))
    maps = inputs.map_files()
    grid = desk.grid(map_path, maps, usable=True)
    asked = desk.scans(scans_path, inputs.as_recorded(chosen=chosen))
    total = len(asked.indices)
    if count * total > _MOST:
        raise ConfigError(f"-n: {count:,} poses of {total:,} scans are more than {_MOST:,}")
    options = replace(search, **vars(taken))
    options = calibrated(options, map_path, grid)
    features = desk.features(map_path, maps, options, cell=cell, scans=asked.scans.scans)
    lines = ["scan,x,y,theta"]
    with progress("sample", total) as advance:
        for k, scan, _ in asked:
            # Each scan has draws of its own, whichever others are drawn from.
            rng = np.random.default_rng((seed, k))
            if scan.directions < options.trust.readings:
                say(f"scan {k}: invalid, too few readings: its poses are drawn from everywhere")
            poses = sample_poses(features, scan, count, rng, options).tolist()
            lines += [f"{k},{x:.6f},{y:.6f},{theta:.6f}" for x, y, theta in poses]
            advance()
    write_text_atomic(out, "\n".join(lines) + "\n", force=force)
    LOG.info("seed %d", seed)
    say(f"wrote {display(out)}: {count} poses for each of {total} scans")
