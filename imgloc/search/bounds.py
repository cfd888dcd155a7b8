"""The bounds of branch and bound: what blocks of poses can score at best, many at a time.

No block is looked at by itself. The top level is summed as runs of memory, heading by heading;
the finer ones are gathered with one call for hundreds of blocks.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import sliding_window_view

from imgloc.features.pyramid import PooledMaps
from imgloc.likelihood.slices import cell_offsets, over_slices
from imgloc.model import FloatArray, IntArray
from imgloc.search.lookups import sums_under

_BAND_BYTES = 1 << 18  # readings x blocks of the top level summed at a time
_GROUPS = 4  # of readings; a block that falls behind after one group is not looked at further
_FULL = 255  # a reading on a wall
_QUARTERS = np.array([(0, 0, 0), (0, 0, 1), (0, 1, 0), (0, 1, 1)])


class Bounds:
    """Upper bounds of the score for blocks ``(theta, row, col)``; at level 0 the score."""

    def __init__(self, pooled: PooledMaps, points: FloatArray, thetas: FloatArray) -> None:
        self.pooled, self.thetas = pooled, thetas
        side = 1 << pooled.top
        # Every fourth reading in one group: each sees all directions.
        points = points[np.argsort(np.arange(len(points)) % _GROUPS, kind="stable")]
        cuts = [-(-(len(points) - g) // _GROUPS) for g in range(_GROUPS)]
        self.groups = [slice(b - n, b) for n, b in zip(cuts, np.cumsum(cuts).tolist(), strict=True)]
        self.sums_type = _sums_type(cuts[0])
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

    def of_top(self, threads: int) -> IntArray:
        """Bounds (K, H', W') of all blocks of the top level; 0 where no pose is wanted.

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
        """Blocks of the top level, and the bounds (n, 4) of their quarters.

        Blocks without a quarter that reaches `threshold` are left out.

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
        """The blocks that `nodes` of the level above consist of, and their bounds.

        Those with a bound less than `threshold` are left out.
        """
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


def _sums_type(readings: int) -> type[np.uint16] | type[np.uint32]:
    """What holds the sum of so many values of a byte: half the memory is half the time."""
    return np.uint16 if readings * _FULL < 1 << 16 else np.uint32
