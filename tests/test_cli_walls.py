"""Walls that others drew, thick or bent, from the command line: stated, and calibrated."""

import json
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from command import MAPS, call, rows

from imgloc.filters.motion import noisy_odometry
from imgloc.io.maps import save_map
from imgloc.io.scans import load_scans, save_scans
from imgloc.io.scanset import ScanSet
from imgloc.model import BoolArray, LaserScan
from imgloc.search.adapt import BENT
from imgloc.simulation.scans import simulate_ranges
from imgloc.simulation.worlds import WORLDS, render

ANGLES = np.deg2rad(np.arange(-180, 180, 3.0))
THICK = 2  # cells of 0.1 m that each side of a wall is drawn too thick
N = 24


GRID = render(WORLDS["visibility"](), 0.1)


def drawn(folder: Path, occupied: BoolArray) -> Path:
    """The folder, with a map that has these walls, and a log from the world itself."""
    save_map(folder / "map.yaml", replace(GRID, occupied=occupied, free=GRID.free & ~occupied))
    poses = np.array([[4.0 + 0.5 * k, 8.0, 0.02 * k] for k in range(N)])
    fine = render(WORLDS["visibility"](), 0.05)
    ranges = simulate_ranges(fine, poses, ANGLES, seed=2, range_max=30.0)
    scans = tuple(LaserScan(r, ANGLES, range_max=30.0) for r in ranges)
    odom = noisy_odometry(poses, np.random.default_rng(0))
    save_scans(folder / "log.npz", ScanSet(scans, poses, 100.0 + np.arange(N), odom))
    return folder


