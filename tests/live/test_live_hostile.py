"""What others may send to `imgloc node`: it says what is wrong, and goes on."""

import array
import math
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from command import MAPS, call

import imgloc
from imgloc import ConfigError, Localizer, Options, Sensor, simulate
from imgloc.live.check import Ear
from imgloc.live.node import LocalizerNode, load_ros, with_parameters
from imgloc.live.settings import Settings
from imgloc.live.status import ERROR, Found, weighed
from imgloc.options import RADIUS, TOLERANCE, Hint
from imgloc.ranges import declared

pytest.importorskip("rclpy", reason="no ROS 2 here: source one, or pip install 'imgloc[node]'")
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of what rclpy imports

NAN, INF = math.nan, math.inf
GRID = imgloc.load_map(MAPS / "curved.yaml")
RESOLUTION = float(GRID.resolution)


class Heard:
    """A node in this process, to which messages are handed as rclpy does."""

    def __init__(self, **settings: Any) -> None:
        self.ros = load_ros()
        self.ros.rclpy.init(args=[])
        self.rclpy = self.ros.rclpy.create_node("imgloc")
        self.core = Localizer({}, Options(), background=True)
        known = {"sensor": (0.0, 0.0, 0.0), "track": True, "max_age": 60.0, "every": 0.05}
        self.node = LocalizerNode(
            self.ros, self.rclpy, Settings(**known | settings), self.core, from_topic=True
        )
        self.executor = self.ros.executors.SingleThreadedExecutor()
        self.executor.add_node(self.rclpy)

    def send(self, topic: str, message: Any) -> None:
        (heard,) = [s.callback for s in self.rclpy.subscriptions if s.topic_name == f"/{topic}"]
        heard(message)

    def until(self, there: Callable[[], object]) -> None:
        end = time.monotonic() + 60
        while not there():
            assert time.monotonic() < end, self.node._health()
            self.executor.spin_once(timeout_sec=0.1)  # an error of a callback comes out here

    def prepare(self, **changed: Any) -> None:
        """Send a map and wait until it is ready."""
        self.send("map", self.map(**changed))
        self.until(lambda: self.core.ready)

    def close(self) -> None:
        self.node.close()
        self.executor.remove_node(self.rclpy)
        self.core.close()
        self.rclpy.destroy_node()
        self.ros.rclpy.try_shutdown()

    def stamped(self, message: Any, frame: str) -> Any:
        message.header.stamp = self.rclpy.get_clock().now().to_msg()
        message.header.frame_id = frame
        return message

    def map(
        self, resolution: float = RESOLUTION, at: tuple[float, float] = (0.0, 0.0),
        q: tuple[float, ...] = (0.0, 0.0, 0.0, 1.0), size: tuple[int, int] | None = None,
    ) -> Any:  # fmt: skip
        message = self.stamped(self.ros.nav_msgs.OccupancyGrid(), "map")
        info = message.info
        cells = np.where(GRID.occupied, 100, np.where(GRID.free, 0, -1)).astype(np.int8)
        info.height, info.width = cells.shape if size is None else size
        info.resolution, message.data = resolution, array.array("b", cells.tobytes())
        info.origin.position.x, info.origin.position.y = at
        turn = info.origin.orientation
        turn.x, turn.y, turn.z, turn.w = q
        return message

    def scan(self, frame: str = "laser", **fields: Any) -> Any:
        ranges = np.random.default_rng().uniform(1, 5, 61).tolist()
        plain = {"angle_min": -1.5, "angle_max": 1.5, "angle_increment": 0.05, "range_max": 20.0}
        message = self.stamped(self.ros.sensor_msgs.LaserScan(), frame)
        for name, value in ({"ranges": ranges} | plain | fields).items():
            setattr(message, name, value)
        return message

    def odometry(self, x: float = 0.0, q: tuple[float, ...] = (0.0, 0.0, 0.0, 1.0)) -> Any:
        message = self.stamped(self.ros.nav_msgs.Odometry(), "odom")
        message.pose.pose.position.x, turn = x, message.pose.pose.orientation
        turn.x, turn.y, turn.z, turn.w = q
        return message


@pytest.fixture
def heard(monkeypatch: pytest.MonkeyPatch) -> Iterator[Heard]:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF")
    made = Heard()
    yield made
    made.close()


BAD_MAPS: list[tuple[dict[str, Any], str]] = [
    ({"size": (0, 0)}, "expected 0 x 0 and some"),
    ({"size": (3, 2)}, "expected 2 x 3 and some"),
    *(({"resolution": r}, "info.resolution: got") for r in (0.0, -1.0, NAN, INF, 1e-30, 1e30)),
    *(({"at": (x, 0.0)}, "info.origin: got") for x in (NAN, INF, -1e300)),
    *(({"q": (v, v, v, v)}, "info.origin: got") for v in (NAN, INF, 1e308)),
]


