"""The surface of a map: points on the boundary between occupied and free, with normals.

Not the centres of occupied cells: the iso-contour of the occupancy image. The two sides of a wall
are two surfaces with opposite normals, however thin it is, which Fig. 4 of the paper depends on.
"""

import itertools

import cv2
import numpy as np

from imgloc.geometry import values_at, wrap
from imgloc.model import BoolArray, FloatArray, IntArray, OrientedPoints

# Half-widths of the windows of the line fit, points: a wide one averages the staircase of a slanted
# wall away, a narrow one follows a curve.
_WINDOWS = (8, 5, 3)
# A digital straight line stays within this rms distance (cells) of the line it draws: the
# staircase gives 1/sqrt(12). A window with more has a corner or a curve in it.
_STRAIGHT = 0.29
# The narrowest window around a right angle has about 0.6, around a circle of 4 cells 0.4.
_CORNER = 0.45
# Free space begins at most this far (cells) in front of a surface: maps made by counting hits
# have single unknown cells between a wall and the room.
_REACH = 1.5
# The direction (0 to 7, 45 degrees each) of the neighbour [dx, dy]; a cell alone came from nowhere,
# and is gone around from a corner. And from a cell's middle to its sides: directions 0, 2, 4, 6.
_COMPASS = np.array([[1, 2, 6], [0, 1, 7], [4, 3, 5]])
_SIDE = np.array([(0.5, 0.0), (0.0, 0.5), (-0.5, 0.0), (0.0, -0.5)])
# A map is worked on in bands of rows with so many sides of walls, or so many cells: the fit keeps
# hundreds of bytes for each vertex. A fit looks into the rows around a band.
_SIDES, _CELLS = 1 << 17, 1 << 24
_HALO = 2 * max(_WINDOWS)
_MAX_SIGMA = np.pi / 4  # radians: normals that are less certain are marked invalid


def surface_points(occupied: BoolArray, free: BoolArray, resolution: float) -> OrientedPoints:
    """Sample the boundary between occupied and free space, with directed normals.

    Parameters
    ----------
    occupied, free : (H, W) bool arrays
        Row 0 is the lowest y. There is no surface between a wall and unknown space, cells that are
        neither, nor between a wall and the edge of the map.
    resolution : float
        Side of a cell, metres.

    Returns
    -------
    OrientedPoints
        In the grid frame, one per cell length of boundary, contour after contour; `alpha` points
        from the wall into free space.

    Notes
    -----
    The polygons of :func:`outlines` are resampled to one point per cell, moved
    onto the line fitted to the widest window around it that is a digital straight line. Where none
    is, the windows that end at the point are tried too: a corner keeps the normals of its two walls
    instead of their mean (the filter of Kuwahara, on a curve).

    Examples
    --------
    A wall one cell thick has two surfaces, half a cell to either side of its centre line:

    >>> wall = np.zeros((5, 40), bool)
    >>> wall[2] = True
    >>> points = surface_points(wall, ~wall, 0.1)
    >>> up = points.alpha > 0
    >>> [round(float(np.median(points.xy[side, 1])), 3) for side in (up, ~up)]
    [0.3, 0.2]
    """
    parts = [_surface_of(occupied, free, *band) for band in _bands(occupied)]
    points, alpha, sigma = (np.concatenate(column) for column in zip(*parts, strict=True))
    return OrientedPoints(points * resolution, alpha, sigma, sigma <= _MAX_SIGMA)


