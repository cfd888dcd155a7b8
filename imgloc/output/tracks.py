"""Tracks for people and programs: rows of JSON, TUM's trajectory, ROS messages, pictures, video."""

import itertools
import math
import os
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path

import cv2
import numpy as np

from imgloc.errors import OutputError
from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.scanpoints import scan_xy
from imgloc.filters.belief import AMBIGUOUS, LOST, UNIQUE, Belief
from imgloc.filters.deviation import Deviation, deviation_of
from imgloc.filters.follow import Moment
from imgloc.geometry import transform_points
from imgloc.io.files import PathLike, display, write_bytes_atomic
from imgloc.model import FloatArray, LaserScan, OccupancyGrid, Pose2D, compose, inverse
from imgloc.output.axes import draw_grid, framed, wrapped
from imgloc.output.canvas import (
    INK,
    LEGEND,
    PALETTE,
    PAPER,
    SHADE,
    TRUTH,
    Canvas,
    Colour,
    Image,
    enlarged,
    faded,
    legend,
    map_canvas,
    marker_size,
    outlined,
    text,
)
from imgloc.output.pictures import Picture
from imgloc.output.plots import blank, ink
from imgloc.runs.opening import quiet_libraries

COLOURS: dict[str, Colour] = {
    UNIQUE: (178, 114, 0), AMBIGUOUS: (0, 159, 230), LOST: (80, 80, 80),
}  # fmt: skip
START: Colour = PALETTE[2]
SCAN: Colour = PALETTE[3]
OFF: Colour = PALETTE[0]  #: of the way that a robot was carried
_SIDE, _NARROW = 960, 480  # pixels of the longer side of a video at most, and of its width at least
_CODECS = {".webm": "VP80", ".mp4": "mp4v"}
_STEP = 3.0  # metres from scan to scan that are drawn as one way
_MINUTES = (10.0, 30.0, 60.0, 120.0, 300.0, 600.0, 1800.0)  # seconds between marks of time
_MARKS = 12  # of them at most
_DRAWN = 1e-3  # mass of a place that is drawn
_LISTED = 3  # kidnappings whose lengths the legend has
_CARRIED = 1.0  # metres beyond twice what odometry says: no driving


def tum_text(moments: Iterable[Moment], *, best: bool = False) -> str:
    """The trajectory for `evo_ape tum`: ``stamp x y z qx qy qz qw``, of unique poses only.

    With `best` it has the best guesses, too, each below a comment that says so.
    """
    lines = []
    for moment in moments:
        pose = moment.best if best else moment.pose
        if pose is None or not math.isfinite(moment.stamp):
            continue
        if moment.pose is None:
            lines.append(f"# guess: {moment.belief.verdict}")
        z, w = math.sin(pose.theta / 2), math.cos(pose.theta / 2)
        lines.append(f"{moment.stamp:.9f} {pose.x:.9f} {pose.y:.9f} 0.0 0.0 0.0 {z:.12f} {w:.12f}")
    return "".join(line + "\n" for line in lines)


def track_line(moment: Moment, *, best: bool = False) -> str:
    """One line for people; with `best` a pose that is not unique is there, as a guess."""
    place = f"{'-':>10} {'-':>10} {'-':>12}"
    p = moment.best if best else moment.pose
    if p is not None:
        place = f"{p.x:>10.3f} {p.y:>10.3f} {math.degrees(p.theta):>12.2f}"
    mass = float(moment.belief.mass[0]) if len(moment.belief.mass) else 0.0
    guess = "guess" if p is not None and moment.pose is None else ""
    verdict = ": ".join(filter(None, (moment.belief.verdict, guess or moment.withheld)))
    head = f"{moment.index:>6} {moment.stamp:>14.3f}  {verdict:<22}"
    return f"{head} {place} {100 * mass:>7.1f}% {moment.metres:>9.2f}"


def track_header() -> str:
    """What stands above the lines of :func:`track_line`."""
    place = f"{'x / m':>10} {'y / m':>10} {'theta / deg':>12}"
    return f"{'index':>6} {'stamp':>14}  {'verdict':<22} {place} {'mass':>8} {'driven/m':>9}"


