"""Pictures of what is computed from a map: surfaces, vector fields, visibility."""

import cv2
import numpy as np
import numpy.typing as npt

from imgloc.draw.canvas import INK, PALETTE, Picture, sheet, wheel
from imgloc.draw.maps import map_canvas, marker_size, scale_bar
from imgloc.model import Float32Array, FloatArray, GridInfo, IntArray, OccupancyGrid, OrientedPoints


def draw_surface(
    grid: OccupancyGrid, surface: OrientedPoints, *, scale: int | None = None
) -> Picture:
    """Draw surface points with their directed normals, coloured by direction.

    Parameters
    ----------
    grid : OccupancyGrid
        Background.
    surface : OrientedPoints
        In the grid frame; points without a normal are drawn as black dots.
    scale : int, optional
        Pixels per cell.

    Returns
    -------
    (H * scale, W * scale, 3) uint8 array
    """
    canvas = map_canvas(grid, scale)
    points = surface.select(surface.valid)
    length = max(2.5 * grid.resolution, 8 / canvas.px_per_m)
    heads = points.xy + length * np.column_stack((np.cos(points.alpha), np.sin(points.alpha)))
    colours = wheel(points.alpha, np.ones(len(points)))
    for tail, head, colour in zip(points.xy, heads, colours.tolist(), strict=True):
        canvas.lines(np.stack((tail, head))[None], tuple(colour))
    canvas.dots(surface.xy[~surface.valid], INK, 1.5)
    scale_bar(canvas)
    return canvas.image


def draw_field(
    vmap: Float32Array, resolution: float, *, scale: int | None = None, step: int | None = None
) -> Picture:
    """Draw a blurred vector field (Fig. 4c): colour is direction, saturation is intensity.

    Parameters
    ----------
    vmap : (2, H, W) float32 array
        x and y components; of the greatest magnitude 1.
    resolution : float
        Side of a cell, metres.
    scale : int, optional
        Pixels per cell.
    step : int, optional
        Cells between arrows; by default arrows are about 14 pixels apart.

    Returns
    -------
    (H * scale, W * scale, 3) uint8 array
    """
    x, y = (np.asarray(v, dtype=np.float64) for v in vmap)
    strength = np.hypot(x, y)
    strength = strength / max(float(strength.max()), 1e-12)
    info = GridInfo(x.shape[0], x.shape[1], resolution)
    canvas = sheet(wheel(np.arctan2(y, x), 0.55 * strength), info, scale)
    apart = step or max(1, round(14 / (canvas.px_per_m * resolution)))
    rows, columns = _strongest(strength, apart)
    centre = (np.column_stack((columns // apart, rows // apart)) + 0.5) * apart * resolution
    length = 0.9 * apart * resolution
    arrow = np.column_stack((x[rows, columns], y[rows, columns]))
    arrow *= (length / np.maximum(np.hypot(*arrow.T), 1e-12) * strength[rows, columns])[:, None]
    tails, heads = canvas.pixels(centre - arrow / 2), canvas.pixels(centre + arrow / 2)
    for a, b in zip(
        np.rint(tails).astype(int).tolist(), np.rint(heads).astype(int).tolist(), strict=True
    ):
        cv2.arrowedLine(canvas.image, a, b, INK, 1, cv2.LINE_AA, tipLength=0.35)
    return canvas.image


def draw_visibility(
    grid: OccupancyGrid,
    xy: npt.ArrayLike,
    vis: npt.ArrayLike,
    *,
    horizon: float,
    alpha: float = 0.0,
    scale: int | None = None,
) -> Picture:
    """Draw what one point of a surface sees: the array ``vis_j`` of Sec. V as a fan.

    Parameters
    ----------
    grid : OccupancyGrid
        Background.
    xy : (2,) array
        The point, metres in the grid frame.
    vis : (n_psi,) array
        Distances to the nearest obstacle, metres; where inf, the fan ends at `horizon`.
    horizon : float
        Metres.
    alpha : float
        Direction of bin 0, radians: the normal, if `vis` is relative to it.
    scale : int, optional
        Pixels per cell.

    Returns
    -------
    (H * scale, W * scale, 3) uint8 array
    """
    canvas = map_canvas(grid, scale)
    reach = np.minimum(np.asarray(vis, dtype=np.float64), horizon)
    n = len(reach)
    # Each bin is a sector: it reaches half a bin to either side of its psi.
    edges = alpha + (np.arange(n)[:, None] + np.linspace(-0.5, 0.5, 5)) * (2 * np.pi / n)
    fan = np.stack((np.cos(edges), np.sin(edges)), axis=-1) * reach[:, None, None]
    outline = fan.reshape(-1, 2) + np.asarray(xy, dtype=np.float64)
    canvas.polygon(outline, PALETTE[4], 0.3)
    canvas.lines(np.concatenate((outline, outline[:1]))[None], PALETTE[0])
    canvas.dots(np.asarray(xy, dtype=np.float64)[None], INK, 0.7 * marker_size(canvas))
    scale_bar(canvas)
    return canvas.image


def _strongest(strength: FloatArray, apart: int) -> tuple[IntArray, IntArray]:
    """Row and column of the strongest cell of each block of `apart` cells a side."""
    height, width = (-(-n // apart) for n in strength.shape)
    short = np.array((height, width)) * apart - strength.shape
    padded = np.pad(strength, ((0, short[0]), (0, short[1])))
    blocks = padded.reshape(height, apart, width, apart).swapaxes(1, 2).reshape(height, width, -1)
    row, column = np.nonzero(blocks.max(axis=2) > 0.2)
    within = blocks.argmax(axis=2)[row, column]
    return row * apart + within // apart, column * apart + within % apart
