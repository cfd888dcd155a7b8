"""`imgloc simulate`: scans with known poses, to try the rest with."""

from pathlib import Path

from imgloc.cli import options as opt
from imgloc.cli.console import say
from imgloc.io.files import display
from imgloc.options import Count, Seed, Sensor
from imgloc.ranges import option


def simulate(
    *,
    map_path: opt.MapPath,
    out: Path = option(..., "File of the scans that is written.", metavar="NPZ"),
    sensor: Sensor,
    count: Count = option(100, "Scans that are simulated.", "-n", "--count"),
    seed: Seed = 0,
    memory_budget: opt.MemoryBudget | None = None,
    force: opt.Force = False,
) -> None:
    """Simulate scans at random free poses of a map.

    Writes an NPZ with the keys ranges, angles, range_min, range_max and poses: the true pose of the
    sensor for each scan, in the map frame (metres, metres, radians).

    Examples
    --------
    imgloc simulate office.yaml -n 100 --out scans.npz
    imgloc simulate office.yaml -n 20 --rays 360 --fov-deg 360 --outliers 0.2 --out hard.npz
    """
    from imgloc.cli import inputs
    from imgloc.io.scans import save_scans
    from imgloc.simulation.scans import simulate

    inputs.check_target(out, ".npz", force=force)
    desk = inputs.desk_of(1, opt.fixed_budget(memory_budget))
    grid = desk.grid(map_path, inputs.map_files(), usable=True)
    desk.check_simulation(grid, display(map_path), count, sensor.rays)
    scans = simulate(grid, count, seed, sensor)
    save_scans(out, scans, force=force)
    say(f"wrote {display(out)}: {count} scans of {sensor.rays} readings, with their poses")
