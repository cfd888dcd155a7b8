"""Bags of ROS 1 and 2, written by rosbags; and what `ros2 topic echo` prints."""

import logging
import math
from pathlib import Path

import numpy as np
import pytest
from command import MAPS, call, rows

from imgloc import Pose2D, ScanError, grid_to_msg, load_map, load_scans
from imgloc.io.bags import read_bag_map
from imgloc.io.scans import scans_size

rosbags = pytest.importorskip("rosbags", reason="reads bags: the extra ros")

SCAN, ODOM, TF = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage"
RANGES = [1.0, math.inf, math.nan, 2.5]
UP, DOWN = (0.0, 0.0, 0.0, 1.0), (1.0, 0.0, 0.0, 0.0)  # x, y, z, w


class Messages:
    """Makes messages of either ROS."""

    def __init__(self, store) -> None:
        self.store, self.types = store, store.types
        self.ros1 = "std_msgs/msg/Header" in store.types and "seq" in str(
            store.types["std_msgs/msg/Header"].__dataclass_fields__.keys()
        )

    def make(self, kind: str, *values):
        return self.types[kind](*values)

    def header(self, stamp: float, frame: str):
        time = self.make("builtin_interfaces/msg/Time", int(stamp), round(stamp % 1 * 1e9))
        return self.make("std_msgs/msg/Header", *([7] if self.ros1 else []), time, frame)

    def scan(self, stamp: float, frame: str = "laser", ranges=RANGES):
        r = np.asarray(ranges, np.float32)
        step = 3.0 / (len(r) - 1)
        none = np.array([], np.float32)
        return self.make(
            SCAN, self.header(stamp, frame), -1.5, 1.5, step, 0.0, 0.0, 0.1, 30.0, r, none
        )

    def vector(self, x: float, y: float, kind: str = "Vector3"):
        return self.make(f"geometry_msgs/msg/{kind}", x, y, 0.2)

    def turn(self, q):
        return self.make("geometry_msgs/msg/Quaternion", *q)

    def odometry(self, stamp: float, x: float, yaw: float, child: str = "base_footprint"):
        q = self.turn((0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)))
        pose = self.make("geometry_msgs/msg/Pose", self.vector(x, 0.5, "Point"), q)
        twist = self.make("geometry_msgs/msg/Twist", self.vector(0, 0), self.vector(0, 0))
        covariance = np.zeros(36)
        return self.make(
            ODOM,
            self.header(stamp, "odom"),
            child,
            self.make("geometry_msgs/msg/PoseWithCovariance", pose, covariance),
            self.make("geometry_msgs/msg/TwistWithCovariance", twist, covariance),
        )

    def transform(self, parent: str, child: str, x: float, q=UP, stamp: float = 0.0):
        t = self.make("geometry_msgs/msg/Transform", self.vector(x, 0.0), self.turn(q))
        stamped = self.make(
            "geometry_msgs/msg/TransformStamped", self.header(stamp, parent), child, t
        )
        return self.make(TF, [stamped])


def messages_of(ros1: bool) -> Messages:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    if TF not in store.types:
        definition = "geometry_msgs/TransformStamped[] transforms"
        store.register(get_types_from_msg(definition, TF))
    return Messages(store)


def write(path: Path, kind: str, content: list[tuple[str, str, object]]) -> Path:
    """Write topic, type and message, one a second, as ``bag``, ``db3`` or ``mcap``."""
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin, Writer

    m = messages_of(kind == "bag")
    plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
    writer = Writer1(path) if kind == "bag" else Writer(path, version=9, storage_plugin=plugin)
    with writer as bag:
        connections = {}
        for i, (topic, name, message) in enumerate(content):
            if topic not in connections:
                connections[topic] = bag.add_connection(topic, name, typestore=m.store)
            pack = m.store.serialize_ros1 if kind == "bag" else m.store.serialize_cdr
            bag.write(connections[topic], (i + 1) * 10**9, bytes(pack(message, name)))
    return path


def robot(kind: str, q=UP) -> list[tuple[str, str, object]]:
    m = messages_of(kind == "bag")
    return [
        ("/tf_static", TF, m.transform("base_link", "laser", 0.3, q)),
        ("/tf_static", TF, m.transform("base_footprint", "base_link", 0.05)),
        ("/odom", ODOM, m.odometry(10.0, 1.0, 3.0)),
        ("/scan", SCAN, m.scan(10.5)),
        ("/odom", ODOM, m.odometry(11.0, 2.0, -3.0)),
        ("/scan", SCAN, m.scan(11.0)),
    ]


