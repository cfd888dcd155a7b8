"""The default search: its parts, what it returns, and that its answer moves with the world."""

import dataclasses
from functools import cache

import cv2
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from imgloc import FusedOptions, LaserScan, MapFeatures, OccupancyGrid, Options, Pose2D
from imgloc.features.raycast import cast_rays
from imgloc.features.scanpoints import Readings, one_per_place, scan_xy
from imgloc.geometry import cell_of, inside, transform_poses, wrap
from imgloc.pipeline import find_modes, propose
from imgloc.search.modes import separate
from imgloc.search.rescore import Scores, score_poses, score_things, shortlist
from imgloc.simulation.scans import sample_free_poses, simulate_ranges
from imgloc.simulation.worlds import WORLDS, render

INF, NAN = float("inf"), float("nan")
OPTIONS = FusedOptions()
ANGLES = np.deg2rad(np.arange(-180, 180, 3.0))
seeds = st.integers(0, 2**32 - 1)


@cache
def world(name="curved"):
    return render(WORLDS[name](), 0.1)


@cache
def features_of(name="curved"):
    return MapFeatures(world(name))


@cache
def truth(name="curved"):
    return render(WORLDS[name](), 0.02)


def scan_at(pose, name="curved", angles=ANGLES, seed=0):
    ranges = simulate_ranges(truth(name), [pose], angles, seed=seed, range_max=30.0)[0]
    return LaserScan(ranges, angles, range_max=30.0)


def moved(grid, change):
    """Map with its images changed."""
    occupied, free = (np.ascontiguousarray(change(a)) for a in (grid.occupied, grid.free))
    return OccupancyGrid(occupied, free, grid.resolution)


def clear_answer(features, scan):
    """The best pose, where it is much better than the second."""
    found = find_modes(features, scan, Options())
    score = found.scores.log_likelihood
    assume(len(score) == 1 or score[0] - score[1] > 20)
    return found.poses[0]


def assert_close(pose, other, metres=0.1, degrees=1.5):
    assert np.hypot(*(pose[:2] - other[:2])) < metres
    assert abs(wrap(pose[2] - other[2])) < np.deg2rad(degrees)


def poses_of(seed, n=1):
    return sample_free_poses(world(), n, seed, clearance=0.4)


# --- parts


def test_endpoints_of_readings_and_the_origin_for_what_is_none():
    scan = LaserScan([2.0, 3.0, NAN, INF, 9.0], [0, np.pi / 2, 0, 0, 0], range_max=8.0)
    np.testing.assert_allclose(scan_xy(scan), [[2, 0], [0, 3], [0, 0], [0, 0], [0, 0]], atol=1e-12)


@pytest.mark.parametrize(("screen", "x"), [(False, 2.05), (True, 1.9)])
def test_a_mode_is_at_the_mean_of_its_maxima_unless_that_is_in_a_wall(screen, x):
    wall = np.pad(np.zeros((36, 36), bool), 2, constant_values=True)
    wall[10:30, 20] |= screen  # from x = 2.0 m to 2.1 m
    features = MapFeatures(OccupancyGrid(wall, ~wall, 0.1))
    poses = np.array([[1.9, 2.0, 0.2], [2.2, 2.0, 0.2], [3.5, 1.0, 0.0]])
    score, pieces = np.array([-50.0, -50.0, -90.0]), [np.zeros((3, 1), bool)] * 4
    scores = Scores(score, score, 0 * score, *pieces, np.ones((3, 4), bool), np.eye(3, 4) > 0)
    mean, best, spread = separate(features, poses, scores, 4, Options())
    np.testing.assert_allclose(mean, [[x, 2.0, 0.2], [3.5, 1.0, 0.0]], atol=1e-12)
    np.testing.assert_array_equal(best.log_likelihood, [-50.0, -90.0])
    np.testing.assert_array_equal(best.crossed, scores.crossed[[0, 2]])
    second = ((1.9 - x) ** 2 + (2.2 - x) ** 2) / 2  # moment around where the mode is
    np.testing.assert_allclose(spread[0], np.diag([second, 0, 0]), atol=1e-12)
    np.testing.assert_allclose(spread[1], np.zeros((3, 3)), atol=1e-12)


# --- the search


