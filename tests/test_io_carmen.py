"""CARMEN logs: each kind of message, what the whole log says of them, and logs of others."""

import gzip
import math
from pathlib import Path

import numpy as np
import pytest

from imgloc import Odometry, Pose2D, ScanError, load_scans
from imgloc.io.carmen import read_carmen
from imgloc.io.scans import scans_size
from imgloc.model import compose

RANGES = " ".join(f"{1 + i / 100:.2f}" for i in range(181))
FLASER = f"FLASER 181 {RANGES} 1.2 2 0.5 1 2 0.5 1211.5 host 3.5"


def log(folder: Path, *lines: str, end: str = "\n") -> Path:
    path = folder / "a.log"
    path.write_text("\n".join(lines) + end)
    return path


def test_flaser_has_the_robot_pose_the_stamp_and_a_sick_s_angles(tmp_path: Path) -> None:
    scans = load_scans(log(tmp_path, "# a comment", "ODOM 0 0 0 0 0 0 1 h 1", FLASER))
    (scan,) = scans.scans
    np.testing.assert_allclose(scan.ranges, 1 + np.arange(181) / 100)
    np.testing.assert_allclose(scan.angles, np.deg2rad(np.arange(-90, 91)))
    assert (scan.range_max, scan.stamp) == (80.0, 1211.5)
    assert scans.odom.tolist() == [[1.0, 2.0, 0.5]]
    assert scans.poses is None


def test_robotlaser_of_both_ages_is_the_same_scan(tmp_path: Path) -> None:
    head = "ROBOTLASER1 0 -1.0 2.0 0.5 30.0 0.01 0 5 1 2 3 4 5"
    tail = "0.3 0 0 0 0 0 0 0 0 0 0 12.5 host 1.5"
    kinds = (f"{head} {tail}", f"{head} 0 {tail}", f"{head} 5 9 8 7 6 5 {tail}")
    for line in kinds:
        (scan,) = load_scans(log(tmp_path, line)).scans
        assert scan.ranges.tolist() == [1, 2, 3, 4, 5]
        assert scan.angles.tolist() == [-1, -0.5, 0, 0.5, 1]
        assert (scan.range_max, scan.stamp) == (30.0, 12.5)
        assert scan.T_base_laser == Pose2D(0.3, 0.0, 0.0)
    with pytest.raises(ScanError, match=r"line 1: ROBOTLASER1: got 30 words, expected 5 readings"):
        load_scans(log(tmp_path, f"{head} 3 2 {tail}", FLASER))


def test_laser_poses_that_move_against_the_robot_are_a_mapper_s(tmp_path: Path) -> None:
    corrected = FLASER.replace("1.2 2 0.5 1 2", "1.5 2.4 0.6 1 2")
    scans = load_scans(log(tmp_path, FLASER, corrected))
    assert scans.poses.tolist() == [[1.2, 2, 0.5], [1.5, 2.4, 0.6]]
    assert scans[0].T_base_laser is None


def test_angles_of_other_scanners_come_from_parameters_or_the_user(tmp_path: Path) -> None:
    line = "FLASER 5 1 2 3 4 5 0 0 0 0 0 0 1 h 1"
    with pytest.raises(ScanError, match=r"line 1: FLASER: 5 readings, .* pass `fov`"):
        load_scans(log(tmp_path, line))
    (scan,) = load_scans(log(tmp_path, line), fov=math.pi).scans
    np.testing.assert_allclose(scan.angles, np.deg2rad([-90, -45, 0, 45, 90]))
    said = ("PARAM laser_front_laser_resolution 30 h 0", "PARAM robot_front_laser_max 4.5 h 0")
    (scan,) = load_scans(log(tmp_path, *said, line)).scans
    np.testing.assert_allclose(scan.angles, np.deg2rad([-60, -30, 0, 30, 60]))
    assert scan.range_max == 4.5
    with pytest.raises(ScanError, match="robot_front_laser_max: got 'far', expected a positive"):
        load_scans(log(tmp_path, "PARAM robot_front_laser_max far h 0", line))


def test_raw_lasers_take_their_odometry_from_the_lines_of_the_log(tmp_path: Path) -> None:
    raw = "RAWLASER1 0 -1 2 1 30 0.01 0 3 1 2 3 0 {} h 0"
    odom = ("ODOM 0 0 3 0 0 0 10 h 0", "ODOM 2 0 -3 0 0 0 11 h 1")
    scans = load_scans(log(tmp_path, odom[0], raw.format(10.5), raw.format(10.75), odom[1]))
    np.testing.assert_allclose(scans.odom[0], [1, 0, math.pi])
    assert scans.odom[1, 2] < -3
    assert load_scans(log(tmp_path, odom[0], raw.format(15))).odom is None
    assert Odometry().along(np.array([1.0])) is None


