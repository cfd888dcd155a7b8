"""The map itself, and the scale that it is drawn at."""

import cv2
import numpy as np

from imgloc.draw.canvas import INK, PAPER, SHADE, Canvas, Picture, sheet, text, text_width
from imgloc.model import OccupancyGrid


def draw_map(
    grid: OccupancyGrid, *, scale: int | None = None, faded: bool = False, bar: bool = True
) -> Picture:
    """Draw a map: walls dark, free space white, unknown space grey, and a scale bar.

    Parameters
    ----------
    grid : OccupancyGrid
    scale : int, optional
        Pixels per cell; by default small maps are enlarged to 1000 pixels or more.
    faded : bool
        Paint walls in a middle grey, as a background.
    bar : bool
        Draw a scale bar.

    Returns
    -------
    (H * scale, W * scale, 3) uint8 array

    Examples
    --------
    >>> wall = np.eye(3, dtype=bool)
    >>> draw_map(OccupancyGrid(wall, ~wall, 0.1), scale=1, bar=False)[..., 0].tolist()
    [[255, 255, 56], [255, 56, 255], [56, 255, 255]]
    """
    colours = np.array([SHADE, PAPER, (146, 140, 134) if faded else INK], dtype=np.uint8)
    classes = np.where(grid.occupied, 2, grid.free.astype(np.int64))
    canvas = sheet(colours[classes], grid.info, scale)
    if bar:
        scale_bar(canvas)
    return canvas.image


def map_canvas(grid: OccupancyGrid, scale: int | None = None) -> Canvas:
    """Return a canvas with the faded map, to draw on."""
    image = draw_map(grid, scale=scale, faded=True, bar=False)
    return Canvas(image, image.shape[1] / (grid.occupied.shape[1] * grid.resolution))


def marker_size(canvas: Canvas) -> float:
    """Radius of a robot in pixels: 0.25 m, but never too small to see nor very large."""
    side = max(canvas.image.shape[:2])
    return float(np.clip(0.25 * canvas.px_per_m, max(5.0, side / 160), max(9.0, side / 80)))


def scale_bar(canvas: Canvas) -> None:
    """Draw a bar of a round length, at most a fifth of the width.

    It stands as close to the lower left corner as it can without covering anything darker
    than unknown space.
    """
    height, width = canvas.image.shape[:2]
    if width < 120 or height < 60:
        return
    longest = 0.2 * width / canvas.px_per_m
    decade = 10.0 ** np.floor(np.log10(longest))
    length = decade * max(k for k in (1, 2, 5) if k * decade <= longest * (1 + 1e-9))
    label = f"{length:g} m"
    px = round(length * canvas.px_per_m)
    wide, high = max(px, text_width(label)) + 14, 32
    ink = cv2.integral((canvas.image.min(axis=2) < SHADE[2]).astype(np.uint8))
    y0, x0 = np.mgrid[5 : height - high - 4 : 3, 5 : width - wide - 4 : 3]
    y1, x1 = y0 + high, x0 + wide
    covered = ink[y1, x1] - ink[y0, x1] - ink[y1, x0] + ink[y0, x0]
    away = np.hypot(x0, height - high - y0)
    best = int(np.argmin(covered + away / (1 + away.max())))
    top, left = int(y0.flat[best]), int(x0.flat[best])
    box = canvas.image[top : top + high, left : left + wide]
    box[:] = np.rint(0.15 * box + 0.85 * 255)
    x, y = left + (wide - px) // 2, top + high - 7
    canvas.image[y - 1 : y + 1, x : x + px + 1] = INK
    canvas.image[y - 5 : y + 1, [x, x + px]] = INK
    text(canvas.image, label, left + (wide - text_width(label)) // 2, y - 8)
