"""Maps at coarser cells, for searches that start coarse."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from imgloc.model import BoolArray, GridInfo

_BAND = 256  # rows that are computed at a time: a large map takes little memory


def any_of_blocks(mask: BoolArray, factor: int) -> BoolArray:
    """Coarser mask (H', W'): whether any cell of each block is set; beyond the map none is."""
    return _over_blocks(np.logical_or, mask, factor)


def _over_blocks(join: np.ufunc, image: npt.NDArray[Any], factor: int) -> npt.NDArray[Any]:
    """Join the cells of each block; 25 times as fast as :func:`skimage.measure.block_reduce`."""
    for _ in range(2):  # rows, then columns
        out = image[::factor].copy(order="K")
        for k in range(1, min(factor, len(image))):
            part = image[k::factor]
            join(out[: len(part)], part, out=out[: len(part)])
        image = out.T
    return image


def coarse_info(grid: GridInfo, factor: int) -> GridInfo:
    """The lattice of blocks of cells: same corner, cells `factor` times as large."""
    rows, columns = (-(-n // factor) for n in grid.shape)
    return GridInfo(rows, columns, grid.resolution * factor, grid.origin)


@dataclass(frozen=True, eq=False)
class Level:
    """One level of the pyramid."""

    image: npt.NDArray[np.uint8]  #: (H, W) How well an endpoint in this cell fits the map, 0..255
    free: BoolArray  #: (H, W) Whether a free cell of the map lies in this cell
    resolution: float  #: side of a cell, metres. All levels share the corner of cell ``[0, 0]``.


def pyramid(
    distance: npt.NDArray[Any],
    free: BoolArray,
    resolution: float,
    *,
    cell: float,
    sigma: float,
    levels: int,
    unit: float = 1.0,
    recess: float = 0.0,
) -> tuple[Level, ...]:
    """Build the endpoint images, finest first.

    The finest level is ``exp(-d^2 / (2 sigma^2))`` of the distance to the nearest surface,
    averaged over its cells; each further level is twice as coarse and keeps the maximum of its
    four cells: a fit is not lost before it has been looked at closely.

    Parameters
    ----------
    distance, free : (H, W) float32 or int16 array, and bool array
        :func:`~imgloc.features.distance.signed_distance`, in units; where a robot can be.
    resolution, cell, sigma : float
        Metres: sides of a cell of the map and, a multiple of it, of the finest level; how far an
        endpoint may lie from its surface.
    levels : int
        At least 1.
    unit : float
        Unit of `distance`, metres.
    recess : float
        Metres to add to it: the surfaces lie so much deeper in the walls.

    Examples
    --------
    >>> d = np.array([[0.5, -0.5, 0.5, 1.5]], dtype=np.float32)
    >>> fine, coarse = pyramid(d, d > 0, 1.0, cell=1.0, sigma=1.0, levels=2)
    >>> fine.image.tolist(), coarse.image.tolist(), coarse.resolution
    ([[225, 225, 225, 83]], [[225, 225]], 2.0)
    """
    factor = max(1, round(cell / resolution))
    rows = factor * max(1, _BAND // factor)
    tops = range(0, len(distance), rows)
    more = np.float32(recess)
    bands = (distance[top : top + rows] * np.float32(unit) + more for top in tops)
    fits = (np.exp(d * d * np.float32(-0.5 / sigma**2)) * np.float32(255) for d in bands)
    sums = (_over_blocks(np.add, fit, factor) for fit in fits)  # beyond the map nothing fits
    image = np.concatenate([np.rint(s / np.float32(factor**2)).astype(np.uint8) for s in sums])
    out = [Level(image, any_of_blocks(free, factor), resolution * factor)]
    for _ in range(levels - 1):
        last = out[-1]
        image = _over_blocks(np.maximum, last.image, 2)
        out.append(Level(image, any_of_blocks(last.free, 2), 2 * last.resolution))
    return tuple(out)
