"""`imgloc simulate`: scans with known poses, to try the rest with."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

from imgloc.cli import options as opt
from imgloc.cli.console import say
from imgloc.cli.options import option
from imgloc.errors import ConfigError
from imgloc.io.files import display

_MAX_READINGS = 10_000_000  # about 1.5 GB while they are simulated


@opt.with_options(opt.sensor, opt.reading, opt.console)
def simulate(
    map_path: opt.MapPath,
    out: Annotated[Path, option(..., "NPZ", "File to write.", show_default=False)],
    sensor: "opt.Sensor",
    reading: "opt.Reading",
    count: int = option(100, "N", "Number of scans.", "-n", "--count", min=1),
    range_max: opt.Reach = 30.0,
    seed: opt.Seed = 0,
    memory_budget: opt.MemoryBudget = None,
    force: opt.Force = False,
    allow_lossy: opt.AllowLossy = False,
) -> None:
    """Simulate scans at random free poses of a map.

    Writes an NPZ with the keys ranges, angles, range_min, range_max and poses: the true pose of the
    sensor for each scan, in the map frame (metres, metres, radians).
    """
    from imgloc.cli import inputs
    from imgloc.io.scans import save_scans
    from imgloc.simulation.scans import simulate

    inputs.check_target(out, ".npz", force=force)
    rays = sensor.rays
    if count * rays > _MAX_READINGS:
        raise ConfigError(
            f"{count:,} scans of {rays:,} rays are {count * rays:,} readings, expected at most "
            f"{_MAX_READINGS:,}; simulate several files with different seeds"
        )
    desk = inputs.desk_of(1, opt.fixed_budget(memory_budget))
    maps = inputs.one_map(reading, allow_lossy=allow_lossy)
    grid = desk.grid(map_path, maps, usable=True)
    desk.check_simulation(grid, display(map_path), count, rays)
    scans = simulate(grid, count, seed, replace(sensor, range_max=range_max))
    save_scans(out, scans, force=force)
    say(f"wrote {display(out)}: {count} scans of {rays} readings, with their poses")
