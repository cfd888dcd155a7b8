"""`imgloc map check`: what is in a map, and what is likely to be wrong with it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from imgloc.io.files import PathLike, display
from imgloc.io.images import MAX_PIXELS, MapImage, read_image
from imgloc.io.maps import grid_of
from imgloc.io.mapsettings import resolve_settings
from imgloc.io.mapwarnings import MapWarning, class_warnings, settings_warnings
from imgloc.io.occupancy import channel_sum
from imgloc.model import Pose2D

__all__ = ["MapReport", "MapWarning", "check_map"]


@dataclass(frozen=True)
class MapReport:
    """What :func:`check_map` found.

    Parameters
    ----------
    path, image, kind : str
        The file asked about, the image it leads to, and that image's format.
    width, height : int
        Cells.
    resolution : float
        Metres per cell.
    origin : Pose2D
        With its yaw.
    mode, semantics : str
        How the greys were read.
    negate : bool
        Whether white is occupied.
    occupied_thresh, free_thresh : float
        As used.
    shares : dict
        Of all cells: ``occupied``, ``free``, ``unknown``; they sum to 1.
    greys : tuple of (value, count)
        The most frequent grey values (mean of the colour channels), at most ten.
    grey_levels : int
        How many different values there are.
    semantics_differ : int
        Cells that Nav2 and ROS 1 would read differently.
    warnings : tuple of MapWarning
        Empty for a map without anything remarkable.
    """

    path: str
    image: str
    kind: str
    width: int
    height: int
    resolution: float
    origin: Pose2D
    mode: str
    semantics: str
    negate: bool
    occupied_thresh: float
    free_thresh: float
    shares: dict[str, float]
    greys: tuple[tuple[float, int], ...]
    grey_levels: int
    semantics_differ: int
    warnings: tuple[MapWarning, ...]

    @property
    def size(self) -> tuple[float, float]:
        """Width and height in metres."""
        return self.width * self.resolution, self.height * self.resolution

    @property
    def area(self) -> float:
        """Free area, square metres."""
        return self.shares["free"] * self.size[0] * self.size[1]


def check_map(
    path: PathLike,
    *,
    resolution: float | None = None,
    origin: Pose2D | Sequence[float] | None = None,
    mode: str | None = None,
    semantics: str = "nav2",
    occupied_thresh: float | None = None,
    free_thresh: float | None = None,
    negate: bool | None = None,
    max_pixels: int = MAX_PIXELS,
) -> MapReport:
    """Look at a map that can be decoded, and report rather than refuse.

    Parameters are those of :func:`imgloc.io.maps.load_map`; JPEG is accepted with a warning.

    Returns
    -------
    MapReport

    Raises
    ------
    MapError, ConfigError
        As :func:`~imgloc.io.maps.load_map`, but not for JPEG or too many cells a side.
    """
    settings = resolve_settings(
        path, resolution, origin, mode, semantics, occupied_thresh, free_thresh, negate, max_pixels
    )
    image = read_image(settings.image, max_pixels=max_pixels, allow_lossy=True)
    grid = grid_of(image, settings)
    other = grid_of(image, replace(settings, semantics=_other(semantics)))
    differ = (grid.occupied != other.occupied) | (grid.free != other.free)
    sums, channels = _colour_sums(image)
    histogram = _histogram(sums, channels * image.white + 1)
    levels = np.flatnonzero(histogram)
    order = levels[np.argsort(-histogram[levels], kind="stable")][:10]
    occupied, free = float(grid.occupied.mean()), float(grid.free.mean())
    n_differ = int(np.count_nonzero(differ))
    return MapReport(
        path=display(path),
        image=display(settings.image),
        kind=image.kind,
        width=grid.info.width,
        height=grid.info.height,
        resolution=settings.resolution,
        origin=settings.origin,
        mode=settings.mode,
        semantics=semantics,
        negate=settings.negate,
        occupied_thresh=settings.occupied_thresh,
        free_thresh=settings.free_thresh,
        shares={
            "occupied": occupied,
            "free": free,
            "unknown": float(np.count_nonzero(grid.unknown)) / grid.occupied.size,
        },
        greys=tuple((round(int(i) / channels, 2), int(histogram[i])) for i in order),
        grey_levels=len(levels),
        semantics_differ=n_differ,
        warnings=(
            *settings_warnings(settings, image, grid, n_differ),
            *class_warnings(settings, image, sums, grid, len(levels)),
        ),
    )


def _other(semantics: str) -> str:
    return "ros1" if semantics == "nav2" else "nav2"


def _colour_sums(image: MapImage) -> tuple[npt.NDArray[Any], int]:
    """Sum of the colour channels, alpha aside, row 0 at the bottom; and their number."""
    colours = image.pixels[::-1]
    return channel_sum(colours if image.channels == 1 else colours[:, :, :3])


def _histogram(sums: npt.NDArray[Any], size: int) -> npt.NDArray[np.intp]:
    # By blocks: bincount makes an eight-byte copy of what it counts.
    blocks = np.array_split(sums, 1 + sums.size // 4_000_000)
    return np.asarray(np.sum([np.bincount(b.ravel(), minlength=size) for b in blocks], axis=0))
