"""Sec. VII's suggestion: one vote per scan point and cell."""

import naive
import numpy as np
import pytest
from hypothesis import strategies as st

from imgloc.likelihoods.ght import BLOCK_COLUMNS, ght, ght_v
from imgloc.model import OrientedPoints

seeds = st.integers(0, 2**32 - 1)
N_PSI = 24
SHAPE = (9, 12)


def random_case(seed, m=14, n=9, lost=0.15, spread=(0.005, 0.6)):
    """Surface, scan and absolute visibility; normals of the surface on the bins of psi."""
    rng = np.random.default_rng(seed)
    sets = []
    for count, low, high in ((m, 0.0, [0.1 * SHAPE[1], 0.1 * SHAPE[0]]), (n, -0.6, 0.6)):
        xy = rng.uniform(low, high, (count, 2))
        xy[rng.random(count) < lost / 2] = np.nan
        valid = rng.random(count) >= lost
        alpha = np.where(valid, rng.uniform(-4, 4, count), np.nan)
        sigma = np.exp(rng.uniform(*np.log(spread), count))
        sets.append((xy, alpha, sigma, valid))
    step = 2 * np.pi / N_PSI
    xy, alpha, sigma, valid = sets[0]
    surface = OrientedPoints(xy, np.rint(alpha / step) * step, sigma, valid)
    vis = rng.uniform(0, 1.2, (m, N_PSI)).astype(np.float32)
    return surface, OrientedPoints(*sets[1]), vis


def relative(vis, alpha):
    """Absolute (M, n_psi) -> from the normal, psi-major (n_psi, M)."""
    turn = np.rint(np.nan_to_num(alpha) * N_PSI / (2 * np.pi)).astype(int)
    return np.stack([np.roll(row, -k) for row, k in zip(vis, turn, strict=True)], axis=1)


def one(x, y, alpha, sigma=1e-3):
    return OrientedPoints([[x, y]], [alpha], [sigma], [True])


@pytest.mark.parametrize("n_theta", [1, 5])
def test_once_equals_the_loops(n_theta):
    surface, points, vis = random_case(1, m=60, n=25)
    fast = ght_v(surface, relative(vis, surface.alpha), points, n_theta, SHAPE, 0.1, once=True)
    slow = naive.ght_v_once(surface, vis, points, n_theta, SHAPE, 0.1)
    np.testing.assert_array_equal(fast, slow)
    everybody = naive.ght_v(surface, vis, points, n_theta, SHAPE, 0.1)
    assert 0 < fast.sum() < everybody.sum()
    plain = ght(surface, points, n_theta, SHAPE, 0.1, once=True)
    np.testing.assert_array_equal(
        plain, naive.ght_v_once(surface, None, points, n_theta, SHAPE, 0.1)
    )


def test_once_holds_across_blocks_and_threads():
    m = BLOCK_COLUMNS + 900
    surface, points, vis = random_case(2, m=m, n=7, lost=0.0)
    vis = relative(vis, surface.alpha)
    stack = ght_v(surface, vis, points, 3, SHAPE, 0.1, once=True)
    assert stack.max() <= 7  # of the 9000 map points no cell gets more votes than scan points
    parts = [
        ght_v(surface, vis, points.select(slice(i, i + 1)), 3, SHAPE, 0.1) > 0 for i in range(7)
    ]
    np.testing.assert_array_equal(stack, np.sum(parts, axis=0))
    for threads in (2, 5):
        more = ght_v(surface, vis, points, 3, SHAPE, 0.1, once=True, threads=threads)
        np.testing.assert_array_equal(more, stack)
