"""The table of Sec. VI: its trials, its rows, and what is claimed of them."""

from dataclasses import replace

import numpy as np
import pytest

from imgloc.geometry import uniform_thetas
from imgloc.lab.evaluation import evaluate, method_options, share
from imgloc.lab.performance_index import Index
from tools.paper.claims import ORDER, claims, growth_claims, time_claims
from tools.paper.complexity import Complexity, PowerLaw, Sample
from tools.paper.table import (
    PAIRS,
    STEPS_DEG,
    Outcome,
    Ratio,
    TableRow,
    gain,
    measure_ratios,
    place,
    stack_of,
    table,
)


@pytest.fixture(scope="module")
def curved():
    return {row.method: row for row in table(3, 7, worlds=["curved"], threads=2)}


def test_every_method_has_a_row_of_all_trials(curved):
    assert list(curved) == list(STEPS_DEG)
    assert {row.index.trials for row in curved.values()} == {3}
    assert {len(row.ms) for row in curved.values()} == {3}


def test_no_s_is_above_that_of_a_method_that_knows(curved):
    for row in curved.values():
        assert row.index.value < row.log_poses
    finer = curved["cbml"].log_poses - curved["ght"].log_poses
    assert finer == pytest.approx(np.log(10))  # 3 and 30 degrees


def test_the_oracle_is_above_all_methods_and_better_for_its_temperature(curved):
    assert curved["beam"].index.value > max(curved[m].index.value for m in ORDER)
    assert curved["beam"].index.value > curved["beam"].bare.value


def test_a_maximum_in_the_cell_is_also_next_to_it_and_in_the_wider_cell(curved):
    for row in curved.values():
        assert row.exact.hits <= row.near.hits
        assert row.exact.hits <= row.wide.hits
        if row.step_deg == 30:
            assert row.exact == row.wide


def test_only_options_of_ght_v_are_compared_with_it(curved):
    for method, row in curved.items():
        assert (row.gain is not None) == (method == "ght-v once")
        if row.gain is not None:
            plain = curved["ght-v"].index.value
            assert row.gain.value == pytest.approx(row.index.value - plain)


def test_a_gain_is_paired():
    ours, theirs = (
        [Outcome(d, None, True, True, True, 1.0) for d in some]
        for some in ((2.0, 20.0, 200.0), (1.0, 10.0, 100.0))
    )
    found = gain(ours, theirs)
    assert found.value == pytest.approx(np.log(2), abs=1e-3)
    assert found.standard_error < 1e-3  # though both scatter by more than two nats
    assert gain(theirs, ours).value == pytest.approx(-found.value)
    assert np.isnan(gain(ours[:1], theirs[:1]).standard_error)


def test_the_table_says_what_evaluate_says(curved):
    features, scans = place("curved", 3, 7)
    for method in ("ght-v", "beam"):
        summary, row = evaluate(features, scans, method_options(method)).summary, curved[method]
        index = row.bare or row.index  # `evaluate` tells of stacks as they are
        assert summary.index.value == pytest.approx(index.value, abs=1e-4)
        assert summary.exact.hits == row.exact.hits
        assert summary.near.hits == row.near.hits


def test_the_options_of_ght_v_change_its_votes():
    features, scans = place("curved", 1, 0)
    thetas = uniform_thetas(np.deg2rad(30))
    plain, once = (stack_of(m, features, scans.scans[0], thetas) for m in ("ght-v", "ght-v once"))
    assert (once <= plain).all()
    assert once.sum() < plain.sum()


def test_threads_change_nothing_but_times():
    rows = [table(2, 3, worlds=["curved"], methods=["ght-v", "cbml-o"], threads=t) for t in (1, 3)]
    one, three = ([replace(row, ms=()) for row in some] for some in rows)
    assert one == three


def made_up(world, s, error=0.1, hits=8):
    """Rows of the four methods with given indices."""
    some, every = share([True] * hits + [False] * (10 - hits)), share([True] * 10)
    return [
        TableRow(
            world, method, 3.0, Index(value, error, 10, 0, 1e-3), None, None, 14.0,
            some, some, every, None, (1.0,) * 3,
        )
        for method, value in zip(ORDER, s, strict=True)
    ]  # fmt: skip


