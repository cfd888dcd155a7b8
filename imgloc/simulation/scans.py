"""Scans of a simulated laser: random poses, cast rays, noise.

A scan must not know the cells of the map in which it is to be located: rays are cast on a
much finer image than the map, :func:`refine_grid` of it or a world's polygons rendered at 1 cm.
"""

from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import numpy.typing as npt

from imgloc.errors import MapError, expect
from imgloc.features.distance import distance_image
from imgloc.features.raycast import cast_rays
from imgloc.geometry import transform_poses, values_at
from imgloc.io.maps import bundled_maps
from imgloc.io.scanset import MAX_READINGS, ScanSet
from imgloc.model import BoolArray, Float32Array, FloatArray, LaserScan, OccupancyGrid, Pose2D
from imgloc.options import Seed, Sensor
from imgloc.ranges import Within, require
from imgloc.simulation.worlds import WORLDS, render

FINE = 0.01  #: cells on which scans are simulated, metres
_MAX_CELLS = 16_000_000
_DRAWS = 100  # of n poses each, before a mounting pose counts as impossible

# Blurred by 0.7 cells, a straight wall of one cell is worth 0.57 at its centre and 0.20 one cell
# off. Raised to 0.8 its outline at 0.5 is again half a cell off, as it was; so with gaps.
_BLUR = 0.7
_THIN, _THIN_VALUE = 0.6, 0.8