def draw_track(
    grid: OccupancyGrid, moments: Sequence[Moment], truth: FloatArray | None = None, title: str = ""
) -> Picture:
    """Draw the path over the map, coloured by verdict, with its start, direction and minutes.

    While several places fit or none does, the best guess is a small dot: it is not a path. The true
    path, poses (N, 3) of the robot in the map frame for each moment, is a thin line. Where the
    robot got farther than odometry knows it was carried: a dashed line leads there. Below is then
    the error of each unique pose over time.
    """
    canvas = map_canvas(grid)
    ticks = draw_grid(canvas, grid.origin)
    back, size = inverse(grid.origin), marker_size(canvas)
    if truth is not None and len(truth) > 1:
        carried = np.hypot(*np.diff(truth[:, :2], axis=0).T)
        carried -= 2 * np.diff([m.metres for m in moments])
        breaks = np.flatnonzero(carried > _CARRIED) + 1
        for part in np.split(truth, breaks):
            known = part[np.isfinite(part[:, 0]), :2]
            canvas.lines(transform_points(back, known)[None], TRUTH)
    guessed = [m for m in moments if m.best is not None]
    at = transform_points(back, np.array([(m.best.x, m.best.y) for m in guessed if m.best]))
    for m, xy in zip(guessed, at, strict=True):
        radius = 0.3 * size if m.belief.verdict == UNIQUE else 0.2 * size
        canvas.dots(xy[None], COLOURS[m.belief.verdict], radius)
    sure = [(m, xy) for m, xy in zip(guessed, at, strict=True) if m.pose is not None]
    carried_off = list[float]()
    for (m, xy), (n, next_xy) in itertools.pairwise(sure):
        far = float(np.hypot(*(next_xy - xy)))
        if n.index == m.index + 1 and far < _STEP:
            canvas.lines(np.stack((xy, next_xy))[None], COLOURS[UNIQUE], 2)
        elif far > 2 * (n.metres - m.metres) + _CARRIED:
            carried_off.append(far)
            dashes = np.linspace(xy, next_xy, 2 * max(2, round(far * canvas.px_per_m / 16)))
            canvas.lines(dashes.reshape(-1, 2, 2), OFF, 2)
    words = _marks(canvas, sure, grid.origin.theta, moments[0].stamp if moments else math.nan)
    counts = [sum(m.belief.verdict == name for m in moments) for name in COLOURS]
    words = [
        (COLOURS[name], f"{name}: {count} of {len(moments)}")
        for name, count in zip(COLOURS, counts, strict=True)
    ] + words
    if carried_off:
        lengths = ", ".join(f"{far:.1f} m" for far in carried_off[:_LISTED])
        words.append(
            (OFF, f"dashed: carried off, {lengths}" + ", ..." * (len(carried_off) > _LISTED))
        )
    if truth is not None:
        words.append((TRUTH, "true path"))
    image = framed(canvas.image, ticks, title)
    found = None if truth is None else deviation_of(moments, truth)
    if found is not None and len(found.ape) > 1:
        image = np.concatenate((image, _curve(moments, found, image.shape[1])))
    return Picture(legend(image, words))


