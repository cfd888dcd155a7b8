"""Constants of trust: fitted to cases that were made with known ones, and by the tool."""

import json
from collections import Counter
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from imgloc import LaserScan, OccupancyGrid, Trust, prepare, simulate
from imgloc.numbers import FILE, read
from imgloc.search.hypotheses import masses
from imgloc.simulation.worlds import WORLDS, render
from tools.trust.__main__ import main
from tools.trust.disturb import MAPS, PRIORS, SCANS, shut
from tools.trust.fit import (
    Case,
    case_of,
    cases_on_floors,
    conditions_table,
    fit_trust,
    numbers_of,
    trust_of,
)
from tools.trust.foreign import Asked


@cache
def made(n=600, seed=0):
    """Cases whose true mode is drawn with the masses of a known temperature."""
    rng, out, true = np.random.default_rng(seed), [], Trust(temperature=4.0, strain=6.0)
    for k in range(n):
        misfit, readings = rng.uniform(0, 2), int(rng.integers(20, 200))
        score = -np.sort(rng.exponential(30.0, 6))
        mass = masses(score, true.temperature_at(misfit, readings, 0.05).value)
        right = np.arange(6) == rng.choice(6, p=mass)
        if k % 3 == 0:  # of another place
            right[:] = False
        gap = rng.normal(-1.0 if k % 3 == 0 else 1.0, 0.5)
        out.append(Case(f"house {k // 3 % 3}", "some", score, right, readings, misfit, gap, 0.05))
    return out


def test_known_constants_come_back():
    cases = made()
    fit = fit_trust(cases)
    assert fit.temperature == pytest.approx(4.0, rel=0.25)
    assert fit.strain / 1.25 == pytest.approx(6.0, rel=0.25)
    assert fit.elsewhere[1] < 0  # what a building on no map does not explain is for the map
    assert fit.cases == {"some": len(cases)}
    assert fit.loss[0] < fit.now[0]
    assert np.all(np.array(fit.left_out) >= np.array(fit.loss) - 0.01)
    row = conditions_table(cases, trust_of(fit)).splitlines()[-1].split("|")
    assert row[1].strip() == "some"
    assert float(row[-2]) < 0.05  # calibrated


def test_a_temperature_that_is_held_stays():
    now = Trust().temperature, Trust().strain
    fit = fit_trust(made(), held=now)
    assert (fit.temperature, fit.strain) == now
    assert fit.loss[1] < fit.now[1]


def test_what_is_fitted_is_written_with_its_command_and_data():
    fit = replace(fit_trust(made(), held=(3.0, 5.0)), elsewhere=(-2.0, -0.5, 1.234))
    text = FILE.read_text("utf-8")
    sources, numbers = read(numbers_of(fit, text, "tools.trust fit", "2030-01-02", held=True))
    assert numbers["Trust.elsewhere"].value == (-2.0, -0.5, 1.23)
    assert sources["trust-fit"].date == "2030-01-02"
    assert sources["trust-fit"].on == "3 buildings: 600 cases, 1 conditions"
    assert numbers["Trust.temperature"].value == Trust().temperature
    sources, numbers = read(numbers_of(fit, text, "tools.trust fit", "2030-01-02", held=False))
    assert (numbers["Trust.temperature"].value, numbers["Trust.strain"].value) == (3.0, 5.0)
    assert sources["temperature-fit"].by == "tools.trust fit"


