"""What is likely to be wrong with a map: the findings of `imgloc map check`."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from imgloc.io.images import MapImage
from imgloc.io.maps import MAX_SIDE
from imgloc.io.mapsettings import MapSettings
from imgloc.model import OccupancyGrid

_MANY_GREYS = 16
_HUGE_CELLS = 16_000_000


class MapWarning(NamedTuple):
    """A finding: a `code` for programs, a `text` for people."""

    code: str
    text: str

    def __str__(self) -> str:
        return f"{self.code}: {self.text}"


def settings_warnings(
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
    if image.kind == "jpeg":
        yield MapWarning("lossy", "JPEG alters greys near walls; export the map as PNG")
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


def class_warnings(
    settings: MapSettings,
    image: MapImage,
    sums: npt.NDArray[Any],
    grid: OccupancyGrid,
    levels: int,
) -> Iterator[MapWarning]:
    """Findings about the greys and what they became.

    `sums` are the colour channels added up, row 0 at the bottom; `levels` of them differ.
    """
    cells = grid.occupied.size
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
            f"{levels:,} grey levels; {unclear:,} of {cells:,} cells fall between the thresholds "
            "(a resampled, smoothed or probabilistic map?)",
        )
