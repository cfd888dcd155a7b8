"""What a filter believes at one moment, whichever filter it is."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from imgloc.model import FloatArray, LaserScan

UNIQUE, AMBIGUOUS, LOST = VERDICTS = ("unique", "ambiguous", "lost")


@dataclass(frozen=True)
class Belief:
    """Where the sensor may be: places, best first, in the grid frame."""

    poses: FloatArray  #: (M, 3)
    mass: FloatArray  #: (M,) of each place; with `lost` they sum to at most 1
    covariance: FloatArray  #: (M, 3, 3)
    lost: float  #: probability of being at none of them
    verdict: str  #: ``unique``, ``ambiguous`` or ``lost``
    neff: float  #: effective number of components or particles
    resets: int = 0  #: how often places were put in from p(x | z)


NOWHERE = Belief(np.empty((0, 3)), np.empty(0), np.empty((0, 3, 3)), 1.0, LOST, 0.0)


class Filter(Protocol):
    """What :mod:`imgloc.tracking` drives along a log."""

    def move(self, increment: FloatArray) -> None:
        """Take a motion (3,) of the sensor, in its frame before."""

    def see(self, scan: LaserScan) -> None:
        """Take a scan."""

    def watch(self, scan: LaserScan) -> bool:
        """Whether a scan that would not be taken contradicts the belief, and should be."""

    def place(self, pose: FloatArray, deviation: tuple[float, float]) -> None:
        """Believe to be at a pose (3,), grid frame, with deviations in metres and radians."""

    @property
    def belief(self) -> Belief:
        """What is believed now."""
