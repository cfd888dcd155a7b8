"""ROS messages, whoever made them: rclpy, rosbags, or mappings."""

import contextlib
import math
from collections.abc import Iterator
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imgloc import ConfigError, LaserScan, MapError, Pose2D, ScanError
from imgloc.io import messages

STAMP = {"sec": 12, "nanosec": 250_000_000}
HEADER = {"stamp": STAMP, "frame_id": "laser"}
SCAN = {
    "header": HEADER, "angle_min": -1.0, "angle_max": 1.0, "angle_increment": 0.5,
    "time_increment": 0.0, "scan_time": 0.1, "range_min": 0.1, "range_max": 8.0,
    "ranges": [1.0, math.nan, 3.0, math.inf, 0.05], "intensities": [],
}  # fmt: skip
HALF = {"x": 0.0, "y": 0.0, "z": math.sin(0.25), "w": math.cos(0.25)}  # yaw of 0.5
POSE = {"position": {"x": 1.0, "y": -2.0, "z": 0.0}, "orientation": HALF}
INFO = {"map_load_time": STAMP, "resolution": 0.05, "width": 3, "height": 2, "origin": POSE}
GRID = {"header": HEADER, "info": INFO, "data": [0, 19, 20, 64, 65, -1]}


def as_object(value):
    """The same with attributes in place of keys."""
    if isinstance(value, dict):
        return SimpleNamespace(**{key: as_object(item) for key, item in value.items()})
    return value


def as_rosbags(kind, value):
    """The same as rosbags has it."""
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    return _typed(store, kind, value)


def _typed(store, kind, value):
    made = {}
    for name, (_, of) in store.fielddefs[kind][1]:
        item = value[name]
        if isinstance(item, dict):
            item = _typed(store, of if isinstance(of, str) else of[0], item)
        elif isinstance(item, list):
            item = np.array(item, np.int8 if name == "data" else np.float32)
        made[name] = item
    return store.types[kind](**made)


def as_rclpy(kind, value):
    """The same as rclpy has it; needs the wheels of ROS 2 (pip install 'imgloc[node]')."""
    package, _, name = kind.split("/")
    module = pytest.importorskip(f"{package}.msg", reason="no ROS 2: imgloc[node]")
    made = getattr(module, name)()
    for key, of in made.get_fields_and_field_types().items():
        item = as_rclpy(of.replace("/", "/msg/"), value[key]) if "/" in of else value[key]
        setattr(made, key, item)
    return made


def forms(kind, value):
    return [lambda: value, lambda: as_object(value), lambda: as_rosbags(kind, value),
            lambda: as_rclpy(kind, value)]  # fmt: skip


NAMES = ["mapping", "object", "rosbags", "rclpy"]


@pytest.mark.parametrize("form", forms("sensor_msgs/msg/LaserScan", SCAN), ids=NAMES)
def test_a_scan_is_the_same_whoever_made_its_message(form) -> None:
    scan = messages.scan_from_msg(form(), mount=Pose2D(0.1, 0.0))
    np.testing.assert_array_equal(scan.ranges.astype(np.float32), np.float32(SCAN["ranges"]))
    assert scan.angles == pytest.approx([-1.0, -0.5, 0.0, 0.5, 1.0])
    assert (scan.stamp, scan.T_base_laser) == (12.25, Pose2D(0.1, 0.0))
    assert scan.valid.tolist() == [True, False, True, False, False]
    assert scan.range_max == 8.0


@pytest.mark.parametrize("form", forms("nav_msgs/msg/OccupancyGrid", GRID), ids=NAMES)
def test_a_map_is_the_same_whoever_made_its_message(form) -> None:
    grid = messages.grid_from_msg(form())
    assert grid.free.tolist() == [[True, True, False], [False, False, False]]
    assert grid.occupied.tolist() == [[False, False, False], [False, True, False]]
    assert grid.resolution == 0.05  # a float32 in the message
    assert (grid.origin.x, grid.origin.y) == (1.0, -2.0)
    assert grid.origin.theta == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("change", "said"),
    [({"ranges": []}, "empty"), ({"angle_max": 3.0}, "were readings left out"),
     ({"range_max": 0.0}, "range_max"), ({"angle_min": math.nan}, "finite")],
)  # fmt: skip
def test_a_scan_that_contradicts_itself_is_refused(change, said) -> None:
    with pytest.raises(ScanError, match=said):
        messages.scan_from_msg(SCAN | change, "/scan")


