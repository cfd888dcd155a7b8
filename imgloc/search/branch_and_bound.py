"""The best poses of the CBML score over the whole map, exactly, without its stack.

Branch and bound (Hess et al. 2016): a max-pooled map gives an upper bound for a block of poses. The
search drops a block with all its poses if its bound is below a score that other poses reach.
Nothing is approximated: the result equals that of the exhaustive search, ties included.

The top level is summed as runs of memory, heading by heading. One call looks up hundreds of blocks
of a finer level.
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import sliding_window_view

from imgloc.errors import ConfigError
from imgloc.features.pyramid import PooledMaps
from imgloc.geometry import centre_of
from imgloc.likelihoods.slices import cell_offsets, check_arguments, finite_points, over_slices
from imgloc.model import BoolArray, Float32Array, FloatArray, IntArray
from imgloc.search.hypotheses import separated
from imgloc.search.lookups import sums_under

_CHUNK = 2048  # blocks of the top level opened before the threshold is looked at again
_PATHS = 64  # blocks that are descended first, to have a threshold
_FULL = 255  # a reading on a wall
_BAND_BYTES = 1 << 18  # readings x blocks of the top level summed at a time
_GROUPS = 4  # groups of readings; a block that falls behind after one group is dropped
_QUARTERS = np.array([(0, 0, 0), (0, 0, 1), (0, 1, 0), (0, 1, 1)])


@dataclass(frozen=True, eq=False)
class Best:
    """The M best poses of a lattice, best first."""

    cells: IntArray  #: (M, 3) ``(theta, row, col)`` indices, as into a stack
    #: (M,) values that the stack of :func:`imgloc.likelihoods.cbml.cbml` has at these cells
    scores: Float32Array


def best_poses(
    pooled: PooledMaps,
    xy: FloatArray,
    thetas: FloatArray,
    *,
    count: int = 1,
    distance: float = 0.0,
    angle: float = 0.0,
    threads: int = 1,
    deadline: float = np.inf,
) -> Best:
    """Find the poses of the largest CBML score, as if the stack had been computed.

    The first pick is the best pose, the next one is the best that is no neighbour of a pick, and so
    on (:func:`imgloc.search.hypotheses.separated`). Among poses of equal score the first in
    (theta, row, col) order wins.

    Parameters
    ----------
    pooled : PooledMaps
        Max-pooled maps from :func:`imgloc.features.pyramid.pooled_maps`, with the mask of the poses
        that are wanted.
    xy : (N, 2) float array
        Scan points, sensor frame, metres. Points that are not finite are left out.
    thetas : (K,) float array
        Headings, radians.
    count : int
        Number of poses to find, at most. The search is exhaustive if far fewer fit on the map.
    distance, angle : float
        Two poses are neighbours if they are closer than both, metres and radians.
    threads : int
        Number of threads. The result does not depend on it.
    deadline : float
        Time by :func:`time.monotonic` at which the search stops, seconds. The result then holds the
        picks made so far, perhaps none.

    Returns
    -------
    Best
        Only poses with a score above 0, because a pose that no reading supports is no answer.

    Raises
    ------
    ConfigError
        If a number is out of its range.
    ValueError
        If `xy` has a wrong shape.

    Examples
    --------
    >>> from imgloc.features.pyramid import pooled_maps
    >>> bmap = np.zeros((4, 4), dtype=np.float32)
    >>> bmap[:, 3] = 1  # a wall on the right
    >>> pooled = pooled_maps(bmap, np.ones((4, 4), bool), 1.0, top=1)
    >>> best = best_poses(pooled, np.array([[2.0, 0.0], [2.0, 1.0]]), np.zeros(1))
    >>> best.cells.tolist(), best.scores.tolist()
    ([[0, 0, 1]], [2.0])
    """
    check_arguments(pooled.resolution, threads)
    if count < 1:
        raise ConfigError(f"count must be at least 1, got {count}")
    if not (np.isfinite([distance, angle]).all() and distance >= 0 and angle >= 0):
        raise ConfigError(f"distance and angle must be at least 0, got {distance}, {angle}")
    headings, points = np.asarray(thetas, dtype=np.float64), finite_points(xy)
    nothing = Best(np.empty((0, 3), dtype=np.int64), np.empty(0, dtype=np.float32))
    if not (points.size and headings.size and pooled.where[0].any()):
        return nothing
    bounds = _Bounds(pooled, points, headings)
    picks = _Picks(bounds, count, distance, angle)
    top = bounds.of_top(threads, deadline)
    if time.monotonic() >= deadline:
        return nothing
    picks.promise(*bounds.descend(_roots(top, _PATHS + 8 * count)))
    nodes = np.flatnonzero(top >= picks.threshold)
    # Best first; equal ones in index order, so that the first of equal poses is met first.
    nodes = nodes[_falling(top.ravel()[nodes])]
    for start in range(0, len(nodes), _CHUNK):
        if time.monotonic() >= deadline:
            break
        # In index order again: lookups of one heading are near each other in memory.
        index = np.sort(nodes[start : start + _CHUNK])
        block = np.stack(np.unravel_index(index, top.shape), axis=1)
        score = top.ravel()[index]
        for level in range(pooled.top, -1, -1):
            if level < pooled.top:
                block, score = bounds.children(level, block, picks.threshold)
            alive = picks.may_hold(level, block, score)
            block, score = block[alive], score[alive]
        picks.add(block, score)
        rest = top.ravel()[nodes[start + _CHUNK :][:1]]
        if picks.settle(int(rest.max(initial=0))):
            break
    return picks.result()


class _Bounds:
    """Upper bounds of the score for blocks ``(theta, row, col)``; at level 0 the score."""

    def __init__(self, pooled: PooledMaps, points: FloatArray, thetas: FloatArray) -> None:
        self.pooled, self.thetas = pooled, thetas
        side = 1 << pooled.top
        # Every fourth reading in one group: each sees all directions.
        points = points[np.argsort(np.arange(len(points)) % _GROUPS, kind="stable")]
        cuts = [-(-(len(points) - g) // _GROUPS) for g in range(_GROUPS)]
        self.groups = [slice(b - n, b) for n, b in zip(cuts, np.cumsum(cuts).tolist(), strict=True)]
        # The smallest type that holds the sum of all readings: half the memory is half the time.
        self.sums_type = np.uint16 if cuts[0] * _FULL < 1 << 16 else np.uint32
        offsets = cell_offsets(points, thetas, pooled.resolution)
        # Farther than the map is large, a point misses it from everywhere.
        down, across = (
            np.clip(offsets[..., i], -n - side, n + side) for i, n in enumerate(pooled.shape)
        )
        reach = int(max(np.abs(down).max(), np.abs(across).max()))
        images, self.margin = pooled.images, pooled.margin
        if reach + side > self.margin:
            more = reach + side - self.margin
            images, self.margin = np.pad(images, ((0, 0), (more, more), (more, 0))), reach + side
        self.stride = images.shape[2]
        self.images = images.reshape(len(images), images.shape[1] * images.shape[2])
        self.flat = down * self.stride + across

        # The top level, with margins for this scan. What leaves a row on the right enters
        # the next one's left margin, which is empty.
        row, column = down >> pooled.top, across >> pooled.top
        left = int(max(-column.min(), column.max(), 0)) + 2
        above, below = int(max(-row.min(), 0)) + 1, int(max(row.max(), 0)) + 2
        rows, columns = pooled.where[-1].shape
        self.top_stride = left + columns
        shape = (side * side, above + rows + below, self.top_stride)
        window = np.s_[:, above - 1 : above + rows, left - 1 :]
        self.coarse, self.quads = np.zeros(shape, np.uint8), np.zeros(shape, np.uint32)
        self.coarse[window], self.quads[window] = pooled.coarse, pooled.quads
        phase = (down & (side - 1)) * side + (across & (side - 1))
        start = phase * (shape[1] * shape[2])
        start += (row + above) * self.top_stride + column + left
        self.starts = [np.ascontiguousarray(start[:, group]) for group in self.groups]

    def of_top(self, threads: int, deadline: float = np.inf) -> IntArray:
        """Bounds (K, H', W') of all blocks of the top level; 0 where no pose is wanted.

        After the `deadline` some are missing.

        One look at a phase of the image, from the offset of a point on, is a run of memory
        that holds what the point adds to every block: the sum over the points is a sum of
        such runs.
        """
        where, stride = self.pooled.where[-1], self.top_stride
        rows, columns = where.shape
        starts = np.concatenate(self.starts, axis=1)
        band = max(1, _BAND_BYTES // (stride * starts.shape[1]))
        self.parts = np.zeros((_GROUPS, len(starts), rows, columns), dtype=self.sums_type)
        bands = [r for r in range(0, rows, band) if where[r : r + band].any()]

        def work(share: Sequence[int]) -> None:
            for r in bands:
                n = min(band, rows - r)
                if time.monotonic() >= deadline:
                    return
                runs = sliding_window_view(self.coarse.reshape(-1), n * stride)[r * stride :]
                for k in share:
                    found = runs[starts[k]]
                    for part, group in zip(self.parts, self.groups, strict=True):
                        total = np.add.reduce(found[group], axis=0, dtype=self.sums_type)
                        part[k, r : r + n] = total.reshape(n, stride)[:, :columns]

        over_slices(work, range(len(starts)), threads)
        return np.asarray(np.add.reduce(self.parts, axis=0, dtype=np.int32) * where)

    def of_quarters(
        self, nodes: IntArray, threshold: int
    ) -> tuple[IntArray, npt.NDArray[np.int32]]:
        """Blocks of the top level with a quarter that reaches `threshold`, and (n, 4) bounds.

        What a group of readings adds to a block bounds what it adds to a quarter of it: as
        soon as that much is not enough, the other groups need not be looked up.
        """
        rows, columns = self.pooled.where[-1].shape
        flat = (nodes[:, 0] * rows + nodes[:, 1]) * columns + nodes[:, 2]
        parts = self.parts.reshape(_GROUPS, -1).take(flat, axis=1).astype(np.int32)
        k, base = nodes[:, 0], nodes[:, 1] * self.top_stride + nodes[:, 2]
        total = np.repeat(parts.sum(axis=0, dtype=np.int32)[:, None], 4, axis=1)
        quads, left = self.quads.reshape(-1), np.arange(len(nodes))
        for starts, part in zip(self.starts, parts, strict=True):
            total += sums_under([quads], starts, k, base)
            total -= part[left, None]
            keep = np.flatnonzero(total.max(axis=1, initial=0) >= threshold)
            k, base, total, left = k[keep], base[keep], total[keep], left[keep]
        return nodes[left], total

    def children(
        self, level: int, nodes: IntArray, threshold: int = 0
    ) -> tuple[IntArray, IntArray]:
        """The blocks in `nodes` of the level above whose bounds reach `threshold`; the bounds."""
        if level == self.pooled.top - 1:
            nodes, bounds = self.of_quarters(nodes, threshold)
        else:
            side = 1 << level
            row, column = 2 * side * nodes[:, 1:].T + self.margin
            quarters = side * (_QUARTERS[:, 1] * self.stride + _QUARTERS[:, 2])
            images = [self.images[level][shift:] for shift in quarters.tolist()]
            bounds = sums_under(images, self.flat, nodes[:, 0], row * self.stride + column)
        parent, quarter = np.nonzero(bounds >= threshold)
        bounds = bounds[parent, quarter]
        out = nodes[parent] * (1, 2, 2) + _QUARTERS[quarter]
        mask = self.pooled.where[level]
        wanted = (out[:, 1] < mask.shape[0]) & (out[:, 2] < mask.shape[1])
        wanted[wanted] = mask[out[wanted, 1], out[wanted, 2]]
        return out[wanted], bounds[wanted].astype(np.int64)

    def descend(self, nodes: IntArray) -> tuple[IntArray, IntArray]:
        """One pose in each block of the top level, down the best bounds, and its score."""
        score = np.zeros(len(nodes), dtype=np.int64)
        for level in range(self.pooled.top - 1, -1, -1):
            nodes, score = self.children(level, nodes)
            rows, columns = self.pooled.where[level + 1].shape
            parent = (nodes[:, 0] * rows + nodes[:, 1] // 2) * columns + nodes[:, 2] // 2
            order = np.lexsort((-score, parent))
            best = order[np.flatnonzero(np.diff(parent[order], prepend=-1))]
            nodes, score = nodes[best], score[best]
        return nodes, score


class _Picks:
    """The poses found so far, and the score that a block must reach to matter."""

    def __init__(self, bounds: "_Bounds", count: int, distance: float, angle: float) -> None:
        self.bounds, self.count, self.distance, self.angle = bounds, count, distance, angle
        self.threshold = 1
        empty = np.empty((0, 3), dtype=np.int64), np.empty(0, dtype=np.int64)
        self.apart = empty  # poses so far apart that each stands for a pick of its own
        self.found = empty  # best first; the first `settled` of them are picks for good
        self.settled = 0

    def may_hold(self, level: int, nodes: IntArray, bounds: IntArray) -> BoolArray:
        """Which blocks may hold a pose that is still to be picked."""
        if self.count > 1 or not len(self.apart[1]):
            return np.asarray(bounds >= self.threshold)
        # Of equal poses the first wins, and no pose of a block comes before its corner.
        first = self.flat(nodes * (1, 1 << level, 1 << level))
        before = first <= self.flat(self.apart[0])[0]
        return np.asarray((bounds > self.threshold) | ((bounds == self.threshold) & before))

    def promise(self, nodes: IntArray, scores: IntArray) -> None:
        """Raise the threshold to a score that the last pick reaches for certain.

        Two poses that are twice the separation apart are never neighbours of one pick. `count`
        such poses therefore lead to `count` picks that score no less.
        """
        few = np.argsort(-scores, kind="stable")[: _CHUNK + self.count]
        nodes, scores = self.sort((self.apart[0], nodes[few]), (self.apart[1], scores[few]))
        # A little more, as sums of rounded distances are not quite.
        keep = self.separate(nodes, 2 * (1 + 1e-6))[0]
        self.apart = nodes[keep], scores[keep]
        if len(keep) == self.count:
            self.threshold = max(self.threshold, int(scores[keep[-1]]))

    def add(self, nodes: IntArray, scores: IntArray) -> None:
        """Take note of poses."""
        if len(nodes):
            self.promise(nodes, scores)
            self.found = self.sort((self.found[0], nodes), (self.found[1], scores))

    def settle(self, rest: int) -> bool:
        """Pick among the poses that beat `rest`, the highest open bound; True if all are picked."""
        nodes, scores = self.found
        picked, owner = self.separate(nodes, 1.0)
        picked = picked[scores[picked] > rest]
        self.settled = len(picked)
        # Neighbours of a pick will never be picked themselves.
        keep = (owner >= len(picked)) | (owner < 0)
        keep[picked] = True
        self.found = nodes[keep], scores[keep]
        return self.settled == self.count

    def result(self) -> Best:
        """The picks, once no block is left."""
        nodes, scores = (part[: self.settled] for part in self.found)
        return Best(nodes, scores.astype(np.float32) / np.float32(_FULL))

    def sort(
        self, nodes: tuple[IntArray, IntArray], scores: tuple[IntArray, IntArray]
    ) -> tuple[IntArray, IntArray]:
        """Join two lists of poses, the best first, equal ones in index order, each once."""
        both, values = np.concatenate(nodes), np.concatenate(scores)
        index = np.unique(self.flat(both), return_index=True)[1]
        order = index[np.argsort(-values[index], kind="stable")]
        return both[order], values[order]

    def separate(self, nodes: IntArray, scale: float) -> tuple[IntArray, IntArray]:
        """:func:`separated` at a multiple of the separation."""
        xy = centre_of(nodes[:, 1:], self.bounds.pooled.resolution)
        poses = np.column_stack((xy, self.bounds.thetas[nodes[:, 0]]))
        distance, angle = scale * self.distance, scale * self.angle
        return separated(poses, self.count, distance=distance, angle=angle)

    def flat(self, nodes: IntArray) -> IntArray:
        """Index of poses into the raveled stack."""
        height, width = self.bounds.pooled.shape
        return np.asarray((nodes[:, 0] * height + nodes[:, 1]) * width + nodes[:, 2])


def _falling(values: IntArray) -> IntArray:
    """Indices by falling value, equal ones in their order."""
    below = values.max(initial=0) - values
    # NumPy sorts integers of 16 bits by their digits, ten times as fast.
    narrow = below.max(initial=0) <= np.iinfo(np.uint16).max
    return np.argsort(below.astype(np.uint16) if narrow else below, kind="stable")


def _roots(top: IntArray, n: int) -> IntArray:
    """Blocks (n, 3) to descend first: at most `n`, at different places, with high bounds."""
    heading = top.argmax(axis=0)
    peak = top.max(axis=0).ravel()
    place = np.argsort(-peak, kind="stable")[:n]
    place = place[peak[place] > 0]
    row, column = np.divmod(place, top.shape[2])
    return np.stack((heading.ravel()[place], row, column), axis=1)
