"""Walls that others drew, thick or bent, from the command line: stated, and aged."""

import re
from pathlib import Path

import pytest
from command import MAPS, call, rows
from walls import GRID, THICK, drawn, thick_in


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
    call("batch", files[0], files[1], "--thinner", 0.2, "--out", thick / "out", "--json").ends(0)
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
    call("localize", thick / "map.yaml", thick / "log.npz", *words).ends(2, expected, out="")


def test_localize_and_track_say_that_a_map_has_aged(tmp_path: Path) -> None:
    before = GRID.occupied.copy()
    for row, column in ((30, 80), (60, 120), (110, 60), (100, 150)):
        before[row : row + 8, column : column + 8] = True  # boxes that are gone
    files = drawn(tmp_path, before) / "map.yaml", tmp_path / "log.npz"
    said = r"scans at sure poses pass (\d+) % of the walls in view: the map is old, has a wrong"
    for command in ("localize", "track"):
        run = call(command, *files).ends(0)
        share = int(re.findall(said, " ".join(run.err.split()))[0])
        assert 5 <= share <= 15
        assert "sure poses" not in call(command, MAPS / "visibility.yaml", files[1]).err
