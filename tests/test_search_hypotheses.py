"""Masses, entropy, modes and covariances."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from imgloc.features.distance import distance_field
from imgloc.features.scanpoints import Readings
from imgloc.geometry import rotate_covariance, transform_points
from imgloc.likelihoods.posterior import entropy
from imgloc.model import Pose2D
from imgloc.search.covariance import covariances
from imgloc.search.hypotheses import as_hypotheses, centres, masses, modes
from imgloc.search.refine import residuals

scores = arrays(float, st.integers(1, 12), elements=st.floats(-2000, 2000))
seeds = st.integers(0, 2**32 - 1)
RESOLUTION = 0.1


@given(scores, st.floats(0.5, 20))
def test_masses_are_a_softmax(score, temperature):
    got = masses(score, temperature)
    best = max(score)
    expected = [math.exp((s - best) / temperature) for s in score]
    np.testing.assert_allclose(got, np.array(expected) / sum(expected), atol=1e-12)
    assert got.sum() == pytest.approx(1)


def test_masses_of_nothing_and_of_the_impossible():
    assert masses(np.empty(0), 1.0).tolist() == []
    assert masses(np.array([5.0]), 1.0).tolist() == [1.0]
    assert masses(np.array([-np.inf, 3.0]), 1.0).tolist() == [0.0, 1.0]


@given(st.integers(1, 500))
def test_entropy_of_equal_shares_is_the_logarithm(n):
    assert entropy(np.full(n, 1 / n)) == pytest.approx(math.log(n))


@given(scores, seeds)
def test_entropy_lies_between_certainty_and_equal_shares(score, seed):
    mass = masses(score, 4.0)
    assert 0 <= entropy(mass) <= math.log(len(mass)) + 1e-9
    shuffled = np.random.default_rng(seed).permutation(mass)
    assert entropy(shuffled) == pytest.approx(entropy(mass))


def test_certainty_has_no_entropy_and_no_sign():
    value = entropy(np.array([1.0, 0.0]))
    assert value == 0
    assert math.copysign(1, value) == 1


def poses_and_scores(seed, n=20):
    rng = np.random.default_rng(seed)
    poses = np.column_stack((rng.uniform(0, 2, (n, 2)), rng.uniform(-np.pi, np.pi, n)))
    return poses, rng.integers(0, 5, n).astype(float)


def near(a, b, distance, angle):
    turn = math.remainder(a[2] - b[2], 2 * math.pi)
    return math.hypot(a[0] - b[0], a[1] - b[1]) < distance and abs(turn) < angle


@given(seeds, st.integers(1, 3))
def test_modes_are_the_best_of_their_neighbourhood_however_often_they_are_proposed(seed, copies):
    poses, score = (np.concatenate([one] * copies) for one in poses_and_scores(seed))
    expected = []
    for i in sorted(range(len(poses)), key=lambda i: (-score[i], i)):
        if not any(near(poses[i], poses[j], 0.8, 1.0) for j in expected):
            expected.append(i)
    assert modes(poses, score, distance=0.8, angle=1.0).tolist() == expected


def test_modes_of_nothing():
    assert modes(np.empty((0, 3)), np.empty(0), distance=1, angle=1).tolist() == []


def wall_ahead(n):
    """Map with one wall at x = 3 m and a sensor 2 m in front of it, seeing n points of it."""
    wall = np.zeros((60, 60), bool)
    wall[:, 30:] = True
    y = np.linspace(-1, 1, n)
    return (
        distance_field(wall, RESOLUTION),
        np.array([[1.0, 3.0, 0.0]]),
        np.column_stack((y * 0 + 2, y)),
    )


def laplace(field, poses, xy, sigma=0.1):
    xy = xy[np.argsort(np.arctan2(xy[:, 1], xy[:, 0]))]
    readings = Readings(np.hypot(*xy.T), np.arctan2(xy[:, 1], xy[:, 0]))
    J, distance = residuals(poses, xy, field)
    return covariances(
        J, distance, 1, readings, sigma=sigma, cell=field.resolution, extent=(0.5, 0.5, 0.25)
    )


@pytest.mark.parametrize("n", [5, 41])
def test_the_variance_in_front_of_a_wall_is_that_of_a_mean(n):
    field, poses, xy = wall_ahead(n)
    xy[:, 0] += 0.04 * (-1.0) ** np.arange(n)  # readings alternately 4 cm long and short
    # A kernel so wide that all readings count alike.
    ((xx, _, _), (_, yy, _), (_, _, tt)) = laplace(field, poses, xy, 100.0)[0]
    variance = 0.04**2
    lever = np.sum(xy[:, 1] ** 2)
    off, far = 0.006**2, np.mean(np.sum(xy**2, axis=1))
    assert xx - off == pytest.approx(1 / (n / variance + 1 / 0.5**2), rel=0.02)
    # Along the wall nothing is known but the extent.
    assert yy == pytest.approx(0.5**2, rel=1e-3)
    assert tt - off / far == pytest.approx(1 / (lever / variance + 1 / 0.25**2), rel=0.02)


def test_a_perfect_fit_is_no_finer_than_the_cells_allow():
    field, poses, xy = wall_ahead(9)
    xx = laplace(field, poses, xy)[0, 0, 0]
    assert xx == pytest.approx((RESOLUTION / 20) ** 2 / 9 + 0.006**2, rel=1e-3)


def test_an_error_that_a_wall_shares_counts_more_than_that_of_each_reading():
    field, poses, xy = wall_ahead(48)
    each, shared = xy.copy(), xy.copy()
    each[:, 0] += 0.03 * (-1.0) ** np.arange(48)
    shared[:24, 0] += 0.03  # half of the wall is drawn 6 cm beside the other
    shared[24:, 0] -= 0.03
    alone, together = (laplace(field, poses, points)[0, 0, 0] for points in (each, shared))
    assert together > 1.15 * alone


def random_room(seed):
    rng = np.random.default_rng(seed)
    wall = np.pad(rng.random((36, 36)) < 0.03, 2, constant_values=True)
    n = int(rng.integers(1, 60))
    poses = np.column_stack((rng.uniform(1, 3, (3, 2)), rng.uniform(-np.pi, np.pi, 3)))
    return wall, poses, rng.uniform(-3, 3, (n, 2))


@given(seeds, st.sampled_from([0.05, 0.3]))
@settings(max_examples=60)
def test_covariances_are_positive_definite_and_no_larger_than_a_mode(seed, sigma):
    wall, poses, xy = random_room(seed)
    got = laplace(distance_field(wall, RESOLUTION), poses, xy, sigma)
    assert got.shape == (3, 3, 3)
    np.testing.assert_array_equal(got, got.transpose(0, 2, 1))
    assert np.all(np.linalg.eigvalsh(got) > 0)
    diagonal = got[:, range(3), range(3)]
    assert np.all(diagonal <= np.square([0.5, 0.5, 0.25]) * 1.001 + (RESOLUTION / 5) ** 2)


@given(seeds)
@settings(max_examples=30)
def test_covariances_turn_with_the_map(seed):
    wall, poses, xy = random_room(seed)
    turned = np.ascontiguousarray(np.rot90(wall, -1))  # rows go up: counter-clockwise
    frame = Pose2D(4.0, 0.0, np.pi / 2)
    there = np.column_stack((transform_points(frame, poses[:, :2]), poses[:, 2] + np.pi / 2))
    a = laplace(distance_field(wall, RESOLUTION), poses, xy)
    b = laplace(distance_field(turned, RESOLUTION), there, xy)
    for before, after in zip(a, b, strict=True):
        np.testing.assert_allclose(
            rotate_covariance(before, np.pi / 2), after, rtol=0.05, atol=1e-4
        )


@given(st.floats(-np.pi, np.pi))
@settings(max_examples=30)
def test_a_corridor_is_long_along_itself_whatever_the_heading(theta):
    wall = np.zeros((40, 120), bool)
    wall[[9, 30]] = True
    s = np.linspace(-3, 3, 30)
    points = np.concatenate((np.column_stack((s, 0 * s + 1)), np.column_stack((s, 0 * s - 1))))
    xy = transform_points(Pose2D(0, 0, -theta), points)
    (got,) = laplace(distance_field(wall, RESOLUTION), np.array([[6.0, 2.0, theta]]), xy)
    assert got[0, 0] > 0.8 * 0.5**2
    assert got[1, 1] < 0.01
    assert abs(got[0, 1]) < 0.1 * math.sqrt(got[0, 0] * got[1, 1])


def test_no_poses_no_covariances():
    field, _, xy = wall_ahead(5)
    assert laplace(field, np.empty((0, 3)), xy).shape == (0, 3, 3)


def test_hypotheses_keep_the_order_of_their_arrays():
    poses, score, mass = np.array([[1, 2, 4.0], [3, 4, 0.5]]), np.array([-1, -2.0]), [0.7, 0.3]
    a, b = as_hypotheses(poses, score, np.array(mass), np.stack([np.eye(3), 2 * np.eye(3)]))
    assert a.pose == Pose2D(1, 2, 4 - 2 * np.pi)
    assert (a.log_likelihood, a.mass, b.log_likelihood, b.mass) == (-1, 0.7, -2, 0.3)
    assert b.covariance[2, 2] == 2
    assert as_hypotheses(np.empty((0, 3)), np.empty(0), np.empty(0), np.empty((0, 3, 3))) == ()
    with pytest.raises(ValueError, match="shorter"):
        as_hypotheses(poses, score, np.array([1.0]), np.stack([np.eye(3)] * 2))


def test_a_mode_is_where_its_maxima_are_and_as_wide_as_they_are_apart():
    poses = np.array([[1, 2, 3.1], [1.2, 2, 3.1], [1, 2, -3.1], [1, 2.001, 3.1], [1.6, 2, 3.1]])
    score = np.array([0.0, np.log(0.5), -50.0, -0.1, 0.0])
    about = {"within": (0.5, 0.3), "same": (0.02, 0.02)}
    (at, beside), (here, there) = centres(poses, score, np.array([0, 4]), **about)
    # The second counts half as much as the first; the fourth is the first, the fifth another mode.
    np.testing.assert_allclose(at, (1 + 0.2 / 3, 2, 3.1))
    assert here[0, 0] == pytest.approx(0.2**2 * 2 / 9, rel=1e-6)
    assert here[1, 1] == pytest.approx(0)
    np.testing.assert_allclose(beside, (1.6 - 0.4 / 3, 2, 3.1))
    assert there[0, 0] == pytest.approx(0.4**2 * 2 / 9, rel=1e-6)
    turn = 2 * np.pi - 6.2
    score[2] = -1.0  # across the half turn
    (at,), (both,) = centres(poses[[0, 2]], score[[0, 2]], np.array([0]), **about)
    share = 1 / (1 + np.exp(1.0))
    assert at[2] == pytest.approx(3.1 + share * turn)
    assert both[2, 2] == pytest.approx(share * (1 - share) * turn**2, rel=1e-6)
