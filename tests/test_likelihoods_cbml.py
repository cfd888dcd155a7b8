import naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from naive import oriented

from imgloc import ConfigError
from imgloc.geometry import uniform_thetas
from imgloc.likelihoods.cbml import cbml, cbml_o, project
from imgloc.likelihoods.correlate import EXACT

seeds = st.integers(0, 2**32 - 1)
every_engine = pytest.mark.parametrize("engine", EXACT)
ONE = np.zeros(1)


def random_field(rng, shape):
    angle, length = rng.uniform(-4, 4, shape), rng.uniform(0, 1, shape)
    return np.stack((length * np.cos(angle), length * np.sin(angle))).astype(np.float32)


def random_case(seed, shape=(7, 9), n=20, reach=0.6):
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-reach, reach, (n, 2))
    valid = rng.random(n) < 0.7
    alpha = np.where(valid | (rng.random(n) < 0.5), rng.uniform(-np.pi, np.pi, n), np.nan)
    return random_field(rng, shape), oriented(xy, alpha, valid)


QUARTERS = np.array([0.0, np.pi / 2, np.pi, -np.pi / 2, 4 * np.pi])


@pytest.mark.parametrize("shape", [(6, 8), (5, 7), (4, 7)])
def test_turning_the_map_is_exact_for_quarter_turns(shape):
    rng = np.random.default_rng(1)
    levels = rng.integers(0, 256, shape)
    xy = rng.uniform(-0.5, 0.5, (13, 2))
    xy[4], xy[5:9] = np.nan, xy[5]  # some share a cell
    bmap = (levels / 255).astype(np.float32)
    stack = cbml(bmap, xy, QUARTERS, 0.1, engine="remap")
    expected = naive.cbml(levels, xy, QUARTERS, 0.1) / 255
    np.testing.assert_allclose(stack, expected, rtol=1e-6)
    vmap, points = random_case(5, shape)
    turned = cbml_o(vmap, points, QUARTERS, 0.1, engine="remap", directions=720)
    error = 0.005 + np.pi / 720  # a projection is rounded to 1/127, a direction to half a degree
    slow = naive.cbml_o(vmap, points, QUARTERS, 0.1)
    np.testing.assert_allclose(turned, slow, atol=len(points) * error)


def test_turning_a_smooth_map_errs_little_in_between():
    # Walls as bmap and vmap blur them: a Gaussian of one cell; stated are errors for each reading.
    y, x = np.mgrid[:40, :50] + 0.5
    walls = [np.exp(-0.5 * (d**2)) for d in (x - 5, y - 6, 0.6 * x + 0.8 * y - 30, x - 44)]
    bmap = np.minimum(np.sum(walls, axis=0), 1).astype(np.float32)
    vmap = np.stack((walls[0] - walls[3], walls[1])).astype(np.float32) / np.float32(1.5)
    rng = np.random.default_rng(2)
    xy, alpha = rng.uniform(-1.5, 1.5, (60, 2)), rng.uniform(-3, 3, 60)
    thetas = uniform_thetas(1.3)
    scan = oriented(xy, alpha)
    for stack in (  # the engines that do not interpolate equal the loops, see below
        lambda engine: cbml(bmap, xy, thetas, 0.1, engine=engine),
        lambda engine: cbml_o(vmap, scan, thetas, 0.1, engine=engine),
    ):
        off = stack("remap") - stack("shift")
        assert np.sqrt(np.mean(off**2)) < 0.015 * len(xy)
        assert np.abs(off).max() < 0.06 * len(xy)


@every_engine
@pytest.mark.parametrize("shape", [(6, 8), (5, 7)])
def test_cbml_equals_algorithm_1(engine, shape):
    rng = np.random.default_rng(1)
    bmap = rng.random(shape).astype(np.float32)
    xy = rng.uniform(-0.5, 0.5, (13, 2))
    xy[4] = np.nan
    thetas = np.array([0.0, 2.0, -9.0])
    stack = cbml(bmap, xy, thetas, 0.1, engine=engine)
    levels = np.rint(bmap * np.float32(255))
    np.testing.assert_allclose(stack, naive.cbml(levels, xy, thetas, 0.1) / 255, rtol=1e-6)
    exact = naive.cbml(bmap, xy, thetas, 0.1)
    np.testing.assert_allclose(stack, exact, atol=12 * 0.5 / 255)


@pytest.mark.parametrize("value", [-0.1, 1.1, np.nan, np.inf])
def test_cbml_refuses_a_bmap_that_is_not_one(value):
    bmap = np.zeros((3, 3), dtype=np.float32)
    bmap[1, 1] = value
    with pytest.raises(ValueError, match=r"bmap must be in 0\.\.1"):
        cbml(bmap, np.zeros((1, 2)), ONE, 0.1)


@every_engine
@settings(max_examples=15)
@given(seed=seeds, shape=st.sampled_from([(6, 8), (5, 7), (1, 4)]))
def test_cbml_o_equals_algorithm_3_on_its_directions(engine, seed, shape):
    vmap, points = random_case(seed, shape)
    step = 2 * np.pi / 64
    points = oriented(points.xy, np.rint(points.alpha / step) * step, points.valid)
    thetas = uniform_thetas(np.pi / 4) + 8 * np.pi
    stack = cbml_o(vmap, points, thetas, 0.1, engine=engine)
    # The shift engine rounds each projection to a step of 1/127.
    tolerance = len(points) * 0.5 / 127 if engine == "shift" else 1e-4
    np.testing.assert_allclose(stack, naive.cbml_o(vmap, points, thetas, 0.1), atol=tolerance)


