"""The appendix: work counted exactly, and how it grows."""

from functools import cache

import naive
import numpy as np
import pytest

from imgloc.features.raydistance import _rotate
from imgloc.model import OrientedPoints
from tools.paper import complexity
from tools.paper.work import pixels_added, ray_cells, votes_cast


@cache
def counted():
    """Counts on all axes: no run, no clock."""
    return complexity.measure(repeats=0)


def random_points(rng, n, low, high):
    valid = rng.random(n) < 0.8
    xy = rng.uniform(low, high, (n, 2))
    xy[rng.random(n) < 0.1] = np.nan
    alpha = np.where(valid, rng.uniform(-4, 4, n), np.nan)
    return OrientedPoints(xy, alpha, np.full(n, 0.1), valid)


@pytest.mark.parametrize("shape", [(5, 7), (4, 4), (1, 9)])
def test_pixels_added_are_those_of_algorithm_2(shape):
    rng = np.random.default_rng(1)
    xy = rng.uniform(-0.7, 0.7, (12, 2))
    xy[3] = np.nan
    thetas = np.array([0.0, 1.0, 2.5, -3.0])
    # An image of ones: what the listing sums up is how often it meets the map.
    slow = naive.cbml_faster(np.ones(shape), xy, thetas, 0.1).sum()
    assert 0 < slow < 11 * 4 * shape[0] * shape[1]
    assert pixels_added(xy, thetas, shape, 0.1) == slow


def test_votes_cast_are_those_of_algorithms_4_and_5():
    rng = np.random.default_rng(2)
    surface, points = random_points(rng, 30, 0.0, 2.0), random_points(rng, 25, -1.0, 1.0)
    step = 2 * np.pi / 12
    surface = OrientedPoints(
        surface.xy, np.rint(surface.alpha / step) * step, surface.sigma_alpha, surface.valid
    )
    vis = rng.uniform(0, 1.5, (30, 12)).astype(np.float32)
    turn = np.rint(np.nan_to_num(surface.alpha) / step).astype(int)
    seen = np.stack([np.roll(row, -k) for row, k in zip(vis, turn, strict=True)], axis=1)
    # Moved to the middle of one huge cell, no vote is lost.
    middle = OrientedPoints(surface.xy + 50, surface.alpha, surface.sigma_alpha, surface.valid)
    everybody = naive.ght(middle, points, 1, (1, 1), 100.0).sum()
    some = naive.ght_v(middle, vis, points, 1, (1, 1), 100.0).sum()
    assert 0 < some < everybody
    assert votes_cast(surface, None, points) == everybody
    assert votes_cast(surface, seen, points) == some
    nobody = points.select(slice(0))
    assert votes_cast(surface, None, nobody) == votes_cast(surface, seen, nobody) == 0


@pytest.mark.parametrize(("shape", "n_psi"), [((10, 20), 4), ((7, 5), 8), ((6, 9), 5), ((1, 3), 1)])
def test_ray_cells_are_the_pixels_of_the_turned_maps(shape, n_psi):
    image = np.zeros(shape, dtype=np.uint8)
    canvases = [_rotate(image, 2 * np.pi * k / n_psi)[0].size for k in range(n_psi)]
    assert ray_cells(shape, n_psi) == sum(canvases)


@pytest.mark.parametrize(
    ("method", "axis", "exponent"),
    [
        (method, axis, exponent)
        for method, exponents in {
            "ght": {"A": 1, "rho_m": 1, "rho_theta": 0, "n": 1},
            "ght-v": {"A": 1, "rho_m": 1, "rho_theta": 0, "n": 1},
            "cbml": {"A": 1, "rho_m": 2, "rho_theta": 1, "n": 1},
            "cbml-o": {"A": 1, "rho_m": 2, "rho_theta": 1, "n": 1},
            "beam": {"A": 1, "rho_m": 2, "rho_theta": 1, "n": 1},
        }.items()
        for axis, exponent in exponents.items()
    ],
)
def test_work_grows_as_the_appendix_says(method, axis, exponent):
    assert abs(counted().exponent(method, axis, "work") - exponent) < 0.15
    assert complexity.PAPER[method]["run_s"][axis] == exponent


def test_storage_grows_as_the_appendix_says():
    for fit in counted().fits:
        if fit.quantity == "storage":
            # The surface points themselves do not grow with rho_theta.
            allowed = 0.25 if (fit.method, fit.axis) == ("ght-v", "rho_theta") else 0.1
            assert abs(fit.exponent - fit.paper) < allowed


def test_the_table_is_a_factor_of_rho_m_cheaper_than_the_papers():
    assert abs(counted().exponent("beam", "rho_m", "init_work") - 2) < 0.1
    assert abs(counted().exponent("beam", "rho_m", "traced") - 3) < 0.1
    # So is the blur: a Gaussian is separable; the paper has rho_m ** 4.
    assert abs(counted().exponent("cbml", "rho_m", "init_work") - 3) < 0.15


def test_times_are_measured_when_asked_for():
    timed = complexity.measure(axes={"n": (5, 10)}, repeats=1, seed=3)
    assert all(s.run_s > 0 and s.init_s > 0 for s in timed.samples)
    assert {f.quantity for f in timed.fits} >= {"init_s", "run_s", "storage", "work"}
    told = []
    again = complexity.measure(
        methods=("ght-v",), axes={"n": (5, 10)}, repeats=0, seed=3, progress=told.append
    )
    assert told == ["n = 5", "n = 10"]
    mine = [s for s in timed.samples if s.method == "ght-v"]
    assert [s.work for s in mine] == [s.work for s in again.samples]
    with pytest.raises(KeyError):
        again.exponent("cbml", "n", "work")