def test_parts_propose_only_where_the_whole_scan_does_not_fit(monkeypatch):
    asked = []

    def counted(features, few, *rest):
        asked.append(len(few))
        return propose(features, few, *rest)

    monkeypatch.setattr("imgloc.pipeline.propose", counted)
    features, scan = MapFeatures(world()), scan_at((6.0, 5.0, 1.0))
    found = find_modes(features, scan, Options())
    assert_close(found.poses[0], (6.0, 5.0, 1.0))
    assert len(asked) == 1
    # Readings of nowhere: half of them stop short, at random.
    short = np.random.default_rng(3).uniform(0.2, 1.0, len(ANGLES)) ** 2
    find_modes(features, dataclasses.replace(scan, ranges=scan.ranges * short), Options())
    few, third = Options().fused.few_rays, 38  # of 115 places
    assert asked[1:] == [few, third, few, few]


@given(seeds)
@settings(max_examples=4)
def test_the_true_pose_is_found(seed):
    (pose,) = poses_of(seed)
    found = clear_answer(features_of(), scan_at(pose))
    assert_close(found, pose)


@pytest.mark.parametrize("name", ["curved", "corridor"])
def test_what_is_returned(name):
    features = features_of(name)
    pose = (6.0, 5.0, 1.0)
    scan = scan_at(pose, name, angles=ANGLES[::2])
    found = find_modes(features, scan, Options())
    poses, evidence = found.poses, found.scores
    assert len(poses) == len(evidence.log_likelihood) == len(evidence.on_surface) > 0
    # Scored with the rays it names, best first.
    assert len(found.readings) == min(OPTIONS.rays, len(one_per_place(scan, OPTIONS.place)))
    assert evidence.on_surface.shape == evidence.crossed.shape == (len(poses), len(found.readings))
    again = score_poses(features, found.readings, poses, OPTIONS.model)
    # Of the best maximum of each mode; the pose is the mean of them.
    less = np.abs(evidence.log_likelihood - again.log_likelihood) / len(found.readings)
    assert less.max() < 0.15
    assert np.all(np.diff(evidence.things) <= 0)
    # Where a robot can be, and none of them another one's neighbour.
    cells = cell_of(poses[:, :2], features.grid.resolution)
    assert inside(cells, features.grid.info).all()
    assert features.standable[tuple(cells.T)].all()
    assert not features.grid.occupied[tuple(cells.T)].any()
    distance, angle = OPTIONS.separation
    for i, a in enumerate(poses):
        gap = np.hypot(*(poses[i + 1 :, :2] - a[:2]).T)
        turn = np.abs(wrap(poses[i + 1 :, 2] - a[2]))
        assert not ((gap < distance) & (turn < angle)).any()


@given(seeds, st.integers(1, 3))
@settings(max_examples=2)
def test_a_turned_map_turns_the_answer(seed, turns):
    scan = scan_at(poses_of(seed)[0])
    pose = clear_answer(features_of(), scan)
    grid = world()
    # Rows go up, so that a clockwise turn of the array is a counter-clockwise one of the plane.
    turned = MapFeatures(moved(grid, lambda a: np.rot90(a, -turns)))
    height, width = np.array(grid.occupied.shape) * grid.resolution
    corner = {1: (height, 0.0), 2: (width, height), 3: (0.0, width)}[turns]
    (expected,) = transform_poses(Pose2D(*corner, turns * np.pi / 2), pose[None])
    assert_close(clear_answer(turned, scan), expected)


@given(seeds)
@settings(max_examples=2)
def test_a_mirrored_world_has_the_mirrored_answer(seed):
    scan = scan_at(poses_of(seed)[0])
    x, y, theta = clear_answer(features_of(), scan)
    grid = world()
    mirrored = MapFeatures(moved(grid, lambda a: a[::-1]))
    across = LaserScan(scan.ranges, -scan.angles, range_max=30.0)
    height = grid.occupied.shape[0] * grid.resolution
    assert_close(clear_answer(mirrored, across), np.array([x, height - y, -theta]))


@given(seeds, st.integers(0, 13), st.integers(0, 13))
@settings(max_examples=2)
def test_unknown_land_around_the_map_shifts_the_answer(seed, left, below):
    scan = scan_at(poses_of(seed)[0])
    pose = clear_answer(features_of(), scan)
    wider = MapFeatures(moved(world(), lambda a: np.pad(a, ((below, 3), (left, 5)))))
    assert_close(clear_answer(wider, scan), pose + np.array([left, below, 0]) * 0.1)


