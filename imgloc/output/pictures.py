"""Pictures of answers: likelihood stacks, ranked hypotheses."""

import itertools
from collections.abc import Sequence

import cv2
import numpy as np

from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.scanpoints import scan_xy
from imgloc.geometry import in_grid_frame, transform_points, transform_poses
from imgloc.model import (
    BoolArray,
    FloatArray,
    Hypothesis,
    LaserScan,
    Likelihood,
    Localization,
    OccupancyGrid,
    Pose2D,
)
from imgloc.options import LOG_METHODS
from imgloc.output.canvas import (
    GREY,
    INK,
    PALETTE,
    PAPER,
    SHADE,
    TRUTH,
    TURQUOISE,
    WHOLE,
    Colour,
    Part,
    Picture,
    building,
    deviation_ellipse,
    enlarged,
    faded,
    map_canvas,
    marker_size,
    sheet,
)
from imgloc.output.features import draw_feature, draw_map
from imgloc.output.plots import AREA, DOT, ROBOT, Bar, Entry, framed

_WALL: Colour = (70, 110, 200)
_TOP = 6  # hypotheses that are drawn at most
_LEAST = 1e-3  # mass of a hypothesis that is drawn
_INSET = 340  # pixels of a side


def draw(
    place: OccupancyGrid | MapFeatures, answer: Localization | Likelihood | None = None,
    scan: LaserScan | None = None, *, truth: Pose2D | None = None, title: str = "", note: str = "",
    what: str = "map", at: tuple[float, float] | None = None,
) -> Picture:  # fmt: skip
    """Draw a map, what is computed from it, or an answer on it.

    Parameters
    ----------
    place : OccupancyGrid or MapFeatures
    answer, scan : Localization or Likelihood, and LaserScan, optional
        The scan is laid on the map at each hypothesis.
    truth : Pose2D, optional
        True pose of the sensor, map frame.
    title, note : str
        Lines above and below an answer.
    what, at : str, and (float, float) in metres, map frame
        Without an answer: which feature to draw, and the point whose visibility is drawn; see
        :func:`imgloc.output.features.draw_feature`.

    Raises
    ------
    TypeError
        If an argument is of another type.
    ValueError, MapError
        If `what` is not known, or needs features, or a surface that the map has not.

    Examples
    --------
    >>> wall = np.pad(np.zeros((30, 40), bool), 2, constant_values=True)
    >>> draw(OccupancyGrid(wall, ~wall, 0.1)).px_per_m
    160.0
    """
    features = place if isinstance(place, MapFeatures) else None
    grid = place if features is None else features.grid
    if not isinstance(grid, OccupancyGrid):
        raise TypeError(f"expected an OccupancyGrid or MapFeatures to draw, got {place!r}")
    if scan is not None and not (isinstance(scan, LaserScan) and isinstance(answer, Localization)):
        raise TypeError("a scan is drawn at the poses of an answer: expected both")
    local = None if truth is None else in_grid_frame(truth, grid)
    if isinstance(answer, Likelihood):
        return _likelihood(answer, grid, local, title)
    if isinstance(answer, Localization):
        points = np.zeros((0, 2))
        if scan is not None:
            points = scan_xy(scan)[scan.valid] * answer.evidence.scale
        drawn = [in_grid_frame(h, grid.info) for h in _drawn(answer)]
        left = f"; {_not_drawn(answer)}" if drawn else ""
        notes = [f"verdict: {answer.verdict}{left}", *([note] if note else [])]
        above = f"{title or 'Where the scan was taken'}: {answer.verdict}"
        return draw_hypotheses(grid, points, drawn, truth=local, notes=notes, title=above)
    if answer is not None:
        raise TypeError(f"expected a Localization or a Likelihood to draw, got {answer!r}")
    if features is None and what == "map":
        return draw_map(grid, title)
    if features is None:
        raise ValueError(f"{what!r} is drawn of the features of a map: use imgloc.prepare")
    return draw_feature(features, what, at)


def draw_likelihood(
    likelihood: Likelihood, grid: OccupancyGrid | None = None, part: Part = WHOLE
) -> Picture:
    """Draw a likelihood as the paper does (caption of Fig. 1): its maximum over theta.

    Linearly normalised, black is the highest likelihood and white the lowest; turquoise is a
    likelihood of exactly 0. Values below 0 (CBML-O has them) count as 0; of log-likelihoods (the
    beam model's) ``exp(L - max L)`` is drawn. Walls and unknown space of the `grid` are laid over
    the picture.
    """
    best = likelihood.values.max(axis=0).astype(np.float64)
    if likelihood.method in LOG_METHODS:
        best = np.exp(best - max(best.max(), -1e300))  # -inf everywhere is 0 everywhere
    best = np.maximum(np.nan_to_num(best, nan=0.0), 0)
    top = best.max()
    grey = np.rint(255 * (1 - best / top if top > 0 else np.ones_like(best)))
    image = np.repeat(grey.astype(np.uint8)[..., None], 3, axis=2)
    image[best == 0] = TURQUOISE
    canvas = sheet(image, likelihood.grid, part)
    if grid is not None:
        free, occupied = _under(canvas, grid)
        canvas.image[~(free | occupied)] = SHADE
        canvas.image[occupied] = _WALL
    return canvas