def test_a_map_that_cannot_be_is_named_and_the_next_one_is_used(heard: Heard) -> None:
    for k, (wrong, said) in enumerate(BAD_MAPS):
        heard.send("map", heard.map(**wrong))
        assert said in heard.node._map_error, wrong
        if k in (0, len(BAD_MAPS) - 1):  # levels of its log go up, and down again
            heard.until(lambda: heard.node._said[0] == ERROR)
            heard.send("map", heard.map())
            assert not heard.node._map_error
            heard.until(lambda: heard.core.ready and heard.node._said[0] != ERROR)


def test_scans_and_odometry_that_cannot_be_do_not_end_it(heard: Heard) -> None:
    heard.prepare(at=(-5.0, 3.0), q=(0.0, 0.0, 0.6, 0.8))
    for x in (NAN, INF, 1e308, -1e308, 1e15, 5.0):
        heard.send("odom", heard.odometry(x))
        heard.send("scan", heard.scan())
    for q in ((0.0, 0.0, 0.0, 0.0), (NAN,) * 4, (1e308,) * 4):
        heard.send("odom", heard.odometry(q=q))
        heard.send("scan", heard.scan())
    laser = heard.node.lasers[0]
    for name in ("angle_min", "angle_max", "angle_increment", "range_max", "range_min"):
        for value in (NAN, -INF, 1e38, -5.0):
            heard.send("scan", heard.scan(**{name: value}))
    assert laser.bad > 15
    for ranges in ([], [NAN] * 61, [-INF] * 61, [1e38] * 61, [2.0], [2.0] * 200_000):
        heard.send("scan", heard.scan(ranges=ranges))
    heard.send("scan", heard.scan(time_increment=NAN))
    heard.until(lambda: heard.node.found is not None)
    assert heard.node._health()[0] < ERROR


def test_a_message_that_nobody_thought_of_is_left_out(heard, capfd):
    heard.send("odom", SimpleNamespace())  # any error that is not imgloc's own
    assert "odom: left out; a defect, AttributeError" in capfd.readouterr().err


def test_the_odometry_of_a_second_robot_on_the_same_topic_is_named_and_left_out(heard, capfd):
    for k, child in enumerate(("a/base", "b/base", "a/base")):
        message = heard.odometry(float(k))
        message.child_frame_id = child
        heard.send("odom", message)
    assert "odom: of two robots, odom -> a/base and odom -> b/base?" in capfd.readouterr().err
    assert [pose[0] for pose in heard.node._moves._poses] == [0.0, 2.0]


def test_a_status_that_cannot_be_told_does_not_end_the_node(heard, capfd):
    first, heard.node.first = heard.node.first, "a defect"  # whatever makes the timer's work fail
    heard.until(lambda: "status: left out; a defect" in capfd.readouterr().err)
    heard.node.first = first
    said = heard.node._said
    heard.until(lambda: heard.node._said is not said)


def test_names_and_transforms_that_cannot_be(heard: Heard) -> None:
    laser, node = heard.node.lasers[0], heard.node
    laser.mount = None  # tf says it
    heard.send("scan", heard.scan("\x1b[31m" + "x" * 5000))
    assert laser.frame.startswith("\\x1b[31mxxx")
    assert len(laser.frame) <= 100
    link = heard.stamped(heard.ros.geometry_msgs.TransformStamped(), "base_link")
    link.child_frame_id = "laser"
    for x in (NAN, INF):
        link.transform.translation.x = x
        node._on_transforms(SimpleNamespace(transforms=[link]))
        heard.send("scan", heard.scan())
        assert laser.frame == "laser"  # whose place is not known
    link.transform.translation.x = 0.1
    node._on_transforms(SimpleNamespace(transforms=[link]))
    heard.send("scan", heard.scan())
    assert laser.frame == ""
    link.header.frame_id = "laser"  # its own parent
    node._on_transforms(SimpleNamespace(transforms=[link]))
    heard.send("scan", heard.scan())
    assert laser.frame == ""  # it is left out


