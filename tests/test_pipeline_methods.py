"""Every method of the pipeline on every bundled world, and the stacks of the paper's methods."""

import dataclasses
import json

import numpy as np
import pytest
from places import POSES, answer_of, error, facts, features_of, grid_of, scan_of

from imgloc import ALL_METHODS, METHODS, ConfigError, Options, likelihood, localize, prepare
from imgloc.features.budget import stack_bytes
from imgloc.geometry import cell_of, uniform_thetas, wrap
from imgloc.likelihoods.posterior import posterior
from imgloc.model import VERDICTS
from imgloc.options import AT_MOST
from imgloc.simulation.worlds import WORLDS


@pytest.mark.parametrize("method", ALL_METHODS)
@pytest.mark.parametrize("name", WORLDS)
def test_the_true_pose_is_found(name, method):
    answer = answer_of(name, method)
    metres, radians = error(answer.pose, POSES[name])
    assert metres < (0.1 if method == "fused" else 0.4)
    assert radians < np.deg2rad(2 if method == "fused" else 8)
    assert answer.explained > 0.6  # a stack knows its poses to half a cell and half a step
    assert answer.verdict in ("unique", "ambiguous")


@pytest.mark.parametrize("name", WORLDS)
def test_an_unambiguous_pose_is_unique(name):
    answer = answer_of(name, "fused")
    assert answer.verdict == "unique"
    assert answer.hypotheses[0].mass > 0.9
    assert answer.entropy < 0.4


@pytest.mark.parametrize("method", ALL_METHODS)
@pytest.mark.parametrize("name", ["double_wall", "curved"])
def test_threads_change_nothing(name, method):
    assert facts(answer_of(name, method)) == facts(answer_of(name, method, threads=2))


@pytest.mark.parametrize("method", ALL_METHODS)
def test_the_same_input_gives_the_same_answer(method):
    again = localize(
        prepare(grid_of("curved"), cell=0.2, n_rays=120), scan_of("curved"), Options(method=method)
    )
    assert facts(again) == facts(answer_of("curved", method))


@pytest.mark.parametrize("method", ALL_METHODS)
@pytest.mark.parametrize("name", ["double_wall", "corridor"])
def test_what_an_answer_holds(name, method):
    answer = answer_of(name, method)
    scan = scan_of(name)
    assert answer.verdict in VERDICTS
    assert answer.best == answer.hypotheses[0].pose
    assert 1 <= len(answer.hypotheses) <= AT_MOST
    score = [h.log_likelihood for h in answer.hypotheses]
    assert score == sorted(score, reverse=True)
    mass = np.array([h.mass for h in answer.hypotheses])
    assert np.all(mass >= 0)
    assert mass.sum() <= 1 + 1e-6
    assert answer.entropy >= 0
    assert 0 <= answer.explained <= 1
    for h in answer.hypotheses:
        np.testing.assert_allclose(h.covariance, h.covariance.T, atol=1e-12)
        assert np.all(np.linalg.eigvalsh(h.covariance) > 0)
    assert answer.counts == scan.counts
    assert all(t >= 0 for t in answer.timings_ms.values())
    assert answer.parameters["method"] == method
    assert "threads" not in answer.parameters
    assert "seed" in answer.parameters
    json.dumps(dict(answer.parameters))


# --- stacks


@pytest.mark.parametrize("method", METHODS)
def test_a_stack_lies_on_the_lattice_of_the_features(method):
    features = features_of("curved")
    stack = likelihood(features, scan_of("curved"), Options(method=method))
    assert stack.method == method
    assert stack.grid == features.lattice
    assert stack.grid.resolution == pytest.approx(0.2)
    step = np.deg2rad(METHODS[method].theta_step_deg)
    np.testing.assert_array_equal(stack.thetas, uniform_thetas(step))
    # The first hypothesis stands at the maximum of the posterior.
    probability = posterior(stack.values, method, features.free)
    assert probability.sum(dtype=float) == pytest.approx(1, abs=1e-4)
    k, row, column = np.unravel_index(probability.argmax(), probability.shape)
    pose = answer_of("curved", method).pose
    at = cell_of(np.array([pose.x, pose.y]), 0.2)
    assert np.abs(at - (row, column)).max() <= 2
    assert abs(wrap(pose.theta - stack.thetas[k])) <= 2.01 * step


@pytest.mark.parametrize("method", METHODS)
def test_invalid_readings_are_no_part_of_a_stack(method):
    scan = scan_of("curved")
    ranges = scan.ranges.copy()
    ranges[::5], ranges[1::30], ranges[2::30], ranges[3::30] = np.nan, -np.inf, 40.0, 0.0
    lost = dataclasses.replace(scan, ranges=ranges)
    kept = dataclasses.replace(scan, ranges=ranges[lost.valid], angles=scan.angles[lost.valid])
    a, b = (likelihood(features_of("curved"), s, Options(method=method)) for s in (lost, kept))
    assert a.values.any()
    np.testing.assert_array_equal(a.values, b.values)


def test_visibility_takes_votes_away_and_adds_none():
    ght, ght_v = (
        likelihood(features_of("visibility"), scan_of("visibility"), Options(method=m)).values
        for m in ("ght", "ght-v")
    )
    assert np.all(ght_v <= ght)
    assert 0.05 * ght.sum() < ght_v.sum() < 0.95 * ght.sum()


@pytest.mark.parametrize("method", METHODS)
def test_the_step_of_theta_is_an_option(method):
    options = Options(method=method, theta_step=np.deg2rad(24))
    stack = likelihood(features_of("curved"), scan_of("curved"), options)
    assert len(stack.thetas) == 15


@pytest.mark.parametrize("method", METHODS)
def test_too_large_a_stack_is_refused_before_it_is_made(method):
    features = features_of("curved")
    height, width = features.lattice.shape
    k = len(uniform_thetas(np.deg2rad(METHODS[method].theta_step_deg)))
    need = stack_bytes(method, (height, width), k, n_rays=features.n_rays)
    small = Options(method=method, memory_budget=need - 1)
    for run in (likelihood, localize):
        with pytest.raises(ConfigError, match=rf"{k} headings x {height} x {width} cells"):
            run(features, scan_of("curved"), small)
    likelihood(features, scan_of("curved"), dataclasses.replace(small, memory_budget=need))
