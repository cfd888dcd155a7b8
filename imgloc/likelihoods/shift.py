"""The shift engine: Alg. 2 line by line, each line of its inner loop one ``cv2.add``.

Integers make it fast. A uint8 image is summed in uint16, twice as dense as float32, over as many
points as cannot overflow it. It is summed in uint8 if that holds the sum of all points. The plane
is cut into tiles so small that accumulator and source stay in the second-level cache.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import as_strided

from imgloc.likelihoods.slices import Finish, box_of, reach_of
from imgloc.model import BoolArray, Float32Array, IntArray
from imgloc.threads import over_slices

#: An image of the type that holds its sums: uint8, uint16, int16 or float32.
Summable = npt.NDArray[Any]

# Cells of a tile, 512 KB: smaller ones pay more calls, larger ones leave the cache.
TILE_CELLS = 1 << 18
TILE_WIDTH = 1024
# Repeated readings are added in powers of two up to 2**MAX_POWER, within the limits of 16 bits.
MAX_POWER = 3
# Cells up to which flat_stack copies the views of a heading side by side to add them in one call.
FLAT_PIECE = 1 << 14


class Tile(NamedTuple):
    """A rectangle of poses: rows ``r0:r1``, columns ``c0:c1``."""

    r0: int
    r1: int
    c0: int
    c1: int

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.r1 - self.r0, self.c1 - self.c0


def tiles_of(shape: tuple[int, int], where: BoolArray | None = None) -> list[Tile]:
    """Cut a plane of (H, W) cells into cache-sized tiles, each shrunk to its wanted poses.

    `where` (H, W) marks the wanted poses, by default all.

    Examples
    --------
    >>> where = np.zeros((4, 6), dtype=bool)
    >>> where[1:3, 2:5] = True
    >>> tiles_of((4, 6), where)
    [Tile(r0=1, r1=3, c0=2, c1=5)]
    """
    height, width = shape
    if 0 in shape:
        return []
    columns = -(-width // -(-width // TILE_WIDTH))
    rows = max(1, TILE_CELLS // columns)
    rows = -(-height // -(-height // rows))
    tiles = []
    for r in range(0, height, rows):
        for c in range(0, width, columns):
            i, j = slice(0, min(rows, height - r)), slice(0, min(columns, width - c))
            if where is not None:
                i, j = box_of(where[r : r + rows, c : c + columns])
            if i.stop:
                tiles.append(Tile(r + i.start, r + i.stop, c + j.start, c + j.stop))
    return tiles


def merge_repeats(offsets: IntArray, which: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    """Join readings with the same offset: offsets (n, 2), which image (n,), power of two (n,).

    An offset that m readings share remains once for each binary digit of m that is 1, the highest
    power first. :func:`shift_sum` doubles its sums on the way down (Horner).

    Examples
    --------
    >>> offsets = np.array([[0, 1], [0, 1], [2, 0], [0, 1]])
    >>> [a.tolist() for a in merge_repeats(offsets, np.zeros(4, dtype=np.int64))]
    [[[0, 1], [0, 1], [2, 0]], [0, 0, 0], [1, 0, 0]]
    """
    if not len(offsets):
        return offsets, which, which
    # Sorted by image, so that an image stays in the cache.
    image = np.where(which >= 0, 2 * which, -1 - 2 * which)
    cell = (offsets[:, 0] << 32) + offsets[:, 1]
    order = np.lexsort((cell, image))
    offsets, which, cell = offsets[order], which[order], cell[order]
    new = (cell[1:] != cell[:-1]) | (which[1:] != which[:-1])
    first = np.flatnonzero(np.concatenate(([True], new)))
    count = np.diff(np.append(first, len(offsets)))
    index = [np.repeat(first, count >> MAX_POWER)]
    index += [first[(count >> p) & 1 > 0] for p in range(MAX_POWER - 1, -1, -1)]
    power = np.repeat(np.arange(MAX_POWER, -1, -1), [len(i) for i in index])
    chosen = np.concatenate(index)
    return offsets[chosen], which[chosen], power


def shift_stack(
    images: Sequence[Summable],
    scan: Callable[[int], tuple[IntArray, IntArray, IntArray]],
    limit: int,
    tiles: Sequence[Tile],
    threads: int,
    out: Float32Array,
    finish: Finish,
) -> None:
    """Fill a stack (K, H, W) with :func:`shift_sum` for each heading, and with 0 off the tiles.

    `scan` is a function of the index of a heading that returns ``offsets, which, powers`` of its
    points. `finish` is called with each slice.
    """
    largest = max((math.prod(t.shape) for t in tiles), default=0)

    def work(share: Iterable[int]) -> None:
        scratch = np.empty(largest, dtype=images[0].dtype)
        for k in share:
            out[k].fill(0)
            shift_sum(images, *scan(k), limit, tiles, scratch, out[k])
            finish(out[k])

    over_slices(work, range(len(out)), threads)


def shift_sum(
    images: Sequence[Summable],
    offsets: IntArray,
    which: IntArray,
    powers: IntArray,
    limit: int,
    tiles: Sequence[Tile],
    scratch: Summable,
    out: Float32Array,
) -> None:
    """Write ``out[r, c] = sum_i ± 2**k_i images[w_i][r + dr_i, c + dc_i]`` on the tiles.

    The result is exact for integer images while the sums stay below 2**24.

    Parameters
    ----------
    images : sequence of (H, W) arrays
        Images of one :data:`Summable` type.
    offsets : (n, 2) int array
        (dr, dc) of each point. Cells outside of the image count as 0.
    which : (n,) int array
        ``w_i >= 0`` adds image ``w_i``, ``w_i < 0`` subtracts image ``-1 - w_i``.
    powers : (n,) int array
        Powers of two. No power is greater than the one before.
    limit : int
        Number of largest values that the type of the images can sum.
    tiles : sequence of Tile
        Where to compute.
    scratch : flat array
        Buffer of the images' type, as large as the largest tile.
    out : (H, W) float32 array
        The result; 0 on entry.
    """
    height, width = images[0].shape
    weights = 1 << powers
    part = np.cumsum(weights) // max(1, limit - int(weights.max(initial=1)))
    bounds = [*np.unique(part, return_index=True)[1].tolist(), len(part)]
    dr, dc = offsets.T
    for t in tiles:
        total = scratch[: math.prod(t.shape)].reshape(t.shape)
        r0, r1 = np.maximum(t.r0, -dr), np.minimum(t.r1, height - dr)
        c0, c1 = np.maximum(t.c0, -dc), np.minimum(t.c1, width - dc)
        inside = (r0 < r1) & (c0 < c1)
        target_box = (r0 - t.r0, r1 - t.r0, c0 - t.c0, c1 - t.c0)
        box = np.column_stack((*target_box, r0 + dr, r1 + dr, c0 + dc, c1 + dc, which, powers))
        target = out[t.r0 : t.r1, t.c0 : t.c1]
        for start, stop in pairwise(bounds):
            boxes = box[start:stop][inside[start:stop]].tolist()
            if not boxes:
                continue
            total.fill(0)
            level = boxes[0][-1]
            for a0, a1, b0, b1, s0, s1, u0, u1, w, power in boxes:
                while level > power:
                    cv2.add(total, total, total)
                    level -= 1
                view = total[a0:a1, b0:b1]
                if w >= 0:
                    cv2.add(view, images[w][s0:s1, u0:u1], view)  # Alg. 2, l. 4-6
                else:
                    cv2.subtract(view, images[-1 - w][s0:s1, u0:u1], view)
            for _ in range(level):
                cv2.add(total, total, total)
            np.add(target, total, out=target)


def flat_stack(
    image: Summable,
    limit: int,
    offsets: IntArray,
    out: Summable,
    where: BoolArray | None = None,
) -> None:
    """Write ``out[k, r, c] = sum_i image[r + dr_ki, c + dc_ki]``, and 0 outside of `where`.

    It sums like :func:`shift_sum`, but on one thread, because several would wait for each other.
    The type of `out` must hold the sums.

    Examples
    --------
    >>> out = np.empty((1, 2, 3), np.float32)
    >>> image = np.array([[1, 2, 3], [4, 5, 6]], np.uint16)
    >>> flat_stack(image, 9, np.array([[[0, 1], [1, -1]]]), out)
    >>> out[0].tolist()
    [[2.0, 7.0, 5.0], [5.0, 6.0, 0.0]]
    """
    height, width = image.shape
    near, (rows, columns) = reach_of(offsets, image.shape)
    stride = width + columns
    line = np.zeros((height + 2 * rows) * stride + 2 * columns, dtype=image.dtype)
    first, length = rows * stride + columns, height * stride
    line[first : first + length].reshape(height, stride)[:, :width] = image
    starts = offsets[..., 0] * stride + offsets[..., 1] + first
    mask = np.ones((height, width), image.dtype) if where is None else where.astype(image.dtype)
    total = np.empty(length, dtype=image.dtype)
    cells, whole = total.reshape(height, stride)[:, :width], bool(near.all())
    # The piece of the line that begins at each cell.
    pieces = as_strided(line, (line.size - length + 1, length), line.strides * 2)
    for k, target in enumerate(out):
        some = starts[k] if whole else starts[k, near[k]]
        for part in range(0, max(1, len(some)), limit):
            if length <= FLAT_PIECE:  # one call copies all pieces, and one adds them: few calls
                every = pieces[some[part : part + limit]]
                np.add.reduce(every, axis=0, dtype=total.dtype, out=total)
            else:
                total.fill(0)
                for s in some[part : part + limit].tolist():
                    np.add(total, line[s : s + length], out=total)  # Alg. 2, l. 4-6
            if part == 0:
                np.multiply(cells, mask, out=target)
            else:
                np.add(target, cells * mask, out=target)
