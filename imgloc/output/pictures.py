"""Pictures of answers: likelihood stacks, ranked hypotheses."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.scanpoints import scan_xy
from imgloc.geometry import in_grid_frame, transform_points, transform_poses
from imgloc.io.files import PathLike, write_bytes_atomic
from imgloc.io.images import encode_picture
from imgloc.model import (
    BoolArray,
    FloatArray,
    Hypothesis,
    LaserScan,
    Likelihood,
    Localization,
    OccupancyGrid,
    Pose2D,
    compose,
)
from imgloc.options import LOG_METHODS
from imgloc.output.axes import draw_grid, framed, wrapped
from imgloc.output.canvas import (
    INK,
    PALETTE,
    PAPER,
    SHADE,
    TRUTH,
    TURQUOISE,
    Canvas,
    Colour,
    Image,
    colour_bar,
    deviation_ellipse,
    draw_map,
    enlarged,
    faded,
    legend,
    map_canvas,
    marker_size,
    outlined,
    scale_bar,
    sheet,
    text,
    text_width,
)
from imgloc.output.features import draw_feature

_WALL: Colour = (70, 110, 200)
_ROW = 24  # pixels of a line of the legend
_TOP = 6  # hypotheses that are drawn at most
_LEAST = 1e-3  # mass of a hypothesis that is drawn


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture to look at, in a notebook too, and to save."""

    image: Image

    def save(self, path: PathLike, *, force: bool = False) -> None:
        """Write it, whole or not at all, as PNG, JPEG or WebP: as the name says.

        A ConfigError for another name; an OutputError if it exists, without `force`.
        """
        data = encode_picture(self.image, Path(path).suffix.lower().replace("jpg", "jpeg")[1:])
        write_bytes_atomic(path, data, force=force)

    def __repr__(self) -> str:
        height, width = self.image.shape[:2]
        return f"<Picture of {width} x {height} pixels; save(path) writes it>"

    def _repr_png_(self) -> bytes:
        return encode_picture(self.image)


