"""Peaks of a stack (theta, y, x), with theta circular."""

from collections.abc import Iterator

import cv2
import numpy as np
import numpy.typing as npt

from imgloc.geometry import wrap
from imgloc.likelihood.posterior import smooth
from imgloc.model import BoolArray, Float32Array, FloatArray, IntArray

__all__ = ["find_peaks", "first_in_cell", "separated", "smooth"]

_FEW = 4096  # peaks sorted at a time


def find_peaks(
    values: Float32Array, n: int, *, radius: int = 1, where: BoolArray | None = None
) -> IntArray:
    """Local maxima of a stack, best first.

    Parameters
    ----------
    values : (K, H, W) float32 array
    n : int
        At most so many.
    radius : int
        A peak is the largest of the ``2 radius + 1`` cells and headings around it, theta
        wrapping around. Of equal neighbours the first in index order stays.
    where : (H, W) bool array, optional
        Cells that may hold a peak.

    Returns
    -------
    (M, 3) int array
        ``(theta, row, col)`` of values above 0.

    Examples
    --------
    >>> stack = np.zeros((4, 1, 5), dtype=np.float32)
    >>> stack[0, 0, 1], stack[3, 0, 1], stack[2, 0, 4] = 3, 5, 2
    >>> find_peaks(stack, 9).tolist()
    [[3, 0, 1], [2, 0, 4]]
    """
    cells = _local_maxima(values, radius, where)
    scores = values.ravel()[cells]
    kept: list[npt.NDArray[np.int64]] = []
    for some in _falling(scores):
        for cell in np.stack(np.unravel_index(cells[some], values.shape), axis=1):
            if len(kept) == n:
                return np.asarray(kept, dtype=np.int64).reshape(-1, 3)
            # Of a plateau only the first stays.
            gap = np.abs(np.asarray(kept).reshape(-1, 3) - cell)
            gap[:, 0] = np.minimum(gap[:, 0], len(values) - gap[:, 0])
            if not (gap <= radius).all(axis=1).any():
                kept.append(cell)
    return np.asarray(kept, dtype=np.int64).reshape(-1, 3)


def _local_maxima(values: Float32Array, radius: int, where: BoolArray | None) -> IntArray:
    """Flat indices, in order, of what is positive and no less than anything in its window.

    The headings of a window are held in a ring, so that they are dilated once and stay in the
    cache.
    """
    n, height, width = values.shape
    kernel = np.ones((2 * radius + 1, 2 * radius + 1), dtype=np.uint8)
    reach = min(radius, n - 1)
    ring = np.empty((2 * reach + 1, height, width), dtype=np.float32)
    top = np.empty((height, width), dtype=np.float32)

    def allowed(k: int) -> Float32Array:
        image = values[k % n]
        return image if where is None else np.where(where, image, np.float32(0))

    found = []
    for k in range(-2 * reach, n):
        cv2.dilate(allowed(k + reach), kernel, dst=ring[k % len(ring)])
        if k >= 0:
            image = allowed(k)
            np.max(ring, axis=0, out=top)
            found.append(np.flatnonzero((image == top) & (image > 0)) + k * top.size)
    return np.concatenate(found)


def _falling(scores: Float32Array) -> Iterator[IntArray]:
    """Indices by falling score, equal ones in their order, a few at a time.

    A stack without information is one plateau: millions of peaks that need not be sorted.
    """
    rest = np.arange(len(scores))
    if len(scores) > _FEW:
        level = np.partition(scores, -_FEW)[-_FEW]
        better, equal = np.flatnonzero(scores > level), np.flatnonzero(scores == level)
        yield better[np.argsort(-scores[better], kind="stable")]
        for start in range(0, len(equal), _FEW):
            yield equal[start : start + _FEW]
        rest = np.flatnonzero(scores < level)
    yield rest[np.argsort(-scores[rest], kind="stable")]


def first_in_cell(poses: FloatArray, distance: float, angle: float) -> IntArray:
    """Indices, in order, of the poses (M, 3) that are the first in their cell of pose space.

    Parameters
    ----------
    poses : (M, 3) float array
        Metres, metres, radians.
    distance, angle : float
        Sides of a cell, metres and radians; those of the headings all fit the circle.

    Examples
    --------
    >>> poses = np.array([[0.01, 0, 3.1], [0.02, 0, 3.1], [0.01, 0, 3.1 - 2 * np.pi]])
    >>> first_in_cell(poses, 0.1, 0.2).tolist()
    [0]
    """
    turn = max(1, round(2 * np.pi / angle))
    x, y = np.floor(poses[:, :2] / distance).T
    heading = np.floor(poses[:, 2] * (turn / (2 * np.pi))) % turn
    order = np.lexsort((x, y, heading))  # stable: the first of a cell comes first
    cells = np.stack((x, y, heading))[:, order]
    new = np.any(np.diff(cells, axis=1, prepend=np.nan) != 0, axis=0)
    return np.sort(order[new])


def separated(
    poses: FloatArray, n: int, *, distance: float, angle: float
) -> tuple[IntArray, IntArray]:
    """Pick poses, best first, that are not another one's neighbour.

    Parameters
    ----------
    poses : (M, 3) float array
        Best first: metres, metres, radians.
    n : int
        At most so many.
    distance, angle : float
        Two poses are neighbours if they are closer than both, metres and radians.

    Returns
    -------
    picked : (K,) int array
        Indices of the picked poses.
    owner : (M,) int array
        For each pose the position in `picked` of the pose it is a neighbour of, or -1.

    Examples
    --------
    >>> poses = np.array([[0, 0, 3.1], [0.1, 0, -3.1], [5, 0, 0.0]])
    >>> [a.tolist() for a in separated(poses, 9, distance=0.5, angle=0.2)]
    [[0, 2], [0, 0, 1]]
    """
    owner = np.full(len(poses), -1, dtype=np.int64)
    x, y, theta = np.ascontiguousarray(poses.T)
    theta = wrap(theta)
    picked: list[int] = []
    for i in range(len(poses)):
        if len(picked) == n:
            break
        if owner[i] >= 0:
            continue
        near = np.square(x - x[i]) + np.square(y - y[i]) < distance * distance
        turn = np.abs(theta - theta[i])
        near &= np.minimum(turn, 2 * np.pi - turn) < angle
        owner[near & (owner < 0)] = len(picked)
        picked.append(i)
    return np.asarray(picked, dtype=np.int64), owner
