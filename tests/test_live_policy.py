"""The policy of a first pose, without ROS: one that the belief is sure of, not too old, once."""

import math

import numpy as np
import pytest

from imgloc.errors import ConfigError
from imgloc.live.policy import (
    CONFIRMED,
    GIVEN_UP,
    QUIET,
    TRYING,
    WAITING,
    FirstPose,
    Rules,
    Sighting,
    alone,
)
from imgloc.model import Hypothesis, Localization, Pose2D, Protection

HERE = Pose2D(3.0, 2.0, 0.5)


def tried(first, stamp, pose, *, age=0.1, new=True):
    return first.believed(Sighting(stamp, pose, new), stamp + age)


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
