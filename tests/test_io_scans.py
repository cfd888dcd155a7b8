"""Scan files: NPZ, CSV, JSON lines; what is kept as recorded and what is refused."""

import contextlib
import io
import json
import zipfile
from pathlib import Path

import numpy as np
import pytest
from badfiles import npz
from hypothesis import given
from hypothesis import strategies as st

from imgloc import ConfigError, LaserScan, OutputError, Pose2D, ScanError, load_scans, save_scans
from imgloc.io.scans import SCAN_ENDINGS, read_npz, write_npz
from imgloc.io.scanset import ScanSet, collect

ANGLES = np.linspace(-1.5, 1.5, 4)
RANGES = np.array([[1.0, np.nan, np.inf, 3.0], [0.01, -np.inf, 81.9, 2.5]])


def same(a: ScanSet, b: ScanSet) -> None:
    assert len(a) == len(b)
    for p, q in zip(a.scans, b.scans, strict=True):
        np.testing.assert_array_equal(p.ranges, q.ranges)
        np.testing.assert_array_equal(p.angles, q.angles)
        assert (p.range_min, p.range_max) == (q.range_min, q.range_max)
    for key in ("poses", "stamps", "odom"):
        x, y = getattr(a, key), getattr(b, key)
        assert (x is None) == (y is None)
        if x is not None:
            np.testing.assert_array_equal(x, y)


def test_npz_keeps_ranges_as_recorded(tmp_path: Path) -> None:
    path = tmp_path / "s.NPZ"
    path.write_bytes(npz(ranges=RANGES, angles=ANGLES, range_min=0.05, range_max=80.0))
    scans = load_scans(path)
    assert len(scans) == 2
    np.testing.assert_array_equal([s.ranges for s in scans.scans], RANGES)
    np.testing.assert_array_equal(scans[1].angles, ANGLES)
    assert scans[0].counts == {"valid": 2, "no_return": 1, "too_close": 0, "nan": 1}
    assert scans[1].counts == {"valid": 1, "no_return": 1, "too_close": 2, "nan": 0}
    assert scans.poses is scans.stamps is scans.odom is None
    assert np.isnan(scans[0].stamp)


def test_npz_defaults_and_short_forms(tmp_path: Path) -> None:
    path = tmp_path / "s.npz"
    path.write_bytes(npz(ranges=[1, 2, 3], angle_min=-0.1, angle_increment=0.1, note="lab"))
    (scan,) = load_scans(path).scans
    assert (scan.range_min, scan.range_max) == (0.0, np.inf)
    np.testing.assert_allclose(scan.angles, [-0.1, 0.0, 0.1])
    path.write_bytes(npz(ranges=RANGES[0], angles=ANGLES, poses=[1, 2, 3], stamps=9.5))
    scans = load_scans(path)
    assert scans.poses.tolist() == [[1, 2, 3]]
    assert scans[0].stamp == 9.5


def test_npz_angles_and_limits_per_scan(tmp_path: Path) -> None:
    path = tmp_path / "s.npz"
    angles = np.stack([ANGLES, ANGLES[::-1]])
    path.write_bytes(npz(ranges=RANGES, angles=angles, range_max=np.array([5.0, 6.0])))
    scans = load_scans(path)
    np.testing.assert_array_equal(scans[1].angles, ANGLES[::-1])
    assert [s.range_max for s in scans.scans] == [5.0, 6.0]


def test_fortran_order_and_float16(tmp_path: Path) -> None:
    path = tmp_path / "s.npz"
    ranges = np.asfortranarray(np.arange(8).reshape(2, 4).astype(np.float16))
    path.write_bytes(npz(ranges=ranges, angles=ANGLES))
    np.testing.assert_array_equal([s.ranges for s in load_scans(path).scans], ranges)


def test_duplicate_and_unsorted_angles_are_fine(tmp_path: Path) -> None:
    path = tmp_path / "s.npz"
    path.write_bytes(npz(ranges=RANGES, angles=[0.3, 0.3, -1, 6.2]))
    assert load_scans(path)[0].angles.tolist() == [0.3, 0.3, -1, 6.2]


def test_file_size_is_not_what_an_npz_is_judged_by(tmp_path: Path) -> None:
    path = tmp_path / "s.npz"
    path.write_bytes(npz(ranges=np.zeros((8000, 6251), np.uint8), angles=np.zeros(6251)))
    assert path.stat().st_size < 10**6
    with pytest.raises(ScanError, match="ranges: 8000 x 6251 numbers, expected at most 50,000,000"):
        load_scans(path)


