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
from imgloc.filters.belief import AMBIGUOUS, LOST, UNIQUE, Belief
from imgloc.filters.follow import Moment
from imgloc.geometry import transform_points
from imgloc.io.files import PathLike, display, write_bytes_atomic
from imgloc.model import FloatArray, OccupancyGrid, inverse
from imgloc.output.canvas import (
    LEGEND,
    TRUTH,
    Canvas,
    Colour,
    Image,
    faded,
    legend,
    map_canvas,
    marker_size,
    scale_bar,
)
from imgloc.output.pictures import Picture

COLOURS: dict[str, Colour] = {
    UNIQUE: (178, 114, 0), AMBIGUOUS: (0, 159, 230), LOST: (80, 80, 80),
}  # fmt: skip
_SIDE = 960  # pixels of the longer side of a video at most
_DRAWN = 1e-3  # mass of a place that is drawn
_CARRIED = 1.0  # metres beyond twice what odometry says: no driving


def tum_text(moments: Iterable[Moment]) -> str:
    """The trajectory for `evo_ape tum`: ``stamp x y z qx qy qz qw``, of unique poses only."""
    lines = []
    for moment in moments:
        if moment.pose is None or not math.isfinite(moment.stamp):
            continue
        pose = moment.pose
        z, w = math.sin(pose.theta / 2), math.cos(pose.theta / 2)
        lines.append(f"{moment.stamp:.9f} {pose.x:.9f} {pose.y:.9f} 0.0 0.0 0.0 {z:.12f} {w:.12f}")
    return "".join(line + "\n" for line in lines)


def track_line(moment: Moment) -> str:
    """One line for people."""
    place = f"{'-':>10} {'-':>10} {'-':>12}"
    if moment.pose is not None:
        p = moment.pose
        place = f"{p.x:>10.3f} {p.y:>10.3f} {math.degrees(p.theta):>12.2f}"
    mass = float(moment.belief.mass[0]) if len(moment.belief.mass) else 0.0
    verdict = ": ".join(filter(None, (moment.belief.verdict, moment.withheld)))
    head = f"{moment.index:>6} {moment.stamp:>14.3f}  {verdict:<22}"
    return f"{head} {place} {100 * mass:>7.1f}% {moment.metres:>9.2f}"


def track_header() -> str:
    """What stands above the lines of :func:`track_line`."""
    place = f"{'x / m':>10} {'y / m':>10} {'theta / deg':>12}"
    return f"{'index':>6} {'stamp':>14}  {'verdict':<22} {place} {'mass':>8} {'driven/m':>9}"


def draw_track(
    grid: OccupancyGrid, moments: Sequence[Moment], truth: FloatArray | None = None
) -> Picture:
    """Draw the path over the map, coloured by verdict; the true path (N, 3) is a thin line.

    It has a gap where the robot got farther than odometry knows: there it was carried.

    While several places fit or none does, the best guess is a small dot: it is not a path.
    """
    canvas = map_canvas(grid)
    back = inverse(grid.origin)
    if truth is not None and len(truth) > 1:
        carried = np.hypot(*np.diff(truth[:, :2], axis=0).T)
        carried -= 2 * np.diff([m.metres for m in moments])
        for part in np.split(truth, np.flatnonzero(carried > _CARRIED) + 1):
            canvas.lines(transform_points(back, part[:, :2])[None], TRUTH)
    size = marker_size(canvas)
    at = [
        (m, transform_points(back, np.array([[m.best.x, m.best.y]]))[0])
        for m in moments
        if m.best is not None
    ]
    for m, xy in at:
        radius = 0.3 * size if m.belief.verdict == UNIQUE else 0.2 * size
        canvas.dots(xy[None], COLOURS[m.belief.verdict], radius)
    for (m, xy), (n, next_xy) in itertools.pairwise(at):
        if m.belief.verdict == n.belief.verdict == UNIQUE and n.index == m.index + 1:
            step = np.hypot(*(next_xy - xy))
            if step < 3.0:
                canvas.lines(np.stack((xy, next_xy))[None], COLOURS[UNIQUE], 2)
    last = next((m for m in reversed(moments) if m.pose is not None), None)
    if last is not None and last.pose is not None:
        x, y = transform_points(back, np.array([[last.pose.x, last.pose.y]]))[0]
        theta = last.pose.theta - grid.origin.theta
        canvas.robot(x, y, theta, COLOURS[UNIQUE], size)
    scale_bar(canvas)
    counts = [sum(m.belief.verdict == name for m in moments) for name in COLOURS]
    words = [
        (COLOURS[name], f"{name}: {count} of {len(moments)}")
        for name, count in zip(COLOURS, counts, strict=True)
    ]
    if truth is not None:
        words.append((TRUTH, "true path"))
    return Picture(legend(canvas.image, words))


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
    """The belief over time as MP4, one frame a scan, written whole or not at all.

    Raises
    ------
    OutputError
        From :meth:`save`, if OpenCV here cannot write MP4, or the file cannot be written.
    """

    def __init__(self, features: MapFeatures) -> None:
        self._canvas = map_canvas(features.grid)
        scale = min(1.0, _SIDE / max(self._canvas.image.shape[:2]))
        height, width = (2 * max(1, round(scale * n / 2)) for n in self._canvas.image.shape[:2])
        self._size = width, height + LEGEND
        handle, self._path = tempfile.mkstemp(suffix=".mp4")
        os.close(handle)
        fourcc = cv2.VideoWriter.fourcc(*"mp4v")
        self._writer = cv2.VideoWriter(self._path, fourcc, 10.0, self._size)

    def add(self, moment: Moment) -> None:
        """Add the frame of a moment."""
        image = draw_belief(self._canvas, moment.belief)
        width, height = self._size
        small = cv2.resize(image, (width, height - LEGEND), interpolation=cv2.INTER_AREA)
        verdict = moment.belief.verdict
        words = f"{moment.stamp:.1f} s, {moment.metres:.1f} m: {verdict}"
        framed = legend(np.asarray(small, np.uint8), [(COLOURS[verdict], words)])
        self._writer.write(np.ascontiguousarray(framed[:, :width]))

    def save(self, path: PathLike, *, force: bool = False) -> None:
        """Write the file."""
        good = self._writer.isOpened()
        self._writer.release()
        data = Path(self._path).read_bytes()
        self.close()
        if not good or not data:
            raise OutputError(f"{display(path)}: OpenCV here cannot write MP4 videos")
        write_bytes_atomic(path, data, force=force)

    def close(self) -> None:
        """Drop what was drawn."""
        self._writer.release()
        Path(self._path).unlink(missing_ok=True)