@pytest.mark.parametrize("kind", ["bag", "db3", "mcap"])
def test_a_bag_has_scans_odometry_and_where_the_sensor_sits(tmp_path: Path, kind: str) -> None:
    path = write(tmp_path / ("a.bag" if kind == "bag" else "a"), kind, robot(kind))
    files = [path] if kind == "bag" else [path, path / f"a.{kind}"]
    for file in files:
        scans = load_scans(file)
        assert len(scans) == 2
        np.testing.assert_array_equal(scans[0].ranges, RANGES)
        np.testing.assert_allclose(scans[0].angles, [-1.5, -0.5, 0.5, 1.5])
        assert (scans[0].range_min, scans[0].range_max) == (pytest.approx(0.1), 30.0)
        assert scans.stamps.tolist() == [10.5, 11.0]
        np.testing.assert_allclose(scans.odom, [[1.5, 0.5, math.pi], [2.0, 0.5, -3.0]])
        assert scans[0].T_base_laser == Pose2D(0.35, 0.0, 0.0)
        size = scans_size(file)
        assert (size.scans, size.numbers) == (2, 16)
        assert size.file_bytes >= 300 * 4  # of odometry and transforms; chunks
    bare = tmp_path / "no-metadata"
    if kind != "bag":
        path.rename(bare)
        (bare / "metadata.yaml").unlink()
        assert len(load_scans(bare)) == 2


def test_scans_that_outgrow_what_the_first_promised_are_refused(tmp_path: Path) -> None:
    m = messages_of(True)
    content = [
        ("/scan", SCAN, m.scan(i, ranges=np.ones(n))) for i, n in enumerate((4, *[60_000] * 2))
    ]
    path = write(tmp_path / "a.bag", "bag", content)
    with pytest.raises(
        ScanError, match="message 2: 120,004 readings up to it, expected 3 scans like"
    ):
        load_scans(path)


def test_a_sensor_upside_down_is_turned_over(tmp_path: Path) -> None:
    scans = load_scans(write(tmp_path / "a.bag", "bag", robot("bag", DOWN)))
    np.testing.assert_allclose(scans[0].angles, [1.5, 0.5, -0.5, -1.5])
    assert scans[0].T_base_laser == Pose2D(0.35, 0.0, 0.0)


@pytest.mark.parametrize(
    ("q", "yaw"), [((0, 0, 0, 0), 0.0), ((0, 0, 3, 3), math.pi / 2), ((0, 0, 0, math.nan), None)]
)
def test_a_turn_that_nobody_filled_in_is_none(tmp_path: Path, q, yaw: float | None) -> None:
    path = write(tmp_path / "a.bag", "bag", robot("bag", q))
    if yaw is None:
        assert load_scans(path)[0].T_base_laser is None
    else:
        assert load_scans(path)[0].T_base_laser.theta == pytest.approx(yaw)


def test_odometry_may_be_in_the_transforms_or_nowhere_near(tmp_path: Path) -> None:
    m = messages_of(False)
    content = [
        ("/tf", TF, m.transform("odom", "base_link", 1.0, stamp=10.0)),
        ("/tf", TF, m.transform("base_link", "laser", 0.2, stamp=10.0)),
        ("/tf", TF, m.transform("odom", "base_link", 3.0, stamp=12.0)),
        ("/scan", SCAN, m.scan(11.0)),
    ]
    scans = load_scans(write(tmp_path / "a", "db3", content))
    np.testing.assert_allclose(scans.odom, [[2.0, 0.0, 0.0]])
    assert scans[0].T_base_laser == Pose2D(0.2, 0.0, 0.0)
    content[3] = ("/scan", SCAN, m.scan(50.0, "unknown"))
    scans = load_scans(write(tmp_path / "b", "db3", content))
    assert scans.odom is None
    assert scans[0].T_base_laser is None


@pytest.mark.parametrize("value", [math.nan, math.inf, -1e308])
def test_odometry_that_cannot_be_is_left_out(tmp_path, value, caplog):
    m, content = messages_of(False), list[tuple[str, str, object]]()
    for k in range(9):
        x = value if k == 4 else 0.1 * k
        content.append(("/odom", ODOM, m.odometry(10.0 + 0.25 * k, x, 0.0)))
        content.append(("/scan", SCAN, m.scan(10.05 + 0.25 * k)))
    scans = load_scans(write(tmp_path / "a", "db3", content))
    assert np.allclose(scans.odom[:8, 0], 0.02 + 0.1 * np.arange(8))  # on the line between
    assert "left out 1 of 9 poses of the odometry" in caplog.text


