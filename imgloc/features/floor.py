"""Readings that may end on the floor: a tilted laser meets it along a line.

A laser that is tilted by s radians at a height h above the floor meets it at h / s metres in the
direction of the tilt. All its readings there lie on a straight line across that direction, as if a
wall stood there. A laser whose plane is a cone meets the floor along a circle. Some readings pass
a wall at its end or through a door; none passes the floor. The wall of a closed room looks like a
floor. The map decides between them: see :func:`imgloc.pipeline.find_adapted_modes`.
"""

import math
from dataclasses import replace

import cv2
import numpy as np

from imgloc.model import FAR, BoolArray, Evidence, FloatArray, Floor, LaserScan
from imgloc.numbers import number
from imgloc.options import FusedOptions

_LEAST = number("floor.least")  # share of the valid readings that is worth looking at
_BEYOND = number("floor.beyond")  # share of the readings on the floor that may be beyond it
_NEAREST = number("floor.nearest")  # metres: what is nearer is no floor
_WIDTH = number("floor.width")  # metres from the line at most: floors are not even
_TURNS = round(math.tau / FusedOptions.theta_step)  # directions that are tried
_TOGETHER = 24  # directions at a time, so that their readings stay in the cache
_BINS = 512  # of distances; what is farther is in the last one


def left_out(scan: LaserScan, floor: Floor | None) -> LaserScan:
    """The scan without its readings on a floor."""
    if floor is None:
        return scan
    return replace(scan, ranges=np.where(_on(scan, floor), np.nan, scan.ranges))


def as_located(scan: LaserScan, evidence: Evidence) -> LaserScan:
    """The readings with which a scan was located: without a floor, and scaled."""
    return left_out(scan, evidence.floor).scaled(evidence.scale)


def on_floor(
    ranges: FloatArray, angles: FloatArray, floor: Floor, width: float = _WIDTH
) -> BoolArray:
    """Which readings (N,), metres and radians, end within a `width` of a floor, metres."""
    return np.asarray(np.abs(_depth(ranges, angles, floor) - floor.distance) <= width)


def _on(scan: LaserScan, floor: Floor, width: float = _WIDTH) -> BoolArray:
    """Which readings (N,) of a scan are valid and end on a floor."""
    return np.asarray(scan.valid & on_floor(scan.ranges, scan.angles, floor, width))


def _depth(ranges: FloatArray, angles: FloatArray, floor: Floor) -> FloatArray:
    """Reach of readings in the direction of a floor, metres."""
    is_circle = math.isnan(floor.direction)
    return np.asarray(ranges * (1 if is_circle else np.cos(angles - floor.direction)))


def floors(scan: LaserScan) -> list[Floor]:
    """Find what may be the floor in a scan: at most a line and a circle.

    A Hough transform counts the readings on each line, and those beyond it.

    Parameters
    ----------
    scan : LaserScan
        A ray without a return counts as a reading at `range_max`.

    Returns
    -------
    list of Floor
        Those with a tenth of the valid readings, at 2 m or farther, and hardly any beyond.

    Examples
    --------
    A room of 12 m by 8 m, and the floor 3 m ahead:

    >>> angles = np.deg2rad(np.arange(-180.0, 180.0))
    >>> c, s = np.cos(angles), np.sin(angles)
    >>> room = np.minimum(6 / np.maximum(abs(c), 1e-9), 4 / np.maximum(abs(s), 1e-9))
    >>> floor = np.where(c > 0.1, 3 / np.maximum(c, 0.1), np.inf)
    >>> found = floors(LaserScan(np.minimum(room, floor), angles, range_max=20.0))[0]
    >>> round(found.distance, 2), abs(round(found.direction, 2)), round(found.share, 2)
    (3.0, 0.0, 0.3)
    """
    seen, angles = scan.valid, scan.angles
    if not seen.any():
        return []
    beyond = np.where(scan.no_return, min(scan.range_max, FAR), 0.0)
    reach = np.where(seen, scan.ranges, beyond)
    turns = np.arange(_TURNS) * (2 * np.pi / _TURNS)
    found = []
    x, y = reach * np.cos(angles), reach * np.sin(angles)
    line = _last_shared(np.cos(turns), np.sin(turns), x, y, seen)
    if line is not None:
        floor = Floor(line[1], float(turns[line[0]]), 0.0)
        for _ in range(2):  # the true direction is between two of those that are tried
            on = _on(scan, floor, 2 * _WIDTH)
            if np.count_nonzero(on) > 1:
                floor = Floor(*_line_through(reach[on], angles[on]), 0.0)
        found.append(floor)
    circle = _last_shared(np.ones(1), np.zeros(1), reach, y, seen)
    if circle is not None:
        floor = Floor(circle[1], math.nan, 0.0)
        on = _on(scan, floor, 2 * _WIDTH)
        found.append(replace(floor, distance=float(np.median(reach[on]))) if on.any() else floor)
    kept = []
    for floor in found:  # it has moved since it was counted
        depth = _depth(reach, angles, floor)
        many = int(np.count_nonzero(_on(scan, floor)))
        farther = int(np.count_nonzero(depth > floor.distance + 2 * _WIDTH))
        if floor.distance >= _NEAREST and farther <= _BEYOND * many:
            kept.append(replace(floor, share=many / int(np.count_nonzero(seen))))
    return [floor for floor in kept if floor.share >= _LEAST]


def _line_through(ranges: FloatArray, angles: FloatArray) -> tuple[float, float]:
    """Distance, metres, and direction, radians, of the line through readings."""
    xy = np.stack((ranges * np.cos(angles), ranges * np.sin(angles)), axis=1).astype(np.float32)
    u, v, x, y = cv2.fitLine(xy, cv2.DIST_HUBER, 0, 0.01, 0.001).ravel().tolist()
    distance = x * v - y * u
    return abs(distance), math.atan2(-u, v) if distance > 0 else math.atan2(u, -v)


def _last_shared(
    u: FloatArray, v: FloatArray, x: FloatArray, y: FloatArray, seen: BoolArray
) -> tuple[int, float] | None:
    """Index k, and the depth ``u[k] x + v[k] y`` that most readings share, hardly any beyond it.

    `u` and `v` are (K,), `x` and `y` (N,) metres. `seen` (N,) are the readings; the others are rays
    without one.
    """
    most, found = 0, None
    for start in range(0, len(u), _TOGETHER):
        bins = u[start : start + _TOGETHER, None] * x + v[start : start + _TOGETHER, None] * y
        bins /= _WIDTH
        np.clip(np.ceil(bins, out=bins), 0, _BINS - 1, out=bins)
        bins += _BINS * np.arange(len(bins))[:, None]
        index, size = bins.astype(np.intp), len(bins) * _BINS
        mine, rest = (np.bincount(index[:, k].ravel(), minlength=size) for k in (seen, ~seen))
        every, mine = (count.reshape(-1, _BINS) for count in (mine + rest, mine))
        on = mine[:, :-3] + mine[:, 1:-2]
        beyond = np.cumsum(every[:, :2:-1], axis=1)[:, ::-1]
        on *= (on >= _LEAST * np.count_nonzero(seen)) & (beyond <= _BEYOND * on)
        on[:, : math.ceil(_NEAREST / _WIDTH)] = 0
        row, column = np.unravel_index(int(np.argmax(on)), on.shape)
        if on[row, column] > most:
            most, found = on[row, column], (start + int(row), float(column * _WIDTH))
    return found