def simulate(
    grid: OccupancyGrid,
    n: int,
    seed: int,
    sensor: Sensor | None = None,
    fine: OccupancyGrid | None = None,
) -> ScanSet:
    """Simulate `n` scans at random free poses; the poses of the set are the sensor's, map frame.

    Parameters
    ----------
    seed : int
        Seed of everything random: the same seed gives the same scans. Poses depend on the seed,
        the sensor's mount and its clearance alone.
    fine : OccupancyGrid, optional
        Image on which rays are cast, with the same lower-left corner. By default the map
        redrawn at 1 cm; for a bundled world ``render(world, 0.01)`` is the truth itself.

    Raises
    ------
    MapError, ConfigError
        If no pose has the clearance; if a parameter of the sensor, the seed or `n` is out of its
        range.

    Examples
    --------
    >>> scans = simulate(render(WORLDS["curved"](), 0.1), 2, seed=0)
    >>> scans.scans[0].ranges.shape, scans.poses.shape
    ((181,), (2, 3))
    """
    expect(grid, OccupancyGrid, "grid")
    sensor = sensor or Sensor()
    require(Annotated[int, Within(1, MAX_READINGS // sensor.rays, "scans")], n, "n")
    require(Seed, seed, "seed")
    angles = ray_angles(sensor.rays, sensor.fov)
    seeds = np.random.SeedSequence(seed).generate_state(2)
    poses = sample_free_poses(grid, n, int(seeds[0]), sensor.clearance, sensor.mount)
    ranges = simulate_ranges(
        refine_grid(grid) if fine is None else fine, poses, angles,
        sigma=sensor.sigma, range_max=sensor.range_max, seed=int(seeds[1]),
        outliers=sensor.outliers, dropped=sensor.dropped,
    )  # fmt: skip
    mount = None if sensor.mount == Pose2D(0.0, 0.0) else sensor.mount
    scans = tuple(
        LaserScan(r, angles, range_max=sensor.range_max, T_base_laser=mount) for r in ranges
    )
    return ScanSet(scans, poses=transform_poses(grid.origin, poses))


def simulate_ranges(
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
        Finer than the map in which the scan is to be located, see :func:`refine_grid`.
    poses : (N, 3) array
        Poses of the sensor in the grid frame: metres, metres, radians.
    angles : (B,) array
        Angles of the rays in the sensor's frame, radians.
    sigma, seed : float, int
        Standard deviation of the noise of a reading, metres, and the seed of all noise.
    range_max : float
        Metres; what is farther gives no return.
    outliers, dropped : float
        Shares of the rays, 0..1: stopped by something that the map does not show, anywhere
        between the sensor and the wall (or `range_max`); without any measurement at all.

    Returns
    -------
    (N, B) float array
        Metres; +inf where nothing is met within `range_max`, NaN where dropped (REP 117).

    Examples
    --------
    >>> wall = np.zeros((20, 40), dtype=bool)
    >>> wall[:, 30] = True
    >>> grid = OccupancyGrid(wall, ~wall, 0.1)
    >>> simulate_ranges(grid, [(1.0, 1.0, 0.0)], [0.0, np.pi], sigma=0.0).round(3).tolist()
    [[2.0, inf]]
    """
    at = np.asarray(poses, dtype=np.float64).reshape(-1, 3)
    psi = at[:, 2:] + np.asarray(angles, dtype=np.float64)
    reach = range_max + 5 * sigma  # noise may bring a wall into the sensor's reach
    ranges = cast_rays(distance_image(grid.occupied), at[:, None, :2], psi, reach, grid.resolution)
    out = np.asarray(ranges, dtype=np.float64)
    # Drawn whether used or not: a scan with outliers differs from one without in them alone.
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal(out.shape)
    blocked, where, lost = (rng.random(out.shape) for _ in range(3))
    out = np.where(blocked < outliers, where * np.minimum(out, range_max), out)
    out = np.maximum(out + sigma * noise, 1e-3)  # never 0, which would mean "too close"
    out[out > range_max] = np.inf
    out[lost < dropped] = np.nan
    return out


def ray_angles(rays: int, fov: float) -> FloatArray:
    """Angles (rays,) of a sensor's rays, centred about forward, radians.

    With a full circle the last ray is one step short of the first.

    Examples
    --------
    >>> np.rad2deg(ray_angles(3, np.pi)).tolist(), np.rad2deg(ray_angles(2, 2 * np.pi)).tolist()
    ([-90.0, 0.0, 90.0], [-180.0, 0.0])
    """
    full = fov > 2 * np.pi * (1 - 1e-9)
    return np.linspace(-fov / 2, fov / 2, rays, endpoint=not full)


def sample_free_poses(
    grid: OccupancyGrid, n: int, seed: int, clearance: float = 0.3, mount: Pose2D | None = None
) -> FloatArray:
    """Draw poses (n, 3) uniformly from the free space of a map: metres, theta in [0, 2 pi).

    They are in the grid frame, and not at the centres of cells.

    Parameters
    ----------
    clearance : float
        Metres from the robot to the nearest cell that is not free, or to the map's border.
    mount : Pose2D, optional
        Pose of the sensor on the robot. Then the result holds the **sensor's** poses,
        ``robot ⊕ mount``; a robot whose sensor is not in a free cell is drawn again.

    Raises
    ------
    MapError
        If no cell is free with that clearance, or next to no sensor is in a free cell.

    Examples
    --------
    >>> free = np.zeros((9, 9), dtype=bool)
    >>> free[2:7, 2:7] = True
    >>> grid = OccupancyGrid(~free, free, 0.1)
    >>> robot = sample_free_poses(grid, 1, seed=1, clearance=0.2)
    >>> bool(np.all((robot[:, :2] > 0.4) & (robot[:, :2] < 0.5)))
    True
    >>> sensor = sample_free_poses(grid, 1, 1, 0.2, Pose2D(0.1, 0.0))
    >>> round(float(np.hypot(*(sensor - robot)[0, :2])), 6)
    0.1
    """
    taken = np.pad(~grid.free, 1, constant_values=True).astype(np.uint8)
    # Grown by one cell, so that the distance is from the square of a cell to the next square.
    grown = cv2.dilate(taken, np.ones((3, 3), dtype=np.uint8)) > 0
    room = distance_image(grown)[1:-1, 1:-1] * grid.resolution
    rows, columns = np.nonzero(grid.free & (room >= clearance - 1e-6))
    if not len(rows):
        raise MapError(
            f"no free cell of the map is {clearance} m away from everything that is not free; "
            "expected some: does imgloc map check find negate and free_thresh right? Where places "
            "are narrow, pass a smaller `clearance`"
        )

    def robots(draw: int) -> FloatArray:
        rng = np.random.default_rng(draw)
        pick = rng.integers(len(rows), size=n)
        cells = np.column_stack((columns[pick], rows[pick]))
        xy = (cells + rng.random((n, 2))) * grid.resolution
        return np.column_stack((xy, rng.uniform(0, 2 * np.pi, n)))

    if mount is None:
        return robots(seed)
    found = np.empty((0, 3))
    for draw in (seed, *np.random.SeedSequence(seed).generate_state(_DRAWS).tolist()):
        x, y, theta = robots(int(draw)).T
        # robot ⊕ mount: the mount, turned by the robot's heading
        x = x + (np.cos(theta) * mount.x - np.sin(theta) * mount.y)
        y = y + (np.sin(theta) * mount.x + np.cos(theta) * mount.y)
        sensors = np.column_stack((x, y, (theta + mount.theta) % (2 * np.pi)))
        there = values_at(grid.free, sensors[:, :2], grid.resolution)
        found = np.concatenate((found, sensors[there]))
        if len(found) >= n:
            return found[:n]
    raise MapError(
        f"a sensor mounted at ({mount.x:g}, {mount.y:g}) m is hardly ever in a free cell of "
        "the map; expected metres on the robot"
    )


def refine_grid(grid: OccupancyGrid) -> OccupancyGrid:
    """Redraw a map with smaller cells and smooth outlines, so that walls have no stairs.

    The occupancy image is blurred by 0.7 cells, enlarged bilinearly and cut at one half; walls
    and gaps that are one cell thin are kept. A map whose cells need not be smaller is returned.
    The side of a cell is divided by a whole number to come closest to :data:`FINE`, or by a
    smaller one on a map so large that it would have more than 16 million cells.

    Examples
    --------
    >>> coarse = OccupancyGrid(np.eye(4, dtype=bool), ~np.eye(4, dtype=bool), 0.05)
    >>> refine_grid(coarse).occupied.shape
    (20, 20)
    """
    height, width = grid.occupied.shape
    factor = fine_factor(grid)
    if factor == 1:
        return grid
    size = (width * factor, height * factor)
    occupied = cv2.resize(_smooth(grid.occupied), size, interpolation=cv2.INTER_LINEAR) >= 0.5
    # Along a wall, part of an occupied cell may come out as not occupied: it is free there.
    known = cv2.resize((~grid.unknown).astype(np.uint8), size, interpolation=cv2.INTER_NEAREST)
    return OccupancyGrid(occupied, (known > 0) & ~occupied, grid.resolution / factor, grid.origin)


def fine_factor(grid: OccupancyGrid) -> int:
    """Number of cells of :func:`refine_grid` along a cell of the map."""
    most = int((_MAX_CELLS / grid.occupied.size) ** 0.5)
    return max(1, min(round(grid.resolution / FINE), most))


def _smooth(occupied: BoolArray) -> Float32Array:
    """Blurred occupancy whose outline at 0.5 keeps walls and gaps of a single cell."""
    image = np.asarray(occupied, dtype=np.float32)
    out = cv2.GaussianBlur(image, (0, 0), _BLUR, borderType=cv2.BORDER_REPLICATE)
    out[occupied & (out < _THIN)] = _THIN_VALUE
    out[~occupied & (out > 1 - _THIN)] = 1 - _THIN_VALUE
    return np.asarray(out, dtype=np.float32)


def fine_image(path: Path, grid: OccupancyGrid) -> OccupancyGrid | None:
    """The walls of a bundled world drawn at 1 cm; None for a map of which only cells are known."""
    return render(WORLDS[path.stem](), FINE) if is_world(path, grid) else None


def is_world(path: Path, grid: OccupancyGrid) -> bool:
    """Return whether a map is a bundled one, as it is: more than its cells is known.

    A copy elsewhere is any map; read at another resolution or origin it is not the world any more.
    """
    if path.stem not in WORLDS or path.resolve().parent != bundled_maps().resolve():
        return False
    width, height = (round(side / grid.resolution) for side in WORLDS[path.stem]().size)
    return grid.occupied.shape == (height, width) and grid.origin == Pose2D(0.0, 0.0)
