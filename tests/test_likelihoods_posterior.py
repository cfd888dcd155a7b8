"""The posterior: normalised over free cells only, whatever the scale of the stack."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from imgloc.errors import ConfigError
from imgloc.likelihoods.posterior import posterior
from imgloc.options import LOG_METHODS, METHODS

VOTES = sorted(set(METHODS) - LOG_METHODS)
stacks = arrays(np.float32, (3, 2, 4), elements=st.integers(-800, 800).map(lambda i: i / 8))
masks = arrays(bool, (2, 4))


def naive(values, log, free, temperature):
    out = np.zeros(values.shape)
    top = max((float(v) for k in values for v in k[free]), default=0.0)
    for k, r, c in np.ndindex(values.shape):
        if free[r, c]:
            v = float(values[k, r, c])
            power = 1 / temperature
            out[k, r, c] = math.exp((v - top) * power) if log else max(v, 0.0) ** power
    total = out.sum()
    return out / total if total > 0 else out


@pytest.mark.parametrize("method", METHODS)
@given(values=stacks, free=masks, temperature=st.sampled_from([1 / 3, 0.5, 1.0, 3.0, 15.0, 1e4]))
@settings(max_examples=60)
def test_posterior_equals_the_loops(method, values, free, temperature):
    before = values.copy()
    got = posterior(values, method, free, temperature=temperature)
    assert got.dtype == np.float32
    expected = naive(values, method in LOG_METHODS, free, temperature)
    np.testing.assert_allclose(got, expected, atol=2e-6)
    np.testing.assert_array_equal(values, before)


@pytest.mark.parametrize("method", VOTES)
def test_votes_raised_to_a_power_do_not_overflow(method):
    # Outside the pose space there may be more of them: a power of that must not overflow.
    values, free = np.array([[[1.0, 3.0, -1.0, 1e9]]], np.float32), np.array([[1, 1, 1, 0]], bool)
    cold = posterior(values, method, free, temperature=1e-3)[0, 0]
    assert cold.tolist() == [0, 1, 0, 0]


@pytest.mark.parametrize("method", METHODS)
def test_headings_may_be_excluded(method):
    values = np.array([[[9.0]], [[1.0]], [[2.0]]], np.float32)
    wanted = np.array([False, True, True])
    got = posterior(values, method, np.ones((1, 1), bool), headings=wanted)
    np.testing.assert_array_equal(
        got[1:], posterior(values[1:], method, np.ones((1, 1), bool)), strict=True
    )
    assert got[0, 0, 0] == 0


def test_a_hot_posterior_still_counts_what_is_far_below():
    values = np.array([[[0.0]], [[-150.0]], [[-1e9]]], np.float32)
    got = posterior(values, "beam", np.ones((1, 1), bool), temperature=15.0)[:, 0, 0]
    np.testing.assert_allclose(got[1] / got[0], math.exp(-10), rtol=1e-5)
    assert got[2] == 0


@pytest.mark.parametrize("temperature", [0.0, -1.0, math.nan, math.inf])
def test_a_temperature_is_positive_and_finite(temperature):
    with pytest.raises(ConfigError, match="temperature"):
        posterior(np.zeros((1, 1, 1), np.float32), "beam", np.ones((1, 1), bool),
                  temperature=temperature)  # fmt: skip


def test_log_likelihoods_may_be_of_any_size():
    values = np.array([[[-90_000.0, -90_001.0, -np.inf, 4e4]]], np.float32)
    got = posterior(values, "beam", np.array([[True, True, True, False]]))[0, 0]
    np.testing.assert_allclose(got, [0.7310586, 0.2689414, 0, 0], rtol=1e-5)


@pytest.mark.parametrize("method", METHODS)
def test_large_stacks_sum_to_one(method):
    rng = np.random.default_rng(0)
    values = rng.uniform(0, 3, (40, 200, 200)).astype(np.float32)
    free = rng.random((200, 200)) < 0.7
    assert posterior(values, method, free).sum(dtype=np.float64) == pytest.approx(1, abs=1e-5)
