"""Eq. 2 for every pose at once against the same sum written out."""

import numpy as np
import pytest

from imgloc.errors import ConfigError
from imgloc.features.raydistance import ray_distances
from imgloc.geometry import uniform_thetas
from imgloc.likelihoods.beam import beam, heading_sigma

NONE = np.zeros(0)


def naive_beam(stack, ranges, angles, valid, thetas, sigma, sigma_theta, hit, short, span):
    n_psi, height, width = stack.shape
    out = np.zeros((len(thetas), height, width))
    for k, theta in enumerate(thetas):
        for row in range(height):
            for col in range(width):
                for rho, phi, ok in zip(ranges, angles, valid, strict=True):
                    if not ok:
                        continue
                    psi = int(np.floor((theta + phi) / (2 * np.pi / n_psi) + 0.5)) % n_psi
                    r_m = stack[psi, row, col] / 100
                    s = np.hypot(sigma, rho * sigma_theta)
                    p = hit * np.exp(-0.5 * ((rho - r_m) / s) ** 2) / (np.sqrt(2 * np.pi) * s)
                    p += (1 - hit - short) / span + (short / span if rho < r_m else 0)
                    out[k, row, col] += np.log(p)
    return out


def room(height=14, width=19):
    occupied = np.ones((height, width), bool)
    occupied[1:-1, 1:-1] = False
    occupied[5:8, 7] = True
    occupied[1:3, 1:6] = True  # or turning it by 180 deg would change little
    return occupied


def scan_at(stack, k, row, col, n_theta, angles):
    """The readings that the stack itself expects at a cell centre and heading."""
    n_psi = len(stack)
    psi = (k * (n_psi // n_theta) + np.round(angles / (2 * np.pi / n_psi)).astype(int)) % n_psi
    return stack[psi, row, col] / 100


@pytest.mark.parametrize(
    "mixture",
    [
        {"sigma": 0.1, "sigma_theta": 0.0, "hit": 0.8, "short": 0.1, "span": 10.0},
        {"sigma": 0.3, "sigma_theta": 0.02, "hit": 0.5, "short": 0.0, "span": 3.0},
        {"sigma": 0.05, "sigma_theta": 0.05, "hit": 0.7, "short": 0.25, "span": 30.0},
    ],
)
def test_equals_the_sum_of_eq_2(mixture):
    rng = np.random.default_rng(0)
    stack = ray_distances(room(9, 11), 0.1, 24, 5.0)
    thetas = uniform_thetas(np.deg2rad(60))
    ranges, angles = rng.uniform(0.02, 1.5, 12), rng.uniform(-4, 4, 12)
    ranges[[3, 7]] = np.nan, np.inf
    valid = np.isfinite(ranges)
    fast = beam(stack, ranges, angles, valid, thetas, **mixture)
    slow = naive_beam(stack, ranges, angles, valid, thetas, **mixture)
    assert fast.dtype == np.float32
    assert fast.shape == (6, 9, 11)
    # The table has steps of one centimetre, ten percent of the smallest sigma.
    assert np.abs(fast - slow).max() < 0.2 * 10
    assert np.abs(fast - slow).mean() < 0.3
    assert np.corrcoef(fast.ravel(), slow.ravel())[0, 1] > 0.999


def test_whole_centimetres_are_exact():
    stack = np.array([[[30, 50, 80]]], np.uint16)
    one = np.array([True])
    fast = beam(stack, np.array([0.5]), np.zeros(1), one, np.zeros(1), sigma=0.1)
    slow = naive_beam(stack, [0.5], [0.0], one, [0.0], 0.1, 0.0, 0.8, 0.1, 10.0)
    np.testing.assert_allclose(fast, slow, rtol=1e-5)


@pytest.mark.parametrize(("k", "row", "col"), [(0, 3, 3), (5, 11, 2), (11, 2, 16), (7, 10, 12)])
def test_the_true_pose_is_the_maximum(k, row, col):
    stack = ray_distances(room(), 0.1, 72, 5.0)
    thetas = uniform_thetas(np.deg2rad(30))
    angles = np.deg2rad(np.arange(-120, 121, 5.0))
    ranges = scan_at(stack, k, row, col, 12, angles)
    values = beam(stack, ranges, angles, np.isfinite(ranges), thetas, sigma=0.05)
    assert np.unravel_index(values.argmax(), values.shape) == (k, row, col)


def test_a_reading_behind_a_mapped_wall_costs_more_than_one_in_front():
    stack = np.full((1, 1, 1), 200, np.uint16)
    one = np.array([True])
    args = (np.zeros(1), one, np.zeros(1))
    long, short = (
        float(beam(stack, np.array([r]), *args, hit=0.8, short=0.15)[0, 0, 0]) for r in (3.0, 1.0)
    )
    assert short - long == pytest.approx(np.log(0.2 / 0.05), abs=1e-3)


def test_the_influence_of_a_reading_is_bounded():
    stack = np.array([[[100, 6000]]], np.uint16)
    one = np.array([True])
    values = beam(stack, np.array([59.0]), np.zeros(1), one, np.zeros(1))
    assert values[0, 0, 0] == pytest.approx(np.log(0.1 / 10), abs=1e-3)
    assert values[0, 0, 1] == pytest.approx(np.log(0.2 / 10), abs=1e-3)


@pytest.mark.parametrize("shape", [(4, 1), (1, 4), (4, 4), (5, 3), (700, 300)])
def test_any_shape_and_any_number_of_threads(shape):
    # Four rows are what OpenCV takes for a scalar; 700 rows are more than one block.
    rng = np.random.default_rng(1)
    stack = rng.integers(0, 800, (6, *shape), dtype=np.uint16)
    ranges, angles = np.array([0.3, 4.0]), np.array([0.0, 1.1])
    args = (stack, ranges, angles, np.isfinite(ranges), uniform_thetas(np.deg2rad(120)))
    values = beam(*args)
    np.testing.assert_array_equal(values, beam(*args, threads=3))
    cells = rng.integers(0, shape, (5, 2))
    for row, col in cells:
        alone = beam(stack[:, row : row + 1, col : col + 1], *args[1:])
        np.testing.assert_array_equal(values[:, row, col], alone[:, 0, 0])


def test_the_deviation_of_a_heading_shrinks_with_their_step():
    assert heading_sigma(360) == pytest.approx(np.deg2rad(1) / np.sqrt(3))
    assert heading_sigma(36) == pytest.approx(10 * heading_sigma(360))


STACK, HEADINGS = np.zeros((4, 3, 3), np.uint16), uniform_thetas(np.pi / 2)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("sigma", (0.0, np.nan)),
        ("sigma_theta", (-0.1,)),
        ("span", (0.0,)),
        ("threads", (0, -1)),
        ("hit", (1.0, -0.1)),
        # Not a stack of uint16; its six directions are no multiple of the four headings.
        ("distances", (1.0 * STACK, STACK[0], np.zeros((6, 3, 3), np.uint16))),
        ("thetas", (NONE, np.arange(4.0), HEADINGS + 0.1)),
        ("angles", (NONE,)),
        ("valid", (NONE.astype(bool),)),
    ],
)
def test_wrong_parameters(name, values):
    readings = {"ranges": np.ones(2), "angles": np.zeros(2), "valid": np.ones(2, bool)}
    good = {"distances": STACK, "thetas": HEADINGS, **readings}
    beam(**good)
    for value in values:
        with pytest.raises(ConfigError):
            beam(**{**good, name: value})
