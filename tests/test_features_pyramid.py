"""Blocks of cells and the pyramid of endpoint images, against loops over cells."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imgloc.features.distance import signed_distance
from imgloc.features.pyramid import any_of_blocks, coarse_info, pyramid
from imgloc.geometry import cell_of
from imgloc.model import GridInfo, Pose2D

sizes = st.tuples(st.integers(1, 13), st.integers(1, 13))


def members(shape, factor, row, column):
    """Cells of a block that lie on the image."""
    return [
        (r, c)
        for r in range(row * factor, (row + 1) * factor)
        for c in range(column * factor, (column + 1) * factor)
        if r < shape[0] and c < shape[1]
    ]


@given(sizes, st.integers(1, 4), st.integers(0, 2**32 - 1))
def test_a_block_is_set_if_any_of_its_cells_is(shape, factor, seed):
    mask = np.random.default_rng(seed).random(shape) < 0.2
    got = any_of_blocks(mask, factor)
    assert got.dtype == bool
    for row, column in np.ndindex(got.shape):
        assert got[row, column] == any(mask[cell] for cell in members(shape, factor, row, column))


@given(sizes, st.integers(1, 5))
def test_the_coarse_lattice_has_the_same_corner_and_covers_the_map(shape, factor):
    fine = GridInfo(*shape, 0.05, Pose2D(1, 2, 0.3))
    coarse = coarse_info(fine, factor)
    assert coarse.shape == any_of_blocks(np.zeros(shape, bool), factor).shape
    assert coarse.origin == fine.origin
    assert coarse.resolution == pytest.approx(0.05 * factor)
    # The centre of every fine cell lies in its block.
    cells = np.stack(np.indices(shape), axis=-1)
    centres = (cells[..., ::-1] + 0.5) * fine.resolution
    np.testing.assert_array_equal(cell_of(centres, coarse.resolution), cells // factor)


def test_a_factor_of_one_leaves_the_image():
    image = np.arange(6).reshape(2, 3) % 2 > 0
    np.testing.assert_array_equal(any_of_blocks(image, 1), image)


def levels_of(shape=(9, 14), resolution=0.05, cell=0.05, sigma=0.1, levels=3, seed=0):
    rng = np.random.default_rng(seed)
    occupied = rng.random(shape) < 0.08
    free = ~occupied & (rng.random(shape) < 0.3)
    distance = signed_distance(occupied, resolution)
    out = pyramid(distance, free, resolution, cell=cell, sigma=sigma, levels=levels)
    return distance, free, out


@pytest.mark.parametrize(("cell", "factor"), [(0.05, 1), (0.1, 2), (0.12, 2), (0.15, 3), (0.01, 1)])
def test_the_finest_level_averages_the_fit_over_its_cells(cell, factor):
    distance, free, (level, *_) = levels_of(cell=cell)
    assert level.resolution == pytest.approx(0.05 * factor)
    assert level.image.dtype == np.uint8
    for row, column in np.ndindex(level.image.shape):
        cells = members(distance.shape, factor, row, column)
        fit = sum(math.exp(-(distance[cell] ** 2) / (2 * 0.1**2)) for cell in cells) / factor**2
        assert level.image[row, column] == pytest.approx(255 * fit, abs=0.51)
        assert level.free[row, column] == any(free[cell] for cell in cells)


@pytest.mark.parametrize("shape", [(9, 14), (8, 8), (1, 5), (7, 2)])
def test_each_further_level_keeps_the_best_of_four(shape):
    _, _, levels = levels_of(shape, levels=4)
    assert len(levels) == 4
    for fine, coarse in itertools.pairwise(levels):
        assert coarse.resolution == pytest.approx(2 * fine.resolution)
        assert coarse.image.shape == tuple(math.ceil(n / 2) for n in fine.image.shape)
        for row, column in np.ndindex(coarse.image.shape):
            cells = members(fine.image.shape, 2, row, column)
            assert coarse.image[row, column] == max(fine.image[cell] for cell in cells)
            assert coarse.free[row, column] == any(fine.free[cell] for cell in cells)


def test_both_sides_of_a_surface_fit_alike():
    # The centres of the two cells at a border are half a cell from it, one inside the wall.
    wall = np.zeros((3, 12), bool)
    wall[:, 6:] = True
    row = pyramid(signed_distance(wall, 0.1), ~wall, 0.1, cell=0.1, sigma=0.1, levels=1)[0].image[1]
    assert row[5] == row[6] == row.max()
    assert row[0] < row[3] < row[5]
    assert row[6] > row[7]  # deep in a wall an endpoint fits no better than in front of it


def test_one_level():
    assert len(levels_of(levels=1)[2]) == 1
