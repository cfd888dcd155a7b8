"""What the lab takes is known beforehand, and refused before anything is done."""

import logging
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from budgets import check_done, check_refused, words
from command import MAPS, call
from test_features_budget import office, peak

from imgloc import ConfigError, MapFeatures, Options, Sensor
from imgloc.features.budget import poses_bytes, simulate_bytes
from imgloc.lab.atlas import MOST, atlas_poses, simulate_at
from imgloc.lab.calibrate import disturbed_set, sweep
from imgloc.search.asked import answer_bytes
from imgloc.simulation.scans import fine_factor

EVALUATE = ["evaluate", MAPS / "curved.yaml", "-n", 1, "--method", "ght-v,cbml", "--threads", 1]
CURVED = MAPS / "curved.yaml"
ATLAS = ["atlas", CURVED, "--out", "{}/a.png", "--step", 3, "--headings", 2,
         "--rays", 61, "--workers"]  # fmt: skip
CALIBRATE = ["calibrate", CURVED, "--method", "ght", "--theta-step-deg", 15, "-n", 20,
             "--rays", 61, "--dry-run", "--threads"]  # fmt: skip


@pytest.mark.parametrize(("step", "rays"), [(1.0, 720)])
def test_the_scans_of_an_atlas_take_no_more_than_estimated(step: float, rays: int) -> None:
    grid = office(4, 0.1)
    poses = atlas_poses(grid, step, 4, 0.2)
    taken = peak(lambda: simulate_at(grid, poses, Sensor(rays=rays), 0))
    cells, factor = grid.occupied.size, fine_factor(grid)
    some = min(len(poses), 1000)
    need = simulate_bytes(cells, factor**2 * cells, some * rays, kept=len(poses) * rays)
    assert taken <= need <= 3 * taken


@pytest.mark.parametrize(("step", "headings"), [(5.0, 1), (0.3, 1), (2.0, 72)])
def test_choosing_the_poses_of_an_atlas_takes_no_more_than_estimated(step, headings):
    grid = office(6, 0.1)
    side = grid.occupied.shape[0] * grid.resolution
    taken = peak(lambda: atlas_poses(grid, step, headings, 0.1))
    need = poses_bytes(grid.occupied.size, round(side / step) ** 2, MOST)
    assert taken <= need <= 3 * taken


def test_too_many_poses_of_an_atlas_are_refused_before_they_are_made() -> None:
    grid = office(6, 0.1)

    def refused(step: float, headings: int) -> None:
        with pytest.raises(ConfigError, match=r"[0-9,]+ poses at places .* use a larger step"):
            atlas_poses(grid, step, headings, 0.1)

    for step, headings in ((0.1, 72), (1e-3, 1), (1e-9, 1)):
        assert peak(lambda s=step, h=headings: refused(s, h)) <= poses_bytes(
            grid.occupied.size, 0, MOST
        ) + (2 << 20)  # the lines of the raster


def test_calibrating_takes_no_more_than_estimated() -> None:
    grid = office(6, 0.1)
    scans = disturbed_set(grid, 1, 0, Sensor(rays=90))
    features, options = MapFeatures(grid), Options(method="cbml", theta_step=0.5)
    _ = features.surface, features.bmap, features.free
    assert peak(lambda: sweep(features, scans, options)) <= answer_bytes(features, options)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """An empty one."""
    (tmp_path / "here").mkdir()
    return tmp_path / "here"


@pytest.mark.parametrize(
    ("command", "budget", "expected"),
    [
        (EVALUATE, "15M", ["simulating 1 scans of 181 rays on", "cells needs"]),
        ([*ATLAS, 1], "10M", ["simulating 18 scans of 61 rays on 1300 x 1600", "larger --step"]),
        ([*ATLAS, 1], "60M", ["fused on 130 x 160 cells of 0.1 m", "features of", "crop the map"]),
        ([*ATLAS, 2], "200M", ["fused on", "in each of 2 processes", "use fewer --workers"]),
        ([*CALIBRATE, 4], "80M", ["ght on 130 x 160 cells of 0.1 m", "features of"]),
    ],
)
def test_over_budget_is_refused_with_sizes(command, budget, expected, folder):
    check_refused(command, budget, expected, folder)


@pytest.mark.parametrize("command", [EVALUATE, [*ATLAS, 1], [*CALIBRATE, 1]])
def test_within_the_budget_it_is_said_and_done(command, folder: Path, caplog) -> None:
    check_done(command, folder, caplog)


def test_every_method_is_checked_before_the_first_one_runs(caplog):
    with caplog.at_level(logging.INFO):
        code, out, err = call(*EVALUATE, "--memory-budget", "100M", "--json", "-v")
    assert (code, out) == (2, "")
    said = err + caplog.text
    assert "ght-v on" in said
    assert "curved: ght-v: S" not in said  # nothing has been measured


def test_each_worker_of_an_atlas_counts(folder: Path) -> None:
    needs = []
    for workers in (2, 4):
        more = words([*ATLAS, workers, "--headings", 4], folder)
        (need,) = re.findall(
            r"processes needs (\d+) MiB", call(*more, "--memory-budget", "60M").err
        )
        needs.append(int(need))
    assert needs[1] == pytest.approx(2 * needs[0], abs=2)


def test_as_many_workers_as_there_is_work_for(folder: Path) -> None:
    # 18 poses are work for 2, however many are asked for.
    run = call(*words([*ATLAS, 99], folder), "--memory-budget", "60M")
    assert "in each of 2 processes" in run.err


def test_every_method_of_a_calibration_is_checked_before_the_first_one_runs(folder: Path) -> None:
    low = [*CALIBRATE[:2], "--method", "ght,beam", *CALIBRATE[4:], 1]
    run = call(*words(low, folder), "--memory-budget", "85M", "-v")
    run.ends(2, "ght on", "beam on 130 x 160 cells of 0.1 m", out="")
    assert "Fit(" not in run.err  # nothing has been measured


def test_maps_that_are_held_count_beside_the_next(tmp_path: Path) -> None:
    grey = np.full((1500, 1500), 254, np.uint8)
    grey[700] = 0
    paths = [tmp_path / f"{name}.yaml" for name in "ab"]
    for path in paths:
        path.with_suffix(".png").write_bytes(cv2.imencode(".png", grey)[1])
        path.write_text(f"{{image: {path.stem}.png, resolution: 0.05, origin: [0, 0, 0]}}")
    run = call("calibrate", *paths, "--dry-run", "--memory-budget", "25M", "-v")
    assert run.code == 2
    assert "a.png: an image of 1500 x 1500 pixels: at most 22 MiB" in run.err
    assert "b.png: an image of 1500 x 1500 pixels beside 5 MiB of other maps needs 26" in run.err
