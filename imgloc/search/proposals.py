"""Proposals: poses that endpoint correlation finds worth a closer look.

The correlation of CBML with a narrow kernel and a fine theta step proposes the true pose almost
always, on clean and on old maps alike. Only the coarsest level of the pyramid is searched
exhaustively. A finer level is searched around the poses that the coarser one kept.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from imgloc.features.pyramid import Level
from imgloc.geometry import uniform_thetas
from imgloc.likelihoods.correlate import correlate
from imgloc.likelihoods.slices import Stack, cell_offsets
from imgloc.model import BoolArray, FloatArray, IntArray
from imgloc.numbers import number
from imgloc.options import AT_MOST, Prior
from imgloc.search.lookups import sums_under

_CHUNK_CELLS = 1 << 20  # cells of the exhaustive level's stack at a time: 4 MB
_FIRST_CELLS = 1 << 18  # cells of its first piece
_FEWEST_LEVELS = number("proposals.fewest_levels")  # grey levels besides 0
_BLOCK = number("proposals.block")  # cells and headings a side; each block has one proposal


def propose_endpoints(
    levels: Sequence[Level],
    xy: FloatArray,
    *,
    theta_step: float,
    keep: Sequence[int],
    skip: int = 1,
    worse: float = 1.0,
    prior: Prior | None = None,
    threads: int = 1,
) -> tuple[FloatArray, FloatArray]:
    """Propose poses whose endpoints fall on walls.

    Parameters
    ----------
    levels : sequence of Level
        Levels from :func:`~imgloc.features.pyramid.pyramid`, finest first, at least two.
    xy : (N, 2) float array
        Scan points, sensor frame, metres.
    theta_step : float
        Largest step between headings, radians. The coarsest level uses every third heading.
    keep : sequence of int
        Number of nodes that each level keeps, finest first.
    skip : int
        All levels but the finest use every `skip`-th point, because their cells are coarse and
        neighbouring points fall on the same ones.
    worse : float
        Poses whose score is lower than the best one's by more than this are left out, apart from a
        few.
    prior : Prior, optional
        Limits the headings. Its cells must be in the levels' `free` already.
    threads : int
        Threads for the exhaustive level. The result does not depend on it.

    Returns
    -------
    poses : (M, 3) float array
        Grid frame: metres, metres, radians. Best first, at most ``keep[0]`` poses, one for each
        block of 2 x 2 cells and 2 headings. Poses that meet no wall are left out.
    scores : (M,) float array
        Mean of the finest endpoint image under the points, 0..1.
    """
    if len(xy) == 0:
        return np.empty((0, 3)), np.empty(0)
    thetas = uniform_thetas(theta_step)
    thetas = uniform_thetas(2 * np.pi / (len(thetas) + -len(thetas) % 3))
    wanted = np.ones(len(thetas), bool)
    if prior is not None:  # a coarse heading stands for the finer ones beside it
        wanted = prior.headings(thetas, 2 * np.pi / len(thetas))
    coarse = np.flatnonzero(wanted[::3])
    rough = _rough(levels[-1], len(xy[::skip]))
    nodes = _exhaustive(rough, xy[::skip], thetas[::3][coarse], keep[-1], threads)
    nodes[:, 0] = 3 * coarse[nodes[:, 0]]
    spread = np.array([-1, 0, 1])
    for level, count in zip(levels[-2::-1], keep[-2::-1], strict=True):
        parents, spread = _parents(nodes, spread, wanted), np.array([0])
        sums = _score(level, xy if level is levels[0] else xy[::skip], thetas, parents)
        sums[~_free_children(level, parents)] = -1
        best = _best(sums.ravel(), count)
        nodes, scores = parents[best >> 2] * (1, 2, 2), sums.ravel()[best]
        nodes[:, 1:] += np.stack((best >> 1 & 1, best & 1), axis=1)  # the best of its four cells
    first = np.sort(np.unique(_key(*nodes.T // _BLOCK), return_index=True)[1])
    first = first[scores[first] > 0]
    mean = scores[first] / (255.0 * len(xy))
    # So many however bad they are: the list has to be full.
    few = max(AT_MOST, np.count_nonzero(mean >= mean.max(initial=0) - worse))
    return _poses(nodes[first[:few]], thetas, levels[0]), mean[:few]


def _poses(nodes: IntArray, thetas: FloatArray, level: Level) -> FloatArray:
    """Poses (M, 3), grid frame, at the centres of nodes."""
    return np.column_stack(((nodes[:, :0:-1] + 0.5) * level.resolution, thetas[nodes[:, 0]]))


def _rough(level: Level, points: int) -> Level:
    """Reduce the grey levels of a level, so that a byte holds the sum over a few `points`.

    This halves the memory to move. An image of few grey levels hardly orders the poses differently.
    """
    most, top = int(level.image.max()), np.iinfo(np.uint8).max // max(1, points)
    if not _FEWEST_LEVELS <= top < most:
        return level
    return replace(level, image=np.rint(level.image * np.float32(top / most)).astype(np.uint8))


def _exhaustive(
    level: Level, xy: FloatArray, thetas: FloatArray, keep: int, threads: int
) -> IntArray:
    """Best `keep` nodes (theta, row, col) of a whole level, a few headings at a time."""
    area = level.image.size
    chunk = min(len(thetas), max(1, _CHUNK_CELLS // area))
    few = int(level.image.max()) * len(xy) <= np.iinfo(np.uint8).max  # bytes hold the sums
    kind = np.uint8 if few else np.float32
    nodes, scores, threshold = np.empty(0, np.int64), np.empty(0, kind), kind(0)
    buffer = np.empty((chunk, *level.image.shape), kind)
    # The first few headings give a threshold, which nearly all nodes of the others miss.
    first = min(chunk, -(-_FIRST_CELLS // area))
    for start, stop in pairwise([0, *range(first, len(thetas), chunk), len(thetas)]):
        some, out = thetas[start:stop], buffer[: stop - start]
        stack = correlate(
            level.image, xy, some, level.resolution, threads=threads, where=level.free, out=out
        )
        # Only nodes above the score that `keep` nodes reach already can still matter.
        best = (
            np.flatnonzero(stack.ravel() >= threshold)
            if threshold > 0
            else _largest(stack, keep, level.free)
        )
        nodes = np.concatenate((nodes, best + start * area))
        scores = np.concatenate((scores, stack.ravel()[best]))
        if len(nodes) >= keep:
            threshold = np.partition(scores, len(scores) - keep)[len(scores) - keep]
            still = scores >= threshold
            nodes, scores = nodes[still], scores[still]
    nodes = nodes[_falling(scores)[:keep]]
    return np.stack(np.unravel_index(nodes, (len(thetas), *level.image.shape)), axis=1)


def _largest(stack: Stack, n: int, free: BoolArray) -> IntArray:
    """Indices of the `n` largest sums in free cells, and of all that equal the last of them.

    The sums are whole numbers. Zeros fill up to `n` in index order: a wall that a coarse pose
    misses by a cell may be met by one of its finer poses.
    """
    # A histogram, because a partition is slow if many sums are equal: on some maps most are 0.
    reached = np.bincount(stack.ravel().astype(np.intp))[::-1].cumsum() >= n
    threshold = len(reached) - 1 - int(reached.argmax()) if reached.any() else 0
    if threshold > 0:
        return np.flatnonzero(stack >= threshold)
    above = np.flatnonzero(stack)
    zeros = np.flatnonzero((stack == 0) & free)  # cells that are not free are 0 as well
    return np.sort(np.concatenate((above, zeros[: n - len(above)])))


def _parents(nodes: IntArray, spread: IntArray, wanted: BoolArray) -> IntArray:
    """The nodes at their own heading, or at it and those beside it, in index order."""
    k = (nodes[:, 0] + spread[:, None]) % len(wanted)
    key = _key(k, nodes[:, 1], nodes[:, 2])[wanted[k]]
    key.sort()
    return np.stack((key >> 40, key >> 20 & 0xFFFFF, key & 0xFFFFF), axis=1)


def _free_children(level: Level, parents: IntArray) -> BoolArray:
    """Which of the four cells of each node are free and on the map, (M, 4): a side may be odd."""
    free = np.pad(level.free, [(0, side % 2) for side in level.free.shape])
    first = 2 * (parents[:, 1] * free.shape[1] + parents[:, 2])
    four = first[:, None] + [0, 1, free.shape[1], free.shape[1] + 1]
    return np.asarray(free.ravel().take(four))


def _best(scores: npt.NDArray[np.int32], n: int) -> IntArray:
    """Indices of the `n` largest scores that are not negative, best first, ties in index order."""
    index = np.flatnonzero(scores >= 0)
    if n < len(index):
        threshold = np.partition(scores, len(scores) - n)[len(scores) - n]
        index = np.flatnonzero(scores >= threshold)
    return index[_falling(scores[index])[:n]]


def _falling(scores: npt.NDArray[Any]) -> IntArray:
    """Indices of sums that are not negative, greatest first, equal ones in their order."""
    # NumPy sorts 16 bits by counting, 15 times as fast as it sorts 32.
    if scores.max(initial=0) <= np.iinfo(np.int16).max:
        return np.argsort(-scores.astype(np.int16), kind="stable")
    return np.argsort(-scores.astype(np.float64), kind="stable")


def _key(k: IntArray, r: IntArray, c: IntArray) -> IntArray:
    """One integer per node; a side of a level has fewer than 2**20 cells."""
    return np.asarray((k << 40) + (r << 20) + c)


def _score(
    level: Level, xy: FloatArray, thetas: FloatArray, parents: IntArray
) -> npt.NDArray[np.int32]:
    """Sums (M, 4) of the level's image under the points at the four cells of each node."""
    height, width = level.image.shape
    offsets = cell_offsets(xy, thetas, level.resolution)
    # A shift by the whole image misses it from anywhere; a longer one needs no wider padding.
    down, across = (np.clip(offsets[..., i], -side, side) for i, side in enumerate((height, width)))
    rows, columns = int(np.abs(down).max()), int(np.abs(across).max())
    # Points off the map miss. A side may be odd: the last node's second row or column is one more.
    padded = np.pad(level.image, ((rows, rows + 2), (columns, columns + 2)))
    images: list[npt.NDArray[np.unsignedinteger]]
    if 4 * len(parents) * len(xy) > padded.size:
        # Many nodes make it worth while to lay the cells under a point, from four poses, together.
        top, bottom = padded[:-1], padded[1:]
        quads = cv2.merge((top[:, :-1], top[:, 1:], bottom[:, :-1], bottom[:, 1:]))
        stride, images = quads.shape[1], [quads.view(np.uint32).ravel()]
    else:
        stride, line = padded.shape[1], padded.ravel()
        images = [line[corner:] for corner in (0, 1, stride, stride + 1)]
    base = (2 * parents[:, 1] + rows) * stride + 2 * parents[:, 2] + columns
    return sums_under(images, down * stride + across, parents[:, 0], base)
