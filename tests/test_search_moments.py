"""Means, masses and covariances around peaks, against loops over their windows."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgloc.geometry import uniform_thetas, wrap
from imgloc.search.peaks import find_peaks, peak_moments

RESOLUTION = 0.2
seeds = st.integers(0, 2**32 - 1)
shapes = st.tuples(st.integers(1, 9), st.integers(1, 8), st.integers(1, 8))


def stack_of(seed, shape):
    values = np.random.default_rng(seed).random(shape) ** 6
    return (values / values.sum()).astype(np.float32)


def naive(probability, peaks, radius):
    """Weighted moments of the cells not yet counted, theta unrolled around the peak."""
    n, height, width = probability.shape
    step, taken = 2 * math.pi / n, set()
    reach = min(radius, (n - 1) // 2)  # on a small circle no heading counts twice
    out = []
    for k, r, c in peaks:
        samples, weights = [], []
        for dk in range(-reach, reach + 1):
            for row in range(max(0, r - radius), min(height, r + radius + 1)):
                for column in range(max(0, c - radius), min(width, c + radius + 1)):
                    cell = ((k + dk) % n, row, column)
                    x, y = (column + 0.5) * RESOLUTION, (row + 0.5) * RESOLUTION
                    samples.append((x, y, (k + dk) * step))
                    weights.append(0.0 if cell in taken else float(probability[cell]))
                    taken.add(cell)
        mass = sum(weights)
        samples, shares = np.array(samples), np.array(weights) / mass
        mean = sum(s * w for s, w in zip(samples, shares, strict=True))
        covariance = np.diag([RESOLUTION**2 / 12, RESOLUTION**2 / 12, step**2 / 12])
        for s, w in zip(samples, shares, strict=True):
            covariance += w * np.outer(s - mean, s - mean)
        out.append((mean, mass, covariance))
    return out


def moments(probability, peaks, radius=2):
    thetas = uniform_thetas(2 * np.pi / len(probability))
    return peak_moments(probability, np.asarray(peaks), thetas, RESOLUTION, radius=radius)


@given(shapes, seeds, st.integers(0, 3))
def test_moments_equal_the_loops(shape, seed, radius):
    probability = stack_of(seed, shape)
    peaks = find_peaks(probability, 3, radius=max(1, radius))
    poses, mass, covariance = moments(probability, peaks, radius)
    for i, (mean, total, expected) in enumerate(naive(probability, peaks.tolist(), radius)):
        np.testing.assert_allclose(poses[i, :2], mean[:2], atol=1e-9)
        np.testing.assert_allclose(wrap(poses[i, 2] - mean[2]), 0, atol=1e-9)
        assert mass[i] == pytest.approx(total)
        np.testing.assert_allclose(covariance[i], expected, atol=1e-9)


def test_no_peaks():
    poses, mass, covariance = moments(stack_of(0, (4, 3, 3)), np.empty((0, 3), int))
    assert (poses.shape, mass.shape, covariance.shape) == ((0, 3), (0,), (0, 3, 3))
