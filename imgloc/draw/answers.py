"""Pictures of answers: likelihood stacks and ranked hypotheses."""

from collections.abc import Sequence

import numpy as np

from imgloc.draw.canvas import (
    INK,
    PALETTE,
    PAPER,
    SHADE,
    TURQUOISE,
    Canvas,
    Colour,
    Picture,
    sheet,
    text,
    text_width,
)
from imgloc.draw.maps import map_canvas, marker_size, scale_bar
from imgloc.geometry import transform_points, transform_poses
from imgloc.model import BoolArray, FloatArray, Hypothesis, Likelihood, OccupancyGrid, Pose2D

_WALL: Colour = (70, 110, 200)
_TRUTH: Colour = (60, 20, 220)
_ROW = 24  # pixels of a line of the legend


def draw_likelihood(
    likelihood: Likelihood,
    *,
    grid: OccupancyGrid | None = None,
    truth: Pose2D | None = None,
    scale: int | None = None,
    log: bool = False,
) -> Picture:
    """Draw a likelihood as the paper does (caption of Fig. 1): its maximum over theta.

    Linearly normalised, black is the highest likelihood and white the lowest; turquoise is a
    likelihood of exactly 0. Values below 0 (CBML-O has them) count as 0.

    Parameters
    ----------
    likelihood : Likelihood
    grid : OccupancyGrid, optional
        Map whose walls and unknown space are laid over the picture.
    truth : Pose2D, optional
        True pose in the grid frame, marked red.
    scale : int, optional
        Pixels per cell of the likelihood.
    log : bool
        The values are log-likelihoods (the beam model's): ``exp(L - max L)`` is drawn.

    Returns
    -------
    (H * scale, W * scale, 3) uint8 array
    """
    best = likelihood.values.max(axis=0).astype(np.float64)
    if log:
        best = np.exp(best - max(best.max(), -1e300))  # -inf everywhere is 0 everywhere
    best = np.maximum(np.nan_to_num(best, nan=0.0), 0)
    top = best.max()
    grey = np.rint(255 * (1 - best / top if top > 0 else np.ones_like(best)))
    image = np.repeat(grey.astype(np.uint8)[..., None], 3, axis=2)
    image[best == 0] = TURQUOISE
    canvas = sheet(image, likelihood.grid, scale)
    if grid is not None:
        free, occupied = _under(canvas, grid)
        canvas.image[~(free | occupied)] = SHADE
        canvas.image[occupied] = _WALL
    if truth is not None:
        canvas.robot(truth.x, truth.y, truth.theta, _TRUTH, marker_size(canvas))
    return canvas.image


def draw_hypotheses(
    grid: OccupancyGrid,
    scan_xy: FloatArray,
    hypotheses: Sequence[Hypothesis],
    *,
    truth: Pose2D | None = None,
    top: int = 6,
    scale: int | None = None,
) -> Picture:
    """Draw where a scan may have been taken: the scan laid on the map at each hypothesis.

    Parameters
    ----------
    grid : OccupancyGrid
    scan_xy : (N, 2) float array
        Points of the scan in the sensor's frame, metres.
    hypotheses : sequence of Hypothesis
        Best first, in the grid frame. With each comes the ellipse of two standard deviations.
    truth : Pose2D, optional
        True pose in the grid frame, marked with a cross.
    top : int
        Draw no more than so many.
    scale : int, optional
        Pixels per cell.

    Returns
    -------
    (H', W', 3) uint8 array
        The map, and below it a legend with the mass and the pose, in the map frame, of each.
    """
    canvas = map_canvas(grid, scale)
    size = marker_size(canvas)
    shown = [(h, PALETTE[k % len(PALETTE)]) for k, h in enumerate(hypotheses[:top])]
    for hypothesis, colour in reversed(shown):
        canvas.dots(transform_points(hypothesis.pose, scan_xy), colour, max(1.2, 0.28 * size))
    for hypothesis, colour in reversed(shown):
        pose = hypothesis.pose
        ellipse = _ellipse(pose, hypothesis.covariance)
        canvas.polygon(ellipse, colour, 0.25)
        canvas.lines(ellipse[None], colour)
        canvas.robot(pose.x, pose.y, pose.theta, colour, size)
    if truth is not None:
        _cross(canvas, truth.x, truth.y, 1.5 * size)
    scale_bar(canvas)
    return _with_legend(canvas.image, shown, grid.origin, truth)


