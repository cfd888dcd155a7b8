"""The Euclidean distance transform, to the last bit."""

import cv2
import numpy as np
import numpy.typing as npt

from imgloc.model import Float32Array

FARTHEST = 512.0
"""Cells; what is farther counts as this far."""


def distance_transform(image: npt.NDArray[np.uint8]) -> Float32Array:
    """Distance from the centre of every cell to the nearest centre of a cell that is 0.

    OpenCV's result differs in its last bits with the number of threads, with the version and
    even with where the image lies in memory, which the refinement of a pose would show. The
    square of a distance between cells is a whole number: rounded to that, it is exact.

    Parameters
    ----------
    image : (H, W) uint8 array

    Returns
    -------
    (H, W) float32 array
        Cells, at most `FARTHEST`, up to which OpenCV's errors are small enough to be rounded
        off; that everywhere if no cell is 0.

    Examples
    --------
    >>> distance_transform(np.array([[0, 1, 1], [1, 1, 1]], np.uint8)).tolist()[0]
    [0.0, 1.0, 2.0]
    """
    out = np.asarray(cv2.distanceTransform(image, cv2.DIST_L2, cv2.DIST_MASK_PRECISE))
    np.minimum(out, np.float32(FARTHEST), out=out)
    np.multiply(out, out, out=out)
    np.rint(out, out=out)
    return np.asarray(np.sqrt(out, out=out), dtype=np.float32)
