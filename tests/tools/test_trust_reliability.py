"""Reliability, NEES and verdicts against true poses, and the command that measures them."""

import json
from dataclasses import replace

import numpy as np
import pytest
from command import ROOT, run

from imgloc import Hypothesis, Localization, Pose2D, ScanSet, Sensor, prepare, save_map, save_scans
from imgloc.simulation.scans import simulate
from imgloc.simulation.worlds import WORLDS, render
from tools.trust.__main__ import main
from tools.trust.precision import precision
from tools.trust.reliability import (
    Judged,
    count_verdicts,
    judge_answer,
    judged,
    mean_nees,
    nees_band,
    reliability,
    summary,
)


def answer(verdict, *told):
    """An answer of (x, theta, mass) with deviations of 0.1 m and 0.1 rad."""
    cov = np.diag([0.01, 0.01, 0.01])
    return Localization(
        tuple(Hypothesis(Pose2D(x, 0.0, theta), 0.0, mass, cov) for x, theta, mass in told),
        verdict, 0.0, 1.0,
    )  # fmt: skip


def test_near_is_right_and_far_is_wrong():
    one = judge_answer(answer("unique", (0.1, 0.2, 0.95), (5.0, 0.0, 0.05)), Pose2D(0.0, 0.0))
    assert one.right.tolist() == [True, False]
    assert not one.wrong
    assert one.nees == pytest.approx((0.01 + 0.04) / 0.01)
    far = judge_answer(answer("unique", (1.1, 0.0, 0.95)), Pose2D(0.0, 0.0))
    assert far.wrong
    assert np.isnan(far.nees)
    turned = judge_answer(answer("unique", (0.0, 0.4, 0.95)), Pose2D(0.0, 0.0))
    assert turned.wrong
    between = judge_answer(answer("unique", (0.7, 0.0, 0.95)), Pose2D(0.0, 0.0))
    assert (between.wrong, between.right.tolist()) == (False, [False])
    unsure = judge_answer(answer("ambiguous", (9.0, 0.0, 0.6), (3.0, 0.0, 0.009)), Pose2D(0.0, 0.0))
    assert (unsure.wrong, unsure.mass.tolist()) == (False, [0.6])  # small masses say nothing


def test_angles_are_compared_around_the_circle():
    one = judge_answer(answer("unique", (0.0, 3.1, 1.0)), Pose2D(0.0, 0.0, -3.1))
    assert one.right.all()
    assert one.nees == pytest.approx((2 * np.pi - 6.2) ** 2 / 0.01)


def test_bins_count_and_compare():
    told = [
        Judged(np.array([1.0]), np.array([True]), "unique", False, 3.0),
        Judged(np.array([0.95, 0.02]), np.array([False, False]), "unique", True, np.nan),
    ]
    rows, ece = reliability(told)
    assert [row.count for row in rows] == [1, 0, 0, 0, 0, 0, 0, 0, 0, 2]
    assert rows[-1].right.value == 0.5
    assert ece == pytest.approx((2 * (0.975 - 0.5) + 0.02) / 3)
    assert reliability([])[1] == 0
    assert count_verdicts(told) == {"unique": 2}
    assert mean_nees(told) == {"mean": 3.0, "trials": 1, "band": nees_band(1)}


@pytest.mark.parametrize("count", [10, 100, 1000])
def test_the_band_is_that_of_chi_square(count):
    rng = np.random.default_rng(0)
    means = rng.chisquare(3 * count, 200_000) / count
    np.testing.assert_allclose(nees_band(count), np.quantile(means, [0.025, 0.975]), rtol=0.01)


def test_simulated_scans_are_judged():
    grid = render(WORLDS["curved"](), 0.1)
    scans = simulate(grid, 3, 5, Sensor(), render(WORLDS["curved"](), 0.01))
    calls = []
    told = list(judged(prepare(grid), scans, advance=lambda: calls.append(1)))
    assert len(told) == len(calls) == 3
    assert all(t.right[0] for t in told)
    other = list(judged(prepare(render(WORLDS["corridor"](), 0.1)), scans))
    assert not any(t.verdict == "unique" for t in other)


