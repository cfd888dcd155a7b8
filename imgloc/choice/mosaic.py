"""A bound on how well a scan fits each of many maps, from one look at all of them side by side.

The coarse levels of maps of about one size are interleaved. A mosaic is one image in which column
``c * n + m`` is column ``c`` of map ``m`` of `n`. A shift by `n` columns shifts all maps by one,
and no map is shifted into another. Alg. 2 thus runs over hundreds of maps as over one large image.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from imgloc.features.pyramid import Level
from imgloc.geometry import uniform_thetas
from imgloc.likelihoods.slices import cell_offsets
from imgloc.model import BoolArray, FloatArray
from imgloc.options import Prior
from imgloc.threads import over_slices

CELLS = 1 << 18
"""Approximate number of cells of a mosaic: its sums and their summands stay in the cache."""
_ALIKE = 1.2  # largest factor between the widths of the maps of a mosaic
_MOST = np.iinfo(np.uint8).max


@dataclass(frozen=True, eq=False)
class Mosaic:
    """The same level of some maps as one image."""

    image: npt.NDArray[np.uint8]  #: (H, W * n) endpoint images of the maps, interleaved
    free: BoolArray  #: (H, W * n) free cells of the maps, interleaved
    maps: tuple[int, ...]  #: (n,) indices of the maps
    resolution: float  #: side of a cell, metres
    turn: float  #: yaw of their origins, radians

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the largest of the maps."""
        height, width = self.image.shape
        return height, width // len(self.maps)


def mosaics(levels: Sequence[Level], turns: Sequence[float]) -> Iterator[Mosaic]:
    """Interleave one level of many maps, those of about one size together.

    `turns` are the yaws of the origins of the maps, radians.

    Examples
    --------
    >>> image = np.array([[1, 2], [3, 4]], np.uint8)
    >>> level = Level(image, image > 0, 0.4)
    >>> (mosaic,) = mosaics([level, Level(image[:1], image[:1] > 3, 0.4)], [0.0, 0.0])
    >>> mosaic.maps, mosaic.image.tolist()
    ((1, 0), [[1, 1, 2, 2], [0, 3, 0, 4]])
    """
    groups: dict[tuple[float, ...], list[int]] = {}
    for k, (level, turn) in enumerate(zip(levels, turns, strict=True)):
        width = np.floor(np.log(level.image.shape[1]) / np.log(_ALIKE))
        groups.setdefault((level.resolution, turn, float(width)), []).append(k)
    for (resolution, turn, _), alike in sorted(groups.items()):
        alike.sort(key=lambda k: levels[k].image.shape)
        each = max(1, CELLS // max(levels[k].image.size for k in alike))
        for first in range(0, len(alike), each):
            some = tuple(alike[first : first + each])
            height, width = np.max([levels[k].image.shape for k in some], axis=0).tolist()
            image = np.zeros((height, width, len(some)), np.uint8)
            free = np.zeros(image.shape, bool)
            for i, k in enumerate(some):
                rows, columns = levels[k].image.shape
                image[:rows, :columns, i] = levels[k].image
                free[:rows, :columns, i] = levels[k].free
            flat = height, width * len(some)
            yield Mosaic(image.reshape(flat), free.reshape(flat), some, resolution, turn)


def best_fits(
    tiles: Iterable[Mosaic], xy: FloatArray, count: int, *, theta_step: float,
    prior: Prior | None = None, threads: int = 1,
) -> FloatArray:  # fmt: skip
    """Largest share of a scan, over all poses, that falls on walls of each map: (count,), 0..1.

    Parameters
    ----------
    tiles : iterable of Mosaic
        The mosaics of `count` maps.
    xy : (N, 2) float array
        At most 255 scan points, sensor frame, metres.
    theta_step : float
        Largest step between headings, radians.
    prior : Prior, optional
        Limits the headings, map frame. Its cells are not used.
    threads : int
        Number of threads. The result does not depend on it.

    Examples
    --------
    >>> image = np.array([[0, 0, 255, 0]], np.uint8)
    >>> levels = [Level(image, image == 0, 1.0), Level(image, image > 0, 1.0)]
    >>> tiles = mosaics(levels, [0.0, 0.0])
    >>> best_fits(tiles, np.array([[1.0, 0.0]]), 2, theta_step=1.6).tolist()
    [1.0, 0.0]
    """
    out, levels = np.zeros(count), _MOST // max(1, len(xy))
    every = uniform_thetas(theta_step)
    for tile in tiles:
        # With few grey levels a byte holds the sum, which halves the memory to move.
        image = np.rint(tile.image * np.float32(levels / _MOST)).astype(np.uint8)
        wanted = np.ones(len(every), bool)
        if prior is not None:
            wanted = prior.headings(every + tile.turn, theta_step)
        offsets = cell_offsets(xy, every[wanted], tile.resolution).tolist()
        found = [np.zeros_like(image)]

        def work(
            share: Iterable[list[list[int]]],
            image: npt.NDArray[np.uint8] = image,
            shape: tuple[int, int] = tile.shape,
            n: int = len(tile.maps),
            found: list[npt.NDArray[np.uint8]] = found,
        ) -> None:
            (height, width), total, best = shape, np.empty_like(image), np.zeros_like(image)
            for shifts in share:
                total.fill(0)
                for dr, dc in shifts:
                    if abs(dr) < height and abs(dc) < width:  # the others miss from every pose
                        there = image[max(0, dr) : height + dr, max(0, dc) * n : (width + dc) * n]
                        here = total[max(0, -dr) : height - dr, max(0, -dc) * n : (width - dc) * n]
                        np.add(here, there, out=here)  # Alg. 2, l. 4-6
                np.maximum(best, total, out=best)
            found.append(best)

        over_slices(work, offsets, threads)
        best = np.maximum.reduce(found) * tile.free
        out[list(tile.maps)] = best.reshape(-1, len(tile.maps)).max(axis=0)
    return out / (levels * max(1, len(xy)))
