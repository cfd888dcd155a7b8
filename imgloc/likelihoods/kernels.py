"""The engines to read: the map filtered with the scan as a kernel (eq. 3), and the map turned.

One image operation of OpenCV replaces the work that the other engines do by hand. ``filter2d``
draws the turned scan as a kernel. ``remap`` leaves the scan upright and turns the map under it: the
same shifts serve every heading, at the price of two interpolations.
"""

from collections.abc import Callable, Iterable, Sequence

import cv2
import numpy as np
import numpy.typing as npt

from imgloc.likelihoods.shift import Summable, shift_sum, tiles_of
from imgloc.likelihoods.slices import Finish
from imgloc.model import Float32Array, FloatArray, IntArray
from imgloc.threads import over_slices


def filter2d_stack(
    image: npt.NDArray[np.generic],
    offsets: IntArray,
    weights: Float32Array,
    threads: int,
    out: Float32Array,
    exact: bool,
    finish: Finish,
) -> None:
    """Write the correlation of each heading's scan with the image, summed over components.

    Parameters
    ----------
    image : (C, H, W) uint8 or float32 array
        One image, or the two components of a vector field.
    offsets, weights : (K, N, 2) int and (K, C, N) float32 arrays
        (rows, columns) from a pose to each point, and its weight in each component.
    threads : int
        Number of threads. The result does not depend on it.
    out : (K, H, W) float32 array
        Stack to write.
    exact : bool
        Whether the sums are integers, which rounding recovers.
    finish : callable
        Called with each finished slice (H, W).
    """
    components = np.asarray(image, dtype=np.float64)
    _, height, width = image.shape

    def work(share: Iterable[int]) -> None:
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
                anchor = (-int(low[1]), -int(low[0]))
                off = cv2.BORDER_CONSTANT  # points off the map miss
                total += cv2.filter2D(component, cv2.CV_64F, kernel, anchor=anchor, borderType=off)
            np.copyto(out[k], np.rint(total) if exact else total, casting="unsafe")
            finish(out[k])

    over_slices(work, range(len(offsets)), threads)


def remap_stack(
    image: npt.NDArray[np.uint8] | Float32Array,
    thetas: FloatArray,
    summands: Callable[[Summable, float], Sequence[Summable]],
    scan: tuple[IntArray, IntArray, IntArray],
    limit: int,
    threads: int,
    out: Float32Array,
    finish: Finish,
) -> None:
    """Turn the image by each heading, add its shifted views, and turn the sum back.

    Exact for multiples of 90 degrees, but for readings on the border of two cells. In between,
    readings are rounded to cells of the turned frame and values are interpolated linearly.

    `image` is (H, W[, C]) uint8 or float32, and `out` the stack (K, H, W) to write. `summands` is a
    function of the turned image (H, W[, C]) and the heading that returns the images to add up.
    `scan` has ``offsets, which, powers`` of the upright scan. `limit` is the number of largest
    values that the type of the images can sum. `finish` is called with each slice.
    """
    height, width = image.shape[:2]

    def work(share: Iterable[int]) -> None:
        for k in share:
            theta = float(thetas[k])
            turn, shape = _turn((height, width), theta)
            turned = cv2.warpAffine(image, turn, shape[::-1], flags=cv2.INTER_LINEAR)
            images, total = summands(turned, theta), np.zeros(shape, np.float32)
            scratch = np.empty(total.size, dtype=images[0].dtype)
            shift_sum(images, *scan, limit, tiles_of(shape), scratch, total)
            flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
            cv2.warpAffine(total, turn, (width, height), dst=out[k], flags=flags)
            finish(out[k])

    over_slices(work, range(len(thetas)), threads)


def _turn(shape: tuple[int, int], theta: float) -> tuple[FloatArray, tuple[int, int]]:
    """Transform from (x, y) of an image to the scan's frame at a heading, and its rows and columns.

    Cells meet cells if the heading is a multiple of 90 degrees.
    """
    c, s = np.round((np.cos(theta), np.sin(theta)), 12)
    ends = np.array([shape[1] - 1, shape[0] - 1])
    size = np.ceil(np.round(np.abs([[c, s], [s, c]]) @ ends, 6)).astype(int) + 3
    matrix = np.array([[c, s], [-s, c]])
    shift = (size - 1) / 2 - matrix @ (ends / 2)
    return np.column_stack((matrix, shift)), (int(size[1]), int(size[0]))
