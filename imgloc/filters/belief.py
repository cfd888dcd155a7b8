"""The belief of a filter at one moment, and the interface that all filters have."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from imgloc.geometry import pose_errors
from imgloc.model import FloatArray, LaserScan, Pose2D
from imgloc.numbers import number
from imgloc.options import Options

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


PLACE = number("belief.place")
"""Poses nearer than this, metres and radians, belong to one place."""


def one_place(a: Pose2D, b: Pose2D) -> bool:
    """Return whether two poses of one frame belong to one place."""
    return bool((pose_errors(np.array([*a]), b) < PLACE).all())
