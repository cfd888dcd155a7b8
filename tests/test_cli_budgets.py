"""`--memory-budget` of the commands: said with -v, refused before anything is done."""

import logging
import re
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from command import MAPS, call, spawn

CURVED = MAPS / "curved.yaml"
EVALUATE = ["evaluate", CURVED, "-n", 1, "--methods", "ght-v,cbml", "--threads", 1]
SIMULATE = ["simulate", CURVED, "-n", 2, "--out", "{}/s.npz"]
SHOW = ["map", "show", CURVED, "--what", "bmap", "--out", "{}/m.png"]

LOCALIZE = ["localize", CURVED, "{}/../scans.npz", "--no-cache", "--threads", 1]
SAMPLE = ["sample", CURVED, "{}/../scans.npz", "--out", "{}/p.csv", "--threads", 1]
ATLAS = ["atlas", CURVED, "--out", "{}/a.png", "--step", 3, "--headings", 2,
         "--rays", 61, "--workers"]  # fmt: skip
CALIBRATE = ["calibrate", CURVED, "--methods", "ght", "--theta-step-deg", 15, "-n", 20,
             "--rays", 61, "--dry-run", "--threads"]  # fmt: skip
CHECK = ["map", "check", CURVED]
DEMO = ["demo", "--map", "curved", "--out", "{}/d.png", "--threads", 1]
BOTH = r"on 130 x 160 cells of 0.1 m \((\d+) MiB\) with features of 130 x 160 cells \((\d+) MiB\)"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """An empty one beside some scans."""
    run = call("simulate", CURVED, "-n", 2, "--rays", 61, "--out", tmp_path / "scans.npz")
    assert run.code == 0
    (tmp_path / "here").mkdir()
    return tmp_path / "here"


def words(command: list[object], folder: Path) -> list[object]:
    return [w.format(folder) if isinstance(w, str) else w for w in command]


@pytest.mark.parametrize(
    ("command", "budget", "expected"),
    [
        (SIMULATE, "10M", ["simulating 2 scans of 181 rays on 1300 x 1600 cells", "fewer scans"]),
        (EVALUATE, "15M", ["simulating 1 scans of 181 rays on", "cells needs"]),
        (EVALUATE, "100M", ["cbml on 130 x 160 cells of 0.1 m", "a larger --cell"]),
        (LOCALIZE, "60M", ["fused on 130 x 160 cells of 0.1 m", "features of 130 x 160 cells"]),
        ([*LOCALIZE, "--method", "beam"], "100M", ["beam on 130 x 160 cells", "--theta-step-deg"]),
        (SAMPLE, "60M", ["fused on 130 x 160 cells of 0.1 m", "features of 130 x 160 cells"]),
        ([*SAMPLE, "--method", "cbml"], "100M", ["cbml on 130 x 160 cells of 0.1 m", "a larger"]),
        ([*ATLAS, 1], "10M", ["simulating 18 scans of 61 rays on 1300 x 1600", "larger --step"]),
        ([*ATLAS, 1], "60M", ["fused on 130 x 160 cells of 0.1 m", "features of", "crop the map"]),
        ([*ATLAS, 2], "200M", ["fused on", "in each of 2 processes", "use fewer --workers"]),
        ([*CALIBRATE, 1], "10M", ["simulating 20 scans of 61 rays on", "fewer scans"]),
        ([*CALIBRATE, 1], "60M", ["ght on 130 x 160 cells of 0.1 m", "a larger --cell"]),
        ([*CALIBRATE, 4], "82M", ["ght on 130 x 160 cells of 0.1 m", "features of"]),
    ],
)
def test_over_budget_is_refused_with_sizes(
    command: list[object], budget: str, expected: list[str], folder: Path
) -> None:
    code, out, err = call(*words(command, folder), "--memory-budget", budget)
    assert (code, out) == (2, "")
    assert "curved.yaml: " in err
    assert f"the budget is {budget.removesuffix('M')} MiB" in err
    assert err.strip().endswith("or raise --memory-budget")
    for text in expected:
        assert text in err
    assert not list(folder.iterdir())


@pytest.mark.parametrize(
    "command",
    [SIMULATE, SHOW, EVALUATE, LOCALIZE, SAMPLE, [*ATLAS, 1], [*CALIBRATE, 1], CHECK, DEMO],
    ids=lambda command: " ".join(map(str, command[:2])),
)
def test_within_the_budget_it_is_said_and_done(
    command: list[object], folder: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.INFO):
        code, _, err = call(*words(command, folder), "--memory-budget", "2G", "-v")
    assert code == 0
    said = [line for line in (err + caplog.text).splitlines() if "at most" in line]
    assert said
    assert all(line.endswith("MiB, the budget is 2048 MiB") for line in said)


