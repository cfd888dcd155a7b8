"""Maps at coarser cells, for searches that start coarse.

The *pyramid* is for endpoints. The *pooled* maps are for branch and bound: the image of level h
holds in each cell the maximum of the 2^h x 2^h cells that begin there, so that the sum of it under
a scan at the first pose of a block bounds the score of every pose of it (Hess et al. 2016, eq. 15).
"""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from imgloc.errors import ConfigError
from imgloc.features.fields import in_levels
from imgloc.model import BoolArray, Float32Array, GridInfo

_BAND = 1024  # rows that are computed at a time: a large map takes little memory
#: Side of the largest blocks, metres. Much larger and their bounds exclude nothing, much
#: smaller and there are many of them.
BLOCK = 1.6


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
    averaged over its cells; each further level is twice as coarse and keeps the maximum of its
    four cells: a fit is not lost before it has been looked at closely.

    Parameters
    ----------
    distance, free : (H, W) float32 and bool arrays
        :func:`~imgloc.features.distance.signed_distance`, metres; where a robot can be.
    resolution, cell, sigma : float
        Metres: sides of a cell of the map and, a multiple of it, of the finest level; how far an
        endpoint may lie from its surface.
    levels : int
        At least 1.

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
    fits = (np.exp(d * d * np.float32(-0.5 / sigma**2)) * np.float32(255) for d in bands)
    sums = (_over_blocks(np.add, fit, factor) for fit in fits)  # beyond the map nothing fits
    image = np.concatenate([np.rint(s / np.float32(factor**2)).astype(np.uint8) for s in sums])
    out = [Level(image, any_of_blocks(free, factor), resolution * factor)]
    for _ in range(levels - 1):
        last = out[-1]
        image = _over_blocks(np.maximum, last.image, 2)
        out.append(Level(image, any_of_blocks(last.free, 2), 2 * last.resolution))
    return tuple(out)


