"""The localizability atlas as a picture: a wedge for each heading of each place."""

from collections.abc import Mapping, Sequence

import cv2
import numpy as np

from imgloc.draw.canvas import INK, PAPER, Colour, Picture, text, text_width
from imgloc.draw.maps import map_canvas, scale_bar
from imgloc.geometry import compose, inverse
from imgloc.model import OccupancyGrid, Pose2D

# Okabe and Ito's colours: told apart by colour-blind readers, and in grey by their lightness.
COLOURS: Mapping[str, Colour] = {
    "unique": (178, 114, 0),
    "ambiguous": (0, 159, 230),
    "no-match": (190, 190, 190),
    "wrong": (0, 0, 0),
}
LEGEND = {
    "unique": "one scan is enough",
    "ambiguous": "several places fit",
    "no-match": "not recognized",
    "wrong": "wrong, but sure",
}
_TWIN_MASS = 0.1


def draw_atlas(
    grid: OccupancyGrid,
    poses: Sequence[Pose2D],
    kinds: Sequence[str],
    twins: Sequence[Pose2D | None],
    *,
    step: float,
    headings: int,
) -> Picture:
    """Draw where a single scan is enough.

    Parameters
    ----------
    grid : OccupancyGrid
    poses : sequence of Pose2D
        Map frame.
    kinds : sequence of str
        One of :data:`COLOURS` for each pose.
    twins : sequence of Pose2D or None
        Where else an ambiguous scan fits; a thin line leads there.
    step : float
        Metres between places.
    headings : int
        Of each place: each gets a wedge that points along it.

    Returns
    -------
    (H, W, 3) uint8 array
    """
    canvas = map_canvas(grid)
    to_grid = inverse(grid.origin)
    local = [compose(to_grid, p) for p in poses]
    lines = [
        ((a.x, a.y), (b.x, b.y))
        for a, kind, twin in zip(local, kinds, twins, strict=True)
        if kind == "ambiguous" and twin is not None
        for b in (compose(to_grid, twin),)
    ]
    if lines:
        layer = canvas.image.copy()
        canvas.lines(np.array(lines), COLOURS["ambiguous"])
        cv2.addWeighted(canvas.image, 0.25, layer, 0.75, 0, dst=canvas.image)
    half = min(np.pi / headings, np.pi / 2) * 0.94
    arc = np.linspace(-half, half, 9)
    for pose, kind in zip(local, kinds, strict=True):
        rim = 0.46 * step * np.column_stack((np.cos(arc + pose.theta), np.sin(arc + pose.theta)))
        canvas.polygon(np.vstack(((0.0, 0.0), rim)) + (pose.x, pose.y), COLOURS[kind])
    scale_bar(canvas)
    return np.vstack((canvas.image, _legend(canvas.image.shape[1], kinds)))


def _legend(width: int, kinds: Sequence[str]) -> Picture:
    """A strip below the map: colours, what they mean, and how many poses have them."""
    entries = [
        (kind, f"{label}: {100 * kinds.count(kind) / max(1, len(kinds)):.1f} %")
        for kind, label in LEGEND.items()
        if kind in kinds or kind in ("unique", "ambiguous")
    ]
    line, gap, box = 26, 24, 14
    rows: list[list[tuple[str, str]]] = [[]]
    used = gap
    for entry in entries:
        need = box + 8 + text_width(entry[1], 14) + gap
        if used + need > width and rows[-1]:
            rows.append([])
            used = gap
        rows[-1].append(entry)
        used += need
    strip = np.full((line * len(rows) + 14, width, 3), PAPER, np.uint8)
    for i, row in enumerate(rows):
        x, y = gap, 10 + line * i
        for kind, words in row:
            cv2.rectangle(strip, (x, y), (x + box, y + box), COLOURS[kind], cv2.FILLED)
            cv2.rectangle(strip, (x, y), (x + box, y + box), INK, 1)
            x += box + 8
            x += text(strip, words, x, y + box - 2, size=14) + gap
    return strip
