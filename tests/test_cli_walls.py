"""Walls that others drew, thick or bent, from the command line: stated, and calibrated."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from command import call, rows

from imgloc.filters.motion import noisy_odometry
from imgloc.io.maps import save_map
from imgloc.io.scans import save_scans
from imgloc.io.scanset import ScanSet
from imgloc.model import LaserScan
from imgloc.simulation.scans import simulate_ranges
from imgloc.simulation.worlds import WORLDS, render

ANGLES = np.deg2rad(np.arange(-180, 180, 3.0))
THICK = 2  # cells of 0.1 m that each side of a wall is drawn too thick
N = 13


@pytest.fixture(scope="module")
def thick(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a map whose walls are too thick, and a log from the world itself."""
    folder = tmp_path_factory.mktemp("thick")
    grid, disc = render(WORLDS["visibility"](), 0.1), np.ones((2 * THICK + 1,) * 2, np.uint8)
    occupied = cv2.dilate(grid.occupied.astype(np.uint8), disc) > 0
    save_map(folder / "map.yaml", replace(grid, occupied=occupied, free=grid.free & ~occupied))
    poses = np.array([[4.0 + 0.5 * k, 8.0, 0.02 * k] for k in range(N)])
    fine = render(WORLDS["visibility"](), 0.05)
    ranges = simulate_ranges(fine, poses, ANGLES, seed=2, range_max=30.0)
    scans = tuple(LaserScan(r, ANGLES, range_max=30.0) for r in ranges)
    odom = noisy_odometry(poses, np.random.default_rng(0))
    save_scans(folder / "log.npz", ScanSet(scans, poses, 100.0 + np.arange(N), odom))
    return folder


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