def test_claims_hold_for_a_table_like_the_papers():
    assert all(c.holds for c in claims(made_up("a", (-0.5, 0.7, 2.9, 3.7))))


@pytest.mark.parametrize(
    ("rows", "failing"),
    [
        (made_up("a", (-0.5, 0.7, 3.7, 2.9)), "CBML < CBML-O < GHT < GHT-V"),
        (made_up("a", (-0.5, -0.2, 2.9, 3.7)), "intervals of CBML and CBML-O"),
        (made_up("a", (-0.5, 0.7, 0.8, 0.9)), "intervals of CBML-O and GHT-V"),
        (made_up("a", (-0.5, 0.7, 2.9, 3.7), hits=6), "70 %"),
    ],
)
def test_a_claim_that_does_not_hold_is_told(rows, failing):
    assert [failing in c.text for c in claims(rows) if not c.holds] == [True]


def test_times_are_claimed_of_each_pair():
    ratios = [
        Ratio("a", "cbml-o", "cbml", 1.3, 6.0, 5.0, 1.2),
        Ratio("a", "ght-v", "ght", 1.1, 6, 5, 1.2),
    ]
    told = time_claims(ratios)
    assert [(c.holds, c.found, c.firm) for c in told] == [
        (True, "1.20 x", False),
        (False, "1.20 x", False),
    ]


def grown(**changed):
    """Exponents of the appendix, but for those given as method_axis."""
    said = {
        ("cbml", "rho_m"): 2, ("cbml", "rho_theta"): 1,
        **{(m, a): p for m in ("ght", "ght-v")
           for a, p in (("A", 1), ("rho_m", 1), ("rho_theta", 0), ("n", 1))},
    }  # fmt: skip
    fits = [PowerLaw(m, a, "work", changed.get(f"{m}_{a}", p), None) for (m, a), p in said.items()]
    fits += [PowerLaw("beam", "rho_m", q, p, 3) for q, p in (("init_work", 2.0), ("traced", 3.0))]
    fits.append(PowerLaw("cbml", "rho_m", "init_work", changed.get("blur", 3.0), None))
    votes = {"ght": 100, "ght-v": changed.get("votes", 80)}
    samples = tuple(Sample(m, "n", 90, 0, 0, 1, 1, work) for m, work in votes.items())
    return Complexity("curved", samples, tuple(fits))


def test_exponents_within_the_tolerance_hold():
    assert all(c.holds for c in growth_claims(grown(ght_n=1.14, cbml_rho_m=1.86)))


@pytest.mark.parametrize("axis", ["ght_n", "ght_rho_theta", "cbml_rho_m"])
def test_other_exponents_do_not(axis):
    failing = [c for c in growth_claims(grown(**{axis: 1.5})) if not c.holds]
    assert [c.text.split(":")[0] for c in failing] == [axis.split("_")[0].upper()]
    assert failing[0].firm


@pytest.mark.parametrize(
    ("changed", "told"), [({"votes": 101}, "no dearer"), ({"blur": 4}, "blur")]
)
def test_what_is_beyond_the_paper_is_claimed_too(changed, told):
    assert [told in c.text for c in growth_claims(grown(**changed)) if not c.holds] == [True]


# --- run times compared fairly: turns, medians, and who is compared with whom


def test_each_pair_is_measured_in_each_world():
    taken = []
    found = measure_ratios(2, 1, trials=3, worlds=("curved",), advance=lambda: taken.append(1))
    assert [(r.world, r.method, r.rival, r.most) for r in found] == [("curved", *p) for p in PAIRS]
    assert all(r.value > 0 and r.ms > 0 and r.rival_ms > 0 for r in found)
    assert len(taken) == 2 * len(PAIRS)
    claims = time_claims(found)
    assert [c.holds for c in claims] == [r.value <= r.most for r in found]
