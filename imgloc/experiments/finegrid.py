"""A map redrawn with finer cells: what rays are cast on when scans are simulated."""

import cv2
import numpy as np

from imgloc.model import BoolArray, Float32Array, OccupancyGrid

FINE = 0.01
"""Cells on which scans are simulated, metres."""
_MAX_CELLS = 16_000_000

# Blurred by 0.7 cells, a straight wall of one cell is worth 0.57 at its centre and 0.20 one cell
# off. Raised to 0.8 its outline at 0.5 is again half a cell off, as it was; so with gaps.
_BLUR = 0.7
_THIN, _THIN_VALUE = 0.6, 0.8


def refine_grid(
    grid: OccupancyGrid, resolution: float = FINE, *, max_cells: int = _MAX_CELLS
) -> OccupancyGrid:
    """Redraw a map with smaller cells and smooth outlines, so that walls have no stairs.

    The occupancy image is blurred by 0.7 cells, enlarged bilinearly and cut at one half; walls
    and gaps that are one cell thin are kept.

    Parameters
    ----------
    grid : OccupancyGrid
    resolution : float
        Side of a cell wanted, metres. The side of the map's cells is divided by a whole
        number that comes closest to it.
    max_cells : int
        No more cells than this: a large map is refined less.

    Returns
    -------
    OccupancyGrid
        Same place, same origin; `grid` itself if its cells need not be smaller.

    Examples
    --------
    >>> coarse = OccupancyGrid(np.eye(4, dtype=bool), ~np.eye(4, dtype=bool), 0.1)
    >>> refine_grid(coarse, 0.02).occupied.shape
    (20, 20)
    """
    height, width = grid.occupied.shape
    factor = fine_factor(grid, resolution, max_cells=max_cells)
    if factor == 1:
        return grid
    size = (width * factor, height * factor)
    occupied = cv2.resize(_smooth(grid.occupied), size, interpolation=cv2.INTER_LINEAR) >= 0.5
    free = cv2.resize(grid.free.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    # Along a wall, part of an occupied cell may come out as not occupied: it is free there.
    known = cv2.resize((~grid.unknown).astype(np.uint8), size, interpolation=cv2.INTER_NEAREST)
    return OccupancyGrid(
        occupied, (free | (known > 0)) & ~occupied, grid.resolution / factor, grid.origin
    )


def fine_factor(
    grid: OccupancyGrid, resolution: float = FINE, *, max_cells: int = _MAX_CELLS
) -> int:
    """How many cells of :func:`refine_grid` lie along a cell of the map.

    Examples
    --------
    >>> fine_factor(OccupancyGrid(np.eye(4, dtype=bool), ~np.eye(4, dtype=bool), 0.1), 0.02)
    5
    """
    most = int((max_cells / grid.occupied.size) ** 0.5)
    return max(1, min(round(grid.resolution / resolution), most))


def _smooth(occupied: BoolArray) -> Float32Array:
    """Blurred occupancy whose outline at 0.5 keeps walls and gaps of a single cell."""
    image = np.asarray(occupied, dtype=np.float32)
    out = cv2.GaussianBlur(image, (0, 0), _BLUR, borderType=cv2.BORDER_REPLICATE)
    out[occupied & (out < _THIN)] = _THIN_VALUE
    out[~occupied & (out > 1 - _THIN)] = 1 - _THIN_VALUE
    return np.asarray(out, dtype=np.float32)
