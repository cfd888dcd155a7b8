"""Where to look closely: poses proposed by endpoint correlation, coarse to fine.

The correlation of CBML with a narrow kernel and a fine theta step proposes the true pose
almost always, on clean and on old maps alike. Only the coarsest level is exhaustive; every
finer one is evaluated around what the level before it kept.
"""

from collections.abc import Sequence
from itertools import pairwise

import cv2
import numpy as np

from imgloc.features.pyramid import Level
from imgloc.geometry import uniform_thetas
from imgloc.likelihood.correlate import correlate
from imgloc.likelihood.slices import cell_offsets
from imgloc.model import BoolArray, Float32Array, FloatArray, IntArray
from imgloc.search.priors import Prior

_CHUNK_CELLS = 1 << 19  # of the exhaustive level's stack: 2 MB at a time
_FIRST_CELLS = 1 << 18  # of its first piece
_PIECE = 2048  # nodes that are scored at a time
_BLOCK = 2  # cells and headings a side: one proposal each


def propose_endpoints(
    levels: Sequence[Level],
    xy: FloatArray,
    *,
    theta_step: float,
    keep: Sequence[int],
    skip: int = 1,
    prior: Prior | None = None,
    threads: int = 1,
) -> tuple[FloatArray, FloatArray]:
    """Propose poses whose endpoints fall on walls.

    Parameters
    ----------
    levels : sequence of Level
        Of :func:`~imgloc.features.pyramid.pyramid`, finest first, at least two.
    xy : (N, 2) float array
        Scan points, sensor frame, metres.
    theta_step : float
        Largest step between headings, radians; the coarsest level takes every second one.
    keep : sequence of int
        How many nodes each level keeps, finest first.
    skip : int
        All levels but the finest take every `skip`-th point: their cells are coarse, and
        neighbouring points say nearly the same.
    prior : Prior, optional
        Whose headings are the only ones; its cells are in the levels' `free` already.
    threads : int
        For the exhaustive level; the result does not depend on it.

    Returns
    -------
    poses : (M, 3) float array
        Grid frame, best first, at most ``keep[0]``, one per block of 2 x 2 cells and 2
        headings; none that meets no wall at all.
    scores : (M,) float array
        Mean of the finest endpoint image under the points, 0..1.
    """
    if len(xy) == 0:
        return np.empty((0, 3)), np.empty(0)
    thetas = uniform_thetas(theta_step)
    thetas = uniform_thetas(2 * np.pi / (len(thetas) + len(thetas) % 2))
    wanted = np.ones(len(thetas), bool)
    if prior is not None:  # a coarse heading stands for those beside it
        wanted = prior.headings(thetas, 2 * np.pi / len(thetas))
    coarse = np.flatnonzero(wanted[::2])
    nodes = _exhaustive(levels[-1], xy[::skip], thetas[::2][coarse], keep[-1], threads)
    nodes[:, 0] = 2 * coarse[nodes[:, 0]]
    spread = np.array([-1, 0, 1])
    for level, count in zip(levels[-2::-1], keep[-2::-1], strict=True):
        nodes = _children(nodes, level, spread, wanted)
        spread = np.array([0])
        points = xy if level is levels[0] else xy[::skip]
        scores = _score(level, points, thetas, nodes)
        best = _best(scores, count)
        nodes, scores = nodes[best], scores[best]
    first = np.sort(np.unique(_key(*nodes.T // _BLOCK), return_index=True)[1])
    first = first[scores[first] > 0]
    nodes, scores = nodes[first], scores[first]
    centres = (nodes[:, :0:-1] + 0.5) * levels[0].resolution
    return np.column_stack((centres, thetas[nodes[:, 0]])), scores / (255.0 * len(xy))


def propose_all(
    level: Level, xy: FloatArray, *, theta_step: float, keep: int, threads: int = 1
) -> FloatArray:
    """The best `keep` of all poses of one level, each heading tried: (M, 3), grid frame.

    Parameters
    ----------
    level : Level
    xy : (N, 2) float array
        Scan points, sensor frame, metres.
    theta_step : float
        Largest step between headings, radians.
    keep : int
    threads : int
        The result does not depend on it.

    Returns
    -------
    (M, 3) float array
        Best first.
    """
    thetas = uniform_thetas(theta_step)
    nodes = _exhaustive(level, xy, thetas, keep, threads)
    centres = (nodes[:, :0:-1] + 0.5) * level.resolution
    return np.column_stack((centres, thetas[nodes[:, 0]]))


def _exhaustive(
    level: Level, xy: FloatArray, thetas: FloatArray, keep: int, threads: int
) -> IntArray:
    """Best `keep` nodes (theta, row, col) of a whole level, a few headings at a time."""
    area = level.image.size
    chunk = min(len(thetas), max(1, _CHUNK_CELLS // area))
    nodes, scores, threshold = np.empty(0, np.int64), np.empty(0, np.float32), np.float32(0)
    buffer = np.empty((chunk, *level.image.shape), np.float32)
    # A few headings first: what they reach spares a look at nearly all of the others.
    first = min(chunk, -(-_FIRST_CELLS // area))
    edges = [0, *range(first, len(thetas), chunk), len(thetas)]
    for start, stop in pairwise(edges):
        stack = correlate(
            level.image,
            xy,
            thetas[start:stop],
            level.resolution,
            threads=threads,
            where=level.free,
            out=buffer[: stop - start],
        )
        # What is known to be reached by `keep` nodes already is all that can still matter.
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
    nodes = nodes[np.argsort(-scores, kind="stable")[:keep]]
    return np.stack(np.unravel_index(nodes, (len(thetas), *level.image.shape)), axis=1)


def _largest(stack: Float32Array, n: int, free: BoolArray) -> IntArray:
    """Indices of the `n` largest values in free cells; of equal ones, those that come first.

    Zeros count: what a coarse pose misses by a cell one of its finer ones may meet.
    """
    values = stack.ravel()
    threshold = np.partition(values, values.size - n)[values.size - n] if n < values.size else 0.0
    above = np.flatnonzero(values > threshold)
    # Poses that are not free are 0 as well.
    at = stack == threshold if threshold > 0 else (stack == 0) & free
    return np.sort(np.concatenate((above, np.flatnonzero(at)[: n - len(above)])))


def _children(nodes: IntArray, level: Level, spread: IntArray, wanted: BoolArray) -> IntArray:
    """The four cells of each node one level down, at its own and its neighbouring headings.

    Each once, in the order of their indices.
    """
    height, width = level.free.shape
    dr, dc = np.array([[0, 0, 1, 1], [0, 1, 0, 1]])
    r, c = (2 * nodes[:, 1:2] + dr).ravel(), (2 * nodes[:, 2:] + dc).ravel()
    k = np.repeat(nodes[:, 0], 4)
    on = (r < height) & (c < width)
    on[on] = level.free[r[on], c[on]]
    k = (k[on] + spread[:, None]) % len(wanted)
    key = _key(k, r[on], c[on])[wanted[k]]
    key.sort()
    key = key[np.diff(key, prepend=-1) > 0]  # neighbouring headings meet in the same child
    return np.stack((key >> 40, key >> 20 & 0xFFFFF, key & 0xFFFFF), axis=1)


def _best(scores: FloatArray, n: int) -> IntArray:
    """Indices of the `n` largest, best first; of equal ones, those that come first."""
    index = np.arange(len(scores))
    if n < len(scores):
        threshold = np.partition(scores, len(scores) - n)[len(scores) - n]
        index = np.flatnonzero(scores >= threshold)
    return index[np.argsort(-scores[index], kind="stable")[:n]]


def _key(k: IntArray, r: IntArray, c: IntArray) -> IntArray:
    """One integer per node; a side of a level has fewer than 2**20 cells."""
    return np.asarray((k << 40) + (r << 20) + c)


def _score(level: Level, xy: FloatArray, thetas: FloatArray, nodes: IntArray) -> FloatArray:
    """Sum of the level's image under the points at each node (Alg. 1, l. 4-6)."""
    # A shift by the whole image misses it from anywhere; a longer one needs no wider padding.
    offsets = cell_offsets(xy, thetas, level.resolution)
    sides = np.array(level.image.shape)
    offsets = np.clip(offsets, -sides, sides)
    rows, columns = np.abs(offsets).max(axis=(0, 1)).tolist()
    padded = np.pad(level.image, ((rows, rows), (columns, columns)))  # off the map is a miss
    stride = padded.shape[1]
    flat = offsets[..., 0] * stride + offsets[..., 1]
    base = (nodes[:, 1] + rows) * stride + nodes[:, 2] + columns
    image, headings = padded.ravel(), nodes[:, 0].copy()
    out = np.empty((len(nodes), 1), dtype=np.int32)
    index = np.empty((_PIECE, len(xy)), dtype=flat.dtype)
    values = np.empty((_PIECE, len(xy)), dtype=np.uint8)
    for start in range(0, len(nodes), _PIECE):  # in pieces that stay in the cache
        sums = out[start : start + _PIECE]
        at, fits = index[: len(sums)], values[: len(sums)]
        # Nothing is out of range; with "clip" NumPy needs no buffer of its own.
        flat.take(headings[start : start + _PIECE], axis=0, out=at, mode="clip")
        np.add(at, base[start : start + _PIECE, None], out=at)
        image.take(at, out=fits, mode="clip")
        # Eight times as fast as NumPy's sum along short rows.
        cv2.reduce(fits, 1, cv2.REDUCE_SUM, dst=sums, dtype=cv2.CV_32S)
    return out[:, 0].astype(np.float64)
