"""The shift engine for small images: each shift of Alg. 2 is one slice of one long line.

With enough zeros between its rows an image is a line, and the image shifted by (dr, dc) is the
line from another cell on. There are no rows to visit and no rectangles to cut, which is most of
the time on an image that fits the cache: the coarse levels of a search.
"""

import numpy as np

from imgloc.likelihood.shift import Summable
from imgloc.model import BoolArray, Float32Array, IntArray

#: Cells of an image, padding included, up to which this is the faster way to shift.
FLAT_CELLS = 1 << 17


def flat_stack(
    image: Summable,
    limit: int,
    offsets: IntArray,
    out: Float32Array,
    *,
    where: BoolArray | None = None,
) -> None:
    """Write ``out[k, r, c] = sum_i image[r + dr_ki, c + dc_ki]``.

    Parameters
    ----------
    image : (H, W) uint8, uint16 or float32 array
    limit : int
        How often the type of the image can hold its largest value.
    offsets : (K, N, 2) int array
        (dr, dc) of each point; what it brings from outside the image is 0.
    out : (K, H, W) float32 array
        Overwritten.
    where : (H, W) bool array, optional
        Poses that are wanted; the others come out 0.

    Examples
    --------
    >>> out = np.empty((1, 2, 3), np.float32)
    >>> image = np.array([[1, 2, 3], [4, 5, 6]], np.uint16)
    >>> flat_stack(image, 9, np.array([[[0, 1], [1, -1]]]), out)
    >>> out[0].tolist()
    [[2.0, 7.0, 5.0], [5.0, 6.0, 0.0]]
    """
    height, width = image.shape
    near = np.all(np.abs(offsets) < (height, width), axis=2)  # the others miss from every pose
    reach = np.where(near[..., None], np.abs(offsets), 0).max(axis=(0, 1), initial=0)
    rows, columns = (int(r) for r in reach)
    stride = width + columns
    line = np.zeros((height + 2 * rows) * stride + 2 * columns, dtype=image.dtype)
    first, length = rows * stride + columns, height * stride
    line[first : first + length].reshape(height, stride)[:, :width] = image
    start = offsets[..., 0] * stride + offsets[..., 1] + first
    wanted = np.zeros((height, stride), dtype=image.dtype)
    wanted[:, :width] = 1 if where is None else where
    mask = wanted.reshape(-1)
    total = np.empty(length, dtype=image.dtype)
    sums = total.reshape(height, stride)[:, :width]
    for k, target in enumerate(out):
        starts = start[k, near[k]].tolist()
        for part in range(0, max(1, len(starts)), limit):
            total.fill(0)
            for s in starts[part : part + limit]:
                np.add(total, line[s : s + length], out=total)  # Alg. 2, l. 4-6
            np.multiply(total, mask, out=total)
            if part == 0:
                np.copyto(target, sums)
            else:
                np.add(target, sums, out=target)
