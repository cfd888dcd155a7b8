"""Pictures of measurements: where on a map one scan is enough, and where a map has aged."""

from collections.abc import Mapping, Sequence

import cv2
import numpy as np

from imgloc.geometry import in_grid_frame
from imgloc.io.images import encode_picture
from imgloc.lab.atlas import Spot
from imgloc.lab.changes import Changes
from imgloc.model import OccupancyGrid
from imgloc.output.canvas import (
    INK,
    PAPER,
    SHADE,
    Colour,
    Image,
    legend,
    map_canvas,
    scale_bar,
    sheet,
)

# Okabe and Ito's colours: told apart by colour-blind readers, and in grey by their lightness.
ATLAS_COLOURS: Mapping[str, Colour] = {
    "unique": (178, 114, 0),
    "ambiguous": (0, 159, 230),
    "no-match": (190, 190, 190),
    "wrong": (0, 0, 0),
}
_UNSEEN: Colour = (190, 186, 182)
_MEANINGS = ("one scan is enough", "several places fit", "not recognized", "wrong, but sure")


def draw_atlas(grid: OccupancyGrid, spots: Sequence[Spot], *, step: float, headings: int) -> Image:
    """Draw where a single scan is enough.

    Places are `step` metres apart. Each of the `headings` at a place has a wedge that points along
    it. A thin line leads from an ambiguous spot to its twin.
    """
    canvas = map_canvas(grid)
    local = [in_grid_frame(spot.pose, grid) for spot in spots]
    kinds = [spot.kind for spot in spots]
    twins = [s.twin if s.kind == "ambiguous" else None for s in spots]
    pairs = [(a, in_grid_frame(b, grid)) for a, b in zip(local, twins, strict=True) if b]
    if lines := [((a.x, a.y), (b.x, b.y)) for a, b in pairs]:
        layer = canvas.image.copy()
        canvas.lines(np.array(lines), ATLAS_COLOURS["ambiguous"])
        cv2.addWeighted(canvas.image, 0.25, layer, 0.75, 0, dst=canvas.image)
    half = min(np.pi / headings, np.pi / 2) * 0.94
    arc = np.linspace(-half, half, 9)
    for pose, kind in zip(local, kinds, strict=True):
        rim = 0.46 * step * np.column_stack((np.cos(arc + pose.theta), np.sin(arc + pose.theta)))
        canvas.polygon(np.vstack(((0.0, 0.0), rim)) + (pose.x, pose.y), ATLAS_COLOURS[kind])
    scale_bar(canvas)
    shares = {kind: 100 * kinds.count(kind) / max(1, len(kinds)) for kind in ATLAS_COLOURS}
    entries = [
        (ATLAS_COLOURS[kind], f"{meaning}: {share:.1f} %")
        for (kind, share), meaning in zip(shares.items(), _MEANINGS, strict=True)
        if share > 0 or kind in ("unique", "ambiguous")
    ]
    return legend(canvas.image, entries)


def draw_survey(
    grid: OccupancyGrid, spots: Sequence[Spot], step: float, headings: int
) -> dict[str, bytes]:
    """Where on a map one scan is enough."""
    return {"atlas": encode_picture(draw_atlas(grid, spots, step=step, headings=headings))}


GONE, NEW = (0, 94, 213), (178, 114, 0)


def draw_changes(changes: Changes) -> Image:
    """Draw a map with its walls that are gone and with the surfaces that are new."""
    grid, seen = changes.grid, changes.seen
    looked = (seen.near > 0) | (seen.passed > 0)
    colours = np.empty((*grid.occupied.shape, 3), np.uint8)
    colours[:] = SHADE
    colours[grid.free] = PAPER
    colours[grid.occupied] = _UNSEEN
    colours[grid.occupied & looked] = INK
    colours[changes.gone], colours[changes.new] = GONE, NEW
    canvas = sheet(colours, grid.info, None)
    scale_bar(canvas)
    share = changes.gone_share
    entries = [
        (GONE, "gone" if np.isnan(share) else f"gone: {100 * share:.1f} % of the walls seen"),
        (NEW, f"new: {changes.new_m2:.1f} m2"),
        (INK, "wall"),
        (_UNSEEN, "wall that no scan has seen"),
    ]
    return legend(canvas.image, entries)


def draw_aged(changes: Changes) -> dict[str, bytes]:
    """Where a map has aged."""
    return {"changes": encode_picture(draw_changes(changes))}
