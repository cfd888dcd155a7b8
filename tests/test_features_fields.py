"""The blurred maps of CBML and CBML-O."""

import numpy as np
import pytest

from imgloc import ConfigError, OrientedPoints
from imgloc.features.fields import bmap, vmap


def points(xy, alpha, valid=None):
    n = len(xy)
    return OrientedPoints(xy, alpha, np.full(n, 0.1), np.ones(n) if valid is None else valid)


def test_bmap_is_the_gaussian_of_the_cells_that_hold_points():
    field = bmap(np.array([[0.55, 0.35]]), (7, 11), 0.1, 0.1)
    assert field.dtype == np.float32
    assert field.shape == (7, 11)
    assert np.unravel_index(field.argmax(), field.shape) == (3, 5)  # row from y, column from x
    assert field.max() == 1.0
    # One cell is one sigma: exp(-1/2), exp(-1), exp(-2).
    np.testing.assert_allclose(
        [field[3, 6], field[4, 6], field[3, 7], field[1, 5]], np.exp([-0.5, -1, -2, -2]), rtol=1e-3
    )


def test_several_points_in_a_cell_count_once():
    one = bmap(np.array([[0.55, 0.35], [0.15, 0.35]]), (7, 11), 0.1, 0.1)
    crowd = bmap(np.array([[0.55, 0.35]] * 9 + [[0.15, 0.35]]), (7, 11), 0.1, 0.1)
    np.testing.assert_array_equal(one, crowd)


def test_cells_hold_their_lower_border():
    field = bmap(np.array([[0.5, 0.25]]), (4, 4), 0.25, 0.25)
    assert np.unravel_index(field.argmax(), field.shape) == (1, 2)


def test_points_off_the_grid_are_left_out_not_clamped():
    inside = np.array([[0.25, 0.25]])
    outside = np.array([[-0.01, 0.25], [0.25, -0.01], [0.5, 0.25], [0.25, 0.5]])
    alone = bmap(inside, (5, 5), 0.1, 0.05)
    np.testing.assert_array_equal(bmap(np.vstack((inside, outside)), (5, 5), 0.1, 0.05), alone)
    surface = points(np.vstack((inside, outside)), [0.0, 1, 2, 3, 4])
    np.testing.assert_array_equal(
        vmap(surface, (5, 5), 0.1, 0.05), vmap(points(inside, [0.0]), (5, 5), 0.1, 0.05)
    )


def test_nothing_is_mirrored_in_at_the_border():
    edge = bmap(np.array([[0.05, 0.25]]), (5, 9), 0.1, 0.1)
    middle = bmap(np.array([[0.45, 0.25]]), (5, 9), 0.1, 0.1)
    np.testing.assert_allclose(edge[:, :5], middle[:, 4:], atol=1e-6)


@pytest.mark.parametrize("alpha", [0.0, 1.0, np.pi / 2, -2.5])
def test_vmap_has_the_direction_of_the_normal(alpha):
    field = vmap(points([[0.55, 0.35]], [alpha]), (7, 11), 0.1, 0.1)
    assert field.shape == (2, 7, 11)
    assert field.dtype == np.float32
    np.testing.assert_allclose(field[:, 3, 5], [np.cos(alpha), np.sin(alpha)], atol=1e-6)
    np.testing.assert_allclose(
        field[:, 3, 6],
        np.exp(-0.5) * np.array([np.cos(alpha), np.sin(alpha)]),
        rtol=1e-3,
        atol=1e-6,
    )


def test_opposite_walls_cancel_where_bmap_merges_them():
    # Fig. 4: two walls two cells apart.
    xy = np.array([[0.35, 0.35], [0.55, 0.35]])
    flat = bmap(xy, (7, 9), 0.1, 0.15)
    field = vmap(points(xy, [np.pi, 0.0]), (7, 9), 0.1, 0.15)
    assert flat[3, 4] == flat.max()  # a false maximum between them
    np.testing.assert_allclose(field[:, 3, 4], 0, atol=1e-6)
    assert field[0, 3, 2] < -0.5
    assert field[0, 3, 6] > 0.5


def test_normals_in_one_cell_sum_to_no_more_than_one():
    xy = [[0.25, 0.25], [0.26, 0.25], [0.24, 0.25], [0.85, 0.25]]
    field = vmap(points(xy, [0.0, 0.0, 0.0, np.pi]), (5, 11), 0.1, 0.05)
    np.testing.assert_allclose(field[0, 2, 2], 1, atol=1e-6)
    np.testing.assert_allclose(field[0, 2, 8], -1, atol=1e-6)


def test_points_without_a_normal_are_not_in_vmap_but_in_bmap():
    surface = points([[0.25, 0.25], [0.75, 0.25]], [np.nan, 0.0], [False, True])
    field = vmap(surface, (5, 10), 0.1, 0.05)
    assert np.isfinite(field).all()
    assert np.abs(field[:, :, :4]).max() < 1e-3
    assert bmap(surface.xy, (5, 10), 0.1, 0.05)[2, 2] == pytest.approx(1.0)


def test_no_points_give_no_field():
    assert not bmap(np.zeros((0, 2)), (4, 5), 0.1, 0.1).any()
    assert not vmap(points(np.zeros((0, 2)), []), (4, 5), 0.1, 0.1).any()


@pytest.mark.parametrize("sigma", [0.0, -1.0, float("nan"), float("inf"), 1e6])
def test_sigma_out_of_range(sigma):
    with pytest.raises(ConfigError, match="sigma"):
        bmap(np.zeros((1, 2)), (4, 5), 0.1, sigma)
    with pytest.raises(ConfigError, match="sigma"):
        vmap(points([[0.1, 0.1]], [0.0]), (4, 5), 0.1, sigma)


@pytest.mark.parametrize(("shape", "resolution"), [((0, 5), 0.1), ((4, 5), 0.0)])
def test_shape_and_resolution_out_of_range(shape, resolution):
    with pytest.raises(ConfigError, match=r"shape|resolution"):
        bmap(np.zeros((1, 2)), shape, resolution, 0.1)
