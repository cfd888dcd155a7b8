"""`imgloc map check`: what is in a map, and what is likely to be wrong with it."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Unpack

import numpy as np
import numpy.typing as npt
from skimage.measure import label

from imgloc.io.files import PathLike, display
from imgloc.io.images import MAX_PIXELS, ImageSize, MapImage, read_image
from imgloc.io.maps import (
    MAX_SIDE,
    MapSettings,
    Reading,
    channel_sum,
    grid_of,
    load_bytes,
    resolve_settings,
)
from imgloc.model import OccupancyGrid, Pose2D

_MANY_GREYS = 16
_HUGE_CELLS = 16_000_000
_MOST = 10  # greys, and parts, that are listed
_CHECKED = 10  # bytes per pixel, more than loading takes


class MapWarning(NamedTuple):
    """A finding: a `code` for programs, a `text` for people."""

    code: str
    text: str

    def __str__(self) -> str:
        return f"{self.code}: {self.text}"


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
    free_parts : tuple of float
        Square metres of the largest parts of the free space between which one cannot go (by
        cells that share a side), at most ten.
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
    free_parts: tuple[float, ...]
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


def check_map(path: PathLike, **reading: Unpack[Reading]) -> MapReport:
    """Look at a map that can be decoded, and report rather than refuse.

    Parameters are those of :func:`imgloc.io.maps.load_map`; lossy images are accepted with a
    warning.

    Raises
    ------
    MapError, ConfigError
        As :func:`~imgloc.io.maps.load_map`, but not for JPEG or too many cells a side.
    """
    settings = resolve_settings(path, **reading)
    most = reading.get("max_pixels", MAX_PIXELS)
    image = read_image(settings.image, max_pixels=most, allow_lossy=True)
    differ = _read_differently(image, settings)
    grid = grid_of(image, settings)
    # Alpha aside, row 0 at the bottom as in the grid.
    sums, channels = channel_sum(
        image.pixels[::-1, :, :3] if image.channels > 1 else image.pixels[::-1]
    )
    histogram = _histogram(sums, channels * image.white + 1)
    levels = np.flatnonzero(histogram)
    order = levels[np.argsort(-histogram[levels], kind="stable")][:_MOST]
    shares = {
        name: float(np.count_nonzero(cells)) / grid.occupied.size
        for name, cells in (("occupied", grid.occupied), ("free", grid.free))
    }
    return MapReport(
        path=display(path),
        image=display(settings.image),
        kind=image.kind,
        width=grid.info.width,
        height=grid.info.height,
        resolution=settings.resolution,
        origin=settings.origin,
        mode=settings.mode,
        semantics=settings.semantics,
        negate=settings.negate,
        occupied_thresh=settings.occupied_thresh,
        free_thresh=settings.free_thresh,
        shares=shares | {"unknown": float(np.count_nonzero(grid.unknown)) / grid.occupied.size},
        free_parts=_parts(grid),
        greys=tuple((round(int(i) / channels, 2), int(histogram[i])) for i in order),
        grey_levels=len(levels),
        semantics_differ=differ,
        warnings=(
            *_about_settings(settings, image, grid, differ),
            *_about_greys(settings, image, sums, grid, len(levels)),
        ),
    )


def check_bytes(size: ImageSize) -> int:
    """Peak of :func:`check_map`, bytes; see :func:`imgloc.io.maps.load_bytes`."""
    return load_bytes(size) + _CHECKED * size.width * size.height


def _read_differently(image: MapImage, settings: MapSettings) -> int:
    """Count the cells of which Nav2 and ROS 1 would make something else."""
    one, other = (grid_of(image, replace(settings, semantics=s)) for s in ("nav2", "ros1"))
    return int(np.count_nonzero((one.occupied != other.occupied) | (one.free != other.free)))


def _histogram(sums: npt.NDArray[Any], size: int) -> npt.NDArray[np.intp]:
    # By blocks: bincount makes an eight-byte copy of what it counts.
    blocks = np.array_split(sums, 1 + sums.size // 4_000_000)
    return np.asarray(np.sum([np.bincount(b.ravel(), minlength=size) for b in blocks], axis=0))


def _parts(grid: OccupancyGrid) -> tuple[float, ...]:
    """Areas of the parts of the free space, square metres, largest first."""
    parts = label(grid.free, connectivity=1)
    sizes = np.sort(_histogram(parts, int(parts.max()) + 1)[1:])[::-1]
    return tuple(float(size) * grid.resolution**2 for size in sizes[:_MOST])


def _about_settings(
    settings: MapSettings, image: MapImage, grid: OccupancyGrid, differ: int
) -> Iterator[MapWarning]:
    """Findings about the file, its size, frame and reading; `differ` cells depend on it."""
    height, width = grid.occupied.shape
    said = settings.yaml
    if said is not None and said.unknown_keys:
        yield MapWarning(
            "unknown-key",
            f"{', '.join(said.unknown_keys)}: not a key of map_server, ignored (a slip?)",
        )
    if said is not None and (said.occupied_thresh is None or said.free_thresh is None):
        yield MapWarning(
            "default-threshold",
            f"the YAML lacks a threshold; occupied_thresh {settings.occupied_thresh} and "
            f"free_thresh {settings.free_thresh} are used",
        )
    if settings.origin.theta:
        yield MapWarning(
            "yaw",
            f"the origin has a yaw of {settings.origin.theta:.4f} rad; it is honoured here, "
            "but some programs ignore it",
        )
    if max(height, width) > MAX_SIDE:
        yield MapWarning(
            "side",
            f"{width:,} x {height:,} cells: Nav2 and imgloc load at most {MAX_SIDE:,} a side",
        )
    if height * width > _HUGE_CELLS:
        yield MapWarning(
            "huge", f"{height * width / 1e6:.0f} million cells: expect long times and much memory"
        )
    if settings.resolution > 0.25:
        yield MapWarning(
            "coarse", f"{settings.resolution:g} m per cell: poses can hardly be finer than that"
        )
    if image.lossy:
        kind = {"jpeg": "JPEG", "webp": "lossy WebP"}.get(image.kind, "JPEG in a TIFF")
        yield MapWarning("lossy", f"{kind} alters greys near walls; export the map as PNG")
    if image.channels == 4:
        clear = int(np.count_nonzero(image.pixels[:, :, 3] < image.white))
        if clear:
            yield MapWarning(
                "transparent",
                f"{clear:,} cells are not opaque: unknown for Nav2 (trinary and scale), averaged "
                "as a colour by ROS 1 (trinary)",
            )
    if differ:
        yield MapWarning(
            "semantics",
            f"{differ:,} cells differ between Nav2 and ROS 1; check --semantics "
            f"(now {settings.semantics})",
        )


def _about_greys(
    settings: MapSettings,
    image: MapImage,
    sums: npt.NDArray[Any],
    grid: OccupancyGrid,
    levels: int,
) -> Iterator[MapWarning]:
    """Findings about the greys (`sums` of channels, of which `levels` differ) and the classes."""
    if image.channels > 1:
        colours = image.pixels[:, :, :3]
        tinted = int(np.count_nonzero(colours.max(axis=2) != colours.min(axis=2)))
        if tinted:
            yield MapWarning(
                "colour", f"{tinted:,} cells are coloured; their channels are averaged"
            )
    if settings.mode != "raw":
        # map_saver writes unknown as 205: occ = 0.196, just above its own free_thresh.
        full = image.white * min(image.channels, 3)
        is_205 = np.round(np.arange(full + 1) * (255 / full)) == 205
        trap = int(np.count_nonzero(is_205[sums] & grid.free))
        if trap:
            yield MapWarning(
                "grey-205",
                f"{trap:,} cells of grey 205, map_saver's unknown, count as free because "
                f"free_thresh is {settings.free_thresh:g}; 0.196 keeps them unknown",
            )
    if not grid.occupied.any():
        yield MapWarning("no-walls", "no cell is occupied: nothing can be localized")
    elif float(grid.occupied.mean()) > 0.5:
        yield MapWarning(
            "mostly-occupied",
            f"{grid.occupied.mean():.0%} of the cells are occupied; is negate right?",
        )
    if not grid.free.any():
        yield MapWarning("no-free", "no cell is free: nothing can be localized")
    if levels > _MANY_GREYS and settings.mode == "trinary":
        unclear = int(np.count_nonzero(grid.unknown))
        yield MapWarning(
            "many-greys",
            f"{levels:,} grey levels; {unclear:,} of {grid.occupied.size:,} cells fall between "
            "the thresholds (a resampled, smoothed or probabilistic map?)",
        )
