"""Odometry beside scans: poses between those recorded, and how fast the robot is."""

from collections import deque

import numpy as np

from imgloc.geometry import wrap
from imgloc.model import FloatArray
from imgloc.numbers import number

# Seconds between two poses that tell a velocity: the odometry's steps are fine enough, and the
# robot has not changed its mind.
_LEAST, _MOST = number("odometry.velocity")

_GAP = 1.0  # seconds that a scan may be from the nearest pose


def odometry_at(at: FloatArray, stamps: FloatArray, poses: FloatArray) -> FloatArray | None:
    """Poses (N, 3) at the times `at`, on straight lines between `poses` (M, 3) at `stamps` (M,).

    NaN where no pose is within a second, as when the odometry starts late; None if that is so
    everywhere.

    Examples
    --------
    >>> odometry_at(np.array([0.0, 7.9]), np.array([9.0, 9.5]), np.zeros((2, 3))) is None
    True
    >>> odometry_at(np.array([0.5]), np.array([0.0, 1.0]), np.array([[0, 0, 3.0], [2, 0, -3.0]]))
    array([[1.        , 0.        , 3.14159265]])
    """
    if not len(stamps):
        return None
    order = np.argsort(stamps, kind="stable")
    times, ordered = stamps[order], poses[order]
    after = np.clip(np.searchsorted(times, at), 1, max(len(times) - 1, 1)) % len(times)
    before = np.maximum(after - 1, 0)
    near = np.minimum(np.abs(at - times[before]), np.abs(at - times[after])) <= _GAP
    if not near.any():
        return None
    columns = [np.interp(at, times, ordered[:, k]) for k in (0, 1)]
    heading = np.interp(at, times, np.unwrap(ordered[:, 2]))
    found = np.stack([*columns, np.arctan2(np.sin(heading), np.cos(heading))], axis=1)
    return np.where(near[:, None], found, np.nan)


class Speedometer:
    """The velocity of a robot from its odometry, pose after pose, and from no later one.

    Examples
    --------
    >>> meter = Speedometer()
    >>> [meter.at(0.5 * k, np.array([k, 0.0, 0.0])).tolist() for k in range(2)]
    [[nan, nan, nan], [2.0, 0.0, 0.0]]
    """

    def __init__(self) -> None:
        self._past = deque[tuple[float, FloatArray]]()

    def at(self, stamp: float, pose: FloatArray) -> FloatArray:
        """Velocity (3,) at a stamp, seconds, in the robot's frame: m/s, m/s, rad/s.

        `pose` (3,) is that of the robot in the odometry's frame. The velocity is NaN at first, and
        after a gap.
        """
        past, velocity = self._past, np.full(3, np.nan)
        while len(past) > 1 and past[1][0] <= stamp - _LEAST:
            past.popleft()
        if past and _LEAST <= stamp - past[0][0] <= _MOST:
            before, seconds = past[0][1], stamp - past[0][0]
            turn = float(wrap(pose[2] - before[2]))
            middle = before[2] + turn / 2
            c, s = np.cos(middle), np.sin(middle)
            step = np.array([[c, s], [-s, c]]) @ (pose[:2] - before[:2])
            velocity = np.array([*step, turn]) / seconds
        past.append((stamp, np.array(pose, dtype=np.float64)))
        return velocity
