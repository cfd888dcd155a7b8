"""`imgloc sample`: the poses of a lost particle filter."""

from pathlib import Path

import numpy as np
import pytest
from command import MAPS, call, simulating

from imgloc import ScanSet, load_map, load_scans, save_map, save_scans
from imgloc.geometry import wrap
from imgloc.model import LaserScan, OccupancyGrid, Pose2D, compose

CURVED = MAPS / "curved.yaml"


scans = simulating(CURVED, "-n", 2, "--rays", 181, "--fov-deg", 360, "--seed", 2)


def drawn(*words: object) -> np.ndarray:
    call("sample", *words).ends(0, out="")
    out = Path(str(words[words.index("--out") + 1]))
    assert out.read_text().startswith("scan,x,y,theta\n")
    return np.loadtxt(out, delimiter=",", skiprows=1, ndmin=2)


def near(poses: np.ndarray, truth: np.ndarray) -> float:
    away = np.hypot(*(poses[:, :2] - truth[:2]).T)
    return float(np.mean((away < 0.5) & (np.abs(wrap(poses[:, 2] - truth[2])) < 0.35)))


@pytest.mark.parametrize("method", ["fused", "ght-v"])
def test_most_are_where_the_scan_was_taken(method: str, scans: Path, tmp_path: Path) -> None:
    words = ("--cell", 0.2, "--method", method, "-n", 200, "--out", tmp_path / "a.csv")
    rows = drawn(CURVED, scans, *words)
    truth = load_scans(scans).poses
    assert rows[:, 0].tolist() == [0] * 200 + [1] * 200
    for k in range(2):
        assert near(rows[rows[:, 0] == k, 1:], truth[k]) > 0.5


@pytest.mark.parametrize("method", ["fused", "ght"])
def test_poses_are_in_the_map_frame(method: str, scans: Path, tmp_path: Path) -> None:
    grid, origin = load_map(CURVED), Pose2D(-20.0, 7.0, 2.0)
    moved = tmp_path / "moved.yaml"
    save_map(moved, OccupancyGrid(grid.occupied, grid.free, grid.resolution, origin))
    words = ("--scans-index", 1, "--method", method, "-n", 50, "--out")
    here, there = (
        drawn(path, scans, *words, tmp_path / f"{path.stem}.csv")[:, 1:] for path in (CURVED, moved)
    )
    expected = [compose(origin, Pose2D(*pose)) for pose in here]
    # The Gaussians of fused are drawn along other axes: the same poses but for their spread.
    close = 0.2 if method == "fused" else 1e-4
    np.testing.assert_allclose(there[:, :2], [(p.x, p.y) for p in expected], atol=close)
    np.testing.assert_allclose(wrap(there[:, 2] - [p.theta for p in expected]), 0, atol=close)


def test_draws_depend_on_the_seed_and_the_scan_alone(scans: Path, tmp_path: Path) -> None:
    words = ("-n", 20, "--out", tmp_path / "a.csv", "--force")
    both = drawn(CURVED, scans, *words, "--threads", 1)
    np.testing.assert_array_equal(drawn(CURVED, scans, *words, "--threads", 2), both)
    np.testing.assert_array_equal(drawn(CURVED, scans, *words, "--scans-index", 1), both[20:])
    assert (drawn(CURVED, scans, *words, "--seed", 1) != both).any()


@pytest.mark.parametrize("method", ["fused", "ght-v", "beam"])
def test_a_scan_that_says_nothing_may_be_from_anywhere(method: str, tmp_path: Path) -> None:
    blind = tmp_path / "blind.npz"
    save_scans(blind, ScanSet((LaserScan(np.full(30, np.inf), np.arange(30) / 9, range_max=9),)))
    words = ("--method", method, "-n", 400, "--out", tmp_path / "a.csv")
    poses = drawn(CURVED, blind, *words)[:, 1:]
    assert poses[:, :2].std(axis=0).min() > 2
    assert np.histogram(poses[:, 2], 4, (-np.pi, np.pi))[0].min() > 60


@pytest.mark.parametrize(
    ("words", "code", "expected"),
    [
        (["--theta-step-deg", 3], 2, "fused has no stack"),
        (["--scans-index", 2], 2, "--scans-index: got 2, expected 0 to 1"),
        (["-n", 10**8], 2, "more than 10,000,000"),
        (["--out", "a.txt"], 2, "ends in .csv"),
    ],
    ids=str,
)
def test_refuses(scans, tmp_path, words, code, expected):
    call("sample", CURVED, scans, "--out", tmp_path / "a.csv", *words).ends(code, expected, out="")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("method", ["fused", "ght-v"])
def test_an_invalid_scan_is_drawn_from_everywhere_and_said_so(method, scans, tmp_path):
    data = dict(np.load(scans))
    data["ranges"][0, 9:] = np.nan  # nine readings are left
    np.savez(tmp_path / "nine.npz", **data)
    words = ("--method", method, "-n", 300, "--out")
    run = call("sample", CURVED, tmp_path / "nine.npz", *words, tmp_path / "a.csv").ends(0)
    assert run.err.count("too few readings") == 1
    assert "scan 0: invalid, too few readings" in run.err
    poses = np.loadtxt(tmp_path / "a.csv", delimiter=",", skiprows=1)[:300, 1:]
    height, width = load_map(CURVED).occupied.shape
    assert (np.ptp(poses[:, :2], axis=0) > 0.08 * np.array([width, height])).all()
    assert call("sample", CURVED, scans, *words, tmp_path / "b.csv").err.count("few") == 0