def draw(
    place: OccupancyGrid | MapFeatures,
    answer: Localization | Likelihood | None = None,
    scan: LaserScan | None = None,
    *,
    truth: Pose2D | None = None,
    title: str = "",
    note: str = "",
    what: str = "map",
    at: tuple[float, float] | None = None,
) -> Picture:
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
    >>> draw(OccupancyGrid(wall, ~wall, 0.1)).image.shape
    (544, 704, 3)
    """
    features = place if isinstance(place, MapFeatures) else None
    grid = place if features is None else features.grid
    if not isinstance(grid, OccupancyGrid):
        raise TypeError(f"expected an OccupancyGrid or MapFeatures to draw, got {place!r}")
    if scan is not None and not (isinstance(scan, LaserScan) and isinstance(answer, Localization)):
        raise TypeError("a scan is drawn at the poses of an answer: expected both")
    local = None if truth is None else in_grid_frame(truth, grid)
    if isinstance(answer, Likelihood):
        log = answer.method in LOG_METHODS
        image = draw_likelihood(
            answer, grid=grid, truth=local, log=log, title=title, origin=grid.origin
        )
        bar = f"likelihood ({answer.method}) at the best heading"
        shades = np.linspace(255, 0, 64).astype(np.uint8)[None, :, None].repeat(3, axis=2)
        image = colour_bar(image, shades, ("least", "greatest"), bar)
        layers = [(PALETTE[1], "maximum"), (_WALL, "wall"), (SHADE, "unknown")]
        layers += [(TURQUOISE, "exactly 0")] if (answer.values.max(axis=0) <= 0).any() else []
        layers += [] if truth is None else [(TRUTH, "true pose")]
        return Picture(legend(image, layers))
    if isinstance(answer, Localization):
        points = np.zeros((0, 2))
        if scan is not None:
            points = scan_xy(scan)[scan.valid] * answer.evidence.scale
        drawn = _drawn(answer)
        hypotheses = [in_grid_frame(h, grid.info) for h in drawn]
        left = f"; {_not_drawn(answer)}" if hypotheses else ""
        notes = [f"verdict: {answer.verdict}{left}", *([note] if note else [])]
        if hypotheses:
            dots = "dots: the scan as seen from each place; " if len(points) else ""
            notes.append(f"{dots}ellipse: 2 standard deviations; dark: wall; grey: unknown")
        above = f"{title}: {answer.verdict}" if title else ""
        image = draw_hypotheses(
            grid, points, hypotheses, truth=local, notes=notes, title=above, axes=True
        )
        return Picture(image)
    if answer is not None:
        raise TypeError(f"expected a Localization or a Likelihood to draw, got {answer!r}")
    if features is None and what == "map":
        return Picture(draw_map(grid))
    if features is None:
        raise ValueError(f"{what!r} is drawn of the features of a map: use imgloc.prepare")
    return Picture(draw_feature(features, what, at))


def draw_likelihood(
    likelihood: Likelihood,
    *,
    grid: OccupancyGrid | None = None,
    truth: Pose2D | None = None,
    scale: int | None = None,
    log: bool = False,
    title: str = "",
    origin: Pose2D | None = None,
) -> Image:
    """Draw a likelihood as the paper does (caption of Fig. 1): its maximum over theta.

    Linearly normalised, black is the highest likelihood and white the lowest; turquoise is a
    likelihood of exactly 0. Values below 0 (CBML-O has them) count as 0; of `log`-likelihoods (the
    beam model's) ``exp(L - max L)`` is drawn. Walls and unknown space of the `grid` are laid over
    the picture; the true pose, grid frame, is red. A cell is `scale` pixels wide. With the `origin`
    of the grid in the map frame the maximum is marked and the picture has axes and a `title`.
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
    ticks = []
    if origin is not None:
        ticks = draw_grid(Canvas(canvas.image.copy(), canvas.px_per_m), origin)
        k, row, column = np.unravel_index(np.argmax(likelihood.values), likelihood.values.shape)
        x, y = (np.array((column, row)) + 0.5) * likelihood.grid.resolution
        canvas.robot(x, y, float(likelihood.thetas[k]), PALETTE[1], marker_size(canvas))
    if truth is not None:
        canvas.robot(truth.x, truth.y, truth.theta, TRUTH, marker_size(canvas))
    return canvas.image if origin is None else framed(canvas.image, ticks, title)


def draw_hypotheses(
    grid: OccupancyGrid,
    scan_xy: FloatArray,
    hypotheses: Sequence[Hypothesis],
    *,
    truth: Pose2D | None = None,
    top: int = _TOP,
    scale: int | None = None,
    notes: Sequence[str] = (),
    title: str = "",
    axes: bool = False,
) -> Image:
    """Draw where a scan may have been taken: the scan laid on the map at each hypothesis.

    The points `scan_xy` (N, 2) are in the sensor's frame, metres. The `top` of the hypotheses, best
    first, grid frame, are drawn with ellipses of two standard deviations; the true pose, grid
    frame, with a cross. The legend, below or beside a high map, has the mass and the pose, in the
    map frame, of each, and the `notes`. A cell is `scale` pixels wide. Of a map that is mostly
    unknown what is known is drawn. With `axes` it has a grid and ticks in the map frame, instead of
    a scale bar, and a `title`.
    """
    shown = [(h, PALETTE[k % len(PALETTE)]) for k, h in enumerate(hypotheses[:top])]
    scene = _Scene(grid, scan_xy, shown, truth)
    image = scene.part(*scene.known()).drawn(scale, title, axes=axes)
    f = enlarged(image)
    legend = _legend(f, scene, notes)
    if legend is None:
        return image
    size = _beside(image, legend) or (round(340 * f),) * 2
    return _laid_out(image, legend, scene.inset(size))


@dataclass(frozen=True, eq=False)
class _Scene:
    """A map, or a part of it, with what is drawn on it; poses are in the grid frame."""

    grid: OccupancyGrid
    scan_xy: FloatArray  #: (N, 2), the sensor's frame, metres
    shown: Sequence[tuple[Hypothesis, Colour]]
    truth: Pose2D | None

    @property
    def poses(self) -> list[Pose2D]:
        """All poses, the true one last."""
        return [h.pose for h, _ in self.shown] + ([] if self.truth is None else [self.truth])

    def known(self) -> tuple[slice, slice]:
        """Rows and columns of the map that are worth a look: what is known of it, and the poses.

        All of them, unless these are less than half of it.
        """
        there = self.grid.occupied | self.grid.free
        for pose in self.poses:
            at = np.array((pose.y, pose.x)) // self.grid.resolution
            row, column = np.clip(at.astype(np.int64), 0, np.array(there.shape) - 1)
            there[row, column] = True
        spare, kept = 1 + max(there.shape) // 50, []
        for axis in (1, 0):
            (found,) = np.nonzero(there.any(axis=axis))
            low, high = (int(found[0]), int(found[-1])) if len(found) else (0, len(there))
            kept.append(slice(max(0, low - spare), min(there.shape[1 - axis], high + spare + 1)))
        rows, columns = kept
        if 2 * (rows.stop - rows.start) * (columns.stop - columns.start) > there.size:
            return slice(0, there.shape[0]), slice(0, there.shape[1])
        return rows, columns

    def part(self, rows: slice, columns: slice) -> "_Scene":
        """The same on some rows and columns of the map."""
        grid, cell = self.grid, self.grid.resolution

        def moved(p: Pose2D) -> Pose2D:
            return Pose2D(p.x - columns.start * cell, p.y - rows.start * cell, p.theta)

        corner = compose(grid.origin, Pose2D(columns.start * cell, rows.start * cell))
        part = OccupancyGrid(grid.occupied[rows, columns], grid.free[rows, columns], cell, corner)
        here = [(replace(h, pose=moved(h.pose)), colour) for h, colour in self.shown]
        return _Scene(part, self.scan_xy, here, None if self.truth is None else moved(self.truth))

    def drawn(self, scale: int | None, title: str = "", *, axes: bool = False) -> Image:
        """Draw hypotheses with their numbers, the bolder the more mass they have, and the truth."""
        canvas, shown, truth = map_canvas(self.grid, scale), self.shown, self.truth
        ticks = draw_grid(canvas, self.grid.origin) if axes else []
        most = max((h.mass for h, _ in shown), default=0.0)
        bold = [0.3 + 0.7 * (h.mass / most) ** 0.5 if most > 0 else 1.0 for h, _ in shown]
        full = marker_size(canvas)
        every = list(zip(shown, bold, strict=True))[::-1]
        for (hypothesis, colour), share in every:
            points = transform_points(hypothesis.pose, self.scan_xy)
            canvas.dots(points, faded(colour, share), max(1.2, 0.28 * full) * (0.5 + 0.5 * share))
        for (hypothesis, colour), share in every:
            pose, size, ink = hypothesis.pose, full * (0.6 + 0.4 * share), faded(colour, share)
            ellipse = (pose.x, pose.y) + 2 * deviation_ellipse(hypothesis.covariance)
            canvas.polygon(ellipse, ink, 0.25)
            canvas.lines(ellipse[None], ink)
            canvas.robot(pose.x, pose.y, pose.theta, ink, size)
        if truth is not None:
            _cross(canvas, truth.x, truth.y, 1.5 * full)
        _number(canvas, [h.pose for h, _ in shown], truth, full)
        if axes:
            return framed(canvas.image, ticks, title)
        scale_bar(canvas)
        return canvas.image

    def inset(self, size: tuple[int, int]) -> Image | None:
        """The place of the best hypothesis, larger, if the scan is small on the map.

        Its `size`, width and height in pixels, is about that.
        """
        if not self.shown or not len(self.scan_xy):
            return None
        reach, cell = float(np.percentile(np.hypot(*self.scan_xy.T), 80)), self.grid.resolution
        least, shape = int(np.ceil(max(2.0, 1.1 * reach) / cell)), self.grid.occupied.shape
        if 5 * least > max(shape):
            return None
        scale = max(1, round(min(size) / (2 * least)))
        pose, kept = self.shown[0][0].pose, []
        for at, pixels, end in zip((pose.y, pose.x), size[::-1], shape, strict=True):
            middle, half = int(at / cell), round(pixels / (2 * scale))
            kept.append(slice(max(0, middle - half), min(end, middle + half)))
            if kept[-1].stop <= kept[-1].start:
                return None
        close = self.part(kept[0], kept[1]).drawn(scale)
        cv2.rectangle(close, (0, 0), (close.shape[1] - 1, len(close) - 1), INK, 2)
        return close


def _number(canvas: Canvas, poses: Sequence[Pose2D], truth: Pose2D | None, size: float) -> None:
    """Write the numbers of poses, each where neither a mark nor another number is.

    Behind its robot if it can be; a line leads to one that has to stand farther off.
    """
    f = enlarged(canvas.image)
    big, high = round(15 * f), 8 * f
    height, width = canvas.image.shape[:2]
    taken = list[tuple[float, float, float, float]]()  # left, right, top, bottom
    spots = canvas.pixels(np.array([(p.x, p.y) for p in poses]))
    for (x, y), pose in zip(spots.tolist(), poses, strict=True):
        nose = (x + 1.4 * size * np.cos(pose.theta), y - 1.4 * size * np.sin(pose.theta))
        for (u, v), r in (((x, y), size), (nose, 0.8 * size)):
            taken.append((u - r, u + r, v - r, v + r))
    if truth is not None:
        ((x, y),) = canvas.pixels(np.array([(truth.x, truth.y)])).tolist()
        r = 1.5 * size
        taken.append((x - r, x + r, y - r, y + r))
    for number, ((x, y), pose) in enumerate(zip(spots.tolist(), poses, strict=True), start=1):
        if not (0 <= x < width and 0 <= y < height):
            continue
        word, best = str(number), (np.inf, x, y, 1.0)
        half = text_width(word, big) / 2 + f
        for far, turn in itertools.product((1.0, 1.6, 2.4, 3.4), range(8)):
            angle = pose.theta + np.pi + (turn + 1) // 2 * (-1) ** turn * np.pi / 4
            away = far * (size + 9 * f)
            u, v = x + away * np.cos(angle), y - away * np.sin(angle)
            covered = sum(
                max(0.0, min(u + half, right) - max(u - half, left))
                * max(0.0, min(v + high, bottom) - max(v - high, top))
                for left, right, top, bottom in taken
            )
            inside = half < u < width - half and high < v < height - high
            cost = covered / (4 * half * high) + 0.1 * far + 0.01 * turn + (not inside)
            if cost < best[0] - 1e-9:
                best = cost, u, v, far
        _, u, v, far = best
        taken.append((u - half, u + half, v - high, v + high))
        if far > 1:
            lead = np.array([[(x, y), (u, v)]])
            lead[0] += ((lead[0, ::-1] - lead[0]) / np.hypot(u - x, v - y)) * [[size], [high]]
            for ink, thick in ((PAPER, 3), (INK, 1)):
                cv2.polylines(canvas.image, [np.rint(lead[0]).astype(np.int32)], False, ink,
                              round(thick * f), cv2.LINE_AA)  # fmt: skip
        left, low = round(u) - text_width(word, big) // 2, round(v) + round(5 * f)
        outlined(canvas.image, word, left, low, big, round(2 * f))


def _drawn(answer: Localization) -> list[Hypothesis]:
    """The hypotheses that a picture shows: the best one, and others that hold mass."""
    some = [h for k, h in enumerate(answer.hypotheses) if k == 0 or h.mass >= _LEAST]
    return some[:_TOP]


def _not_drawn(answer: Localization) -> str:
    """What a picture of an answer leaves out, in words."""
    drawn = _drawn(answer)
    more = answer.evidence.found - len(drawn)
    mass = answer.evidence.unlisted + sum(h.mass for h in answer.hypotheses)
    mass -= sum(h.mass for h in drawn)
    other = f"{more} other poses: {100 * mass:.1f} %, " if more > 0 else ""
    return f"{other}elsewhere: {100 * answer.elsewhere:.1f} %"


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


def _legend(f: float, scene: _Scene, notes: Sequence[str]) -> Image | None:
    """A line per hypothesis: mark, bar and share of mass, pose; and the notes. None of nothing.

    Words are `f` times as large as on a screen.
    """
    poses, shown = scene.poses, scene.shown
    size, row = round(13 * f), round(_ROW * f)

    def px(length: float) -> int:
        return round(length * f)

    lines, ends = list[tuple[str, str, str]](), np.array([px(440)])
    if poses:
        table = transform_poses(scene.grid.origin, np.array([(p.x, p.y, p.theta) for p in poses]))
        lines = [("x / m", "y / m", "theta / deg")]
        lines += [(f"{x:.2f}", f"{y:.2f}", f"{np.rad2deg(theta):.1f}") for x, y, theta in table]
        columns = [px(24) + max(text_width(line[k], size) for line in lines) for k in range(3)]
        ends = px(272) + np.cumsum(columns)
    left = px(44) if poses else px(14)
    said = [line for note in notes for line in wrapped(note, int(ends[-1]) - left, size)]
    rows = len(lines) + len(said)
    if not rows:
        return None
    wide = max(int(ends[-1]), *(left + text_width(line, size) for line in said), 0) + px(14)
    out = np.full((row * rows + px(14), wide, 3), 255, np.uint8)
    base = px(21)
    for k, line in enumerate(lines):
        y = base + k * row
        for end, word in zip(ends.tolist(), line, strict=True):
            text(out, word, end - text_width(word, size), y, size=size)
    if shown:
        text(out, "mass", px(266) - text_width("mass", size), base, size=size)
    for k, (hypothesis, colour) in enumerate(shown, start=1):
        y = base + k * row
        Canvas(out, 1.0).robot(px(22), len(out) - y + 4.5 * f, 0.0, colour, 5.5 * f)
        text(out, str(k), px(44), y, size=size)
        out[y - px(10) : y + 1, px(68) : px(188)] = SHADE
        share = min(1.0, max(0.0, hypothesis.mass))
        out[y - px(10) : y + 1, px(68) : px(68) + round(px(120) * share)] = colour
        mass = f"{100 * hypothesis.mass:.1f} %"
        text(out, mass, px(266) - text_width(mass, size), y, size=size)
    if scene.truth is not None:
        y = base + len(poses) * row
        _cross(Canvas(out, 1.0), px(23), len(out) - y + 4.5 * f, 5 * f)
        text(out, "true pose", px(44), y, size=size)
    for k, words in enumerate(said, start=len(lines)):
        text(out, words, left, base + k * row, size=size)
    return out


def _beside(image: Image, legend: Image) -> tuple[int, int] | None:
    """Width and height in pixels that are left below a legend beside a high picture."""
    (height, width), gap = image.shape[:2], round(7 * enlarged(image))
    high, wide = height - len(legend) - 3 * gap, legend.shape[1] - gap
    return (wide, min(high, 2 * wide)) if height > 1.5 * width and high > wide / 2 else None


def _laid_out(image: Image, legend: Image, inset: Image | None) -> Image:
    """Put the legend and the inset below a picture, or beside one that is high."""
    (height, width), gap = image.shape[:2], round(7 * enlarged(image))
    parts = [part for part in (legend, inset) if part is not None]
    highs, wides = [len(p) for p in parts], [p.shape[1] for p in parts]
    beside = inset is not None and _beside(image, legend) is not None
    if beside:
        size = max(height, sum(highs) + 3 * gap), width + max(wides) + 2 * gap
    else:
        size = height + max(highs) + 2 * gap, max(width, sum(wides) + 2 * gap)
    out = np.full((*size, 3), 255, np.uint8)
    out[:height, :width] = image
    top, left = (gap, width + gap) if beside else (height + gap, 0)
    out[top : top + highs[0], left : left + wides[0]] = legend
    if inset is not None:
        top, left = (top + highs[0] + gap, left) if beside else (top, size[1] - gap - wides[1])
        out[top : top + highs[1], left : left + wides[1]] = inset
    return out


def mosaic(
    pictures: Sequence[tuple[str, Image]],
    columns: int | None = None,
    *,
    top: bool = False,
) -> Image:
    """Lay pictures of any sizes out on a white sheet, each with its caption, which is first, below.

    Without `columns` the sheet is about as wide as 4 : 3. Of a row the
    lower edges are aligned, or the `top` ones. Without a picture it is a ValueError.
    """
    if not pictures:
        raise ValueError("a mosaic needs at least one picture")
    gap, caption, n = 16, 26, len(pictures)
    cells = [(max(p.shape[1], text_width(c)), p.shape[0] + caption) for c, p in pictures]
    if columns is None:
        area = float(np.mean([w / h for w, h in cells]))
        columns = max(1, min(n, round((n * 4 / 3 / area) ** 0.5)))
    rows = -(-n // columns)
    wide = [max(w for w, _ in cells[k::columns]) for k in range(min(columns, n))]
    high = [max(h for _, h in cells[k * columns : (k + 1) * columns]) for k in range(rows)]
    size = (sum(high) + gap * (rows + 1), sum(wide) + gap * (len(wide) + 1), 3)
    out = np.full(size, 255, np.uint8)
    for k, (label, picture) in enumerate(pictures):
        row, column = divmod(k, columns)
        y = sum(high[:row]) + gap * (row + 1)
        x = sum(wide[:column]) + gap * (column + 1)
        h, w = picture.shape[:2]
        start = y if top else y + high[row] - caption - h
        left = x + (wide[column] - w) // 2
        out[start : start + h, left : left + w] = picture
        centre = x + (wide[column] - text_width(label)) // 2
        text(out, label, centre, y + high[row] - 8)
    return out
