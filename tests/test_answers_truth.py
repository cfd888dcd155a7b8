"""Recorded poses: true ones, odometry, and those of other maps."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command import MAPS, call

import imgloc
from imgloc.answers.scanmotion import overlap
from imgloc.answers.truth import poses_fit
from imgloc.io.scanset import ScanSet


def simulated(tmp_path: Path, shift: float) -> Path:
    scans = imgloc.simulate(imgloc.load_map(MAPS / "curved.yaml"), 6, seed=3)
    assert scans.poses is not None
    path = tmp_path / f"{shift}.npz"
    poses = scans.poses + (shift, 0, 0)
    imgloc.save_scans(path, ScanSet(scans.scans, poses, np.arange(6.0), poses))
    return path


@pytest.mark.parametrize("shift", [0.0, 2.0])
def test_poses_that_do_not_fit_the_map_are_not_truth(tmp_path: Path, shift: float) -> None:
    path = simulated(tmp_path, shift)
    run = call("localize", "curved", path, "--scans-index", 2, "--no-cache").ends(0)
    assert ("truth" in run.out) == (shift == 0)
    assert ("so imgloc treats them as odometry" in run.err) == (shift > 0)
    run = call("track", "curved", path, "--no-cache").ends(0)
    assert ("so imgloc treats them as odometry" in run.err) == (shift > 0)


@pytest.mark.parametrize("shift", [0.0, 2.0])
def test_a_batch_compares_with_no_odometry(tmp_path: Path, shift: float) -> None:
    path, out = simulated(tmp_path, shift), tmp_path / "out"
    run = call("batch", MAPS / "curved.yaml", path, "--out", out, "--workers", 1, "--no-cache")
    assert run.code == 0
    assert ("6 scans with a known pose 6 are right" in run.out) == (shift == 0)
    assert ("known pose" in run.out) == (shift == 0)
    assert ("so imgloc treats them as odometry" in run.out + run.err) == (shift > 0)


def test_odometry_that_fits_at_one_scan_by_chance_is_not_truth(tmp_path: Path) -> None:
    """Of this file the first pose is true, and the others are not."""
    scans = imgloc.simulate(imgloc.load_map(MAPS / "curved.yaml"), 6, seed=3)
    assert scans.poses is not None
    poses = scans.poses + np.where(np.arange(6) > 0, 2.0, 0.0)[:, None] * (1, 0, 0)
    imgloc.save_scans(tmp_path / "s.npz", ScanSet(scans.scans, poses, np.arange(6.0), poses))
    run = call("localize", "curved", tmp_path / "s.npz", "--scans-index", 0, "--no-cache").ends(0)
    assert "truth" not in run.out
    assert "so imgloc treats them as odometry" in run.err


def test_scans_without_readings_tell_nothing() -> None:
    grid = imgloc.load_map(MAPS / "curved.yaml")
    scan = imgloc.LaserScan(np.full(9, np.inf), np.arange(9.0))
    assert poses_fit(grid, [scan], np.zeros((1, 3))) is None


def test_readings_that_are_not_valid_tell_nothing() -> None:
    """A slice of a cloud has readings in some directions alone."""
    grid = imgloc.load_map(MAPS / "curved.yaml")
    scans = imgloc.simulate(grid, 4, seed=3)
    assert scans.poses is not None
    few = [replace(s, ranges=np.where(np.arange(len(s.ranges)) % 3, np.nan, s.ranges))
           for s in scans.scans]  # fmt: skip
    assert poses_fit(grid, few, scans.poses)
    assert not poses_fit(grid, few, scans.poses + (1.5, 0, 0))
    still = overlap(few[0], few[0], imgloc.Pose2D(0.0, 0.0))
    assert still == 1


@pytest.mark.parametrize(
    "name", ["fr079", "fr079_half", "belgioioso", "duke_loop5", "gh25", "malaga_campus", "wean",
             "factory_changed"],
)  # fmt: skip
def test_known_poses_of_recorded_sets_are_true(shared: Path, name: str) -> None:
    folder = shared / "data" / name
    grid, scans = imgloc.load_map(folder / "map.yaml"), imgloc.load_scans(folder / "scans.npz")
    assert scans.poses is not None
    assert poses_fit(grid, scans.scans, scans.poses)
    assert not poses_fit(grid, scans.scans, scans.poses + (0.5, 0.3, 0.05))
    if scans.odom is not None:
        assert not poses_fit(grid, scans.scans, scans.odom)
