"""Scans with the true pose of each: recorded ones beside a map, simulated ones of a world."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from imgloc import ConfigError, OccupancyGrid, Pose2D, ScanSet, load_map, load_scans, simulate
from imgloc.filters.follow import with_odometry
from imgloc.io.files import display
from imgloc.options import Chosen, Sensor
from imgloc.simulation.worlds import WORLDS, render
from tools.script import at_least_one

#: Metres and radians within which a pose is right.
RIGHT = (0.5, float(np.deg2rad(10.0)))
#: Where the sensor sits on the robot whose odometry was recorded, if that is known: of duke_loop5
#: as odometry and poses agree best while it turns.
MOUNTS = {"duke_loop5": Pose2D(0.32, 0.0, 0.0)}


def scans_in(folder: Path) -> ScanSet:
    """The scans of the sensor where it sits, in a folder with ``scans.npz``."""
    scans, mount = load_scans(folder / "scans.npz"), MOUNTS.get(folder.name)
    if mount is None:
        return scans
    return replace(scans, scans=tuple(replace(s, T_base_laser=mount) for s in scans.scans))


def logs_of(folder: Path) -> Iterator[tuple[str, ScanSet]]:
    """The logs of a folder with ``scans.npz``, with odometry, each with its name."""
    scans = scans_in(folder)
    with np.load(folder / "scans.npz") as file:
        number = file["log"] if "log" in file.files else np.zeros(len(scans), int)
    for one in np.unique(number):
        log = scans.take(np.flatnonzero(number == one).tolist())
        yield f"{folder.name} {one}", with_odometry(log)[0]


def scans_beside(path: Path, n: int, seed: int, range_max: float) -> ScanSet:
    """Pick `n` scans of the file ``scans.npz`` beside a map, as a shorter reach would have them.

    See :class:`imgloc.options.Chosen`; all if there are fewer.

    Raises
    ------
    ScanError
        If there is no such file, or it is no set of scans.
    ConfigError
        If `n` is less than 1 or the reach not positive.
    """
    file = path.with_name("scans.npz")
    scans, some = load_scans(file), Chosen(sample=n, seed=seed)
    return cut_set(scans.take(some.of(len(scans), display(file))), range_max)


def recorded_sets(
    paths: Iterable[Path], n: int, seed: int, range_max: float
) -> list[tuple[str, OccupancyGrid, ScanSet]]:
    """The maps, called as their folders are, with the scans beside them: :func:`scans_beside`."""
    sets = [(path, scans_beside(path, n, seed, range_max)) for path in paths]
    return [(path.parent.name, load_map(path), scans) for path, scans in sets]


def in_world(
    name: str, n: int, seed: int, sensor: Sensor | None = None, cell: float = 0.1
) -> tuple[OccupancyGrid, ScanSet]:
    """The map of a bundled world, and `n` scans taken in the world itself."""
    at_least_one(n=n)
    grid = render(WORLDS[name](), cell)
    return grid, simulate(grid, n, seed, sensor, render(WORLDS[name](), 0.01))


def cut_set(scans: ScanSet, range_max: float) -> ScanSet:
    """The scans as a sensor of a shorter reach, metres, would have recorded them."""
    if not range_max > 0:
        raise ConfigError(f"the reach must be positive, got {range_max:g} m")
    cut = (replace(s, range_max=min(s.range_max, range_max)) for s in scans.scans)
    return replace(scans, scans=tuple(cut))