def _likelihood(
    answer: Likelihood, grid: OccupancyGrid, truth: Pose2D | None, title: str
) -> Picture:
    """A likelihood on its map, with its maximum, framed."""
    k, row, column = np.unravel_index(np.argmax(answer.values), answer.values.shape)
    x, y = (np.array((column, row)) + 0.5) * answer.grid.resolution
    marks = [(Pose2D(x, y, float(answer.thetas[k])), PALETTE[1], "maximum")]
    marks += [] if truth is None else [(truth, TRUTH, "true pose")]
    canvas = draw_likelihood(answer, grid, building(grid, [pose for pose, *_ in marks]))
    names = ((colour, ROBOT, name) for _, colour, name in marks)
    entries = [*names, (_WALL, AREA, "wall"), (SHADE, AREA, "unknown")]
    if (canvas.image == TURQUOISE).all(axis=2).any():
        entries.append((TURQUOISE, AREA, "exactly 0"))
    for pose, colour, _ in marks:
        canvas.robot(pose.x, pose.y, pose.theta, colour, marker_size(canvas))
    shades = np.linspace(255, 0, 64).astype(np.uint8)[None, :, None].repeat(3, axis=2)
    bar = Bar(shades, 0.0, 1.0, 0.25, "likelihood at the best heading, as a share of the maximum")
    title = f"{title or 'Likelihood of each place'} ({answer.method})"
    return framed(canvas, grid.origin, title, entries, bar=bar)


def draw_hypotheses(
    grid: OccupancyGrid, scan_xy: FloatArray, hypotheses: Sequence[Hypothesis], *,
    truth: Pose2D | None = None, notes: Sequence[str] = (), title: str = "",
) -> Picture:  # fmt: skip
    """Draw where a scan may have been taken: the scan laid on the map at each hypothesis.

    The points `scan_xy` (N, 2) are in the sensor's frame, metres. The hypotheses, best first, grid
    frame, are drawn with ellipses of two standard deviations; the true pose, grid frame, with a
    cross. The legend has the mass and the pose, in the map frame, of each, and the `notes`. A scan
    that is small on the map is drawn larger beside it.
    """
    shown = list(zip(hypotheses, itertools.cycle(PALETTE)))
    poses = [h.pose for h in hypotheses]
    every = poses if truth is None else [*poses, truth]
    canvas = map_canvas(grid, building(grid, every))
    names = [f"{k:<2} {'█' * round(12 * h.mass):12} {100 * h.mass:5.1f} %"
             for k, h in enumerate(hypotheses, 1)]  # fmt: skip
    marks = [(colour, ROBOT) for _, colour in shown]
    if truth is not None:
        names, marks = [*names, f"{'true pose':23}"], [*marks, (INK, "x")]
    xyt = np.array([(p.x, p.y, p.theta) for p in every]).reshape(-1, 3)
    head = f"{'mass':>23} {'x / m':>9} {'y / m':>9} {'theta / deg':>12}"
    entries: list[Entry] = [(PAPER, "", head)] if every else []
    for mark, name, (x, y, theta) in zip(
        marks, names, transform_poses(grid.origin, xyt).tolist(), strict=True
    ):
        entries.append((*mark, f"{name} {x:9.2f} {y:9.2f} {np.rad2deg(theta):12.1f}"))
    entries += [(PAPER, "", note) for note in notes]
    if poses:
        entries += [(PALETTE[0], DOT, "the scan, as seen from each place")] * bool(len(scan_xy))
        entries.append((faded(PALETTE[0], 0.25), DOT, "ellipse: 2 standard deviations"))
    entries += [(GREY, AREA, "wall"), (SHADE, AREA, "unknown")]
    inset = _inset(grid, scan_xy, poses, canvas)
    for each in (canvas, inset):
        if each is not None:
            _lay(each, scan_xy, shown, truth)
    return framed(
        canvas, grid.origin, title, entries, columns=1, labels=_numbers(canvas, poses), inset=inset
    )


def _lay(
    canvas: Picture, scan_xy: FloatArray, shown: Sequence[tuple[Hypothesis, Colour]],
    truth: Pose2D | None,
) -> None:  # fmt: skip
    """Draw hypotheses, the bolder the more mass they have, and the truth."""
    most = max((h.mass for h, _ in shown), default=0.0)
    full, every = marker_size(canvas), []
    for h, colour in reversed(shown):
        share = 0.3 + 0.7 * (h.mass / most) ** 0.5 if most > 0 else 1.0
        every.append((h, faded(colour, share), share))
    for h, colour, share in every:
        points = transform_points(h.pose, scan_xy)
        canvas.dots(points, colour, max(1.2, 0.28 * full) * (0.5 + 0.5 * share))
    for h, colour, share in every:
        ellipse = (h.pose.x, h.pose.y) + 2 * deviation_ellipse(h.covariance)
        canvas.polygon(ellipse, colour, 0.25)
        canvas.lines(ellipse[None], colour)
        canvas.robot(h.pose.x, h.pose.y, h.pose.theta, colour, full * (0.6 + 0.4 * share))
    if truth is not None:
        arms = np.array([[(-1, -1), (1, 1)], [(-1, 1), (1, -1)]]) * 1.5 * full / canvas.px_per_m
        for colour, thickness in ((PAPER, 4), (INK, 2)):
            canvas.lines(arms + (truth.x, truth.y), colour, thickness)


