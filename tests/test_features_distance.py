"""Signed distance: against loops over all cells, exact along straight walls, off the map."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from skimage.morphology import thin

from imgloc.features.distance import (
    FARTHEST,
    SLOPE,
    UNIT,
    distance_field,
    distance_image,
    peeled,
    signed_distance,
    straight_share,
)

seeds = st.integers(0, 2**32 - 1)


def naive(occupied, resolution):
    """From each centre to the nearest centre of the other kind, less half a cell.

    Around the map lies a ring of cells without a wall.
    """
    padded = np.pad(occupied, 1)
    out = np.empty(occupied.shape)
    for row in range(occupied.shape[0]):
        for column in range(occupied.shape[1]):
            here, best = occupied[row, column], math.inf
            for r in range(padded.shape[0]):
                for c in range(padded.shape[1]):
                    if padded[r, c] != here:
                        best = min(best, math.hypot(r - 1 - row, c - 1 - column) - 0.5)
            d = min(best * resolution, FARTHEST)
            out[row, column] = -d if here else d
    return out


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (7, 1), (6, 9), (9, 8)])
@pytest.mark.parametrize("share", [0.05, 0.4, 1.0])
def test_signed_distance_equals_the_loops(shape, share):
    occupied = np.random.default_rng(len(shape)).random(shape) < share
    occupied.flat[0] = True
    for resolution in (0.05, 1.0):
        got = signed_distance(occupied, resolution)
        assert got.dtype == np.float32
        np.testing.assert_allclose(got, naive(occupied, resolution), rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("degrees", [10.0, 26.6, 45.0])
def test_a_slanted_wall_is_where_it_was_drawn_and_not_where_its_steps_are(degrees):
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    y, x = np.indices((120, 120)) - 59.5
    near, away, steps = [], [], []
    for shift in np.linspace(-0.5, 0.5, 7):
        drawn = c * x + s * y + shift  # cells; the wall is where it is negative
        got = signed_distance(drawn < 0, 0.1) / 0.1
        middle = np.hypot(x, y) < 40
        near.append((got - drawn)[middle & (np.abs(drawn) < 1)].mean())
        off = middle & (drawn > 6) & (drawn < 8)
        away.append((got - drawn)[off].mean())
        walls = np.argwhere((drawn < 0) & (drawn > -3))
        gap = np.maximum(np.abs(np.argwhere(off)[:, None] - walls) - 0.5, 0)  # to the squares
        steps.append((np.hypot(gap[..., 0], gap[..., 1]).min(axis=1) - drawn[off]).mean())
    assert abs(np.mean(near)) < 0.05
    assert -0.32 < np.mean(away) < -0.12
    assert np.mean(steps) < np.mean(away) - 0.05


def test_far_away_is_cut_and_a_map_without_walls_is_far_everywhere():
    wall = np.zeros((3, 60), bool)
    wall[:, 0] = True
    got = signed_distance(wall, 0.1)
    assert got.max() == FARTHEST
    assert got[1, 39] == pytest.approx(3.85)
    assert got[1, 45] == FARTHEST
    assert np.all(signed_distance(np.zeros((2, 3), bool), 0.1) == FARTHEST)


@pytest.mark.parametrize("side", ["left", "right", "down", "up"])
@given(data=st.data())
@settings(max_examples=40)
def test_lookups_are_exact_along_a_straight_wall(side, data):
    resolution = data.draw(st.sampled_from([0.05, 0.1, 1.0]))
    n, thick = 24, 5
    wall = np.zeros((n, n), bool)
    wall[:, :thick] = True
    far = min(n - 1.01, FARTHEST / resolution + thick - 1.01)
    across = data.draw(st.floats(1, far)) * resolution
    along = data.draw(st.floats(6, n - 6)) * resolution
    # Its surface is at x = 5 cells; turn wall and point so that it faces any of four ways.
    expected, slope = across - thick * resolution, (1.0, 0.0)
    x, y, size = across, along, n * resolution
    if side == "right":
        wall, x, slope = wall[:, ::-1], size - x, (-1.0, 0.0)
    elif side == "down":
        wall, x, y, slope = wall.T, y, x, (0.0, 1.0)
    elif side == "up":
        wall, x, y, slope = wall.T[::-1], y, size - x, (0.0, -1.0)
    distance, gx, gy = distance_field(np.ascontiguousarray(wall), resolution).lookup(x, y)
    if across > 3.01 * resolution:  # deeper in, the other side of the wall is as near
        assert distance == pytest.approx(expected, abs=2e-5)
        assert (gx, gy) == pytest.approx(slope, abs=1e-5)
    else:
        assert distance < 0


@pytest.mark.parametrize("turns", range(4))
def test_the_slope_at_the_edge_of_the_map_is_one(turns):
    wall = np.zeros((9, 9), bool)
    wall[:, :3] = True  # rows go up: a turn of the array by -90 degrees is one of the plane by 90
    field = distance_field(np.ascontiguousarray(np.rot90(wall, -turns)), 1.0)
    c, s = round(math.cos(turns * math.pi / 2)), round(math.sin(turns * math.pi / 2))
    x, y = 4.25, 0.0  # from the middle of the map: in its last column, off the centre
    distance, gx, gy = field.lookup(4.5 + c * x - s * y, 4.5 + s * x + c * y)
    assert distance == pytest.approx(min(5.75, FARTHEST))
    assert (gx, gy) == pytest.approx((0, 0))  # cut at FARTHEST
    field = distance_field(np.ascontiguousarray(np.rot90(wall[:, 1:6], -turns)), 0.5)
    h, w = (9, 5) if turns % 2 == 0 else (5, 9)
    x, y = 1.125, 0.3
    distance, gx, gy = field.lookup(w / 4 + c * x - s * y, h / 4 + s * x + c * y)
    assert distance == pytest.approx(1.25 + 1.125 - 1.0)
    assert (gx, gy) == pytest.approx((c, s))


def test_a_map_of_one_row_has_no_slope_across():
    field = distance_field(np.array([[True, False, False]]), 1.0)
    assert field.table[:-1, 2].tolist() == [0, 0, 0]
    assert field.table[2, 1] * SLOPE == pytest.approx(1)


def test_thin_walls_are_inside_on_both_sides():
    wall = np.zeros((5, 9), bool)
    wall[:, 4] = True
    x = np.array([3.0, 3.75, 4.5, 5.25, 6.0])
    distance, gx, _ = distance_field(wall, 1.0).lookup(x, np.full(5, 2.5))
    assert (distance < 0).tolist() == [False, False, True, False, False]
    assert gx[2] == 0  # its middle is as near to one side as to the other
    assert gx[1] < 0 < gx[3]


@pytest.mark.parametrize(
    ("x", "y"),
    [(-1e-4, 0.5), (0.5, -1e-4), (0.6, 0.5), (0.5, 0.4), (1e9, 0.0), (-1e9, -1e9), (0.0, 1e9)],
)
def test_off_the_map_is_far_and_flat(x, y):
    field = distance_field(np.ones((4, 6), bool), 0.1)
    assert [v.tolist() for v in field.lookup([x], [y])] == [[FARTHEST], [0], [0]]
    inside = field.lookup(0.599, 0.399)
    assert inside[0] < 0


@given(seeds, st.integers(1, 14), st.integers(1, 14))
@settings(max_examples=60)
def test_a_layer_is_peeled_as_scikit_image_does_it(seed, height, width):
    rng = np.random.default_rng(seed)
    walls = rng.random((height, width)) < rng.random()
    walls |= np.roll(walls, 1, axis=0) & (rng.random() < 0.5)  # thick ones, too
    np.testing.assert_array_equal(peeled(walls), thin(walls.copy(), max_num_iter=1))


@given(seeds, st.sampled_from([0.02, 0.3, 0.9]))
@settings(max_examples=20)
def test_distances_that_are_there_already_change_nothing(seed, share):
    walls = np.random.default_rng(seed).random((30, 40)) < share
    fresh, kept = (distance_field(walls, 0.1, given) for given in (None, distance_image(walls)))
    np.testing.assert_array_equal(fresh.table, kept.table)


def test_rows_of_the_table_are_the_cells_in_order():
    field = distance_field(np.eye(3, 4, dtype=bool), 0.5)
    x, y = np.array([0.25, 1.75, 0.25, 2.0]), np.array([0.25, 1.25, 0.75, 0.75])  # centres, off
    found = np.stack(field.lookup(x, y), axis=1) / [UNIT, SLOPE, SLOPE]
    np.testing.assert_allclose(found, field.table[[0, 11, 4, 12], :3], rtol=1e-6)
    assert [v.item() for v in field.lookup(np.nan, 1.0)[1:]] == [0, 0]
    assert field.table.shape == (13, 4)
    assert [v.item() for v in field.lookup(1e30, -1e30)] == [FARTHEST, 0, 0]
    exact = signed_distance(np.eye(3, 4, dtype=bool), 0.5)
    np.testing.assert_allclose(field.distance, exact, atol=UNIT / 2 + 1e-6)


@given(seeds)
@settings(max_examples=30)
def test_at_centres_the_lookup_is_the_image_and_no_slope_is_steeper_than_one(seed):
    rng = np.random.default_rng(seed)
    occupied = rng.random((7, 8)) < 0.25
    field = distance_field(occupied, 0.1)
    y, x = (np.indices((7, 8)) + 0.5) * 0.1
    distance, gx, gy = field.lookup(x, y)
    np.testing.assert_allclose(distance, signed_distance(occupied, 0.1), atol=UNIT)
    assert max(np.abs(gx).max(), np.abs(gy).max()) <= 1 + 1e-5


def test_lookups_keep_the_shape_and_nobody_changes_the_table():
    field = distance_field(np.eye(4, dtype=bool), 0.1)
    for out in field.lookup(np.zeros((2, 3)), np.zeros((2, 3))):
        assert out.shape == (2, 3)
        assert out.dtype == np.float32
    assert not field.table.flags.writeable


def straight_by_loops(occupied, run):
    long = length = 0
    for image in (occupied, occupied.T):
        image = np.pad(image, 1)
        for side in (-1, 1):
            for row in range(1, len(image) - 1):
                ends, run_so_far = [], 0
                for column in range(image.shape[1]):
                    if image[row, column] and not image[row + side, column]:
                        run_so_far += 1
                    else:
                        ends.append(run_so_far)
                        run_so_far = 0
                length += sum(ends)
                long += sum(one for one in ends if one >= run)
    return long / length if length else 0.0


@given(st.integers(0, 2**32 - 1), st.integers(1, 12), st.integers(1, 12), st.integers(1, 5))
def test_straight_borders_equal_the_loops(seed, height, width, run):
    occupied = np.random.default_rng(seed).random((height, width)) < 0.6
    assert straight_share(occupied, run) == straight_by_loops(occupied, run)
