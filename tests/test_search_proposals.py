"""Proposals by endpoint correlation against the exhaustive correlation, loop by loop."""

import dataclasses
import itertools
import tracemalloc
from functools import partial

import naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from places import features_of, scan_of

from imgloc.features.distance import signed_distance
from imgloc.features.pyramid import Level, pyramid
from imgloc.features.scanpoints import one_per_place
from imgloc.geometry import cell_of, theta_bin, uniform_thetas
from imgloc.model import Pose2D
from imgloc.search import proposals
from imgloc.search.proposals import propose_endpoints

RESOLUTION = 0.1
STEP = np.deg2rad(30)
ALL = (1 << 30,) * 3
BLOCK = proposals._BLOCK  # cells and headings a side, of which one is proposed
seeds = st.integers(0, 2**32 - 1)


def levels_of(occupied, free=None, sigma=0.6, levels=3):
    free = ~occupied if free is None else free
    distance = signed_distance(occupied, RESOLUTION)
    return pyramid(distance, free, RESOLUTION, cell=RESOLUTION, sigma=sigma, levels=levels)


def random_case(seed, shape=(13, 18), n=6, margin=20, sigma=0.6):
    rng = np.random.default_rng(seed)
    occupied = rng.random(shape) < 0.08
    occupied.flat[0] = True
    free = ~occupied & (rng.random(shape) < 0.6)
    levels = levels_of(np.pad(occupied, margin), np.pad(free, margin), sigma)
    return levels, rng.uniform(-1, 1, (n, 2))


def exhaustive(level, xy, thetas):
    """Mean of the finest image under the points for every pose: Alg. 1; -1 where none may be."""
    out = np.full((len(thetas), *level.image.shape), -1.0)
    for k, theta in enumerate(thetas):
        for row, column in np.argwhere(level.free):
            x, y = naive.centre(row, column, level.resolution)
            at = [naive.oplus(p, x, y, theta) for p in xy]
            fit = [naive.value(level.image, p, level.resolution) for p in at]
            out[k, row, column] = np.mean(fit) / 255
    return out


def nodes_of(poses, thetas):
    return np.column_stack((theta_bin(poses[:, 2], len(thetas)), cell_of(poses[:, :2], RESOLUTION)))


def score(level, xy, theta, row, column):
    """Sum of the image under the points at a pose, Alg. 1."""
    x, y = naive.centre(row, column, level.resolution)
    at = [naive.oplus(p, x, y, theta) for p in xy]
    return sum(naive.value(level.image, p, level.resolution) for p in at)


def rough(level, n):
    """The level in as many grey levels as let a byte hold the sum of n points, if not too few."""
    top, most = 255 // n, level.image.max()
    if top < 6 or top >= most:
        return level
    image = np.rint(level.image * np.float32(top / most)).astype(np.uint8)
    return dataclasses.replace(level, image=image)


