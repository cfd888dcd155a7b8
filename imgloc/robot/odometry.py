"""The odometry of a robot: poses over time, interpolated between two of them.

A pose is never held: at a metre a second the last pose of a moment ago is wrong by as much.
"""

import math
from bisect import bisect_left, bisect_right
from collections.abc import Iterable

import numpy as np

from imgloc.geometry import wrap
from imgloc.model import FloatArray
from imgloc.numbers import number
from imgloc.robot.frames import GAP

# Seconds between two poses that tell a velocity: the odometry's steps are fine enough, and the
# robot has not changed its mind.
_LEAST, _MOST = number("odometry.velocity")
_END = 0.1  # seconds by which a whole log may be prolonged


class Odometry:
    """A buffer of poses in the order of time.

    Parameters
    ----------
    stamps : iterable of float
        Seconds, in any order.
    poses : iterable of (3,) arrays
        Of the robot in the odometry's frame: metres, metres, radians.
    most : int
        Poses that are kept, the latest.

    Examples
    --------
    >>> odometry = Odometry([0.0, 1.0], [[0, 0, 3.0], [2, 0, -3.0]])
    >>> odometry.at(0.5).round(3).tolist(), odometry.at(1.1)
    ([1.0, 0.0, 3.142], None)
    >>> odometry.waits(1.1), odometry.add(1.2, [2.0, 0.0, -3.0]), odometry.waits(1.1)
    (True, True, False)
    """

    def __init__(
        self,
        stamps: Iterable[float] = (),
        poses: Iterable[FloatArray] = (),
        most: int = 1_000_000_000,
    ) -> None:
        times, rows = np.array(list(stamps), float), np.array(list(poses), float).reshape(-1, 3)
        known = np.isfinite(times) & np.isfinite(rows).all(axis=1)
        order = np.argsort(times[known], kind="stable")
        self._stamps: list[float] = times[known][order].tolist()
        self._poses: list[list[float]] = rows[known][order].tolist()
        self._most = most

    def __len__(self) -> int:
        return len(self._stamps)

    @property
    def last(self) -> float:
        """Stamp of the latest pose, seconds; -inf without any."""
        return self._stamps[-1] if self._stamps else -np.inf

    def add(self, stamp: float, pose: Iterable[float]) -> bool:
        """Take a pose (3,); return whether it was finite."""
        row = [float(value) for value in pose]
        if not np.isfinite([stamp, *row]).all():
            return False
        k = bisect_right(self._stamps, stamp)
        if k and self._stamps[k - 1] == stamp:
            self._poses[k - 1] = row
            return True
        self._stamps.insert(k, stamp)
        self._poses.insert(k, row)
        if len(self._stamps) > self._most:
            del self._stamps[0], self._poses[0]
        return True

    def clear(self) -> None:
        """Forget all poses, because time begins anew."""
        self._stamps, self._poses = [], []

    def waits(self, stamp: float) -> bool:
        """Return whether the next pose may still show where the robot was at a time."""
        return stamp > self.last

    def at(self, stamp: float) -> FloatArray | None:
        """Pose (3,) at a time, on a straight line between two poses at most :data:`GAP` away.

        None if it is not known: before the first pose, after the last one, in a gap.
        """
        k = bisect_left(self._stamps, stamp)
        if k < len(self._stamps) and self._stamps[k] == stamp:
            return np.array(self._poses[k])
        if not 0 < k < len(self._stamps):
            return None
        if max(stamp - self._stamps[k - 1], self._stamps[k] - stamp) > GAP:
            return None
        return self._on_line(k, stamp)

    def lately(self, stamp: float) -> FloatArray | None:
        """Pose (3,) at a time, or the last one, which may be :data:`GAP` older; else None."""
        return self.at(min(stamp, self.last)) if stamp <= self.last + GAP else None

    def _on_line(self, k: int, stamp: float) -> FloatArray:
        """Pose (3,) at a time on the line through the poses k - 1 and k."""
        before, after = self._stamps[k - 1], self._stamps[k]
        a, b = np.array(self._poses[k - 1]), np.array(self._poses[k])
        step = b - a
        step[2] = wrap(step[2])
        out = a + (stamp - before) / (after - before) * step
        out[2] = wrap(out[2])
        return np.asarray(out)

    def _beyond(self, stamp: float) -> FloatArray | None:
        """Pose (3,) shortly before the first pose or after the last one, as the robot drives."""
        if len(self) < 2 or math.isnan(stamp):
            return None
        k = 1 if stamp < self._stamps[0] else len(self) - 1
        off = max(self._stamps[0] - stamp, stamp - self.last)
        step = self._stamps[k] - self._stamps[k - 1]
        return self._on_line(k, stamp) if off <= min(step, _END) else None

    def along(self, stamps: FloatArray) -> FloatArray | None:
        """Poses (N, 3) at the times of scans, NaN where they are not known; None if none is.

        A log that begins or ends with a scan is prolonged by a step, as the robot drives.
        """
        found = [
            pose if (pose := self.at(stamp)) is not None or 0 < bisect_left(self._stamps, stamp)
            < len(self) else self._beyond(stamp) for stamp in stamps.tolist()
        ]  # fmt: skip
        if all(pose is None for pose in found):
            return None
        return np.array([np.full(3, np.nan) if pose is None else pose for pose in found])


def velocities_at(stamps: FloatArray, poses: FloatArray) -> FloatArray:
    """Velocities (N, 3) of a robot in its own frame at its poses (N, 3): m/s, m/s, rad/s.

    Each is that of the way from a pose shortly before; NaN at first, and after a gap.

    Examples
    --------
    >>> velocities_at(np.array([0.0, 0.5]), np.array([[0, 0, 0.0], [1, 0, 0]])).tolist()
    [[nan, nan, nan], [2.0, 0.0, 0.0]]
    """
    order = np.argsort(stamps, kind="stable")
    t, (x, y, theta) = stamps[order], poses[order].T
    before = np.searchsorted(t, t - _LEAST, side="right") - 1
    seconds = t - t[before]
    turn = wrap(theta - theta[before])
    dx, dy, middle = x - x[before], y - y[before], theta[before] + turn / 2
    c, s = np.cos(middle), np.sin(middle)
    steps = np.stack((c * dx + s * dy, c * dy - s * dx, turn), axis=1)
    known = (before >= 0) & (seconds >= _LEAST) & (seconds <= _MOST)
    out = np.full_like(steps, np.nan)
    out[order[known]] = steps[known] / seconds[known, None]
    return out