def _cross(canvas: Canvas, x: float, y: float, arm: float) -> None:
    """Mark a true position with a cross whose arms span `arm` pixels along either axis."""
    a = arm / canvas.px_per_m
    ends = np.array([[(-a, -a), (a, a)], [(-a, a), (a, -a)]]) + np.array((x, y))
    canvas.lines(ends, PAPER, 4)
    canvas.lines(ends, INK, 2)


def _under(canvas: Canvas, grid: OccupancyGrid) -> tuple[BoolArray, BoolArray]:
    """Which pixels of a canvas lie over free and which over occupied cells of a map."""
    height, width = canvas.image.shape[:2]
    cell = canvas.px_per_m * grid.resolution
    row = np.floor((height - 0.5 - np.arange(height)) / cell).astype(np.int64) + 1
    column = np.floor((np.arange(width) + 0.5) / cell).astype(np.int64) + 1
    last = np.array(grid.occupied.shape) + 1
    index = np.ix_(np.minimum(row, last[0]), np.minimum(column, last[1]))
    return np.pad(grid.free, 1)[index], np.pad(grid.occupied, 1)[index]


def _ellipse(pose: Pose2D, covariance: FloatArray) -> FloatArray:
    """Outline (64, 2) of two standard deviations of x and y."""
    values, vectors = np.linalg.eigh(np.asarray(covariance)[:2, :2])
    s = np.linspace(0, 2 * np.pi, 64)
    circle = np.column_stack((np.cos(s), np.sin(s))) * 2 * np.sqrt(np.maximum(values, 0))
    return np.asarray(circle @ vectors.T + (pose.x, pose.y))


def _with_legend(
    image: Picture, shown: Sequence[tuple[Hypothesis, Colour]], origin: Pose2D, truth: Pose2D | None
) -> Picture:
    """Put a line per hypothesis below a picture: mark, bar and share of mass, pose."""
    poses = [h.pose for h, _ in shown] + ([truth] if truth is not None else [])
    if not poses:
        return image
    table = transform_poses(origin, np.array([(p.x, p.y, p.theta) for p in poses]))
    lines = [("x / m", "y / m", "theta / deg")]
    lines += [(f"{x:.2f}", f"{y:.2f}", f"{np.rad2deg(theta):.1f}") for x, y, theta in table]
    ends = 272 + np.cumsum([24 + max(text_width(line[k]) for line in lines) for k in range(3)])
    height, width = image.shape[:2]
    out = np.full((height + _ROW * len(lines) + 14, max(width, ends[-1] + 14), 3), 255, np.uint8)
    out[:height, :width] = image
    base = height + 21
    for k, line in enumerate(lines):
        y = base + k * _ROW
        for end, word in zip(ends.tolist(), line, strict=True):
            text(out, word, end - text_width(word), y)
    text(out, "mass", 266 - text_width("mass"), base)
    for k, (hypothesis, colour) in enumerate(shown, start=1):
        y = base + k * _ROW
        Canvas(out, 1.0).robot(22, len(out) - y + 4.5, 0.0, colour, 5.5)
        text(out, str(k), 44, y)
        out[y - 10 : y + 1, 68:188] = SHADE
        out[y - 10 : y + 1, 68 : 68 + round(120 * min(1.0, max(0.0, hypothesis.mass)))] = colour
        share = f"{100 * hypothesis.mass:.1f} %"
        text(out, share, 266 - text_width(share), y)
    if truth is not None:
        y = base + len(poses) * _ROW
        _cross(Canvas(out, 1.0), 23, len(out) - y + 4.5, 5)
        text(out, "true pose", 44, y)
    return out