def test_every_method_is_checked_before_the_first_one_runs(
    caplog: pytest.LogCaptureFixture,
) -> None:
    with caplog.at_level(logging.INFO):
        code, out, err = call(*EVALUATE, "--memory-budget", "100M", "--json", "-v")
    assert (code, out) == (2, "")
    said = err + caplog.text
    assert "ght-v on" in said
    assert "curved: ght-v: S" not in said  # nothing has been measured


@pytest.mark.parametrize(
    ("command", "method"),
    [(LOCALIZE, "fused"), (SAMPLE, "fused"), ([*ATLAS, 1], "fused"), (EVALUATE, "ght-v")],
    ids=["localize", "sample", "atlas", "evaluate"],
)
def test_features_and_answer_have_to_fit_together(
    command: list[object], method: str, folder: Path
) -> None:
    given = words(command, folder)
    run = call(*given, "--memory-budget", "60M")
    found = re.search(f"{method} {BOTH}", run.err)
    assert found is not None
    answer, features = map(int, found.groups())
    assert features > 4
    each = call(*given, "--memory-budget", f"{answer + 1}M")
    assert (each.code, each.out) == (2, "")
    assert f"{method} on" in each.err
    if method == "fused":
        assert call(*given, "--memory-budget", f"{answer + features}M").code == 0


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


def test_every_method_of_a_calibration_is_checked_before_the_first_one_runs(
    folder: Path,
) -> None:
    low = [*CALIBRATE[:2], "--methods", "ght,beam", *CALIBRATE[4:], 1]
    run = call(*words(low, folder), "--memory-budget", "85M", "-v")
    assert (run.code, run.out) == (2, "")
    assert "ght on" in run.err
    assert "beam on 130 x 160 cells of 0.1 m" in run.err
    assert "Fit(" not in run.err  # nothing has been measured


def test_which_leaves_out_maps_that_need_more(folder: Path) -> None:
    for ending in (".yaml", ".png"):
        for name in ("curved", "large"):
            shutil.copy(MAPS / f"{name}{ending}", folder)
    given = ("which", folder, folder.parent / "scans.npz", "--no-cache", "-v")
    run = call(*given, "--memory-budget", "100M")
    assert run.code == 5
    assert run.err.count("left out: ") == 1
    assert "large.yaml: fused on 400 x 500 cells of 0.1 m" in run.err
    assert "with features of 400 x 500 cells" in run.err
    assert "the budget is 100 MiB: crop the map, or raise --memory-budget" in run.err
    assert re.search(r"curved.yaml: fused .*: at most \d+ MiB, the budget is 100 MiB", run.err)


@pytest.mark.parametrize("image", ["png", "pgm"])
def test_an_image_is_refused_by_its_header(image: str, tmp_path: Path) -> None:
    path = tmp_path / f"m.{image}"
    side = 1200
    if image == "pgm":
        path.write_bytes(b"P5 %d %d 255\n" % (side, side) + bytes(side * side))
    else:
        path.write_bytes(cv2.imencode(".png", np.zeros((side, side), np.uint8))[1])
    given = ("map", "check", path, "--resolution", 0.1, "--memory-budget")
    run = call(*given, "20M")
    assert (run.code, run.out) == (2, "")
    assert f"m.{image}: an image of 1200 x 1200 pixels needs" in run.err
    assert "crop the map, or raise --memory-budget" in run.err
    assert call(*given, "100M").code == 0


def test_what_is_no_image_is_still_said_to_be_none(tmp_path: Path) -> None:
    path = tmp_path / "m.png"
    path.write_text("no image")
    run = call("map", "check", path, "--resolution", 0.1, "--memory-budget", "1M")
    assert run.code == 3
    assert "not an image that can be read" in run.err


def test_a_demo_counts_the_stack_that_it_draws(folder: Path) -> None:
    run = call(*words(DEMO, folder), "--memory-budget", "90M")
    assert (run.code, run.out) == (2, "")
    assert "curved: cbml on 130 x 160 cells of 0.1 m" in run.err
    assert "use another --map" in run.err
    assert not list(folder.iterdir())


def test_the_real_command(folder: Path) -> None:
    run = spawn(*words([*ATLAS, 2], folder), "--memory-budget", "200M")
    assert (run.code, run.out) == (2, "")
    assert run.err.startswith("imgloc: error: ")
    assert not list(folder.iterdir())


@pytest.mark.parametrize(
    "command", [LOCALIZE, [*SAMPLE, "--method", "cbml"], EVALUATE], ids=lambda command: command[0]
)
def test_the_default_budget_is_that_of_the_start(
    command: list[object], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    left = [4 << 30]  # then others, and the features, have taken what there was
    monkeypatch.setattr("imgloc.features.budget.available_bytes", lambda: left.pop() if left else 0)
    if command == EVALUATE:
        command = ["evaluate", CURVED, "--scans", folder.parent / "scans.npz", *EVALUATE[4:]]
    assert call(*words(command, folder)).code == 0
