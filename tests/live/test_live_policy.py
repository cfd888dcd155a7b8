"""The policy of a first pose, without ROS: one that the belief is sure of, not too old, once."""

import math

import numpy as np
import pytest

from imgloc import Belief, ConfigError, Hypothesis, Localization, Moment, Pose2D, Protection
from imgloc.filters.belief import AMBIGUOUS, LOST, UNIQUE
from imgloc.live.policy import (
    CONFIRMED,
    GIVEN_UP,
    QUIET,
    TRYING,
    WAITING,
    FirstPose,
    LastPose,
    Rules,
    alone,
)

HERE = Pose2D(3.0, 2.0, 0.5)


def tried(first, stamp, pose, *, age=0.1, new=True):
    return first.believed(stamp, pose, stamp + age, new=new)


def test_a_pose_of_which_the_belief_is_sure_is_published_once() -> None:
    first = FirstPose()
    assert first.state == WAITING
    assert not tried(first, 10.0, None)
    assert first.state == TRYING
    assert tried(first, 10.5, HERE)
    assert first.state == CONFIRMED
    first.published()
    assert first.state == QUIET
    assert not tried(first, 11.0, HERE)


def test_one_scan_is_asked_alone_at_a_time_and_never_twice() -> None:
    first = FirstPose()
    assert first.due(10.0, None)
    assert not first.due(20.0, None)  # the first one is still looked at
    first.answered()
    assert not first.due(10.0, None)
    assert not first.due(9.0, None)
    assert first.due(10.5, None)


def test_driving_makes_a_scan_due_before_its_time() -> None:
    first = FirstPose(Rules(every=5.0, metres=0.3))
    assert first.due(10.0, Pose2D(0.0, 0.0))
    first.answered()
    assert not first.due(10.2, Pose2D(0.2, 0.0))
    assert first.due(10.3, Pose2D(0.31, 0.0))


@pytest.mark.parametrize("age", [2.1, -2.1, math.nan])
def test_an_answer_that_is_too_old_or_of_another_clock_is_not_published(age: float) -> None:
    first = FirstPose(Rules(max_age=2.0))
    assert not tried(first, 11.0, HERE, age=age)
    assert first.state == TRYING
    assert tried(first, 12.0, HERE)


def test_it_gives_up_after_what_is_new_and_starts_again_only_when_asked() -> None:
    first = FirstPose(Rules(tries=3))
    for k in range(50):  # a robot that stands and sees the same may wait as long as it likes
        assert not tried(first, 10.0 + k, None, new=False)
    assert (first.state, first.tries) == (TRYING, 0)
    for k in range(9):  # at most one try in 0.3 s
        assert not tried(first, 70.0 + 0.1 * k, None)
    assert first.state == GIVEN_UP
    assert not tried(first, 99.0, HERE)
    first.start()
    assert first.state == WAITING
    assert tried(first, 5.0, HERE)  # time may have begun anew


def test_rules_out_of_range_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"tries: got 1, expected"):
        Rules(tries=1)


def test_one_scan_alone_is_believed_only_if_it_is_very_sure() -> None:
    def answer(verdict: str, mass: float, metres: float) -> Localization:
        place = Hypothesis(HERE, -1.0, mass, np.eye(3))
        levels = (Protection(0.95, metres, 0.1),)
        return Localization((place,), verdict, 0.0, 0.8, protection=levels)

    assert alone(answer("unique", 0.9995, 0.3))
    assert not alone(answer("unique", 0.99, 0.3))
    assert not alone(answer("unique", 0.9995, 0.6))
    assert not alone(answer("ambiguous", 0.9995, 0.3))


def moment(stamp, verdict, *, x=0.0, here=0.0):
    """A robot at `x` of the map whose odometry is at `here`."""
    belief = Belief(np.zeros((1, 3)), np.ones(1), np.zeros((1, 3, 3)), 0.0, verdict, 1.0)
    at = {"best": Pose2D(x, 0.0), "map_odom": Pose2D(x - here, 0.0)}
    return Moment(0, stamp, 0.0, True, here, belief, "", covariance=np.zeros((3, 3)),
                  deviation=(0.1, 0.1), **at)  # fmt: skip


@pytest.mark.parametrize(
    ("then", "holds"),
    [
        (moment(11.9, AMBIGUOUS, x=3.2, here=3.0), True),
        (moment(12.1, AMBIGUOUS, x=3.2, here=3.0), False),  # too long ago
        (moment(11.0, AMBIGUOUS, x=3.8, here=3.0), False),  # not where the odometry led
        (moment(11.0, LOST, x=3.0, here=3.0), False),
        (moment(99.0, UNIQUE, x=9.0, here=3.0), True),
    ],
)
def test_a_sure_pose_holds_for_a_while_if_the_belief_stays_with_it(then, holds) -> None:
    last = LastPose()

    def take(one):
        return last.take(one, sure=one.belief.verdict == UNIQUE, longest=2.0)

    assert not take(moment(9.0, AMBIGUOUS))
    assert take(moment(10.0, UNIQUE))
    assert take(then) is holds
    assert take(moment(then.stamp + 0.1, AMBIGUOUS, x=then.best.x, here=3.0)) is holds
