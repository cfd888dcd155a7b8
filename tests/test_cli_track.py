"""`imgloc track`."""

import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from command import MAPS, call, rows
from places import drive
from walls import thick_in

from imgloc import LaserScan, ScanSet, Shared, load_map, load_scans, save_scans
from imgloc.filters.choose import FILTERS
from imgloc.filters.motion import noisy_odometry
from imgloc.io.calibration import calibration_path, save_calibrations
from imgloc.io.images import read_image
from imgloc.model import FloatArray
from imgloc.output.tracks import COLOURS, SCAN
from imgloc.simulation.scans import simulate_ranges
from imgloc.simulation.worlds import WORLDS, render

MAP, N = MAPS / "visibility.yaml", 9
ANGLES = np.deg2rad(np.arange(-180, 180, 3.0))


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    poses = np.array([[4.0 + 0.5 * k, 8.0, 0.02 * k] for k in range(N)])
    path = tmp_path_factory.mktemp("log") / "log.npz"
    save_scans(path, drive(poses))
    return path


@pytest.fixture(scope="module")
def tracked(log: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str, str]:
    folder = tmp_path_factory.mktemp("out")
    outputs = ("--tum", folder / "a.tum", "--picture", folder / "a.png")
    outputs = (*outputs, "--video", folder / "a.webm")
    run = call("track", MAP, log, "--json", *outputs).ends(0)
    return folder, run.out, run.err


def test_a_row_for_each_scan_with_the_promised_keys(tracked: tuple[Path, str, str]) -> None:
    got = rows(tracked[1])
    assert [row["index"] for row in got] == list(range(N))
    expected = ["stamp", "age", "verdict", "pose", "covariance", "map_odom", "neff", "resets"]
    assert all(key in row for row in got for key in expected)
    assert {(row["scale"], row["thinner"], row["bent"]) for row in got} == {(1.0, 0.0, 0.0)}
    for row in got:
        assert (row["pose"] is None) == (row["verdict"] != "unique")
        assert (row["covariance"] is None) == (row["verdict"] != "unique")
    assert got[-1]["verdict"] == "unique"
    assert abs(got[-1]["pose"]["x"] - (4 + 0.5 * (N - 1))) < 0.3
    assert "x real time" in tracked[2]


def test_walls_that_are_allowed_for_are_told(log: Path, tmp_path: Path) -> None:
    save_scans(tmp_path / "two.npz", load_scans(log).take([0, 1]))
    words = ("--json", "--thinner", "0.1", "--bent", "0.15")
    run = call("track", MAP, tmp_path / "two.npz", *words).ends(0)
    told = {(row["scale"], row["thinner"], row["bent"]) for row in rows(run.out)}
    assert told == {(1.0, 0.1, 0.15)}
    assert "walls 0.10 m thinner on each side and pieces of wall 0.15 m off" in run.err


def test_tum_has_the_unique_poses(tracked: tuple[Path, str, str]) -> None:
    lines = (tracked[0] / "a.tum").read_text().splitlines()
    published = [row for row in rows(tracked[1]) if row["pose"]]
    assert len(lines) == len(published) > 3
    for line, row in zip(lines, published, strict=True):
        words = line.split(" ")
        assert len(words) == 8
        assert len(words[0].split(".")[1]) >= 9
        stamp, x, y, z, qx, qy, qz, qw = map(float, words)
        assert (stamp, z, qx, qy) == (row["stamp"], 0, 0, 0)
        assert (x, y) == (pytest.approx(row["pose"]["x"]), pytest.approx(row["pose"]["y"]))
        assert qz**2 + qw**2 == pytest.approx(1, abs=1e-9)
        assert 2 * np.arctan2(qz, qw) == pytest.approx(row["pose"]["theta"], abs=1e-9)


