"""`imgloc convert`: each form is read back as what it was made of."""

from pathlib import Path

import numpy as np
import pytest
from command import call

from imgloc import LaserScan, Pose2D, ScanSet, load_scans, save_scans

N, ANGLES = 5, np.linspace(-1.5, 1.5, 31)


@pytest.fixture
def log(tmp_path: Path) -> Path:
    ranges = np.random.default_rng(4).uniform(1, 8, (N, 31))
    ranges[:, 3], ranges[:, 4] = np.inf, np.nan
    stamps = 100.5 + np.arange(N)
    scans = tuple(
        LaserScan(r, ANGLES, 0.25, 8.5, t, Pose2D(0.25, 0, 0.5))
        for r, t in zip(ranges, stamps, strict=True)
    )
    odom = np.column_stack([np.arange(N), np.zeros(N), 0.1 * np.arange(N)])
    save_scans(tmp_path / "a.npz", ScanSet(scans, odom + 1, stamps, odom))
    return tmp_path / "a.npz"


@pytest.mark.parametrize("ending", ["csv", "jsonl", "npz", "mcap"])
def test_a_log_in_another_form_is_the_same_log(log: Path, ending: str) -> None:
    if ending == "mcap":
        pytest.importorskip("rosbags", reason="writes bags: the extra ros")
    out = log.with_name(f"b.{ending}")
    call("convert", log, out).ends(0, "b.")
    a, b = load_scans(log), load_scans(out)
    close = 1e-6 if ending == "mcap" else 1e-12  # float32
    for one, other in zip(a.scans, b.scans, strict=True):
        np.testing.assert_allclose(one.ranges, other.ranges, rtol=close)
        np.testing.assert_allclose(one.angles, other.angles, atol=close)
        assert (one.range_min, one.range_max) == (other.range_min, other.range_max)
        assert one.stamp == other.stamp
        if ending != "csv":
            np.testing.assert_allclose(list(one.T_base_laser), list(other.T_base_laser), atol=close)
    np.testing.assert_allclose(a.odom, b.odom, atol=1e-9)
    assert (b.poses is None) == (ending == "mcap")
    assert call("convert", log, out).code == 1  # it is there
    again = out.read_bytes()
    assert call("convert", log, out, "--force", "--scans-index", "1:3").code == 0
    assert len(load_scans(out)) == 2
    assert call("convert", log, out, "--force").code == 0
    assert out.read_bytes() == again or ending == "mcap"


def test_what_a_form_cannot_hold_is_one_error(log: Path, tmp_path: Path) -> None:
    call("convert", log, tmp_path / "a.xyz").ends(2, "ends in .csv or .jsonl")
    uneven = LaserScan(np.ones(30), np.linspace(-1, 1, 30) ** 3, 0.1, 9.0)
    save_scans(tmp_path / "u.npz", ScanSet((uneven,)))
    call("convert", tmp_path / "u.npz", tmp_path / "u.csv").ends(2, "end the name in .jsonl")
    assert call("convert", tmp_path / "u.npz", tmp_path / "u.jsonl").code == 0
    np.testing.assert_allclose(load_scans(tmp_path / "u.jsonl")[0].angles, uneven.angles)
    assert not (tmp_path / "u.csv").exists()


@pytest.mark.parametrize("ending", ["jsonl", "npz", "mcap", "csv"])
def test_lasers_of_a_robot_stay_apart(tmp_path: Path, ending: str) -> None:
    pytest.importorskip("rosbags", reason="writes bags: the extra ros")
    # The second one is turned, and moves on the robot.
    mounts = [Pose2D(0.25, 0, 0), Pose2D(-0.25, 0, 3)] * 2 + [Pose2D(0.25, 0, 0), Pose2D(-1, 0, 3)]
    scans = tuple(
        LaserScan(np.full(31, 1.0 + k), ANGLES, 0.25, 8.5, 5.0 + k // 2, m, laser="01"[k % 2])
        for k, m in enumerate(mounts)
    )
    odom = np.repeat(np.arange(3.0), 2)[:, None] * (1, 0, 0.1)
    save_scans(tmp_path / "a.npz", ScanSet(scans, odom=odom))
    run = call("convert", tmp_path / "a.npz", out := tmp_path / f"b.{ending}")
    if ending == "csv":
        assert (run.code, "names the laser" in run.err) == (2, True)
        return
    back = load_scans(out, topic="/laser_0/scan,/laser_1/scan" if ending == "mcap" else None)
    assert len({scan.laser for scan in back.scans}) == 2
    for one, other in zip(scans, back.scans, strict=True):
        assert other.ranges[0] == one.ranges[0]
        np.testing.assert_allclose(list(one.T_base_laser), list(other.T_base_laser), atol=1e-9)
    np.testing.assert_allclose(back.odom, odom, atol=1e-9)
