"""The readable engine: the scan drawn as a kernel, the map filtered with it (eq. 3)."""

from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt

from imgloc.likelihood.slices import Finish, over_slices
from imgloc.model import Float32Array, IntArray


def filter2d_stack(
    image: npt.NDArray[np.generic],
    offsets: IntArray,
    weights: Float32Array,
    threads: int,
    out: Float32Array,
    *,
    exact: bool,
    finish: Finish,
) -> None:
    """Write the correlation of each heading's scan with the image, summed over components.

    Parameters
    ----------
    image : (C, H, W) uint8 or float32 array
        One image, or the two components of a vector field.
    offsets : (K, N, 2) int array
        (rows, columns) from a pose to each point.
    weights : (K, C, N) float32 array
        What each point counts in each component.
    threads : int
        Number of threads, over headings.
    out : (K, H, W) float32 array
        Overwritten.
    exact : bool
        Whether the sums are integers, to be recovered by rounding.
    finish : callable
        Called with each slice.
    """
    components = np.asarray(image, dtype=np.float64)
    _, height, width = image.shape

    def work(share: Sequence[int]) -> None:
        for k in share:
            # Points that miss the map from every pose would only make the kernel larger.
            near = (np.abs(offsets[k]) < (height, width)).all(axis=1)
            points = offsets[k][near]
            low = points.min(axis=0, initial=0)
            size = points.max(axis=0, initial=0) - low + 1
            total = np.zeros((height, width))
            for component, weight in zip(components, weights[k], strict=True):
                kernel = np.zeros(size)
                np.add.at(kernel, tuple((points - low).T), weight[near])
                # Double precision, or large sums would lose their last digit.
                total += cv2.filter2D(
                    component,
                    cv2.CV_64F,
                    kernel,
                    anchor=(-int(low[1]), -int(low[0])),
                    borderType=cv2.BORDER_CONSTANT,  # off the map is a miss
                )
            np.copyto(out[k], np.rint(total) if exact else total, casting="unsafe")
            finish(out[k])

    over_slices(work, range(len(offsets)), threads)
