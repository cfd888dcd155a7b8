"""tools/measure_which.py as a user runs it."""

import json
import subprocess
import sys

import pytest
from command import ROOT

from imgloc.io.maps import save_map
from imgloc.io.scans import save_scans
from imgloc.simulate import Sensor, simulate_set
from imgloc.worlds import WORLDS, render


def run_tool(*words):
    return subprocess.run(
        [sys.executable, "-m", "tools.trust", "which", *map(str, words)],
        capture_output=True, text=True, check=False,
        cwd=ROOT, env={"PATH": "/usr/bin:/bin"},
    )  # fmt: skip


@pytest.fixture(scope="module")
def maps(tmp_path_factory):
    """Two maps, one of them with scans beside it, and a map that is another name of one."""
    folder = tmp_path_factory.mktemp("maps")
    for name in ("curved", "corridor"):
        (folder / name).mkdir()
        grid = render(WORLDS[name](), 0.1)
        save_map(folder / name / "map.yaml", grid)
    save_scans(folder / "corridor" / "scans.npz", simulate_set(grid, 3, 3, Sensor()))
    return folder


def test_recorded_and_simulated_scans_are_asked_of_all_maps(maps):
    done = run_tool(maps, "-n", 2)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert (found["scans"], found["maps"]) == (2, 2)
    named = found["named with 0.5 or more"]
    assert (named["right"]["hits"], named["wrong"]["hits"]) == (2, 0)
    assert named["not right"] == []
    assert named["silent without its map"]["trials"] == 2


def test_two_maps_of_one_building_count_as_one(maps):
    done = run_tool(maps, "-n", 2, "--same", "curved,corridor")
    named = json.loads(done.stdout)["named with 0.5 or more"]
    assert named["right"]["hits"] == 2
    assert named["silent without its map"]["hits"] == 2  # none is left


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [(("-n", 0), 2, "at least 1"), (("--range-max", 0), 2, "reach"), (("nowhere",), 2, "nowhere")],
)
def test_refusals_are_one_line(maps, words, code, said):
    done = run_tool(maps, *words)
    assert (done.returncode, done.stdout) == (code, "")
    assert done.stderr.count("\n") == 1
    assert said in done.stderr
