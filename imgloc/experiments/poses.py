"""Where simulated robots stand: poses drawn from the free space of a map."""

import cv2
import numpy as np

from imgloc.errors import MapError
from imgloc.features.distance import distance_image
from imgloc.geometry import cell_of, inside
from imgloc.model import FloatArray, OccupancyGrid, Pose2D

_DRAWS = 100  # of n poses each, before a mounting pose counts as impossible


def sample_free_poses(grid: OccupancyGrid, n: int, seed: int, clearance: float = 0.3) -> FloatArray:
    """Draw poses uniformly from the free space of a map, in the grid frame.

    Parameters
    ----------
    grid : OccupancyGrid
    n : int
        Number of poses.
    seed : int
        Seed of the random generator.
    clearance : float
        Metres to the nearest cell that is not free; the border of the map counts as such.

    Returns
    -------
    (n, 3) float array
        x and y in metres, continuous, and theta in [0, 2 pi).

    Raises
    ------
    MapError
        If no cell is free with that clearance.

    Examples
    --------
    >>> free = np.zeros((9, 9), dtype=bool)
    >>> free[2:7, 2:7] = True
    >>> pose = sample_free_poses(OccupancyGrid(~free, free, 0.1), 1, seed=1, clearance=0.2)
    >>> bool(np.all((pose[:, :2] > 0.4) & (pose[:, :2] < 0.5)))
    True
    """
    taken = np.pad(~grid.free, 1, constant_values=True).astype(np.uint8)
    # Grown by one cell, so that the distance is from the square of a cell to the next square.
    grown = cv2.dilate(taken, np.ones((3, 3), dtype=np.uint8)) > 0
    room = distance_image(grown)[1:-1, 1:-1] * grid.resolution
    rows, columns = np.nonzero(grid.free & (room >= clearance - 1e-6))
    if not len(rows):
        raise MapError(
            f"no free cell of the map is {clearance} m away from everything that is not free; "
            "expected some free space, hint: a smaller clearance or another free_thresh"
        )
    rng = np.random.default_rng(seed)
    pick = rng.integers(len(rows), size=n)
    cells = np.column_stack((columns[pick], rows[pick]))
    xy = (cells + rng.random((n, 2))) * grid.resolution
    return np.column_stack((xy, rng.uniform(0, 2 * np.pi, n)))


def sample_sensor_poses(
    grid: OccupancyGrid, n: int, seed: int, mount: Pose2D, clearance: float = 0.3
) -> FloatArray:
    """Draw poses of a sensor that is mounted on a robot, in the grid frame.

    Parameters
    ----------
    grid : OccupancyGrid
    n : int
        Number of poses.
    seed : int
        Draws the poses of the robot, as :func:`sample_free_poses` does.
    mount : Pose2D
        Of the sensor on the robot. A robot whose sensor is not in a free cell is drawn again.
    clearance : float
        Of the robot, see :func:`sample_free_poses`.

    Returns
    -------
    (n, 3) float array
        Poses of the **sensor**, ``robot ⊕ mount``; theta in [0, 2 pi).

    Raises
    ------
    MapError
        If no robot has the clearance, or next to none has its sensor in a free cell.

    Examples
    --------
    >>> grid = OccupancyGrid(np.zeros((20, 20), bool), np.ones((20, 20), bool), 1.0)
    >>> robot = sample_free_poses(grid, 1, seed=1)[0]
    >>> sensor = sample_sensor_poses(grid, 1, 1, Pose2D(0.2, 0.0, np.pi))[0]
    >>> round(float(np.hypot(*(sensor - robot)[:2])), 6)
    0.2
    """
    found = np.empty((0, 3))
    seeds = (seed, *np.random.SeedSequence(seed).generate_state(_DRAWS).tolist())
    for draw in seeds:
        robots = sample_free_poses(grid, n, int(draw), clearance)
        # robot ⊕ mount: the mount, turned by the robot's heading
        c, s = np.cos(robots[:, 2]), np.sin(robots[:, 2])
        sensors = np.column_stack(
            (
                robots[:, 0] + c * mount.x - s * mount.y,
                robots[:, 1] + s * mount.x + c * mount.y,
                (robots[:, 2] + mount.theta) % (2 * np.pi),
            )
        )
        cells = cell_of(sensors[:, :2], grid.resolution)
        on_map = inside(cells, grid.info)
        row, column = cells[on_map].T
        found = np.concatenate((found, sensors[on_map][grid.free[row, column]]))
        if len(found) >= n:
            return found[:n]
    raise MapError(
        f"a sensor mounted at ({mount.x:g}, {mount.y:g}) m is hardly ever in a free cell of "
        "the map; expected metres on the robot"
    )
