"""Poses stand where the faces of walls are: one wall in a tiny room, of one cell or of several."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imgloc import MapFeatures, OccupancyGrid, Options, Prior, Shared
from imgloc.features.scanpoints import Readings
from imgloc.io.calibration import calibration_path, load_calibrations, save_calibrations
from imgloc.numbers import number
from imgloc.search.faces import any_depth, depth_of, faces_met, on_faces
from imgloc.search.modes import Modes
from imgloc.search.rescore import score_poses
from imgloc.search.weigh import stand_on_faces

CELL, SIDE = 0.05, 4.0


def room(cells: int, view: float) -> MapFeatures:
    """A room of 4 m, open to the back if the view does not go there, with walls of some cells."""
    n = round(SIDE / CELL) + 2 * cells + 20
    walls = np.zeros((n, n), bool)
    walls[10:-10, 10:-10] = True
    inner = slice(10 + cells, -10 - cells)
    walls[inner, inner] = False
    if view <= 90:
        walls[inner, : n // 2] = False
    walls[:8:2, ::2] = walls[-8::2, ::2] = True  # specks that nobody drew
    return MapFeatures(OccupancyGrid(walls, ~walls, CELL))


KNOWN, UNKNOWN = (depth_of(Shared(depth=depth), room(1, 360)) for depth in (0.0, None))


def seen(cells: int, view: float, noise: float, depth: float = 0.0, seed: int = 0) -> Readings:
    """What a sensor in the middle reads, facing +x: rays end `depth` behind the walls' border."""
    phi = np.deg2rad(np.linspace(-view / 2, view / 2, 181, endpoint=view < 360))
    rho = SIDE / 2 / np.maximum(np.abs(np.cos(phi)), np.abs(np.sin(phi))) + depth
    return Readings(rho + noise * np.random.default_rng(seed).standard_normal(len(phi)), phi)


def errors(cells: int, view: float, noise: float, prior, depth: float = 0.0) -> np.ndarray:
    """Errors (40, 2) along and across the view, metres, of poses that begin 3 cm too far on."""
    features = room(cells, view)
    middle = features.grid.info.shape[0] * CELL / 2
    begin = np.array([[middle + 0.03, middle - 0.01, 0.01]])
    found = [
        on_faces(begin, seen(cells, view, noise, depth, k), features, prior) for k in range(40)
    ]
    return np.array([one.poses[0, :2] - middle for one in found])


@pytest.mark.parametrize("cells", [1, 3, 6])
@pytest.mark.parametrize("view", [90, 180, 360])
@pytest.mark.parametrize("noise", [0.01, 0.05, 0.15])
def test_poses_do_not_lean_toward_sharp_walls(cells, view, noise):
    along, across = errors(cells, view, noise, KNOWN).mean(axis=0)
    assert abs(along) < (0.006 if noise <= 0.05 else 0.015)
    if view > 90:  # else the only wall in view leaves the pose free along it
        assert abs(across) < 0.01


@pytest.mark.parametrize("cells", [3, 6])
@pytest.mark.parametrize("view", [180, 270, 360])
@pytest.mark.parametrize("depth", [0.0, 0.04])
def test_walls_on_both_sides_show_how_deep_the_faces_are(cells, view, depth):
    features = room(cells, view)
    middle = features.grid.info.shape[0] * CELL / 2
    at = np.array([[middle, middle, 0.0]])
    found = [
        on_faces(at, seen(cells, view, 0.02, depth, k), features, any_depth()) for k in range(10)
    ]
    assert np.mean([one.depth for one in found]) == pytest.approx(depth, abs=0.012)
    assert np.mean([one.poses[0, 0] for one in found]) == pytest.approx(middle, abs=0.01)


def carried(cells: int, view: float, shared: Shared, depth: float, seed: int = 0):
    """Error (2,) and standard deviations (2,) along and across the view, metres."""
    features, readings = room(cells, view), seen(cells, view, 0.02, depth, seed)
    middle = features.grid.info.shape[0] * CELL / 2
    at, options = np.array([[middle, middle, 0.0]]), Options()
    scores = score_poses(features, readings, at, options.model)
    poses, (covariance,) = stand_on_faces(
        features, Modes(at, scores, readings, shared=shared), at, options
    )
    return poses[0, :2] - middle, np.sqrt(np.diag(covariance))[:2]


