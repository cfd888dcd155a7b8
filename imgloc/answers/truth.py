"""Recorded poses, checked: scans at true ones lie on the walls of the map there, not beside it."""

import logging
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import cv2
import numpy as np

from imgloc.answers.scanmotion import LEAST, PAIRS, RAYS
from imgloc.features.scanpoints import evenly, scan_xy
from imgloc.geometry import in_grid_frame
from imgloc.io.scanset import ScanSet
from imgloc.model import BoolArray, FloatArray, LaserScan, OccupancyGrid, Pose2D
from imgloc.numbers import number
from imgloc.options import EvidenceModel

_LOG = logging.getLogger("imgloc")
_AROUND, _APART = number("truth.around"), number("truth.apart")
_SHARE, _BEST = number("truth.fits")
#: What may be wrong with all scans of a file, and what mends it.
WAYS: Mapping[str, Callable[[LaserScan], LaserScan]] = {
    "": lambda scan: scan,
    "flipped": lambda scan: scan.flipped,
    "centimetres": lambda scan: scan.scaled(0.01),
    "millimetres": lambda scan: scan.scaled(0.001),
}
NOT_TRUE = (
    "the recorded poses do not match this map, so imgloc treats them as odometry; they may be in "
    "the frame of another map"
)


def poses_fit(grid: OccupancyGrid, scans: Sequence[LaserScan], poses: FloatArray) -> bool | None:
    """Return whether scans fit a map at poses that are given; None if they have too few readings.

    They fit if most of them have more readings near walls at their poses than elsewhere within 3 m
    and 10 degrees, or nearly as many.

    Parameters
    ----------
    grid : OccupancyGrid
    scans : sequence of LaserScan
    poses : (N, 3) float array
        Poses of the sensors, map frame: metres, metres, radians.

    Examples
    --------
    >>> wall = np.pad(np.zeros((60, 80), bool), 2, constant_values=True)
    >>> grid = OccupancyGrid(wall, ~wall, 0.1)
    >>> from imgloc.simulation.scans import simulate
    >>> known = simulate(grid, 3, seed=1)
    >>> poses_fit(grid, known.scans, known.poses), poses_fit(grid, known.scans, known.poses + 1.5)
    (True, False)
    """
    walls = near_walls(grid)
    shares = list[tuple[float, float]]()
    for k in evenly(len(scans), PAIRS).tolist():
        xy = scan_xy(scans[k])[scans[k].valid]
        xy = xy[evenly(len(xy), RAYS)]
        if len(xy) >= LEAST:
            pose = np.array([*in_grid_frame(Pose2D(*poses[k]), grid)])
            shares.append(shares_around(walls, grid.resolution, xy, pose))
    if not shares:
        return None
    here, best = np.median(shares, axis=0)
    ratio = float(np.median([a / b if b else 0.0 for a, b in shares]))
    return bool(here >= _SHARE and ratio >= _BEST and best > 0)


def tried_of(scans: ScanSet) -> ScanSet:
    """The scans of a file by which its poses are judged: a few, in even steps."""
    return scans.take(evenly(len(scans), PAIRS).tolist())


def with_true_poses(
    scans: ScanSet, grid: OccupancyGrid, name: str, tried: ScanSet | None = None
) -> ScanSet:
    """The scans; if by :func:`poses_fit` their poses do not fit, as odometry, with a warning.

    Poses are true, too, if the scans fit there in another unit, or turned over. `name` is that of
    the file, for the warning. `tried` are :func:`tried_of` the whole file, of which `scans` may be
    one: odometry may fit the map at one scan by chance.
    """
    few = tried_of(scans) if tried is None else tried
    if scans.poses is None or few.poses is None:
        return scans
    fits = (poses_fit(grid, [way(s) for s in few.scans], few.poses) for way in WAYS.values())
    if any(fit is not False for fit in fits):
        return scans
    _LOG.warning("%s: %s", name, NOT_TRUE)
    return replace(scans, poses=None, odom=scans.poses if scans.odom is None else scans.odom)


def near_walls(grid: OccupancyGrid) -> BoolArray:
    """(H + 2, W + 2) bool: the cells that are a wall, or near one. None is beyond the map."""
    r = max(1, round(max(EvidenceModel.sigmas) / grid.resolution))
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * r + 1, 2 * r + 1))
    return np.pad(cv2.dilate(grid.occupied.astype(np.uint8), disc).astype(bool), 1)


def steps_around(far: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
    """Steps on both sides of 0 and 0 itself, at most `far`: metres (N,), and radians (M,)."""
    some = (math.floor(most / step) for most, step in zip(far, _APART, strict=True))
    along, turn = (np.arange(-n, n + 1) * step for n, step in zip(some, _APART, strict=True))
    return along, turn


def shares_around(
    walls: BoolArray, resolution: float, xy: FloatArray, pose: FloatArray
) -> tuple[float, float]:
    """Share of the points xy (N, 2), sensor frame, that are near walls at a pose (3,).

    The second is the greatest share at the poses around it.
    """
    steps, turns = steps_around(_AROUND)
    cos, sin = np.cos(pose[2] + turns)[:, None, None], np.sin(pose[2] + turns)[:, None, None]
    x = cos * xy[:, 0] - sin * xy[:, 1] + (pose[0] + steps)[:, None]
    y = sin * xy[:, 0] + cos * xy[:, 1] + (pose[1] + steps)[:, None]
    # A step along x changes no row, so there are as few cells to compute as steps, not poses.
    column, row = (
        1 + np.clip(np.floor(v / resolution), -1, n - 2).astype(np.int64)
        for v, n in zip((x, y), walls.shape[::-1], strict=True)
    )
    at = walls.ravel()[row[:, :, None] * walls.shape[1] + column[:, None]].mean(axis=-1)
    return float(at[tuple(n // 2 for n in at.shape)]), float(at.max())
