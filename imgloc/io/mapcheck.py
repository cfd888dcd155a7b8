"""`imgloc map check`: what is in a map, and what is likely to be wrong with it.

>>> from imgloc.io.maps import bundled_maps
>>> report = check_map(bundled_maps() / "double_wall.yaml")
>>> report.resolution, round(sum(report.shares.values()), 6)
(0.1, 1.0)
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from imgloc.io.files import PathLike, display
from imgloc.io.images import MAX_PIXELS, ImageSize, MapImage, read_image
from imgloc.io.maps import (
    DRAWN,
    GREY_205,
    SLIP,
    SWAPPED,
    MapSettings,
    channel_sum,
    grid_of,
    lacks_unknown,
    load_bytes,
    looks_drawn,
    looks_swapped,
    other_frame,
    resolve_settings,
    unknown_as_free,
)
from imgloc.model import OccupancyGrid, Pose2D, plain
from imgloc.options import Reading

if TYPE_CHECKING:
    from typing_extensions import Unpack

_MANY_GREYS, _HUGE_CELLS = 16, 16_000_000
_MOST = 10  # greys, and parts, that are listed
_CHECKED = 10  # bytes per pixel, more than loading takes
_WARNINGS = {
    "frame": "{frame}",
    "unknown-key": "{keys}: not a key of map_server, ignored (a slip?)",
    "default-threshold": "the YAML lacks a threshold; occupied_thresh {occupied_thresh} and "
    "free_thresh {free_thresh} are used",
    "yaw": "the origin has a yaw of {origin.theta:.4f} rad; it is honoured here, but some "
    "programs ignore it",
    "huge": "{millions:.0f} million cells: expect long times and much memory",
    "centimetres": SLIP,
    "coarse": "{resolution:g} m per cell: poses are rarely finer than that",
    "lossy": "{lossy} alters greys near walls; export the map as PNG",
    "transparent": "{clear:,} cells are not opaque: unknown for Nav2 (trinary and scale), "
    "averaged as a colour by ROS 1 (trinary)",
    "semantics": "{differ:,} cells differ between Nav2 and ROS 1; check `semantics` "
    "(now {semantics})",
    "colour": "{tinted:,} cells are coloured; their channels are averaged",
    "grey-205": GREY_205,
    "no-walls": "no cell is occupied: nothing can be localized",
    "mostly-occupied": "{share:.0%} of the cells are occupied; is negate right?",
    "swapped": SWAPPED,
    "plan": DRAWN,
    "no-unknown": "nothing is unknown: what lies beyond the walls counts as free, where a robot "
    "may be",
    "scale": "the free space is {free_area:.3g} square metres in all on a map of {wide:.4g} x "
    "{high:.4g} m; is the resolution, {resolution:g} m per cell, right?",
    "no-free": "no cell is free: nothing can be localized; are free_thresh and negate right?",
    "many-greys": "{levels:,} grey levels; {unknown:,} of {cells:,} cells fall between the "
    "thresholds (a resampled, smoothed or probabilistic map?)",
}
"""What a check may find, in the order of its output."""


class MapWarning(NamedTuple):
    """A finding: a `code` for programs, a `text` for people."""

    code: str
    text: str

    def __str__(self) -> str:
        return f"{self.code}: {self.text}"


@dataclass(frozen=True)
class MapReport:
    """The findings of :func:`check_map`."""

    path: str  #: the file asked about
    image: str  #: the image it leads to
    kind: str  #: that image's format
    width: int  #: cells, as `height`
    height: int
    resolution: float  #: metres per cell; this and the next as used, see ``MapSettings``
    origin: Pose2D
    mode: str
    semantics: str
    negate: bool
    occupied_thresh: float
    free_thresh: float
    shares: dict[str, float]  #: of all cells: ``occupied``, ``free``, ``unknown``; they sum to 1
    movable: float | None  #: share of all cells, free ones, that the YAML names so, if it does
    #: square metres of the ten largest parts of the free space between which one cannot go (by
    #: cells that share a side)
    free_parts: tuple[float, ...]
    greys: tuple[tuple[float, int], ...]  #: ten most frequent means of the colours, with counts
    grey_levels: int  #: how many different means there are
    semantics_differ: int  #: cells that Nav2 and ROS 1 would read differently
    warnings: tuple[MapWarning, ...]

    @property
    def size(self) -> tuple[float, float]:
        """Width and height in metres."""
        return self.width * self.resolution, self.height * self.resolution

    @property
    def area(self) -> float:
        """Free area, square metres."""
        return self.shares["free"] * self.size[0] * self.size[1]

    def as_row(self) -> dict[str, Any]:
        """The row of the map, as `imgloc map check --json` writes it."""
        first = ("path", "image", "kind", "width", "height", "resolution")
        return {
            **{key: getattr(self, key) for key in first},
            "size": dict(zip(("width", "height"), self.size, strict=True)),
            "free_area": self.area,
            "free_parts": self.free_parts,
            **vars(self),  # all the rest, in its order
            "origin": plain(self.origin),
            "greys": [{"value": value, "cells": cells} for value, cells in self.greys],
            "warnings": [warning._asdict() for warning in self.warnings],
        }


def check_map(path: PathLike, **reading: "Unpack[Reading]") -> MapReport:
    """Look at a map that can be decoded, and report rather than refuse.

    Parameters
    ----------
    path, reading
        As in :func:`imgloc.io.maps.load_map`, and so are the errors; but for lossy images and for
        too many cells a side, there is only a warning.
    """
    settings = resolve_settings(path, **reading)
    most = reading.get("max_pixels", MAX_PIXELS)
    image = read_image(settings.image, max_pixels=most, allow_lossy=True)
    one, other = (grid_of(image, replace(settings, semantics=s)) for s in ("nav2", "ros1"))
    differ = int(np.count_nonzero((one.occupied != other.occupied) | (one.free != other.free)))
    del one, other
    grid = grid_of(image, settings)
    upright = image.pixels[::-1]  # row 0 at the bottom as in the grid; alpha aside
    sums, channels = channel_sum(upright[:, :, :3] if image.channels > 1 else upright)
    histogram = _histogram(sums, channels * image.white + 1)
    levels = np.flatnonzero(histogram)
    order = levels[np.argsort(-histogram[levels], kind="stable")][:_MOST]
    masks = {"occupied": grid.occupied, "free": grid.free, "unknown": grid.unknown}
    counts = {name: int(np.count_nonzero(mask)) for name, mask in masks.items()}
    shares = {name: count / sums.size for name, count in counts.items()}
    del masks
    counts |= {"differ": differ, "levels": len(levels)}
    _, parts = cv2.connectedComponents(grid.free.view(np.uint8), connectivity=4)
    sizes = np.sort(_histogram(parts, int(parts.max()) + 1)[1:])[::-1]
    del parts
    as_used = {key: value for key, value in vars(settings).items() if key not in ("image", "yaml")}
    return MapReport(
        path=display(path),
        image=display(settings.image),
        kind=image.kind,
        width=grid.info.width,
        height=grid.info.height,
        **as_used,
        shares=shares,
        movable=None if grid.movable is None else float(grid.movable.mean()),
        free_parts=tuple(float(size) * grid.resolution**2 for size in sizes[:_MOST]),
        greys=tuple((round(int(i) / channels, 2), int(histogram[i])) for i in order),
        grey_levels=len(levels),
        semantics_differ=differ,
        warnings=_warnings(settings, image, sums, grid, counts),
    )


def check_bytes(size: ImageSize) -> int:
    """Peak of :func:`check_map`, bytes; see :func:`imgloc.io.maps.load_bytes`."""
    return load_bytes(size) + _CHECKED * size.width * size.height


def _histogram(sums: npt.NDArray[Any], size: int) -> npt.NDArray[np.intp]:
    # By blocks: bincount makes an eight-byte copy of what it counts.
    blocks = np.array_split(sums, 1 + sums.size // 4_000_000)
    return np.asarray(np.sum([np.bincount(b.ravel(), minlength=size) for b in blocks], axis=0))


def _warnings(
    used: MapSettings, image: MapImage, sums: npt.NDArray[Any], grid: OccupancyGrid,
    n: dict[str, int],
) -> tuple[MapWarning, ...]:  # fmt: skip
    """Findings about the file, its frame and reading, and the greys; `n` counts cells."""
    height, width = grid.info.shape
    said, clear, trap, tinted = used.yaml, 0, unknown_as_free(image, used, grid), 0
    unknown_keys, area = said.unknown_keys if said else (), n["free"] * used.resolution**2
    if image.channels == 4:
        clear = int(np.count_nonzero(image.pixels[:, :, 3] < image.white))
    if image.channels > 1:
        colours = image.pixels[:, :, :3]
        tinted = int(np.count_nonzero(colours.max(axis=2) != colours.min(axis=2)))
    # Where much grey 205 is read as free, that is why nothing is unknown.
    swapped = looks_swapped(grid)
    known = n["free"] and n["occupied"] and not (trap or swapped) and lacks_unknown(grid)
    drawn = known and looks_drawn(grid)
    found = {
        "frame": (frame := other_frame(used)), "unknown-key": unknown_keys,
        "default-threshold": said and None in (said.occupied_thresh, said.free_thresh),
        "yaw": used.origin.theta, "huge": sums.size > _HUGE_CELLS,
        "centimetres": used.resolution >= 1, "coarse": used.resolution > 0.25,
        "lossy": image.lossy, "transparent": clear, "semantics": n["differ"], "colour": tinted,
        "grey-205": trap, "no-walls": not n["occupied"],
        "mostly-occupied": n["occupied"] > 0.5 * sums.size, "swapped": swapped, "plan": drawn,
        "no-unknown": known and not drawn, "scale": n["free"] and not 2 < area < 4e6,
        "no-free": not n["free"],
        "many-greys": n["levels"] > _MANY_GREYS and used.mode == "trinary",
    }  # fmt: skip
    values = {
        **vars(used), **n, "height": height, "width": width,
        "frame": frame, "keys": ", ".join(unknown_keys),
        "clear": clear, "tinted": tinted, "trap": trap,
        "cells": sums.size, "millions": sums.size / 1e6,
        "lossy": {"jpeg": "JPEG", "webp": "lossy WebP"}.get(image.kind, "JPEG in a TIFF"),
        "share": n["occupied"] / sums.size, "free_area": area, "metres": used.resolution / 100,
        "wide": width * used.resolution, "high": height * used.resolution,
    }  # fmt: skip
    return tuple(
        MapWarning(code, text.format_map(values)) for code, text in _WARNINGS.items() if found[code]
    )
