"""Map files to :class:`~imgloc.model.OccupancyGrid` and back."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import yaml

from imgloc.errors import ConfigError, MapError
from imgloc.io.files import PathLike, display
from imgloc.io.images import MAX_PIXELS, MapImage, read_image
from imgloc.io.mapsettings import (
    FREE_THRESH,
    OCCUPIED_THRESH,
    YAML_ENDINGS,
    MapSettings,
    resolve_settings,
)
from imgloc.io.occupancy import classify, occupancy
from imgloc.io.output import encode_png, refuse_existing, write_bytes_atomic
from imgloc.model import OccupancyGrid, Pose2D

MAX_SIDE = 32_767
"""Cells a side: the limit of Nav2 (map_io) and of ``cv2.remap``."""


def load_map(
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
    allow_lossy: bool = False,
) -> OccupancyGrid:
    """Load a map.

    A map without walls or without free cells is loaded too, so that it can be looked at;
    :func:`require_usable` refuses it.

    Parameters
    ----------
    path : path
        A map_server YAML (the image is found relative to it), or an image; then
        `resolution` is needed, as it is never guessed.
    resolution : float, optional
        Metres per cell, 0.001 to 10; overrides the YAML, as do the next ones.
    origin : Pose2D or (x, y, yaw), optional
        Pose of the lower-left corner in the map frame, m and rad; (0, 0, 0) for an image.
    mode : {'trinary', 'scale', 'raw'}, optional
        Default trinary; see :func:`imgloc.io.occupancy.occupancy`.
    semantics : {'nav2', 'ros1'}
        Whose reading of thresholds and transparency.
    occupied_thresh, free_thresh : float, optional
        Occupancies, ``0 <= free_thresh < occupied_thresh <= 1``; default 0.65 and 0.196.
    negate : bool, optional
        White is occupied; default False.
    max_pixels : int
        Larger images are refused before they are decoded.
    allow_lossy : bool
        Accept JPEG.

    Returns
    -------
    OccupancyGrid
        Row 0 is the lowest y: the image is turned over here, once.

    Raises
    ------
    MapError
        A file is missing, damaged, too large or contradicts itself.
    ConfigError
        An argument is out of its range.
    """
    settings = resolve_settings(
        path, resolution, origin, mode, semantics, occupied_thresh, free_thresh, negate, max_pixels
    )
    image = read_image(settings.image, max_pixels=max_pixels, allow_lossy=allow_lossy)
    height, width = image.pixels.shape[:2]
    if max(height, width) > MAX_SIDE:
        raise MapError(
            f"{display(settings.image)}: {width:,} x {height:,} cells, expected at most "
            f"{MAX_SIDE:,} a side; crop or downsample the map"
        )
    return grid_of(image, settings)


def grid_of(image: MapImage, settings: MapSettings) -> OccupancyGrid:
    """Read the pixels of `image` as `settings` says; see :func:`load_map`."""
    values = occupancy(
        image,
        mode=settings.mode,
        semantics=settings.semantics,
        negate=settings.negate,
        occupied_thresh=settings.occupied_thresh,
        free_thresh=settings.free_thresh,
    )
    occupied, free = classify(
        np.ascontiguousarray(values[::-1]),
        mode=settings.mode,
        occupied_thresh=settings.occupied_thresh,
        free_thresh=settings.free_thresh,
    )
    return OccupancyGrid(occupied, free, settings.resolution, settings.origin)


def require_usable(grid: OccupancyGrid, name: str) -> None:
    """Refuse a map in which nothing can be localized.

    Raises
    ------
    MapError
        If `grid` has no occupied or no free cell.
    """
    cells = grid.occupied.size
    for what, found in (("occupied", grid.occupied.any()), ("free", grid.free.any())):
        if not found:
            raise MapError(
                f"{name}: none of its {cells:,} cells is {what}, expected walls and free space; "
                "look at the greys with 'imgloc map check', and at negate and the thresholds"
            )


def save_map(path_yaml: PathLike, grid: OccupancyGrid, *, force: bool = False) -> Path:
    """Write `grid` as a map_server YAML and a PNG of the same stem beside it.

    Occupied is 0, free 254, unknown 205, as map_saver writes them.

    Parameters
    ----------
    path_yaml : path
        Ends in ``.yaml`` or ``.yml``.
    grid : OccupancyGrid
    force : bool
        Overwrite existing files.

    Returns
    -------
    Path
        Of the PNG.

    Raises
    ------
    OutputError
        A file exists, or cannot be written.
    ConfigError
        `path_yaml` is not named as a YAML.
    """
    target = Path(path_yaml)
    if target.suffix.lower() not in YAML_ENDINGS:
        raise ConfigError(f"{display(path_yaml)}: expected a name that ends in .yaml")
    png = target.with_suffix(".png")
    if not force:
        refuse_existing(target)
        refuse_existing(png)
    pixels = np.full(grid.occupied.shape, 205, np.uint8)
    pixels[grid.free] = 254
    pixels[grid.occupied] = 0
    text = yaml.safe_dump(
        {
            "image": png.name,
            "resolution": float(grid.resolution),
            "origin": [grid.origin.x, grid.origin.y, grid.origin.theta],
            "negate": 0,
            "occupied_thresh": OCCUPIED_THRESH,
            "free_thresh": FREE_THRESH,
            "mode": "trinary",
        },
        sort_keys=False,
        allow_unicode=True,
    )
    write_bytes_atomic(png, encode_png(pixels[::-1]), force=force)
    write_bytes_atomic(target, text.encode("utf-8"), force=force)
    return png
