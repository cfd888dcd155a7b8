"""Tracks for people and programs: rows of JSON, TUM's trajectory, ROS messages, pictures, video."""

import itertools
import math
import os
import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import replace
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
from imgloc.output.canvas import (
    INK,
    PALETTE,
    PAPER,
    SHADE,
    TRUTH,
    Colour,
    Picture,
    building,
    enlarged,
    faded,
    map_canvas,
    marker_size,
)
from imgloc.output.pictures import mosaic
from imgloc.output.plots import DASHED, DOT, LINE, ROBOT, Entry, blank, framed, ink
from imgloc.runs.opening import quiet_libraries

COLOURS: dict[str, Colour] = {
    UNIQUE: (178, 114, 0), AMBIGUOUS: (0, 159, 230), LOST: (80, 80, 80),
}  # fmt: skip
START: Colour = PALETTE[2]
SCAN: Colour = PALETTE[3]
OFF: Colour = PALETTE[0]  #: of the way that a robot was carried
_SIDE = 960  # pixels of the longer side of the map of a video at most
_CODECS = {".webm": "VP80", ".mp4": "mp4v"}
_STEP = 3.0  # metres from scan to scan that are drawn as one way
_MINUTES = (10.0, 30.0, 60.0, 120.0, 300.0, 600.0, 1800.0)  # seconds between marks of time
_MARKS = 12  # of them at most
_DRAWN = 1e-3  # mass of a place that is drawn
_LISTED = 3  # kidnappings whose lengths the legend has
_CARRIED = 1.0  # metres beyond twice what odometry says: no driving


