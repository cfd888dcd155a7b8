"""Angles, arrays of poses, and the one place where cells, grid frame and map frame meet."""

from collections.abc import Iterable
from dataclasses import replace
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from imgloc.errors import ConfigError
from imgloc.model import (
    FloatArray,
    GridInfo,
    Hypothesis,
    IntArray,
    OccupancyGrid,
    Pose2D,
    compose,
    inverse,
)


def wrap(angle: npt.ArrayLike) -> FloatArray:
    """Wrap angles to (-pi, pi].

    Examples
    --------
    >>> wrap([-np.pi, 4.0]).round(4).tolist()
    [3.1416, -2.2832]
    """
    out = np.pi - (np.pi - np.asarray(angle, dtype=np.float64)) % (2 * np.pi)
    return np.where(out <= -np.pi, np.pi, out)  # the remainder may round up to 2 pi


def uniform_thetas(step: float) -> FloatArray:
    """Headings ``0, step', 2 step', ...`` over the circle, with step' <= step dividing it.

    Examples
    --------
    >>> np.rad2deg(uniform_thetas(np.deg2rad(90))).tolist()
    [0.0, 90.0, 180.0, 270.0]
    """
    n = max(1, int(np.ceil(2 * np.pi / step - 1e-9)))
    return np.arange(n, dtype=np.float64) * (2 * np.pi / n)


def theta_bin(theta: npt.ArrayLike, n: int) -> IntArray:
    """Index of the nearest of `n` uniform headings, circular (the inverse of uniform_thetas).

    Examples
    --------
    >>> theta_bin([0.0, -0.1, 3.2], 4).tolist()
    [0, 0, 2]
    """
    return np.floor(np.asarray(theta) * (n / (2 * np.pi)) + 0.5).astype(np.int64) % n


def poses_of(hypotheses: Iterable[Hypothesis]) -> FloatArray:
    """Poses (M, 3) of hypotheses: metres, metres, radians, in their frame."""
    poses = [(h.pose.x, h.pose.y, h.pose.theta) for h in hypotheses]
    return np.array(poses, dtype=np.float64).reshape(-1, 3)


def rotation(theta: float) -> FloatArray:
    """Return the (2, 2) matrix that rotates column vectors by `theta`."""
    c, s = np.cos(theta), np.sin(theta)
    return np.array([[c, -s], [s, c]])


def transform_points(pose: Pose2D, xy: FloatArray) -> FloatArray:
    """Points (N, 2) of the frame at `pose`, in the parent frame: ``p ⊕ pose`` of the paper."""
    return xy @ rotation(pose.theta).T + (pose.x, pose.y)


def transform_poses(pose: Pose2D, poses: FloatArray) -> FloatArray:
    """Poses (N, 3) of the frame at `pose`, in the parent frame; theta wrapped.

    ``transform_poses(grid.origin, poses)`` takes grid frame to map frame, and
    ``transform_poses(inverse(grid.origin), poses)`` takes it back.
    """
    poses = np.asarray(poses, dtype=np.float64)
    xy = transform_points(pose, poses[:, :2])
    return np.column_stack((xy, wrap(poses[:, 2] + pose.theta)))


def rotate_covariance(covariance: FloatArray, theta: float) -> FloatArray:
    """Covariance (3, 3) of (x, y, theta) seen from a frame rotated by `theta`."""
    R = np.eye(3)
    R[:2, :2] = rotation(theta)
    return np.asarray(R @ covariance @ R.T)


Framed = TypeVar("Framed", Pose2D, Hypothesis)
Value = TypeVar("Value", bound=np.generic)


def in_map_frame(given: Framed, grid: GridInfo | OccupancyGrid) -> Framed:
    """Take a pose or a hypothesis from the grid frame to the map frame: origin and its yaw."""
    return _seen_from(given, grid.origin)


def in_grid_frame(given: Framed, grid: GridInfo | OccupancyGrid) -> Framed:
    """Take a pose or a hypothesis from the map frame to the grid frame.

    Examples
    --------
    >>> in_grid_frame(Pose2D(3.0, 2.0, 0.5), GridInfo(9, 9, 0.1, Pose2D(1.0, 1.0)))
    Pose2D(x=2.0, y=1.0, theta=0.5)
    """
    return _seen_from(given, inverse(grid.origin))


def _seen_from(given: Framed, origin: Pose2D) -> Framed:
    if isinstance(given, Hypothesis):
        covariance = rotate_covariance(given.covariance, origin.theta)
        return replace(given, pose=compose(origin, given.pose), covariance=covariance)
    return compose(origin, given)


def cell_of(xy: FloatArray, resolution: float) -> IntArray:
    """Cells (..., 2) as (row, col) that hold the points (..., 2) of the grid frame.

    Cell ``[r, c]`` covers ``[c, c + 1) x [r, r + 1)`` times the resolution; cells outside the
    grid come out with indices outside it, never clamped.

    Examples
    --------
    >>> cell_of(np.array([[0.0, 0.19]]), 0.1).tolist()
    [[1, 0]]
    """
    return np.floor(xy[..., ::-1] / resolution).astype(np.int64)


def centre_of(cells: npt.NDArray[np.integer], resolution: float) -> FloatArray:
    """Centres (..., 2) as (x, y) in the grid frame of the cells (..., 2) given as (row, col)."""
    return np.asarray((cells[..., ::-1] + 0.5) * resolution)


def inside(cells: IntArray, grid: GridInfo) -> npt.NDArray[np.bool_]:
    """Return whether each (row, col) of (..., 2) lies on the grid."""
    r, c = cells[..., 0], cells[..., 1]
    return (r >= 0) & (r < grid.height) & (c >= 0) & (c < grid.width)


def point_on(grid: OccupancyGrid, at: tuple[float, float]) -> FloatArray:
    """A point (x, y) of the map frame in the grid frame, (2,); a ConfigError beyond the map."""
    there = in_grid_frame(Pose2D(*at), grid)
    xy = np.array([there.x, there.y])
    if not inside(cell_of(xy, grid.resolution), grid.info):
        raise ConfigError(f"`at`: {at[0]:g},{at[1]:g} is not on the map, expected a point of it")
    return xy


def values_at(image: npt.NDArray[Value], xy: FloatArray, resolution: float) -> npt.NDArray[Value]:
    """Values (N,) of an image (H, W) under points (N, 2) of the grid frame; 0 beyond its edge.

    Examples
    --------
    >>> values_at(np.array([[1, 2]]), np.array([[0.15, 0.05], [0.25, 0.05], [-0.01, 0.0]]), 0.1)
    array([2, 0, 0])
    """
    cells = cell_of(xy, resolution)
    on = ((cells >= 0) & (cells < image.shape)).all(axis=1)
    out = np.zeros(len(cells), image.dtype)
    out[on] = image[tuple(cells[on].T)]
    return out


def pose_errors(poses: FloatArray, truth: Pose2D | FloatArray) -> FloatArray:
    """Distances in metres and angles in radians, (..., 2), from poses (..., 3) to the true ones.

    Examples
    --------
    >>> pose_errors(np.array([[3.0, 4.0, 3.0]]), Pose2D(0, 0, -3.0)).round(3).tolist()
    [[5.0, 0.283]]
    """
    true = np.array([*truth]) if isinstance(truth, Pose2D) else truth
    apart = np.asarray(poses, dtype=np.float64) - true
    away = np.hypot(apart[..., 0], apart[..., 1])
    return np.stack((away, np.abs(wrap(apart[..., 2]))), axis=-1)
