"""Messages as ROS prints them, files whose names tell nothing, and those that others convert."""

import logging
import math
from pathlib import Path

import numpy as np
import pytest

from imgloc.errors import ScanError
from imgloc.io.scans import load_scans, scans_size

ROS2 = """header:
  stamp:
    sec: 12
    nanosec: 500000000
  frame_id: laser
angle_min: -1.0
angle_max: 1.0
angle_increment: 1.0
time_increment: 0.0
scan_time: 0.0
range_min: 5e-2
range_max: 30.0
ranges:
- 1.0
- .inf
- .nan
intensities: []
---
"""
ROS1 = """header:
  seq: 4
  stamp:
    secs: 12
    nsecs: 500000000
  frame_id: "laser"
angle_min: -1e0
angle_increment: 1.0
range_min: 0.05
range_max: 30.0
ranges: [1.0, inf, nan]
intensities: []
---
"""


@pytest.mark.parametrize("text", [ROS2, ROS1])
def test_echo_of_either_ros(tmp_path: Path, text: str) -> None:
    path = tmp_path / "a.yaml"
    path.write_text(2 * text)
    scans = load_scans(path)
    assert len(scans) == 2
    np.testing.assert_array_equal(scans[1].ranges, [1.0, math.inf, math.nan])
    assert scans[1].angles.tolist() == [-1.0, 0.0, 1.0]
    assert (scans[1].range_min, scans[1].range_max, scans[1].stamp) == (0.05, 30.0, 12.5)
    size = scans_size(path)
    assert size.scans >= 2
    assert size.numbers >= 12


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            ROS2.replace("- .nan", "- '...'"),
            "shortened after 2 readings; print all of them: ros2 topic echo -f",
        ),
        ("image: a.png\nresolution: 0.05\norigin: [0, 0, 0]\n", "a map's YAML: the order is MAP"),
        ("a: &x 1\nranges: [1]\n", "line 1: YAML anchor &x, expected plain"),
        ("ranges: [1, 2\n", "message 0: line 2: not valid YAML"),
        ("ranges: [1, 2]\nangle_min: left\nangle_max: 1\n", "angle_min: got 'left'"),
        ("hello\n", "expected the fields of a LaserScan"),
    ],
)
def test_what_cannot_be_used_is_one_error(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "a.yaml"
    path.write_text(text)
    with pytest.raises(ScanError, match=message):
        load_scans(path)


@pytest.mark.parametrize(
    "text",
    [
        ROS2,
        '{"ranges": [1.0, 2.0, 3.0], "angle_min": -1, "angle_max": 1}\n',
        "# angle_min=-1, angle_max=1\n1.0,2.0,3.0\n",
        "FLASER 181 " + 181 * "1.0 " + "0 0 0 0 0 0 1 h 1\n",
        "-1.0,1.0\n0.0,2.0\n1.0,3.0\n",
    ],
)
def test_content_tells_what_a_name_does_not(tmp_path: Path, text: str) -> None:
    for name in ("a.txt", "a"):
        path = tmp_path / name
        path.write_text(text)
        scans = load_scans(path)
        assert len(scans) == 1
        assert scans[0].ranges[0] == 1.0
        assert scans_size(path).scans >= 1


def test_what_others_convert_is_said_with_how(tmp_path: Path) -> None:
    for name, hint in (
        ("a.npy", r"np\.savez"), ("a.pcap", "record a bag"), ("a.bag.active", "rosbag reindex"),
        ("a.rawlog.gz", "rawlog-edit"), ("a.mat", "loadmat"),
        ("a.parquet", "read_parquet"), ("a.h5", "h5py"),
    ):  # fmt: skip
        (tmp_path / name).write_bytes(b"1")
        with pytest.raises(ScanError, match=f"{name}: cannot be read: .*{hint}"):
            load_scans(tmp_path / name)
    with pytest.raises(ScanError, match="is a folder, expected a file of scans"):
        load_scans(tmp_path)


LOST = "A message was lost!!!\n\ttotal count change:2\n\ttotal count: 2---\n"


@pytest.mark.parametrize("bad", [
    ROS2.replace("- 1.0\n- .inf\n- .nan\n", "[]\n").replace("ranges:\n[]", "ranges: []"),
    ROS2.replace("angle_increment: 1.0", "angle_increment: .nan"),
    ROS2.replace("- .inf", "- '...'\n"), "header: [\n---\n", "data: 5\n---\n",
])  # fmt: skip
def test_a_broken_message_is_left_out(tmp_path: Path, caplog, monkeypatch, bad: str) -> None:
    monkeypatch.setattr(logging.getLogger("imgloc"), "propagate", True)
    path = tmp_path / "a.yaml"
    path.write_text(ROS2 + LOST + 60 * ROS2 + "[INFO] [5.1]: spinning up\n" + bad + 60 * ROS2)
    assert len(load_scans(path)) == 121
    assert "lacks 2 message(s)" in caplog.text
    assert "left out 1 of 122 messages, which are broken: message 61: " in caplog.text
    with pytest.raises(ScanError, match=r"message 61: .*\(1 of 122 is broken; `max_bad=0.01`"):
        load_scans(path, max_bad=0.0)


def test_a_message_that_was_cut_off_is_left_out(tmp_path: Path, caplog, monkeypatch) -> None:
    monkeypatch.setattr(logging.getLogger("imgloc"), "propagate", True)
    path = tmp_path / "a.yaml"
    path.write_text(2 * ROS2 + ROS2[: ROS2.index("- .inf")])
    assert len(load_scans(path)) == 2
    assert "the last message was cut off and is left out" in caplog.text