def test_a_scan_without_a_stamp_has_the_time_when_it_came() -> None:
    unset = SCAN | {"header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}}
    assert messages.scan_from_msg(unset, received=7.5).stamp == 7.5


@pytest.mark.parametrize(
    "change", [{"width": 4}, {"width": 0}, {"resolution": 0.0}, {"resolution": math.nan}]
)
def test_a_map_that_contradicts_itself_is_refused(change) -> None:
    with pytest.raises(MapError, match="expected"):
        messages.grid_from_msg(GRID | {"info": INFO | change})


ODD = (None, "text", 200, -5.5, 1e400, math.nan, [], [None], [200, 0, 0, 0, 0, 0], {}, b"\xff")


def broken(message: dict) -> Iterator[dict]:
    """The message without each of its fields, and with something odd in place of each."""
    for key, value in message.items():
        yield {name: item for name, item in message.items() if name != key}
        yield from ({**message, key: odd} for odd in ODD)
        if isinstance(value, dict):
            yield from ({**message, key: part} for part in broken(value))


@pytest.mark.parametrize(
    ("message", "read", "error"),
    [(SCAN, messages.scan_from_msg, ScanError), (GRID, messages.grid_from_msg, MapError)],
    ids=["scan", "map"],
)
@pytest.mark.parametrize("shape", [dict, as_object], ids=NAMES[:2])
def test_what_is_no_message_is_refused_with_its_name(message, read, error, shape) -> None:
    for one in [*broken(message), [1, 2], None, {}]:
        with contextlib.suppress(error):
            read(shape(one) if isinstance(one, dict) else one, "/topic")


@pytest.mark.parametrize(
    ("read", "message", "said"),
    [
        (messages.grid_from_msg, GRID | {"data": [200, 0, 0, 0, 0, 0]}, "data: expected whole"),
        (messages.grid_from_msg, GRID | {"data": None}, "a field is of another kind"),
        (messages.grid_from_msg, {"info": INFO}, "it has no field 'data'"),
        (messages.grid_from_msg, GRID | {"info": {"width": 3, "height": 2, "resolution": 0.05}},
         "it has no field 'origin'"),
        (messages.scan_from_msg, {k: v for k, v in SCAN.items() if k != "angle_max"},
         "it has no field 'angle_max'"),
    ],
)  # fmt: skip
def test_the_field_of_a_message_that_is_missing_is_named(read, message, said) -> None:
    for shape in (dict, as_object):
        with pytest.raises((MapError, ScanError), match=f"^/topic: {said}"):
            read(shape(message), "/topic")


def test_odometry_is_seconds_and_a_pose() -> None:
    odometry = {"header": HEADER, "pose": {"pose": POSE, "covariance": [0.0] * 36}}
    assert messages.move_of(as_object(odometry)) == pytest.approx((12.25, 1.0, -2.0, 0.5))


def test_a_transform_may_turn_about_any_axis() -> None:
    q = np.array([0.1, -0.4, 0.3, 0.86])
    pose = {
        "position": {"x": 1.0, "y": 2.0, "z": 3.0},
        "orientation": dict(zip("xyzw", q, strict=True)),
    }
    expected = np.eye(4)
    expected[:3, :3], expected[:3, 3] = Rotation.from_quat(q).as_matrix(), (1, 2, 3)
    np.testing.assert_allclose(messages.matrix_of(pose), expected, atol=1e-12)


def test_messages_are_written_as_they_are_read() -> None:
    scan = messages.scan_from_msg(SCAN)
    fields = messages.scan_to_msg(scan, "laser")
    for again in (fields, as_rosbags("sensor_msgs/msg/LaserScan", fields)):
        twin = messages.scan_from_msg(again)
        np.testing.assert_allclose(twin.ranges, scan.ranges, rtol=1e-6)
        np.testing.assert_allclose(twin.angles, scan.angles, rtol=1e-6)
        assert (twin.stamp, twin.range_max) == (scan.stamp, scan.range_max)
    grid = messages.grid_from_msg(GRID)
    fields = messages.grid_to_msg(grid, stamp=12.25)
    assert fields["header"]["stamp"] == STAMP
    for again in (fields, as_rosbags("nav_msgs/msg/OccupancyGrid", fields)):
        twin = messages.grid_from_msg(again)
        assert (twin.occupied == grid.occupied).all()
        assert (twin.free == grid.free).all()
        assert twin.origin.theta == pytest.approx(grid.origin.theta)


def test_angles_that_are_not_even_are_no_message() -> None:
    scan = LaserScan([1.0, 2.0, 3.0], [0.0, 0.1, 0.5])
    with pytest.raises(ConfigError, match="not evenly spaced"):
        messages.scan_to_msg(scan)


def test_stamps_of_rospy_are_read() -> None:
    header = {"stamp": {"secs": 12, "nsecs": 250_000_000}, "frame_id": "laser"}
    assert messages.scan_from_msg(as_object(SCAN | {"header": header})).stamp == 12.25
