"""The outlines of the walls of a map: closed polygons through the borders between cells.

:func:`skimage.measure.find_contours` finds the same ones in the same order, but keeps Python
objects for each vertex, hundreds of bytes, where a large map has millions. Here a polygon is a
cycle of a permutation: each border between two cells leads to the next one.
"""

import numpy as np
import numpy.typing as npt

from imgloc.model import BoolArray, FloatArray, IntArray

_BAND = 1024  # rows that are looked at at a time
_Index = npt.NDArray[np.int32]

# Marching squares. Which cells of a square are occupied makes its case: 1 for [r, c], 2 for
# [r, c + 1], 4 for [r + 1, c], 8 for [r + 1, c + 1]. The outline runs through it from one side to
# another, with the wall on the left (y up). Where walls touch at a corner (6, 9) it runs twice:
# the second time is listed where there is no outline (0, 15).
_LOW, _LEFT, _HIGH, _RIGHT = range(4)  # between the two cells of row r, of column c, ...
_RUNS = np.array([
    (_RIGHT, _HIGH), (_LOW, _LEFT), (_RIGHT, _LOW), (_RIGHT, _LEFT), (_LEFT, _HIGH), (_LOW, _HIGH),
    (_LEFT, _LOW), (_RIGHT, _HIGH), (_HIGH, _RIGHT), (_LOW, _RIGHT), (_HIGH, _LOW), (_HIGH, _LEFT),
    (_LEFT, _RIGHT), (_LOW, _RIGHT), (_LEFT, _LOW), (_HIGH, _LEFT),
])  # fmt: skip


def outlines(occupied: BoolArray) -> tuple[FloatArray, IntArray]:
    """Trace the outline of every wall and of every hole in one.

    Parameters
    ----------
    occupied : (H, W) bool array
        Nothing is occupied beyond its edge. Cells that touch at a corner hold together.

    Returns
    -------
    vertices : (N, 2) float array
        (x, y) in cells, cell ``[0, 0]`` reaching from 0 to 1: midpoints of the sides between
        an occupied and another cell, polygon after polygon. Each polygon is closed, its first
        vertex being its last, too, and has the wall on its right (y up). Polygons and their
        first vertices are ordered as by ``skimage.measure.find_contours(..., 0.5,
        fully_connected="high", positive_orientation="high")``.
    size : (M,) int array
        Number of vertices of each polygon.

    Examples
    --------
    >>> vertices, size = outlines(np.array([[False, True]]))
    >>> vertices.tolist(), size.tolist()
    ([[1.5, 1.0], [2.0, 0.5], [1.5, 0.0], [1.0, 0.5], [1.5, 1.0]], [5])
    """
    start, end = _runs(occupied)
    n = len(start)
    if n == 0:
        return np.zeros((0, 2)), np.zeros(0, np.int64)
    follower = np.empty(n, np.int32)  # of a run: the one that starts where it ends
    follower[np.argsort(end)] = np.argsort(start)
    del start
    label, rank = _cycles(follower)
    # By steps that are left, so backwards: now the wall is on the right.
    head = np.flatnonzero(label == np.arange(n))
    size = np.bincount(label, minlength=n)[head] + 1
    first = np.cumsum(size) - size
    at = np.empty(n, np.int64)
    at[head] = first
    at = at[label] + rank
    row, column = np.divmod(end >> 1, occupied.shape[1] + 2)
    end &= 1
    vertices = np.empty((n + len(head), 2))
    vertices[at, 0] = column - 0.5 * end
    vertices[at, 1] = row - 0.5 * (1 - end)
    vertices[first + size - 1] = vertices[first]
    return vertices, size


def _runs(occupied: BoolArray) -> tuple[IntArray, IntArray]:
    """Start and end (n,) of each run of an outline through a square of four cells, row by row.

    Each is a side between two cells of the map with a border around it: twice the index of the
    first of them, and 1 more if the other is in the next row.
    """
    height, width = occupied.shape
    step = np.array([0, 1, 2 * (width + 2), 3])  # to the sides of a square
    found = []
    for top in range(0, height + 1, _BAND):
        rows = occupied[max(0, top - 1) : top + _BAND].view(np.uint8)
        edge = (int(top == 0), int(top + _BAND > height)), (1, 1)
        cells = np.pad(rows, edge)
        case = cells[:-1, :-1] + 2 * cells[:-1, 1:] + 4 * cells[1:, :-1] + 8 * cells[1:, 1:]
        row, column = np.nonzero(case % 15)
        case = case[row, column]
        twice = (case == 6) | (case == 9)
        second = np.flatnonzero(twice) + np.arange(1, twice.sum() + 1)
        square, case = (np.repeat(v, 1 + twice) for v in ((row + top) * (width + 2) + column, case))
        case[second] = np.where(case[second] == 6, 0, 15)
        found.append(2 * square + step[_RUNS[case].T])
    start, end = np.concatenate(found, axis=1)
    return start, end


def _cycles(follower: _Index) -> tuple[_Index, _Index]:
    """The least element of each element's cycle, and how many steps it is to the greatest.

    Every element looks twice as far in each turn, so that the longest cycle takes as many
    turns as its length has bits.
    """
    index = np.arange(len(follower), dtype=np.int32)
    label, jump = index, follower
    while True:
        least = np.minimum(label, label[jump])
        if np.array_equal(least, label):
            break
        label, jump = least, jump[jump]
    last = np.zeros_like(index)
    np.maximum.at(last, label, index)
    done = last[label] == index
    jump = np.where(done, index, follower)
    rank = (~done).astype(np.int32)
    while (more := rank[jump]).any():
        rank += more
        jump = jump[jump]
    return label, rank
