"""Smoothing, local maxima and separation, against loops; theta is a circle throughout."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imgloc.likelihoods.posterior import smooth
from imgloc.search import peaks as peaks_module
from imgloc.search.hypotheses import first_in_cell, separated
from imgloc.search.peaks import find_peaks

seeds = st.integers(0, 2**32 - 1)
shapes = st.tuples(st.integers(1, 7), st.integers(1, 6), st.integers(1, 7))


def circular(i, j, n):
    return min((i - j) % n, (j - i) % n)


def naive_smooth_theta(values, sigma):
    n = len(values)
    out = np.zeros(values.shape)
    for k in range(n):
        weights = [math.exp(-0.5 * (circular(k, j, n) / sigma) ** 2) for j in range(n)]
        for j in range(n):
            out[k] += values[j] * weights[j] / sum(weights)
    return out


def naive_peaks(values, n, radius):
    """The definition: the largest of its window, the first of equals, nothing at or below 0."""
    ranked = sorted(np.ndindex(values.shape), key=lambda cell: (-values[cell], cell))
    windows = {
        a: [
            b
            for b in ranked
            if circular(a[0], b[0], len(values)) <= radius
            and abs(a[1] - b[1]) <= radius
            and abs(a[2] - b[2]) <= radius
        ]
        for a in ranked
    }
    kept = []
    for a in ranked:
        largest = all(values[a] >= values[b] for b in windows[a])
        if values[a] > 0 and largest and not any(b in kept for b in windows[a]):
            kept.append(a)
    return [list(a) for a in kept[:n]]


def naive_separated(poses, n, distance, angle):
    picked, owner = [], []
    for x, y, theta in poses:
        for at, i in enumerate(picked):
            turn = abs(math.remainder(theta - poses[i][2], 2 * math.pi))
            if math.hypot(x - poses[i][0], y - poses[i][1]) < distance and turn < angle:
                owner.append(at)
                break
        else:
            owner.append(len(picked))
            picked.append(len(owner) - 1)
    return picked[:n], [at if at < n else -1 for at in owner]


@given(shapes, seeds, st.sampled_from([0.3, 0.7, 2.0]))
def test_smoothing_along_theta_equals_the_loops(shape, seed, sigma):
    values = np.random.default_rng(seed).random(shape).astype(np.float32)
    got = smooth(values, 0, sigma)
    np.testing.assert_allclose(got, naive_smooth_theta(values, sigma), rtol=1e-5)
    assert got.sum() == pytest.approx(values.sum(), rel=1e-5)  # a circle loses nothing


def test_a_smoothed_impulse_is_a_gaussian_in_the_image():
    values = np.zeros((2, 21, 23), np.float32)
    values[1, 10, 12] = 1
    got = smooth(values, 1.5, 0)
    assert not got[0].any()
    r, c = np.indices((21, 23))
    bell = np.exp(-((r - 10) ** 2 + (c - 12) ** 2) / (2 * 1.5**2))
    np.testing.assert_allclose(got[1], bell / bell.sum(), atol=2e-4)


def test_nothing_comes_in_from_outside_the_image():
    got = smooth(np.ones((1, 30, 30), np.float32), 1.0, 0)[0]
    assert got[15, 15] == pytest.approx(1)
    assert got[0, 15] == pytest.approx(0.7, abs=0.01)  # half of the bell, and its middle
    assert got[0, 0] == pytest.approx(got[0, 15] ** 2, abs=1e-3)


def test_zero_width_copies():
    values = np.arange(12, dtype=np.float32).reshape(3, 2, 2)
    got = smooth(values, 0, 0)
    np.testing.assert_array_equal(got, values)
    got[...] = 7
    assert values[0, 0, 0] == 0


@given(shapes, seeds, st.integers(0, 3), st.integers(1, 3), st.integers(1, 300))
@settings(max_examples=150)
def test_peaks_equal_the_loops(shape, seed, radius, top, n):
    # Few distinct values: plateaus everywhere, and negative ones as in CBML-O.
    values = np.random.default_rng(seed).integers(-1, top + 1, shape).astype(np.float32)
    assert find_peaks(values, n, radius=radius).tolist() == naive_peaks(values, n, radius)


@given(shapes, seeds, st.integers(1, 300), st.integers(1, 9))
@settings(max_examples=60)
def test_peaks_may_be_sorted_a_few_at_a_time(shape, seed, n, few):
    values = np.random.default_rng(seed).integers(0, 4, shape).astype(np.float32)
    before = peaks_module._FEW
    peaks_module._FEW = few
    try:
        got = find_peaks(values, n).tolist()
    finally:
        peaks_module._FEW = before
    assert got == naive_peaks(values, n, 1)


def test_a_read_only_stack_and_a_view_of_one_have_peaks():
    values = np.random.default_rng(3).random((6, 9, 14)).astype(np.float32)
    expected = find_peaks(values[:, 1:8, ::2].copy(), 9).tolist()
    values.flags.writeable = False
    assert find_peaks(values[:, 1:8, ::2], 9).tolist() == expected


def poses_of(seed, n):
    """A crowd in which most poses are somebody's neighbour, on both sides of the seam."""
    rng = np.random.default_rng(seed)
    return np.column_stack((rng.uniform(0, 2, (n, 2)), rng.uniform(np.pi - 0.6, np.pi + 0.6, n)))


@given(seeds, st.integers(0, 25), st.integers(1, 30), st.booleans())
@settings(max_examples=100)
def test_separation_equals_the_greedy_loops(seed, m, n, wrapped):
    poses = poses_of(seed, m)
    if wrapped:
        poses[:, 2] -= 2 * np.pi * (poses[:, 2] > np.pi)
    picked, owner = separated(poses, n, distance=0.5, angle=0.3)
    expected = naive_separated(poses.tolist(), n, 0.5, 0.3)
    assert picked.tolist() == expected[0]
    assert owner.tolist() == expected[1]


def test_neighbours_are_strictly_closer_in_both():
    at = [(0, 0, 0), (0.5, 0, 0), (0.25, 0, 0.25), (0.25, 0, 0.125), (0, 0, 0.25)]
    picked, owner = separated(np.array(at, float), 9, distance=0.5, angle=0.25)
    assert picked.tolist() == [0, 1, 2]
    assert owner.tolist() == [0, 1, 2, 0, 2]


def test_first_in_cell_knows_sides_and_the_circle():
    poses = np.array([
        [0.95, 0.5, 0.1], [1.05, 0.5, 0.1],  # either side of a border of cells
        [0.91, 0.5, 0.1 + 2 * np.pi],  # the first one's cell, once round
        [-0.05, 0.5, 0.1], [0.05, -0.5, 0.1], [0.05, 0.5, 0.1],  # nor is -0.05 what 0.05 is
        [0.95, 0.5, -0.1], [0.95, 0.5, 0.6],
    ])  # fmt: skip
    assert first_in_cell(poses, 1.0, 0.5).tolist() == [0, 1, 3, 4, 6, 7]
    assert first_in_cell(np.empty((0, 3)), 1.0, 0.5).tolist() == []
