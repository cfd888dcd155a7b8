"""The vector field of CBML-O from the image itself: Gaussian, Sobel, structure tensor (Fig. 4).

Along a wall the gradient of the blurred occupancy *is* the blurred surface times its normal; the
structure tensor averages the staircase of the cells away. It knows an axis only: which end is the
normal (alpha is mod 2 pi) has the sign of the gradient, out of the wall into free space.
"""

import cv2
import numpy as np
from skimage import measure

from imgloc.errors import ConfigError
from imgloc.model import BoolArray, Float32Array

SOURCES = ("contours", "image")

_EDGE = 1.0  # cells: of the Gaussian before the gradient
_AROUND = 2.0  # cells: of the Gaussian over which the tensor averages
# A wall that leaves the map has no side there; beyond the border there are no normals.
_CELLS, _NORMALS = cv2.BORDER_REPLICATE, cv2.BORDER_CONSTANT


def vmap_of_image(
    occupied: BoolArray, free: BoolArray, resolution: float, sigma: float, *, factor: int = 1
) -> Float32Array:
    """Blurred normals of the walls: ``map * K`` of eq. 4, as :func:`imgloc.features.fields.vmap`.

    Parameters
    ----------
    occupied, free, resolution : (H, W) bool arrays, float
        Cells that are walls, cells that are free, row 0 lowest; side of a cell, metres.
    sigma : float
        Standard deviation of the Gaussian kernel K, metres; at least that of the Gaussian before
        the gradient, one cell, has an effect. Like `resolution` positive, or a ConfigError.
    factor : int
        Cells along a cell of the result.

    Returns
    -------
    (2, H', W') float32 array
        x and y components, the longest vector of length 1 (all 0 without walls). The two sides of
        a thin wall have opposite normals and cancel where they overlap.

    Examples
    --------
    Two walls that face each other generate opposite fields (Fig. 4c):

    >>> wall = np.zeros((9, 12), bool)
    >>> wall[:, [0, 1, 10, 11]] = True
    >>> x, y = vmap_of_image(wall, ~wall, 0.1, 0.1)
    >>> (100 * x[4]).round().astype(int).tolist()
    [0, 100, 100, 46, 9, 1, -1, -9, -46, -100, -100, 0]
    """
    if not (0 < sigma < np.inf and 0 < resolution < np.inf):
        raise ConfigError(f"sigma {sigma} and resolution {resolution} must be positive and finite")
    wall = cv2.GaussianBlur(occupied.astype(np.float32), (0, 0), _EDGE, borderType=_CELLS)
    # Out of the wall: down the occupancy.
    gx, gy = (
        cv2.Sobel(wall, cv2.CV_32F, *order, scale=-1 / 8, borderType=_CELLS)
        for order in ((1, 0), (0, 1))
    )
    xx, yy, xy = (
        cv2.GaussianBlur(product, (0, 0), _AROUND, borderType=_NORMALS)
        for product in (gx * gx, gy * gy, gx * gy)
    )
    axis = 0.5 * np.arctan2(2 * xy, xx - yy)  # of the greater eigenvalue
    del wall, xx, yy, xy
    nx, ny = np.cos(axis), np.sin(axis)
    length = gx * nx + gy * ny  # its sign directs the axis
    length *= cv2.dilate(free.astype(np.uint8), np.ones((3, 3), np.uint8))  # towards free space
    left = np.sqrt(max(0.0, (sigma / resolution) ** 2 - _EDGE**2)) / factor
    field = np.stack([measure.block_reduce(length * n, factor, np.mean) for n in (nx, ny)])
    if left > 0.1:
        for image in field:
            cv2.GaussianBlur(image, (0, 0), left, dst=image, borderType=_NORMALS)
    peak = np.hypot(*field).max(initial=0.0)
    return np.asarray(field / peak if peak > 0 else field, dtype=np.float32)
