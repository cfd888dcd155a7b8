"""When a robot is told its first pose: a small state machine, without ROS and without clocks.

========== =================================================== ====================================
state      what it waits for                                   what ends it
========== =================================================== ====================================
waiting    a map that is ready, and a scan                     the first scan: trying
trying     a scan each `every` s, or after `metres` of driving two unique answers that agree:
                                                               confirmed; `tries` answers: given up
confirmed  its pose to be published                            that it was: quiet
quiet      nothing: whoever was told the pose goes on from it  start(): waiting
given up   nothing: this place does not say where it is        start(): waiting
========== =================================================== ====================================

A new map, a reset and a request each call start().

>>> first, standing = FirstPose(), Pose2D(0.0, 0.0)
>>> first.due(10.0, standing)
True
>>> first.answered(Sighting(10.0, "map", Pose2D(3.0, 2.0), standing), now=10.2)
False
>>> first.due(10.1, standing), first.due(10.5, standing)
(False, True)
>>> first.answered(Sighting(10.5, "map", Pose2D(3.0, 2.1), standing), now=10.7), first.state
(True, 'confirmed')
"""

import math
from dataclasses import dataclass
from typing import Annotated

from imgloc.filters.belief import PLACE
from imgloc.model import Pose2D, compose, inverse
from imgloc.ranges import Checked, Within

WAITING, TRYING, CONFIRMED, QUIET, GIVEN_UP = (
    "waiting", "trying", "confirmed", "quiet", "given up",
)  # fmt: skip


@dataclass(frozen=True)
class Rules(Checked):
    """How often a first pose is tried, and what of it is published."""

    #: from one scan that is tried to the next
    every: Annotated[float, Within(0, 3600, "seconds")] = 0.3
    #: or so much driving, by odometry
    metres: Annotated[float, Within(0, 1000, "metres")] = 0.3
    #: until it is given up
    tries: Annotated[int, Within(2, 1_000_000, "answers")] = 100
    #: of a scan whose pose is published
    max_age: Annotated[float, Within(0.01, 3600, "seconds")] = 2.0


@dataclass(frozen=True)
class Sighting:
    """The answer for one scan."""

    stamp: float  #: of the scan, seconds
    map: str | None  #: its name
    pose: Pose2D | None  #: of the robot's base, map frame, if it is unique; None otherwise
    odom: Pose2D | None  #: of the robot's base in the frame of its odometry, if that is known
    blind: bool = False  #: the scan has too few readings to say anything of the place


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
        self._before: Sighting | None = None  # the last answer, if it was unique
        self._tried: tuple[float, Pose2D | None] | None = None  # stamp and odometry of the last try
        self._asked = False
        self._repeated = -math.inf  # time of the last repeated scan that counted as a try

    def due(self, stamp: float, odom: Pose2D | None) -> bool:
        """Whether a scan is to be looked at; :meth:`answered` has to follow then."""
        if self._asked or self.state not in (WAITING, TRYING):
            return False
        if self._tried is not None:
            waited, driven = stamp - self._tried[0], _apart(self._tried[1], odom)
            if waited <= 0 or (waited < self.rules.every and driven < self.rules.metres):
                return False
        self.state, self._asked, self._tried = TRYING, True, (stamp, odom)
        return True

    def answered(self, found: Sighting | None, now: float) -> bool:
        """Take the answer, or None if there is none; whether its pose is to be published.

        `now`, seconds, is the time that stamps are of.
        """
        self._asked = False
        if self.state != TRYING or found is None:
            return False
        self.tries += 1
        if self.fresh(found.stamp, now) and agree(self._before, found):
            self.state = CONFIRMED
            return True
        if not found.blind:  # such a scan neither confirms a place nor speaks against it
            self._before = found if found.pose is not None else None
        self._give_up()
        return False

    def repeated(self, now: float) -> None:
        """Count a scan that repeats the one before as a try, one in `every` seconds at most.

        `now` is in seconds.
        """
        if self._asked or self.state not in (WAITING, TRYING):
            return
        if abs(now - self._repeated) < self.rules.every:
            return
        self.state, self.tries, self._repeated = TRYING, self.tries + 1, now
        self._give_up()

    def _give_up(self) -> None:
        if self.tries >= self.rules.tries:
            self.state = GIVEN_UP

    def fresh(self, stamp: float, now: float) -> bool:
        """Whether a scan is young enough; one from the future, by another clock, is not."""
        return abs(now - stamp) <= self.rules.max_age

    def published(self) -> None:
        """Take note that the pose which was confirmed is out."""
        self.state = QUIET


def agree(before: Sighting | None, found: Sighting) -> bool:
    """Whether two unique answers, the one after the other, are of one place in one map.

    The robot's way between them is that of its odometry; without any it has hardly moved. How far
    they may be apart is what the filters take for one place.
    """
    if before is None or before.pose is None or found.pose is None or before.map != found.map:
        return False
    expected = before.pose
    if before.odom is not None and found.odom is not None:
        expected = compose(expected, compose(inverse(before.odom), found.odom))
    turned = math.remainder(found.pose.theta - expected.theta, math.tau)
    return bool(_apart(expected, found.pose) < PLACE[0] and abs(turned) < PLACE[1])


def _apart(a: Pose2D | None, b: Pose2D | None) -> float:
    """Metres between two poses; 0 if one of them is not known."""
    return 0.0 if a is None or b is None else math.hypot(b.x - a.x, b.y - a.y)
