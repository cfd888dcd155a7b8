"""The vector field of CBML-O from the image: that of the loops, and that of the walls."""

import naive
import numpy as np
import pytest

from imgloc import ConfigError, MapFeatures, OccupancyGrid
from imgloc.features.fields import vmap
from imgloc.features.gradients import vmap_of_image
from imgloc.features.surface import surface_points
from imgloc.geometry import wrap


def angle_of(field):
    return np.arctan2(field[1], field[0])


def slab(angle, thickness, size=80):
    """A wall through the centre of the image, its normal at `angle`, and distances from it."""
    y, x = np.mgrid[:size, :size] + 0.5 - size / 2
    across = x * np.cos(angle) + y * np.sin(angle)
    return np.abs(across) < thickness / 2, across


@pytest.mark.parametrize(("sigma", "factor"), [(0.1, 1), (0.25, 1), (0.2, 2), (0.3, 3)])
def test_the_field_is_that_of_the_loops(sigma, factor):
    rng = np.random.default_rng(factor)
    occupied = rng.random((13, 16)) < 0.25
    free = ~occupied & (rng.random((13, 16)) < 0.8)
    ours = vmap_of_image(occupied, free, 0.1, sigma, factor=factor)
    theirs = naive.vmap_of_image(occupied, free, 0.1, sigma, factor)
    assert ours.shape == theirs.shape
    assert ours.dtype == np.float32
    np.testing.assert_allclose(ours, theirs, atol=2e-4)
    assert np.hypot(*ours).max() == pytest.approx(1)


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_a_quarter_turn_of_the_map_turns_the_field(turns):
    occupied = np.zeros((24, 24), bool)
    occupied[5:8, 4:20] = occupied[5:19, 4:7] = True
    field = vmap_of_image(occupied, ~occupied, 0.1, 0.15)
    turned = np.rot90(occupied, turns, axes=(1, 0))
    other = vmap_of_image(turned, ~turned, 0.1, 0.15)
    for _ in range(turns):
        x, y = (np.rot90(part, 1, axes=(1, 0)) for part in field)
        field = np.stack((-y, x))
    np.testing.assert_allclose(other, field, atol=2e-5)


@pytest.mark.parametrize("thickness", [2.5, 8.0])
@pytest.mark.parametrize("degrees", [45, 3, 17, 30, 62, 104, -71, 165])
def test_the_direction_of_oblique_walls(degrees, thickness):
    angle = np.deg2rad(degrees)
    occupied, across = slab(angle, thickness)
    field = vmap_of_image(occupied, ~occupied, 0.05, 0.1)
    inner = np.zeros_like(occupied)
    inner[15:-15, 15:-15] = True
    for side, normal in ((across, angle), (-across, angle + np.pi)):
        near = inner & (side > thickness / 2 - 0.3) & (side < thickness / 2 + 1.5)
        off = np.rad2deg(wrap(angle_of(field)[near] - normal))
        assert np.abs(off).max() < 8
        assert np.median(np.abs(off)) < 3  # at 3 degrees the steps are wide
        assert abs(off.mean()) < 1.6  # of the differences that Sobel takes


def test_no_normals_towards_unknown_space_or_off_the_map():
    occupied = np.zeros((20, 20), bool)
    occupied[:, :4] = True
    occupied[:, 12:15] = True
    free = np.zeros_like(occupied)
    free[:, 4:12] = True  # behind the wall on the right is unknown
    x, _ = vmap_of_image(occupied, free, 0.1, 0.1)
    assert (x[:, 4] > 0.5).all()
    assert (x[:, 11] < -0.5).all()
    assert np.abs(x[:, 15:]).max() < 0.05
    assert np.abs(x[:, 0]).max() < 0.05


def test_it_agrees_with_the_field_of_the_contours():
    y, x = np.mgrid[:100, :100] + 0.5
    occupied = (np.hypot(x - 50, y - 50) > 40) | (np.hypot(x - 60, y - 45) < 9)
    surface = surface_points(occupied, ~occupied, 0.05)
    ours = vmap_of_image(occupied, ~occupied, 0.05, 0.1, factor=2)
    theirs = vmap(surface, (50, 50), 0.1, 0.1)
    strong = (np.hypot(*ours) > 0.2) & (np.hypot(*theirs) > 0.2)
    assert strong.sum() > 100
    off = np.abs(wrap(angle_of(ours) - angle_of(theirs)))[strong]
    assert np.rad2deg(np.median(off)) < 2
    assert np.corrcoef(ours.ravel(), theirs.ravel())[0, 1] > 0.95


def test_features_take_it_from_either():
    occupied = np.zeros((40, 60), bool)
    occupied[:3] = occupied[-3:] = True
    grid = OccupancyGrid(occupied, ~occupied, 0.05)
    image, contours = (MapFeatures(grid, vmap_from=source) for source in ("image", "contours"))
    np.testing.assert_array_equal(
        image.vmap, vmap_of_image(occupied, ~occupied, 0.05, 0.1, factor=2)
    )
    assert image.vmap.shape == contours.vmap.shape
    assert (image.vmap != contours.vmap).any()
    assert not image.vmap.flags.writeable


def test_without_walls_there_is_no_field():
    nothing = np.zeros((5, 6), bool)
    assert not vmap_of_image(nothing, ~nothing, 0.1, 0.1).any()


@pytest.mark.parametrize(("resolution", "sigma"), [(0.0, 0.1), (0.1, 0.0), (0.1, np.nan)])
def test_wrong_parameters(resolution, sigma):
    with pytest.raises(ConfigError, match="must be positive and finite"):
        vmap_of_image(np.eye(3, dtype=bool), ~np.eye(3, dtype=bool), resolution, sigma)
