"""Branch and bound finds what the exhaustive search finds, ties and borders included."""

import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from places import features_of, scan_of

from imgloc.errors import ConfigError
from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.pyramid import pooled_maps
from imgloc.features.scanpoints import scan_xy
from imgloc.geometry import centre_of, uniform_thetas
from imgloc.io.maps import load_map
from imgloc.io.scans import load_scans
from imgloc.likelihoods.cbml import cbml
from imgloc.model import BoolArray, Float32Array, FloatArray
from imgloc.options import Options
from imgloc.pipeline import localize
from imgloc.search import stacked
from imgloc.search.branch_and_bound import Best, _Bounds, best_poses
from imgloc.search.hypotheses import separated

DRAWN = st.fixed_dictionaries(
    {
        "seed": st.integers(0, 2**32 - 1),
        "shape": st.tuples(st.integers(1, 40), st.integers(1, 40)),
        "points": st.integers(1, 40),
        "reach": st.floats(0.1, 60.0),
        "headings": st.integers(1, 9),
        "levels": st.integers(1, 4),  # few grey levels make many ties
        "walls": st.floats(0.0, 0.4),
        "wanted": st.floats(0.0, 1.0),
        "top": st.integers(1, 5),
        "prepared_reach": st.sampled_from((0.0, 5.0, 80.0)),
    }
)


def problem(drawn: dict) -> tuple[Float32Array, BoolArray, FloatArray, FloatArray]:
    """A random blurred map, the poses that are wanted, a scan and headings; cells of 1 m."""
    rng = np.random.default_rng(drawn["seed"])
    shape = drawn["shape"]
    bmap = rng.integers(0, drawn["levels"], shape, endpoint=True) / drawn["levels"]
    bmap *= rng.random(shape) < drawn["walls"]
    wanted = rng.random(shape) < drawn["wanted"]
    xy = rng.normal(0, drawn["reach"] / 2, (drawn["points"], 2))
    return bmap.astype(np.float32), wanted, xy, uniform_thetas(2 * np.pi / drawn["headings"])


def exhaustive(
    stack: Float32Array,
    wanted: BoolArray,
    thetas: FloatArray,
    count: int = 1,
    distance: float = 0.0,
    angle: float = 0.0,
    resolution: float = 1.0,
) -> Best:
    """The whole stack, sorted; then the separated ones."""
    flat = np.flatnonzero(np.where(wanted, stack, 0) > 0)
    flat = flat[np.argsort(-stack.ravel()[flat], kind="stable")]
    cells = np.stack(np.unravel_index(flat, stack.shape), axis=1)
    poses = np.column_stack((centre_of(cells[:, 1:], resolution), thetas[cells[:, 0]]))
    picked = separated(poses, count, distance=distance, angle=angle)[0]
    return Best(cells[picked], stack.ravel()[flat][picked])


def same(a: Best, b: Best) -> bool:
    return np.array_equal(a.cells, b.cells) and np.array_equal(a.scores, b.scores)


@settings(max_examples=300)
@given(DRAWN)
def test_argmax_is_that_of_the_stack(drawn: dict) -> None:
    bmap, wanted, xy, thetas = problem(drawn)
    stack = cbml(bmap, xy, thetas, 1.0, engine="shift")
    masked = np.where(wanted, stack, 0)
    pooled = pooled_maps(bmap, wanted, 1.0, top=drawn["top"], reach=drawn["prepared_reach"])
    best = best_poses(pooled, xy, thetas)
    assert len(best.cells) == (masked.max() > 0)
    if len(best.cells):
        assert tuple(best.cells[0]) == np.unravel_index(masked.argmax(), masked.shape)
        assert best.scores[0] == masked.max()


@settings(max_examples=100)
@given(DRAWN, st.integers(2, 12), st.floats(0.0, 12.0), st.floats(0.0, 4.0))
def test_separated_poses_are_those_of_the_stack(
    drawn: dict, count: int, distance: float, angle: float
) -> None:
    bmap, wanted, xy, thetas = problem(drawn)
    stack = cbml(bmap, xy, thetas, 1.0, engine="shift")
    pooled = pooled_maps(bmap, wanted, 1.0, top=drawn["top"], reach=drawn["prepared_reach"])
    best = best_poses(pooled, xy, thetas, count=count, distance=distance, angle=angle)
    assert same(best, exhaustive(stack, wanted, thetas, count, distance, angle))


