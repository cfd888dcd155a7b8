"""The bundle of a map's features: what is computed, once, and refused."""

import dataclasses

import numpy as np
import pytest

from imgloc import ConfigError, MapFeatures, OccupancyGrid
from imgloc.features import mapfeatures
from imgloc.features.fields import bmap, vmap
from imgloc.features.raycast import cast_rays
from imgloc.features.raydistance import ray_distances
from imgloc.features.surface import surface_points
from imgloc.features.visibility import visibility_frames
from imgloc.simulation.worlds import WORLDS, render


@pytest.fixture
def features():
    occupied = np.ones((24, 30), bool)
    occupied[3:-3, 3:-3] = False
    return MapFeatures(
        OccupancyGrid(occupied, ~occupied, 0.1), sigma=0.15, n_psi=12, n_rays=8, max_range=7.0
    )


def test_features_are_those_of_the_functions(features):
    grid = features.grid
    surface = surface_points(grid.occupied, grid.free, 0.1)
    np.testing.assert_array_equal(features.surface.xy, surface.xy)
    np.testing.assert_array_equal(features.bmap, bmap(surface.xy, (24, 30), 0.1, 0.15))
    by_normals = dataclasses.replace(features, vmap_from="contours").vmap
    np.testing.assert_array_equal(by_normals, vmap(surface, (24, 30), 0.1, 0.15))
    np.testing.assert_array_equal(
        features.visibility, visibility_frames(grid.occupied, surface, 0.1, 12, 30.0)
    )
    np.testing.assert_array_equal(features.ray_distances, ray_distances(grid.occupied, 0.1, 8, 7.0))


def test_a_large_map_has_a_coarser_level(features, monkeypatch):
    assert [level.resolution for level in features.pyramid] == [0.1, 0.2, 0.4]
    monkeypatch.setattr(mapfeatures, "COARSE_CELLS", 40)  # 24 x 30 / 16 cells are more
    large = dataclasses.replace(features)
    assert [level.resolution for level in large.pyramid] == [0.1, 0.2, 0.4, 0.8]
    assert large.pyramid[3].image.shape == (3, 4)


@pytest.mark.parametrize("name", ["surface", "bmap", "vmap", "visibility", "ray_distances"])
def test_each_is_computed_once_and_read_only(features, name):
    value = getattr(features, name)
    assert getattr(features, name) is value
    array = value.xy if name == "surface" else value
    assert not array.flags.writeable


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("cell", 0.0),
        ("sigma", -1.0),
        ("sigma_endpoint", np.nan),
        ("horizon", np.inf),
        ("max_range", 700.0),
        ("n_psi", 0),
        ("n_rays", -3),
        ("memory_budget", 0),
        ("threads", 0),
        ("vmap_from", "scan"),
        ("visibility_by", "eye"),
    ],
)
def test_values_out_of_their_range_are_refused(features, name, value):
    with pytest.raises(ConfigError, match=f"^MapFeatures.{name}: got {value!r}, expected"):
        dataclasses.replace(features, **{name: value})


def test_too_large_a_stack_is_refused_with_its_size(features):
    small = dataclasses.replace(features, memory_budget=24 * 30 * 8 * 2 - 1)
    with pytest.raises(ConfigError, match="8 directions x 24 x 30 cells"):
        _ = small.ray_distances
    assert dataclasses.replace(features, memory_budget=24 * 30 * 8 * 2).ray_distances.shape[0] == 8


def test_thinner_walls_are_prepared_ahead_on_small_maps_alone(monkeypatch) -> None:
    walls = np.zeros((30, 40), bool)
    walls[5:9] = True
    grid = OccupancyGrid(walls, ~walls, 0.1)
    assert set(MapFeatures(grid).ready(2)._thinner) == {1, 2}
    monkeypatch.setattr("imgloc.features.mapfeatures.AHEAD_CELLS", walls.size - 1)
    assert not MapFeatures(grid).ready(2)._thinner


def test_rays_on_a_very_large_map_go_by_bytes(monkeypatch):
    grid = render(WORLDS["curved"](), 0.02)  # whole steps of more than a band, more than a byte
    small = MapFeatures(grid)
    monkeypatch.setattr("imgloc.features.mapfeatures.PEELED_CELLS", grid.occupied.size - 1)
    large = MapFeatures(grid)
    assert large.walls.dtype == np.uint8
    np.testing.assert_array_equal(large.walls, np.minimum(np.floor(small.walls), 255))
    np.testing.assert_array_equal(large.field.table, small.field.table)
    rng = np.random.default_rng(0)
    start = rng.uniform(0, grid.occupied.shape[0] * 0.02, (20_000, 2))
    psi = rng.uniform(-np.pi, np.pi, len(start))
    seen = [cast_rays(f.walls, start, psi, 30.0, 0.02) for f in (small, large)]
    assert np.isfinite(seen[0]).sum() > 1000
    assert np.mean(np.abs(np.nan_to_num(seen[0]) - np.nan_to_num(seen[1])) > 1e-5) < 1e-3  # corners
