"""The paper's figures: panels with letters, side by side."""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from imgloc.geometry import transform_points
from imgloc.model import (
    Float32Array,
    FloatArray,
    GridInfo,
    Likelihood,
    OccupancyGrid,
    OrientedPoints,
    Pose2D,
)
from imgloc.output.canvas import PAPER, Canvas, Image, draw_map, marker_size
from imgloc.output.features import draw_bmap, draw_field, draw_surface
from imgloc.output.pictures import draw_likelihood, mosaic

_TRUTH = (60, 20, 220)
_MAXIMUM = (178, 114, 0)
_FRAME = (205, 199, 193)
_APART = 0.3  # metres from the true pose at which a maximum is marked


def draw_scan(
    grid: OccupancyGrid, truth: Pose2D, points: OrientedPoints, *, scale: int | None = None
) -> Image:
    """Draw a scan with its normals where it was taken, on a sheet with a trace of the map.

    Parameters
    ----------
    grid : OccupancyGrid
    truth : Pose2D
        Grid frame.
    points : OrientedPoints
        Sensor frame.
    scale : int, optional
        Pixels per cell.

    Returns
    -------
    (H * scale, W * scale, 3) uint8 array
    """
    there = OrientedPoints(
        transform_points(truth, points.xy), points.alpha + truth.theta, points.sigma_alpha,
        points.valid,
    )  # fmt: skip
    # Walls are drawn as what is unknown, pale: the scan is what is to be seen.
    sheet = OccupancyGrid(np.zeros_like(grid.occupied), ~grid.occupied, grid.resolution)
    return ring(draw_surface(sheet, there, scale=scale), grid.info, truth)


def ring(image: Image, info: GridInfo, pose: Pose2D) -> Image:
    """Mark a pose by a ring, which leaves visible what is in it, and a line along theta.

    Parameters
    ----------
    image : (H * scale, W * scale, 3) uint8 array
        Drawn on in place, and returned.
    info : GridInfo
        Of the lattice that the image shows.
    pose : Pose2D
        Grid frame.
    """
    canvas = Canvas(image, image.shape[1] / (info.width * info.resolution))
    radius = 1.6 * marker_size(canvas) / canvas.px_per_m
    turn = np.linspace(0, 2 * np.pi, 49)
    circle = np.array((pose.x, pose.y)) + radius * np.column_stack((np.cos(turn), np.sin(turn)))
    ahead = np.array((np.cos(pose.theta), np.sin(pose.theta))) * radius
    nose = np.array((pose.x, pose.y)) + np.stack((ahead, 2.2 * ahead))
    for colour, thickness in ((PAPER, 5), (_TRUTH, 2)):
        canvas.lines(circle[None], colour, thickness)
        canvas.lines(nose[None], colour, thickness)
    return image


def cross(image: Image, info: GridInfo, xy: FloatArray) -> Image:
    """Mark a position (2,), metres in the grid frame, by an oblique cross; returns `image`."""
    canvas = Canvas(image, image.shape[1] / (info.width * info.resolution))
    arm = 0.8 * marker_size(canvas) / canvas.px_per_m * np.array((1.0, 1.0))
    strokes = np.stack([xy + np.outer((-1, 1), arm * turn) for turn in ((1, 1), (1, -1))])
    for colour, thickness in ((PAPER, 5), (_MAXIMUM, 2)):
        canvas.lines(strokes, colour, thickness)
    return image


def draw_comparison(
    grid: OccupancyGrid,
    truth: Pose2D,
    points: OrientedPoints,
    stacks: Sequence[tuple[str, Likelihood]],
    *,
    scale: int,
    columns: int = 3,
) -> Image:
    """Draw the map and each method's likelihood, as Figs. 1, 2 and 5 have it.

    Parameters
    ----------
    grid : OccupancyGrid
    truth : Pose2D
        Grid frame; a red ring in every panel. A blue cross is a maximum that is elsewhere.
    points : OrientedPoints
        Of the scan, sensor frame.
    stacks : sequence of (str, Likelihood)
        Captions and stacks. The scan stands between the second and the third.
    scale : int
        Pixels per cell.
    columns : int
        Panels in a row.

    Returns
    -------
    (H, W, 3) uint8 array
    """
    panels = [("Map, true pose", ring(draw_map(grid, scale=scale), grid.info, truth))]
    for caption, stack in stacks:
        panels.append((caption, _likelihood(stack, grid, truth, scale)))
    panels.insert(3, ("Scan with its normals", draw_scan(grid, truth, points, scale=scale)))
    return mosaic(lettered(panels), columns=columns)