def test_the_summary_counts_simulated_recorded_and_other_maps():
    good = Judged(np.array([0.95]), np.array([True]), "unique", False, 3.0)
    bad = Judged(np.array([0.85, 0.1]), np.array([False, True]), "unique", True, np.nan)
    none = Judged(np.array([0.4]), np.array([False]), "no-match", False, np.nan)
    rows, said = summary({"a": [good, bad], "b": [good]}, {"c": [bad, good]}, [none, bad])
    assert (rows[9].count, rows[8].count, rows[1].count) == (2, 1, 1)
    assert said["right of mass 0.8 and more"]["hits"] == 2
    assert said["unique but wrong, simulated"]["hits"] == 1
    assert said["unique but wrong, recorded"]["trials"] == 2
    assert said["not unique in another map"]["value"] == 0.5
    assert {name: said["nees"][name]["trials"] for name in "ab"} == {"a": 1, "b": 1}
    assert said["recorded"]["c"]["verdicts"] == {"unique": 2}
    assert said["recorded"]["c"]["nees"]["mean"] == 3.0


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (("--picture", "tools/demo.png"), 1, "exists already"),
        (("-n", 0), 2, "n must be"),
        (("--sets", "nowhere/map.yaml"), 4, "scans.npz"),
    ],
)
def test_the_tool_refuses_in_one_line_before_it_measures(words, code, said):
    words = [ROOT / w if "tools/" in str(w) else w for w in words]
    done = run(main, "reliability", *words).ends(code, out="")
    assert done.err.count("\n") == 1
    assert said in done.err


def test_the_tool_writes_numbers_and_a_picture(tmp_path):
    grid = render(WORLDS["curved"](), 0.1)
    save_map(tmp_path / "map.yaml", grid)
    save_scans(tmp_path / "scans.npz", simulate(grid, 2, 3, Sensor()))
    words = ("-n", 1, "--picture", tmp_path / "r.png", "--sets", tmp_path / "map.yaml")
    # From where a robot can be there is nothing so near.
    found = json.loads(run(main, "reliability", *words, "--range-max", 0.31).ends(0).out)
    assert found["range_max"] == 0.31
    assert found["unique but wrong, simulated"]["trials"] == 5
    assert found["recorded"][tmp_path.name]["verdicts"] == {"invalid": 1}
    assert set(found["nees"]) == set(WORLDS)
    assert (tmp_path / "r.png").read_bytes().startswith(b"\x89PNG")


def test_covariances_are_held_against_truth_halves_and_single_readings(capsys):
    assert main(["precision", "-n", "1", "--worlds", "curved"]) == 0
    rows = capsys.readouterr().out.splitlines()
    assert len(rows) == 2 + 4
    assert rows[-1].startswith("| curved, noise of 10 cm |")
    scans = simulate(render(WORLDS["curved"](), 0.1), 1, 0)
    features = prepare(render(WORLDS["curved"](), 0.1))
    assert precision("", features, ScanSet((), poses=None)).answers == 0
    lenient, strict = (
        precision("", features, replace(scans, poses=scans.poses + (0.08, 0, 0)), truth=truth)
        for truth in ((1.0, 1.0, 1.0), (1e-6, 1e-6, 1e-6))
    )
    assert lenient.inside == 1
    assert strict.inside < 1  # 8 cm beside the truth is not within a centimetre
    assert lenient.claimed == strict.claimed


def test_the_mean_error_is_given_along_the_view_and_to_its_left():
    grid = render(WORLDS["visibility"](), 0.1)
    scans = simulate(grid, 3, 0, Sensor(fov=np.pi))
    ahead, left = np.array([[0.2, 0.0], [0.0, 0.1]])
    x, y, theta = scans.poses.T
    for off in (ahead, left):  # the poses that are told are behind and to the right of the answers
        told = np.column_stack(
            (
                x - off[0] * np.cos(theta) + off[1] * np.sin(theta),
                y - off[0] * np.sin(theta) - off[1] * np.cos(theta),
                theta,
            )
        )
        found = precision("", prepare(grid), replace(scans, poses=told))
        np.testing.assert_allclose(found.bias, off, atol=0.03)
        assert found.ratio < 1