@pytest.mark.parametrize("cells", [1, 3, 6])
@pytest.mark.parametrize("share", [0.0, 1.0])
def test_a_face_that_is_not_known_counts_along_the_view(cells, share):
    middle = share * min(cells * CELL / 2, 0.05)
    error, unknown = carried(cells, 90, Shared(), middle)
    assert abs(error[0]) < 2 * unknown[0]
    _, known = carried(cells, 90, Shared(depth=middle), middle)
    _, around = carried(cells, 360, Shared(), middle)
    walls = number("covariance.walls")[0]  # what all of them have in common
    scan, told, behind = (np.sqrt(v[0] ** 2 - walls**2) for v in (unknown, known, around))
    assert told < 0.6 * scan
    assert behind < 0.6 * scan  # a wall behind the sensor tells where the faces are


def test_the_faces_of_drawn_walls_are_their_borders_unless_these_are_too_thick():
    walls = room(3, 360).grid.occupied.copy()
    walls[:8] = walls[-8:] = False  # no specks: all borders are straight
    drawn = MapFeatures(OccupancyGrid(walls, ~walls, CELL))
    assert depth_of(Shared(), drawn) == (0.0, UNKNOWN[1])
    assert depth_of(Shared(depth=0.04), drawn) == (0.04, KNOWN[1])  # a calibration knows better


def test_a_pose_stays_where_no_sensor_can_be_at_the_new_one():
    features, readings = room(3, 360), seen(3, 360, 0.0)
    middle = features.grid.info.shape[0] * CELL / 2
    options = Options()
    at = np.array([[middle, middle, 0.0], [middle + 0.05, middle, 0.0]])
    cells = np.zeros(features.grid.info.shape, bool)
    row = int(middle / CELL)
    cells[row, int((middle + 0.05) / CELL)] = True  # only the place of the second is allowed
    found = Modes(at, score_poses(features, readings, at, options.model), readings)
    allowed = replace(options, prior=Prior(cells))
    poses, _ = stand_on_faces(features, found, at + [[0.0, 0.0, 0.0], [0.01, 0.0, 0.0]], allowed)
    assert poses[1, 0] == pytest.approx(middle + 0.06)


def test_no_pose_and_no_face_are_no_error():
    features, few = room(1, 360), seen(1, 360, 0.0).spread(3)
    settled = on_faces(np.empty((0, 3)), few, features, UNKNOWN)
    assert settled.poses.shape == (0, 3)
    away = np.array([[-50.0, -50.0, 0.0]])  # off the map nothing is met: the pose stays
    settled = on_faces(away, few, features, UNKNOWN)
    np.testing.assert_array_equal(settled.poses, away)
    assert settled.depth == pytest.approx(UNKNOWN[0])


@pytest.mark.parametrize("cells", [1, 2, 6])
def test_a_face_has_its_distance_its_slope_and_the_middle_of_its_wall(cells):
    features = room(cells, 360)
    middle = features.grid.info.shape[0] * CELL / 2
    at, ahead = np.array([[middle, middle, 0.0]]), np.zeros(1)
    for beyond in (-0.3, -0.02, 0.0, 0.02, 0.3):  # before the wall, in it, behind it
        met = faces_met(at, Readings(ahead + SIDE / 2 + beyond, ahead), features)
        assert met.before[0, 0] == pytest.approx(-beyond, abs=2e-3)
        np.testing.assert_allclose(met.J[0, :, 0], [-1, 0, 0], atol=1e-3)
        assert met.middle[0, 0] == pytest.approx(cells * CELL / 2, abs=0.01)
        assert met.facing[0, 0] == pytest.approx(1, abs=1e-3)
        assert met.usable[0, 0] == 1


def test_the_depth_is_kept_beside_the_map_and_files_without_one_are_read(tmp_path: Path):
    grid, path = room(1, 360).grid, calibration_path(tmp_path / "office.yaml")
    save_calibrations(path, grid, {}, {}, shared=Shared(1.01, 1, depth=0.04))
    assert load_calibrations(path, grid) == ({}, Shared(1.01, 1, depth=0.04))
    content = json.loads(path.read_text())
    del content["shared"]["depth"]
    path.write_text(json.dumps(content))
    assert load_calibrations(path, grid) == ({}, Shared(1.01, 1, depth=None))