def test_a_laser_is_chosen_by_name(tmp_path: Path) -> None:
    path = log(tmp_path, FLASER.replace("FLASER", "RLASER").replace(" 1.00 ", " 7.0 "), FLASER)
    assert load_scans(path)[0].ranges[0] == 1.0
    assert load_scans(path, topic="RLASER")[0].ranges[0] == 7.0
    with pytest.raises(ScanError, match=r"no messages ROBOTLASER1; it has FLASER \(1\), RLASER"):
        load_scans(path, topic="ROBOTLASER1")


def test_front_and_rear_are_one_set_each_at_its_place(tmp_path: Path) -> None:
    rear = f"RLASER 181 {RANGES} 0.7 2 3.6415926 1 2 0.5 1211.4 host 3.5"
    front = FLASER.replace("1.2 2 0.5 1 2", "1 2 0.5 1 2")
    path = log(tmp_path, front, rear)
    scans = load_scans(path, topic="FLASER,RLASER")
    back, at = (scan.T_base_laser for scan in scans.scans)
    assert scans.stamps.tolist() == [1211.4, 1211.5]
    assert at == Pose2D(0.0, 0.0, 0.0)
    assert back.x == pytest.approx(-0.2633, abs=1e-3)
    assert abs(back.theta) == pytest.approx(math.pi, abs=1e-4)
    assert load_scans(path, topic="FLASER")[0].T_base_laser is None
    with pytest.raises(ScanError, match="FLASER: no stamps"):
        load_scans(log(tmp_path, front.replace("1211.5", "nan"), rear), topic="FLASER,RLASER")


def test_a_line_that_is_cut_off_is_an_error_but_for_the_last(tmp_path: Path) -> None:
    half = FLASER[:300]
    assert len(load_scans(log(tmp_path, FLASER, half, end=""))) == 1
    with pytest.raises(
        ScanError, match="line 1: FLASER: 60 words, expected 189 or more: 181 readings"
    ):
        load_scans(log(tmp_path, half, FLASER))
    with pytest.raises(ScanError, match="line 1: FLASER: 60 words, expected 189 or more"):
        load_scans(log(tmp_path, half))
    with pytest.raises(ScanError, match="no line of a laser, expected FLASER"):
        load_scans(log(tmp_path, "hello"))


def test_stamps_without_digits_are_none(tmp_path: Path) -> None:
    path = log(tmp_path, *[FLASER.replace("1211.5", "1.01893e+09")] * 3)
    assert load_scans(path).stamps is None


@pytest.mark.parametrize(
    ("name", "file"),
    [("belgioioso", "belgioioso.log"), ("fr079", "fr079.log"),
     ("duke_loop5", "duke_loop5.dpslam.log")],
)  # fmt: skip
def test_logs_of_other_programs_are_the_scans_that_others_read_of_them(shared, name, file):
    data = shared / "data"
    scans, known = read_carmen(data / "raw" / file), load_scans(data / name / "scans.npz")
    odd = range(1, len(scans), 2)  # the others made the map
    assert known.poses is not None
    assert len(known) == len(odd)
    assert scans.odom is not None
    mount = scans[0].T_base_laser or Pose2D(0.0, 0.0)
    for k, (scan, i) in enumerate(zip(known.scans, odd, strict=True)):
        np.testing.assert_allclose(scans[i].ranges, scan.ranges, atol=1e-4)
        np.testing.assert_allclose(scans[i].angles, scan.angles, atol=1e-3)
        if name == "fr079":
            at = compose(Pose2D(*scans.odom[i]), mount)
            np.testing.assert_allclose([at.x, at.y], known.poses[k, :2], atol=1e-4)
            assert scans[i].stamp == scan.stamp
    if name == "duke_loop5":
        np.testing.assert_allclose(scans.odom[1::2], known.odom, atol=1e-5)
        assert scans[0].range_max == known[0].range_max


