"""What a robot is told of where it is, and how that is said to be: without ROS."""

import math
from dataclasses import replace

import numpy as np
import pytest
import yaml
from command import MAIN, ROOT, params_of, spawn, tree

from imgloc.filters.belief import Belief
from imgloc.filters.follow import STANDING, Moment
from imgloc.live.policy import FirstPose
from imgloc.live.settings import Rules, Settings
from imgloc.live.status import (
    ERROR,
    OK,
    STALE,
    WARN,
    Found,
    base_covariance,
    found_along,
    found_of,
    health,
    status_row,
)
from imgloc.model import Hypothesis, Localization, Pose2D, compose
from imgloc.ranges import declared

MOUNT = Pose2D(0.3, 0.1, math.pi / 2)
BASE = (Pose2D(2.0, 1.0, 0.5), Pose2D(7.0, 1.0, -2.5))
COVARIANCE = np.diag([0.01, 0.04, 0.001])
VDA = {"localized", "localizationScore", "deviationRange", "mapId", "x", "y", "theta"}


def answer(verdict):
    pairs = zip(BASE, (0.9, 0.1), strict=True)
    found = tuple(Hypothesis(compose(b, MOUNT), -1.0, mass, COVARIANCE) for b, mass in pairs)
    return Localization(found, verdict, 0.0, 0.8, T_base_laser=MOUNT)


def quiet():
    first = FirstPose()
    first.believed(10.0, BASE[0], 10.0)
    first.published()
    return first


def row(found, *, stands=True, first=None):
    return status_row(found, first or quiet(), now=12.0, stands=stands, dropped=3, said="well")


def test_a_pose_is_that_of_the_base_in_the_words_of_vda_5050() -> None:
    said = row(found_of(answer("unique"), 11.0, "hall"))
    assert list(said)[: len(VDA)] == [
        "localized", "localizationScore", "deviationRange", "mapId", "x", "y", "theta",
    ]  # fmt: skip
    assert (said["x"], said["y"], said["theta"]) == pytest.approx((2.0, 1.0, 0.5))
    assert (said["localized"], said["localizationScore"], said["mapId"]) == (True, 0.9, "hall")
    assert 5 < said["deviationRange"] < 6  # the other place, 5 m away, has more than 5 %
    assert said["alternatives"] == [pytest.approx({"x": 7.0, "y": 1.0, "theta": -2.5, "mass": 0.1})]
    assert (said["age"], said["dropped"], said["state"]) == (1.0, 3, "quiet")


@pytest.mark.parametrize(
    ("verdict", "stands", "score", "others"),
    [("unique", False, 0.9, 2), ("ambiguous", False, 0.9, 2), ("no-match", False, 0.0, 2)],
)
def test_no_pose_is_given_that_cannot_be_relied_upon(verdict, stands, score, others) -> None:
    said = row(found_of(answer(verdict), 11.0, "hall"), stands=stands)
    assert said["localized"] is False
    assert [said[key] for key in ("x", "y", "theta", "deviationRange")] == [None] * 4
    assert said["localizationScore"] == score
    assert len(said["alternatives"]) == others


def test_a_pose_that_holds_is_localized_and_else_the_reason_is_told() -> None:
    found = replace(found_of(answer("ambiguous"), 11.0, "hall"), why="wide")
    assert (row(found)["localized"], row(found)["withheld"]) == (True, "")
    said = row(found, stands=False)
    assert (said["localized"], said["withheld"]) == (False, "wide")


def test_before_the_first_answer_everything_is_there_and_empty() -> None:
    said = row(None, first=FirstPose())
    assert said.keys() >= VDA
    assert (said["localized"], said["verdict"], said["state"]) == (False, None, "waiting")


def test_the_covariance_of_the_base_has_the_lever_arm_of_the_sensor() -> None:
    found = base_covariance(np.diag([0.01, 0.01, 0.04]), Pose2D(0.0, 0.0), Pose2D(0.0, 3.0))
    assert found == pytest.approx(np.array([[0.37, 0, -0.12], [0, 0.01, 0], [-0.12, 0, 0.04]]))


def test_what_a_filter_believes_is_in_the_map_frame_and_lost_is_no_match() -> None:
    poses = np.array([[1.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    belief = Belief(poses, np.array([0.6, 0.3]), np.array([COVARIANCE] * 2), 0.1, "lost", 2.0)
    moment = Moment(0, 5.0, 0.0, True, 1.0, belief, "", Pose2D(0, 1), COVARIANCE, (0.2, 0.1), None)
    found = found_along(moment, Pose2D(0.0, 0.0, math.pi / 2), "hall")
    assert (found.poses[1].x, found.poses[1].y) == pytest.approx((0.0, 2.0))
    assert (found.verdict, found.pose, found.score) == ("no-match", None, 0.0)


@pytest.mark.parametrize(
    ("change", "level", "said"),
    [
        ({}, OK, "published"),
        ({"waits": "the map is being prepared"}, WARN, "prepared"),
        ({"silent": ["/scan"]}, STALE, "no scans on /scan"),
        ({"silent": ["/rear"], "alive": True}, WARN, "no scans on /rear"),
        ({"errors": ["map hall: no walls"], "silent": ["/scan"]}, ERROR, "no walls"),
        ({"first": FirstPose()}, WARN, "waiting: the last scan is unique"),
        ({"found": None, "first": FirstPose()}, WARN, "waiting: no answer yet"),
        ({"track": True, "found": Found(1.0, "hall", "ambiguous")}, WARN, "ambiguous"),
        ({"track": True}, WARN, "the last scan is unique"),
        ({"track": True, "stands": True}, OK, "the pose is unique"),
        (
            {"track": True, "found": Found(1.0, "hall", "ambiguous", why="blind")},
            WARN,
            "ambiguous: blind: it sees nothing",
        ),
        (
            {"first": FirstPose(), "found": Found(1, "a", "ambiguous", why=STANDING)},
            WARN,
            "has not moved",
        ),
    ],
)
def test_health_names_what_keeps_a_robot_from_its_pose(change, level, said) -> None:
    found = found_of(answer("unique"), 11.0, "hall")
    given = {"first": quiet(), "found": found, "silent": [], "alive": False, "errors": [],
             "waits": "", "track": False}  # fmt: skip
    first, last = ({**given, **change}.pop(key) for key in ("first", "found"))
    rest = {k: v for k, v in {**given, **change}.items() if k not in ("first", "found")}
    assert health(first, last, **rest)[0] == level
    assert said in health(first, last, **rest)[1]


def test_without_ros_one_error_says_what_to_install() -> None:
    run = spawn("node", "--sensor", "0,0,0", code=f"sys.modules['rclpy'] = None; {MAIN}")
    run.ends(2, "pip install 'imgloc[node]'", "source a ROS 2")
    assert run.err.count("\n") == 1


def test_the_command_has_the_defaults_of_the_node_and_so_has_the_file_of_parameters() -> None:
    settings = vars(Settings())
    said = {param.opts[0] for param in params_of(tree().commands["node"])}
    assert said >= {one.flag for one in declared(Settings) if one.option}
    file = ROOT / "tools" / "ros" / "imgloc_ros" / "config" / "imgloc.params.yaml"
    written = yaml.safe_load(file.read_text())["/**"]["ros__parameters"]
    assert {k: tuple(v) if isinstance(v, list) else v for k, v in written.items()} == {
        k: settings[k] for k in written
    }
    assert vars(Settings()).items() >= vars(Rules()).items()
