"""Odometry beside scans: poses between those recorded, and how fast the robot is."""

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