def a_set(n: int = 3, b: int = 5, **extra) -> ScanSet:
    rng = np.random.default_rng(n)
    ranges = rng.uniform(0, 9, (n, b))
    angles = np.sort(rng.uniform(-2, 2, b))
    return ScanSet(tuple(LaserScan(r, angles, 0.1, 8.0) for r in ranges), **extra)


def test_save_and_load_give_the_same_scans(tmp_path: Path) -> None:
    extra = {"poses": np.ones((3, 3)) / 3, "stamps": np.arange(3.0), "odom": np.zeros((3, 3))}
    for scans in (a_set(), a_set(**extra)):
        path = tmp_path / f"{scans.poses is None}.npz"
        save_scans(path, scans)
        same(load_scans(path), scans)
    mixed = ScanSet((LaserScan(RANGES[0], ANGLES), LaserScan(RANGES[1], -ANGLES, 0.1, 5)))
    save_scans(tmp_path / "mixed.npz", mixed)
    same(load_scans(tmp_path / "mixed.npz"), mixed)


def test_equal_scans_are_equal_bytes() -> None:
    data = write_npz(a_set())
    assert data == write_npz(a_set())
    with zipfile.ZipFile(io.BytesIO(data)) as archive:  # at any time of the day
        assert {member.date_time for member in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}


def test_save_refuses(tmp_path: Path) -> None:
    path = tmp_path / "s.npz"
    path.write_bytes(b"mine")
    with pytest.raises(OutputError, match="exists already"):
        save_scans(path, a_set())
    assert path.read_bytes() == b"mine"
    save_scans(path, a_set(), force=True)
    same(load_scans(path), a_set())
    with pytest.raises(ConfigError, match=r"\.npz"):
        save_scans(tmp_path / "s.csv", a_set())
    ragged = ScanSet((LaserScan([1.0], [0.0]), LaserScan([1.0, 2.0], [0.0, 1.0])))
    with pytest.raises(ConfigError, match=r"\[1, 2\] readings"):
        save_scans(tmp_path / "t.npz", ragged)
    assert not (tmp_path / "t.npz").exists()


def test_scan_set_checks_its_shapes_and_is_read_only() -> None:
    with pytest.raises(ValueError, match=r"poses \(2, 3\) must be \(3, 3\)"):
        a_set(poses=np.zeros((2, 3)))
    mine = np.zeros(3)
    scans = a_set(stamps=mine)
    mine[0] = 7
    assert scans.stamps[0] == 0
    with pytest.raises(ValueError, match="read-only"):
        scans.stamps[0] = 1


# ---- CSV -------------------------------------------------------------------------------


def csv(tmp_path: Path, text: str) -> ScanSet:
    path = tmp_path / "s.csv"
    path.write_text(text)
    return load_scans(path)


def test_csv_one_scan_a_line(tmp_path: Path) -> None:
    scans = csv(
        tmp_path,
        "# lidar of the lab\n# angle_min=-0.2, angle_max=0.2, range_min: 0.05, range_max=30\n"
        "1, nan, inf\n\n4,,-inf\n",
    )
    np.testing.assert_array_equal(scans[0].ranges, [1, np.nan, np.inf])
    np.testing.assert_array_equal(scans[1].ranges, [4, np.nan, -np.inf])
    np.testing.assert_allclose(scans[1].angles, [-0.2, 0, 0.2])
    assert (scans[0].range_min, scans[0].range_max) == (0.05, 30)
    assert scans.poses is None
    assert scans.stamps is None


def test_csv_with_names_stamp_and_pose(tmp_path: Path) -> None:
    scans = csv(
        tmp_path,
        "# angle_min=0, angle_increment=0.5\nstamp,x,r0,y,r1,theta\n"
        "7.5,1,10,2,11,3\n8,4,12,5,13,6\n",
    )
    assert scans[1].ranges.tolist() == [12, 13]
    assert scans[1].angles.tolist() == [0, 0.5]
    assert scans.poses.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert scans.stamps.tolist() == [7.5, 8]