def test_picture_and_video_show_the_map(tracked: tuple[Path, str, str]) -> None:
    image = read_image(tracked[0] / "a.png").pixels
    assert min(image.shape[:2]) > 300
    movie = cv2.VideoCapture(str(tracked[0] / "a.webm"))
    assert int(movie.get(cv2.CAP_PROP_FRAME_COUNT)) == N
    good, frame = movie.read()
    assert good
    assert frame.std() > 10
    assert b"V_VP8" in (tracked[0] / "a.webm").read_bytes()[:1000]  # which browsers play
    for _ in range(N - 1):
        frame = movie.read()[1]
    for colour in (COLOURS["unique"], SCAN):  # the scan, and the trail with the robot
        near = np.abs(frame.astype(int) - colour).max(axis=2) < 60
        assert near.sum() > 50


def test_the_errors_against_a_true_trajectory_are_those_of_evo(tracked, log, tmp_path):
    assert "APE of " in tracked[2]  # the log has true poses
    got = [(row["stamp"], row["pose"]) for row in rows(tracked[1]) if row["pose"]]
    rng = np.random.default_rng(3)
    poses = np.array([(p["x"], p["y"], p["theta"]) for _, p in got])
    true = poses + rng.normal(0, (0.1, 0.1, 0.02), poses.shape)
    lines = ["# stamp x y z qx qy qz qw"]
    for (stamp, _), (x, y, theta) in zip(got, true, strict=True):
        q = f"0 0 {np.sin(theta / 2):.12f} {np.cos(theta / 2):.12f}"
        lines.append(f"{stamp + 0.004:.6f} {x:.9f} {y:.9f} 0 {q}")
    (tmp_path / "t.tum").write_text("\n".join(lines) + "\n")
    outputs = ("--truth", tmp_path / "t.tum", "--picture", tmp_path / "a.png")
    run = call("track", MAP, log, *outputs).ends(0)
    ape = np.hypot(*(poses - true)[:, :2].T)

    def matrix(p: FloatArray) -> FloatArray:
        c, s = np.cos(p[2]), np.sin(p[2])
        return np.array([[c, -s, p[0]], [s, c, p[1]], [0, 0, 1]])

    P, Q = [matrix(p) for p in poses], [matrix(p) for p in true]
    inv, rpe = np.linalg.inv, []
    for k in range(len(P) - 1):  # evo: the error of each step, in SE(2)
        rpe.append(np.hypot(*(inv(inv(Q[k]) @ Q[k + 1]) @ (inv(P[k]) @ P[k + 1]))[:2, 2]))
    for name, errors in (("APE", ape), ("RPE", np.array(rpe))):
        said = re.search(rf"{name} .*?rmse ([\d.]+) m, mean ([\d.]+) m, max ([\d.]+) m", run.err)
        expected = np.sqrt(np.mean(errors**2)), errors.mean(), errors.max()
        assert [float(word) for word in said.groups()] == pytest.approx(expected, abs=6e-4)
    with_truth, without = (read_image(f / "a.png").pixels.shape for f in (tmp_path, tracked[0]))
    assert with_truth == without  # both have the curve below: the log has true poses, too
    (tmp_path / "late.tum").write_text(lines[1].replace(lines[1].split()[0], "9999") + "\n")
    run = call("track", MAP, log, "--truth", tmp_path / "late.tum")
    assert (run.code, "no stamp is within 0.01 s of a scan" in run.err) == (4, True)
    (tmp_path / "bad.tum").write_text("1 2 3\n")
    run = call("track", MAP, log, "--truth", tmp_path / "bad.tum")
    assert (run.code, "bad.tum: line 1: got '1 2 3', expected stamp x y z" in run.err) == (4, True)


@pytest.mark.parametrize(
    ("quaternion", "said"),
    [("0 0 0 0", "of length 1, not 0"),
     ("1e200 0 1e200 1e200", "of length 1, not 1.73e+200"), ("0 nan 0 1", "qw, all finite"),
     ("0 0 1", "expected stamp x y z qx qy qz qw")],
)  # fmt: skip
def test_a_quaternion_that_is_no_rotation_is_named(log, tmp_path, quaternion, said):
    stamps = load_scans(log).stamps
    path = tmp_path / "t.tum"
    lines = [f"{stamp:.6f} 4 8 0 0 0 0 1" for stamp in stamps]
    lines[7] = f"{stamps[7]:.6f} 4 8 0 {quaternion}"
    path.write_text("\n".join(lines))
    run = call("track", MAP, log, "--truth", path)
    assert run.code == 4
    assert f"{path.name}: line 8: got '{lines[7][:20]}" in run.err
    assert f"{said} (1 of 9 is broken; --max-bad 0.12 leaves it out)" in run.err
    run = call("track", MAP, log, "--truth", path, "--max-bad", "0.12")
    assert (run.code, f"{path.name}: left out 1 of 9 lines" in run.err) == (0, True)