@pytest.mark.parametrize(
    ("word", "reach"),
    [(8.183, 8.0), (16.38, 16.0), (32.73, 32.0), (32.9, 80.0), (7.0, 80.0), (20.0, 80.0)],
)
def test_the_greatest_word_of_a_sick_tells_its_reach(tmp_path: Path, word: float, reach) -> None:
    (scan,) = load_scans(log(tmp_path, FLASER.replace(" 1.00 ", f" {word} "))).scans
    assert (scan.range_max, scan.counts["no_return"]) == (reach, word > reach)


def drive(n: int = 200, odom: str = "0 0 0") -> list[str]:
    return [f"FLASER 181 {RANGES} {k / 10} 2 0.5 {odom} {1000 + k}.25 pippo 0" for k in range(n)]


def test_a_few_broken_lines_are_left_out_and_named(tmp_path: Path, caplog) -> None:
    lines = drive()
    lines[50] = lines[50].replace(" 1050.25 ", " ")  # no stamp
    path = log(tmp_path, *lines)
    scans = load_scans(path)
    assert len(scans) == 199
    assert "left out 1 of 200 lines, which are broken: line 51: FLASER: the stamp" in caplog.text
    lines[60] = lines[60].replace(" 1.05 ", " 1.O5 ")
    lines[70] = lines[70][:300]
    assert len(load_scans(log(tmp_path, *lines), max_bad=0.02)) == 197
    assert "line 61: FLASER: word 8 is '1.O5', expected a range; line 71: FLASER: 60 words, " in (
        caplog.text
    )
    with pytest.raises(ScanError, match=r"line 61: .*3 of 200 are broken; `max_bad=0.02` leaves"):
        load_scans(path)


def test_odometry_that_never_moves_is_none(tmp_path: Path, caplog) -> None:
    scans = load_scans(log(tmp_path, *drive(20)))
    assert scans.odom[3].tolist() == [0.3, 2, 0.5]
    assert scans[0].T_base_laser is None
    assert "the robot's poses never change (all are 0 0 0)" in caplog.text
    still = [line.replace(f" {k / 10} 2", " 0 2", 1) for k, line in enumerate(drive(5))]
    assert load_scans(log(tmp_path, *still)).odom.tolist() == [[0, 0, 0]] * 5


def test_logs_of_courses_are_centimetres(tmp_path: Path) -> None:
    ranges = " ".join(str(100 + k) for k in range(180))
    lines = ("O 94 -139 0.5 0.03", f"L 100 200 0.5 121.94 211.99 0.5 {ranges} 0.026")
    (scan,) = (scans := load_scans(log(tmp_path, *lines))).scans
    assert scan.ranges[:2].tolist() == [1.0, 1.01]
    assert len(scan.angles) == 180
    assert np.rad2deg(scan.angles[[0, -1]]).round(6).tolist() == [-90, 89]
    assert scans.odom.tolist() == [[1, 2, 0.5]]
    assert scan.T_base_laser.x == pytest.approx(0.25, abs=1e-3)
    with pytest.raises(ScanError, match="line 1: L: 4 words, expected 9 or more"):
        load_scans(log(tmp_path, "L 1 2 3"))


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("code", ["utf-8", "utf-8-sig", "utf-16"])
def test_packed_and_marked_files_are_read(tmp_path: Path, packed: bool, code: str) -> None:
    data = FLASER.encode(code)
    for name in ("a.log", "a"):
        path = tmp_path / (name + ".gz" * packed)
        path.write_bytes(gzip.compress(data) if packed else data)
        assert load_scans(path)[0].stamp == 1211.5
        assert scans_size(path).scans == 1
    rows = "# angle_min=-1, angle_max=1\n1,2,3\n".encode(code)
    (tmp_path / "b.csv.gz").write_bytes(gzip.compress(rows))
    assert load_scans(tmp_path / "b.csv.gz")[0].ranges.tolist() == [1, 2, 3]


def test_what_gzip_unpacks_to_has_an_end(tmp_path: Path) -> None:
    path = tmp_path / "a.log.gz"
    path.write_bytes(gzip.compress(b"FLASER " * 4_000_000))
    for read in (load_scans, scans_size):
        with pytest.raises(ScanError, match=r"gzip unpacks to too much, expected at most 100"):
            read(path)
    path.write_bytes(gzip.compress(FLASER.encode())[:-20])
    with pytest.raises(ScanError, match="damaged gzip file"):
        load_scans(path)
    (tmp_path / "a.npz.gz").write_bytes(path.read_bytes())
    with pytest.raises(ScanError, match="cannot be read packed: unpack it with gunzip"):
        load_scans(tmp_path / "a.npz.gz")
