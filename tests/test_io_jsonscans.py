"""Scans as JSON of other programs: what they are wrapped in, and what their fields are called."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command import call

from imgloc import Pose2D, ScanError, load_scans
from imgloc.io.messages import pose_fields

N, RANGES = 4, [1.5, 2.5, 3.5]
ANGLES = [-0.5, 0.0, 0.5]


def message(k: int, seconds: str = "sec", rest: str = "nanosec") -> dict[str, Any]:
    stamp = {seconds: 1_700_000_000 + k, rest: 500_000_000}
    return {
        "header": {"stamp": stamp, "frame_id": "laser"}, "angle_min": -0.5, "angle_max": 0.5,
        "angle_increment": 0.5, "range_min": 0.1, "range_max": 9.0, "ranges": RANGES,
    }  # fmt: skip


def foxglove(k: int, stamp: object) -> dict[str, Any]:
    pose = {"position": {"x": 0, "y": 0, "z": 0}, "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}}
    return {"timestamp": stamp, "frame_id": "laser", "pose": pose, "start_angle": -0.5,
            "end_angle": 0.5, "ranges": RANGES, "intensities": []}  # fmt: skip


def camel(entry: dict[str, Any]) -> dict[str, Any]:
    def name(key: str) -> str:
        first, *more = key.split("_")
        return first + "".join(word.title() for word in more)

    return {name(key): value for key, value in entry.items()}


def csm(k: int) -> dict[str, Any]:
    return {"nrays": 3, "min_theta": -0.5, "max_theta": 0.5, "theta": ANGLES, "valid": [1, 1, 0],
            "readings": [1.5, 2.5, None], "odometry": [k, 0.5, 0.1], "true_pose": [None] * 3,
            "timestamp": [1_700_000_000 + k, 500_000]}  # fmt: skip


FORMS = {
    "rosbridge": lambda k: {"op": "publish", "topic": "/scan", "msg": message(k, "secs", "nsecs")},
    "data": lambda k: {"data": message(k)},
    "foxglove": lambda k: foxglove(k, {"sec": 1_700_000_000 + k, "nsec": 500_000_000}),
    "protobuf": lambda k: camel(foxglove(k, f"2023-11-14T22:13:{20 + k}.500Z")),
    "mcap": lambda k: {"topic": "/scan", "log_time": 5, "message": camel(message(k))},
    "nanoseconds": lambda k: {
        **message(k), "header": {}, "timestamp": 10**9 * (1_700_000_000 + k) + 5 * 10**8
    },
    "csm": csm,
}  # fmt: skip


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize(
    "whole", ["lines", "lines called .json", "array", "object", "one after the other"]
)
def test_json_of_other_programs(tmp_path: Path, form: str, whole: str) -> None:
    entries = [FORMS[form](k) for k in range(N)]
    path = tmp_path / ("a.jsonl" if whole == "lines" else "a.json")
    one_by_one = "\n".join(json.dumps(entry, indent=1) for entry in entries)
    texts = {
        "one after the other": one_by_one,
        "array": json.dumps(entries, indent=1),
        "object": json.dumps({"scans": entries}),
    }
    path.write_text(texts.get(whole, "\n".join(map(json.dumps, entries)) + "\n"))
    scans = load_scans(path)
    assert len(scans) == N
    expected = [1.5, 2.5, math.nan] if form == "csm" else RANGES
    np.testing.assert_array_equal(scans[1].ranges, expected)
    np.testing.assert_allclose(scans[1].angles, ANGLES)
    np.testing.assert_allclose(scans.stamps, 1_700_000_000.5 + np.arange(N))
    assert scans.poses is None
    assert (scans.odom is not None) == (form == "csm")


def test_the_pose_of_foxglove_is_where_the_sensor_sits(tmp_path: Path) -> None:
    said, path = foxglove(0, {"sec": 5, "nsec": 0}), tmp_path / "a.json"
    said["pose"]["orientation"] = {"x": 0.6, "y": 0.8, "z": 0, "w": 0}  # upside down
    path.write_text(json.dumps(said))
    (scan,) = load_scans(path).scans
    np.testing.assert_allclose(scan.angles, [0.5, 0.0, -0.5])
    assert scan.T_base_laser.theta == pytest.approx(2 * math.atan2(0.8, 0.6))
    path.write_text(json.dumps(said).replace('"w": 0', '"w": 1'))
    with pytest.raises(ScanError, match="scan 0: pose: tilted by more than 5 degrees"):
        load_scans(path)


@pytest.mark.parametrize("key", ["name", "child_frame_id", "label"])
def test_a_field_of_any_name_tells_lasers_apart(tmp_path: Path, key: str) -> None:
    said = {"angle_min": -0.5, "angle_increment": 0, "angle_max": 0.5, "ranges": RANGES}
    pairs = [{**said, "stamp": k // 2, key: ("front", "rear")[k % 2]} for k in range(2 * N)]
    path = tmp_path / "a.jsonl"
    path.write_text("\n".join(map(json.dumps, pairs)))
    with pytest.raises(ScanError, match=rf"one of front \({N}\), rear \({N}\)"):
        load_scans(path)
    assert len(load_scans(path, topic="rear")) == N
    files, turns = [f"{k}.csv" for k in range(2 * N)], ["there", "back"] * 9
    runs = ["first"] * 9 + ["second"] * 9  # with times that begin again
    for words in (files, ["hall", "hall", "lab", "hall"] * 2, turns, runs):
        at = [k % 9 if words is runs else k for k in range(len(words))]
        own = [{**said, "stamp": at[k], "source": f"{k}.csv", key: w} for k, w in enumerate(words)]
        path.write_text("\n".join(map(json.dumps, own)))
        np.testing.assert_allclose(load_scans(path)[7].angles, ANGLES)  # a step of 0 is none
    (tmp_path / "a.json").write_text(json.dumps([[1.0, 2.0, None, 4.0]] * 3))
    assert len(load_scans(tmp_path / "a.json", fov=1.0)[2].ranges) == 4


def test_a_table_of_ranges_in_one_object(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    said = {"angle_min": -0.5, "angle_max": 0.5, "range_max": 9.0, "stamps": [5.0, 5.1]}
    path.write_text(json.dumps({**said, "ranges": [RANGES, [1.0, None, 2.0]]}))
    scans = load_scans(path)
    np.testing.assert_array_equal(scans[1].ranges, [1.0, math.nan, 2.0])
    np.testing.assert_allclose(scans.stamps, [5.0, 5.1])


def test_a_recording_of_rosbridge_has_its_lasers_and_odometry(tmp_path: Path) -> None:
    path, pose = tmp_path / "a.jsonl", pose_fields(Pose2D(2.0, 1.0, 0.5))
    odom = {"header": message(1)["header"], "child_frame_id": "base", "pose": {"pose": pose}}
    links = [
        {"header": odom["header"] | {"frame_id": "base"}, "child_frame_id": laser,
         "transform": pose_fields(Pose2D(x, 0.0, 0.0))}
        for laser, x in (("laser", 0.25), ("back", -0.25))
    ]  # fmt: skip
    rear = {**(m := message(1)), "header": {**m["header"], "frame_id": "back"}}
    said = {"/x": {"data": {}}, "/odom": odom, "/tf_static": {"transforms": links}, "/rear": rear}
    lines = [{"topic": topic, "msg": entry} for topic, entry in said.items()]
    path.write_text(
        "\n".join(map(json.dumps, [*(FORMS["rosbridge"](k) for k in range(N)), *lines]))
    )
    scans = load_scans(path)
    assert (len(scans), scans[1].T_base_laser) == (N, Pose2D(0.25, 0.0, 0.0))
    np.testing.assert_allclose(scans.odom[1], (2.0, 1.0, 0.5))
    assert load_scans(path, topic="/scan,/rear").lasers == ["/scan", "/rear"]
    assert load_scans(path, topic="/rear")[0].T_base_laser.x == -0.25
    run = call("inspect", path, "--topic", "/rear")
    assert all(
        said in run.out for said in ("/odom (1 Odometry)", "taken       scans /rear, odometry")
    )
    with pytest.raises(ScanError, match=r"no scans on /no; it has /rear \(1\), /scan"):
        load_scans(path, topic="/no")


def test_one_bad_scan_of_an_array_is_left_out(tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    path.write_text(json.dumps([*[message(k) for k in range(200)], 5]))
    assert len(load_scans(path)) == 200
