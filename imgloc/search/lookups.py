"""What images hold under a scan at many poses: Alg. 1, l. 4-6, a few poses and not all.

Poses that move together are looked up together: an image of wider integers holds the cells of
several of them side by side.
"""

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from imgloc.model import IntArray

_LOOKUPS = 1 << 15  # at a time: they stay in the cache


def sums_under(
    images: Sequence[npt.NDArray[Any]], offsets: IntArray, k: IntArray, base: IntArray
) -> npt.NDArray[np.int32]:
    """Sum what each byte of the images holds under the scan: (M, B), B bytes for M poses.

    Parameters
    ----------
    images : sequence of flat arrays
        Of unsigned integers of one type; each of their bytes, in the order of the memory, is an
        image of its own.
    offsets : (K, N) int array
        Of the readings from a pose, for each heading, as indices into the images.
    k, base : (M,) int arrays
        Heading and place of each pose. No sum of `base` and `offsets` is out of range.

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
    if not readings:  # of no columns cv2.reduce makes anything, before OpenCV 4.14
        return out
    step = max(1, _LOOKUPS // readings)
    for i in range(0, len(k), step):
        # Nothing is out of range; with "clip" NumPy needs no buffer of its own.
        index = offsets.take(k[i : i + step], axis=0, mode="clip")
        index += base[i : i + step, None]
        for j, image in enumerate(images):
            found = image.take(index, mode="clip").view(np.uint8).reshape(*index.shape, size)
            # Eight times as fast as NumPy's sum along short rows.
            total = cv2.reduce(found, 1, cv2.REDUCE_SUM, dtype=cv2.CV_32S)
            out[i : i + step, j * size : (j + 1) * size] = total.reshape(-1, size)
    return out
