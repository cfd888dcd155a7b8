"""`imgloc simulate`: scans with known poses, to try the rest with."""

from pathlib import Path
from typing import Annotated

import typer

from imgloc.cli.console import quiet_libraries, say
from imgloc.cli.options import (
    AllowLossy,
    Force,
    MapPath,
    Reading,
    check_range,
    check_target,
    console,
    reading,
    with_options,
)
from imgloc.errors import ConfigError

_MAX_READINGS = 10_000_000  # about 1.5 GB while they are simulated


@with_options(reading, console)
def simulate(
    map_path: MapPath,
    out: Annotated[Path, typer.Option(metavar="NPZ", help="File to write.", show_default=False)],
    reading: Reading,
    count: Annotated[
        int, typer.Option("-n", "--count", min=1, metavar="N", help="Number of scans.")
    ] = 100,
    rays: Annotated[int, typer.Option(min=1, metavar="N", help="Readings of a scan.")] = 181,
    fov_deg: Annotated[
        float, typer.Option(metavar="DEG", help="Angle that a scan covers, degrees.")
    ] = 180.0,
    sigma: Annotated[
        float, typer.Option(metavar="M", help="Standard deviation of a reading's noise, metres.")
    ] = 0.02,
    range_max: Annotated[
        float, typer.Option(metavar="M", help="Reach of the sensor, metres.")
    ] = 30.0,
    outliers: Annotated[
        float,
        typer.Option(metavar="P", help="Share of the rays that something unmapped stops, 0..1."),
    ] = 0.0,
    dropped: Annotated[
        float, typer.Option(metavar="P", help="Share of the rays that give no measurement, 0..1.")
    ] = 0.0,
    clearance: Annotated[
        float,
        typer.Option(metavar="M", help="Least distance of a pose from what is not free, metres."),
    ] = 0.3,
    seed: Annotated[int, typer.Option(min=0, metavar="N", help="Seed of everything random.")] = 0,
    force: Force = False,
    allow_lossy: AllowLossy = False,
) -> None:
    """Simulate scans at random free poses of a map.

    Writes an NPZ with the keys ranges, angles, range_min, range_max and poses: the true pose of the
    sensor for each scan, in the map frame (metres, metres, radians).
    """
    check_target(out, ".npz", force=force)
    check_range("--fov-deg", fov_deg, 0.01, 360, "degrees")
    check_range("--sigma", sigma, 0, 10, "metres")
    check_range("--range-max", range_max, 0.01, 10_000, "metres")
    check_range("--outliers", outliers, 0, 1, "a share")
    check_range("--dropped", dropped, 0, 1, "a share")
    check_range("--clearance", clearance, 0, 1000, "metres")
    if count * rays > _MAX_READINGS:
        raise ConfigError(
            f"{count:,} scans of {rays:,} rays are {count * rays:,} readings, expected at most "
            f"{_MAX_READINGS:,}; simulate several files with different seeds"
        )
    import numpy as np

    from imgloc.experiments.simulate import simulate_scans
    from imgloc.geometry import transform_poses
    from imgloc.io.files import display
    from imgloc.io.maps import load_map, require_usable
    from imgloc.io.scans import ScanSet, save_scans
    from imgloc.model import LaserScan

    with quiet_libraries():
        grid = load_map(map_path, **reading, allow_lossy=allow_lossy)
    require_usable(grid, display(map_path))
    ranges, angles, poses = simulate_scans(
        grid,
        count,
        seed,
        rays=rays,
        fov=float(np.deg2rad(fov_deg)),
        sigma=sigma,
        range_max=range_max,
        outliers=outliers,
        dropped=dropped,
        clearance=clearance,
    )
    scans = tuple(LaserScan(r, angles, range_max=range_max) for r in ranges)
    in_map = transform_poses(grid.origin, poses)
    save_scans(out, ScanSet(scans, poses=in_map), force=force)
    say(f"wrote {display(out)}: {count} scans of {rays} readings, with their poses")
