"""Sums of image values under a scan at some poses, not at all of them: Alg. 1, l. 4-6.

Poses that move together are looked up together. An image of wider integers holds the cells of
several poses side by side.
"""

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from imgloc.model import IntArray

_LOOKUPS = 1 << 15  # lookups at a time, so that they stay in the cache


def sums_under(
    images: Sequence[npt.NDArray[Any]], offsets: IntArray, k: IntArray, base: IntArray
) -> npt.NDArray[np.int32]:
    """Sum the bytes of the images under the scan at M poses: (M, B) for B bytes in all.

    Parameters
    ----------
    images : sequence of flat arrays
        Unsigned integers of one type. Each of their bytes, in memory order, is an image of its own.
    offsets : (K, N) int array
        Offset of each reading from a pose, for each heading, as an index into the images.
    k, base : (M,) int arrays
        Index of each pose's heading, and index of its cell. Every sum of `base` and `offsets` is in
        range.

    Examples
    --------
    >>> image = np.array([0, 10, 20, 30], np.uint8)
    >>> offsets, k, base = np.array([[0, 1]]), np.array([0, 0]), np.array([0, 2])
    >>> sums_under([image], offsets, k, base).ravel().tolist()
    [10, 50]
    """
    size = images[0].itemsize
    out = np.zeros((len(k), len(images) * size), dtype=np.int32)
    readings = offsets.shape[1]
    if not readings:  # before OpenCV 4.14 cv2.reduce returns arbitrary sums for no columns
        return out
    step = max(1, _LOOKUPS // readings)
    for i in range(0, len(k), step):
        # Every index is in range. With "clip" NumPy needs no buffer of its own.
        index = offsets.take(k[i : i + step], axis=0, mode="clip")
        index += base[i : i + step, None]
        for j, image in enumerate(images):
            found = image.take(index, mode="clip").view(np.uint8).reshape(*index.shape, size)
            # Eight times as fast as NumPy's sum along short rows.
            total = cv2.reduce(found, 1, cv2.REDUCE_SUM, dtype=cv2.CV_32S)
            out[i : i + step, j * size : (j + 1) * size] = total.reshape(-1, size)
    return out
