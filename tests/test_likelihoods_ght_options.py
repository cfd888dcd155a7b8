"""Sec. VII's two suggestions: one vote per scan point and cell, and eq. 8's uncertainty."""

import naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imgloc.errors import ConfigError
from imgloc.likelihoods.ght import BLOCK_COLUMNS, ght, ght_v
from imgloc.model import OrientedPoints
from tools.paper.uncertainty import Uncertainty, blur, blur_of, turned_copies, vote_spread

seeds = st.integers(0, 2**32 - 1)
N_PSI = 24
SHAPE = (9, 12)
SHARP = Uncertainty(0.0, 0.0, copies=1)  # spreads nothing where sigma_alpha is next to nothing


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


def test_once_is_per_scan_point_and_cell():
    # Three map points in a row: scan point A sees two of them in one cell, B too.
    wall = OrientedPoints([[0.5, 0.2], [0.5, 0.7], [0.5, 1.2]], np.zeros(3), np.ones(3), np.ones(3))
    twice = OrientedPoints(np.zeros((2, 2)), np.zeros(2), np.ones(2), np.ones(2))
    np.testing.assert_array_equal(ght(wall, twice, 1, (2, 1), 1.0)[0], [[4], [2]])
    np.testing.assert_array_equal(ght(wall, twice, 1, (2, 1), 1.0, once=True)[0], [[2], [2]])


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


UNCERTAINTIES = [
    Uncertainty(0.0, 0.0, copies=15),
    Uncertainty(0.02, 0.03, copies=5),
    Uncertainty(0.1, 0.05, copies=1),
]


@pytest.mark.parametrize("uncertainty", UNCERTAINTIES)
@pytest.mark.parametrize("once", [False, True])
@pytest.mark.parametrize("n_theta", [4, 24])
def test_uncertain_votes_equal_the_loops(uncertainty, once, n_theta):
    surface, points, vis = random_case(3)
    fast = vote_spread(
        surface, relative(vis, surface.alpha), points, n_theta, SHAPE, 0.1,
        once=once, uncertainty=uncertainty,
    )  # fmt: skip
    slow = naive.ght_v_uncertain(surface, vis, points, n_theta, SHAPE, 0.1, uncertainty, once)
    assert slow.sum() > 2
    np.testing.assert_allclose(fast, slow, atol=1e-5)


def test_uncertain_votes_without_visibility():
    surface, points, _ = random_case(4)
    uncertainty = Uncertainty(copies=7)
    np.testing.assert_allclose(
        vote_spread(surface, None, points, 8, SHAPE, 0.1, uncertainty=uncertainty),
        naive.ght_v_uncertain(surface, None, points, 8, SHAPE, 0.1, uncertainty),
        atol=1e-5,
    )


def test_certain_votes_are_those_of_algorithm_4():
    surface, points, vis = random_case(5, m=40, n=20, spread=(1e-9, 1e-8))
    # At most 0.85 m times 2.5 times hypot(1/256, 1/256): less than half a cell of 0.1 m.
    fast = vote_spread(
        surface, relative(vis, surface.alpha), points, 12, SHAPE, 0.1, uncertainty=SHARP
    )
    np.testing.assert_array_equal(fast, naive.ght_v(surface, vis, points, 12, SHAPE, 0.1))


def test_a_vote_is_spread_along_the_arc_around_its_map_point():
    # Seen 4 m ahead with a normal uncertain by 0.1 rad: poses 4 m from the wall point, on an arc
    # of 0.4 m (one sigma), each with the heading under which the point lies ahead.
    wall, scan = one(5.05, 3.05, np.pi), one(4.0, 0.0, np.pi, sigma=0.1)
    stack = vote_spread(
        wall, None, scan, 72, (60, 60), 0.1, uncertainty=Uncertainty(0.0, 0.0, copies=101)
    ).astype(float)
    assert abs(stack.sum() - 1) < 0.05
    k, row, column = np.nonzero(stack)
    x, y = (column + 0.5) * 0.1, (row + 0.5) * 0.1
    np.testing.assert_allclose(np.hypot(x - 5.05, y - 3.05), 4.0, atol=0.08)
    theta = np.arctan2(3.05 - y, 5.05 - x)
    heading = (k * 2 * np.pi / 72 + np.pi) % (2 * np.pi) - np.pi
    np.testing.assert_allclose(heading, theta, atol=np.pi / 72 + 0.02)
    weight = stack[k, row, column]
    spread = np.sqrt(np.average((y - 3.05) ** 2, weights=weight))
    assert abs(np.average(y, weights=weight) - 3.05) < 0.02
    assert 0.35 < spread < 0.42  # 4 m x 0.1 rad, cut at 2.5 sigma
    # What varies is eq. 7 and 8 together: a turn to the left is a step to the right.
    assert np.corrcoef(heading, y)[0, 1] < -0.98


def test_blur_stands_in_for_copies_that_are_not_cast():
    wall, scan = one(5.05, 3.05, np.pi), one(4.0, 0.0, np.pi, sigma=0.1)
    spreads = []
    for copies in (1, 3, 5, 9, 101):
        stack = vote_spread(
            wall, None, scan, 4, (61, 60), 0.1, uncertainty=Uncertainty(0.0, 0.0, copies=copies)
        ).sum(axis=(0, 2))
        y = (np.arange(61) + 0.5) * 0.1
        spreads.append(np.sqrt(np.average((y - 3.05) ** 2, weights=stack)))
    np.testing.assert_allclose(spreads, 0.4, atol=0.05)


