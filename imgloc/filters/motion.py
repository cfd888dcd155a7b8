"""Motions by odometry and their errors: turn, go, turn.

An increment is the later pose in the frame of the earlier one, so that composing it with any pose
of the earlier time is exact. Its error has three parts. The four parameters have AMCL's names and
meaning (Thrun, Burgard and Fox, *Probabilistic Robotics*, table 5.6)::

    var(rot)   = alpha1 rot^2   + alpha2 trans^2
    var(trans) = alpha3 trans^2 + alpha4 (rot1^2 + rot2^2)
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from imgloc.geometry import wrap
from imgloc.model import FloatArray
from imgloc.numbers import number
from imgloc.options import Metres, Radians
from imgloc.ranges import Checked, Within

Alpha = Annotated[float, Within(0, 1e6, "a variance")]
# Metres and radians: a robot that has gone and turned less stands.
_STANDS: tuple[float, float] = number("follow.stands")


@dataclass(frozen=True)
class MotionNoise(Checked):
    """Errors of odometry; the square roots of the alphas are shares."""

    alpha1: Alpha = number("MotionNoise.alpha")[0]  #: rotation error from rotation
    alpha2: Alpha = number("MotionNoise.alpha")[1]  #: rotation error from translation, rad²/m²
    alpha3: Alpha = number("MotionNoise.alpha")[2]  #: translation error from translation
    alpha4: Alpha = number("MotionNoise.alpha")[3]  #: translation error from rotation, m²/rad²
    #: least standard deviations of a motion other than 0, metres and radians, because a share of a
    #: very short step is next to nothing
    floor: tuple[Metres, Radians] = number("MotionNoise.floor")

    def scaled(self, factor: float) -> "MotionNoise":
        """The noise with all variances multiplied by `factor`."""
        if factor == 1:
            return self
        some = {f"alpha{k}": factor * getattr(self, f"alpha{k}") for k in range(1, 5)}
        return MotionNoise(**some, floor=self.floor)


def compose_poses(a: FloatArray, b: FloatArray) -> FloatArray:
    """``a ⊕ b`` for poses (..., 3) that broadcast: `b` is in the frame of `a`. Theta is wrapped.

    Examples
    --------
    >>> compose_poses(np.array([[1, 0, np.pi / 2]]), np.array([1, 0, 0.0])).round(6).tolist()
    [[1.0, 1.0, 1.570796]]
    """
    a, b = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    x = a[..., 0] + c * b[..., 0] - s * b[..., 1]
    y = a[..., 1] + s * b[..., 0] + c * b[..., 1]
    return np.stack((x, y, wrap(a[..., 2] + b[..., 2])), axis=-1)


def invert_poses(a: FloatArray) -> FloatArray:
    """The poses (..., 3) that undo `a`."""
    a = np.asarray(a, dtype=np.float64)
    c, s = np.cos(a[..., 2]), np.sin(a[..., 2])
    x, y = -c * a[..., 0] - s * a[..., 1], s * a[..., 0] - c * a[..., 1]
    return np.stack((x, y, wrap(-a[..., 2])), axis=-1)


def increments(odom: FloatArray) -> FloatArray:
    """Motions (N - 1, 3) from each of the poses (N, 3) to the next, in the frame of the earlier.

    Examples
    --------
    >>> increments(np.array([[0, 0, np.pi / 2], [0, 2, np.pi / 2]])).round(6).tolist()
    [[2.0, 0.0, 0.0]]
    """
    return compose_poses(invert_poses(odom[:-1]), odom[1:])


def way_of(increment: FloatArray) -> FloatArray:
    """Metres and radians (2,) of a motion (3,), neither of them negative."""
    return np.array([np.hypot(increment[0], increment[1]), abs(wrap(increment[2]))])


def stands(step: FloatArray) -> bool:
    """Return whether a motion (3,) is that of a robot that stands."""
    return bool((way_of(step) < _STANDS).all())


class Way:
    """Counts the way of a robot, but not the trembling of its odometry while it stands.

    Examples
    --------
    >>> way = Way()
    >>> sum(way.gone(np.array([0.01 * (-1) ** k, 0.0, 0.0])) for k in range(1000)).tolist()
    [0.0, 0.0]
    >>> way.gone(np.array([0.3, 0.0, 0.0])).round(6).tolist()
    [0.3, 0.0]
    """

    def __init__(self) -> None:
        self._since = np.zeros(3)

    def gone(self, increment: FloatArray) -> FloatArray:
        """Metres and radians (2,) that a motion (3,) adds to the way: none while it stands."""
        self._since = compose_poses(self._since, increment)
        if stands(self._since):
            return np.zeros(2)
        gone, self._since = way_of(self._since), np.zeros(3)
        return gone


def turn_go_turn(increment: FloatArray) -> FloatArray:
    """First turn, distance and second turn (..., 3) of increments (..., 3): radians, m, radians.

    Examples
    --------
    >>> turn_go_turn(np.array([0.0, 2.0, 1.0])).round(4).tolist()
    [1.5708, 2.0, -0.5708]
    """
    increment = np.asarray(increment, dtype=np.float64)
    x, y, turn = np.moveaxis(increment, -1, 0)
    go = np.hypot(x, y)
    first = np.arctan2(y, x)
    return np.stack((first, go, wrap(turn - first)), axis=-1)


def deviations(increment: FloatArray, noise: MotionNoise) -> FloatArray:
    """Standard deviations (..., 3) of first turn, distance and second turn: radians, m, radians."""
    first, go, second = np.moveaxis(turn_go_turn(increment), -1, 0)
    still = go < MotionNoise.floor[0]  # the direction of so short a motion is noise
    first, second = np.where(still, 0.0, first), np.where(still, wrap(first + second), second)
    # Driving backwards is no half turn.
    first, second = (np.minimum(np.abs(r), np.pi - np.abs(r)) for r in (first, second))
    moved = np.any(np.asarray(increment) != 0, axis=-1)
    metres, radians = (np.where(moved, floor, 0.0) for floor in noise.floor)
    turns = [
        np.sqrt(noise.alpha1 * r**2 + noise.alpha2 * go**2 + radians**2) for r in (first, second)
    ]
    along = np.sqrt(noise.alpha3 * go**2 + noise.alpha4 * (first**2 + second**2) + metres**2)
    return np.stack((turns[0], along, turns[1]), axis=-1)


def sample_motion(
    poses: FloatArray, increment: FloatArray, noise: MotionNoise, rng: np.random.Generator
) -> FloatArray:
    """Move each of the poses (N, 3) by a draw of what the increment (3,) or (N, 3) may have been.

    Examples
    --------
    >>> still = MotionNoise(0, 0, 0, 0, (0, 0))
    >>> sample_motion(np.zeros((1, 3)), np.array([1, 1, 0.5]), still, np.random.default_rng(0))
    array([[1. , 1. , 0.5]])
    """
    spread = rng.standard_normal((len(poses), 3)) * deviations(increment, noise)
    first, go, second = np.moveaxis(turn_go_turn(increment) + spread, -1, 0)
    x, y = go * np.cos(first), go * np.sin(first)
    return compose_poses(poses, np.stack((x, y, first + second), axis=-1))


def move_gaussians(
    poses: FloatArray, covariance: FloatArray, increment: FloatArray, noise: MotionNoise,
    own: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """Means (M, 3) and covariances (M, 3, 3) of Gaussians after a motion (3,), to first order.

    `own` (3, 3) is the covariance of the motion in the earlier frame, by default that of `noise`.
    """
    first, go, _ = turn_go_turn(increment)
    c, s = np.cos(first), np.sin(first)
    G = np.array([[-go * s, c, 0.0], [go * c, s, 0.0], [1.0, 0.0, 1.0]])
    if own is None:
        own = G @ np.diag(deviations(increment, noise) ** 2) @ G.T
        own[[0, 1], [0, 1]] += noise.floor[0] ** 2 * bool(np.any(increment != 0))  # sideways slip
    moved = compose_poses(poses, increment)
    F, R = np.tile(np.eye(3), (2, len(poses), 1, 1))
    F[:, 0, 2], F[:, 1, 2] = -(moved[:, 1] - poses[:, 1]), moved[:, 0] - poses[:, 0]
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    R[:, 0, 0], R[:, 0, 1], R[:, 1, 0], R[:, 1, 1] = c, -s, s, c
    spread = F @ covariance @ F.transpose(0, 2, 1) + R @ own @ R.transpose(0, 2, 1)
    return moved, (spread + spread.transpose(0, 2, 1)) / 2


def noisy_odometry(poses: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Simulate the odometry (N, 3) of a robot that drives through the poses (N, 3).

    Its distances are 2 % too long, and it turns by 0.01 rad per metre too much; random errors
    come besides, 0.05 of each motion.
    """
    noise = MotionNoise(0.0025, 0.0025, 0.0025, 0.0025, (0.0, 0.0))
    steps = increments(poses)
    metres = np.hypot(steps[:, 0], steps[:, 1])
    steps[:, :2] *= 1.02
    steps[:, 2] += 0.01 * metres
    out = [np.zeros(3)]
    for step in sample_motion(np.zeros_like(steps), steps, noise, rng):
        out.append(compose_poses(out[-1], step))
    return np.array(out)
