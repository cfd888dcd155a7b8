"""Blurred maps at coarser and coarser cells, for a search that starts coarse."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from imgloc.features.lattice import blocks
from imgloc.model import BoolArray, Float32Array

_BAND = 1024  # rows that are computed at a time: a large map takes little memory


@dataclass(frozen=True)
class Level:
    """One level of the pyramid.

    Parameters
    ----------
    image : (H, W) uint8 array
        How well an endpoint in this cell fits the map, 0..255.
    free : (H, W) bool array
        Whether a free cell of the map lies in this cell.
    resolution : float
        Side of a cell, metres. All levels share the corner of cell ``[0, 0]``.
    """

    image: npt.NDArray[np.uint8]
    free: BoolArray
    resolution: float


def pyramid(
    distance: Float32Array,
    free: BoolArray,
    resolution: float,
    *,
    cell: float,
    sigma: float,
    levels: int,
) -> tuple[Level, ...]:
    """Build the endpoint images, finest first.

    The finest level is ``exp(-d^2 / (2 sigma^2))`` of the distance to the nearest surface,
    averaged over its cells; each further level is twice as coarse and keeps the maximum of
    its four cells, so that a fit is not lost before it has been looked at closely.

    Parameters
    ----------
    distance : (H, W) float32 array
        :func:`~imgloc.features.distance.signed_distance`, metres.
    free : (H, W) bool array
        Cells in which a robot can be.
    resolution : float
        Side of a cell of the map, metres.
    cell : float
        Side of a cell of the finest level, metres; rounded to a multiple of `resolution`.
    sigma : float
        How far an endpoint may lie from its surface, metres.
    levels : int
        Number of levels, at least 1.

    Examples
    --------
    >>> d = np.array([[0.5, -0.5, 0.5, 1.5]], dtype=np.float32)
    >>> fine, coarse = pyramid(d, d > 0, 1.0, cell=1.0, sigma=1.0, levels=2)
    >>> fine.image.tolist(), coarse.image.tolist(), coarse.resolution
    ([[225, 225, 225, 83]], [[225, 225]], 2.0)
    """
    factor = max(1, round(cell / resolution))
    rows = factor * max(1, _BAND // factor)
    bands = [distance[top : top + rows] for top in range(0, len(distance), rows)]
    image = np.concatenate([_fit(band, factor, sigma) for band in bands])
    mask = np.asarray(blocks(free, factor).any(axis=(1, 3)))
    out = [Level(image, mask, resolution * factor)]
    for _ in range(levels - 1):
        last = out[-1]
        image = np.asarray(blocks(last.image, 2).max(axis=(1, 3)))
        mask = np.asarray(blocks(last.free, 2).any(axis=(1, 3)))
        out.append(Level(image, mask, 2 * last.resolution))
    return tuple(out)


def _fit(distance: Float32Array, factor: int, sigma: float) -> npt.NDArray[np.uint8]:
    """How well an endpoint in each block fits, from the distances of some rows of cells."""
    fit = np.exp(distance * distance * np.float32(-0.5 / sigma**2)) * np.float32(255)
    return np.asarray(np.rint(blocks(fit, factor).mean(axis=(1, 3))), dtype=np.uint8)
