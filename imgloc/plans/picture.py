"""The picture of `imgloc map plan`: what a plan was taken for, beside the map that it became."""

import cv2
import numpy as np
import numpy.typing as npt

from imgloc.output.canvas import INK, PAPER, Colour, Image, legend, map_canvas
from imgloc.output.pictures import Picture
from imgloc.plans.building import KINDS, FloorPlan

_SIDE = 1400  # pixels of a panel at most
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
    shrink = min(1.0, _SIDE / max(height, width))
    size = max(1, round(width * shrink)), max(1, round(height * shrink))
    colours = np.array(_COLOURS, np.uint8)[plan.kinds]
    # What the plan has besides ink, a tinted room, shows through.
    paper = cv2.resize(grey, (width, height), interpolation=cv2.INTER_AREA)[..., None]
    left = np.where(plan.kinds[..., None] == 0, np.maximum(paper, 150), colours)
    left = _shrunk(left[::-1].astype(np.uint8), size)
    info = plan.grid.info
    scale = max(1, round(info.resolution / plan.pixel))
    canvas = map_canvas(plan.grid, scale, faded=False)
    far = round(info.width * scale * shrink), round(info.height * scale * shrink)
    right = _shrunk(canvas.image, (max(1, far[0]), max(1, far[1])))
    beside = height > width
    both = _joined([left, right], axis=1 if beside else 0)
    low, median, high = plan.thickness
    walls = f"walls: {low:.2f} to {high:.2f} m thick, median {median:.2f} m"
    entries = [(_COLOURS[1], walls)]
    for kind, colour in zip(KINDS, _COLOURS, strict=True):
        for r in (r for r in plan.removed if r.kind == kind):
            entries.append((colour, f"{kind}: {r.count}, {r.area:.2f} m2 of ink"))
    return Picture(legend(both, entries))


def _shrunk(image: Image, size: tuple[int, int]) -> Image:
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def _joined(images: list[Image], axis: int) -> Image:
    """Images beside or below each other, with paper around what is smaller."""
    other, gap = 1 - axis, 16
    most = max(image.shape[other] for image in images)
    parts = []
    for image in images:
        pad = [(0, 0)] * 3
        pad[other] = (0, most - image.shape[other])
        pad[axis] = (0, gap)
        parts.append(np.pad(image, pad, constant_values=255))
    return np.concatenate(parts, axis=axis)
