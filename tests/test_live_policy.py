"""The policy of a first pose, without ROS: two agreeing scans, none too old, nothing twice."""

import math

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
    agree,
)
from imgloc.model import Pose2D, compose

HERE, ELSEWHERE = Pose2D(3.0, 2.0, 0.5), Pose2D(9.0, 2.0, 0.5)


def tried(first, stamp, pose, *, odom=None, map_="map", age=0.1):
    assert first.due(stamp, odom)
    return first.answered(Sighting(stamp, map_, pose, odom), stamp + age)


def test_two_scans_that_agree_confirm_and_then_it_is_quiet() -> None:
    first = FirstPose()
    assert first.state == WAITING
    assert not tried(first, 10.0, HERE)
    assert first.state == TRYING
    assert tried(first, 10.5, HERE)
    assert first.state == CONFIRMED
    first.published()
    assert first.state == QUIET
    assert not first.due(11.0, None)


def test_one_scan_is_looked_at_at_a_time_and_never_twice() -> None:
    first = FirstPose()
    assert first.due(10.0, None)
    assert not first.due(20.0, None)  # the first one is still looked at
    assert not first.answered(None, 20.0)  # it was dropped
    assert first.tries == 0
    assert not first.due(10.0, None)
    assert not first.due(9.0, None)
    assert first.due(10.5, None)


def test_driving_makes_a_scan_due_before_its_time() -> None:
    first = FirstPose(Rules(every=5.0, metres=0.3))
    tried(first, 10.0, None, odom=Pose2D(0.0, 0.0))
    assert not first.due(10.2, Pose2D(0.2, 0.0))
    assert first.due(10.3, Pose2D(0.31, 0.0))


def test_the_way_between_two_scans_is_that_of_the_odometry() -> None:
    step = Pose2D(2.0, 0.5, 1.0)
    start, end = Pose2D(7.0, 1.0, 2.0), compose(Pose2D(7.0, 1.0, 2.0), step)
    before = Sighting(1.0, "map", HERE, start)
    assert agree(before, Sighting(2.0, "map", compose(HERE, step), end))
    assert not agree(before, Sighting(2.0, "map", HERE, end))
    assert not agree(before, Sighting(2.0, "map", compose(HERE, step), None))


def test_angles_agree_across_the_seam() -> None:
    a, b = Pose2D(0.0, 0.0, math.pi - 0.01), Pose2D(0.0, 0.0, -math.pi + 0.01)
    assert agree(Sighting(1.0, "m", a, None), Sighting(2.0, "m", b, None))
    assert not agree(Sighting(1.0, "m", a, None), Sighting(2.0, "m", Pose2D(0, 0, 2.5), None))


@pytest.mark.parametrize("between", [ELSEWHERE, None])
def test_what_does_not_agree_begins_the_count_again(between: Pose2D | None) -> None:
    first = FirstPose()
    answers = [tried(first, 10.0 + k, pose) for k, pose in enumerate((HERE, between, HERE))]
    assert answers == [False, False, False]
    assert tried(first, 20.0, HERE)


def test_two_floors_never_agree() -> None:
    first = FirstPose()
    assert not tried(first, 10.0, HERE, map_="first floor")
    assert not tried(first, 11.0, HERE, map_="second floor")
    assert tried(first, 12.0, HERE, map_="second floor")


@pytest.mark.parametrize("age", [2.1, -2.1, math.nan])
def test_an_answer_that_is_too_old_or_of_another_clock_is_not_published(age: float) -> None:
    first = FirstPose(Rules(max_age=2.0))
    tried(first, 10.0, HERE)
    assert not tried(first, 11.0, HERE, age=age)
    assert first.state == TRYING
    assert tried(first, 12.0, HERE)


def test_it_gives_up_and_starts_again_only_when_asked() -> None:
    first = FirstPose(Rules(tries=3))
    for k in range(3):
        assert not tried(first, 10.0 + k, None)
    assert first.state == GIVEN_UP
    assert not first.due(99.0, None)
    first.start()
    assert first.state == WAITING
    assert not tried(first, 5.0, HERE)  # time may have begun anew
    assert tried(first, 6.0, HERE)


def test_an_answer_for_what_was_reset_in_between_is_not_taken() -> None:
    first = FirstPose()
    tried(first, 10.0, HERE)
    assert first.due(11.0, None)
    first.start()
    assert not first.answered(Sighting(11.0, "map", HERE, None), 11.1)
    assert first.state == WAITING
    assert first.tries == 0


def test_rules_out_of_range_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"tries: got 1, expected"):
        Rules(tries=1)


def test_a_blind_scan_counts_and_says_nothing_of_the_place() -> None:
    first = FirstPose(Rules(tries=3))
    for stamp, found in ((10.0, HERE), (10.5, None), (11.0, HERE)):
        assert first.due(stamp, None)
        sighting = Sighting(stamp, "map", found, None, blind=found is None)
        sure = first.answered(sighting, stamp)
    assert (sure, first.tries) == (True, 3)
    first.start()
    for stamp in (12.0, 12.5, 13.0):
        assert first.due(stamp, None)
        first.answered(Sighting(stamp, "map", None, None, blind=True), stamp)
    assert first.state == GIVEN_UP