@pytest.mark.parametrize(("kind", "saves"), [("bag", "rosbag reindex"), ("mcap", "mcap recover")])
def test_a_bag_that_was_cut_off_is_told_what_may_save_it(tmp_path, kind, saves):
    path = write(tmp_path / ("a.bag" if kind == "bag" else "a"), kind, robot(kind))
    file = path if kind == "bag" else next(path.glob("*.mcap"))
    file.write_bytes(file.read_bytes()[:-300])
    run = call("localize", MAPS / "curved.yaml", file)
    run.ends(4, "damaged or not a bag", f"; {saves} may save what is in it", out="")


@pytest.mark.parametrize("name", ["upload", "A.BAG"])
def test_a_bag_whose_name_does_not_tell_its_storage_is_not_called_damaged(tmp_path, name):
    path = write(tmp_path / "a.bag", "bag", robot("bag")).rename(tmp_path / name)
    with pytest.raises(ScanError, match=r"is a bag, expected a name that ends in \.bag, \.mcap"):
        load_scans(path)


def test_of_several_topics_one_is_named(tmp_path: Path) -> None:
    m = messages_of(False)
    front, rear = ("/front", SCAN, m.scan(1.0)), ("/rear", SCAN, m.scan(2.0))
    path = write(tmp_path / "a", "mcap", [front, rear, rear])
    with pytest.raises(ScanError, match=r"pass `topic`, one of /front \(1\), /rear \(2\)"):
        load_scans(path)
    assert len(load_scans(path, topic="rear")) == 2
    with pytest.raises(ScanError, match=r"no scans on /up; it has /front"):
        load_scans(path, topic="/up")
    with pytest.raises(ScanError, match=r"/front: no place on the robot"):
        load_scans(path, topic="/front,/rear")
    beside = [("/laser", SCAN, m.scan(1.0)), *[("laser", SCAN, m.scan(2.0))] * 2]
    path = write(tmp_path / "b.mcap", "mcap", beside)
    assert [len(load_scans(path, topic=name)) for name in ("laser", "/laser")] == [2, 1]


def test_several_lasers_are_one_set_each_at_its_place(tmp_path: Path) -> None:
    m = messages_of(True)
    content = [
        ("/tf_static", TF, m.transform("base_link", "front", 0.3)),
        ("/tf_static", TF, m.transform("base_link", "rear", -0.2, (0.0, 0.0, 1.0, 0.0))),
        ("/odom", ODOM, m.odometry(1.0, 0.0, 0.0, "base_link")),
        *(("/front", SCAN, m.scan(t, "front")) for t in (1.0, 2.0)),
        *(("/rear", SCAN, m.scan(t, "rear", (1.0, 2.0, 3.0))) for t in (1.1, 1.9)),
        ("/odom", ODOM, m.odometry(2.0, 1.0, 0.0, "base_link")),
    ]
    path = write(tmp_path / "a.bag", "bag", content)
    scans = load_scans(path, topic="/front, rear")
    np.testing.assert_allclose(scans.stamps, [1.0, 1.1, 1.9, 2.0])
    np.testing.assert_allclose(scans.odom[:, 0], [0.0, 0.1, 0.9, 1.0], atol=1e-9)
    front, rear = Pose2D(0.3, 0.0, 0.0), Pose2D(-0.2, 0.0, math.pi)
    assert [scan.T_base_laser for scan in scans.scans] == [front, rear, rear, front]
    assert [len(scan.ranges) for scan in scans.scans] == [4, 3, 3, 4]
    assert [scan.laser for scan in scans.scans] == ["/front", "/rear", "/rear", "/front"]
    assert scans_size(path, topic="/front,/rear").scans == 4
    with pytest.raises(ScanError, match="expected each laser once"):
        load_scans(path, topic="/front,front")