def test_csv_with_odometry(tmp_path: Path) -> None:
    head = "# angle_min=0, angle_increment=0.5\n"
    scans = csv(
        tmp_path, f"{head}stamp,odom_x,odom_y,odom_theta,r0,r1\n7,1,2,0.5,10,11\n8,4,5,0.6,12,13\n"
    )
    assert scans.poses is None
    assert scans.odom.tolist() == [[1, 2, 0.5], [4, 5, 0.6]]
    assert scans[1].ranges.tolist() == [12, 13]
    with pytest.raises(ScanError, match="columns odom_x, expected all of odom_x, odom_y, odom_th"):
        csv(tmp_path, f"{head}odom_x,r0,r1\n1,10,11\n")


def test_csv_with_columns_that_are_no_ranges(tmp_path: Path) -> None:
    head = "# angle_min=0, angle_increment=0.5\n"
    with pytest.raises(ScanError, match="columns yaw_deg, expected all of x, y, theta"):
        csv(tmp_path, f"{head}time,yaw_deg,d0,d1,d2\n7,1,2,3,4\n")
    assert len(csv(tmp_path, f"{head}left,front,right\n2,3,4\n")[0].ranges) == 3


def test_csv_of_angle_and_range_is_one_scan(tmp_path: Path) -> None:
    (scan,) = csv(tmp_path, "# range_max=9\r\nrange,Angle,intensity\r\n5,-1,0\r\n6,1,0\r\n").scans
    assert scan.ranges.tolist() == [5, 6]
    assert scan.angles.tolist() == [-1, 1]
    assert scan.range_max == 9


# ---- JSON lines ------------------------------------------------------------------------


def test_jsonl_with_the_names_of_laserscan(tmp_path: Path) -> None:
    path = tmp_path / "s.jsonl"
    entries = [
        {"header": {"stamp": {"sec": 12, "nanosec": 500_000_000}, "frame_id": "laser"},
         "angle_min": -0.5, "angle_max": 0.5, "angle_increment": 0.5, "range_min": 0.1,
         "range_max": "inf", "ranges": [1, None, "inf"], "pose": [1, 2, 3]},
        {"angles": [0, 1], "ranges": ["-inf", "NaN"], "pose": {"theta": 6, "x": 4, "y": 5}},
    ]  # fmt: skip
    path.write_text("\n".join(json.dumps(e) for e in entries) + "\n\n")
    scans = load_scans(path)
    np.testing.assert_array_equal(scans[0].ranges, [1, np.nan, np.inf])
    np.testing.assert_array_equal(scans[1].ranges, [-np.inf, np.nan])
    assert scans[0].angles.tolist() == [-0.5, 0, 0.5]
    assert (scans[0].range_min, scans[0].range_max) == (0.1, np.inf)
    assert scans.poses.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert scans.stamps is not None
    np.testing.assert_array_equal(scans.stamps, [12.5, np.nan])


def test_json_array_object_and_python_style_numbers(tmp_path: Path) -> None:
    path = tmp_path / "s.json"
    entry = {"ranges": [1.0, float("nan"), float("inf")], "angle_min": 0, "angle_max": 1}
    for whole in (entry, [entry, entry]):
        path.write_text(json.dumps(whole, indent=2))
        scans = load_scans(path)
        assert len(scans) == (len(whole) if isinstance(whole, list) else 1)
        np.testing.assert_array_equal(scans[-1].ranges, entry["ranges"])
        assert scans[0].angles.tolist() == [0, 0.5, 1]


@pytest.mark.parametrize("key", ["ranges", "angles", "mount"])
def test_true_is_no_number_beside_numbers_either(tmp_path: Path, key: str) -> None:
    entry = {"ranges": [1.0, 2.0, 3.0], "angles": [0, 1, 2], "mount": [0.1, 0, 0]}
    (tmp_path / "s.jsonl").write_text(json.dumps({**entry, key: [True, 0.5, 1]}))
    with pytest.raises(ScanError, match=f"line 1: {key}: got true or false"):
        load_scans(tmp_path / "s.jsonl")


def test_angle_max_may_be_the_ray_after_the_last(tmp_path: Path) -> None:
    path = tmp_path / "s.jsonl"
    entry = {"ranges": [1] * 4, "angle_min": 0, "angle_increment": 0.25, "angle_max": 1}
    path.write_text(json.dumps(entry))
    assert load_scans(path)[0].angles.tolist() == [0, 0.25, 0.5, 0.75]


