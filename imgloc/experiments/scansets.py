"""The scans of an experiment, with the true pose of each: simulated, or recorded."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from imgloc.errors import ConfigError, ScanError
from imgloc.experiments.finegrid import FINE
from imgloc.experiments.simulate import simulate_scans
from imgloc.experiments.worlds import WORLDS, render
from imgloc.geometry import transform_poses
from imgloc.io.maps import bundled_maps
from imgloc.io.scanset import ScanSet
from imgloc.model import LaserScan, OccupancyGrid, Pose2D


@dataclass(frozen=True)
class Sensor:
    """A simulated laser; the defaults are that of Sec. VI, with a reach of 30 m.

    Parameters
    ----------
    rays : int
    fov : float
        Radians, see :func:`~imgloc.experiments.simulate.simulate_scans`.
    sigma, range_max : float
        Noise of a reading and reach, metres.
    outliers, dropped : float
        Shares of the rays, see :func:`~imgloc.experiments.simulate.simulate`.
    clearance : float
        Of the robot, metres.
    mount : Pose2D
        Of the sensor on the robot.
    """

    rays: int = 181
    fov: float = np.pi
    sigma: float = 0.02
    range_max: float = 30.0
    outliers: float = 0.0
    dropped: float = 0.0
    clearance: float = 0.3
    mount: Pose2D = field(default_factory=lambda: Pose2D(0.0, 0.0))


def simulate_set(
    grid: OccupancyGrid, n: int, seed: int, sensor: Sensor, fine: OccupancyGrid | None = None
) -> ScanSet:
    """Simulate scans at random free poses; the poses of the set are the sensor's, map frame.

    Parameters
    ----------
    grid : OccupancyGrid
    n : int
    seed : int
        Of everything random.
    sensor : Sensor
    fine : OccupancyGrid, optional
        On which rays are cast, see :func:`~imgloc.experiments.simulate.simulate_scans`.

    Raises
    ------
    MapError
        If no pose has the clearance.
    ConfigError
        If a parameter of the sensor or the seed is out of its range.
    """
    _check_seed(seed)
    ranges, angles, poses = simulate_scans(
        grid, n, seed,
        rays=sensor.rays, fov=sensor.fov, sigma=sensor.sigma, range_max=sensor.range_max,
        outliers=sensor.outliers, dropped=sensor.dropped, clearance=sensor.clearance,
        mount=sensor.mount, fine=fine,
    )  # fmt: skip
    scans = tuple(
        LaserScan(r, angles, range_max=sensor.range_max, T_base_laser=sensor.mount) for r in ranges
    )
    return ScanSet(scans, poses=transform_poses(grid.origin, poses))


def sample_set(scans: ScanSet, n: int | None, seed: int, name: str = "scans") -> ScanSet:
    """Pick `n` recorded scans at random, without repetition; None takes all, in order.

    The indices are ``numpy.random.default_rng(seed).choice(N, min(n, N), replace=False)``.

    Raises
    ------
    ScanError
        If the set has no poses to compare with; `name` is what the message calls it.
    ConfigError
        If the seed is negative.

    Examples
    --------
    >>> line = ScanSet(tuple(LaserScan([k], [0]) for k in range(5)), poses=np.zeros((5, 3)))
    >>> [int(s.ranges[0]) for s in sample_set(line, 3, 1).scans]
    [2, 1, 3]
    """
    if scans.poses is None:
        raise ScanError(f"{name}: no poses; expected the true pose of each scan to compare with")
    _check_seed(seed)
    if n is None:
        return scans
    pick = np.random.default_rng(seed).choice(len(scans), min(n, len(scans)), replace=False)
    return ScanSet(tuple(scans[int(k)] for k in pick), poses=scans.poses[pick])


def _check_seed(seed: int) -> None:
    if seed < 0:
        raise ConfigError(f"the seed must be at least 0, got {seed}")


def fine_image(path: Path, grid: OccupancyGrid) -> OccupancyGrid | None:
    """The walls of a bundled world drawn at 1 cm; None for a map of which only cells are known.

    Parameters
    ----------
    path : Path
        Of the map. A copy of a bundled map elsewhere is any map.
    grid : OccupancyGrid
        As loaded: read at another resolution or origin it is not the world any more.
    """
    return render(WORLDS[path.stem](), FINE) if is_world(path, grid) else None


def is_world(path: Path, grid: OccupancyGrid) -> bool:
    """Whether a map is a bundled one, as it is: more than its cells is known."""
    if path.stem not in WORLDS or path.resolve().parent != bundled_maps().resolve():
        return False
    width, height = (round(side / grid.resolution) for side in WORLDS[path.stem]().size)
    return grid.occupied.shape == (height, width) and grid.origin == Pose2D(0.0, 0.0)
