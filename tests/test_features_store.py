"""Features as arrays and back: the same features, or none that do not fit."""

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imgloc import MapFeatures, OccupancyGrid, Pose2D
from imgloc.features.store import (
    KEPT,
    features_from_arrays,
    features_key,
    features_to_arrays,
    load_features,
    save_features,
)
from imgloc.io.cache import entry_path, store_entry

PARAMETERS = {"n_psi": 24, "horizon": 5.0, "max_range": 5.0}


@pytest.fixture(scope="module")
def grid() -> OccupancyGrid:
    walls = np.zeros((45, 61), dtype=bool)
    walls[[0, -1]] = walls[:, [0, -1]] = True
    walls[10:14, 20:50] = True
    return OccupancyGrid(walls, ~walls, 0.05)


@pytest.fixture(scope="module")
def arrays(grid: OccupancyGrid) -> dict:
    features = MapFeatures(grid, **PARAMETERS)
    _ = [getattr(features, name) for name in KEPT]
    return features_to_arrays(features)


def leaves(value: object) -> list[np.ndarray]:
    """All arrays in a feature."""
    if isinstance(value, np.ndarray):
        return [value]
    if isinstance(value, dict):
        return leaves(tuple(value.values()))
    if isinstance(value, tuple):
        return [array for part in value for array in leaves(part)]
    if hasattr(value, "__dataclass_fields__"):
        return [
            array for name in value.__dataclass_fields__ for array in leaves(getattr(value, name))
        ]
    return [np.array(value)]


def test_every_feature_comes_back(grid: OccupancyGrid, arrays: dict) -> None:
    fresh = MapFeatures(grid, **PARAMETERS)
    back = features_from_arrays(grid, arrays, PARAMETERS)
    for name in KEPT:
        assert name in vars(back)  # nothing is computed
        for a, b in zip(leaves(getattr(fresh, name)), leaves(getattr(back, name)), strict=True):
            np.testing.assert_array_equal(a, b)
            assert a.dtype == b.dtype
            assert b.ndim == 0 or not b.flags.writeable
    for name in ("bmap", "free", "standable"):
        np.testing.assert_array_equal(getattr(fresh, name), getattr(back, name))


def test_by_default_what_has_been_computed(grid: OccupancyGrid) -> None:
    features = MapFeatures(grid, **PARAMETERS)
    assert features_to_arrays(features) == {}
    _ = features.walls, features.bmap  # bmap needs the surface
    assert {name.split(".")[0] for name in features_to_arrays(features)} == {"walls", "surface"}
    assert "field" not in vars(features)


def test_missing_features_are_computed(grid: OccupancyGrid, arrays: dict) -> None:
    back = features_from_arrays(grid, {"walls": arrays["walls"]}, PARAMETERS)
    assert "field" not in vars(back)
    np.testing.assert_array_equal(back.field.table, arrays["field"])


@pytest.mark.parametrize("name", ["walls", "visibility", "surface.xy", "pyramid.image1", "vmap"])
@pytest.mark.parametrize("fault", ["shape", "type", "axes", "scalar"])
def test_arrays_that_do_not_fit_are_refused(grid, arrays, name, fault):
    array = arrays[name]
    bad = {
        "shape": array[..., :-1],
        "type": array.astype(np.complex64),
        "axes": array[None],
        "scalar": np.zeros((), array.dtype),
    }[fault]
    with pytest.raises(ValueError, match=r"expected|must agree"):
        features_from_arrays(grid, {**arrays, name: bad}, PARAMETERS)


@pytest.mark.parametrize("name", ["surface.alpha", "pyramid.free2", "pyramid.image0"])
def test_part_of_a_feature_is_refused(grid: OccupancyGrid, arrays: dict, name: str) -> None:
    rest = {k: v for k, v in arrays.items() if k != name}
    with pytest.raises(ValueError, match="got nothing"):
        features_from_arrays(grid, rest, PARAMETERS)


def test_unknown_arrays_and_orphans_are_refused(grid: OccupancyGrid, arrays: dict) -> None:
    with pytest.raises(ValueError, match="no such feature"):
        features_from_arrays(grid, {"wall": arrays["walls"]}, PARAMETERS)
    with pytest.raises(ValueError, match="without its surface"):
        features_from_arrays(grid, {"visibility": arrays["visibility"]}, PARAMETERS)


def test_arrays_of_another_map_are_refused(grid: OccupancyGrid, arrays: dict) -> None:
    smaller = OccupancyGrid(grid.occupied[:-1], grid.free[:-1], grid.resolution)
    for name in ("walls", "field", "pyramid"):
        some = {k: v for k, v in arrays.items() if k.split(".")[0] == name}
        with pytest.raises(ValueError, match="expected"):
            features_from_arrays(smaller, some, PARAMETERS)


def test_key_ignores_what_does_not_change_a_feature(grid: OccupancyGrid) -> None:
    key = features_key(MapFeatures(grid, **PARAMETERS))
    assert key == features_key(MapFeatures(grid, **PARAMETERS, threads=7, memory_budget=1))
    assert key == features_key(MapFeatures(replace(grid, origin=Pose2D(1, 2, 3)), **PARAMETERS))
    assert key != features_key(MapFeatures(grid, **PARAMETERS, sigma=0.2))


def test_second_start_finds_what_the_first_computed(grid: OccupancyGrid, tmp_path: Path) -> None:
    first = load_features(grid, tmp_path, PARAMETERS)
    assert not save_features(first, tmp_path)  # nothing computed yet
    _ = first.walls
    assert save_features(first, tmp_path)
    assert not save_features(first, tmp_path)
    second = load_features(grid, tmp_path, PARAMETERS)
    assert "walls" in vars(second)
    assert not save_features(second, tmp_path)
    _ = second.field
    assert save_features(second, tmp_path)
    assert {"walls", "field"} <= vars(load_features(grid, tmp_path, PARAMETERS)).keys()
    other = load_features(grid, tmp_path, {**PARAMETERS, "cell": 0.2})
    assert "walls" not in vars(other)
    assert not vars(load_features(grid, tmp_path / "nowhere", PARAMETERS)).keys() & set(KEPT)


def test_an_entry_of_wrong_shapes_is_computed_anew(grid, tmp_path, caplog):
    features = MapFeatures(grid, **PARAMETERS)
    key = features_key(features)
    store_entry(tmp_path, key, {"walls": np.zeros((2, 2), np.float32)})
    with caplog.at_level(logging.WARNING):
        back = load_features(grid, tmp_path, PARAMETERS)
    assert "bad cache entry" in caplog.text
    assert entry_path(tmp_path, key).name in caplog.text
    np.testing.assert_array_equal(back.walls, features.walls)
    assert save_features(back, tmp_path)
    caplog.clear()
    assert "walls" in vars(load_features(grid, tmp_path, PARAMETERS))
    assert not caplog.text
