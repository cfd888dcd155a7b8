"""The inner functions under pytest-benchmark, each with a look at what it returns.

In a run of all tests each is called once; the table of times is printed by

    python -m pytest tests/test_benchmarks.py -n 0 --benchmark-only
"""

import numpy as np
import pytest
from places import POSES, error, features_of, grid_of, scan_of

from imgloc.features.distance import FARTHEST, distance_field, distance_image
from imgloc.features.pyramid import pyramid
from imgloc.features.raycast import cast_rays
from imgloc.features.scanpoints import Readings, scan_points, scan_xy
from imgloc.features.surface import outlines, surface_points
from imgloc.features.visibility import visibility_frames
from imgloc.geometry import centre_of, uniform_thetas
from imgloc.likelihoods.cbml import cbml_o
from imgloc.likelihoods.correlate import EXACT, correlate
from imgloc.likelihoods.ght import ght, ght_v
from imgloc.likelihoods.shift import flat_stack
from imgloc.likelihoods.slices import cell_offsets
from imgloc.model import Pose2D
from imgloc.options import FusedOptions
from imgloc.pipeline import localize
from imgloc.search.proposals import propose_endpoints
from imgloc.search.refine import refine
from imgloc.search.rescore import score_poses

WORLD = "curved"
TRUTH = np.array(POSES[WORLD])
THETAS = uniform_thetas(np.deg2rad(10))
OPTIONS = FusedOptions()


@pytest.fixture(scope="module")
def features():
    return features_of(WORLD)


@pytest.fixture(scope="module")
def scan():
    return scan_of(WORLD)


@pytest.fixture(scope="module")
def xy(scan):
    return scan_xy(scan)[scan.valid]


@pytest.fixture(scope="module")
def image(features):
    return np.rint(255 * features.bmap).astype(np.uint8)


def near_truth(cells, cell=0.2, thetas=THETAS):
    """Whether the cell (theta, row, col) lies at the true pose, give or take one."""
    x, y = centre_of(np.asarray(cells[1:]), cell)
    away, turn = error(Pose2D(x, y, thetas[cells[0]]), TRUTH)
    return away < 2 * cell and turn < np.deg2rad(15)


def argmax(stack):
    return np.unravel_index(int(stack.argmax()), stack.shape)


@pytest.mark.parametrize("engine", [*EXACT, "auto"])
def test_correlate(benchmark, engine, image, xy):
    stack = benchmark(lambda: correlate(image, xy, THETAS, 0.2, engine=engine))
    assert stack.max() <= 255 * len(xy)
    assert near_truth(argmax(stack))
    np.testing.assert_array_equal(stack, correlate(image, xy, THETAS, 0.2, engine="filter2d"))