def draw_fields(
    grid: OccupancyGrid,
    surface: OrientedPoints,
    bmap: Float32Array,
    vmap: Float32Array,
    truth: Pose2D,
    points: OrientedPoints,
    stacks: Sequence[tuple[str, Likelihood]],
    *,
    window: tuple[float, float, float, float],
    scale: int = 9,
) -> Image:
    """Draw what CBML and CBML-O make of a map, Fig. 4, and what comes of it near a pose.

    Parameters
    ----------
    grid : OccupancyGrid
    surface : OrientedPoints
        Grid frame.
    bmap : (H, W) float32 array
    vmap : (2, H, W) float32 array
    truth : Pose2D
        Grid frame.
    points : OrientedPoints
        Of the scan, sensor frame.
    stacks : sequence of (str, Likelihood)
        Captions and stacks.
    window : (float, float, float, float)
        The part that is shown: least x and y, greatest x and y, metres.
    scale : int
        Pixels per cell.

    Returns
    -------
    (H, W, 3) uint8 array
    """
    cell = grid.resolution
    x0, y0, x1, y1 = (round(v / cell) for v in window)
    part = np.s_[y0:y1, x0:x1]
    info = replace(grid.info, height=y1 - y0, width=x1 - x0)
    shift = np.array((x0, y0)) * cell
    local = surface.xy - shift
    seen = np.all((local >= 0) & (local <= np.array((x1 - x0, y1 - y0)) * cell), axis=1)
    near = surface.select(seen)
    near = OrientedPoints(near.xy - shift, near.alpha, near.sigma_alpha, near.valid)
    here = Pose2D(truth.x - float(shift[0]), truth.y - float(shift[1]), truth.theta)
    cut = OccupancyGrid(grid.occupied[part], grid.free[part], cell)
    panels = [
        ("Map: surface points, true pose", ring(draw_surface(cut, near, scale=scale), info, here)),
        ("bmap", draw_bmap(bmap[part], info, scale=scale)),
        ("Vector field", draw_field(vmap[:, *part], cell, scale=scale)),
    ]
    for caption, stack in stacks:
        shown = Likelihood(stack.values[:, *part], stack.thetas, info, stack.method)
        panels.append((caption, _likelihood(shown, cut, here, scale)))
    panels.insert(3, ("Scan with its normals", draw_scan(cut, here, points, scale=scale)))
    return mosaic(lettered(panels), columns=3)


def _likelihood(stack: Likelihood, grid: OccupancyGrid, truth: Pose2D, scale: int) -> Image:
    """One method's panel: its likelihood, the true pose, the maximum if it is elsewhere."""
    best = np.where(grid.free, stack.values.max(axis=0), -np.inf)
    row, column = np.unravel_index(int(best.argmax()), best.shape)
    at = np.array((column + 0.5, row + 0.5)) * stack.grid.resolution
    panel = ring(draw_likelihood(stack, grid=grid, scale=scale), stack.grid, truth)
    elsewhere = np.hypot(*(at - (truth.x, truth.y))) > _APART
    return cross(panel, stack.grid, at) if elsewhere else panel


def lettered(panels: Sequence[tuple[str, Image]]) -> list[tuple[str, Image]]:
    """Put (a), (b), ... before the captions, and a thin frame on each panel.

    Examples
    --------
    >>> one = np.zeros((1, 1, 3), np.uint8)
    >>> [caption for caption, _ in lettered([("map", one), ("CBML", one)])]
    ['(a) map', '(b) CBML']
    """
    return [
        (f"({chr(ord('a') + k)}) {caption}", framed(p)) for k, (caption, p) in enumerate(panels)
    ]


def framed(picture: Image) -> Image:
    """Replace the outermost pixels by a thin line."""
    out = picture.copy()
    cv2.rectangle(out, (0, 0), (out.shape[1] - 1, out.shape[0] - 1), _FRAME, 1)
    return out
