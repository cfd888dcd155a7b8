"""`--memory-budget` of the commands: said with -v, refused before anything is done."""

import logging
from pathlib import Path

import pytest
from command import MAPS, call

CURVED = MAPS / "curved.yaml"
EVALUATE = ["evaluate", CURVED, "-n", 1, "--methods", "ght-v,cbml", "--threads", 1]
SIMULATE = ["simulate", CURVED, "-n", 2, "--out", "{}/s.npz"]
SHOW = ["map", "show", CURVED, "--what", "bmap", "--out", "{}/m.png"]


def words(command: list[object], folder: Path) -> list[object]:
    return [w.format(folder) if isinstance(w, str) else w for w in command]


@pytest.mark.parametrize(
    ("command", "budget", "expected"),
    [
        (SIMULATE, "1M", ["simulating 2 scans of 181 rays on 1300 x 1600 cells", "fewer scans"]),
        (SHOW, "1M", ["a picture (bmap) of 910 x 1120 pixels", "a larger --cell"]),
        ([*SHOW, "--what", "map"], "1M", ["a picture (map) of", "crop the map"]),
        (EVALUATE, "15M", ["simulating 1 scans of 181 rays on", "cells needs"]),
        (EVALUATE, "100M", ["cbml on 130 x 160 cells of 0.1 m", "a larger --cell"]),
    ],
)
def test_over_budget_is_refused_with_sizes(
    command: list[object], budget: str, expected: list[str], tmp_path: Path
) -> None:
    code, out, err = call(*words(command, tmp_path), "--memory-budget", budget)
    assert (code, out) == (2, "")
    assert "curved.yaml: " in err
    assert f"the budget is {budget.removesuffix('M')} MiB" in err
    assert err.strip().endswith("or raise --memory-budget")
    for text in expected:
        assert text in err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("command", [SIMULATE, SHOW, EVALUATE])
def test_within_the_budget_it_is_said_and_done(
    command: list[object], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.INFO):
        code, _, err = call(*words(command, tmp_path), "--memory-budget", "2G", "-v")
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
