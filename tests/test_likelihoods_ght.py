import naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from naive import oriented

from imgloc import ConfigError, OrientedPoints
from imgloc.likelihoods.ght import BLOCK_COLUMNS, BLOCK_PAIRS, ght, ght_v

seeds = st.integers(0, 2**32 - 1)
N_PSI = 24


def random_points(rng, n, low, high, lost=0.2):
    """Points, some without a normal and some not finite; normals anywhere on the circle."""
    xy = rng.uniform(low, high, (n, 2))
    valid = rng.random(n) >= lost
    alpha = rng.uniform(-7, 7, n)
    alpha[~valid] = np.nan
    xy[rng.random(n) < lost / 2] = np.nan
    return oriented(xy, alpha, valid)


def random_case(seed, shape=(7, 10), m=14, n=11, lost=0.2):
    """Surface, scan and absolute visibility; normals of the surface on the bins of psi."""
    rng = np.random.default_rng(seed)
    surface = random_points(rng, m, 0.0, [0.1 * shape[1], 0.1 * shape[0]], lost)
    step = 2 * np.pi / N_PSI
    surface = oriented(surface.xy, np.rint(surface.alpha / step) * step, surface.valid)
    points = random_points(rng, n, -0.6, 0.6, lost)
    vis = rng.uniform(0, 1, (m, N_PSI))
    vis[rng.random(vis.shape) < 0.1] = np.inf
    return surface, points, vis.astype(np.float32)


def relative(vis, alpha):
    """Absolute (M, n_psi) -> from the normal, psi-major (n_psi, M)."""
    m, n_psi = vis.shape
    turn = np.rint(np.nan_to_num(alpha) * n_psi / (2 * np.pi)).astype(int)
    columns = [np.roll(vis[j], -turn[j]) for j in range(m)]
    return np.stack(columns, axis=1)


def test_lattice_of_votes_is_not_that_of_the_map():
    surface, points, vis = random_case(3, (20, 30), m=30)
    for shape, resolution in (((5, 6), 0.5), ((40, 50), 0.06)):
        np.testing.assert_array_equal(
            ght_v(surface, relative(vis, surface.alpha), points, 6, shape, resolution),
            naive.ght_v(surface, vis, points, 6, shape, resolution),
        )


def test_a_heading_a_hair_below_the_first_bin_stays_on_the_circle():
    # -1e-16 % 4 is 4.0, one bin too many.
    scan = oriented([[0.0, 0.0]], [0.0])
    for steps in range(-3, 4):
        alpha = -np.pi / 4
        for _ in range(abs(steps)):
            alpha = np.nextafter(alpha, steps * np.inf)
        votes = ght(oriented([[0.5, 0.5]], [alpha]), scan, 4, (1, 1), 1.0)
        assert votes[[0, 3]].sum() == 1


@pytest.mark.parametrize(
    ("x", "columns"),
    [(0.0, [0]), (0.999, [0]), (1.0, [1]), (1.001, [1]), (2.999, [2]), (3.0, []), (-1e-9, [])],
)
def test_cells_are_half_open_and_the_border_is_a_miss(x, columns):
    wall, scan = oriented([[x, 0.5]], [0.0]), oriented([[0.0, 0.0]], [0.0])
    votes = ght(wall, scan, 1, (1, 3), 1.0)
    assert np.flatnonzero(votes).tolist() == columns
    wall = oriented([[0.5, x]], [0.0])
    assert np.flatnonzero(ght(wall, scan, 1, (3, 1), 1.0)).tolist() == columns


def test_visibility_is_strict_to_the_last_bit():
    # |p_i| = 0.1 is not a float32: the comparison must not depend on its rounding.
    wall, scan = oriented([[0.5, 0.5]], [np.pi]), oriented([[0.1, 0.0]], [np.pi])
    for distance in (0.1, 0.3, 1.0, 0.7):
        scan = oriented([[distance, 0.0]], [np.pi])
        for steps in range(-2, 3):
            seen = np.float32(distance)
            for _ in range(abs(steps)):
                seen = np.nextafter(seen, np.float32(np.sign(steps) * np.inf))
            vis = np.full((8, 1), seen, dtype=np.float32)
            votes = ght_v(wall, vis, scan, 1, (1, 3), 1.0, out=None).sum()
            assert votes == (float(seen) > distance) * ght(wall, scan, 1, (1, 3), 1.0).sum()


def test_votes_add_over_blocks_of_pairs():
    m, n = BLOCK_COLUMNS + 700, BLOCK_PAIRS // BLOCK_COLUMNS + 2
    surface, points, vis = random_case(5, (20, 30), m, n, lost=0.1)
    vis = relative(vis, surface.alpha)
    whole = ght_v(surface, vis, points, 8, (20, 30), 0.1)
    halves = [
        ght_v(surface.select(j), vis[:, j], points.select(i), 8, (20, 30), 0.1)
        for j in (slice(None, 4000), slice(4000, None))
        for i in (slice(None, 2), slice(2, None))
    ]
    np.testing.assert_array_equal(whole, np.sum(halves, axis=0))
    assert whole.sum() > 3000


def test_any_number_of_threads_gives_the_same_bits():
    surface, points, vis = random_case(6, (9, 9), m=3000, n=60)
    vis = relative(vis, surface.alpha)
    one, *more = (ght_v(surface, vis, points, 7, (9, 9), 0.1, threads=t) for t in (1, 2, 3, 50))
    for stack in more:
        np.testing.assert_array_equal(stack, one)


