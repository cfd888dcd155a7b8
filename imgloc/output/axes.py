"""Axes of a picture of a map: a light grid, ticks in metres of the map frame, and a title."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from imgloc.geometry import transform_points
from imgloc.model import FloatArray, OccupancyGrid, Pose2D, inverse
from imgloc.output.canvas import (
    INK,
    SHADE,
    Canvas,
    Colour,
    Image,
    building,
    enlarged,
    legend,
    round_length,
    text,
    text_width,
)

_LINE: Colour = (214, 208, 202)
_TICKS = 8  # along the longer side, at most
_TITLE = 480  # pixels that a title has on a narrow picture
_TURNED = 1e-3  # radians, from which ticks name their axis


@dataclass(frozen=True)
class Tick:
    """Where a line of the grid meets the lower or the left edge of a picture."""

    label: str
    at: float  #: pixels from the left edge, or from the top
    below: bool  #: whether it is at the lower edge


def draw_grid(canvas: Canvas, origin: Pose2D) -> list[Tick]:
    """Draw lines of equal x and of equal y of the map frame over free and unknown space.

    `origin` is the pose of the lower left corner of the canvas in the map frame. Returns the ticks
    of the lines.

    Examples
    --------
    >>> canvas = Canvas(np.full((100, 200, 3), 255, np.uint8), 10.0)
    >>> [(tick.label, tick.at) for tick in draw_grid(canvas, Pose2D(-1.0, 3.0)) if tick.below][:3]
    [('0', 9.5), ('2', 29.5), ('4', 49.5)]
    """
    height, width = canvas.image.shape[:2]
    size = np.array((width, height)) / canvas.px_per_m
    corners = transform_points(origin, np.array([(0, 0), (1, 0), (0, 1), (1, 1)]) * size)
    low, high = corners.min(axis=0), corners.max(axis=0)
    step, back = round_length(float(size.max()) / _TICKS * 1.6), inverse(origin)
    layer, ticks = canvas.image.copy(), list[Tick]()
    sheet = Canvas(layer, canvas.px_per_m)
    for axis, name in enumerate("xy"):
        first, last = int(np.ceil(low[axis] / step)), int(np.floor(high[axis] / step))
        for k in range(first, last + 1):
            ends = np.array([low, high])
            ends[:, axis] = k * step
            local = transform_points(back, ends)
            sheet.lines(local[None], _LINE, max(1, round(enlarged(layer))))
            label = f"{name} {k * step:g}" if abs(origin.theta) > _TURNED else f"{k * step:g}"
            ticks += _ticks(label, local, canvas)
    bare = canvas.image.min(axis=2) >= min(SHADE)
    canvas.image[bare] = layer[bare]
    return ticks


def _ticks(label: str, ends: FloatArray, canvas: Canvas) -> list[Tick]:
    """The tick of a line between two points (2, 2), metres on the canvas, if it has one."""
    height, width = canvas.image.shape[:2]
    for across, below in ((1, True), (0, False)):
        start, way = ends[0, across], ends[1, across] - ends[0, across]
        if abs(way) < 1e-9 or not 0 <= -start / way <= 1:
            continue
        at = canvas.pixels((ends[0] - start / way * (ends[1] - ends[0]))[None])[0]
        pixel, most = (float(at[0]), width) if below else (float(at[1]), height)
        if 0 <= pixel <= most:
            return [Tick(label, pixel, below)]
    return []


def framed(image: Image, ticks: Sequence[Tick], title: str = "") -> Image:
    """Put ticks with their labels below and to the left of a picture, and a title above it.

    A picture that is too narrow for its title is widened with paper, but not by much.
    """
    f = enlarged(image)
    height, width = image.shape[:2]
    size, gap = round(12 * f), round(6 * f)
    left = max([text_width(t.label, size) for t in ticks if not t.below], default=0) + 3 * gap
    big = round(14 * f)
    right = left + width + gap
    broad = max(right, min(text_width(title, big) + 2 * gap, round(_TITLE * f)))
    lines = wrapped(title, broad - 2 * gap, big) if title else []
    top, low = round(24 * f) * len(lines) + gap, round(26 * f)
    out = np.full((top + height + low, broad, 3), 255, np.uint8)
    out[top : top + height, left : left + width] = image
    cv2.rectangle(out, (left - 1, top - 1), (left + width, top + height), SHADE, 1)
    for k, line in enumerate(lines):
        text(out, line, gap, round(18 * f) + k * round(24 * f), size=big)
    free = left - 3 * gap
    unit = "m" if all(t.label[:1] not in "xy" for t in ticks) else ""
    last = right - gap - text_width("x / m", size)
    for tick in sorted(ticks, key=lambda tick: tick.at):
        wide = text_width(tick.label, size)
        if tick.below:
            x = left + round(tick.at)
            cv2.line(out, (x, top + height), (x, top + height + gap), INK, max(1, round(f)))
            begin = x - wide // 2
            if begin >= free and begin + wide + gap < (last if unit else right):
                text(out, tick.label, begin, top + height + round(21 * f), size=size)
                free = begin + wide + gap
        else:
            y = top + round(tick.at)
            cv2.line(out, (left - gap, y), (left, y), INK, max(1, round(f)))
            if y - top > round(22 * f) or not unit:
                text(out, tick.label, left - wide - 2 * gap, y + round(4 * f), size=size)
    if unit:
        text(out, "x / m", last, top + height + round(21 * f), size=size)
        text(out, "y / m", gap // 2, top + round(12 * f), size=size)
    return out


def finished(
    canvas: Canvas, grid: OccupancyGrid, title: str, entries: Sequence[tuple[Colour, str]] = ()
) -> Image:
    """Crop a picture of a whole map to the building; add axes, a title and a legend."""
    box = canvas.pixels(building(grid)[0])
    (left, bottom), (right, top) = np.rint(box + 0.5).astype(int).tolist()
    corner = np.array([[left, len(canvas.image) - bottom]]) / canvas.px_per_m
    x, y = transform_points(grid.origin, corner)[0].tolist()
    part = Canvas(canvas.image[top:bottom, left:right].copy(), canvas.px_per_m)
    ticks = draw_grid(part, Pose2D(x, y, grid.origin.theta))
    image = framed(part.image, ticks, title)
    return legend(image, entries) if entries else image


def wrapped(words: str, width: int, size: int) -> list[str]:
    """A text as lines of at most `width` pixels: a word that is longer is broken.

    Examples
    --------
    >>> wrapped("a door", 40, 14), len(wrapped("door" * 9, 40, 14)) > 7
    (['a', 'door'], True)
    """
    lines = [""]
    for word in itertools.chain.from_iterable(_parts(w, width, size) for w in words.split()):
        longer = f"{lines[-1]} {word}".lstrip()
        if lines[-1] and text_width(longer, size) > width:
            lines.append(word)
        else:
            lines[-1] = longer
    return lines


def _parts(word: str, width: int, size: int) -> list[str]:
    """The word, or pieces of it that are at most `width` pixels wide, of one letter at least."""
    parts = [""]
    for letter in word:
        if parts[-1] and text_width(parts[-1] + letter, size) > width:
            parts.append("")
        parts[-1] += letter
    return parts
