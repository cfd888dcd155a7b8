"""Images at coarser cells: blocks of cells, seen as two more axes."""

from typing import Any

import numpy as np
import numpy.typing as npt

from imgloc.model import BoolArray, GridInfo


def blocks(image: npt.NDArray[Any], factor: int) -> npt.NDArray[Any]:
    """Cut an image into blocks of `factor` x `factor` cells.

    Returns
    -------
    (H', factor, W', factor) array
        Reduce over axes 1 and 3. Blocks that stick out are filled with zeros (no wall, not
        free).

    Examples
    --------
    >>> blocks(np.arange(6).reshape(2, 3), 2).sum(axis=(1, 3)).tolist()
    [[8, 7]]
    """
    height, width = image.shape
    rows, columns = -height % factor, -width % factor
    padded = np.pad(image, ((0, rows), (0, columns))) if rows or columns else image
    return padded.reshape((height + rows) // factor, factor, (width + columns) // factor, factor)


def any_of_blocks(mask: BoolArray, factor: int) -> BoolArray:
    """Coarser mask (H', W'): whether any cell of each block is set."""
    return np.asarray(blocks(mask, factor).any(axis=(1, 3)))


def coarse_info(grid: GridInfo, factor: int) -> GridInfo:
    """The lattice of :func:`blocks`: same corner, cells `factor` times as large."""
    return GridInfo(
        -(-grid.height // factor),
        -(-grid.width // factor),
        grid.resolution * factor,
        grid.origin,
    )
