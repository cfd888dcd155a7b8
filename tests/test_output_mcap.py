"""`imgloc track --mcap`: what is in the file, read back."""

import hashlib
import json
import math
from collections import Counter, defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command import MAIN, MAPS, call, spawn

import imgloc
from imgloc.model import LaserScan, Pose2D
from imgloc.output.mcap import Recording, evenly

highlevel = pytest.importorskip("rosbags.highlevel", reason="reads bags: the extra ros")

MAP = MAPS / "curved.yaml"


@pytest.fixture(scope="module")
def log(tmp_path_factory) -> Path:
    """Four scans of a robot that stands, and one with nothing in it."""
    grid = imgloc.load_map(MAP)
    made = imgloc.simulate(grid, 1, seed=1, sensor=imgloc.Sensor(rays=91, fov=math.radians(270)))
    rng = np.random.default_rng(1)
    first = made[0]
    ranges = [first.ranges + rng.normal(0, 0.01, 91) for _ in range(4)] + [np.full(91, np.nan)]
    scans = tuple(LaserScan(r, first.angles, range_max=30.0) for r in ranges)
    path = tmp_path_factory.mktemp("log") / "log.npz"
    stamps = 1_700_000_000 + np.arange(5.0)
    imgloc.save_scans(path, imgloc.ScanSet(scans, None, stamps, np.zeros((5, 3))))
    return path


def read(path: Path) -> dict[str, list]:
    """Type, nanoseconds and message of all that is on each topic."""
    out = defaultdict(list)
    with highlevel.AnyReader([path]) as bag:
        for c, time, raw in bag.messages():
            out[c.topic].append((c.msgtype, time, bag.deserialize(raw, c.msgtype)))
    return out


def test_a_track_is_there_as_ros_knows_it(tmp_path, log) -> None:
    out = tmp_path / "out.mcap"
    run = call("track", MAP, log, "--mcap", out, "--json", "--start", "8,6,0").ends(0)
    rows = [json.loads(line) for line in run.out.splitlines()]
    found = read(out)
    assert {topic: items[0][0] for topic, items in found.items()}.items() >= {
        "/map": "nav_msgs/msg/OccupancyGrid", "/scan": "sensor_msgs/msg/LaserScan",
        "/imgloc/track": "std_msgs/msg/String", "/imgloc/verdict": "std_msgs/msg/String",
        "/imgloc/hypotheses": "geometry_msgs/msg/PoseArray",
    }.items()  # fmt: skip
    counts = Counter({topic: len(items) for topic, items in found.items()})
    unique = sum(row["pose"] is not None for row in rows)
    assert (counts["/map"], counts["/imgloc/verdict"], counts["/imgloc/track"]) == (1, 5, 5)
    assert counts["/imgloc/pose"] == unique
    assert [json.loads(message.data) for _, _, message in found["/imgloc/track"]] == rows
    assert [time for _, time, _ in found["/imgloc/track"]] == [
        10**9 * (1_700_000_000 + k) for k in range(5)
    ]
    grid, there = imgloc.load_map(MAP), imgloc.grid_from_msg(found["/map"][0][2])
    assert (there.occupied == grid.occupied).all()
    assert (there.resolution, there.origin) == (grid.resolution, grid.origin)
    scan = found["/scan"][0][2]
    assert len(scan.ranges) == 91
    assert scan.angle_max - scan.angle_min == pytest.approx(math.radians(270))
    assert len(imgloc.load_scans(out)) == counts["/scan"]


def test_a_unique_pose_is_a_pose_and_a_transform(tmp_path) -> None:
    from imgloc.filters.belief import Belief
    from imgloc.filters.follow import Moment

    pose = Pose2D(1.0, 2.0, math.pi / 2)
    belief = Belief(np.array([[1.0, 2.0, 0.5]]), np.ones(1), np.eye(3)[None], 0.0, "unique", 1.0)
    moment = Moment(0, 5.25, 0.0, True, 1.0, belief, "", pose, np.eye(3), (0.1, 0.1), pose)
    scan = LaserScan([1.0, 2.0], [0.0, 0.5], T_base_laser=Pose2D(0.5, 0.0, 0.0))
    recording = Recording(imgloc.load_map(MAP), ["/front", "1"])
    for laser in ("/front", "1"):
        recording.add(moment, replace(scan, laser=laser))
    recording.save(tmp_path / "one.mcap")
    recording.close()
    found = read(tmp_path / "one.mcap")
    at = found["/imgloc/pose"][0][2].pose.pose
    assert (at.position.x, at.position.y) == (1.0, 2.0)
    for (_, _, tf), topic in zip(found["/tf"], ("/front", "/laser_1/scan"), strict=True):
        sensor, base = tf.transforms
        assert (base.header.frame_id, base.child_frame_id) == ("map", "base_link")
        assert (base.transform.translation.x, base.transform.translation.y) == (1.0, 2.0)
        assert base.transform.rotation.z == pytest.approx(math.sin(math.pi / 4))
        ((_, _, message),) = found[topic]
        assert (sensor.header.frame_id, sensor.child_frame_id) == ("map", message.header.frame_id)
        place = sensor.transform.translation
        assert (place.x, place.y) == pytest.approx((1.0, 2.5))
    assert found["/imgloc/pose"][0][1] == 5_250_000_000


def test_the_same_track_has_the_same_bytes_and_no_file_is_overwritten(tmp_path, log) -> None:
    paths = [tmp_path / name for name in ("a.mcap", "b.mcap")]
    assert call("track", MAP, log, "--mcap", paths[0]).code == 0
    assert spawn("track", MAP, log, "--mcap", paths[1]).code == 0
    a, b = (hashlib.sha256(path.read_bytes()).hexdigest() for path in paths)
    assert a == b
    call("track", MAP, log, "--mcap", paths[0]).ends(1, "a.mcap")


def test_a_stamp_that_mcap_does_not_have_is_refused_and_nothing_is_left(tmp_path, log) -> None:
    scans = imgloc.load_scans(log)
    early = tmp_path / "early.npz"
    moved = imgloc.ScanSet(scans.scans, None, scans.stamps - 2e9, scans.odom)
    imgloc.save_scans(early, moved)
    run = call("track", MAP, early, "--mcap", tmp_path / "out.mcap")
    run.ends(1, "expected 0 to 4,294,967,295 s")
    assert not (tmp_path / "out.mcap").exists()


def test_uneven_angles_are_those_of_the_nearest_rays() -> None:
    angles = np.array([0.3, 0.0, 0.1, 0.2, 0.9])
    even, ranges = evenly(LaserScan([4.0, 1.0, 2.0, 3.0, 9.0], angles))
    assert even == pytest.approx(np.arange(10) / 10)
    np.testing.assert_array_equal(ranges, [1, 2, 3, 4, *[np.nan] * 5, 9])


def test_without_rosbags_one_error_says_what_to_install(tmp_path, log) -> None:
    code = f"sys.modules['rosbags.rosbag1'] = None; {MAIN}"
    run = spawn("track", MAP, log, "--mcap", tmp_path / "o.mcap", code=code)
    run.ends(1, "pip install 'imgloc[ros]'")
