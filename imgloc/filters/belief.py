"""What a filter believes at one moment, whichever filter it is."""

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from imgloc.filters.motion import compose_poses, way_of
from imgloc.geometry import wrap
from imgloc.model import FloatArray, LaserScan, Pose2D
from imgloc.numbers import number
from imgloc.options import Options
from imgloc.search.hypotheses import separated

UNIQUE, AMBIGUOUS, LOST = VERDICTS = ("unique", "ambiguous", "lost")
STRANGE = number("belief.strange")
"""Misfit, nats per reading, that is taken for usual where nothing was seen yet."""
_HABIT = number("belief.habit")  # share of a scan in what is the usual misfit


@dataclass(frozen=True)
class Belief:
    """Where the robot may be: places, best first, in the grid frame."""

    poses: FloatArray  #: (M, 3)
    mass: FloatArray  #: (M,) of each place; with `lost` they sum to at most 1
    covariance: FloatArray  #: (M, 3, 3)
    lost: float  #: probability of being at none of them
    verdict: str  #: ``unique``, ``ambiguous`` or ``lost``
    neff: float  #: effective number of components or particles
    resets: int = 0  #: how often places were put in from p(x | z)


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
    """What :mod:`imgloc.filters.follow` drives along a log.

    The poses are those of the robot; of scans without a `T_base_laser`, of the sensor.
    """

    options: Options  #: with what is known by now of the scale of its scans

    def move(self, increment: FloatArray) -> None:
        """Take a motion (3,) of the robot, in its frame before."""

    def see(self, scan: LaserScan) -> None:
        """Take a scan."""

    def watch(self, scan: LaserScan) -> bool:
        """Correct the pose by a scan; True if it contradicts the belief and has to be taken."""

    def miss(self, seconds: float) -> None:
        """Take note of a scan that says nothing, so long after the one before."""

    def place(self, pose: FloatArray, deviation: tuple[float, float]) -> None:
        """Believe to be at a pose (3,), grid frame, with deviations in metres and radians."""

    @property
    def belief(self) -> Belief:
        """What is believed now."""


@dataclass
class Habit:
    """What a filter remembers of one laser of a robot: another one sees other walls."""

    #: metres and radians since the last scan that was taken
    way: FloatArray = field(default_factory=lambda: np.full(2, np.inf))
    usual: float = np.nan  #: misfit, in the long run
    last: float = np.nan  #: misfit of the last scan
    doubted: bool = False  #: it was much more than usual

    def expect(self, misfit: float) -> None:
        """Say what a scan is expected to lack, if nothing is known of that."""
        if np.isnan(self.usual):
            self.usual = self.last = misfit

    def learn(self, misfit: float) -> None:
        """Take the misfit of a scan."""
        self.expect(misfit)
        self.last, self.usual = misfit, self.usual + _HABIT * (misfit - self.usual)


class Habits:
    """A :class:`Habit` for each place at which a scan's laser sits."""

    def __init__(self) -> None:
        self._of: dict[Pose2D | None, Habit] = {}
        self._placed = False

    def of(self, scan: LaserScan) -> Habit:
        """That of the laser of a scan."""
        if scan.T_base_laser not in self._of:
            self._of[scan.T_base_laser] = Habit()
            if self._placed:
                self._of[scan.T_base_laser].expect(STRANGE)
        return self._of[scan.T_base_laser]

    @property
    def doubted(self) -> bool:
        """Whether what one of the lasers saw is doubted."""
        return any(habit.doubted for habit in self._of.values())

    def move(self, increment: FloatArray) -> None:
        """Take a motion (3,)."""
        for habit in self._of.values():
            habit.way = habit.way + way_of(increment)

    def place(self) -> None:
        """A place was told: scans are expected to fit there."""
        self._placed = True
        for habit in self._of.values():
            habit.expect(STRANGE)


PLACE = number("belief.place")
"""Poses nearer than this, metres and radians, are of one place."""
_PLACES = number("belief.places")


def belief_of(
    poses: FloatArray,
    mass: FloatArray,
    *,
    sure: float,
    lost: bool,
    doubted: bool,
    neff: float,
    resets: int,
) -> Belief:
    """The places of many weighted poses (N, 3), mass (N,), heaviest first.

    Parameters
    ----------
    sure : float
        Mass of the first place from which on it is ``unique``, unless it is `doubted`.
    lost : bool
        The best place does not explain what is seen.

    Examples
    --------
    >>> poses = np.array([[0, 0, 3.1], [0.1, 0, -3.1], [9, 9, 0.0]])
    >>> b = belief_of(poses, np.array([0.5, 0.3, 0.2]), sure=0.9, lost=False, doubted=False,
    ...               neff=3, resets=0)
    >>> b.verdict, b.mass.tolist(), b.poses.round(2).tolist()[0]
    ('ambiguous', [0.8, 0.2], [0.04, 0.0, 3.13])
    """
    picked, owner = separated(poses, _PLACES, distance=PLACE[0], angle=PLACE[1])
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
    verdict = LOST if lost or not len(order) else AMBIGUOUS
    if verdict == AMBIGUOUS and not doubted and shares[order[0]] >= sure:
        verdict = UNIQUE
    covariance = np.array(spreads).reshape(-1, 3, 3)[order]
    away = max(0.0, 1 - float(shares.sum()))
    return Belief(out, shares[order], covariance, away, verdict, neff, resets)


class Followed:
    """For how many metres the best place has been the same one, carried by odometry."""

    def __init__(self) -> None:
        self.metres = 0.0
        self._pose: FloatArray | None = None

    def move(self, increment: FloatArray) -> None:
        """Take a motion (3,)."""
        self.metres += float(np.hypot(*increment[:2]))
        if self._pose is not None:
            self._pose = compose_poses(self._pose, increment)

    def best(self, pose: FloatArray) -> None:
        """Say which pose (3,) is the best one now."""
        if self._pose is not None:
            apart = pose - self._pose
            if np.hypot(*apart[:2]) < PLACE[0] and abs(float(wrap(apart[2]))) < PLACE[1]:
                self._pose = pose
                return
        self._pose, self.metres = pose, 0.0