def test_a_trajectory_that_meets_no_unique_pose_is_said_to(log: Path, tmp_path: Path) -> None:
    scans, path = load_scans(log), tmp_path / "t.tum"
    path.write_text(f"{scans.stamps[0]:.6f} 4 8 0 0 0 0 1\n")  # where the robot is not unique yet
    run = call("track", MAP, log, "--truth", path).ends(0)
    assert re.search(r"no errors: \d+ poses are unique and 1 true poses are known, but", run.err)
    with np.load(log) as held:
        np.savez(tmp_path / "b.npz", **{k: v for k, v in held.items() if k != "stamps"})
    run = call("track", MAP, tmp_path / "b.npz", "--truth", path)
    run.ends(2, "--truth: the log has no stamps", out="")


def test_lines_for_people(log: Path) -> None:
    run = call("track", MAP, log, "--start", "4,8,0", "--every", "5,90", "--no-cache").ends(0)
    lines = run.out.splitlines()
    assert "verdict" in lines[0]
    assert len(lines) == N + 1
    assert "unique" in lines[-1]


def test_the_best_guess_is_marked_in_every_output(log: Path, tmp_path: Path) -> None:
    tum, ros = tmp_path / "a.tum", tmp_path / "a.yaml"
    words = ("--every", "0.4,90", "--best", "--no-cache")
    run = call("track", MAP, log, *words, "--json", "--tum", tum, "--ros", ros).ends(0)
    got = rows(run.out)
    guessed = [row for row in got if row["guess"]]
    assert 0 < len(guessed) < N
    for row in got:
        assert (row["pose"] is None) or (row["guess"] is None)
        first = row["places"][0]
        best = row["pose"] or row["guess"]
        assert (first["x"], first["y"]) == (pytest.approx(best["x"]), pytest.approx(best["y"]))
        assert sum(place["mass"] for place in row["places"]) + row["lost"] <= 1 + 1e-9
    lines = tum.read_text().splitlines()
    assert [line for line in lines if line.startswith("# guess: ")] == [
        f"# guess: {row['verdict']}" for row in guessed
    ]
    assert len(lines) == N + len(guessed)
    assert ros.read_text().count(", a guess") == len(guessed)
    run = call("track", MAP, log, *words)
    assert run.out.count(": guess") == len(guessed)
    assert ": guess" not in call("track", MAP, log, *words[:2]).out


DARK = range(10, 15)