def test_output_is_reused():
    surface, points, vis = random_case(7)
    out = np.full((4, 7, 10), np.nan, dtype=np.float32)
    fresh = ght(surface, points, 4, (7, 10), 0.1)
    assert ght(surface, points, 4, (7, 10), 0.1, out=out) is out
    np.testing.assert_array_equal(out, fresh)
    with pytest.raises(ValueError, match="out must be"):
        ght_v(surface, relative(vis, surface.alpha), points, 5, (7, 10), 0.1, out=out)


def test_nobody_votes():
    surface, points, vis = random_case(8)
    nobody = surface.select(np.zeros(len(surface), dtype=bool))
    no_vis = vis[:0].T
    for s, p, v in ((nobody, points, no_vis), (surface, points.select(slice(0)), vis.T)):
        assert not ght(s, p, 4, (7, 10), 0.1).any()
        assert not ght_v(s, v, p, 4, (7, 10), 0.1, threads=3).any()


def test_points_far_away_do_not_wrap():
    far = [[1e300, -1e300], [2.0**40, 0.5], [2.0**31, 2.0**32], [2.0**28, -(2.0**28)]]
    wall = oriented([[0.5, 0.5], *far], np.zeros(5))
    scan = oriented([[0.0, 0.0], *far[:3], [1e308, 1e308], [0.0, 2.0**28]], np.arange(6.0))
    assert ght(wall, scan, 4, (3, 3), 1.0).sum() == 1


@pytest.mark.parametrize(
    ("n_theta", "shape", "resolution", "threads"),
    [(0, (3, 3), 0.1, 1), (4, (0, 3), 0.1, 1), (4, (3, 3), -0.1, 1), (4, (3, 3), 0.1, 0)],
)
def test_refuses_bad_parameters(n_theta, shape, resolution, threads):
    surface, points, _ = random_case(9)
    with pytest.raises(ConfigError, match="got"):
        ght(surface, points, n_theta, shape, resolution, threads=threads)


@pytest.mark.parametrize("shape", [(14,), (14, 24), (24, 13), (0, 14)])
def test_refuses_a_visibility_that_does_not_fit(shape):
    surface, points, _ = random_case(10)
    with pytest.raises(ValueError, match=r"visibility must be \(n_psi, 14\)"):
        ght_v(surface, np.ones(shape, dtype=np.float32), points, 4, (7, 10), 0.1)


@settings(max_examples=40)
@given(seeds, st.integers(1, 12), st.integers(1, 9), st.integers(1, 9))
def test_random_cases_equal_the_listings(seed, n_theta, height, width):
    shape = height, width
    surface, points, vis = random_case(seed, shape)
    slow = naive.ght(surface, points, n_theta, shape, 0.1)
    np.testing.assert_array_equal(ght(surface, points, n_theta, shape, 0.1), slow)
    np.testing.assert_array_equal(
        ght_v(surface, relative(vis, surface.alpha), points, n_theta, shape, 0.1),
        naive.ght_v(surface, vis, points, n_theta, shape, 0.1),
    )


@pytest.mark.parametrize("n_theta", [24, 36, 120])
def test_a_normal_just_below_a_whole_turn_has_a_heading(n_theta):
    # A half added to round to the nearest bin makes a turn of what is just less than one.
    alpha = (n_theta - 0.5) * 2 * np.pi / n_theta
    for _ in range(4):
        wall = OrientedPoints([[1.0, 1.0]], [alpha], [0.1], [True])
        scan = OrientedPoints([[0.1, 0.0]], [0.0], [0.1], [True])
        stack = ght(wall, scan, n_theta, (20, 20), 0.1)
        assert stack.sum() == 1
        assert int(stack.argmax()) // 400 in (n_theta - 1, 0)
        alpha = np.nextafter(alpha, 0)


# Sec. VII's suggestion: one vote per scan point and cell.


@pytest.mark.parametrize("n_theta", [1, 5])
def test_once_equals_the_loops(n_theta):
    surface, points, vis = random_case(1, m=60, n=25)
    fast = ght_v(surface, relative(vis, surface.alpha), points, n_theta, (7, 10), 0.1, once=True)
    slow = naive.ght_v_once(surface, vis, points, n_theta, (7, 10), 0.1)
    np.testing.assert_array_equal(fast, slow)
    everybody = naive.ght_v(surface, vis, points, n_theta, (7, 10), 0.1)
    assert 0 < fast.sum() < everybody.sum()
    plain = ght(surface, points, n_theta, (7, 10), 0.1, once=True)
    slow = naive.ght_v_once(surface, None, points, n_theta, (7, 10), 0.1)
    np.testing.assert_array_equal(plain, slow)


def test_once_holds_across_blocks_and_threads():
    m = BLOCK_COLUMNS + 900
    surface, points, vis = random_case(2, m=m, n=7, lost=0.0)
    vis = relative(vis, surface.alpha)
    stack = ght_v(surface, vis, points, 3, (7, 10), 0.1, once=True)
    assert stack.max() <= 7  # of the 9000 map points no cell gets more votes than scan points
    parts = [
        ght_v(surface, vis, points.select(slice(i, i + 1)), 3, (7, 10), 0.1) > 0 for i in range(7)
    ]
    np.testing.assert_array_equal(stack, np.sum(parts, axis=0))
    for threads in (2, 5):
        more = ght_v(surface, vis, points, 3, (7, 10), 0.1, once=True, threads=threads)
        np.testing.assert_array_equal(more, stack)
