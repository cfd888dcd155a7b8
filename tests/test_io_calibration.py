"""The file of calibrations beside a map: found again, and not used for another map."""

import json
import logging
from pathlib import Path

import numpy as np
import pytest

from imgloc import Calibration, OccupancyGrid, Options, OutputError, Pose2D, Shared
from imgloc.io.calibration import (
    calibrated,
    calibration_path,
    load_calibrations,
    map_hash,
    save_calibrations,
)

WALL = np.eye(4, dtype=bool)
GRID = OccupancyGrid(WALL, ~WALL, 0.1)
FITTED = {"ght-v": Calibration(0.1, 0.17, 1 / 30), "beam": Calibration(temperature=0.1)}


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = calibration_path(tmp_path / "office.v2.yaml")
    save_calibrations(path, GRID, FITTED, {name: {"seed": 3} for name in FITTED})
    return path


def test_what_is_stored_is_found_again(path: Path, caplog: pytest.LogCaptureFixture) -> None:
    assert path.name == "office.v2.calibration.json"
    assert load_calibrations(path, GRID)[0] == FITTED
    content = json.loads(path.read_text())
    assert content["about"] == {"ght-v": {"seed": 3}, "beam": {"seed": 3}}
    assert content["map_hash"] == map_hash(GRID)
    assert not caplog.records


def test_no_file_no_calibrations(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    assert load_calibrations(tmp_path / "a.calibration.json", GRID) == ({}, Shared())
    assert load_calibrations(tmp_path, GRID) == ({}, Shared())
    assert not caplog.records


def test_the_hash_is_of_what_is_seen_in_the_map() -> None:
    moved = OccupancyGrid(WALL, ~WALL, 0.1, Pose2D(1, 2, 3))
    assert map_hash(moved) == map_hash(GRID)
    other = WALL.copy()
    other[0, 1] = True
    unknown = ~WALL
    unknown[0, 1] = False
    grids = [
        OccupancyGrid(other, ~other, 0.1),
        OccupancyGrid(WALL, unknown, 0.1),
        OccupancyGrid(WALL, ~WALL, 0.2),
        OccupancyGrid(WALL.reshape(2, 8), ~WALL.reshape(2, 8), 0.1),
    ]
    assert len({map_hash(grid) for grid in [GRID, *grids]}) == 5


def test_of_another_map_it_is_not_used(path: Path, caplog: pytest.LogCaptureFixture) -> None:
    finer = OccupancyGrid(WALL, ~WALL, 0.05)
    assert load_calibrations(path, finer) == ({}, Shared())
    (record,) = caplog.records
    assert record.levelno == logging.WARNING
    assert "office.v2.calibration.json: ignored" in record.getMessage()
    assert "a map with other cells" in record.getMessage()


def values(sigma_xy: float, temperature: object) -> dict[str, object]:
    return {"sigma_xy": sigma_xy, "sigma_theta": 0, "temperature": temperature}


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"format": 2}, "format 1"),
        ({"methods": []}, "methods: got [], expected an object"),
        ({"methods": {"fused": values(1, 1)}}, "methods: expected an object with keys of cbml"),
        ({"methods": {"ght": {"sigma_xy": 1}}}, "methods.ght: no sigma_theta, expected a number"),
        ({"methods": {"ght": values(0, "1")}}, "got '1'"),
        ({"methods": {"ght": values(0, True)}}, "got True"),
        ({"methods": {"ght": values(0, 0)}}, "methods.ght.temperature: got 0.0, expected a factor"),
        ({"methods": {"ght": values(-1, 1)}}, "sigma_xy"),
        ({"methods": {"ght": values(float("nan"), 1)}}, "methods.ght.sigma_xy: got nan, expected"),
    ],
)
def test_a_damaged_file_is_not_used(path, change, expected, caplog):
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    assert load_calibrations(path, GRID) == ({}, Shared())
    assert expected in caplog.text


@pytest.mark.parametrize("value", ["1e999", "9" * 400, "[" * 900, "null", '"\\ud800"'])
@pytest.mark.parametrize("key", ["shared", "scale", "thinner", "about"])
def test_numbers_that_no_float_holds_are_a_warning(path, key, value, caplog):
    content = json.loads(path.read_text()) | {"shared": {"scale": 1.0, "thinner": 0}}
    of = content if key in content else content["shared"]
    of[key] = "HERE"
    path.write_text(json.dumps(content).replace('"HERE"', value))
    if (key, value) == ("about", "null"):
        assert load_calibrations(path, GRID) == (FITTED, Shared())
    else:
        assert load_calibrations(path, GRID) == ({}, Shared())
        assert len(caplog.records) == 1