@pytest.mark.parametrize(
    "topics",
    [
        "/a/front/scan /a/tf_static /a/tf /b/tf",
        "/a/scan /a/tf_static /a/tf /tf",
        "/scan /tf_static /tf /a/tf",
        "/lidar /tf_static /model/v/tf ",
        "/scan /laser/tf_static /tf ",
    ],
)
def test_robots_with_transforms_of_their_own_may_call_their_frames_alike(tmp_path, topics) -> None:
    scan, still, moving, other = topics.split(" ")
    m, turned = messages_of(True), (0.0, 0.0, 1.0, 0.0)
    content = [(still, TF, m.transform("base_link", "laser", 0.3))]
    for t in (1.0, 2.0, 3.0):
        content += [(moving, TF, m.transform("odom", "base_link", 0.3 * t, stamp=t))]
        content += [(scan, SCAN, m.scan(t))]
    if other:
        content += [(f"{other}_static", TF, m.transform("base_link", "laser", 0.5, turned))]
        content += [(other, TF, m.transform("odom", "base_link", 9.0, stamp=2.0))]
    scans = load_scans(write(tmp_path / "two.bag", "bag", content))
    assert scans[0].T_base_laser == Pose2D(0.3, 0.0, 0.0)
    np.testing.assert_allclose(scans.odom[:, 0], [0.3, 0.6, 0.9])


def test_a_place_that_is_stated_of_a_laser_that_turns_is_refused(tmp_path: Path) -> None:
    m, content = messages_of(True), []
    for t, yaw in ((1.0, 0.0), (2.0, 0.05), (3.0, 0.5)):
        q = (0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))
        content += [("/tf", TF, m.transform("base_link", "laser", 0.2, q, t))]
        content += [("/scan", SCAN, m.scan(t))]
    for n, code in ((4, 0), (6, 4)):
        path = write(tmp_path / f"{n}.bag", "bag", content[:n])
        said = call("inspect", path, "--sensor", "0.2,0,0").ends(code)
        assert ("--sensor: tf turns laser by 29 degrees" in said.err) is (code == 4)


def test_what_is_no_bag_or_has_no_scans_is_one_error(tmp_path: Path) -> None:
    m = messages_of(False)
    path = write(tmp_path / "a", "mcap", [("/odom", ODOM, m.odometry(1.0, 0.0, 0.0))])
    with pytest.raises(ScanError, match="no sensor_msgs/LaserScan in it, but nav_msgs/msg/Odom"):
        load_scans(path)
    for name in ("b.bag", "b.db3", "b.mcap"):
        (tmp_path / name).write_bytes(b"hello")
        with pytest.raises(ScanError, match=r"b\.\w+: damaged or not a bag"):
            load_scans(tmp_path / name)
        with pytest.raises(ScanError, match="no such file"):
            load_scans(tmp_path / f"c{name}")


def cloud(m: Messages, stamp: float, points):
    fields = [
        m.make("sensor_msgs/msg/PointField", axis, 4 * k, 7, 1) for k, axis in enumerate("xyz")
    ]
    data = np.asarray(points, "<f4")
    return m.make(
        CLOUD, m.header(stamp, "laser"), 1, len(data), fields, False, 12, 12 * len(data),
        np.frombuffer(data.tobytes(), np.uint8), True,
    )  # fmt: skip


CLOUD = "sensor_msgs/msg/PointCloud2"


@pytest.mark.parametrize("kind", ["bag", "mcap"])
def test_a_slice_of_a_cloud_is_a_scan(tmp_path: Path, kind: str) -> None:
    m = messages_of(kind == "bag")
    points = [(2, 0, 0.1), (1, 0, 0.9), (3, 0, 0), (0, -3, -0.1), (math.nan, 0, 0)]
    content = [("/tf_static", TF, m.transform("base_link", "laser", 0.3, DOWN)),
               ("/points", CLOUD, cloud(m, 10.5, points)),
               ("/points", CLOUD, cloud(m, 11.0, [(1, 1, 5.0)]))]  # fmt: skip
    path = write(tmp_path / ("a.bag" if kind == "bag" else "log"), kind, content)
    with pytest.raises(ScanError, match=r"cloud of points: a slice .* pass `height=-0.1,0.1`"):
        scans_size(path)
    scans = load_scans(path, height=(-0.2, 0.2))
    assert len(scans) == 2
    assert scans_size(path, height=(-0.2, 0.2)).scans == 2
    first, empty = scans.scans
    assert first.ranges[first.valid].tolist() == [3.0, 2.0]
    assert np.rad2deg(first.angles[first.valid]).tolist() == [90.0, 0.0]  # it hangs upside down
    assert (first.stamp, len(empty.ranges), empty.valid.any()) == (10.5, 720, False)
    with pytest.raises(ScanError, match="no point 7 to 8 m above the sensor"):
        load_scans(path, height=(7, 8))
    bad = call("localize", "curved", path, "--height", "1,-1", "--no-cache")
    bad.ends(2, "--height: got 1,-1, expected a lower end first")


