"""Odometry: exact composition, and errors of the size that the parameters say."""

import itertools

import numpy as np
import pytest

from imgloc.errors import ConfigError
from imgloc.filters.motion import (
    MotionNoise,
    compose_poses,
    deviations,
    increments,
    invert_poses,
    move_gaussians,
    noisy_odometry,
    sample_motion,
    turn_go_turn,
)
from imgloc.geometry import wrap
from imgloc.model import Pose2D, compose, inverse

STILL = MotionNoise(0, 0, 0, 0, (0, 0))


@pytest.fixture
def path() -> np.ndarray:
    rng = np.random.default_rng(3)
    return np.column_stack((rng.uniform(-9, 9, (50, 2)), rng.uniform(-3, 3, 50)))


def test_composition_is_that_of_single_poses(path: np.ndarray) -> None:
    for a, b in itertools.pairwise(path):
        expected = compose(Pose2D(*a), Pose2D(*b))
        np.testing.assert_allclose(compose_poses(a, b), list(vars(expected).values()), atol=1e-12)
        back = inverse(Pose2D(*a))
        np.testing.assert_allclose(invert_poses(a), list(vars(back).values()), atol=1e-12)


def test_increments_lead_back_along_the_path(path: np.ndarray) -> None:
    at = path[0]
    for step, expected in zip(increments(path), path[1:], strict=True):
        at = compose_poses(at, step)
        np.testing.assert_allclose(at[:2], expected[:2], atol=1e-9)
        assert abs(wrap(at[2] - expected[2])) < 1e-9


def test_without_noise_a_draw_is_the_increment(path: np.ndarray) -> None:
    steps = np.concatenate((increments(path), np.zeros((1, 3)), [[-0.5, 0, 0], [0.003, 0.004, 2]]))
    moved = sample_motion(np.tile(path[0], (len(steps), 1)), steps, STILL, np.random.default_rng(0))
    expected = compose_poses(path[0], steps)
    np.testing.assert_allclose(moved[:, :2], expected[:, :2], atol=1e-9)
    np.testing.assert_allclose(wrap(moved[:, 2] - expected[:, 2]), 0, atol=1e-9)


@pytest.mark.parametrize(
    ("alpha", "increment", "expected"),
    [
        ("alpha1", [0, 0, 1.0], (0, 0, 0.2)),
        ("alpha2", [2.0, 0, 0], (0.4, 0, 0.4)),
        ("alpha3", [2.0, 0, 0], (0, 0.4, 0)),
        ("alpha4", [0, 0, 0.5], (0, 0.1, 0)),
        ("alpha4", [1.0, 0, 0.5], (0, 0.1, 0)),
        ("alpha1", [-2.0, 0, 0], (0, 0, 0)),  # backwards is no turn
    ],
)
def test_each_alpha_is_of_its_own_part(alpha: str, increment: list, expected: tuple) -> None:
    noise = MotionNoise(**{"alpha1": 0, "alpha2": 0, "alpha3": 0, "alpha4": 0} | {alpha: 0.04},
                        floor=(0, 0))  # fmt: skip
    np.testing.assert_allclose(deviations(np.array(increment), noise), expected, atol=1e-12)


def test_gaussians_move_as_samples_do() -> None:
    noise, step = MotionNoise(0.002, 0.002, 0.002, 0.002), np.array([0.8, 0.3, 0.6])
    start, P = np.array([[3.0, -2.0, 2.0]]), np.diag([0.02, 0.03, 0.04])[None] ** 2
    rng = np.random.default_rng(1)
    poses = rng.multivariate_normal(start[0], P[0], 40_000)
    moved = sample_motion(poses, step, noise, rng)
    mean, spread = move_gaussians(start, P, step, noise)
    np.testing.assert_allclose(moved.mean(axis=0), mean[0], atol=3e-3)
    measured = np.cov(moved.T)
    assert np.linalg.eigvalsh(spread[0]).min() > 0
    np.testing.assert_allclose(measured, spread[0], atol=0.1 * measured.max())


def test_odometry_drifts_as_its_bias_says(monkeypatch: pytest.MonkeyPatch) -> None:
    line = np.column_stack((np.arange(0, 20, 0.5), np.zeros(40), np.zeros(40)))
    other = noisy_odometry(line, np.random.default_rng(0))
    np.testing.assert_array_equal(other, noisy_odometry(line, np.random.default_rng(0)))
    monkeypatch.setattr("imgloc.filters.motion.sample_motion", lambda _, steps, *__: steps)
    odom = noisy_odometry(line, np.random.default_rng(0))
    assert np.hypot(*increments(odom)[:, :2].T).sum() == pytest.approx(1.02 * 19.5)
    assert odom[-1, 2] == pytest.approx(0.195)
    assert np.abs(other - odom).max() > 0.01


def test_parts_add_up(path: np.ndarray) -> None:
    first, go, second = turn_go_turn(path).T
    np.testing.assert_allclose(go * np.cos(first), path[:, 0], atol=1e-12)
    np.testing.assert_allclose(wrap(first + second - path[:, 2]), 0, atol=1e-12)


@pytest.mark.parametrize("bad", [{"alpha1": -1.0}, {"alpha4": np.nan}, {"floor": (0.0, -1.0)}])
def test_refuses_noise_that_is_none(bad: dict) -> None:
    with pytest.raises(ConfigError, match=next(iter(bad))):
        MotionNoise(**bad)
