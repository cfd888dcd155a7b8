"""Entropy and draws of a posterior, against sums written out."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imgloc.answers.sample import draw_near, draw_poses
from imgloc.errors import ConfigError
from imgloc.geometry import cell_of, theta_bin, transform_poses, uniform_thetas, wrap
from imgloc.likelihoods.posterior import entropy
from imgloc.model import GridInfo, Hypothesis, Localization, Pose2D, inverse

GRID = GridInfo(2, 3, 0.5, Pose2D(7.0, -3.0, 1.0))
THETAS = uniform_thetas(np.pi / 2)
P = np.zeros((4, 2, 3), dtype=np.float32)
P[0, 0, 0], P[1, 0, 0], P[3, 1, 2] = 0.5, 0.25, 0.25


def test_entropy_of_a_stack_and_of_its_marginals():
    assert entropy(P) == pytest.approx(1.5 * np.log(2))
    assert entropy(P.sum(axis=0)) == pytest.approx(-0.75 * np.log(0.75) - 0.25 * np.log(0.25))
    assert entropy(np.full((4, 2, 3), 1 / 24, np.float32)) == pytest.approx(np.log(24), rel=1e-6)
    certain = np.zeros((4, 2, 3), np.float32)
    certain[2, 1, 1] = 1
    assert entropy(certain) == 0


def test_draws_have_the_shares_of_the_posterior():
    poses = draw_poses(P, THETAS, GRID, 20_000, np.random.default_rng(3))
    cells = cell_of(poses[:, :2], 0.5)
    drawn = np.zeros_like(P)
    np.add.at(drawn, (theta_bin(poses[:, 2], 4), cells[:, 0], cells[:, 1]), 1 / len(poses))
    np.testing.assert_allclose(drawn, P, atol=4 * np.sqrt(0.25 / len(poses)))
    assert (drawn[P == 0] == 0).all()


def test_draws_are_uniform_inside_a_cell():
    one = np.zeros_like(P)
    one[2, 1, 2] = 1e-20  # need not sum to 1
    poses = draw_poses(one, THETAS, GRID, 20_000, np.random.default_rng(0))
    low, high = (1.0, 0.5), (1.5, 1.0)
    for axis in range(2):
        inside = (poses[:, axis] - low[axis]) / (high[axis] - low[axis])
        assert inside.min() >= 0
        assert inside.max() <= 1
        assert np.histogram(inside, 4, (0, 1))[0] / 20_000 == pytest.approx([0.25] * 4, abs=0.02)
    # The cell of heading pi goes across the cut.
    turn = np.abs(poses[:, 2])
    assert turn.min() >= 0.75 * np.pi
    assert np.mean(poses[:, 2] > 0) == pytest.approx(0.5, abs=0.02)
    assert np.corrcoef(poses[:, 0], poses[:, 1])[0, 1] == pytest.approx(0, abs=0.03)


@given(st.integers(0, 2**32 - 1), st.integers(0, 50))
@settings(max_examples=20)
def test_the_same_seed_the_same_poses(seed, n):
    a, b = (draw_poses(P, THETAS, GRID, n, np.random.default_rng(seed)) for _ in range(2))
    assert a.shape == (n, 3)
    np.testing.assert_array_equal(a, b)


class Edges:
    """A generator that draws the ends of [0, 1)."""

    def __init__(self, share):
        self.share = share

    def random(self, shape):
        return np.full(shape, self.share)

    def uniform(self, low, high, shape):
        return np.full(shape, (low + high) / 2)


@pytest.mark.parametrize(
    ("share", "expected"), [(0.0, (0.25, 0.25, 0.0)), (1.0, (1.25, 0.75, -90))]
)
def test_the_ends_of_the_sums_are_poses_that_may_be(share, expected):
    (pose,) = draw_poses(P, THETAS, GRID, 1, Edges(share))
    np.testing.assert_allclose(pose[:2], expected[:2])
    assert np.rad2deg(pose[2]) == pytest.approx(expected[2])


def test_refuses_what_cannot_be_drawn():
    with pytest.raises(ConfigError, match="negative, got -1"):
        draw_poses(P, THETAS, GRID, -1, np.random.default_rng(0))
    with pytest.raises(ConfigError, match="no pose"):
        draw_poses(np.zeros_like(P), THETAS, GRID, 1, np.random.default_rng(0))


def test_draws_of_an_answer_are_its_gaussians_and_what_they_leave():
    covariance = np.array([[0.04, 0.01, 0.0], [0.01, 0.09, 0.02], [0.0, 0.02, 0.01]])
    far = Hypothesis(Pose2D(90, -60, 3.1), 0.0, 0.6, covariance)
    twin = Hypothesis(Pose2D(-90, 60, 0.0), 0.0, 0.3, 1e-6 * np.eye(3))
    answer = Localization((far, twin), "ambiguous", 1.0, 1.0)
    free = np.array([[True, True, False], [False, True, False]])
    poses = draw_near(answer, free, GRID, 20_000, np.random.default_rng(1))
    near = np.hypot(poses[:, 0] - 90, poses[:, 1] + 60) < 5
    at_twin = np.hypot(poses[:, 0] + 90, poses[:, 1] - 60) < 5
    assert near.mean() == pytest.approx(0.6, abs=0.02)
    assert at_twin.mean() == pytest.approx(0.3, abs=0.02)
    d = poses[near] - (90, -60, 3.1)
    d[:, 2] = wrap(d[:, 2])
    np.testing.assert_allclose(d.mean(axis=0), 0, atol=0.01)
    np.testing.assert_allclose(np.cov(d.T), covariance, atol=0.004)
    assert np.abs(poses[:, 2]).max() <= np.pi
    # The rest is anywhere that is free, in the map frame.
    local = transform_poses(inverse(GRID.origin), poses[~near & ~at_twin])
    cells = cell_of(local[:, :2], 0.5)
    assert free[cells[:, 0], cells[:, 1]].all()
    assert len(np.unique(cells, axis=0)) == 3
    assert np.histogram(local[:, 2], 4)[0] / len(local) == pytest.approx([0.25] * 4, abs=0.05)


def test_draws_of_an_answer_need_a_free_cell():
    lost = Localization((), "no-match", 0.0, 0.0)
    with pytest.raises(ConfigError, match="no pose"):
        draw_near(lost, np.zeros((2, 3), bool), GRID, 3, np.random.default_rng(0))
