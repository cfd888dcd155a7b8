"""SE(2) and cells: group laws, sign conventions, half-open cells, the circle's seam."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgloc.geometry import (
    cell_of,
    centre_of,
    inside,
    rotate_covariance,
    theta_bin,
    transform_poses,
    uniform_thetas,
    wrap,
)
from imgloc.model import GridInfo, Pose2D, compose, inverse

coordinates = st.floats(-50, 50)
angles = st.floats(-12.5, 12.5)
poses = st.builds(Pose2D, coordinates, coordinates, angles)


def matrix(pose):
    """Homogeneous matrix: the textbook definition that everything here must follow."""
    c, s = np.cos(pose.theta), np.sin(pose.theta)
    return np.array([[c, -s, pose.x], [s, c, pose.y], [0, 0, 1]])


@pytest.mark.parametrize(
    ("angle", "expected"),
    [
        (0.0, 0.0),
        (np.pi, np.pi),
        (-np.pi, np.pi),
        (3 * np.pi, np.pi),
        (np.pi + 0.25, -np.pi + 0.25),
        (-np.pi - 0.25, np.pi - 0.25),
        (2 * np.pi, 0.0),
        (-0.5, -0.5),
    ],
)
def test_wrap_to_the_half_open_circle(angle, expected):
    assert wrap(angle) == pytest.approx(expected, abs=1e-12)
    assert Pose2D(0, 0, angle).theta == pytest.approx(expected, abs=1e-12)


@given(st.floats(-1e4, 1e4))
def test_wrapping_keeps_the_direction(angle):
    w = float(wrap(angle))
    assert -np.pi <= w <= np.pi
    assert np.cos(w) == pytest.approx(np.cos(angle), abs=1e-9)
    assert np.sin(w) == pytest.approx(np.sin(angle), abs=1e-9)


def test_wrap_keeps_the_shape():
    assert wrap(np.zeros((2, 3))).shape == (2, 3)
    assert np.isnan(wrap([np.nan])).all()


@given(st.floats(0.005, 10))
def test_the_step_is_never_larger_than_asked_for(step):
    thetas = uniform_thetas(step)
    actual = 2 * np.pi / len(thetas)
    assert thetas[0] == 0
    assert len(thetas) == 1 or actual <= step * (1 + 1e-8)
    assert len(thetas) == 1 or 2 * np.pi / (len(thetas) - 1) > step * (1 - 1e-8)  # no finer
    np.testing.assert_allclose(np.diff(thetas), actual, rtol=1e-9)


@given(st.integers(1, 400), st.integers(-3, 3))
def test_theta_bin_is_the_inverse_of_uniform_thetas(n, turns):
    thetas = uniform_thetas(2 * np.pi / n) + turns * 2 * np.pi
    assert len(thetas) == n
    np.testing.assert_array_equal(theta_bin(thetas, n), np.arange(n))


@given(st.floats(-30, 30), st.integers(1, 64))
def test_theta_bin_is_the_nearest_heading_on_the_circle(theta, n):
    gap = np.abs(wrap(uniform_thetas(2 * np.pi / n) - theta))
    assert gap[theta_bin(theta, n)] <= gap.min() + 1e-9


@given(poses, poses)
def test_compose_is_the_product_of_matrices(a, b):
    np.testing.assert_allclose(matrix(compose(a, b)), matrix(a) @ matrix(b), atol=1e-9)


@given(poses)
def test_inverse_undoes_from_both_sides(a):
    for identity in (compose(a, inverse(a)), compose(inverse(a), a)):
        np.testing.assert_allclose(matrix(identity), np.eye(3), atol=1e-9)


@given(poses, st.lists(st.tuples(coordinates, coordinates, angles), max_size=4))
def test_transform_poses_composes_each_row_and_comes_back(frame, rows):
    rows = np.array(rows, dtype=float).reshape(-1, 3)
    out = transform_poses(frame, rows)
    assert out.shape == rows.shape
    for row, got in zip(rows, out, strict=True):
        np.testing.assert_allclose(
            matrix(Pose2D(*got)), matrix(compose(frame, Pose2D(*row))), atol=1e-9
        )
    back = transform_poses(inverse(frame), out)
    np.testing.assert_allclose(back[:, :2], rows[:, :2], atol=1e-9)
    np.testing.assert_allclose(wrap(back[:, 2] - rows[:, 2]), 0, atol=1e-9)


@given(poses, st.integers(0, 2**32 - 1))
def test_covariance_is_that_of_the_transformed_samples(frame, seed):
    samples = np.random.default_rng(seed).normal(size=(20, 3)) * (0.5, 0.2, 0.1)
    moved = transform_poses(frame, samples)
    moved[:, 2] = samples[:, 2] + frame.theta  # without the seam
    expected = np.cov(moved.T)
    np.testing.assert_allclose(
        rotate_covariance(np.cov(samples.T), frame.theta), expected, atol=1e-9
    )


def test_cells_are_half_open_and_rows_go_with_y():
    xy = [[0.0, 0.0], [0.49, 0.0], [0.5, 0.0], [0.0, 0.5], [1.2, 0.6]]
    assert cell_of(np.array(xy), 0.5).tolist() == [[0, 0], [0, 0], [0, 1], [1, 0], [1, 2]]


def test_cells_off_the_grid_are_outside_and_not_clamped():
    xy = np.array([[-0.001, 0.0], [0.0, -0.001], [9.0, 1.0], [1.0, 9.0]])
    cells = cell_of(xy, 1.0)
    assert cells.tolist() == [[0, -1], [-1, 0], [1, 9], [9, 1]]
    assert not inside(cells, GridInfo(4, 5, 1.0)).any()


def test_inside_ends_with_the_last_row_and_column():
    cells = np.array([[0, 0], [3, 4], [4, 4], [3, 5], [-1, 0], [0, -1]])
    on = inside(cells, GridInfo(height=4, width=5, resolution=0.1))
    assert on.tolist() == [True, True, False, False, False, False]


@given(
    st.lists(st.tuples(st.integers(-99, 999), st.integers(-99, 999)), min_size=1, max_size=5),
    st.sampled_from([0.025, 0.05, 0.1, 1.0, 0.0504]),
)
def test_the_centre_of_a_cell_lies_in_it(cells, resolution):
    cells = np.array(cells)
    centres = centre_of(cells, resolution)
    np.testing.assert_allclose(centres[:, 0], (cells[:, 1] + 0.5) * resolution)
    np.testing.assert_array_equal(cell_of(centres, resolution), cells)


def test_cells_and_centres_keep_leading_axes():
    cells = np.arange(12).reshape(2, 3, 2)
    assert centre_of(cells, 0.1).shape == (2, 3, 2)
    np.testing.assert_array_equal(cell_of(centre_of(cells, 0.1), 0.1), cells)