def test_disturbances_change_what_they_say_and_nothing_else():
    grid = render(WORLDS["curved"](), 0.1)
    scan = simulate(grid, 1, 0).scans[0]
    for name, change in SCANS.items():
        once, again = (change(scan, np.random.default_rng(3)) for _ in range(2))
        np.testing.assert_array_equal(once.ranges, again.ranges)
        same = once.ranges.shape == scan.ranges.shape and np.array_equal(once.ranges, scan.ranges)
        assert same == (name in ("undisturbed", "reach of 5 m"))
    longer = SCANS["ranges + 0.15 m"](scan, np.random.default_rng(0))
    assert longer.ranges[scan.valid] == pytest.approx(scan.ranges[scan.valid] + 0.15)
    assert SCANS["reach of 5 m"](scan, np.random.default_rng(0)).range_max == 5
    assert SCANS["18 beams"](scan, np.random.default_rng(0)).ranges.shape == (18,)
    far = SCANS["people"](scan, np.random.default_rng(1))
    assert np.all(far.ranges[scan.valid] <= scan.ranges[scan.valid])
    for name, alter in MAPS.items():
        changed = alter(grid, np.random.default_rng(3))
        assert not (changed.occupied & changed.free).any()
        assert (changed is grid) == (name == "undisturbed")
    thick = MAPS["walls dilated by 2 cells"](grid, np.random.default_rng(0))
    assert thick.occupied[grid.occupied].all()
    half = MAPS["half the map"](grid, np.random.default_rng(0))
    assert 0.3 < half.occupied.sum() / grid.occupied.sum() < 0.7


def test_a_doorway_is_shut_and_a_corridor_stays_open():
    walls = np.pad(np.zeros((60, 80), bool), 1, constant_values=True)
    walls[:, 40] = True
    walls[20:29, 40] = False  # 0.9 m
    walls[45:56, 60:] = True
    walls[46:55, 60:] = False  # a corridor, 0.9 m wide and 2 m long
    grid = OccupancyGrid(walls, ~walls, 0.1)
    closed = shut(grid, np.random.default_rng(0), share=1.0)
    new = np.argwhere(closed.occupied & ~walls)
    assert new.tolist() == [[row, 40] for row in range(20, 29)]
    assert not (closed.free & closed.occupied).any()
    assert shut(grid, np.random.default_rng(0), share=0.0).occupied.sum() == walls.sum()


def test_furniture_goes_and_comes_and_walls_stay():
    walls = np.pad(np.zeros((98, 98), bool), 1, constant_values=True)
    table = np.zeros_like(walls)
    table[50:55, 50:55] = True
    grid = OccupancyGrid(walls | table, ~(walls | table), 0.1)
    gone = 0
    for seed in range(20):
        other = MAPS["furniture moved"](grid, np.random.default_rng(seed))
        assert other.occupied[walls].all()
        gone += not other.occupied[52, 52]
        assert 0 < (other.occupied & ~grid.occupied).mean() < 0.2
        assert other.free[table & ~other.occupied].all()
    assert 3 < gone < 17


def test_a_case_says_which_mode_is_right():
    grid = render(WORLDS["curved"](), 0.1)
    scans = simulate(grid, 1, 0)
    features, scan = prepare(grid), scans.scans[0]
    case = case_of(features, Asked("plain", "curved", scan, scans.poses[0]))
    assert case.right[0]
    assert case.right.sum() == 1
    assert case.gap > 0
    assert not case_of(features, Asked("away", "x", scan, None)).right.any()
    assert case_of(features, Asked("few", "x", LaserScan([1.0], [0.0]), None)) is None


def test_scans_of_other_floors_have_no_place():
    cases = list(cases_on_floors(3, 1))
    rows = Counter(c.condition for c in cases)
    assert rows["own floor"] == rows["another floor"] == rows["mirrored plan"] == 4
    assert rows["another floor, heading known to 30 deg"] == 4
    own = [c for c in cases if c.condition == "own floor"]
    assert sum(c.right[0] for c in own) >= 3
    assert not any(c.right.any() for c in cases if c.condition != "own floor")
    assert {c.building for c in cases} == {"building 3"}


def test_the_tool_prints_constants_and_a_table(capsys):
    assert main(["fit", "-n", "1", "--worlds", "curved", "--buildings", "0"]) == 0
    text = capsys.readouterr().out
    numbers, end = json.JSONDecoder().raw_decode(text)
    assert set(numbers["cases"]) <= set(SCANS) | set(MAPS) | set(PRIORS)
    assert numbers["cases"]["clearance of 0.3 m known"] == 1
    assert numbers["buildings"] == {"curved": sum(numbers["cases"].values())}
    assert "| people | 1 |" in text[end:]
    assert main(["fit", "-n", "0"]) == 2