def _bands(occupied: BoolArray) -> list[tuple[int, int]]:
    """Cut the rows into bands of bounded work: first row, and the one after the last."""
    height, width = occupied.shape
    sides = np.zeros(height, np.int64)
    for row in range(height):  # by row: the differences of a whole map would be another map
        sides[row] = np.count_nonzero(occupied[row, 1:] != occupied[row, :-1])
        sides[row] += np.count_nonzero(occupied[row] != occupied[row - 1])  # row 0: the last
    part = np.maximum(np.cumsum(sides) // _SIDES, np.arange(height) // max(1, _CELLS // width))
    cuts = [0, *(np.flatnonzero(np.diff(part)) + 1).tolist(), height]
    return list(itertools.pairwise(cuts))


def _surface_of(
    occupied: BoolArray, free: BoolArray, top: int, bottom: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Points in cells, normals and their deviations, of the surface in some rows."""
    low, high = max(0, top - _HALO), min(len(occupied), bottom + _HALO)
    vertices, size = outlines(occupied[low:high])
    vertices[:, 1] += low
    points, start, length = _resampled(vertices, size)
    mine = (points[:, 1] >= top) & (points[:, 1] < bottom)
    if (low, high) == (0, len(occupied)):
        mine[:] = True
    points, alpha, sigma = (part[mine] for part in _fit(points, start, length))
    # Only what faces free space; normals that are not known at all become NaN.
    normal = np.column_stack((np.cos(alpha), np.sin(alpha)))
    keep, far = (values_at(free, points + away * normal, 1.0) for away in (0.5, _REACH))
    keep |= far
    return points[keep], np.where(np.isfinite(sigma), alpha, np.nan)[keep], sigma[keep]


def outlines(occupied: BoolArray) -> tuple[FloatArray, IntArray]:
    """Outline every wall and every hole in one, closed polygons with the wall on their right.

    Beyond the (H, W) map nothing is occupied; cells that touch at a corner hold together.

    Returns
    -------
    vertices, size : (N, 2) float and (M,) int arrays
        Midpoints (x, y) of the sides between an occupied and another cell, in cells, ``[0, 0]``
        from 0 to 1, and their number in each polygon, whose first is its last, too.

    Notes
    -----
    The same to the bit as :func:`skimage.measure.find_contours` at 0.5 (``fully_connected="high"``,
    ``positive_orientation="high"``), several times as fast, and other threads run meanwhile.

    Examples
    --------
    >>> vertices, size = outlines(np.array([[False, True]]))
    >>> vertices.tolist(), size.tolist()
    ([[1.5, 1.0], [2.0, 0.5], [1.5, 0.0], [1.0, 0.5], [1.5, 1.0]], [5])
    """
    contours, _ = cv2.findContours(
        np.pad(occupied, 1).view(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE
    )
    if not contours:
        return np.zeros((0, 2)), np.zeros(0, np.int64)
    size = np.array([len(contour) for contour in contours])
    cell = np.concatenate(contours)[:, 0] - 1
    following = _following(size)
    ahead = cell[following] - cell
    back = np.empty_like(ahead)
    back[following] = -ahead
    # Around each cell, from the cell before to the cell after it, lie cells that are not occupied:
    # a side of the wall is there where such a neighbour is one of the four.
    came, goes = _COMPASS[tuple(back.T)], _COMPASS[tuple(ahead.T)]
    turn = (came[:, None] - np.arange(1, 8)) % 8
    side = (np.arange(7) < (came - goes - 1)[:, None] % 8) & (turn % 2 == 0)
    at = np.nonzero(side)[0]
    vertices = cell[at] + 0.5 + _SIDE[turn[side] // 2]
    size = np.add.reduceat(side.sum(axis=1), np.cumsum(size) - size)
    # Polygons and their first vertices in the order of find_contours: by the corners of cells that
    # each step goes around, the first one of a polygon and the last.
    first, following = np.cumsum(size) - size, _following(size)
    corner = np.rint((vertices + vertices[following]) / 2) @ [1, occupied.shape[1] + 1]
    start = np.flatnonzero(corner == np.repeat(np.maximum.reduceat(corner, first), size)) - first
    order = np.argsort(np.minimum.reduceat(corner, first))
    size, start, first = size[order], start[order], first[order]
    rank = np.arange(np.sum(size + 1)) - np.repeat(np.cumsum(size + 1) - size - 1, size + 1)
    rank = (rank + np.repeat(start, size + 1)) % np.repeat(size, size + 1)
    return vertices[np.repeat(first, size + 1) + rank], size + 1


def _following(size: IntArray) -> IntArray:
    """Give the index of the next one in closed polygons of so many vertices, end to end."""
    last = np.cumsum(size) - 1
    following = np.arange(1, size.sum() + 1)
    following[last] = last - size + 1
    return following


def _resampled(vertices: FloatArray, size: IntArray) -> tuple[FloatArray, IntArray, IntArray]:
    """Points (N, 2) along polygons, one per cell of arc length; first and number in the polygon."""
    if len(size) == 0:
        none = np.zeros(0, np.int64)
        return np.zeros((0, 2)), none, none
    # One arc length over all polygons, so that one interpolation resamples them all.
    first = np.cumsum(size) - size
    step = np.hypot(*np.diff(vertices, axis=0, prepend=vertices[:1]).T)
    step[first] = 1.0  # apart from the polygon before it
    arc = np.cumsum(step)
    perimeter = arc[first + size - 1] - arc[first]
    count = np.maximum(np.round(perimeter).astype(np.int64), 4)
    start = np.repeat(np.cumsum(count) - count, count)
    rank = np.arange(count.sum()) - start
    at = np.repeat(arc[first], count) + rank * np.repeat(perimeter / count, count)
    xy = np.column_stack([np.interp(at, arc, vertices[:, axis]) for axis in (0, 1)])
    return xy, start, np.repeat(count, count)


def _fit(
    points: FloatArray, start: IntArray, length: IntArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Fit a line at each point; return the points on their lines, normals and deviations."""
    n = len(points)
    index = np.arange(n)

    def neighbour(k: int) -> IntArray:
        return np.asarray(start + (index - start + k) % length)

    # Moments of the window (relative to its centre, in cells), widened step by step.
    mean, square, cross = np.zeros((n, 2)), np.zeros((n, 2)), np.zeros(n)
    fits: dict[int, FloatArray] = {}  # (n, 5): direction, residual, sigma, and the window's middle
    for k in range(1, max(_WINDOWS) + 1):
        after, before = points[neighbour(k)] - points, points[neighbour(-k)] - points
        mean += after + before
        square += after**2 + before**2
        cross += after[:, 0] * after[:, 1] + before[:, 0] * before[:, 1]
        if k in (1, 2, *_WINDOWS):
            m = 2 * k + 1
            cov = (square - mean**2 / m) / m
            line = _principal(cov, cross / m - mean.prod(axis=1) / m**2, after - before, m)
            fits[k] = np.column_stack((*line, points + mean / m))

    # Each point takes its first choice that is straight: the widest window first, then, at
    # corners, the straighter of the two windows that end at the point. A window that goes all
    # around an outline never is.
    side = _WINDOWS[-1]
    ends = np.stack((neighbour(side), neighbour(-side)))
    residual = fits[side][:, 1]
    end = ends[np.argmin(residual[ends], axis=0), index]
    corner = residual > _CORNER
    choices = [(k, index) for k in _WINDOWS] + [(side, np.where(corner, end, index))]
    chosen = fits[1].copy()  # specks: the chord of the two neighbours
    open_ = np.ones(n, np.bool_)
    for k, at in choices:
        take = open_ & (fits[k][at, 1] <= _STRAIGHT)
        chosen[take] = fits[k][at[take]]
        open_ &= ~take
    round_ = open_ & (length > 4)  # tight curves
    chosen[round_] = fits[2][round_]
    angle, _, sigma = chosen[:, :3].T
    centre = chosen[:, 3:]

    alpha = angle + np.pi / 2  # the wall is on the right of the contour, free space on its left
    normal = np.column_stack((np.cos(alpha), np.sin(alpha)))
    off = ((centre - points) * normal).sum(axis=1).clip(-0.5, 0.5)
    off[open_] = 0.0  # a curve does not lie on its chord
    return points + off[:, None] * normal, wrap(alpha), sigma


def _principal(
    var: FloatArray, cov: FloatArray, forward: FloatArray, m: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Direction, rms residual and sigma of the line through `m` points with these moments."""
    half, mean = (var[:, 0] - var[:, 1]) / 2, (var[:, 0] + var[:, 1]) / 2
    spread = np.hypot(half, cov)
    angle = 0.5 * np.arctan2(2 * cov, 2 * half)
    backward = forward[:, 0] * np.cos(angle) + forward[:, 1] * np.sin(angle) < 0
    residual = np.maximum(mean - spread, 0.0)
    # Regression: sigma² = residual variance / sum of squares, and no less than what the
    # staircase of the cells allows (1/12 of a cell²).
    with np.errstate(divide="ignore"):
        sigma = np.sqrt((residual + 1 / 12) / (m * (mean + spread)))
    return np.where(backward, angle + np.pi, angle), np.sqrt(residual), sigma