def _marks(
    canvas: Canvas, sure: Sequence[tuple[Moment, FloatArray]], turned: float, begin: float
) -> list[tuple[Colour, str]]:
    """Mark start, end, direction and minutes of a path; returns what the marks mean."""
    if not sure:
        return []
    size, f = marker_size(canvas), enlarged(canvas.image)
    points = canvas.pixels(np.array([xy for _, xy in sure]))
    way = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))))
    last = sure[-1][0].stamp - begin
    every = next((s for s in _MINUTES if last / s <= _MARKS), _MINUTES[-1])
    next_arrow, next_mark, used = 6 * size, every, list[tuple[FloatArray, str]]()
    for (moment, xy), pixel, far in zip(sure, points, way, strict=True):
        pose = moment.pose
        assert pose is not None
        if far >= next_arrow:
            next_arrow = far + 10 * size
            _arrow(canvas, xy, pose.theta - turned, 0.8 * size)
        since = moment.stamp - begin
        if since >= next_mark:
            time, next_mark = since // every * every, (since // every + 1) * every
            near = any(np.abs(pixel - other).max() <= 30 * f for other, _ in used)
            if since - time < 0.2 * every:  # else no pose was unique at that time
                canvas.dots(xy[None], INK, 0.35 * size)
                label = f"{time / 60:g} min" if every >= 60 else f"{time:g} s"
                used += [] if near else [(pixel, label)]
    for pixel, label in used:
        x, y = round(pixel[0] + 0.6 * size), round(pixel[1] - 0.6 * size)
        outlined(canvas.image, label, x, y, round(12 * f), 2)
    first, end = sure[0], sure[-1]
    canvas.dots(first[1][None], PAPER, 1.2 * size)
    canvas.dots(first[1][None], START, size)
    pose = end[0].pose
    assert pose is not None
    canvas.robot(end[1][0], end[1][1], pose.theta - turned, COLOURS[UNIQUE], size)
    marks = [(START, "first unique pose"), (COLOURS[UNIQUE], "robot: last unique pose")]
    return [*marks, (INK, "arrow: direction")] + ([(INK, "dot: time")] if last >= every else [])


def _arrow(canvas: Canvas, xy: FloatArray, theta: float, size: float) -> None:
    """An arrow head on the path that points along the heading."""
    r = size / canvas.px_per_m
    turn = np.array([[np.cos(theta), np.sin(theta)], [-np.sin(theta), np.cos(theta)]])
    canvas.polygon(
        np.array([(1.2, 0.0), (-0.7, 0.8), (-0.3, 0.0), (-0.7, -0.8)]) * r @ turn + xy, INK
    )


def _curve(moments: Sequence[Moment], found: Deviation, width: int) -> Image:
    """The distance of each unique pose from the true one, over time."""
    f = max(1.0, width / 1500)
    figure, pixels = blank(width / 100, 2.4 * f, layout="constrained")
    axes = figure.subplots()
    stamps = np.array([m.stamp for m in moments])
    timed = bool(np.isfinite(stamps).all() and stamps[-1] > stamps[0])
    x = stamps - stamps[0] if timed else np.array([float(m.index) for m in moments])
    after = np.diff([moments[k].index for k in found.which], prepend=math.inf) == 1
    parts = np.split(np.arange(len(found.which)), np.flatnonzero(~after)[1:])
    for part in parts:
        axes.plot(x[found.which[part]], found.ape[part], ".-", color=ink(TRUTH))
    axes.set_title(found.words, fontsize=10 * f, loc="left", wrap=True)
    axes.set_xlabel("time / s" if timed else "scan", fontsize=9 * f)
    axes.set_ylabel("error / m", fontsize=9 * f)
    axes.set(xlim=(0.0, max(float(x[-1]), 1e-9)), ylim=(0.0, 1.05 * max(found.ape.max(), 0.01)))
    axes.tick_params(labelsize=8 * f)
    axes.grid(color=ink(SHADE))
    out = pixels()
    return np.pad(out, ((0, 0), (0, width - out.shape[1]), (0, 0)), constant_values=255)


def draw_belief(canvas: Canvas, belief: Belief) -> Image:
    """Draw all places of a belief, grid frame, on a copy of the map: as dark as they are likely."""
    sheet = Canvas(canvas.image.copy(), canvas.px_per_m)
    size, colour = marker_size(canvas), COLOURS[belief.verdict]
    for pose, mass in list(zip(belief.poses, belief.mass, strict=True))[::-1]:
        if mass < _DRAWN:
            continue
        ink = faded(colour, 0.25 + 0.75 * math.sqrt(float(mass)))
        x, y, theta = pose
        sheet.robot(x, y, theta, ink, size * (0.5 + 0.5 * float(mass)))
    return sheet.image


