"""Levels held against the truth: spreads are found again, and who is misled is counted."""

import numpy as np
import pytest

from imgloc.search.protection import Spread
from tools.trust.levels import Answered, fit_spreads, held_table, risk_table, stanford_table

TRUE = Spread(0.8, 0.02, 5.0)


def answered(error, level, condition="undisturbed", building="A", mass=0.99, deviation=0.03):
    return Answered(
        building, condition, "unique", mass, np.array([error, 0.01]), np.array([deviation, 0.01]),
        np.array([[level, 0.1]] * 3),
    )  # fmt: skip


def drawn(building, n, seed):
    rng = np.random.default_rng(seed)
    for _ in range(n):
        deviation = rng.uniform(0.01, 0.06)
        t = rng.standard_normal(2) / np.sqrt(rng.chisquare(TRUE.tail) / TRUE.tail)
        error = np.linalg.norm(t) * TRUE.units(np.array(deviation))
        yield answered(float(error), 0.1, building=building, deviation=deviation)


def test_the_levels_of_a_fitted_spread_hold_answers_that_it_has_not_seen():
    fit = fit_spreads([*drawn("A", 400, 1), *drawn("B", 100, 2)])
    inside = np.array([fit.scaled(a)[:, 0] <= 1 for a in drawn("C", 2000, 3)]).mean(axis=0)
    assert inside == pytest.approx([0.95, 0.99, 0.999], abs=0.015)
    assert fit.buildings == {"A": 400, "B": 100}


def test_a_wrong_place_is_not_fitted():
    some = list(drawn("A", 100, 1))
    assert fit_spreads([*some, answered(30.0, 0.1)]) == fit_spreads(some)


def test_the_table_counts_who_is_misled():
    some = [answered(*pair) for pair in ((0.1, 0.2), (0.22, 0.2), (0.3, 0.2), (5.0, 0.2))]
    line = stanford_table([*some, answered(0.1, np.inf)]).splitlines()[-1]
    assert line == "| undisturbed | 5 | 0.80, 1, 2 | 0.80, 2, 1 | 0.80, 2, 1 |"


def test_risk_is_counted_at_each_mass():
    some = [answered(0.1, 0.2, mass=0.995), answered(5.0, 0.2, mass=0.9)]
    rows = {line.split(" | ")[0].strip("| "): line for line in risk_table(some).splitlines()}
    assert "| 1.000, 1 of 2 |" in rows["0.9"]
    assert "| 0.500, 0 of 1 |" in rows["0.99"]


def test_each_building_is_left_out_once():
    some = [*drawn("A", 20, 1), *drawn("B", 20, 2)]
    lines = held_table(some, fit_spreads(some)).splitlines()
    assert [line.split(" | ")[0] for line in lines[2:]] == ["| A", "| B"]
    assert "left out" in lines[0]
