"""`imgloc simulate`: scans with known poses, to try the rest with."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from imgloc.cli.console import say
from imgloc.cli.files import check_target
from imgloc.cli.options import (
    AllowLossy,
    Force,
    MapPath,
    MemoryBudget,
    Reading,
    console,
    reading,
    with_options,
)
from imgloc.cli.sensor import sensor
from imgloc.cli.values import check_range
from imgloc.errors import ConfigError

if TYPE_CHECKING:
    from imgloc.simulate import Sensor

_MAX_READINGS = 10_000_000  # about 1.5 GB while they are simulated


@with_options(sensor, reading, console)
def simulate(
    map_path: MapPath,
    out: Annotated[Path, typer.Option(metavar="NPZ", help="File to write.", show_default=False)],
    sensor: "Sensor",
    reading: Reading,
    count: Annotated[
        int, typer.Option("-n", "--count", min=1, metavar="N", help="Number of scans.")
    ] = 100,
    range_max: Annotated[
        float, typer.Option(metavar="M", help="Reach of the sensor, metres.")
    ] = 30.0,
    seed: Annotated[int, typer.Option(min=0, metavar="N", help="Seed of everything random.")] = 0,
    memory_budget: MemoryBudget = None,
    force: Force = False,
    allow_lossy: AllowLossy = False,
) -> None:
    """Simulate scans at random free poses of a map.

    Writes an NPZ with the keys ranges, angles, range_min, range_max and poses: the true pose of the
    sensor for each scan, in the map frame (metres, metres, radians).
    """
    check_target(out, ".npz", force=force)
    check_range("--range-max", range_max, 0.01, 10_000, "metres")
    rays = sensor.rays
    if count * rays > _MAX_READINGS:
        raise ConfigError(
            f"{count:,} scans of {rays:,} rays are {count * rays:,} readings, expected at most "
            f"{_MAX_READINGS:,}; simulate several files with different seeds"
        )
    from imgloc.cli.budgets import check_simulation, fixed_budget
    from imgloc.cli.loading import load_usable
    from imgloc.io.files import display
    from imgloc.io.scans import save_scans
    from imgloc.simulate import simulate_set

    memory_budget = fixed_budget(memory_budget)
    grid = load_usable(map_path, memory_budget, allow_lossy=allow_lossy, **reading)
    check_simulation(grid, display(map_path), count, rays, memory_budget)
    scans = simulate_set(grid, count, seed, replace(sensor, range_max=range_max))
    save_scans(out, scans, force=force)
    say(f"wrote {display(out)}: {count} scans of {rays} readings, with their poses")