def tum_text(moments: Iterable[Moment], *, best: bool = False) -> str:
    """The trajectory for `evo_ape tum`: ``stamp x y z qx qy qz qw``, of unique poses only.

    With `best` it has the best guesses, too, each below a comment that names it a guess.
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
    way = "-" if math.isnan(moment.metres) else f"{moment.metres:.2f}"
    return f"{head} {place} {100 * mass:>7.1f}% {way:>9}"


def way_words(moment: Moment) -> str:
    """The way since the first scan, if it is known."""
    return "unknown way" if math.isnan(moment.metres) else f"{moment.metres:.1f} m"


def track_header() -> str:
    """The line above those of :func:`track_line`."""
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
    back, guessed = inverse(grid.origin), [m for m in moments if m.best is not None]
    poses = [compose(back, m.best) for m in guessed if m.best]
    canvas = map_canvas(grid, building(grid, poses))
    size = marker_size(canvas)
    if truth is not None and len(truth) > 1:
        carried = np.hypot(*np.diff(truth[:, :2], axis=0).T)
        carried -= 2 * np.diff([m.metres for m in moments])
        breaks = np.flatnonzero(carried > _CARRIED) + 1
        for part in np.split(truth, breaks):
            known = part[np.isfinite(part[:, 0]), :2]
            canvas.lines(transform_points(back, known)[None], TRUTH)
    at = np.array([(pose.x, pose.y) for pose in poses]).reshape(-1, 2)
    for m, xy in zip(guessed, at, strict=True):
        radius = 0.3 * size if m.belief.verdict == UNIQUE else 0.2 * size
        canvas.dots(xy[None], COLOURS[m.belief.verdict], radius)
    sure = [(m, xy) for m, xy in zip(guessed, at, strict=True) if m.pose is not None]
    carried_off = list[float]()
    for (m, xy), (n, next_xy) in itertools.pairwise(sure):
        if far := _lay_way(canvas, m, n, np.stack((xy, next_xy))):
            carried_off.append(far)
    begin = moments[0].stamp if moments else math.nan
    marks, labels = _marks(canvas, sure, grid.origin.theta, begin)
    verdicts = [m.belief.verdict for m in moments]
    entries = [
        (colour, DOT, f"{name}: {verdicts.count(name)} of {len(moments)}")
        for name, colour in COLOURS.items()
    ] + marks
    if carried_off:
        lengths = ", ".join(f"{far:.1f} m" for far in carried_off[:_LISTED])
        more = ", ..." * (len(carried_off) > _LISTED)
        entries.append((OFF, DASHED, f"carried off, {lengths}{more}"))
    if truth is not None:
        entries.append((TRUTH, LINE, "true path"))
    title = title or "The way that the robot took"
    picture = framed(canvas, grid.origin, title, entries, labels=labels)
    found = None if truth is None else deviation_of(moments, truth)
    if found is not None and len(found.ape) > 1:
        picture = mosaic([picture, _curve(moments, found, picture.image.shape[1])], columns=1)
    return picture


def _lay_way(canvas: Picture, before: Moment, after: Moment, ends: FloatArray) -> float:
    """Draw the way between two unique poses (2, 2); the metres that it was carried, or 0."""
    far = float(np.hypot(*(ends[1] - ends[0])))
    if after.index == before.index + 1 and far < _STEP:
        canvas.lines(ends[None], COLOURS[UNIQUE], 2)
    elif far > 2 * (after.metres - before.metres) + _CARRIED:
        dashes = np.linspace(ends[0], ends[1], 2 * max(2, round(far * canvas.px_per_m / 16)))
        canvas.lines(dashes.reshape(-1, 2, 2), OFF, 2)
        return far
    return 0.0


def _marks(
    canvas: Picture, sure: Sequence[tuple[Moment, FloatArray]], turned: float, begin: float
) -> tuple[list[Entry], list[tuple[float, float, str]]]:
    """Mark start, end, direction and minutes of a path; entries of the legend, and labels."""
    if not sure:
        return [], []
    size, f = marker_size(canvas), enlarged(canvas.image)
    points = canvas.pixels(np.array([xy for _, xy in sure]))
    way = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))))
    last = sure[-1][0].stamp - begin
    every = next((s for s in _MINUTES if last / s <= _MARKS), _MINUTES[-1])
    next_arrow, next_mark, used, labels = 6 * size, every, list[FloatArray](), []
    for (moment, xy), pixel, far in zip(sure, points, way, strict=True):
        pose = moment.pose
        assert pose is not None
        if far >= next_arrow:
            next_arrow = far + 10 * size
            _arrow(canvas, xy, pose.theta - turned, 0.8 * size)
        since = moment.stamp - begin
        if since >= next_mark:
            time, next_mark = since // every * every, (since // every + 1) * every
            near = any(np.abs(pixel - other).max() <= 30 * f for other in used)
            if since - time < 0.2 * every:  # else no pose was unique at that time
                canvas.dots(xy[None], INK, 0.35 * size)
                label = f"{time / 60:g} min" if every >= 60 else f"{time:g} s"
                if not near:
                    used.append(pixel)
                    away = np.array((24 * f, 10 * f)) / canvas.px_per_m
                    labels.append((*(xy + away).tolist(), label))
    first, end = sure[0], sure[-1]
    canvas.dots(first[1][None], PAPER, 1.2 * size)
    canvas.dots(first[1][None], START, size)
    pose = end[0].pose
    assert pose is not None
    canvas.robot(end[1][0], end[1][1], pose.theta - turned, COLOURS[UNIQUE], size)
    marks = [(START, DOT, "first unique pose"), (COLOURS[UNIQUE], ROBOT, "last unique pose")]
    marks.append((INK, ">", "direction"))
    return marks + [(INK, DOT, "time since the first scan")] * (last >= every), labels


def _arrow(canvas: Picture, xy: FloatArray, theta: float, size: float) -> None:
    """An arrow head on the path that points along the heading."""
    r = size / canvas.px_per_m
    turn = np.array([[np.cos(theta), np.sin(theta)], [-np.sin(theta), np.cos(theta)]])
    canvas.polygon(
        np.array([(1.2, 0.0), (-0.7, 0.8), (-0.3, 0.0), (-0.7, -0.8)]) * r @ turn + xy, INK
    )


def _curve(moments: Sequence[Moment], found: Deviation, width: int) -> Picture:
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
    return Picture(pixels())


def _draw_belief(canvas: Picture, belief: Belief) -> None:
    """Draw all places of a belief, grid frame: as dark as they are likely."""
    size, colour = marker_size(canvas), COLOURS[belief.verdict]
    for pose, mass in list(zip(belief.poses, belief.mass, strict=True))[::-1]:
        if mass < _DRAWN:
            continue
        ink = faded(colour, 0.25 + 0.75 * math.sqrt(float(mass)))
        x, y, theta = pose.tolist()
        canvas.robot(x, y, theta, ink, size * (0.5 + 0.5 * float(mass)))


class Video:
    """The belief over time, one frame a scan: the scan, the trail and all places that may be it.

    WebM with VP8, which browsers play; MP4 (MPEG-4 part 2), which they do not, by the name.

    Raises
    ------
    OutputError
        From :meth:`save`, if OpenCV here cannot write such videos, or the file cannot be written.
    """

    def __init__(self, features: MapFeatures, ending: str = ".webm", title: str = "") -> None:
        grid = features.grid
        large = map_canvas(grid, building(grid))
        shrink = min(1.0, _SIDE / max(large.image.shape[:2]))
        small = cv2.resize(large.image, None, None, shrink, shrink, cv2.INTER_AREA)
        self._map = Picture(np.asarray(small, np.uint8), shrink * large.px_per_m, large.corner)
        entries: list[Entry] = [(colour, ROBOT, name) for name, colour in COLOURS.items()]
        entries += [(faded(COLOURS[AMBIGUOUS], 0.4), ROBOT, "other places, paler if less likely")]
        entries += [(SCAN, DOT, "scan"), (COLOURS[UNIQUE], LINE, "way")]
        entries.append((OFF, DASHED, "carried off"))
        sheet = framed(self._map, grid.origin, title, entries)
        # Where in it the upper left pixel of the map is.
        upper = np.array([(self._map.box[0, 0], self._map.box[1, 1])])
        left, top = np.rint(sheet.pixels(upper)[0] + 0.5).astype(int).tolist()
        high, wide = self._map.image.shape[:2]
        self._within = np.s_[top : top + high, left : left + wide]
        height, width = sheet.image.shape[:2]
        figure, self._line = blank((width + width % 2) / 100, 0.28, facecolor="white")
        self._words = figure.text(16 / width, 0.4, "", size=10, color=ink(INK))
        around = ((0, 28 + height % 2), (0, width % 2), (0, 0))
        self._sheet = np.pad(sheet.image, around, constant_values=255)
        self._begin, self._last = math.nan, list[Moment]()  # the last unique one
        handle, self._path = tempfile.mkstemp(suffix=ending)
        os.close(handle)
        fourcc = cv2.VideoWriter.fourcc(*_CODECS[ending])
        with quiet_libraries():  # FFmpeg says that it does not know the tag, and writes it
            self._writer = cv2.VideoWriter(self._path, fourcc, 10.0, self._sheet.shape[1::-1])

    def add(self, moment: Moment, scan: LaserScan | None = None) -> None:
        """Add the frame of a moment, with its scan at the best place."""
        if math.isnan(self._begin):
            self._begin = moment.stamp
        belief = moment.belief
        if moment.pose is not None:
            for last in self._last:
                ends = np.stack((last.belief.poses[0, :2], belief.poses[0, :2]))
                _lay_way(replace(self._map, image=self._sheet[self._within]), last, moment, ends)
            self._last = [moment]
        frame = self._sheet.copy()
        canvas = replace(self._map, image=frame[self._within])
        if scan is not None and len(belief.poses):
            base = Pose2D(*belief.poses[0])
            at = base if scan.T_base_laser is None else compose(base, scan.T_base_laser)
            canvas.dots(transform_points(at, scan_xy(scan)[scan.valid]), SCAN, 1.5)
        _draw_belief(canvas, belief)
        about = f"{moment.stamp - self._begin:.1f} s, " if np.isfinite(moment.stamp) else ""
        others = int(np.count_nonzero(belief.mass[1:] >= _DRAWN))
        more = f"{others} other place{'s' * (others > 1)}" if others else moment.withheld
        words = ", ".join(filter(None, (belief.verdict, more)))
        self._words.set_text(f"{about}{way_words(moment)}: {words}")
        line = self._line()
        frame[-len(line) :, : line.shape[1]] = line
        self._writer.write(frame)

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
