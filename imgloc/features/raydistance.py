"""Ray-distance images: ``r_m(x, y, psi)`` of eq. 2 for every cell, one image per direction.

The paper's "Table" by image rotation: with the map turned so that all rays of one direction
run down the rows, the nearest obstacle of every cell is one running minimum. That is O(cells)
per direction, a factor of the map's resolution better than the paper's appendix.
"""

from collections.abc import Iterable

import cv2
import numpy as np
import numpy.typing as npt
from skimage import measure

from imgloc.errors import ConfigError
from imgloc.model import BoolArray, Float32Array, FloatArray
from imgloc.threads import over_slices

_CM = 100.0
_MAX_CM = np.iinfo(np.uint16).max
LONGEST = _MAX_CM / _CM  #: metres: no longer distance has a value
# Grey levels: the surface of a wall is where the interpolated occupancy passes one half; a
# sample counts from a little below, so that rays a pixel apart do not miss a one-pixel wall.
_WALL, SURFACE, HIT = 255, 127.5, 100
_JOINT = 90  # free cells beside two occupied ones that touch at a corner; see watertight


def ray_distances(
    occupied: BoolArray,
    resolution: float,
    n_psi: int,
    max_range: float,
    *,
    factor: int = 1,
    threads: int = 1,
) -> npt.NDArray[np.uint16]:
    """Distance to the nearest obstacle, from every cell in every direction.

    Parameters
    ----------
    occupied, resolution : (H, W) bool array, float
        Occupied cells, row 0 lowest; side of a cell, metres. Unknown cells and the world off
        the map are transparent.
    n_psi, max_range : int, float
        Number of directions; metres, at most 655.35, the value where nothing is hit within it.
    factor : int
        Rays start at the centres of blocks of so many cells a side; walls keep the map's cells.
    threads : int
        Directions computed at a time; the result does not depend on it.

    Returns
    -------
    (n_psi, H, W) uint16 array
        Centimetres from the centre of block ``[row, col]`` to the boundary of the first occupied
        cell in direction ``psi_k = 2 pi k / n_psi`` of the grid frame; 0 in blocks all occupied.

    Raises
    ------
    ConfigError
        If a number or the size of the map is out of its range.

    Notes
    -----
    Hits are interpolated and the ray's own start is exact; what is left is that the ray runs up to
    half a cell beside the centre of the cell.

    Examples
    --------
    >>> row = np.array([[1, 0, 0, 0, 1]], bool)
    >>> ray_distances(row, 0.1, 2, 5.0)[:, 0].tolist()
    [[0, 25, 15, 5, 0], [0, 5, 15, 25, 0]]
    """
    occupied = np.asarray(occupied, np.bool_)
    if occupied.ndim != 2 or occupied.size == 0:
        raise ConfigError(f"occupied must be an image, got an array of shape {occupied.shape}")
    if np.hypot(*occupied.shape) >= np.iinfo(np.int16).max:  # the limit of warpAffine
        raise ConfigError(f"a map of {occupied.shape} is too large to be rotated")
    if n_psi < 1 or factor < 1:
        raise ConfigError(f"n_psi and factor must be at least 1, got {n_psi} and {factor}")
    if not 0 < max_range <= LONGEST:
        raise ConfigError(f"max_range must be in (0, {LONGEST}] m, got {max_range}")
    if not (np.isfinite(resolution) and resolution > 0):
        raise ConfigError(f"resolution must be positive and finite, got {resolution}")

    solid = np.asarray(measure.block_reduce(occupied, factor, np.all))
    stack = np.empty((n_psi, *solid.shape), np.uint16)
    image = watertight(occupied)
    limit = np.uint16(round(max_range * _CM))

    def work(share: Iterable[int]) -> None:
        for k in share:
            # A rotated map serves the two directions along its columns.
            canvas, turn = _rotate(image, 2 * np.pi * k / n_psi)
            # From the centres of blocks, counted in blocks.
            linear = turn[:, :2]
            offset = turn[:, 2] + linear.sum(axis=1) * (factor - 1) / 2
            turn = np.column_stack((factor * linear, offset))
            _look(canvas, turn, solid, resolution, limit, stack[k])
            if n_psi % 2 == 0:
                back = turn.copy()
                back[1] = -turn[1]
                back[1, 2] += len(canvas) - 1
                _look(canvas[::-1], back, solid, resolution, limit, stack[k + n_psi // 2])

    turns = range(n_psi // 2 if n_psi % 2 == 0 else n_psi)
    over_slices(work, turns, threads)
    return stack


def watertight(occupied: BoolArray) -> npt.NDArray[np.uint8]:
    """Occupancy as grey levels, with the gaps of diagonal walls one pixel wide filled.

    Rays would slip through where occupied cells touch at a corner only. A light grey in the two
    cells beside it widens the joint, and is itself below the surface's level.
    """
    image = np.where(occupied, _WALL, 0).astype(np.uint8)
    corners = [(slice(i, i - 1 or None), slice(j, j - 1 or None)) for i in (0, 1) for j in (0, 1)]
    a, b, c, d = (occupied[corner] for corner in corners)
    falling, rising = b & c & ~(a | d), a & d & ~(b | c)
    for corner, joint in zip(corners, (falling, rising, rising, falling), strict=True):
        image[corner][joint] = _JOINT
    return image


def canvas_size(shape: tuple[int, int], psi: float) -> tuple[int, int]:
    """Rows and columns of the map turned by `psi`, with a margin."""
    height, width = shape
    c, s = np.round((np.cos(psi), np.sin(psi)), 12)
    along = int(np.ceil(round(abs(c) * (width - 1) + abs(s) * (height - 1), 6))) + 3
    across = int(np.ceil(round(abs(s) * (width - 1) + abs(c) * (height - 1), 6))) + 3
    return along, across


def _rotate(image: npt.NDArray[np.uint8], psi: float) -> tuple[npt.NDArray[np.uint8], FloatArray]:
    """The map turned so that rays in direction `psi` run down, and the (2, 3) matrix to there."""
    height, width = image.shape
    c, s = np.round((np.cos(psi), np.sin(psi)), 12)
    along, across = canvas_size((height, width), psi)
    turn = np.array([[-s, c, 0.0], [c, s, 0.0]])
    centre = np.array([(width - 1) / 2, (height - 1) / 2])
    turn[:, 2] = np.array([(across - 1) / 2, (along - 1) / 2]) - turn[:, :2] @ centre
    canvas = cv2.warpAffine(image, turn, (across, along), flags=cv2.INTER_LINEAR)
    return np.asarray(canvas, np.uint8), turn


def _look(
    canvas: npt.NDArray[np.uint8], turn: FloatArray, solid: BoolArray, resolution: float,
    limit: np.uint16, out: npt.NDArray[np.uint16],
) -> None:  # fmt: skip
    """Write the distance, in cm, from each block to the first wall down its column of `canvas`."""
    hit = _next_hit(canvas)
    height, width = solid.shape
    flags = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
    back = cv2.warpAffine(hit, turn, (width, height), flags=flags, borderMode=cv2.BORDER_REPLICATE)
    # The row of the canvas where each block's own centre lies, exactly.
    x, y = np.arange(width), np.arange(height)
    start = np.add.outer(
        (turn[1, 1] * y).astype(np.float32), (turn[1, 0] * x + turn[1, 2]).astype(np.float32)
    )
    scale = resolution * _CM
    cm = cv2.addWeighted(back, scale, start, -scale, 0.0, dtype=cv2.CV_16U)  # saturates

    # A free cell beside a wall may have been rounded into it: its other neighbour then.
    row, col = np.divmod(np.flatnonzero((cm == 0) > solid), width)
    v, u = turn @ (col, row, np.ones(len(row)))
    near = np.floor(v + 0.5)
    other = (near + np.where(v < near, -1, 1)).astype(np.int64).clip(0, canvas.shape[1] - 1)
    down = np.floor(u + 0.5).astype(np.int64).clip(0, len(canvas) - 1)
    cm[row, col] = np.clip(np.round((hit[down, other] - u) * scale), 0, _MAX_CM)
    cm[solid] = 0  # occupied cells look from within
    np.minimum(cm, limit, out=out)


def _next_hit(canvas: npt.NDArray[np.uint8]) -> Float32Array:
    """For each pixel the row, with fraction, of the first surface at or below it; else far."""
    wall = canvas >= HIT
    far = np.float32(4 * np.iinfo(np.uint16).max)
    rows = np.arange(len(canvas), dtype=np.float32)[:, None]
    hit = np.where(wall, rows, far)
    row, col = np.divmod(np.flatnonzero(wall[1:] > wall[:-1]), canvas.shape[1])
    before, after = canvas[row, col].astype(np.float32), canvas[row + 1, col].astype(np.float32)
    # Between the two samples, where the interpolated occupancy passes one half.
    hit[row + 1, col] -= np.clip((after - SURFACE) / (after - before), 0, 1)
    # Row by row this is a vector operation; np.minimum.accumulate takes three times as long.
    for i in range(len(hit) - 2, -1, -1):
        np.minimum(hit[i], hit[i + 1], out=hit[i])
    return hit
