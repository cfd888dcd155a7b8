"""Scans of a laser that is not there: random poses, cast rays, noise.

A scan must not know the cells of the map in which it is to be located: rays are cast on a
much finer image than the map, :func:`~imgloc.experiments.finegrid.refine_grid` of it or a
world's polygons rendered at 1 cm.
"""

import numpy as np
import numpy.typing as npt

from imgloc.errors import ConfigError
from imgloc.experiments.finegrid import refine_grid
from imgloc.experiments.poses import sample_free_poses, sample_sensor_poses
from imgloc.features.distance import distance_image
from imgloc.features.raycast import cast_rays
from imgloc.model import FloatArray, OccupancyGrid, Pose2D

__all__ = ["sample_free_poses", "sample_sensor_poses", "simulate", "simulate_scans"]


def simulate(
    grid: OccupancyGrid,
    poses: npt.ArrayLike,
    angles: npt.ArrayLike,
    *,
    sigma: float = 0.02,
    range_max: float = 30.0,
    seed: int = 0,
    outliers: float = 0.0,
    dropped: float = 0.0,
) -> FloatArray:
    """Simulate what a laser reads at given poses: a draw from ``p(z | x)`` of eq. 2.

    Parameters
    ----------
    grid : OccupancyGrid
        On which rays are cast: finer than the map in which the scan is to be located, see
        :func:`~imgloc.experiments.finegrid.refine_grid`.
    poses : (N, 3) array
        Of the sensor in the grid frame: metres, metres, radians.
    angles : (B,) array
        Of the rays in the sensor's frame, radians.
    sigma : float
        Standard deviation of the noise of a reading, metres.
    range_max : float
        Metres; what is farther gives no return.
    seed : int
        Seed of the noise.
    outliers : float
        Share of the rays, 0..1, that are stopped by something that the map does not show,
        anywhere between the sensor and the wall (or `range_max`).
    dropped : float
        Share of the rays, 0..1, that give no measurement at all, NaN.

    Returns
    -------
    (N, B) float array
        Metres; +inf where nothing is met within `range_max`, NaN where dropped (REP 117).

    Raises
    ------
    ConfigError
        If a parameter is out of its range.

    Examples
    --------
    >>> wall = np.zeros((20, 40), dtype=bool)
    >>> wall[:, 30] = True
    >>> grid = OccupancyGrid(wall, ~wall, 0.1)
    >>> simulate(grid, [(1.0, 1.0, 0.0)], [0.0, np.pi], sigma=0.0).round(3).tolist()
    [[2.0, inf]]
    """
    if not (np.isfinite(sigma) and sigma >= 0):
        raise ConfigError(f"sigma must be finite and not negative, got {sigma}")
    if not (np.isfinite(range_max) and range_max > 0):
        raise ConfigError(f"range_max must be positive and finite, got {range_max}")
    if not (0 <= outliers <= 1 and 0 <= dropped <= 1):
        raise ConfigError(f"outliers {outliers} and dropped {dropped} are shares between 0 and 1")
    at = np.asarray(poses, dtype=np.float64).reshape(-1, 3)
    psi = at[:, 2:] + np.asarray(angles, dtype=np.float64)
    distance = distance_image(grid.occupied)
    # A little farther than the sensor reaches: noise may bring a wall into its reach.
    reach = range_max + 5 * sigma
    ranges = cast_rays(distance, at[:, None, :2], psi, reach, grid.resolution)
    out = np.asarray(ranges, dtype=np.float64)
    # Drawn whether used or not: a scan with outliers differs from one without in them alone.
    rng = np.random.default_rng(seed)
    noise, blocked, where, lost = (
        rng.standard_normal(out.shape), rng.random(out.shape), rng.random(out.shape),
        rng.random(out.shape),
    )  # fmt: skip
    out = np.where(blocked < outliers, where * np.minimum(out, range_max), out)
    out = np.maximum(out + sigma * noise, 1e-3)  # never 0, which would mean "too close"
    out[out > range_max] = np.inf
    out[lost < dropped] = np.nan
    return out


def ray_angles(rays: int, fov: float) -> FloatArray:
    """Angles (rays,) of a sensor's rays, centred about forward, radians.

    With a full circle the last ray is one step short of the first.

    Raises
    ------
    ConfigError
        If there is no ray, or `fov` is not in (0, 2 pi].

    Examples
    --------
    >>> np.rad2deg(ray_angles(3, np.pi)).tolist(), np.rad2deg(ray_angles(2, 2 * np.pi)).tolist()
    ([-90.0, 0.0, 90.0], [-180.0, 0.0])
    """
    if rays < 1 or not 0 < fov <= 2 * np.pi + 1e-9:
        raise ConfigError(f"rays {rays} must be at least 1 and fov {fov} in (0, 2 pi]")
    full = fov > 2 * np.pi * (1 - 1e-9)
    return np.linspace(-fov / 2, fov / 2, rays, endpoint=not full)


def simulate_scans(
    grid: OccupancyGrid,
    n: int,
    seed: int,
    *,
    rays: int = 181,
    fov: float = np.pi,
    sigma: float = 0.02,
    range_max: float = 30.0,
    outliers: float = 0.0,
    dropped: float = 0.0,
    clearance: float = 0.3,
    mount: Pose2D | None = None,
    fine: OccupancyGrid | None = None,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Simulate scans at random free poses of a map; the defaults are the sensor of Sec. VI.

    Parameters
    ----------
    grid : OccupancyGrid
        The map, from whose free space the poses are drawn.
    n : int
        Number of scans.
    seed : int
        Seed of everything random: the same seed gives the same scans, and poses that do not
        depend on the sensor.
    rays : int
        Readings of a scan.
    fov : float
        Angle between the first and the last ray, radians, see :func:`ray_angles`.
    sigma, range_max, outliers, dropped : float
        See :func:`simulate`.
    clearance : float
        Of the robot, see :func:`~imgloc.experiments.poses.sample_free_poses`.
    mount : Pose2D, optional
        Of the sensor on the robot, whose poses are what is drawn; by default they are one.
    fine : OccupancyGrid, optional
        Image on which rays are cast, with the same lower-left corner. By default the map
        redrawn at 1 cm; for a bundled world ``render(world, 0.01)`` is the truth itself.

    Returns
    -------
    ranges : (n, rays) float array
        Metres, +inf for no return, NaN for dropped.
    angles : (rays,) float array
        Radians, in the sensor's frame.
    poses : (n, 3) float array
        Of the sensor in the grid frame.

    Raises
    ------
    MapError
        If no pose has the clearance.
    ConfigError
        If a parameter is out of its range.
    """
    angles = ray_angles(rays, fov)
    seeds = np.random.SeedSequence(seed).generate_state(2)
    poses = sample_sensor_poses(grid, n, int(seeds[0]), mount or Pose2D(0.0, 0.0), clearance)
    ranges = simulate(
        refine_grid(grid) if fine is None else fine, poses, angles,
        sigma=sigma, range_max=range_max, seed=int(seeds[1]), outliers=outliers, dropped=dropped,
    )  # fmt: skip
    return ranges, angles, poses
