"""Pictures of measurements: where on a map one scan is enough, and where a map has aged."""

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from imgloc.geometry import in_grid_frame
from imgloc.lab.atlas import Spot
from imgloc.lab.changes import Changes
from imgloc.model import OccupancyGrid, Pose2D
from imgloc.output.canvas import INK, PAPER, SHADE, Colour, Picture, building, map_canvas, sheet
from imgloc.output.plots import AREA, Entry, framed

ATLAS_COLOURS: Mapping[str, Colour] = {
    "unique": (210, 150, 60), "ambiguous": (150, 165, 255), "no-match": (190, 190, 190),
    "wrong": (0, 0, 0),
}  # fmt: skip
"""By verdict; several places are the redder the more there are, see :data:`REDS`."""
REDS: Sequence[tuple[int, Colour, str]] = (
    (2, ATLAS_COLOURS["ambiguous"], "2 places fit"),
    (4, (70, 80, 235), "3 or 4 places"),
    (1 << 30, (25, 25, 140), "5 or more places"),
)
"""Up to how many places that fit, the colour and the words. In grey they get darker, too."""
BLUES: Sequence[tuple[float, Colour, str]] = (
    (0.01, (140, 80, 20), "one scan is enough, to 1 cm at best"),
    (0.05, ATLAS_COLOURS["unique"], "one scan is enough, to 5 cm at best"),
    (np.inf, (235, 205, 160), "one scan is enough, less exact"),
)
"""Up to which bound of a pose by one scan, metres, the colour and the words."""
_UNSEEN: Colour = (190, 186, 182)
_MEANINGS = {"no-match": "not recognized", "wrong": "sure, but wrong"}


def _look(spot: Spot) -> tuple[Colour, str]:
    """The colour of a spot, and what it means."""
    of: Mapping[str, tuple[float, Sequence[tuple[float, Colour, str]]]] = {
        "unique": (np.nan_to_num(spot.bound, nan=BLUES[1][0], posinf=np.inf), BLUES),
        "ambiguous": (spot.places, REDS),
    }  # fmt: skip
    if spot.kind not in of:
        return ATLAS_COLOURS[spot.kind], _MEANINGS[spot.kind]
    value, classes = of[spot.kind]
    return next((colour, words) for most, colour, words in classes if value <= most)


def draw_atlas(
    grid: OccupancyGrid, spots: Sequence[Spot], *, step: float, headings: int, title: str = ""
) -> Picture:
    """Draw where a single scan is enough, and where it is not by how many places fit.

    Places are `step` metres apart. Each of the `headings` at a place has a wedge that points along
    it.
    """
    part = building(grid)
    canvas = map_canvas(grid, part)
    half = min(np.pi / headings, np.pi / 2) * 0.94
    arc = np.linspace(-half, half, 9)
    for spot in spots:
        pose = in_grid_frame(spot.pose, grid)
        colour, _ = _look(spot)
        rim = 0.46 * step * np.column_stack((np.cos(arc + pose.theta), np.sin(arc + pose.theta)))
        canvas.polygon(np.vstack(((0.0, 0.0), rim)) + (pose.x, pose.y), colour)
    canvas.image[(map_canvas(grid, part, INK).image == INK).all(axis=2)] = INK
    looks = Counter(_look(spot) for spot in spots)
    known = [(colour, words) for classes in (BLUES, REDS) for _, colour, words in classes]
    known += [(ATLAS_COLOURS[kind], words) for kind, words in _MEANINGS.items()]
    entries: list[Entry] = [
        (look[0], AREA, f"{look[1]}: {100 * looks[look] / max(1, len(spots)):.1f} %")
        for k, look in enumerate(known)
        if looks[look] or k <= len(REDS)
    ]
    entries += [(INK, "", "wedge: the way that the robot looks")] * (headings > 1)
    title = title or f"Is one scan enough? {len(spots):,} scans, {step:g} m apart"
    return framed(canvas, grid.origin, title, entries)


GONE, NEW = (0, 94, 213), (178, 114, 0)


def draw_changes(changes: Changes, title: str = "") -> Picture:
    """Draw a map with its walls that are gone and the surfaces that are new, a ring around each."""
    grid, seen = changes.grid, changes.seen
    looked = (seen.near > 0) | (seen.passed > 0)
    palette = (SHADE, PAPER, _UNSEEN, INK, NEW, GONE)
    layers = (grid.free, grid.occupied, grid.occupied & looked, changes.new, changes.gone)
    classes = np.zeros(grid.occupied.shape, np.uint8)
    for k, cells in enumerate(layers, 1):
        classes[cells] = k
    canvas = sheet(classes, grid.info, building(grid), palette)
    turn = np.linspace(0, 2 * np.pi, 33)
    ring = np.column_stack((np.cos(turn), np.sin(turn)))
    for piece in changes.pieces:
        at = in_grid_frame(Pose2D(piece.x, piece.y), grid)
        colour = GONE if piece.kind == "gone" else NEW
        canvas.lines((ring * (0.5 + 0.7 * piece.length) + (at.x, at.y))[None], colour, 2)
    kinds = [piece.kind for piece in changes.pieces]
    share = changes.gone_share
    gone, new = (f"{k}, {(n := kinds.count(k))} place{'s' * (n != 1)}" for k in ("gone", "new"))
    walls = "" if np.isnan(share) else f": {100 * share:.1f} % of the walls seen"
    entries = [
        (GONE, AREA, gone + walls), (NEW, AREA, f"{new}: {changes.new_m2:.1f} m2"),
        (INK, AREA, "wall that scans have seen"), (_UNSEEN, AREA, "wall that no scan has seen"),
    ]  # fmt: skip
    title = title or f"What has changed, by {changes.seen.scans} scans with a sure pose"
    return framed(canvas, grid.origin, title, entries)