@pytest.mark.parametrize("how", ["ascii", "binary"])
def test_a_slice_of_a_pcd_is_a_scan(tmp_path: Path, how: str) -> None:
    points = np.array([(0, 2, 0.1, 7), (1, 0, 0.9, 7), (-4, 0, 0, 7)], "<f4")
    head = (
        "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z i\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\n"
        f"WIDTH 3\nHEIGHT 1\nPOINTS 3\nDATA {how}\n"
    )
    words = "\n".join(" ".join(map(str, p)) for p in points.tolist()).encode()
    for name in ("a.pcd", "a"):
        path = tmp_path / name
        path.write_bytes(head.encode() + (words if how == "ascii" else points.tobytes()))
        (scan,) = load_scans(path, height=(-0.2, 0.2)).scans
        assert scans_size(path, height=(-0.2, 0.2)).scans == 1
        assert scan.ranges[scan.valid].tolist() == [4.0, 2.0]
        assert np.rad2deg(scan.angles[scan.valid]).round(6).tolist() == [180.0, 90.0]
    with pytest.raises(ScanError, match=r"pass `height=-0.1,0.1`"):
        load_scans(path)
    path.write_bytes(head.replace(how, "binary_compressed").encode() + b"1")
    with pytest.raises(ScanError, match="pcl_convert_pcd_ascii_binary"):
        load_scans(path, height=(-0.2, 0.2))


def test_a_map_in_a_bag_is_a_map(tmp_path: Path) -> None:
    m, grid = messages_of(False), load_map(MAPS / "curved.yaml")
    fields = grid_to_msg(grid, stamp=1.0)
    at, turn = (fields["info"]["origin"][key] for key in ("position", "orientation"))
    pose = m.make(
        "geometry_msgs/msg/Pose", m.vector(at["x"], at["y"], "Point"), m.turn(turn.values())
    )
    info = m.make(
        "nav_msgs/msg/MapMetaData", m.header(1.0, "map").stamp, grid.resolution,
        fields["info"]["width"], fields["info"]["height"], pose,
    )  # fmt: skip
    data = np.array(fields["data"], np.int8)
    kind = "nav_msgs/msg/OccupancyGrid"
    content = [("/map", kind, m.make(kind, m.header(1.0, "map"), info, data))]
    write(tmp_path / "log", "mcap", [*content, ("/scan", SCAN, m.scan(2.0))])
    (path,) = (tmp_path / "log").glob("*.mcap")
    found = read_bag_map(path)
    assert (found.occupied == grid.occupied).all()
    assert found.origin == grid.origin
    assert call("simulate", "curved", "-n", 1, "--out", tmp_path / "a.npz").code == 0
    run = call("localize", path, tmp_path / "a.npz", "--json", "--no-cache").ends(0)
    (row,) = rows(run.out)
    (twin,) = rows(call("localize", "curved", tmp_path / "a.npz", "--json", "--no-cache").out)
    assert row["pose"]["x"] == pytest.approx(twin["pose"]["x"], abs=1e-6)
    write(tmp_path / "none", "mcap", [("/scan", SCAN, m.scan(2.0))])
    (none,) = (tmp_path / "none").glob("*.mcap")
    run = call("localize", none, tmp_path / "a.npz", "--no-cache")
    run.ends(3, "no map on /map: expected a map, then scans")


def test_empty_scans_of_a_bag_are_left_out(tmp_path: Path, caplog, monkeypatch) -> None:
    monkeypatch.setattr(logging.getLogger("imgloc"), "propagate", True)
    m = messages_of(True)
    empty = m.scan(0.0)
    empty.ranges = np.array([], np.float32)
    # Those of a motor that spins up come first: they do not tell how large the others are.
    content = [("/scan", SCAN, empty)] * 2
    content += [("/scan", SCAN, m.scan(i, ranges=np.ones(5000))) for i in range(1, 99)]
    path = write(tmp_path / "a.bag", "bag", content)
    assert scans_size(path).numbers == 2 * 100 * 5000
    assert len(load_scans(path, max_bad=0.02)) == 98
    assert "left out 2 of 100 scans, which are broken: /scan: message 0" in caplog.text
    with pytest.raises(ScanError, match=r"2 of 100 are broken; `max_bad=0.02` leaves them out"):
        load_scans(path)
