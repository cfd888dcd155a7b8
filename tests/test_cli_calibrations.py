"""A calibration file that is wrong, through the command: it is named, not the map or the scans."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command import MAPS, call

import imgloc
from imgloc import Sensor, save_scans, simulate
from imgloc.io.calibration import calibration_path, save_calibrations
from imgloc.simulation.worlds import WORLDS, render

MENDS = "Make that file anew with imgloc calibrate MAP --scans FILE --force, or move it away"


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """A folder with a map and scans of it, two files."""
    for ending in (".yaml", ".png"):
        (tmp_path / f"map{ending}").write_bytes((MAPS / f"curved{ending}").read_bytes())
    text = (tmp_path / "map.yaml").read_text("utf-8").replace("curved.png", "map.png")
    (tmp_path / "map.yaml").write_text(text, "utf-8")
    sensor = Sensor(rays=180, fov=2 * np.pi)
    save_scans(tmp_path / "a.npz", simulate(render(WORLDS["curved"](), 0.1), 3, 5, sensor))
    return tmp_path


def calibrate(path: Path, **shared: object) -> Path:
    """Write a calibration beside a map that holds what is said of its error."""
    grid, file = imgloc.load_map(path), calibration_path(path)
    save_calibrations(file, grid, {}, {}, force=True)
    content = json.loads(file.read_text("utf-8"))
    content["shared"] |= shared
    file.write_text(json.dumps(content), "utf-8")
    return file


def advice(run_err: str) -> list[str]:
    return [line.removeprefix("imgloc: ") for line in run_err.splitlines() if "fit" in line]


@pytest.mark.parametrize(
    ("shared", "said"),
    [
        ({"scale": 0.6, "depth": 0.01}, "shared.scale is 0.6"),
        ({"scale": 1.06, "bent": 0.02}, "shared.scale is 1.06"),  # unique, with another scale
    ],
)
def test_the_calibration_is_named_not_the_map(place, shared, said):
    file = calibrate(place / "map.yaml", **shared)
    cause = f"fit this map far better without .*{re.escape(file.name)}, whose {said}. {MENDS}"
    run = call("localize", place / "map.yaml", place / "a.npz", "--no-cache")
    (hint,) = advice(run.err)
    assert re.fullmatch(f"scans like these {cause}", hint)
    file.unlink()
    run = call("localize", place / "map.yaml", place / "a.npz", "--no-cache")
    assert not advice(run.err)


def test_a_batch_and_inspect_name_the_calibration(place: Path) -> None:
    calibrate(place / "map.yaml", scale=1.4)
    run = call("batch", place / "map.yaml", place / "a.npz", "--out", place / "out", "--no-cache")
    assert "map.calibration.json, whose shared.scale is 1.4. Make that file anew" in run.out
    run = call("inspect", place / "map.yaml", place / "a.npz")
    assert "map.calibration.json, whose shared.scale is 1.4. Make that file anew" in run.out


def test_changes_of_a_map_name_the_calibration(place: Path) -> None:
    calibrate(place / "map.yaml", scale=1.4)
    run = call("map", "changes", place / "map.yaml", place / "a.npz", "--no-cache").ends(0)
    (hint,) = advice(run.err)
    assert f"map.calibration.json, whose shared.scale is 1.4. {MENDS}" in hint


def test_a_calibration_that_is_right_is_not_blamed(place: Path) -> None:
    calibrate(place / "map.yaml", scale=1.001, depth=0.01)
    run = call("localize", place / "map.yaml", place / "a.npz", "--no-cache", "--flipped")
    (hint,) = advice(run.err)
    assert hint.endswith("Leave out --flipped")


def test_a_followed_robot_names_the_calibration(shared: Path, tmp_path: Path) -> None:
    grid = imgloc.load_map(shared / "data" / "fr079" / "map.yaml", free_thresh=0.196)
    imgloc.save_map(tmp_path / "map.yaml", grid)
    log = imgloc.load_scans(shared / "data" / "raw" / "fr079.log").take(range(12))
    few = [replace(s, ranges=s.ranges[::4], angles=s.angles[::4]) for s in log.scans]
    imgloc.save_scans(tmp_path / "log.npz", replace(log, scans=tuple(few)))
    calibrate(tmp_path / "map.yaml", scale=1.3)
    run = call("track", tmp_path / "map.yaml", tmp_path / "log.npz", "--no-cache")
    (hint,) = advice(run.err)
    assert f"map.calibration.json, whose shared.scale is 1.3. {MENDS}" in hint


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        ("scale", 7, "shared.scale: got 7.0, expected a factor, 0.5 to 2"),
        ("thinner", 1.7, "shared.thinner: got 1.7, expected a whole number"),
        ("thinner", 101, "shared.thinner: got 101, expected a whole number, cells, 0 to 100"),
        ("depth", float("nan"), "shared.depth: got nan, expected"),
        ("depth", 0.2, "shared.depth: got 0.2, expected metres, -0.15 to 0.15"),
        ("bent", -1, "shared.bent: got -1.0, expected metres, 0 to 1"),
        ("usual", 1e6, "shared.usual: got 1000000.0, expected nats, 0 to 10"),
    ],
)
def test_a_value_that_cannot_be_is_named_with_its_file(place, key, value, expected):
    file = calibrate(place / "map.yaml", **{key: value})
    run = call("localize", place / "map.yaml", place / "a.npz", "--no-cache", "--scans-index", 0)
    assert run.code == 0
    (line,) = [line for line in run.err.splitlines() if "calibration" in line]
    assert f"{file.name}: ignored, the defaults are used: " in line
    assert expected in line


def test_no_scale_is_found_beyond_what_can_be_stated(place: Path) -> None:
    calibrate(place / "map.yaml", scale=2.0)
    run = call("batch", place / "map.yaml", place / "a.npz", "--no-cache", "--out", place / "out")
    assert run.code == 0, run.err
    assert "whose shared.scale is" in run.err + run.out