@pytest.mark.parametrize("engine", ["shift", "dft"])
def test_normals_go_to_the_nearest_direction(engine):
    vmap, points = random_case(12)
    step = 2 * np.pi / 64
    centred = oriented(points.xy, np.rint(points.alpha / step) * step + 1e-9, points.valid)
    thetas = uniform_thetas(np.pi / 4)
    expected = cbml_o(vmap, centred, thetas, 0.1, engine=engine)
    for off in (-0.49, 0.49):
        near = oriented(points.xy, centred.alpha + off * step, points.valid)
        np.testing.assert_array_equal(cbml_o(vmap, near, thetas, 0.1, engine=engine), expected)


@every_engine
def test_cbml_o_is_near_algorithm_3_in_any_direction(engine):
    vmap, points = random_case(5)
    thetas = np.array([0.1, 1.7, -2.9])
    n = int(points.valid.sum())
    expected = naive.cbml_o(vmap, points, thetas, 0.1)
    previous = np.inf
    for directions, rounding in ((8, np.pi / 8), (64, np.pi / 64), (512, np.pi / 512)):
        stack = cbml_o(vmap, points, thetas, 0.1, directions=directions, engine=engine)
        error = np.abs(stack - expected).max()
        assert error <= n * (2 * np.sin(rounding / 2) + 0.5 / 127) + 1e-4
        assert error < previous
        previous = error


def test_a_valid_point_with_nan_does_not_vote():
    vmap, points = random_case(7)
    xy = np.concatenate((points.xy, [[np.nan, 0.0], [0.1, 0.1]]))
    alpha = np.concatenate((points.alpha, [0.0, np.nan]))
    more = oriented(xy, alpha, np.concatenate((points.valid, [True, True])))
    np.testing.assert_array_equal(
        cbml_o(vmap, more, ONE, 0.1, engine="shift"), cbml_o(vmap, points, ONE, 0.1, engine="shift")
    )


def test_projections_are_reused():
    vmap, points = random_case(8, (20, 30))
    thetas = uniform_thetas(0.5)
    vmap[:, :3] = 0
    projections = project(vmap, 32)
    assert projections.shape == (16, 20, 30)
    how = {"directions": 32, "engine": "shift"}
    fresh = cbml_o(vmap, points, thetas, 0.1, **how)
    again = cbml_o(vmap, points, thetas, 0.1, **how, projections=projections)
    np.testing.assert_array_equal(fresh, again)
    with pytest.raises(ValueError, match="projections must be"):
        cbml_o(vmap, points, thetas, 0.1, directions=64, engine="shift", projections=projections)


@every_engine
def test_cbml_o_reused_and_threaded(engine):
    vmap, points = random_case(9, (12, 10), 30)
    thetas = uniform_thetas(0.9)
    full = cbml_o(vmap, points, thetas, 0.1, engine=engine)
    out = np.full(full.shape, np.nan, dtype=np.float32)
    assert cbml_o(vmap, points, thetas, 0.1, engine=engine, out=out) is out
    np.testing.assert_allclose(out, full, atol=1e-5)
    for threads in (2, 5):
        threaded = cbml_o(vmap, points, thetas, 0.1, engine=engine, threads=threads)
        np.testing.assert_array_equal(threaded, full)


@pytest.mark.parametrize("directions", [0, 7, -2])
def test_refuses_directions(directions):
    vmap, points = random_case(10)
    with pytest.raises(ConfigError, match="directions"):
        cbml_o(vmap, points, ONE, 0.1, directions=directions)
    with pytest.raises(ConfigError, match="directions"):
        project(vmap, directions)


def test_refuses_a_vmap_that_is_not_one():
    _, points = random_case(11)
    with pytest.raises(ValueError, match=r"\(2, H, W\)"):
        cbml_o(np.zeros((3, 4), np.float32), points, ONE, 0.1)
    for value in (0.75, 1.2, np.nan):  # both components: 0.75 is a length of 1.06
        with pytest.raises(ValueError, match="length"):
            cbml_o(np.full((2, 3, 4), value, np.float32), points, ONE, 0.1)


@pytest.mark.parametrize("n", [1, 2, 3, 7, 8, 9, 31, 257, 258, 259, 700])
def test_readings_that_share_cell_and_direction_are_added_at_once_and_exactly(n):
    # Also where their sums would overflow 16 bits, on both sides of zero.
    vmap = np.zeros((2, 1, 3), dtype=np.float32)
    vmap[0] = [1, -1, 0.5]
    left = oriented(np.zeros((n, 2)), np.zeros(n))
    right = oriented(np.zeros((n, 2)), np.full(n, np.pi))
    expected = n * np.array([127, -127, 64]) / np.float32(127)
    for points, sign in ((left, 1), (right, -1)):
        stack = cbml_o(vmap, points, ONE, 1.0, engine="shift")
        np.testing.assert_allclose(stack[0, 0], sign * expected, rtol=1e-6)
    both = oriented(np.zeros((2 * n, 2)), np.repeat([0.0, np.pi], n))
    assert not cbml_o(vmap, both, ONE, 1.0, engine="shift").any()
