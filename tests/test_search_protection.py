"""Protection levels: what they hold, what no radius holds, and what the other modes do to them."""

import math

import numpy as np
import pytest

from imgloc.model import Protection
from imgloc.search.protection import SHARES, Spread, levels, protection

GAUSSIAN = Spread(1.0, 0.0, 1e7)


def of(mass, away=(0.0, 8.0), elsewhere=0.0, deviation=0.02, shares=SHARES):
    poses = np.array([[5.0 + d, 2.0, 0.0] for d in away])
    covariance = np.diag([deviation**2, deviation**2, 1e-4])[None]
    return protection(poses, np.array(mass), covariance, elsewhere, shares)


def test_one_sure_gaussian_mode_has_the_radius_of_a_chi_square():
    at = np.zeros(1), np.array([0.1]), np.ones(1), 0.0
    found = levels(*at, SHARES, GAUSSIAN)
    expected = 0.1 * np.sqrt(-2 * np.log(1 - np.array(SHARES)))
    assert np.all((found >= expected * 0.999) & (found < 1.04 * expected))


@pytest.mark.parametrize(("axes", "tail"), [(1, None), (2, 4.0)])
def test_draws_of_a_spread_are_within_its_levels_as_often_as_these_say(axes, tail):
    rng, spread = np.random.default_rng(0), Spread(1.2, 0.03, tail)
    deviation, n = np.array([0.05]), 40_000
    draws = rng.standard_normal((n, axes))
    if tail is not None:
        draws /= np.sqrt(rng.chisquare(tail, (n, 1)) / tail)
    distance = np.linalg.norm(spread.units(deviation) * draws, axis=1)
    found = levels(np.zeros(1), deviation, np.ones(1), 0.0, SHARES, spread)
    held = (distance[:, None] <= found).mean(axis=0)
    assert held == pytest.approx(SHARES, abs=0.007)  # levels are rounded up
    assert np.all(held > np.array(SHARES) - 0.001)


def test_a_level_grows_with_the_mass_elsewhere_until_there_is_none():
    radii = [of([1 - e, 0.0], elsewhere=e)[0].metres for e in (0.0, 0.02, 0.049, 0.051)]
    assert radii == sorted(radii)
    assert radii[2] < 5
    assert radii[3] == math.inf


def test_a_second_mode_counts_once_its_mass_is_more_than_the_risk():
    (near,), (far,) = (of([1 - m, m], shares=[0.99]) for m in (0.004, 0.02))
    assert near.metres < 0.5
    assert 8 < far.metres < 9


def test_modes_without_a_covariance_are_as_uncertain_as_the_worst():
    covariance = np.diag([0.01, 0.01, 1e-4])[None]
    poses, mass = np.array([[0, 0, 0.0], [0, 0.3, 0.5]]), np.array([0.6, 0.4])
    both = np.concatenate((covariance, covariance))
    assert protection(poses, mass, covariance, 0.0) == protection(poses, mass, both, 0.0)


def test_a_heading_is_taken_around_the_circle():
    poses = np.array([[0, 0, np.pi - 0.01], [0, 0, -np.pi + 0.01]])
    (level,) = protection(
        poses, np.array([0.5, 0.5]), np.diag([1e-4, 1e-4, 1e-8])[None], 0.0, [0.9]
    )
    assert level.radians < 0.1


def test_a_level_that_is_larger_than_the_map_is_none():
    poses, covariance = np.zeros((1, 3)), np.diag([100.0, 100.0, 0.01])[None]
    free = [level.metres for level in protection(poses, np.ones(1), covariance, 0.0)]
    assert np.isfinite(free).all()
    for farthest in (1.01 * free[2], 1.01 * free[1], 1.01 * free[0], 0.99 * free[0]):
        found = protection(poses, np.ones(1), covariance, 0.0, farthest=farthest)
        expected = [metres if metres <= farthest else np.inf for metres in free]
        assert [level.metres for level in found] == expected
        assert all(np.isfinite(level.radians) for level in found)


def test_without_a_pose_no_radius_holds_anything():
    none = protection(np.empty((0, 3)), np.empty(0), np.empty((0, 3, 3)), 1.0)
    assert none == tuple(Protection(share, math.inf, math.inf) for share in SHARES)