@settings(max_examples=30)
@given(DRAWN)
def test_a_block_is_bounded_and_no_more_than_by_its_own_points(drawn: dict) -> None:
    bmap, wanted, xy, thetas = problem(drawn)
    pooled = pooled_maps(bmap, wanted, 1.0, top=drawn["top"], reach=drawn["prepared_reach"])
    if not wanted.any():
        return
    stack = np.rint(255 * np.where(wanted, cbml(bmap, xy, thetas, 1.0, engine="shift"), 0))
    side = 1 << pooled.top
    ends = [(0, 0), *((0, -n % side) for n in bmap.shape)]
    k, h, w = np.pad(stack, ends).shape
    best = np.pad(stack, ends).reshape(k, h // side, side, w // side, side).max(axis=(2, 4))
    top = _Bounds(pooled, xy, thetas).of_top(threads=1)
    assert (top >= best).all()
    assert (top[:, ~pooled.where[-1]] == 0).all()


def test_a_descent_ends_in_a_pose_of_each_block() -> None:
    rng = np.random.default_rng(5)
    bmap = rng.integers(0, 3, (13, 21)).astype(np.float32) / 2
    pooled = pooled_maps(bmap, np.ones(bmap.shape, bool), 1.0, top=2)
    xy, thetas = rng.normal(0, 3, (8, 2)), uniform_thetas(np.pi / 3)
    blocks = np.stack(np.unravel_index(np.arange(6 * 4 * 6), (6, 4, 6)), axis=1)
    bounds = _Bounds(pooled, xy, thetas)
    bounds.of_top(threads=1)
    poses, scores = bounds.descend(blocks)
    assert sorted((poses // (1, 4, 4)).tolist()) == blocks.tolist()
    stack = cbml(bmap, xy, thetas, 1.0, engine="shift")
    np.testing.assert_array_equal(scores, np.rint(255 * stack[tuple(poses.T)]))


def test_first_of_equal_poses_in_index_order() -> None:
    bmap = np.ones((40, 50), dtype=np.float32)
    wanted = np.ones((40, 50), dtype=bool)
    wanted[:7] = wanted[:, :9] = False
    xy = np.array([[2.0, 0.0], [0.0, 1.0]])
    best = best_poses(pooled_maps(bmap, wanted, 1.0, top=3), xy, uniform_thetas(np.pi / 2), count=1)
    assert best.cells.tolist() == [[0, 7, 9]]
    assert best.scores.tolist() == [2.0]


def test_count_beyond_what_fits_returns_all_that_fit() -> None:
    bmap = np.ones((6, 6), dtype=np.float32)
    pooled = pooled_maps(bmap, np.ones((6, 6), bool), 1.0, top=2)
    best = best_poses(pooled, np.zeros((1, 2)), np.zeros(1), count=99, distance=3.5, angle=1.0)
    assert best.cells[:, 1:].tolist() == [[0, 0], [0, 4], [3, 2], [5, 5]]


def test_more_readings_than_sixteen_bits_hold() -> None:
    bmap = np.zeros((9, 9), dtype=np.float32)
    bmap[4, 6] = 1
    xy = np.tile([[2.0, 0.0]], (2000, 1))
    best = best_poses(pooled_maps(bmap, np.ones((9, 9), bool), 1.0, top=2), xy, np.zeros(1))
    assert best.cells.tolist() == [[0, 4, 4]]
    assert best.scores.tolist() == [2000.0]


def test_nothing_to_find() -> None:
    bmap, wanted = np.zeros((5, 5), np.float32), np.ones((5, 5), bool)
    xy, thetas = np.array([[1.0, 0.0]]), np.zeros(1)
    wall = np.ones((5, 5), np.float32)
    for image, where, points in (
        (bmap, wanted, xy),
        (wall, ~wanted, xy),
        (wall, wanted, np.full((3, 2), np.nan)),
        (wall, wanted, np.array([[1e9, 0.0]])),
    ):
        best = best_poses(pooled_maps(image, where, 1.0, top=2), points, thetas, count=3)
        assert best.cells.shape == (0, 3)
        assert best.scores.shape == (0,)


def test_a_lost_reading_does_not_count() -> None:
    bmap = np.eye(6, dtype=np.float32)
    pooled = pooled_maps(bmap, np.ones((6, 6), bool), 1.0, top=1)
    xy = np.array([[1.0, 0.0], [0.0, 1.0]])
    with_nan = np.insert(xy, 1, np.nan, axis=0)
    thetas = uniform_thetas(1.0)
    assert same(best_poses(pooled, xy, thetas), best_poses(pooled, with_nan, thetas))


def test_threads_do_not_matter() -> None:
    rng = np.random.default_rng(3)
    bmap = (rng.random((60, 70)) * (rng.random((60, 70)) < 0.1)).astype(np.float32)
    pooled = pooled_maps(bmap, np.ones((60, 70), bool), 0.1, top=3)
    xy, thetas = rng.normal(0, 1.5, (50, 2)), uniform_thetas(0.1)
    options = {"count": 7, "distance": 0.5, "angle": 0.3}
    one = best_poses(pooled, xy, thetas, threads=1, **options)
    assert same(one, best_poses(pooled, xy, thetas, threads=3, **options))


@pytest.mark.parametrize("size", [(3, 200), (200, 3)])
def test_long_narrow_maps(size: tuple[int, int]) -> None:
    rng = np.random.default_rng(1)
    bmap = (rng.random(size) * (rng.random(size) < 0.3)).astype(np.float32)
    xy, thetas = rng.normal(0, 30, (30, 2)), uniform_thetas(0.5)
    wanted = np.ones(size, bool)
    best = best_poses(pooled_maps(bmap, wanted, 1.0, top=4), xy, thetas)
    assert same(best, exhaustive(cbml(bmap, xy, thetas, 1.0), wanted, thetas))


def test_office(shared: Path) -> None:
    features = MapFeatures(load_map(shared / "problem/mapA.yaml"))
    scans = load_scans(shared / "problem/scans_10m.npz").scans
    pooled = pooled_maps(features.bmap, features.free, 0.1)
    thetas = uniform_thetas(np.deg2rad(6.0))
    for scan in scans[:3]:
        r, a = scan.ranges[scan.valid], scan.angles[scan.valid]
        xy = np.column_stack((r * np.cos(a), r * np.sin(a)))
        stack = cbml(features.bmap, xy, thetas, 0.1, where=features.free)
        best = best_poses(pooled, xy, thetas, count=5, distance=0.5, angle=0.3)
        # Poses that score less than half the best one are not among the five.
        stack = np.where(stack > stack.max() / 2, stack, 0)
        expected = exhaustive(stack, features.free, thetas, 5, 0.5, 0.3, 0.1)
        assert same(best, expected)


@pytest.mark.parametrize(
    "wrong",
    [{"count": 0}, {"distance": -1.0}, {"angle": np.nan}, {"threads": 0}],
)
def test_options_out_of_range(wrong: dict) -> None:
    pooled = pooled_maps(np.ones((3, 3), np.float32), np.ones((3, 3), bool), 1.0, top=1)
    with pytest.raises(ConfigError, match=next(iter(wrong))):
        best_poses(pooled, np.zeros((1, 2)), np.zeros(1), **wrong)


@pytest.mark.parametrize("wrong", [{"top": 0}, {"top": 13}, {"reach": -1.0}, {"resolution": 0.0}])
def test_pooling_options_out_of_range(wrong: dict) -> None:
    arguments = {"resolution": 1.0, **wrong}
    with pytest.raises(ConfigError, match=next(iter(wrong))):
        pooled_maps(np.ones((3, 3), np.float32), np.ones((3, 3), bool), **arguments)


def test_pooling_refuses_other_arrays() -> None:
    good = np.ones((3, 3), np.float32)
    with pytest.raises(ValueError, match="where"):
        pooled_maps(good, np.ones((3, 4), bool), 1.0)
    with pytest.raises(ValueError, match="where"):
        pooled_maps(good, np.ones((3, 3), np.uint8), 1.0)
    with pytest.raises(ValueError, match=r"0\.\.1"):
        pooled_maps(good * 2, np.ones((3, 3), bool), 1.0)
    with pytest.raises(ValueError, match=r"0\.\.1"):
        pooled_maps(good * np.nan, np.ones((3, 3), bool), 1.0)


def test_after_its_time_the_search_says_what_it_knows(monkeypatch):
    features, scan = features_of("curved"), scan_of("curved")
    late = localize(features, scan, Options(exact=True, time_budget=1e-9))
    assert not late.complete
    assert late.verdict != "unique"
    asked = []

    def noted(*given, **more):
        asked.append(more)
        return best_poses(*given, **more)

    monkeypatch.setattr(stacked, "best_poses", noted)
    assert len(localize(features, scan, Options(exact=True, time_budget=1e-9)).hypotheses)
    assert asked == []  # what takes a second is not begun
    assert localize(features, scan, Options(exact=True, time_budget=60.0)).complete
    assert asked[0]["deadline"] < np.inf
    pooled, xy, thetas = features.pooled, scan_xy(scan)[scan.valid], uniform_thetas(0.1)
    assert len(best_poses(pooled, xy, thetas, deadline=time.monotonic()).scores) == 0
    later = best_poses(pooled, xy, thetas, deadline=time.monotonic() + 60)
    np.testing.assert_array_equal(later.cells, best_poses(pooled, xy, thetas).cells)
