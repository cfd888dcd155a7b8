"""Decides when to publish the first pose: a small state machine, without ROS and without clocks.

========== =============================================== ========================================
state      what it waits for                               what ends it
========== =============================================== ========================================
waiting    a map that is ready, and a scan                 the first scan: trying
trying     a pose of which the belief is sure              it is there: confirmed; `tries`: given up
confirmed  its pose to be published                        that it was: quiet
quiet      nothing: whoever was told the pose goes on      start(): waiting
given up   nothing: this place is like others              start(): waiting
========== =============================================== ========================================

A new map, a reset and a request each call start(). The belief is that of a filter, so a place is
confirmed by scans along a way: the same scan, asked again, is no second witness.

>>> first = FirstPose()
>>> first.believed(10.0, None, 10.2), first.state, first.tries
(False, 'trying', 1)
>>> first.believed(10.5, Pose2D(3.0, 2.1), 10.7), first.state
(True, 'confirmed')

Which of several maps it is, or where a robot stands, one scan alone is asked: a scan each `every` s
or after `metres` of driving is due.

>>> standing, first = Pose2D(0.0, 0.0), FirstPose()
>>> first.due(10.0, standing), first.due(10.5, standing)
(True, False)
>>> first.answered()
>>> first.due(10.1, standing), first.due(10.5, standing)
(False, True)
"""

import math

from imgloc.filters.belief import LOST, PLACE, one_place
from imgloc.filters.follow import Moment
from imgloc.filters.tracker import TrackerOptions
from imgloc.live.settings import Rules
from imgloc.model import Localization, Pose2D, compose, inverse

WAITING, TRYING, CONFIRMED, QUIET, GIVEN_UP = (
    "waiting", "trying", "confirmed", "quiet", "given up",
)  # fmt: skip
_, _SUREST = TrackerOptions.mass


class FirstPose:
    """The state, and what a scan or an answer makes of it.

    Parameters
    ----------
    rules : Rules, optional
    """

    def __init__(self, rules: Rules | None = None) -> None:
        self.rules = rules or Rules()
        self.start()

    def start(self) -> None:
        """Know nothing: another map, a reset, or someone asks again."""
        self.state, self.tries = WAITING, 0
        self._asked: tuple[float, Pose2D | None] | None = None  # stamp and odometry, alone
        self._open = False  # whether the answer to it has not come
        self._counted = -math.inf  # stamp of the last try

    @property
    def wanted(self) -> bool:
        """True if a first pose is looked for."""
        return self.state in (WAITING, TRYING)

    def believed(self, stamp: float, pose: Pose2D | None, now: float, *, new: bool = True) -> bool:
        """Take what is believed after a scan; whether its pose is to be published.

        `pose` is that of the robot's base, map frame, if the belief is sure of it; `stamp` and
        `now` are seconds of one clock. `new`: the scan showed something new, or that it sees
        nothing.
        """
        if not self.wanted:
            return False
        self.state = TRYING
        if pose is not None and self.fresh(stamp, now):
            self.state = CONFIRMED
            return True
        if new and abs(stamp - self._counted) >= self.rules.every:
            self.tries, self._counted = self.tries + 1, stamp
        if self.tries >= self.rules.tries:
            self.state = GIVEN_UP
        return False

    def due(self, stamp: float, odom: Pose2D | None) -> bool:
        """Return whether a scan is to be asked alone; :meth:`answered` has to follow then."""
        if self._open or not self.wanted:
            return False
        if self._asked is not None:
            waited, driven = stamp - self._asked[0], _apart(self._asked[1], odom)
            if waited <= 0 or (waited < self.rules.every and driven < self.rules.metres):
                return False
        self._open, self._asked = True, (stamp, odom)
        return True

    def answered(self) -> None:
        """Take note that what was due has an answer, or will have none."""
        self._open = False

    def fresh(self, stamp: float, now: float) -> bool:
        """Return whether a scan is young enough; one from the future, by another clock, is not."""
        return abs(now - stamp) <= self.rules.max_age

    def published(self) -> None:
        """Take note that the pose which was confirmed is out."""
        self.state = QUIET


class LastPose:
    """Decides whether a pose holds: the last sure one does, though a scan does not confirm it.

    It does for so many seconds, while the belief stays where the odometry has carried it.
    """

    def __init__(self) -> None:
        self._at: tuple[float, Pose2D] | None = None  # stamp and map_odom of the last sure pose

    def take(self, moment: Moment, *, sure: bool, longest: float) -> bool:
        """Take what is believed after a scan, and whether its pose is `sure`; `longest` in s."""
        if sure:
            self._at = None if moment.map_odom is None else (moment.stamp, moment.map_odom)
        elif self._at is not None and not self._holds(moment, longest):
            self._at = None
        return sure or self._at is not None

    def _holds(self, moment: Moment, longest: float) -> bool:
        if self._at is None or moment.map_odom is None or moment.best is None:
            return False
        stamp, before = self._at
        odom = compose(inverse(moment.map_odom), moment.best)
        young = moment.belief.verdict != LOST and moment.stamp - stamp <= longest
        return young and one_place(compose(before, odom), moment.best)


def alone(answer: Localization) -> bool:
    """Return whether one scan is so sure of a place that a robot which stands may be told it."""
    sure = answer.verdict == "unique" and answer.hypotheses[0].mass >= _SUREST
    return sure and bool(answer.protection) and answer.protection[0].metres < PLACE[0]


def _apart(a: Pose2D | None, b: Pose2D | None) -> float:
    """Metres between two poses; 0 if one of them is not known."""
    return 0.0 if a is None or b is None else math.hypot(a.x - b.x, a.y - b.y)
