"""The belief of a filter at one moment, and the interface that all filters have."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from imgloc.filters.motion import compose_poses
from imgloc.geometry import pose_errors, wrap
from imgloc.model import FloatArray, LaserScan, Pose2D
from imgloc.options import FusedOptions, Options
from imgloc.search.hypotheses import separated
from imgloc.search.weigh import MODES

UNIQUE, AMBIGUOUS, LOST = VERDICTS = ("unique", "ambiguous", "lost")


@dataclass(frozen=True)
class Belief:
    """Where the robot may be: places, best first, in the grid frame."""

    poses: FloatArray  #: (M, 3) metres, metres, radians
    mass: FloatArray  #: (M,) probability of each place; with `lost` they sum to at most 1
    covariance: FloatArray  #: (M, 3, 3) m², m rad and rad²
    lost: float  #: probability that the robot is at none of them
    verdict: str  #: ``unique``, ``ambiguous`` or ``lost``
    neff: float  #: effective number of components or particles
    resets: int = 0  #: number of times that the filter added places from p(x | z)


NOWHERE = Belief(np.empty((0, 3)), np.empty(0), np.empty((0, 3, 3)), 1.0, LOST, 0.0)


def deviations_of(covariance: FloatArray) -> tuple[float, float]:
    """Standard deviations of a covariance (3, 3): metres along its longest axis, and radians.

    Examples
    --------
    >>> deviations_of(np.diag([0.04, 0.09, 0.01]))
    (0.3, 0.1)
    """
    metres = np.linalg.eigvalsh(covariance[:2, :2])[-1]
    return float(np.sqrt(max(0.0, metres))), float(np.sqrt(max(0.0, covariance[2, 2])))


class Filter(Protocol):
    """The interface of a filter, which :mod:`imgloc.filters.follow` drives along a log.

    Poses are the robot's in the grid frame. If scans have no `T_base_laser`, poses are the
    sensor's.
    """

    options: Options  #: options of the search, with the scale of the scans as estimated so far
    unsure: str  #: why no pose is ever ``unique`` on this map; empty if one may be

    def move(
        self, increment: FloatArray, covariance: FloatArray | None = None, *, known: bool = True
    ) -> None:
        """Move the belief by a motion (3,), in the robot's earlier frame: m, m, radians.

        `covariance` (3, 3) is that of the motion, by default that of a robot's odometry. A way that
        is not `known` confirms no place.
        """

    def see(self, scan: LaserScan) -> None:
        """Weigh the whole belief by a scan."""

    def watch(self, scan: LaserScan) -> bool:
        """Correct the best pose by a scan; True if it contradicts the belief: then `see` it."""

    def miss(self, seconds: float) -> None:
        """Note a blind scan, `seconds` after the scan before it."""

    def place(self, pose: FloatArray, deviation: tuple[float, float]) -> None:
        """Start at a pose (3,), grid frame, with standard deviations in metres and radians."""

    @property
    def belief(self) -> Belief:
        """The belief now."""


PLACE = FusedOptions.separation
"""Poses nearer than this, metres and radians, belong to one place."""


def one_place(a: Pose2D, b: Pose2D) -> bool:
    """Return whether two poses of one frame belong to one place."""
    return bool((pose_errors(np.array([*a]), b) < PLACE).all())


def belief_of(
    poses: FloatArray,
    mass: FloatArray,
    *,
    sure: float,
    doubted: bool,
    neff: float,
    resets: int,
) -> Belief:
    """Join many weighted poses into places, the heaviest first.

    Parameters
    ----------
    poses : (N, 3) float array
        Grid frame: metres, metres, radians.
    mass : (N,) float array
        Probability of each pose.
    sure : float
        Mass, 0..1, from which the first place is ``unique``, unless it is `doubted`.
    doubted : bool
        Whether the best place fits much worse than usual.
    neff : float
        Effective number of poses, for the record.
    resets : int
        Number of times that the filter added places from p(x | z), for the record.

    Examples
    --------
    >>> poses = np.array([[0, 0, 3.1], [0.1, 0, -3.1], [9, 9, 0.0]])
    >>> b = belief_of(poses, np.array([0.5, 0.3, 0.2]), sure=0.9, doubted=False,
    ...               neff=3, resets=0)
    >>> b.verdict, b.mass.tolist(), b.poses.round(2).tolist()[0]
    ('ambiguous', [0.8, 0.2], [0.04, 0.0, 3.13])
    """
    picked, owner = separated(poses, MODES, distance=PLACE[0], angle=PLACE[1])
    means, spreads, masses = [], [], []
    for place, first in enumerate(picked):
        mine = owner == place
        weight = mass[mine] / max(1e-300, mass[mine].sum())
        apart = poses[mine] - poses[first]
        apart[:, 2] = wrap(apart[:, 2])
        mean = weight @ apart
        rest = apart - mean
        means.append(poses[first] + mean)
        spreads.append((rest * weight[:, None]).T @ rest + np.diag([1e-4, 1e-4, 1e-5]))
        masses.append(mass[mine].sum())
    shares = np.array(masses)
    order = np.argsort(-shares, kind="stable")
    out = np.array(means).reshape(-1, 3)[order]
    out[:, 2] = wrap(out[:, 2])
    verdict = AMBIGUOUS if len(order) else LOST
    if verdict == AMBIGUOUS and not doubted and shares[order[0]] >= sure:
        verdict = UNIQUE
    covariance = np.array(spreads).reshape(-1, 3, 3)[order]
    away = max(0.0, 1 - float(shares.sum()))
    return Belief(out, shares[order], covariance, away, verdict, neff, resets)


class Followed:
    """Counts the metres for which odometry has carried one best place."""

    def __init__(self) -> None:
        self.metres = 0.0
        self._pose: FloatArray | None = None

    def move(self, increment: FloatArray) -> None:
        """Move the best place by a motion (3,): metres, metres, radians."""
        self.metres += float(np.hypot(*increment[:2]))
        if self._pose is not None:
            self._pose = compose_poses(self._pose, increment)

    def best(self, pose: FloatArray) -> None:
        """Set the best pose (3,), grid frame; another place starts the count again."""
        if self._pose is None or not (pose_errors(pose, self._pose) < PLACE).all():
            self.metres = 0.0
        self._pose = pose