@given(seeds, st.floats(-np.pi, np.pi))
@settings(max_examples=2)
def test_a_sensor_mounted_askew_is_a_turned_pose(seed, turn):
    pose = poses_of(seed)[0]
    scan = scan_at(pose)
    askew = LaserScan(scan.ranges, scan.angles - turn, range_max=30.0)
    here, there = clear_answer(features_of(), scan), clear_answer(features_of(), askew)
    assert_close(there, here + (0, 0, turn))


@given(seeds)
@settings(max_examples=2)
def test_the_order_of_the_readings_is_of_no_importance(seed):
    scan = scan_at(poses_of(seed)[0])
    order = np.random.default_rng(seed).permutation(len(scan.ranges))
    shuffled = LaserScan(scan.ranges[order], scan.angles[order], range_max=30.0)
    # Other rays are left out: the pose may settle a little beside the other one.
    one, other = clear_answer(features_of(), shuffled), clear_answer(features_of(), scan)
    assert_close(one, other, metres=0.15, degrees=2.5)


@given(seeds)
@settings(max_examples=3)
def test_lost_readings_are_no_evidence(seed):
    pose = poses_of(seed)[0]
    scan = scan_at(pose)
    ranges = scan.ranges.copy()
    ranges[::4] = NAN
    ranges[1::8] = -INF
    ranges[5::8] = 30.0
    found = clear_answer(features_of(), LaserScan(ranges, scan.angles, range_max=30.0))
    assert_close(found, pose, metres=0.15, degrees=2)


def test_people_in_front_of_the_walls_do_not_move_the_answer():
    pose = np.array([6.0, 9.0, 0.5])
    ranges = simulate_ranges(truth(), [pose], ANGLES, seed=4, range_max=30.0, outliers=0.25)[0]
    found = find_modes(features_of(), LaserScan(ranges, ANGLES, range_max=30.0), Options())
    assert_close(found.poses[0], pose)


def test_no_pose_stands_where_nobody_has_been():
    wall = np.pad(np.zeros((30, 40), bool), 2, constant_values=True)
    wall[2:12, 20:23] = True
    # The same room again, of which only the walls are known and what lies right before them.
    seen = cv2.dilate(wall.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    free = np.concatenate((~wall, ~wall & seen), axis=1)
    features = MapFeatures(OccupancyGrid(np.concatenate((wall, wall), axis=1), free, 0.1))
    pose, width = np.array([1.25, 2.35, 1.0]), wall.shape[1] * 0.1
    ranges = cast_rays(features.walls, pose[:2], pose[2] + ANGLES, 20.0, 0.1)
    scan = LaserScan(ranges, ANGLES, range_max=20.0)
    found = find_modes(features, scan, Options())
    assert_close(found.poses[0], pose)
    assert np.hypot(*(found.poses[:, :2] - pose[:2] - (width, 0)).T).min() > 0.5


def test_a_scan_that_fits_nowhere_on_the_map_finds_nothing():
    scan = LaserScan(np.full(len(ANGLES), 300.0), ANGLES)
    found = find_modes(features_of(), scan, Options())
    assert found.poses.shape == (0, 3)
    assert found.scores.log_likelihood.shape == (0,)


def test_twins_get_one_second_look():
    # As many looks as twins are left unrecognised: all of them go to the best place.
    features, scan = features_of("corridor"), scan_at((6.0, 5.0, 1.0), "corridor")
    few = dataclasses.replace(OPTIONS, second_look=4, closer=0)
    all_looks, one_look = (
        find_modes(features, scan, Options(fused=dataclasses.replace(few, twins=twins)))
        for twins in ((1e-9, 1e-9), (0.1, 0.05))
    )
    assert 1 <= len(all_looks.poses) < len(one_look.poses) <= 4
    assert_close(one_look.poses[0], all_looks.poses[0])


def test_two_layers_of_a_wall_have_a_maximum_each():
    # One place, but 5 cm apart: both are looked at closer, and the better one is the answer.
    features, scan = features_of("curved"), scan_at((6.0, 5.0, 1.0), "curved")
    poses = np.array([[6.0, 5.0, 1.0], [6.05, 5.0, 1.0], [6.051, 5.0, 1.0], [3.0, 5.0, 1.0]])
    readings = Readings(scan.ranges[scan.valid][::3], scan.angles[scan.valid][::3])
    for closer, expected in ((0, 2), (40, 3)):
        options = Options(fused=dataclasses.replace(OPTIONS, closer=closer))
        kept, score = shortlist(poses, readings, features, options)
        assert len(kept) == expected
        again = score_things(features, readings, kept, options.model)
        np.testing.assert_array_equal(score, again)
        assert score[0] == score.max()