def _inset(
    grid: OccupancyGrid, scan_xy: FloatArray, poses: Sequence[Pose2D], canvas: Picture
) -> Picture | None:
    """The place of the best hypothesis, larger, if the scan is small on the map."""
    if not poses or not len(scan_xy):
        return None
    half = max(2.0, 1.1 * float(np.percentile(np.hypot(*scan_xy.T), 80)))
    if 5 * half > np.ptp(canvas.box, axis=0).max():
        return None
    scale = _INSET * enlarged(canvas.image) * grid.resolution / (2 * half)
    around = np.array([(poses[0].x, poses[0].y)]) + [[-half], [half]]
    return map_canvas(grid, Part(around, max(1, round(scale))))


def _numbers(canvas: Picture, poses: Sequence[Pose2D]) -> list[tuple[float, float, str]]:
    """The numbers of poses, each behind its robot; those of poses at one place together."""
    size, f = marker_size(canvas), enlarged(canvas.image)
    groups, near = list[tuple[Pose2D, list[str]]](), 3 * size / canvas.px_per_m
    for number, pose in enumerate(poses, 1):
        for other, names in groups:
            if np.hypot(other.x - pose.x, other.y - pose.y) < near:
                names.append(str(number))
                break
        else:
            groups.append((pose, [str(number)]))
    away, edge = (1.4 * size + 8 * f) / canvas.px_per_m, 8 * f / canvas.px_per_m
    out = []
    for pose, names in groups:
        at = (pose.x - away * np.cos(pose.theta), pose.y - away * np.sin(pose.theta))
        x, y = np.clip(at, canvas.box[0] + edge, canvas.box[1] - edge).tolist()
        out.append((x, y, ", ".join(names)))
    return out


def _drawn(answer: Localization) -> list[Hypothesis]:
    """The hypotheses that a picture shows: the best one, and others that hold mass."""
    some = [h for k, h in enumerate(answer.hypotheses) if k == 0 or h.mass >= _LEAST]
    return some[:_TOP]


def _not_drawn(answer: Localization) -> str:
    """Count what a picture of an answer leaves out, in words."""
    drawn = _drawn(answer)
    more = answer.evidence.found - len(drawn)
    mass = answer.evidence.unlisted + sum(h.mass for h in answer.hypotheses)
    mass -= sum(h.mass for h in drawn)
    other = f"{more} other poses: {100 * mass:.1f} %, " if more > 0 else ""
    return f"{other}elsewhere: {100 * answer.elsewhere:.1f} %"


def _under(canvas: Picture, grid: OccupancyGrid) -> tuple[BoolArray, BoolArray]:
    """The pixels of a canvas that lie over free and over occupied cells of a map."""
    height, width = canvas.image.shape[:2]
    last, cell = np.array(grid.occupied.shape), grid.resolution
    y = canvas.corner[1] + (height - 0.5 - np.arange(height)) / canvas.px_per_m
    x = canvas.corner[0] + (np.arange(width) + 0.5) / canvas.px_per_m
    row, column = (np.floor(v / cell + 1e-9).astype(np.int64) + 1 for v in (y, x))
    index = np.ix_(np.clip(row, 0, last[0] + 1), np.clip(column, 0, last[1] + 1))
    # Where a pixel has several cells, a wall that is one cell thick is still there.
    block = max(1, round(1 / (canvas.px_per_m * cell)))
    walls = cv2.dilate(np.pad(grid.occupied, 1).view(np.uint8), np.ones((block, block), np.uint8))
    return np.pad(grid.free, 1)[index], walls[index] > 0


def mosaic(pictures: Sequence[Picture], columns: int | None = None) -> Picture:
    """Lay pictures of any sizes out on a white sheet, upper edges aligned.

    Without `columns` the sheet is about as wide as 4 : 3. Without a picture it is a ValueError.
    """
    if not pictures:
        raise ValueError("a mosaic needs at least one picture")
    images, gap = [picture.image for picture in pictures], 8
    if columns is None:
        area = float(np.mean([i.shape[1] / i.shape[0] for i in images]))
        columns = round((len(images) * 4 / 3 / area) ** 0.5)
    columns = max(1, min(len(images), columns))
    wide = [max(i.shape[1] for i in images[k::columns]) + gap for k in range(columns)]
    out = []
    for row in (images[k : k + columns] for k in range(0, len(images), columns)):
        sheet = np.full((max(map(len, row)) + gap, sum(wide), 3), 255, np.uint8)
        for k, image in enumerate(row):
            sheet[: len(image), sum(wide[:k]) :][:, : image.shape[1]] = image
        out.append(sheet)
    return Picture(np.concatenate(out))