def test_flat_stack(benchmark, image, xy):
    wide, offsets = image.astype(np.uint16), cell_offsets(xy, THETAS, 0.2)
    out = np.empty((len(THETAS), *image.shape), np.float32)
    benchmark(lambda: flat_stack(wide, 0xFFFF // int(image.max()), offsets, out))
    np.testing.assert_array_equal(out, correlate(image, xy, THETAS, 0.2, engine="filter2d"))


def test_cbml_o(benchmark, features, scan):
    points = scan_points(scan.ranges, scan.angles, scan.valid)
    stack = benchmark(lambda: cbml_o(features.vmap, points, THETAS, 0.2))
    assert near_truth(argmax(stack))


@pytest.mark.parametrize("visible", [False, True], ids=["ght", "ght_v"])
def test_votes(benchmark, visible, features, scan):
    points = scan_points(scan.ranges, scan.angles, scan.valid)
    surface, visibility = features.surface, features.visibility
    args = points, len(THETAS), features.lattice.shape, 0.2
    out = np.empty((len(THETAS), *features.lattice.shape), np.float32)
    if visible:
        benchmark(lambda: ght_v(surface, visibility, *args, out=out))
    else:
        benchmark(lambda: ght(surface, *args, out=out))
    pairs = int(points.valid.sum()) * int(surface.valid.sum())
    assert 0 < out.sum() <= pairs
    assert near_truth(argmax(out))


def test_propose_endpoints(benchmark, features, xy):
    keep = OPTIONS.keep[: len(features.pyramid)]
    poses, scores = benchmark(
        lambda: propose_endpoints(features.pyramid, xy, theta_step=np.deg2rad(1), keep=keep)
    )
    assert (np.diff(scores) <= 0).all()
    away = [error(Pose2D(*pose), TRUTH) for pose in poses]
    assert any(d < 0.3 and turn < np.deg2rad(3) for d, turn in away)


def test_rescore(benchmark, features, scan):
    poses = TRUTH + np.array([[0.0, 0.0, 0.0], *np.random.default_rng(1).normal(0, 1, (255, 3))])
    readings = Readings(scan.ranges[scan.valid], scan.angles[scan.valid])
    evidence = benchmark(lambda: score_poses(features, readings, poses, OPTIONS.model))
    assert evidence.log_likelihood.argmax() == 0
    assert evidence.explained[0] > 0.9


def test_refine(benchmark, features, xy):
    poses = TRUTH + np.random.default_rng(1).normal(0, 1, (256, 3)) * (0.1, 0.1, 0.02)
    out = benchmark(lambda: refine(poses, xy, features.field, sigmas=(0.3, 0.1, 0.05)))
    away = [error(Pose2D(*pose), TRUTH)[0] for pose in out]
    assert np.median(away) < 0.03 < np.median(np.hypot(*(poses - TRUTH)[:, :2].T))


def test_cast_rays(benchmark, features, scan):
    psi = TRUTH[2] + np.repeat(scan.angles, 100)
    ranges = benchmark(lambda: cast_rays(features.walls, TRUTH[:2], psi, 30.0, 0.1))
    off = np.abs(ranges[::100] - scan.ranges)[scan.valid]
    assert np.median(off) < 0.1  # a cell


def test_distance_image(benchmark):
    occupied = grid_of(WORLD).occupied
    walls = benchmark(lambda: distance_image(occupied))
    assert (walls[occupied] == 0).all()
    assert walls[~occupied].min() == 1


def test_distance_field(benchmark):
    grid = grid_of(WORLD)
    field = benchmark(lambda: distance_field(grid.occupied, grid.resolution))
    distance = field.distance
    assert (distance[grid.occupied] < 0).all()
    assert 0 < distance[~grid.occupied].min() < distance.max() <= FARTHEST


def test_pyramid(benchmark, features):
    grid, distance = features.grid, features.field.distance
    levels = benchmark(
        lambda: pyramid(distance, grid.free, grid.resolution, cell=0.1, sigma=0.15, levels=3)
    )
    assert [level.resolution for level in levels] == pytest.approx([0.1, 0.2, 0.4])
    assert all(level.image.max() > 200 for level in levels)


def test_outlines(benchmark):
    occupied = grid_of(WORLD).occupied
    vertices, size = benchmark(lambda: outlines(occupied))
    assert size.sum() == len(vertices)


def test_surface_points(benchmark):
    grid = grid_of(WORLD)
    points = benchmark(lambda: surface_points(grid.occupied, grid.free, grid.resolution))
    assert points.valid.mean() > 0.9


def test_visibility(benchmark, features):
    grid = features.grid
    vis = benchmark(
        lambda: visibility_frames(grid.occupied, features.surface, grid.resolution, 72, 30.0)
    )
    assert vis.shape == (72, len(features.surface))
    assert (vis[36] == 0).all()  # behind the surface


def test_localize(benchmark, features, scan):
    answer = benchmark(lambda: localize(features, scan))
    assert answer.verdict == "unique"
    assert error(answer.pose, TRUTH)[0] < 0.1
