"""Gauss-Newton on the signed distance: the linear algebra, and where it converges."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imgloc.features.distance import distance_field
from imgloc.geometry import transform_points, wrap
from imgloc.model import Pose2D, compose, inverse
from imgloc.search.refine import endpoints, normal_equations, refine

RESOLUTION = 0.1
WIDTH, HEIGHT = 6.0, 4.0  # of the room, whose lower-left inner corner is at (1, 1)


def room():
    wall = np.ones((60, 80), bool)
    wall[10:50, 10:70] = False
    return wall


FIELD = distance_field(room(), RESOLUTION)


def seen_from(pose, n=90):
    """Points (n, 2) on the walls of the room, in the frame of a sensor at `pose`: exact."""
    s = (np.arange(n) + 0.37) / n * 2 * (WIDTH + HEIGHT)
    x = np.clip(s, 0, WIDTH) - np.clip(s - WIDTH - HEIGHT, 0, WIDTH)
    y = np.clip(s - WIDTH, 0, HEIGHT) - np.clip(s - 2 * WIDTH - HEIGHT, 0, HEIGHT)
    return transform_points(inverse(pose), np.column_stack((x + 1, y + 1)))


def row(pose):
    return np.array([[pose.x, pose.y, pose.theta]])


in_room = st.builds(Pose2D, st.floats(1.5, 6.5), st.floats(1.5, 4.5), st.floats(-np.pi, np.pi))
seeds = st.integers(0, 2**32 - 1)


def random_case(seed, c=4, n=7):
    rng = np.random.default_rng(seed)
    occupied = rng.random((30, 40)) < 0.05
    poses = np.column_stack((rng.uniform(0, 4, c), rng.uniform(0, 3, c), rng.uniform(-7, 7, c)))
    return distance_field(occupied, RESOLUTION), poses, rng.uniform(-2, 2, (n, 2))


@given(seeds)
@settings(max_examples=30)
def test_endpoints_are_the_transformed_points(seed):
    field, poses, xy = random_case(seed)
    dx, dy, distance, gx, gy = endpoints(poses, xy, field)
    for i, pose in enumerate(poses):
        at = transform_points(Pose2D(*pose), xy)
        np.testing.assert_allclose(np.column_stack((dx[i], dy[i])) + pose[:2], at, atol=1e-5)
        # The same lookups, unless rounding puts a point into the next cell.
        off = at / RESOLUTION - np.rint(at / RESOLUTION)
        clear = (np.abs(off) > 1e-3).all(axis=1)
        for got, expected in zip((distance[i], gx[i], gy[i]), field.lookup(*at.T), strict=True):
            np.testing.assert_allclose(got[clear], expected[clear], atol=1e-4)


@given(seeds, st.sampled_from([0.05, 0.3]))
@settings(max_examples=30)
def test_normal_equations_equal_the_loops(seed, sigma):
    field, poses, xy = random_case(seed)
    (A,), (b,), square = normal_equations(poses, xy, field, sigma)
    dx, dy, distance, gx, gy = (v.astype(float) for v in endpoints(poses, xy, field))
    for i in range(len(poses)):
        JtJ, Jte, total, weights = np.zeros((3, 3)), np.zeros(3), 0.0, 0.0
        for k in range(len(xy)):
            weight = 1 / (1 + (distance[i, k] / sigma) ** 2) ** 2  # Geman-McClure
            turned = gx[i, k] * -dy[i, k] + gy[i, k] * dx[i, k]  # d(R p)/dtheta = R (-p_y, p_x)
            J = np.array([gx[i, k], gy[i, k], turned])
            JtJ += weight * np.outer(J, J)
            Jte += weight * J * distance[i, k]
            total += weight * distance[i, k] ** 2
            weights += weight
        np.testing.assert_allclose(A[i], JtJ, rtol=1e-4, atol=1e-4)
        np.testing.assert_allclose(b[i], Jte, rtol=1e-4, atol=1e-4)
        assert square[i] == pytest.approx(total / weights, rel=1e-3, abs=1e-8)


def test_normal_equations_of_blocks_are_those_of_their_readings():
    field, poses, xy = random_case(3, n=11)
    A, b, square = normal_equations(poses, xy, field, 0.3, 3)
    assert len(A) == len(b) == 3
    for k, block in enumerate((xy[:4], xy[4:7], xy[7:])):
        (alone,), (rest,), _ = normal_equations(poses, block, field, 0.3)
        np.testing.assert_allclose(A[k], alone, rtol=1e-5, atol=1e-5)
        np.testing.assert_allclose(b[k], rest, rtol=1e-5, atol=1e-5)
    np.testing.assert_array_equal(square, normal_equations(poses, xy, field, 0.3)[2])
    assert len(normal_equations(poses, xy[:2], field, 0.3, 3)[0]) == 2


@pytest.mark.parametrize("axis", [0, 1, 2])
@given(seed=seeds)
@settings(max_examples=20)
def test_the_jacobian_is_the_slope_of_the_distance(axis, seed):
    field, poses, xy = random_case(seed, c=1, n=25)
    h = 1e-3
    step = np.zeros(3)
    step[axis] = h
    dx, dy, _, gx, gy = endpoints(poses, xy, field)
    J = (gx, gy, dx * gy - dy * gx)[axis][0]
    before, after = (transform_points(Pose2D(*(poses + s)[0]), xy) for s in (-step, step))
    same = (np.floor(before / RESOLUTION) == np.floor(after / RESOLUTION)).all(axis=1)
    slope = (endpoints(poses + step, xy, field)[2] - endpoints(poses - step, xy, field)[2])[0]
    np.testing.assert_allclose(slope[same] / (2 * h), J[same], atol=0.02)


@given(in_room, st.floats(-0.15, 0.15), st.floats(-0.15, 0.15), st.floats(-5, 5), st.integers(0, 2))
@settings(max_examples=40)
def test_a_pose_that_is_off_finds_its_place(pose, dx, dy, degrees, turns):
    start = row(pose) + (dx, dy, np.deg2rad(degrees) + 2 * np.pi * turns)
    ((x, y, theta),) = refine(start, seen_from(pose), FIELD, sigmas=(0.3, 0.2, 0.1, 0.05))
    # To the surface itself: half a cell of bias would be 5 cm.
    assert np.hypot(x - pose.x, y - pose.y) < 0.01
    assert abs(wrap(theta - pose.theta)) < np.deg2rad(0.2)
    assert -np.pi <= theta <= np.pi


@given(in_room)
@settings(max_examples=20)
def test_the_true_pose_stays_where_it_is(pose):
    ((x, y, theta),) = refine(row(pose), seen_from(pose), FIELD, sigmas=(0.1, 0.05))
    assert np.hypot(x - pose.x, y - pose.y) < 0.005
    assert abs(wrap(theta - pose.theta)) < np.deg2rad(0.1)


def test_points_of_something_else_have_no_say():
    pose = Pose2D(3.0, 2.5, 0.4)
    xy = seen_from(pose)
    xy[::5] *= 0.5  # people
    ((x, y, theta),) = refine(row(pose) + (0.1, -0.1, 0.05), xy, FIELD, sigmas=(0.3, 0.1, 0.05))
    assert np.hypot(x - pose.x, y - pose.y) < 0.01
    assert abs(theta - pose.theta) < np.deg2rad(0.2)


def test_a_corridor_leaves_a_pose_where_it_is_along_it():
    wall = np.zeros((30, 300), bool)
    wall[[5, 24]] = True
    pose = Pose2D(15.0, 1.4, 0.0)
    s = np.linspace(-4, 4, 40)
    xy = np.concatenate((np.column_stack((s, 0 * s + 1.0)), np.column_stack((s, 0 * s - 0.8))))
    start = row(pose) + (0.3, 0.1, 0.03)
    ((x, y, theta),) = refine(start, xy, distance_field(wall, RESOLUTION), sigmas=(0.3, 0.1))
    assert x == pytest.approx(15.3, abs=1e-3)
    assert y == pytest.approx(1.4, abs=5e-3)
    assert theta == pytest.approx(0, abs=2e-3)


@given(seeds, st.integers(1, 4))
@settings(max_examples=30)
def test_a_step_is_short(seed, steps):
    field, poses, xy = random_case(seed, c=9)
    moved = refine(poses, xy, field, sigmas=(0.5,), iterations=steps)
    assert np.abs(moved[:, :2] - poses[:, :2]).max() <= 0.1 * steps + 1e-12
    assert np.abs(wrap(moved[:, 2] - poses[:, 2])).max() <= np.deg2rad(2) * steps + 1e-12


@given(seeds)
@settings(max_examples=20)
def test_poses_do_not_know_of_each_other_and_points_have_no_order(seed):
    field, poses, xy = random_case(seed)
    together = refine(poses, xy, field, sigmas=(0.3,), iterations=1)
    for i in range(len(poses)):
        alone = refine(poses[i : i + 1], xy[::-1], field, sigmas=(0.3,), iterations=1)
        np.testing.assert_allclose(alone[0], together[i], atol=1e-3)


@given(in_room, st.integers(0, 9), st.integers(0, 9))
@settings(max_examples=20)
def test_moving_the_corner_of_the_map_moves_the_pose(pose, left, below):
    field = distance_field(np.pad(room(), ((below, 0), (left, 0)), mode="edge"), RESOLUTION)
    start, shift = row(pose) + (0.1, -0.05, 0.02), np.array([left, below, 0]) * RESOLUTION
    xy = seen_from(pose)
    here = refine(start, xy, FIELD, sigmas=(0.2, 0.1))
    there = refine(start + shift, xy, field, sigmas=(0.2, 0.1))
    np.testing.assert_allclose(there, here + shift, atol=2e-3)


@given(in_room)
@settings(max_examples=20)
def test_a_quarter_turn_of_the_map_turns_the_pose(pose):
    turned = distance_field(np.ascontiguousarray(np.rot90(room(), -1)), RESOLUTION)
    # Rows go up: this turns the plane counter-clockwise, about its corner, then back into x > 0.
    frame = Pose2D(6.0, 0.0, np.pi / 2)
    xy = seen_from(pose)
    off = compose(pose, Pose2D(0.1, -0.05, 0.03))
    ((x, y, theta),) = refine(row(compose(frame, off)), xy, turned, sigmas=(0.2, 0.1))
    here = compose(frame, Pose2D(*refine(row(off), xy, FIELD, sigmas=(0.2, 0.1))[0]))
    assert (x, y) == pytest.approx((here.x, here.y), abs=5e-3)
    assert abs(wrap(theta - here.theta)) < 2e-3


def test_nothing_to_do():
    poses, xy = np.array([[1.0, 2.0, 4.0]]), np.array([[1.0, 0.0]])
    assert refine(np.empty((0, 3)), xy, FIELD, sigmas=(0.1,)).shape == (0, 3)
    got = refine(poses, np.empty((0, 2)), FIELD, sigmas=(0.1,))
    np.testing.assert_array_equal(got[:, :2], poses[:, :2])
    np.testing.assert_array_equal(refine(poses, xy, FIELD, sigmas=())[:, :2], poses[:, :2])


def test_the_callers_poses_are_not_moved():
    poses = row(Pose2D(3.1, 2.4, 0.1))
    before = poses.copy()
    assert not np.allclose(refine(poses, seen_from(Pose2D(3, 2.5, 0)), FIELD, sigmas=(0.3,)), poses)
    np.testing.assert_array_equal(poses, before)