def test_a_check_reads_tf_and_names_a_message_that_is_no_scan(heard: Heard) -> None:
    ear = Ear(heard.ros, heard.rclpy, Settings(watch="tf"), map_topic=False)
    for message in (heard.scan(), heard.scan(angle_max=-1.0)):
        ear.scans[0].kept = -INF
        ear.hear(ear.scans[0], message)
    rows, scans = ear.mounted(0)
    assert (rows[0].found, scans) == ("1 of 2 are no scans", [])
    assert rows[1].found == "tf does not say where laser sits on base_link"
    link = heard.stamped(heard.ros.geometry_msgs.TransformStamped(), "base_link")
    link.child_frame_id, link.transform.translation.x = "laser", 0.2
    link.transform.rotation.x, link.transform.rotation.w = 1.0, 0.0
    ear.on_transforms(SimpleNamespace(transforms=[link]))
    rows, scans = ear.mounted(0)
    assert (rows[1].found, len(scans)) == ("0.2, 0, 0 deg by tf, flipped", 1)
    (row,) = ear.poses_rows()
    assert (row.found, "map -> odom" in row.do) == ("not published", True)
    link.header.frame_id, link.child_frame_id = "map", "base_link"
    ear.on_transforms(SimpleNamespace(transforms=[link]))
    assert [(row.found, row.do) for row in ear.poses_rows()] == [("published", "")]


def test_hints_move_with_the_robot_and_some_cannot_be(heard: Heard) -> None:
    heard.prepare()
    heard.send("odom", at := heard.odometry())
    message = heard.stamped(heard.ros.geometry_msgs.PoseWithCovarianceStamped(), "map")
    message.header.stamp = at.header.stamp
    message.pose.covariance[0] = message.pose.covariance[7] = 0.25
    for x in (NAN, 2.0):
        message.pose.pose.position.x = x
        heard.send("imgloc/hint", message)
    message.header.frame_id = "odom"
    heard.send("imgloc/hint", message)
    heard.send("odom", heard.odometry(1.0))
    (hint,) = heard.node._hinted(heard.node._moves.last, imgloc.Pose2D(0.5, 0.0))
    assert (hint.x, hint.y, hint.metres) == pytest.approx((3.5, 0.0, 0.5))
    assert hint.radians == TOLERANCE  # nobody said how sure the heading is
    assert not heard.node._hinted(heard.node._moves.last + 100)
    start, *_ = found = weighed_by(hint)
    assert [one.verdict for one in found] == ["unique", "ambiguous", "unique"]
    assert (found[1].why, found[2].masses > start.masses) == ("hinted", True)


def test_a_given_pose_whose_covariance_is_not_known_is_rough(heard: Heard) -> None:
    heard.prepare()
    message = heard.stamped(heard.ros.geometry_msgs.PoseWithCovarianceStamped(), "map")
    message.pose.pose.position.x = 5.0
    for variance in (0.0, NAN, -1.0):
        message.pose.covariance[:] = np.full(36, variance)
        heard.node._on_set_pose(SimpleNamespace(pose=message), None)
        assert heard.node._robot._start == (imgloc.Pose2D(5.0, 0.0), (RADIUS, TOLERANCE))


def test_a_robot_that_stops_while_another_scan_is_asked_is_asked_there_too(heard: Heard) -> None:
    heard.node.settings = replace(heard.node.settings, standing=True)
    heard.prepare()
    for x, stood in ((0.0, 0.0), (0.3, 0.0), (0.3, 0.3)):
        for message in (heard.odometry(x), heard.scan(), heard.odometry(x)):
            heard.send("odom" if hasattr(message, "pose") else "scan", message)
        assert heard.node._stood.x == stood
        if x:
            heard.until(lambda: heard.node._asked is None)
            time.sleep(0.1)  # more than `every`


def weighed_by(hint: Hint) -> tuple[Found, ...]:
    """A unique answer: as it is, with a hint at its second place, and with one at its first."""
    here, there = imgloc.Pose2D(hint.x, hint.y), imgloc.Pose2D(hint.x + 9, hint.y)
    found = Found(1.0, "map", "unique", (there, here), (0.95, 0.05), np.eye(3))
    other = replace(found, poses=(here, there))
    return found, weighed(found, (hint,), 0.9), weighed(other, (hint,), 0.9)


def test_poses_are_in_the_frame_of_a_map_that_lies_anywhere(heard: Heard) -> None:
    """The origin is far off and turned, and its quaternion is not quite one."""
    yaw, z = 2 * math.atan2(0.6, 0.8), 1.3
    heard.node.settings = replace(heard.node.settings, standing=True)
    heard.prepare(at=(-512.3, 87.1), q=(0.0, 0.0, 0.6 * z, 0.8 * z))
    there = imgloc.OccupancyGrid(
        GRID.occupied, GRID.free, GRID.resolution, imgloc.Pose2D(-512.3, 87.1, yaw)
    )
    seen = simulate(there, 3, 5, Sensor(rays=241, fov=6.0))
    for scan, truth in zip(seen.scans, seen.poses, strict=True):
        heard.node._again()
        heard.send("odom", heard.odometry())
        fields = {"angle_min": -3.0, "angle_max": 3.0, "angle_increment": 0.025}
        heard.send("scan", heard.scan(ranges=scan.ranges.tolist(), **fields))
        heard.send("odom", heard.odometry())
        heard.until(lambda: heard.node.first.state == "quiet")
        found = heard.node.found
        assert math.hypot(found.poses[0].x - truth[0], found.poses[0].y - truth[1]) < 0.15
        assert abs(math.remainder(found.poses[0].theta - truth[2], math.tau)) < 0.05


