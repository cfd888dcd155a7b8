"""An option wins over a value of a file that cannot be, and the error of the file names it."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from command import MAPS, call

from imgloc.io.scans import load_scans

WRONG = {
    "--origin 0,0,0": "origin: [0, 0, -nan]",
    "--origin 0,0,90deg": "origin: [0, 0, 90]",
    "--origin 1,2,0": "origin: here",
    "--resolution 0.1": "resolution: 0",
    "--resolution 0.10": "resolution: 0.05 m",
    "--resolution 0.100": "resolution: 0,05",
    "--occupied-thresh 0.65": "occupied_thresh: 65",
    "--free-thresh 0.196": "free_thresh: 19.6 %",
    "--mode trinary": "mode: costmap",
    "--no-negate": "negate: '0'",
    "--negate": "negate: maybe",
}


@pytest.mark.parametrize("option", WRONG)
def test_an_option_wins_over_a_value_of_a_map_that_cannot_be(option: str, tmp_path: Path) -> None:
    shutil.copy(MAPS / "curved.png", tmp_path)
    said = {"image": "curved.png", "resolution": "0.1", "origin": "[0, 0, 0]"}
    key, _, value = WRONG[option].partition(": ")
    path = tmp_path / "a.yaml"
    path.write_text("\n".join(f"{k}: {v}" for k, v in {**said, key: value}.items()))
    refused = call("map", "check", path).ends(3)
    flag = option.split()[0].replace("--no-", "--")
    assert f"; or pass {flag}" in refused.err
    for command in ("map check", "inspect"):
        call(*command.split(), path, *option.split()).ends(0)
    read = tmp_path / "b.yaml"  # it keeps how an image is read
    call("map", "check", path, *option.split(), "--write", read).ends(0)
    call("simulate", read, "-n", 1, "--out", tmp_path / "a.npz").ends(0)


RANGES = np.linspace(1.0, 2.0, 181)


@pytest.mark.parametrize("bad", [0.01, float("nan"), "12 m"])
@pytest.mark.parametrize("kind", ["csv", "jsonl", "json", "npz", "yaml"])
def test_range_max_wins_over_one_that_cannot_be(kind: str, bad: object, tmp_path: Path) -> None:
    path = tmp_path / f"a.{kind}"
    fields = {"angle_min": -1.5, "angle_max": 1.5, "range_min": 0.05, "range_max": bad}
    lists = ",".join(f"{r:g}" for r in RANGES)
    if kind == "npz":
        if isinstance(bad, str):
            pytest.skip("an array of numbers has no words")
        angles = np.linspace(-1.5, 1.5, 181)
        np.savez(path, ranges=RANGES, angles=angles, range_max=bad, range_min=0.05)
    elif kind == "csv":
        said = ", ".join(f"{k}={str(v).replace(' ', '')}" for k, v in fields.items())
        path.write_text(f"# {said}\n{lists}\n")
    elif kind == "yaml":
        said = "".join(f"{k}: {v}\n" for k, v in fields.items()).replace(": nan", ": .nan")
        path.write_text(f"{said}ranges: [{lists}]\n---\n")
    else:
        path.write_text(json.dumps({**fields, "ranges": RANGES.tolist()}))
    call("inspect", path).ends(4, "range_max: got", "; or pass --range-max")
    mended = call("inspect", path, "--range-max", 12).ends(0)
    assert "range_max 12 m" in mended.out
    millimetres = call("inspect", path, "--range-max", 12, "--range-scale", 0.001)
    assert "range_max 12 m" in millimetres.out


def test_angles_that_contradict_each_other_may_be_stated(tmp_path: Path) -> None:
    path = tmp_path / "a.jsonl"
    said = {"angle_min": 3.14, "angle_max": -3.14, "angle_increment": 0.1, "ranges": [1.0] * 60}
    path.write_text(json.dumps(said))
    call("inspect", path).ends(4, "or pass --fov-deg")
    assert "-180 to 174 degrees" in call("inspect", path, "--fov-deg", 360).out
    np.testing.assert_allclose(
        load_scans(path, fov=np.pi)[0].angles[[0, -1]], [-np.pi / 2, np.pi / 2]
    )


MOUNTS = ([0.1, 0], "front", [0.1, 0, 90], [20000, 0, 0], [None, 0, 0], {"x": 1, "y": 2})


@pytest.mark.parametrize("bad", MOUNTS, ids=str)
def test_the_given_sensor_wins_over_a_mount_that_cannot_be(bad: object, tmp_path: Path) -> None:
    path = tmp_path / "a.json"
    said = {"angle_min": -1.5, "angle_max": 1.5, "range_max": 12, "ranges": RANGES.tolist()}
    path.write_text(json.dumps({**said, "mount": bad}))
    refused = call("inspect", path)
    assert (refused.code, "; or pass --sensor" in refused.err) == (4, True)
    run = call("inspect", path, "--sensor", "0.1,0,0")
    assert "on the robot at x 0.1 m, y 0 m" in run.out


@pytest.mark.parametrize("bad", [np.zeros((5, 3)), np.array([0.1, 0, 90])], ids=["rows", "degrees"])
def test_the_given_sensor_wins_over_mounts_of_an_npz(bad: np.ndarray, tmp_path: Path) -> None:
    angles = np.linspace(-1.5, 1.5, 181)
    np.savez(tmp_path / "a.npz", ranges=[RANGES] * 2, angles=angles, mount=bad)
    assert "; or pass --sensor" in call("inspect", tmp_path / "a.npz").err
    run = call("inspect", tmp_path / "a.npz", "--sensor", "0.1,0,0")
    assert "on the robot at x 0.1 m, y 0 m" in run.out