@pytest.fixture(scope="module")
def thick(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a map whose walls are too thick."""
    disc = np.ones((2 * THICK + 1,) * 2, np.uint8)
    occupied = cv2.dilate(GRID.occupied.astype(np.uint8), disc) > 0
    return drawn(tmp_path_factory.mktemp("thick"), occupied)


@pytest.fixture
def bent(tmp_path: Path) -> Path:
    """A folder with a map on which each block of 1.5 m stands 0.2 m off, any way."""
    occupied, rng, block = np.zeros_like(GRID.occupied), np.random.default_rng(5), 15
    for row in range(0, len(occupied), block):
        for column in range(0, occupied.shape[1], block):
            there = np.argwhere(GRID.occupied[row : row + block, column : column + block])
            y, x = (there + [row, column] + rng.choice([-2, 2], 2)).T
            inside = (y >= 0) & (x >= 0) & (y < len(occupied)) & (x < occupied.shape[1])
            occupied[y[inside], x[inside]] = True
    return drawn(tmp_path, occupied)


def test_walls_are_stated_by_hand_in_metres(thick: Path) -> None:
    files = thick / "map.yaml", thick / "log.npz"
    run = call("localize", *files, "--thinner", 0.2, "--bent", 0.1, "--scans-index", 3, "--json")
    assert run.code == 0, run.err
    (row,) = rows(run.out)
    shared = row["parameters"]["shared"]
    assert (shared["scale"], shared["thinner"], shared["bent"]) == (1.0, THICK, 0.1)
    assert row["evidence"]["thinner"] == pytest.approx(0.2)
    assert row["verdict"] == "unique"
    assert "calibrate" not in run.err  # there is nothing left to find
    run = call("track", *files, "--thinner", 0.2)
    assert run.code == 0, run.err
    assert "thinner" not in run.err
    run = call("batch", files[0], files[1], "--thinner", 0.2, "--out", thick / "out", "--json")
    assert run.code == 0, run.err
    (found,) = rows((thick / "out" / "results.jsonl").read_text())
    assert all(a["evidence"]["thinner"] == pytest.approx(0.2) for a in found["answers"])


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--thinner", 0.01], "--thinner: got 0.01, expected 0 or at least half a cell, 0.05 m"),
        (["--thinner", -1], "--thinner: got -1, expected metres, 0 to 1"),
        (["--bent", "wide"], "--bent"),
        (["--bent", 0.1, "--method", "cbml"], "--thinner and --bent: cbml scores walls as drawn"),
    ],
)
def test_walls_that_cannot_be_are_refused(thick: Path, words: list[object], expected: str) -> None:
    run = call("localize", thick / "map.yaml", thick / "log.npz", *words)
    assert (run.code, run.out) == (2, "")
    assert expected in run.err


def test_scans_that_fit_nowhere_alone_calibrate_a_map_together(bent: Path) -> None:
    files, kept = (bent / "map.yaml", bent / "log.npz"), bent / "map.calibration.json"
    alone = np.load(files[1])
    np.savez(bent / "alone.npz", **{name: alone[name] for name in alone if name != "odom"})
    run = call("calibrate", files[0], "--scans", bent / "alone.npz")
    assert (run.code, run.out) == (2, "")
    assert "expected at least 5 to say what error they share" in run.err
    assert "Scans of a log with odometry need not fit one by one" in run.err
    run = call("calibrate", files[0], "--scans", files[1])
    assert run.code == 0, run.err
    content = json.loads(kept.read_text())
    shared, about = content["shared"], content["about"]["shared"]
    assert shared["bent"] == BENT
    assert 0.5 < shared["usual"] < 1.5
    assert about["asked"] == N
    assert about["metres"] == pytest.approx(0.5 * (N - 1), abs=0.5)
    assert f"{about['used']} of {N} are at sure places" in run.out
    assert "stands 0.15 m off" in run.out
    assert f"lack {shared['usual']:.1f} nats per reading here" in run.out
    for row in rows(call("localize", *files, "--json", "--sample", 3).out):
        assert row["parameters"]["shared"] == shared
    assert "thinner" not in call("track", *files).err  # there is nothing left to find


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--scans", "log.npz", "--rays", 90], "--rays: is for calibrate without --scans"),
        (["--topic", "/scan"], "--topic: is for calibrate --scans"),
        (["--scans", "log.npz", "--scans-index", 99], "--scans-index: got 99, expected 0 to 23"),
        (["--scans", "log.npz", "--range-scale", 0], "--range-scale: got 0"),
    ],
)
def test_calibrate_reads_a_log_as_localize_does(
    thick: Path, words: list[object], expected: str
) -> None:
    given = [thick / word if word == "log.npz" else word for word in words]
    run = call("calibrate", thick / "map.yaml", *given)
    assert (run.code, run.out) == (2, "")
    assert expected in " ".join(run.err.split())


def test_calibrate_is_told_how_a_log_is_read(thick: Path) -> None:
    recorded = load_scans(thick / "log.npz")
    mirrored = tuple(scan.flipped.scaled(1000) for scan in recorded.scans)
    save_scans(thick / "mm.npz", replace(recorded, scans=mirrored))
    words = ("--flipped", "--range-scale", 0.001, "--scans-index", "::3", "--dry-run", "--json")
    run = call("calibrate", thick / "map.yaml", "--scans", thick / "mm.npz", *words)
    assert run.code == 0, run.err
    (found,) = rows(run.out)
    assert found["asked"] == N // 3
    assert found["shared"]["thinner"] == THICK


def test_localize_and_track_say_that_a_map_has_aged(tmp_path: Path) -> None:
    before = GRID.occupied.copy()
    for row, column in ((30, 80), (60, 120), (110, 60), (100, 150)):
        before[row : row + 8, column : column + 8] = True  # boxes that are gone
    files = drawn(tmp_path, before) / "map.yaml", tmp_path / "log.npz"
    said = r"the map has aged: (\d+) % of the walls that scans at sure poses look at are gone"
    for command in ("localize", "track"):
        run = call(command, *files)
        assert run.code == 0, run.err
        share = int(re.findall(said, " ".join(run.err.split()))[0])
        assert 5 <= share <= 15
        assert "aged" not in call(command, MAPS / "visibility.yaml", files[1]).err
