"""The blurred maps: `bmap` of CBML and the vector field `vmap` of CBML-O (Fig. 4)."""

import cv2
import numpy as np
import numpy.typing as npt

from imgloc.errors import ConfigError
from imgloc.geometry import cell_of
from imgloc.model import BoolArray, Float32Array, FloatArray, IntArray, OrientedPoints

# bmap in 0..BMAP_LEVELS: sums of 257 readings fit into uint16.
BMAP_LEVELS = 255


def bmap(xy: FloatArray, shape: tuple[int, int], resolution: float, sigma: float) -> Float32Array:
    """Blur the surface points of a map into an image: ``map * K`` of eq. 3.

    Parameters
    ----------
    xy : (N, 2) float array
        Surface points in the grid frame, metres; points off the grid are left out.
    shape, resolution : (H, W), float
        Rows and columns of the result; side of a cell, metres.
    sigma : float
        Standard deviation of the Gaussian kernel K, metres: the sensor's, or more where the
        map itself is uncertain. Greater than 0 and no greater than the map, or a ConfigError.

    Returns
    -------
    (H, W) float32 array
        In 0..1 with greatest value 1 (all 0 without points). Several points in a cell count once.

    Examples
    --------
    >>> field = bmap(np.array([[0.25, 0.15]]), (3, 5), 0.1, 0.05)
    >>> (int(field.argmax()), round(float(field[1, 3] / field[1, 2]), 3))
    (7, 0.135)
    """
    image = np.zeros(shape, np.float32)
    row, col, _ = _cells(xy, shape, resolution)
    image[row, col] = 1.0
    image = _blur(image, sigma, resolution)
    peak = image.max(initial=0.0)
    return image / peak if peak > 0 else image


def vmap(
    surface: OrientedPoints, shape: tuple[int, int], resolution: float, sigma: float
) -> Float32Array:
    """Blur the normals of a map into a vector field: ``map * K`` of eq. 4.

    Parameters
    ----------
    surface : OrientedPoints
        In the grid frame; invalid normals and points off the grid are left out.
    shape, resolution, sigma
        As for :func:`bmap`, and so are the errors.

    Returns
    -------
    (2, H, W) float32 array
        x and y components, the longest vector of length 1 (all 0 without points). The normals in
        one cell are summed, to no more than 1: opposite walls in one cell cancel.

    Examples
    --------
    Two walls that face each other generate opposite fields (Fig. 4c):

    >>> walls = OrientedPoints([[0.05, 0.05], [0.45, 0.05]], [0.0, np.pi], [0.1, 0.1], [1, 1])
    >>> (100 * vmap(walls, (1, 5), 0.1, 0.05)[0]).round().astype(int).tolist()
    [[100, 14, 0, -14, -100]]
    """
    row, col, on_grid = _cells(surface.xy, shape, resolution)
    use = surface.valid[on_grid]
    alpha = surface.alpha[on_grid][use]
    flat = row[use] * shape[1] + col[use]
    # map(x, y) = sum_j (cos alpha_j, sin alpha_j) delta_pj(x, y), caption of Fig. 4
    sums = [np.bincount(flat, part, shape[0] * shape[1]) for part in (np.cos(alpha), np.sin(alpha))]
    field = np.reshape(sums, (2, *shape))
    field = field / np.maximum(np.hypot(*field), 1.0)
    blurred = np.stack([_blur(part.astype(np.float32), sigma, resolution) for part in field])
    peak = np.hypot(*blurred).max(initial=0.0)
    return blurred / peak if peak > 0 else blurred


def in_levels(bmap: Float32Array, hint: str = "") -> npt.NDArray[np.uint8]:
    """Round a blurred map to its 256 levels; one that leaves 0..1 is a ValueError."""
    levels = np.asarray(bmap, dtype=np.float32) * BMAP_LEVELS
    # One comparison that NaN fails too.
    if levels.size and not (levels.min() >= 0 and levels.max() <= BMAP_LEVELS * (1 + 1e-6)):
        low, high = np.min(bmap), np.max(bmap)
        raise ValueError(f"bmap must be in 0..1, got {low:g} to {high:g}{hint}")
    return np.rint(levels).astype(np.uint8)


def _cells(
    xy: FloatArray, shape: tuple[int, int], resolution: float
) -> tuple[IntArray, IntArray, BoolArray]:
    """Row and column of the points on the grid, and which of the points those are."""
    if min(shape) < 1:
        raise ConfigError(f"shape must be (rows, columns), both positive, got {shape}")
    if not (np.isfinite(resolution) and resolution > 0):
        raise ConfigError(f"resolution must be positive and finite, got {resolution}")
    cells = cell_of(np.asarray(xy, np.float64).reshape(-1, 2), resolution)
    on_grid: BoolArray = np.all((cells >= 0) & (cells < shape), axis=1)
    return cells[on_grid, 0], cells[on_grid, 1], on_grid


def _blur(image: Float32Array, sigma: float, resolution: float) -> Float32Array:
    """Convolve with a Gaussian of `sigma` metres; beyond the border there is nothing."""
    # cv2 raises on 0 and NaN and takes minutes for a kernel much wider than the image.
    widest = max(image.shape) * resolution
    if not 0 < sigma <= widest:
        raise ConfigError(
            f"sigma must be greater than 0 and at most the map's longest side, "
            f"{widest:g} m, got {sigma}"
        )
    off = cv2.BORDER_CONSTANT
    out = cv2.GaussianBlur(image, (0, 0), sigma / resolution, borderType=off)
    return np.asarray(out, np.float32)