class Video:
    """The belief over time, one frame a scan: the scan, the trail and all places that may be it.

    WebM with VP8, which browsers play; MP4 (MPEG-4 part 2), which they do not, by the name.

    Raises
    ------
    OutputError
        From :meth:`save`, if OpenCV here cannot write such videos, or the file cannot be written.
    """

    def __init__(self, features: MapFeatures, ending: str = ".webm", title: str = "") -> None:
        large, self._origin = map_canvas(features.grid), features.grid.origin
        scale = min(1.0, _SIDE / max(large.image.shape[:2]))
        height, width = (2 * max(1, round(scale * n / 2)) for n in large.image.shape[:2])
        small = cv2.resize(large.image, (width, height), interpolation=cv2.INTER_AREA)
        self._canvas = Canvas(np.asarray(small, np.uint8), scale * large.px_per_m)
        self._size = max(width, _NARROW), height + 2 * LEGEND
        first, *more = wrapped(title, self._size[0] - 32, 13)
        self._title = f"{first} ..." if more else first
        self._trail, self._begin = list[FloatArray](), math.nan
        self._last: int | None = None
        handle, self._path = tempfile.mkstemp(suffix=ending)
        os.close(handle)
        fourcc = cv2.VideoWriter.fourcc(*_CODECS[ending])
        with quiet_libraries():  # FFmpeg says that it does not know the tag, and writes it
            self._writer = cv2.VideoWriter(self._path, fourcc, 10.0, self._size)

    def add(self, moment: Moment, scan: LaserScan | None = None) -> None:
        """Add the frame of a moment, with its scan at the best place."""
        if math.isnan(self._begin):
            self._begin = moment.stamp
        canvas = Canvas(self._canvas.image.copy(), self._canvas.px_per_m)
        verdict, belief = moment.belief.verdict, moment.belief
        for part in self._trail:
            canvas.lines(part[None], COLOURS[UNIQUE], 2)
        if scan is not None and len(belief.poses):
            base = Pose2D(*belief.poses[0])
            at = base if scan.T_base_laser is None else compose(base, scan.T_base_laser)
            canvas.dots(transform_points(at, scan_xy(scan)[scan.valid]), SCAN, 1.5)
        self._extend(moment)
        image = draw_belief(canvas, belief)
        about = f"{moment.stamp - self._begin:.1f} s, " if np.isfinite(moment.stamp) else ""
        words = [(COLOURS[verdict], f"{about}{moment.metres:.1f} m: {verdict}"), (SCAN, "scan")]
        others = sum(belief.mass[1:] >= _DRAWN)
        words += [(faded(COLOURS[verdict], 0.4), f"{others} other places")] if others else []
        width, height = self._size
        frame = np.full((height, width, 3), 255, np.uint8)
        text(frame, self._title, 8, 24)
        frame[LEGEND : LEGEND + len(image), : image.shape[1]] = image
        below = legend(np.full((1, width, 3), 255, np.uint8), words)[1 : LEGEND + 1, :width]
        frame[height - LEGEND :][: len(below)] = below
        self._writer.write(frame)

    def _extend(self, moment: Moment) -> None:
        """Add the pose of a moment to the trail, if it is unique."""
        if moment.pose is None:
            self._last = None
            return
        xy = moment.belief.poses[:1, :2]
        if self._last == moment.index - 1 and np.hypot(*(xy[0] - self._trail[-1][-1])) < _STEP:
            self._trail[-1] = np.concatenate((self._trail[-1], xy))
        else:
            self._trail.append(xy)
        self._last = moment.index

    def save(self, path: PathLike, *, force: bool = False) -> None:
        """Write the file."""
        good = self._writer.isOpened()
        self._writer.release()
        data = Path(self._path).read_bytes()
        self.close()
        if not good or not data:
            ending = Path(path).suffix.lower()
            raise OutputError(f"{display(path)}: OpenCV here cannot write {ending} videos")
        write_bytes_atomic(path, data, force=force)

    def close(self) -> None:
        """Drop what was drawn."""
        self._writer.release()
        Path(self._path).unlink(missing_ok=True)
