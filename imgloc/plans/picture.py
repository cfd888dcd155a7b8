"""The picture of `imgloc map plan`: what a plan was taken for, beside the map that it became."""

import cv2
import numpy as np
import numpy.typing as npt

from imgloc.model import Pose2D
from imgloc.output.canvas import INK, PAPER, SHADE, Canvas, Colour, Part, map_canvas
from imgloc.output.pictures import Picture, mosaic
from imgloc.output.plots import AREA, framed
from imgloc.plans.floorplan import KINDS, FloorPlan

_SIDE = 1000  # pixels of a panel at most, unless a cell of the map has one
# Of KINDS: paper, walls, then Okabe and Ito's colours.
_COLOURS: tuple[Colour, ...] = (
    PAPER, INK, (0, 94, 213), (115, 158, 0), (178, 114, 0), (167, 121, 204), (0, 159, 230),
    (170, 170, 170), (233, 180, 86),
)  # fmt: skip


def draw_floor_plan(grey: npt.NDArray[np.uint8], plan: FloorPlan) -> Picture:
    """Draw a plan, what was taken from it in colour, beside its map; `grey` as for `plan_to_map`.

    Where the plan is wider than high the two are below each other.
    """
    height, width = plan.kinds.shape
    scale = max(1, _SIDE // max(plan.grid.occupied.shape))
    right = map_canvas(plan.grid, Part(scale=scale), INK)
    # What the plan has besides ink, a tinted room, shows through.
    paper = cv2.resize(grey, (width, height), interpolation=cv2.INTER_AREA)[..., None]
    left = np.array(_COLOURS, np.uint8)[plan.kinds]
    left = np.where(plan.kinds[..., None] == 0, np.maximum(paper, 150), left)[::-1]
    size = [max(1, round(n * plan.pixel * right.px_per_m)) for n in (width, height)]
    image = cv2.resize(left.astype(np.uint8), size, interpolation=cv2.INTER_AREA)
    low, median, high = plan.thickness
    walls = f"walls: {low:.2f} to {high:.2f} m thick, median {median:.2f} m"
    entries = [(INK, AREA, walls)]
    for kind, colour in zip(KINDS, _COLOURS, strict=True):
        for r in (r for r in plan.removed if r.kind == kind):
            entries.append((colour, AREA, f"{kind}: {r.count}, {r.area:.2f} m2 of ink"))
    classes = [(INK, AREA, "wall"), (PAPER, AREA, "free"), (SHADE, AREA, "unknown")]
    canvas = Canvas(np.asarray(image, np.uint8), right.px_per_m)
    panels = [
        framed(canvas, Pose2D(0, 0), "The plan, and what was removed from it", entries).image,
        framed(right, plan.grid.origin, "The map that it became", classes).image,
    ]
    return Picture(mosaic(panels, columns=2 if height > width else 1))
