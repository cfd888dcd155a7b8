"""`imgloc evaluate`, from the command line to its table and its JSON."""

import contextlib
import dataclasses
import importlib
import os
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command import MAPS, call, command, rows, simulating

from imgloc import OccupancyGrid, Pose2D, ScanSet, load_map, load_scans, save_map, save_scans
from imgloc.geometry import transform_poses
from imgloc.options import DEFAULTS

CURVED = MAPS / "curved.yaml"
OFF = "--no-cache"
QUICK = ["--method", "fused,ght-v", "--threads", 1]
KEYS = ["map", "method", "trials", "index", "index_box", "index_calibrated", "outside", "exact"]
KEYS += ["near", "success", "position", "heading", "verdicts", "cost"]
KEYS += ["lattice", "source", "parameters"]


scans = simulating(CURVED, "-n", 6, "--seed", 2)


def evaluated(*arguments: object) -> list[dict[str, Any]]:
    code, out, err = call("evaluate", *arguments, "--json")
    assert (code, err) == (0, "")
    return rows(out)


def test_simulated_scans_on_a_bundled_map_called_by_its_name() -> None:
    words = ["curved", "-n", 3, "--seed", 5, "--range-max", 8]
    fused, votes = evaluated(*words, *QUICK, "--tolerance", "0.3,20")
    assert list(fused) == list(votes) == KEYS
    assert (fused["method"], votes["method"]) == ("fused", "ght-v")
    assert fused["trials"] == 3
    source = fused["source"]
    assert source == votes["source"]
    assert source["seed"] == 5
    assert source["map"].endswith("curved.yaml")
    assert source["sensor"]["range_max"] == 8
    assert fused["near"]["hits"] == 3
    assert fused["index"]["value"] > votes["index"]["value"] > 0
    tolerances = [s["tolerance"] for s in fused["success"]]
    assert [t["position"] for t in tolerances] == [0.25, 0.5, 0.3]
    assert tolerances[2]["heading"] == pytest.approx(np.deg2rad(20))
    assert fused["success"][0]["at_1"]["hits"] == 3
    assert fused["verdicts"]["unique"]["value"] == 1
    assert fused["success"][2]["unique_wrong"]["hits"] == 0
    assert sum(share["hits"] for share in votes["verdicts"].values()) == 3
    assert votes["index_calibrated"]["value"] > votes["index"]["value"] + 2
    assert fused["index_calibrated"]["value"] < fused["lattice"]["log_poses"]
    calibration = votes["parameters"]["calibration"]
    assert calibration == dataclasses.asdict(DEFAULTS["ght-v"])
    assert votes["lattice"]["theta_step"] == pytest.approx(np.deg2rad(30))  # the paper's
    assert votes["parameters"]["method"] == "ght-v"


def test_several_maps_with_scans_of_their_own(scans: Path, tmp_path: Path) -> None:
    grid, recorded = load_map(CURVED), load_scans(scans)
    origin = Pose2D(-4.0, 9.0, 2.0)  # the same world in another frame
    save_map(tmp_path / "map.yaml", OccupancyGrid(grid.occupied, grid.free, 0.1, origin))
    moved = transform_poses(origin, np.array(recorded.poses))
    save_scans(tmp_path / "b.npz", ScanSet(recorded.scans, poses=moved))
    a, b = evaluated(
        CURVED, tmp_path / "map.yaml", "--scans", scans, "--scans", tmp_path / "b.npz",
        "--method", "fused",
    )  # fmt: skip
    assert (a["map"], b["map"]) == ("curved", tmp_path.name)
    assert b["index"]["value"] == pytest.approx(a["index"]["value"], abs=0.01)
    assert [s["at_1"] for s in a["success"]] == [s["at_1"] for s in b["success"]]
    assert a["success"][0]["at_1"]["hits"] >= 5


def test_range_max_cuts_recorded_readings(scans: Path) -> None:
    words = (CURVED, "--scans", scans, "--method", "cbml", "--cell", 0.2)
    (whole,), (short,) = evaluated(*words), evaluated(*words, "--range-max", 2)
    assert short["source"]["range_max"] == 2
    assert short["index"]["value"] < whole["index"]["value"]