@cache
def corridor(*, carried: bool) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Poses along a corridor, ranges, and odometry; the robot drives, or is carried for a while."""
    poses = np.array([[4.0 + 0.5 * k, 7.0, 0.0] for k in range(24)])
    odom = noisy_odometry(poses, np.random.default_rng(0))
    if carried:  # turned around where it was, with its wheels in the air; then it drives back
        poses[DARK.start :] = [[8.5 - 0.25 * k, 7.0, np.pi] for k in range(24 - DARK.start)]
        odom[DARK.start :] = odom[DARK.start] + [[0.25 * k, 0, 0] for k in range(14)]
        poses[DARK.start : DARK.stop], odom[DARK] = poses[DARK.stop], odom[DARK.start]
    fine = render(WORLDS["visibility"](), 0.05)
    return poses, simulate_ranges(fine, poses, ANGLES, seed=2, range_max=30.0), odom


def in_the_dark(folder: Path, ranges: Callable[[FloatArray], object], *, carried: bool) -> Path:
    """A log along a corridor whose scans are blind for 2.5 m, or for as long as it is carried."""
    poses, seen, odom = corridor(carried=carried)
    seen = seen.copy()
    for k in DARK:
        seen[k] = ranges(seen[k - 1])
    scans = tuple(LaserScan(r, ANGLES, range_max=30.0) for r in seen)
    save_scans(folder / "dark.npz", ScanSet(scans, poses, 100.0 + np.arange(24), odom))
    return folder / "dark.npz"


@pytest.mark.parametrize(
    ("ranges", "carried"),
    [(lambda _: np.nan, False), (lambda r: np.linspace(0.09, 0.11, len(r)), True),
     (lambda last: last, False), (lambda last: last, True)],
    ids=["nan", "covered, carried", "frozen", "frozen, carried"],
)  # fmt: skip
def test_a_blind_robot_gives_no_pose(tmp_path, ranges, carried):
    path = in_the_dark(tmp_path, ranges, carried=carried)
    run = call("track", MAP, path, "--json", "--tum", tmp_path / "a.tum").ends(0)
    got, truth = rows(run.out), load_scans(path).poses
    assert got[DARK.start - 1]["verdict"] == "unique"
    blind = [got[k] for k in DARK]
    assert [row["verdict"] for row in blind] == ["ambiguous"] * len(DARK)
    assert {row["withheld"] for row in blind} == {"blind"}
    assert not any(row["looked"] or row["pose"] for row in blind)
    assert [row["age"] for row in blind] == [1, 2, 3, 4, 5]
    if not carried:  # whoever stands grows no less sure of where
        spread = [row["deviation"][0] for row in blind]
        assert spread == sorted(spread)
        assert got[-1]["verdict"] == "unique"
    assert all(row["age"] == 0 for row in got[DARK.stop :])
    for row in got:
        if row["pose"]:
            x, y, theta = truth[row["index"]]
            assert np.hypot(row["pose"]["x"] - x, row["pose"]["y"] - y) < 0.3, row["index"]
            assert abs(np.angle(np.exp(1j * (row["pose"]["theta"] - theta)))) < 0.1
    published = [row["stamp"] for row in got if row["pose"]]
    tum = (tmp_path / "a.tum").read_text().splitlines()
    assert [float(line.split()[0]) for line in tum] == published


def test_a_pose_is_as_sure_as_was_asked_for(log: Path) -> None:
    run = call("track", MAP, log, "--json", "--max-sd", "0.02,10").ends(0)
    assert {row["withheld"] for row in rows(run.out)} == {"unconfirmed", "wide"}
    assert not any(row["pose"] for row in rows(run.out))
    assert "wide" not in call("track", MAP, log, "--max-sd", "2,10").out


def test_what_was_calibrated_for_the_map_is_used(log: Path, tmp_path: Path) -> None:
    for name in ("visibility.yaml", "visibility.png"):
        shutil.copy(MAPS / name, tmp_path)
    here = tmp_path / "visibility.yaml"
    recorded = load_scans(log)
    short = tuple(scan.scaled(0.88) for scan in recorded.scans)
    save_scans(tmp_path / "short.npz", replace(recorded, scans=short))
    save_calibrations(calibration_path(here), load_map(here), {}, {}, shared=Shared(1 / 0.88))
    run = call("track", here, tmp_path / "short.npz", "--json").ends(0)
    last = rows(run.out)[-1]
    assert last["verdict"] == "unique"
    assert abs(last["pose"]["x"] - (4 + 0.5 * (N - 1))) < 0.15
    assert "multiplied" not in run.err


def test_strict_says_that_the_end_is_not_unique(log: Path) -> None:
    assert call("track", MAP, log, "--strict", "--max-sd", "0.001,0.01").code == 6


@pytest.mark.parametrize(
    ("words", "code", "expected"),
    [
        (["--start", "1,2"], 2, "3 numbers"),
        (["--start", "1,2,90"], 2, "radians"),
        (["--start", "1,2,400deg"], 2, "expected -360deg to 360deg"),
        (["--start", "1,900,0"], 2, "start: 1,900 is outside of the map"),
        (["--every", "-1,3"], 2, "--every: got -1.0, expected metres, 0 to "),
        (["--max-sd", "0,10"], 2, "--max-sd: got 0.0, expected metres, 0.001 to "),
        (["--max-sd", "1"], 2, "2 numbers"),
        (["--tum", "a.txt"], 2, "ends in .tum"),
        (["--video", "a.avi"], 2, "a.avi: expected a name that ends in .webm or .mp4"),
        (["--ros", "a.json"], 2, "a.json: expected a name that ends in .yaml or .bag"),
        (["--filter", "kalman"], 2, "kalman"),
    ],
    ids=str,
)
def test_refuses(log: Path, words: list[str], code: int, expected: str) -> None:
    call("track", MAP, log, *words).ends(code, expected, out="")


def test_scans_alone_tell_the_motion_of_a_log_without_odometry(log: Path, tmp_path: Path) -> None:
    data = dict(np.load(log))
    del data["odom"]
    bare = tmp_path / "bare.npz"
    np.savez(bare, **data)
    run = call("track", MAP, bare)
    run.ends(0, "bare.npz: no odometry that moves is used: the scans alone tell the motion")
    asked = call("track", MAP, log, "--odom", "scans")
    assert (asked.code, asked.out) == (0, run.out)
    assert "more scans a second" not in run.err
    np.savez(bare, **data | {"stamps": 20 * data["stamps"]})
    far = call("track", MAP, bare).ends(0, "more than 4 s apart tell no motion", "unknown way: ")
    assert {line.split()[-1] for line in far.out.splitlines()[2:]} == {"-"}


def test_odometry_in_millimetres_is_refused(log: Path, tmp_path: Path) -> None:
    data = dict(np.load(log))
    data["odom"] = data["odom"] * (1000, 1000, 1)
    np.savez(tmp_path / "mm.npz", **data)
    run = call("track", MAP, tmp_path / "mm.npz").ends(4, out="")
    assert re.search(r"mm.npz: odom: it says [45]\d\d(.\d)? m/s, .* millimetres", run.err)


@pytest.mark.parametrize("far", [2e6, 1e20, 1e200, -1e308])
def test_odometry_that_leaves_the_earth_is_refused(log: Path, tmp_path: Path, far: float) -> None:
    data = dict(np.load(log))
    data["odom"][3, 0] = far
    np.savez(tmp_path / "far.npz", **data)
    for name in FILTERS:
        run = call("track", MAP, tmp_path / "far.npz", "--filter", name)
        assert (run.code, run.out) == (4, ""), run.err
        assert "far.npz: odom[3]: it is " in run.err
        assert "expected at most 1,000,000 m; the log is damaged" in run.err


def test_true_poses_are_those_of_the_scans_that_have_odometry(log: Path, tmp_path: Path) -> None:
    scans = load_scans(log)
    odom = scans.odom.copy()
    odom[:3] = np.nan
    save_scans(tmp_path / "part.npz", replace(scans, odom=odom))
    out = tmp_path / "a.png"
    run = call("track", MAP, tmp_path / "part.npz", "--start", "5.5,8,0.06", "--picture", out)
    assert run.code == 0, run.err
    assert float(re.search(r"APE of \d+ unique poses: rmse ([\d.]+)", run.err)[1]) < 0.2


def test_a_true_trajectory_is_read_first_and_never_overwritten(tmp_path: Path, log: Path) -> None:
    truth = tmp_path / "t.tum"
    truth.write_text("1e9 0 0 0 0 0 0 1\n")
    run = call("track", MAPS / "visibility.yaml", log, "--truth", truth, "--tum", truth, "--force")
    run.ends(1, "will not be overwritten")
    assert truth.read_text() == "1e9 0 0 0 0 0 0 1\n"
    run = call("track", MAPS / "visibility.yaml", log, "--truth", truth)
    assert (run.code, run.out) == (4, "")  # before the log is followed
    assert "no stamp is within 0.01 s of a scan" in run.err


def test_a_filter_that_is_never_sure_on_a_map_says_so(tmp_path: Path) -> None:
    files = thick_in(tmp_path, 1) / "map.yaml", tmp_path / "log.npz"
    told = "the walls of this map are drawn 0.5 m thick, so no pose of --filter particle is unique"
    for options, warned in ((), True), (("--bent", "0.1"), False):
        run = call("track", *files, "--filter", "particle", *options).ends(0)
        assert (told in run.err) == warned