def by_score_and_parent(entry):
    value, (k, row, column) = entry
    return -value, (k, row // 2, column // 2), (row, column)


def naive_propose(levels, xy, thetas, keep):
    """Coarse to fine with plain lists; ties in the order of their parents' indices."""
    n, coarsest = len(thetas), rough(levels[-1], len(xy))
    ranked = []
    for k in range(0, n, 3):
        for row, column in np.ndindex(coarsest.free.shape):
            value = score(coarsest, xy, thetas[k], row, column)
            if coarsest.free[row, column]:
                ranked.append((value, (k, row, column)))
    ranked = sorted(ranked, key=lambda entry: -entry[0])[: keep[-1]]
    spread = (-1, 0, 1)
    for level, count in zip(levels[-2::-1], keep[-2::-1], strict=True):
        met = {}
        for _, (k, row, column) in ranked:
            for dk, dr, dc in itertools.product(spread, (0, 1), (0, 1)):
                child = ((k + dk) % n, 2 * row + dr, 2 * column + dc)
                on = child[1] < level.free.shape[0] and child[2] < level.free.shape[1]
                if on and level.free[child[1:]] and child not in met:
                    met[child] = score(level, xy, thetas[child[0]], *child[1:])
        ranked = sorted(((v, c) for c, v in met.items()), key=by_score_and_parent)[:count]
        spread = (0,)
    out = {}
    for value, node in ranked:
        out.setdefault(tuple(i // BLOCK for i in node), (node, value))
    return [(node, value) for node, value in out.values() if value > 0]


@given(
    seeds,
    st.tuples(*[st.integers(1, 40)] * 3),
    st.sampled_from([30, 45, 72]),
    st.sampled_from([(0.6, 6), (0.02, 1)]),  # the second: most poses meet nothing at all
)
@settings(max_examples=12)
def test_coarse_to_fine_equals_the_loops(seed, keep, step, fit):
    levels, xy = random_case(seed, sigma=fit[0], n=fit[1], margin=0)
    thetas = uniform_thetas(np.deg2rad({45: 40, 72: 60}.get(step, step)))
    poses, scores = propose_endpoints(levels, xy, theta_step=np.deg2rad(step), keep=keep)
    expected = naive_propose(levels, xy, thetas, keep)
    assert nodes_of(poses, thetas).tolist() == [list(node) for node, _ in expected]
    np.testing.assert_allclose(scores * 255 * len(xy), [value for _, value in expected])


@pytest.mark.parametrize("cells", [1, 100, 5000])
def test_the_exhaustive_level_may_be_cut_into_any_chunks(monkeypatch, cells):
    levels, xy = random_case(11)
    whole = propose_endpoints(levels, xy, theta_step=STEP, keep=(30, 50, 70))
    monkeypatch.setattr(proposals, "_CHUNK_CELLS", cells)
    cut = propose_endpoints(levels, xy, theta_step=STEP, keep=(30, 50, 70))
    for a, b in zip(whole, cut, strict=True):
        np.testing.assert_array_equal(a, b)


@given(seeds, st.sampled_from([0.05, 0.6]))
@settings(max_examples=6)
def test_with_all_kept_each_block_proposes_its_best_pose(seed, sigma):
    # A narrow fit and no land around: coarse poses that meet nothing have finer ones that do.
    levels, xy = random_case(seed, sigma=sigma, margin=0)
    poses, scores = propose_endpoints(levels, xy, theta_step=STEP, keep=ALL)
    thetas = uniform_thetas(STEP)
    expected = exhaustive(levels[0], xy, thetas)
    nodes = nodes_of(poses, thetas)
    np.testing.assert_allclose(scores, expected[tuple(nodes.T)], atol=1e-12)
    best = {}
    for node in np.ndindex(expected.shape):
        if expected[node] > 0:
            block = tuple(i // BLOCK for i in node)
            best[block] = max(best.get(block, 0), expected[node])
    got = {tuple(node // BLOCK): score for node, score in zip(nodes, scores, strict=True)}
    assert got == pytest.approx(best)
    assert len(got) == len(poses)  # one of each block
    assert scores[0] == pytest.approx(expected.max())  # the exhaustive argmax is the first


@given(seeds, st.tuples(*[st.integers(1, 60)] * 3), st.integers(1, 3))
@settings(max_examples=15)
def test_what_is_proposed_is_scored_truly_sorted_and_free(seed, keep, skip):
    levels, xy = random_case(seed)
    poses, scores = propose_endpoints(levels, xy, theta_step=STEP, keep=keep, skip=skip)
    assert 0 < len(poses) <= keep[0]
    assert np.all(np.diff(scores) <= 0)
    cells = cell_of(poses[:, :2], RESOLUTION)
    np.testing.assert_allclose(poses[:, 1::-1], (cells + 0.5) * RESOLUTION)  # cell centres
    assert levels[0].free[tuple(cells.T)].all()
    for (x, y, theta), score in zip(poses, scores, strict=True):
        at = [naive.oplus(p, x, y, theta) for p in xy]
        fit = [naive.value(levels[0].image, p, RESOLUTION) / 255 for p in at]
        assert score == pytest.approx(np.mean(fit))


@given(seeds)
@settings(max_examples=8)
def test_threads_and_the_order_of_points_change_nothing(seed):
    levels, xy = random_case(seed, shape=(40, 60))
    once = propose_endpoints(levels, xy, theta_step=STEP, keep=(40, 80, 80))
    for points, threads in ((xy, 2), (xy[::-1], 1), (xy, 3)):
        again = propose_endpoints(
            levels, points, theta_step=STEP, keep=(40, 80, 80), threads=threads
        )
        for a, b in zip(once, again, strict=True):
            np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize(("step", "n"), [(120, 3), (100, 6), (72, 6), (90, 6), (360, 3)])
def test_headings_are_a_multiple_of_three_and_no_farther_apart_than_asked(step, n):
    levels, xy = random_case(3)
    poses, _ = propose_endpoints(levels, xy, theta_step=np.deg2rad(step), keep=ALL)
    headings = poses[:, 2] * n / (2 * np.pi)
    np.testing.assert_allclose(headings, np.rint(headings), atol=1e-9)
    assert len(np.unique(np.rint(headings) % n)) <= n


@pytest.mark.parametrize("far", [1e4, 1e7, 1e39])
def test_an_absurd_reading_is_a_miss_like_any_other(far):
    levels, xy = random_case(6)
    poses, scores = propose_endpoints(levels, xy, theta_step=STEP, keep=(30, 60, 90))
    more = np.vstack((xy, np.array([[1, 0], [-0.6, 0.8], [0, -1]]) * far))
    poses_far, scores_far = propose_endpoints(levels, more, theta_step=STEP, keep=(30, 60, 90))
    np.testing.assert_array_equal(poses_far, poses)
    np.testing.assert_allclose(scores_far, scores * len(xy) / len(more))


@pytest.mark.parametrize("n_levels", [2, 3, 4])
def test_any_number_of_levels_from_two(n_levels):
    rng = np.random.default_rng(n_levels)
    occupied = rng.random((16, 20)) < 0.1
    levels, xy = levels_of(occupied, levels=n_levels), rng.uniform(-0.5, 0.5, (4, 2))
    keep = (1 << 30,) * n_levels
    _, scores = propose_endpoints(levels, xy, theta_step=STEP, keep=keep)
    assert scores[0] == pytest.approx(exhaustive(levels[0], xy, uniform_thetas(STEP)).max())


def test_nothing_to_propose():
    levels, xy = random_case(7)
    nowhere = levels_of(levels[0].image > 250, np.zeros(levels[0].image.shape, bool))
    cases = [(levels, np.empty((0, 2))), (nowhere, xy), (levels, xy + 50.0)]
    for (some, points), keep in itertools.product(cases, [ALL, (1, 1, 1)]):
        poses, scores = propose_endpoints(some, points, theta_step=STEP, keep=keep)
        assert poses.shape == (0, 3)
        assert scores.shape == (0,)


@pytest.mark.parametrize(("most", "points"), [(7, 32), (1, 10), (255, 43), (255, 400), (0, 9)])
def test_a_faint_image_and_many_points_stay_as_they_are(most, points):
    level = Level(np.array([[0, most]], np.uint8), np.ones((1, 2), bool), 0.8)
    assert proposals._rough(level, points) is level


def test_walls_that_are_faint_on_coarse_cells_propose():
    # At cells of a metre the finest image of a wall is 1 of 255 at most.
    rng = np.random.default_rng(12)
    occupied = rng.random((120, 120)) < 0.04
    levels = pyramid(signed_distance(occupied, 1.0), ~occupied, 1.0, cell=1.0, sigma=0.15, levels=3)
    assert levels[0].image.max() < 3
    pose = Pose2D(90.5, 78.5, 0.0)
    walls = (np.argwhere(occupied)[:, ::-1] + 0.5) - (pose.x, pose.y)
    xy = walls[np.hypot(*walls.T) < 20][:36]
    assert len(xy) == 36
    poses, _ = propose_endpoints(levels, xy, theta_step=STEP, keep=(200, 200, 200))
    near = np.hypot(poses[:, 0] - pose.x, poses[:, 1] - pose.y) < 2
    assert (near & (np.abs(poses[:, 2]) < STEP)).any()


def test_a_far_reading_pads_a_long_level_by_its_own_sides():
    level = Level(np.full((20, 4000), 9, np.uint8), np.ones((20, 4000), bool), 0.1)
    xy, thetas = np.array([[1e6, 0.0], [0.5, 0.5]]), uniform_thetas(np.pi)
    parents = np.array([[0, 3, 7], [1, 9, 1999]])
    tracemalloc.start()
    proposals._score(level, xy, thetas, parents)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 8 * 9 * level.image.size


def test_what_is_far_worse_than_the_best_is_not_proposed():
    features, scan = features_of("curved"), scan_of("curved")
    levels, xy = features.pyramid, one_per_place(scan, 0.07).spread(48).xy
    ask = partial(propose_endpoints, levels, xy, theta_step=np.deg2rad(1), keep=(3000, 8000, 8000))
    poses, scores = ask()
    few, best = ask(worse=0.1)
    n = max(100, np.count_nonzero(scores >= scores[0] - 0.1))
    assert 100 <= n < len(poses)
    np.testing.assert_array_equal(few, poses[:n])
    np.testing.assert_array_equal(best, scores[:n])
    assert len(ask(worse=0.0)[0]) == 100