def test_steps_and_cells_are_those_of_all_methods(scans: Path) -> None:
    words = ("--method", "ght,ght-v", "--theta-step-deg", "20", "--cell", "0.2")
    for row in evaluated(CURVED, "--scans", scans, *words):
        assert row["lattice"]["theta_step"] == pytest.approx(np.deg2rad(20))
        assert row["lattice"]["cell"] == 0.2


def test_the_table_shows_every_method_thrice() -> None:
    code, out, err = call("evaluate", "curved", "-n", 2, *QUICK, "--tolerance", "0.3,10")
    assert (code, err) == (0, "")
    for method in ("fused", "ght-v"):
        assert sum(line.startswith(f"| curved | {method} ") for line in out.splitlines()) == 3
    assert "0.3 m 10 deg @1" in out
    assert "100.0 [34, 100]" in out
    assert "nan" not in out
    tables = out.split("\n\n")
    assert len(tables) == 3
    for table in tables:
        assert len({len(line) for line in table.splitlines()[1:]}) == 1


@pytest.mark.skipif(os.name != "posix", reason="terminals of POSIX")
def test_no_line_of_the_table_is_wider_than_the_terminal() -> None:
    pty, termios = (importlib.import_module(name) for name in ("pty", "termios"))
    leader, follower = pty.openpty()
    termios.tcsetwinsize(follower, (24, 80))
    words = command(["evaluate", "curved", "-n", 1, "--method", "fused", "--tolerance", "0.3,10"])
    plain = {key: value for key, value in os.environ.items() if key not in ("COLUMNS", "LINES")}
    with subprocess.Popen(words, stdout=follower, stderr=subprocess.DEVNULL, env=plain) as run:
        os.close(follower)
        shown = b""
        with contextlib.suppress(OSError):  # so a terminal says that its other end is closed
            while piece := os.read(leader, 100_000):
                shown += piece
    os.close(leader)
    assert run.returncode == 0
    lines = shown.decode().splitlines()
    assert max(map(len, lines)) <= 80
    assert sum(line.startswith("| curved | fused ") for line in lines) > 3
    for name in ("unique, wrong", "stack ms", "within 1 cell %"):
        assert sum(name in line for line in lines) == 1


@pytest.mark.parametrize(
    ("words", "code", "expected"),
    [
        (["--method", "cbml,cmbl"], 2, "--method: got 'cmbl', expected fused,cbml,"),
        (["--cell", "x"], 2, "--cell: got 'x', expected metres"),
        (["--tolerance", "0.3"], 2, "--tolerance: got '0.3', expected 2 numbers"),
        (["--flipped"], 2, "--flipped: is no option here; imgloc convert LOG scans.npz"),
        (["--sample", "3"], 2, "--sample: is for evaluate --scans, not"),
        (["-n", "1000000"], 2, "-n: got 1000000"),
        (["--scans", "SCANS", "-n", "4"], 2, "-n: is for evaluate without --scans"),
        (["--rays", "90"], 2, "--rays: is no option here; imgloc simulate has it"),
        (["--scans", "SCANS", "--scans", "SCANS"], 2, "got 2 for 1 maps"),
        (["--scans", "no.npz"], 4, "no.npz"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_refuses(words: list[str], code: int, expected: str, scans: Path) -> None:
    given = [str(scans) if w == "SCANS" else w for w in words]
    run = call("evaluate", CURVED, "--method", "fused", *given).ends(code, out="")
    assert expected in " ".join(run.err.split())


def test_scans_without_poses_cannot_be_compared(scans: Path, tmp_path: Path) -> None:
    bare = tmp_path / "bare.npz"
    save_scans(bare, ScanSet(load_scans(scans).scans))
    code, out, err = call("evaluate", CURVED, "--scans", bare)
    assert (code, out) == (4, "")
    assert "bare.npz: no poses" in err


def test_an_unknown_name_is_a_missing_map() -> None:
    code, _, err = call("evaluate", "curvy")
    assert code == 3
    assert "curvy" in err


def test_real_data(shared: Path) -> None:
    folder = shared / "data" / "fr079"
    words = ("--scans", folder / "scans.npz", "--sample", 3, "--range-max", 20)
    (row,) = evaluated(folder / "map.yaml", *words, "--method", "fused")
    assert row["map"] == "fr079"
    assert row["success"][1]["at_1"]["hits"] == 3
    assert row["outside"] == 0
