"""What a calibration does to a stack: the blur, the exponent, the number of readings."""

import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from imgloc import METHODS, Calibration, ConfigError, GridInfo, Likelihood
from imgloc.likelihoods.posterior import calibrated, circular_kernel, posterior, smooth
from imgloc.options import DEFAULTS, LOG_METHODS

VOTES = sorted(set(METHODS) - LOG_METHODS)
FREE = np.ones((5, 7), bool)
FREE[2, 3:5] = False


def stack_of(method, seed=0, cell=0.1):
    values = np.random.default_rng(seed).uniform(-1, 9, (12, 5, 7)).astype(np.float32)
    return Likelihood(values, np.arange(12) * np.pi / 6, GridInfo(5, 7, cell), method)


@pytest.mark.parametrize("method", METHODS)
def test_one_and_no_blur_is_the_stack_as_it_is(method):
    stack = stack_of(method)
    # A scale of 1: of votes with very many readings, of logarithms with one.
    readings = 1 if method in LOG_METHODS else 10**9
    got = calibrated(stack, FREE, readings, Calibration())
    np.testing.assert_allclose(got, posterior(stack.values, method, FREE), rtol=1e-5)


@pytest.mark.parametrize("method", METHODS)
def test_a_calibrated_posterior_is_one(method):
    got = calibrated(stack_of(method), FREE, 181)
    assert got.sum(dtype=float) == pytest.approx(1, abs=1e-5)
    assert (got >= 0).all()
    assert not got[:, ~FREE].any()


def naive(stack, how, readings):
    """Eq. 8's Gaussian and the exponent, one sum at a time; beyond the image there is nothing."""
    n, height, width = stack.values.shape
    out = np.zeros(stack.values.shape)
    sigma_px, sigma_bins = how.sigma_xy / stack.grid.resolution, how.sigma_theta * n / math.tau

    def kernel(sigma, reach, size):
        steps = np.arange(-reach, reach + 1)
        weights = np.exp(-0.5 * (steps / sigma) ** 2)
        return steps, weights / weights.sum()

    steps, weights = kernel(sigma_bins, 5, n)
    turned = sum(w * np.roll(np.maximum(stack.values, 0), s, axis=0)
                 for s, w in zip(steps, weights, strict=True))  # fmt: skip
    steps, weights = kernel(sigma_px, 4, width)
    for dy, wy in zip(steps, weights, strict=True):
        for dx, wx in zip(steps, weights, strict=True):
            for r in range(max(0, dy), min(height, height + dy)):
                for c in range(max(0, dx), min(width, width + dx)):
                    out[:, r, c] += wy * wx * turned[:, r - dy, c - dx]
    out = np.where(FREE, out, 0) ** (1 / (how.temperature * (1 + 20 / readings)))
    return out / out.sum()


@pytest.mark.parametrize("method", VOTES)
def test_calibrated_equals_the_loops(method):
    stack = stack_of(method)
    how = Calibration(sigma_xy=0.1, sigma_theta=math.pi / 6, temperature=1 / 8)
    got = calibrated(stack, FREE, 60, how)
    np.testing.assert_allclose(got, naive(stack, how, 60), rtol=1e-3, atol=1e-7)


def test_logarithms_are_divided_by_the_number_of_readings():
    stack = stack_of("beam")
    how = Calibration(temperature=0.5)
    np.testing.assert_allclose(
        calibrated(stack, FREE, 12, how), posterior(stack.values, "beam", FREE, temperature=6.0)
    )


def test_few_readings_make_votes_worth_less():
    few, many = (calibrated(stack_of("ght"), FREE, n, Calibration()).max() for n in (5, 500))
    assert few < many
    assert Calibration().temperature_at("ght", 0) == Calibration().temperature_at("ght", 1)


@pytest.mark.parametrize("method", METHODS)
def test_headings_that_are_excluded_have_nothing(method):
    headings = np.arange(12) % 3 == 0
    how = Calibration(0.1, 0.6, 0.5)
    got = calibrated(stack_of(method), FREE, 9, how, headings=headings)
    assert not got[~headings].any()
    assert got.sum(dtype=float) == pytest.approx(1, abs=1e-5)
    # Relative to one another the others are what they were.
    everything = calibrated(stack_of(method), FREE, 9, how)[headings]
    np.testing.assert_allclose(got[headings], everything / everything.sum(), rtol=1e-3, atol=1e-9)


@given(arrays(np.float32, (6, 3, 4), elements=st.integers(0, 100)), st.integers(0, 5))
@settings(max_examples=30)
def test_smoothing_keeps_the_sum_along_theta_and_turns_with_the_stack(values, turn):
    got = smooth(values, 0, 0.9)
    np.testing.assert_allclose(got.sum(axis=0), values.sum(axis=0), rtol=1e-4)
    np.testing.assert_allclose(
        smooth(np.roll(values, turn, axis=0), 0, 0.9), np.roll(got, turn, axis=0), rtol=1e-5
    )


def test_smoothing_makes_a_new_stack_and_says_what_is_beyond_the_border():
    values = np.full((4, 6, 6), -5.0, np.float32)
    got = smooth(values, 1.0, 0.0, border=cv2.BORDER_REPLICATE)
    np.testing.assert_allclose(got, -5, rtol=1e-6)
    assert smooth(values, 1.0, 0.0)[0, 0, 0] > -4
    assert not np.shares_memory(smooth(values, 0.0, 0.0), values)
    assert smooth(np.empty((0, 3, 3), np.float32), 1, 1).shape == (0, 3, 3)


@given(st.integers(1, 40), st.floats(0, 30))
def test_a_circular_kernel_is_symmetric_and_sums_to_one(n, sigma):
    kernel = circular_kernel(n, sigma)
    assert kernel.sum() == pytest.approx(1, abs=1e-5)
    np.testing.assert_array_equal(kernel[1:], kernel[1:][::-1])
    assert kernel.argmax() == 0


@pytest.mark.parametrize(
    "values", [(-0.1, 0, 1), (0, math.nan, 1), (0, 0, 0), (0, 0, math.inf), (0, 0, -1)]
)
def test_values_out_of_range(values):
    with pytest.raises(ConfigError, match=r"Calibration\.\w+: got "):
        Calibration(*values)


def test_more_rays_know_no_more_than_half_a_dozen() -> None:
    how = DEFAULTS["beam"]
    assert how.temperature_at("beam", 635) == pytest.approx(100)
    assert how.temperature_at("beam", 1270) == pytest.approx(200)