def test_range_and_map_noise_blur_in_x_and_y():
    wall, scan = one(2.05, 2.05, np.pi, 1e-9), one(0.5, 0.0, np.pi, 1e-9)
    stack = vote_spread(
        wall, None, scan, 1, (40, 40), 0.1, uncertainty=Uncertainty(0.12, 0.16, copies=1)
    )[0]
    assert abs(stack.sum() - 1) < 1e-4
    x = (np.arange(40) + 0.5) * 0.1
    for profile, middle in ((stack.sum(axis=0), 1.55), (stack.sum(axis=1), 2.05)):
        assert abs(profile @ x - middle) < 1e-3
        assert abs(np.sqrt(profile @ (x - middle) ** 2) - 0.2) < 0.01


def test_each_copy_of_a_vote_has_its_own_visibility():
    wall, scan = one(3.05, 3.05, 0.0), one(1.0, 0.0, np.pi, sigma=0.3)
    options = {"uncertainty": Uncertainty(0.0, 0.0, copies=15)}
    everything = np.full((72, 1), 9.0, dtype=np.float32)
    left_only = everything.copy()
    left_only[37:] = 0  # directions clockwise from the normal are blocked
    full = vote_spread(wall, everything, scan, 36, (60, 60), 0.1, **options)
    half = vote_spread(wall, left_only, scan, 36, (60, 60), 0.1, **options)
    rows = np.nonzero(half)[1]
    assert rows.min() == 30
    assert 0.5 < half.sum() / full.sum() < 0.7  # the copy at 0 is on the left too
    np.testing.assert_array_equal(half[:, 31:], full[:, 31:])


def test_sum_of_weights_and_symmetry_of_copies():
    rng = np.random.default_rng(6)
    sigma, distance = np.exp(rng.uniform(-6, -0.7, 50)), rng.uniform(0, 30, 50)
    copies = turned_copies(sigma, distance, 0.1, 0.1, 15)
    counts = np.bincount(copies.index)
    assert set(counts) <= set(range(1, 16, 2))
    assert {1, 15} <= set(counts)
    assert np.abs(np.bincount(copies.index, copies.weight) - 1).max() < 0.03
    np.testing.assert_allclose(np.bincount(copies.index, copies.weight * copies.turn), 0, atol=1e-9)
    assert copies.blur.max() > 1
    assert (copies.blur[copies.index == distance.argmin()] == 0).all()


def test_variances_of_the_blurs_add_up():
    for group in range(5):
        variance = sum(blur_of(g, 0.3) ** 2 for g in range(group + 1))
        assert np.isclose(variance, 0.3**2 + (4.0 ** (group - 1) if group else 0))
    stack = np.zeros((2, 21, 21), dtype=np.float32)
    stack[0, 10, 10] = 1
    blur(stack, 1.5)
    assert not stack[1].any()
    assert np.isclose(stack[0].sum(), 1, atol=1e-5)


@pytest.mark.parametrize("once", [False, True])
def test_any_number_of_threads_gives_the_same_bits(once):
    surface, points, vis = random_case(7, m=2000, n=60)
    vis = relative(vis, surface.alpha)
    first, *more = (
        vote_spread(
            surface, vis, points, 6, SHAPE, 0.1, threads=t, once=once, uncertainty=Uncertainty()
        )
        for t in (1, 2, 5)
    )
    assert first.any()
    for stack in more:
        np.testing.assert_array_equal(stack, first)


def test_unknown_uncertainty_of_a_normal_is_a_great_one():
    wall = one(3.05, 3.05, 0.0)
    stacks = [
        vote_spread(
            wall, None, one(1.0, 0.0, np.pi, sigma), 36, (60, 60), 0.1, uncertainty=Uncertainty()
        )
        for sigma in (np.nan, 0.5)
    ]
    np.testing.assert_array_equal(*stacks)
    nobody = wall.select(slice(0))
    assert not vote_spread(
        nobody, None, wall, 4, (3, 3), 0.1, uncertainty=Uncertainty(), once=True
    ).any()
    assert not vote_spread(
        wall, None, nobody, 4, (3, 3), 0.1, uncertainty=Uncertainty(), once=True
    ).any()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"sigma_range": -0.1}, "sigma_range"),
        ({"sigma_surface": np.nan}, "sigma_surface"),
        ({"copies": 4}, "odd"),
        ({"copies": -1}, "odd"),
    ],
)
def test_refuses_bad_uncertainty(options, message):
    with pytest.raises(ConfigError, match=message):
        Uncertainty(**options)


@settings(max_examples=25)
@given(seeds, st.booleans())
def test_turning_the_map_turns_the_votes(seed, once):
    surface, points, vis = random_case(seed, m=40, n=12)
    vis = relative(vis, surface.alpha)
    options = {"once": once, "uncertainty": Uncertainty()}
    stack = vote_spread(surface, vis, points, 8, SHAPE, 0.1, **options)
    x, y = surface.xy.T
    turned = OrientedPoints(
        np.stack((0.1 * SHAPE[0] - y, x), axis=1), surface.alpha + np.pi / 2,
        surface.sigma_alpha, surface.valid,
    )  # fmt: skip
    again = vote_spread(turned, vis, points, 8, SHAPE[::-1], 0.1, **options)
    np.testing.assert_allclose(
        np.roll(stack.swapaxes(1, 2)[..., ::-1], 2, axis=0), again, atol=1e-5
    )