@dataclass(frozen=True, eq=False)
class PooledMaps:
    """A blurred map max-pooled over blocks of 1, 2, 4 ... 2^top cells a side."""

    #: (top - 1, H + 2 margin, margin + W) Level h holds the maxima over 2^h x 2^h cells; cell ``[r,
    #: c]`` is at ``[margin + r, margin + c]``, a row's right margin is the left one of the next.
    images: npt.NDArray[np.uint8]
    #: (side^2, H', W') The top level, ``side = 2^top``, in phases: the maximum over the cells that
    #: begin at ``[r, c]`` is at ``[r % side * side + c % side, 1 + r // side, 1 + c // side]``
    coarse: npt.NDArray[np.uint8]
    #: (side^2, H', W') In the same order the four quarters of those cells, as the bytes of a word:
    #: one lookup serves the four blocks that a block of the top level is made of
    quads: npt.NDArray[np.uint32]
    where: tuple[BoolArray, ...]  #: for each level 0 .. top: blocks with a pose wanted; 0 is (H, W)
    margin: int  #: empty cells around the map in `images`
    resolution: float  #: side of a cell, metres

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the map."""
        height, width = self.where[0].shape
        return height, width

    @property
    def top(self) -> int:
        """The coarsest level."""
        return len(self.where) - 1


def pooled_maps(
    bmap: Float32Array,
    where: BoolArray,
    resolution: float,
    *,
    top: int | None = None,
    reach: float = 30.0,
) -> PooledMaps:
    """Pool a blurred map, once for all its scans: ``top + 4`` bytes per cell, and the margins.

    Parameters
    ----------
    bmap : (H, W) float array
        0..1 (:func:`imgloc.features.fields.bmap`), rounded to 256 levels as CBML does.
    where : (H, W) bool array
        Poses that are wanted, usually the free cells.
    resolution : float
        Side of a cell, metres.
    top, reach : int and float, optional
        The coarsest level, at least 1, by default of blocks of about :data:`BLOCK` metres; how far
        scan points may lie, metres: the images are padded anew for a scan beyond it.

    Raises
    ------
    ConfigError, ValueError
        If a number is out of its range; if the arrays differ in shape, or `bmap` leaves 0..1.

    Examples
    --------
    >>> wall = np.array([[0, 0, 0, 0, 1]], dtype=np.float32)
    >>> pooled = pooled_maps(wall, np.ones((1, 5), bool), 1.0, top=3, reach=0.0)
    >>> pooled.images[1, pooled.margin, pooled.margin:].tolist()
    [0, 0, 0, 255, 255]
    """
    if not (np.isfinite(resolution) and resolution > 0):
        raise ConfigError(f"resolution must be a positive number of metres, got {resolution}")
    top = default_top(resolution) if top is None else top
    if not 1 <= top <= 12:
        raise ConfigError(f"top must be 1 to 12, got {top}")
    if not (np.isfinite(reach) and reach >= 0):
        raise ConfigError(f"reach must be a number of metres, at least 0, got {reach}")
    height, width = bmap.shape
    if where.shape != bmap.shape or where.dtype != np.bool_:
        raise ValueError(f"where must be bool {bmap.shape}, got {where.dtype} {where.shape}")
    image = in_levels(bmap)
    margin = margin_of(bmap.shape, resolution, top, reach)
    images = np.zeros((top - 1, height + 2 * margin, margin + width), dtype=np.uint8)
    for level in range(top - 1):
        images[level, margin : margin + height, margin:] = image
        images[level] = _pool(images[level], 1 << level)
    coarse, quads = _phases(image, 1 << top)
    masks = block_masks(where, top)
    out = PooledMaps(images, coarse, quads, masks, margin, resolution)
    for array in (images, coarse, quads, *masks):
        array.flags.writeable = False
    return out


def default_top(resolution: float) -> int:
    """The level whose blocks are about :data:`BLOCK` metres a side, at least 1.

    Examples
    --------
    >>> default_top(0.1), default_top(0.05), default_top(5.0)
    (4, 5, 1)
    """
    return max(1, round(float(np.log2(BLOCK / resolution))))


def margin_of(shape: tuple[int, ...], resolution: float, top: int, reach: float) -> int:
    """Empty cells that a scan of that reach needs around the map, blocks included.

    Examples
    --------
    A point farther off than the map is large misses it from everywhere:

    >>> margin_of((50, 60), 0.1, 4, 3.0), margin_of((50, 60), 0.1, 4, 300.0)
    (47, 76)
    """
    return min(int(np.ceil(reach / resolution)) + 1, max(shape)) + (1 << top)


def block_masks(where: BoolArray, top: int) -> tuple[BoolArray, ...]:
    """For each level 0 .. top the blocks in which a cell of the mask is set.

    Examples
    --------
    >>> [mask.tolist() for mask in block_masks(np.array([[True, False, False]]), 2)]
    [[[True, False, False]], [[True, False]], [[True]]]
    """
    masks = [np.array(where)]
    for _ in range(top):
        masks.append(any_of_blocks(masks[-1], 2))
    return tuple(masks)


def _phases(
    image: npt.NDArray[np.uint8], side: int
) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint32]]:
    """`coarse` and `quads` of :class:`PooledMaps`."""
    half = side // 2
    rows, columns = (-(-n // side) + 1 for n in image.shape)
    # One block before the map, whose cells look into it, and half a one behind.
    ends = [
        (side, (n - 1) * side + half - m) for n, m in zip((rows, columns), image.shape, strict=True)
    ]
    quarter = _pool(np.pad(image, ends), half)
    quads = np.empty((side, side, rows, columns, 4), dtype=np.uint8)
    for which, (r, c) in enumerate(((0, 0), (0, half), (half, 0), (half, half))):
        part = quarter[r : r + rows * side, c : c + columns * side]
        quads[..., which] = part.reshape(rows, side, columns, side).transpose(1, 3, 0, 2)
    quads = quads.reshape(side * side, rows, columns, 4)
    return quads.max(axis=-1), quads.view(np.uint32)[..., 0]


def _pool(image: npt.NDArray[np.uint8], side: int) -> npt.NDArray[np.uint8]:
    """Maximum of the `side` x `side` cells that begin at each cell."""
    kernel = np.ones((side, side), dtype=np.uint8)
    return np.asarray(cv2.dilate(image, kernel, anchor=(0, 0)), dtype=np.uint8)