def test_the_same_map_again_changes_nothing_and_a_map_that_moved_is_another(heard: Heard) -> None:
    """Stamps and cells say nothing of where a map is, and a new stamp is no new map."""
    heard.send("map", heard.map())
    eras = [heard.node._era]
    for at in ((0.0, 0.0), (100.0, 50.0), (100.0, 50.0)):
        message = heard.map(at=at)
        message.header.stamp.sec, message.header.stamp.nanosec = 0, 0
        heard.send("map", message)
        eras.append(heard.node._era)
    assert eras == [1, 1, 2, 2]
    assert heard.core.site(timeout=60).features.grid.origin.x == 100.0


def test_one_stale_scan_changes_nothing_and_a_clock_set_back_does(heard: Heard) -> None:
    def stamped(seconds: float) -> Any:
        message = heard.scan()
        at = heard.rclpy.get_clock().now().nanoseconds + int(1e9 * seconds)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(at, 10**9)
        return message

    heard.prepare()
    for seconds in (0.0, -20.0, 0.1, -20.0, 0.2):
        heard.send("scan", stamped(seconds))
    assert heard.node._era == 1
    heard.send("scan", stamped(-20.0))
    heard.send("scan", stamped(-19.0))
    assert heard.node._era == 2


def test_a_scan_waits_for_the_odometry_of_its_time_and_then_is_late(heard, monkeypatch):
    monkeypatch.setattr("imgloc.live.node.LATE", 0.2)
    heard.prepare()
    laser = heard.node.lasers[0]
    heard.send("odom", heard.odometry())
    heard.send("scan", heard.scan())
    assert len(heard.node._waiting) == 1
    heard.send("odom", heard.odometry())
    assert (len(heard.node._waiting), laser.skipped, laser.late) == (0, 0, "")
    heard.send("scan", heard.scan())
    heard.until(lambda: laser.late)
    assert (len(heard.node._waiting), laser.skipped) == (0, 1)
    assert "late: no odometry of the time of its scans" in heard.node._health()[1]


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"range_max": -1.0}, "range_max: got -1.0, expected metres, 0.001 or more"),
        ({"range_max": NAN}, "range_max: got nan"),
        ({"scan_timeout": NAN}, "scan_timeout: got nan"),
        ({"least_deviation": (1.0,)}, "least_deviation: got (1.0,), expected 2 values"),
        ({"least_deviation": (NAN, 1.0)}, "least_deviation[0]: got (nan, 1.0), expected metres"),
        (
            {"cloud_topics": ("a",), "height": (0.4, 0.2)},
            "height: got (0.4, 0.2), expected a lower",
        ),
        ({"map_frame": "/"}, "map_frame: got '/', expected the name of a frame"),
        ({"sensor": (0.0, 0.0, INF)}, "sensor[2]: got (0.0, 0.0, inf), expected metres"),
    ],
)
def test_a_parameter_that_cannot_be_is_refused(wrong: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigError) as refused:
        Settings(**wrong)
    assert str(refused.value).startswith(f"Settings.{said}")


def test_each_parameter_has_the_text_the_limits_and_the_default_of_its_option(heard: Heard) -> None:
    settings = with_parameters(heard.ros, heard.rclpy, Settings())
    assert settings == Settings()
    for one in declared(Settings):
        about = heard.rclpy.describe_parameter(one.name)
        limits = "" if one.limit is None else str(one.limit)
        assert (about.description, about.additional_constraints) == (one.text, limits)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--scan", "bad topic"), "topic: got 'bad topic': Invalid topic name"),
        (("--ros-args", "-p", "sensor:=['a','b','c']"), "parameter sensor[0]: got ('a', 'b', 'c')"),
        (("--ros-args", "-p", "least_deviation:=[1.0]"), "parameter least_deviation: got (1.0,)"),
    ],
)
def test_the_command_refuses_parameters_before_it_runs(words: tuple[str, ...], said: str) -> None:
    call("node", "curved", "--sensor", "0,0,0", *words).ends(2, said)
