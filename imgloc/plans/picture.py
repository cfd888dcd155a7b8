"""The picture of `imgloc map plan`: what a plan was taken for, beside the map that it became."""

import cv2
import numpy as np
import numpy.typing as npt

from imgloc.model import BoolArray, FloatArray, Pose2D, compose
from imgloc.output.canvas import INK, PAPER, SHADE, Colour, Picture, map_canvas
from imgloc.output.pictures import mosaic
from imgloc.output.plots import AREA, framed
from imgloc.plans.building import KINDS, FloorPlan

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
    right = map_canvas(plan.grid, wall=INK)
    # What the plan has besides ink, a tinted room, shows through.
    paper = cv2.resize(grey, (width, height), interpolation=cv2.INTER_AREA)[..., None]
    left = np.array(_COLOURS, np.uint8)[plan.kinds]
    left = np.where(plan.kinds[..., None] == 0, np.maximum(paper, 150), left)[::-1]
    size = [max(1, round(n * plan.pixel * right.px_per_m)) for n in (width, height)]
    image = cv2.resize(left.astype(np.uint8), size, interpolation=cv2.INTER_AREA)
    low, median, high = plan.thickness
    walls = f"walls: {low:.2f} to {high:.2f} m thick, median {median:.2f} m"
    entries = [(INK, AREA, walls)]
    for r in plan.removed:
        colour = _COLOURS[KINDS.index(r.kind)]
        entries.append((colour, AREA, f"{r.kind}: {r.count}, {r.area:.2f} m2 of ink"))
    classes = [(INK, AREA, "wall"), (PAPER, AREA, "free"), (SHADE, AREA, "unknown")]
    canvas = Picture(np.asarray(image, np.uint8), right.px_per_m)
    corner = compose(plan.grid.origin, Pose2D(*_first(plan.grid.occupied) * plan.grid.resolution))
    corner = compose(corner, Pose2D(*-_first(plan.kinds == 1) * plan.pixel))  # to half a cell
    panels = [
        framed(canvas, corner, "The plan, and what was removed from it", entries),
        framed(right, plan.grid.origin, "The map that it became", classes),
    ]
    return mosaic(panels, columns=2 if height > width else 1)


def _first(walls: BoolArray) -> FloatArray:
    """The first column and the first row (2,) that have a wall, or 0."""
    return np.array([float(walls.any(axis=axis).argmax()) for axis in (0, 1)])
