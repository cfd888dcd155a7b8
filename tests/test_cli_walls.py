"""Walls that others drew, thick or bent, from the command line: stated, and aged."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command import MAPS, call, rows
from walls import GRID, THICK, drawn, thick_in

from imgloc import load_scans, save_scans


@pytest.fixture(scope="module")
def thick(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a map whose walls are too thick."""
    return thick_in(tmp_path_factory.mktemp("thick"))


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
    run.ends(0, "allows for walls 0.20 m thinner on each side;")
    assert run.err.count("thinner") == 1  # no advice


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
    call("localize", thick / "map.yaml", thick / "log.npz", *words).ends(2, expected, out="")


def test_localize_and_track_say_that_a_map_has_aged(tmp_path: Path) -> None:
    before = GRID.occupied.copy()
    for row, column in ((30, 80), (60, 120), (110, 60), (100, 150)):
        before[row : row + 8, column : column + 8] = True  # boxes that are gone
    files = drawn(tmp_path, before, 16) / "map.yaml", tmp_path / "log.npz"
    said = r"scans at sure poses pass (\d+)% of the walls in view"
    for command in ("localize", "track"):
        run = call(command, *files).ends(0)
        share = int(re.findall(said, " ".join(run.err.split()))[0])
        assert 5 <= share <= 15
        assert "sure poses" not in call(command, MAPS / "visibility.yaml", files[1]).err


def test_a_wrong_resolution_and_a_wrong_unit_of_ranges_are_told_apart(tmp_path: Path) -> None:
    yaml, log = drawn(tmp_path, GRID.occupied, 8) / "map.yaml", tmp_path / "log.npz"
    text, scans = yaml.read_text(), load_scans(log)
    yaml.write_text(re.sub("resolution: .*", "resolution: 0.2", text))
    said = "the cells of the map are of 0.1 m. Try --resolution 0.1\n"
    assert re.search(f"(?s){said}.*next .* --resolution 0.1$", call("inspect", yaml, log).out)
    call("track", yaml, log).ends(0, said)
    yaml.write_text(text)
    short = tuple(scan.scaled(1 / 0.93) for scan in scans.scans)
    save_scans(log, replace(scans, scans=short), force=True)
    (scale,) = re.findall(r"next .*--range-scale (\S+)", call("inspect", yaml, log).out)
    assert float(scale) == pytest.approx(0.93, rel=0.02)


def test_a_similar_building_is_another_place(tmp_path: Path) -> None:
    walls, half = GRID.occupied.copy(), GRID.occupied.shape[1] // 2
    walls[8:-8, half:-8] = walls[8:-8, half:-8][:, ::-1]  # the outer walls, and one half, stand
    files = drawn(tmp_path, walls, 16) / "map.yaml", tmp_path / "log.npz"
    for command in ("inspect", "track"):
        run = call(command, *files)
        assert "of the walls in view: this map is of another place" in run.out + run.err
    assert "findings    none" in call("inspect", MAPS / "visibility.yaml", files[1]).out


def test_a_mirrored_map_sends_nobody_in_a_circle(tmp_path: Path) -> None:
    files = drawn(tmp_path, np.fliplr(GRID.occupied), 24) / "map.yaml", tmp_path / "log.npz"
    run = call("inspect", *files)
    assert "the image of the map is mirrored. Mirror it, left to right" in run.out
    assert "--flipped" not in run.out
    assert "Leave out --flipped" in call("inspect", *files, "--flipped").out


def test_odometry_that_leads_away_from_the_map_is_named(tmp_path: Path) -> None:
    files = drawn(tmp_path, GRID.occupied, 24) / "map.yaml", tmp_path / "log.npz"
    scans = load_scans(files[1])
    save_scans(files[1], replace(scans, odom=scans.odom * (3.28, 3.28, 1.0)), force=True)
    assert re.search("(?s)disagree: .*--odom scans$", call("inspect", *files).out.rstrip())
    call("track", *files).ends(0, "as the odometry has it (50% and more is usual)")