# ---- damage ----------------------------------------------------------------------------

GOOD = write_npz(a_set(poses=np.zeros((3, 3))))


@given(data=st.data())
def test_every_truncation_of_an_npz_is_refused(data, tmp_path_factory):
    path = tmp_path_factory.getbasetemp() / "t.npz"
    path.write_bytes(GOOD[: data.draw(st.integers(0, len(GOOD) - 1))])
    with pytest.raises(ScanError, match=r"t\.npz: "):
        load_scans(path)


def test_no_single_byte_can_take_range_max_away(tmp_path: Path) -> None:
    path = tmp_path / "d.npz"
    lost = []
    for at in range(len(GOOD) - 300, len(GOOD)):  # the directory of the archive
        path.write_bytes(
            GOOD[:at] + bytes([GOOD[at] ^ (0x01, 0x40, 0x76)[at % 3]]) + GOOD[at + 1 :]
        )
        with contextlib.suppress(ScanError):
            lost += [at] * (load_scans(path)[0].range_max != 8.0)
    assert lost == []


@given(data=st.data())
def test_a_damaged_npz_gives_the_same_ranges_or_an_error(data, tmp_path_factory):
    path = tmp_path_factory.getbasetemp() / "d.npz"
    bad = bytearray(GOOD)
    for _ in range(data.draw(st.integers(1, 3))):
        bad[data.draw(st.integers(0, len(GOOD) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(bad)
    message = ""
    try:
        np.testing.assert_array_equal(read_npz(path)[0].ranges, a_set()[0].ranges)
    except ScanError as e:
        message = str(e)
    assert "\n" not in message


def test_real_scans(shared: Path) -> None:
    paths = sorted((shared / "data").glob("*/scans*.npz"))
    assert paths
    for path in paths:
        scans = load_scans(path)
        assert scans.poses is not None
        assert scans.stamps is not None
        assert (scans.odom is not None) == (
            path.parent.name in ("duke_loop5", "wean") and "map" not in path.name
        )
        assert all(s.valid.sum() > 20 for s in scans.scans[:20]), path
    assert load_scans(shared / "data" / "duke_loop5" / "scans.npz")[0].range_max == 8.0


def test_a_topic_is_of_logs_that_have_some(tmp_path):
    path = tmp_path / "a.npz"
    save_scans(path, ScanSet((LaserScan([1.0], [0.0]),)))
    with pytest.raises(ScanError, match=r"a.npz: has one laser, expected no topic, got /scan"):
        load_scans(path, topic="/scan")
    said = '{{"ranges": [{}], "angles": [0], "header": {{"frame_id": "{}"}}}}\n'
    (path := tmp_path / "two.jsonl").write_text(said.format(1, "a") + said.format(2, "b"))
    with pytest.raises(ScanError, match=r"pass `topic`, one of a \(1\), b \(1\)"):
        load_scans(path)
    assert load_scans(path, topic="b")[0].ranges.tolist() == [2.0]


def test_where_each_sensor_sits_is_a_row_or_not_known(tmp_path: Path) -> None:
    data = {"ranges": np.ones((2, 4)), "angles": np.arange(4.0), "range_max": 9.0}
    np.savez(tmp_path / "s.npz", **data, mount=[[0.1, 0.2, 0.3], [np.nan] * 3])
    first, second = load_scans(tmp_path / "s.npz").scans
    assert first.T_base_laser == Pose2D(0.1, 0.2, 0.3)
    assert second.T_base_laser is None
    np.savez(tmp_path / "s.npz", **data, mount=[[0.1, 0.2, 0.3], [0.1, np.nan, 0.3]])
    with pytest.raises(ScanError, match="mount"):
        load_scans(tmp_path / "s.npz")


def test_odometry_may_be_unknown_at_some_scans() -> None:
    odom = np.array([[1.0, 2.0, 0.5], [np.nan] * 3])  # as of a bag
    entry = {"ranges": [1.0, 2.0], "angles": [0.0, 0.1], "range_max": 9.0}
    scans = collect([(f"scan {k}", entry | {"odom": row}) for k, row in enumerate(odom)], "a.bag")
    np.testing.assert_array_equal(scans.odom, odom)


def test_an_ending_of_scans_has_one_dot_as_path_suffix_has() -> None:
    assert [ending for ending in SCAN_ENDINGS if ending.count(".") != 1] == []