@pytest.mark.parametrize("content", [b"", b"{", b"[1]", b"\xff\xfe", b"[" * 100_000, b" " * 2**21])
def test_what_is_no_such_file_is_not_used(path, content, caplog):
    path.write_bytes(content)
    assert load_calibrations(path, GRID) == ({}, Shared())
    assert len(caplog.records) == 1


def test_nothing_is_overwritten_unless_told_to(path: Path) -> None:
    with pytest.raises(OutputError, match="`force=True`"):
        save_calibrations(path, GRID, {}, {})
    assert load_calibrations(path, GRID)[0] == FITTED


def test_other_methods_are_kept(path: Path) -> None:
    new = {"cbml": Calibration(0.1, 0.0, 0.5), "beam": Calibration(temperature=0.7)}
    save_calibrations(path, GRID, new, {name: {"seed": 4} for name in new}, force=True)
    assert load_calibrations(path, GRID)[0] == FITTED | new
    about = json.loads(path.read_text())["about"]
    assert {name: said["seed"] for name, said in about.items()} == {
        "ght-v": 3, "beam": 4, "cbml": 4,
    }  # fmt: skip


@pytest.mark.parametrize("damage", ['{"format": 1}', "{", '{"about": 3}'])
def test_a_file_that_is_of_no_use_is_replaced(path: Path, damage: str) -> None:
    path.write_text(damage)
    save_calibrations(path, GRID, {"cbml": Calibration()}, {}, force=True)
    assert load_calibrations(path, GRID)[0] == {"cbml": Calibration()}


def test_what_is_of_another_map_is_not_kept(path: Path) -> None:
    finer = OccupancyGrid(WALL, ~WALL, 0.05)
    save_calibrations(path, finer, {"cbml": Calibration()}, {}, force=True)
    assert load_calibrations(path, finer)[0] == {"cbml": Calibration()}


@pytest.mark.parametrize("about", [[], 7, {"seed": 1}, {"beam": None}])
def test_fits_of_which_nothing_is_said_are_kept(path: Path, about: object) -> None:
    path.write_text(json.dumps(json.loads(path.read_text()) | {"about": about}))
    save_calibrations(path, GRID, {}, {}, force=True)
    assert load_calibrations(path, GRID)[0] == FITTED


def test_scale_and_walls_are_kept_and_come_with_the_options(path: Path) -> None:
    shared = Shared(1.0426, 2)
    save_calibrations(path, GRID, {}, {"shared": {"asked": 9}}, shared=shared, force=True)
    assert load_calibrations(path, GRID) == (FITTED, shared)
    save_calibrations(path, GRID, {"cbml": Calibration()}, {}, force=True)
    assert load_calibrations(path, GRID) == (FITTED | {"cbml": Calibration()}, shared)
    assert json.loads(path.read_text())["about"]["shared"] == {"asked": 9}
    options = calibrated(Options("ght-v", top=3), path.with_name("office.v2.yaml"), GRID)
    assert options == Options("ght-v", top=3, calibration=FITTED["ght-v"], shared=shared)
    nothing = calibrated(Options(), path.with_name("other.yaml"), GRID)
    assert nothing == Options()


def test_a_file_of_before_has_no_error(path: Path) -> None:
    content = json.loads(path.read_text())
    del content["shared"]
    path.write_text(json.dumps(content))
    assert load_calibrations(path, GRID) == (FITTED, Shared())


@pytest.mark.parametrize(
    "shared",
    [
        {"scale": 0.0, "thinner": 0},
        {"scale": 1.0},
        {"scale": "1", "thinner": 0},
        [1, 2],
        {"scale": 1.0, "thinner": 2.5},
        {"scale": 1.0, "thinner": 0, "depth": float("nan")},
    ],
)
def test_an_error_that_cannot_be_is_not_used(path: Path, shared: object, caplog) -> None:
    path.write_text(json.dumps(json.loads(path.read_text()) | {"shared": shared}))
    with caplog.at_level(logging.WARNING):
        assert load_calibrations(path, GRID) == ({}, Shared())
    assert "shared" in caplog.text.lower()
