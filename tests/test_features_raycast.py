"""Ray casting against known distances and against a slow, exact intersection."""

import numpy as np
import pytest

from imgloc.errors import ConfigError
from imgloc.features.distance import distance_image
from imgloc.features.raycast import cast_rays

INF = float("inf")

ROOM = np.array(
    [
        [1, 1, 1, 1, 1, 1],
        [1, 0, 0, 0, 0, 1],
        [1, 0, 0, 0, 0, 1],
        [1, 0, 0, 1, 0, 1],
        [1, 1, 1, 1, 1, 1],
    ],
    dtype=bool,
)


def naive(occupied, x, y, psi, shrink=0.0):
    """Entry into the nearest of all occupied squares, by the slab method, in cells."""
    best = INF
    direction = np.array([np.cos(psi), np.sin(psi)])
    for row, column in np.argwhere(occupied):
        low = np.array([column, row]) + shrink
        high = np.array([column, row]) + 1 - shrink
        with np.errstate(divide="ignore", invalid="ignore"):
            a, b = (low - (x, y)) / direction, (high - (x, y)) / direction
        near, far = np.minimum(a, b).max(), np.maximum(a, b).min()
        if far >= max(near, 0):
            best = min(best, max(near, 0))
    return best


@pytest.mark.parametrize("psi", [0.0, 1.4, np.pi, 4.0])
def test_off_the_map_is_a_miss(psi):
    open_field = np.zeros((5, 5), dtype=bool)
    open_field[2, 2] = True
    distance = distance_image(open_field)
    assert cast_rays(distance, (0.5, 0.5), psi, 100.0, 1.0) == INF
    # A start off the map sees nothing, not even the post straight ahead.
    assert cast_rays(distance, (-0.5, 2.5), 0.0, 100.0, 1.0) == INF
    assert cast_rays(distance, (2.5, 5.0), -np.pi / 2, 100.0, 1.0) == INF


def test_each_ray_may_have_its_own_reach():
    distance = distance_image(ROOM)
    got = cast_rays(distance, (1.5, 1.5), [0.0, 0.0, np.pi], [3.4, 3.6, 0.4], 1.0)
    assert got[[0, 2]].tolist() == [INF, INF]
    assert got[1] == pytest.approx(3.5, abs=0.02)
    reach = np.array([[1.0], [9.0]])  # of two scans
    scans = cast_rays(distance, np.full((2, 3, 2), 1.5), np.zeros((2, 3)), reach, 1.0)
    assert np.isinf(scans).tolist() == [[True] * 3, [False] * 3]


def test_origins_and_angles_broadcast_to_scans():
    poses = np.array([[1.5, 1.5, 0.0], [2.5, 2.5, np.pi / 2], [3.5, 1.5, -0.4]])
    angles = np.linspace(-1, 1, 7)
    distance = distance_image(ROOM)
    scans = cast_rays(distance, poses[:, None, :2], poses[:, 2:] + angles, 10.0, 1.0)
    assert scans.shape == (3, 7)
    assert scans.dtype == np.float32
    for pose, scan in zip(poses, scans, strict=True):
        np.testing.assert_array_equal(
            scan, cast_rays(distance, pose[:2], pose[2] + angles, 10.0, 1.0)
        )


@pytest.mark.parametrize("shape", [(12, 17), (17, 12)])
def test_random_maps_agree_with_the_exact_intersection(shape):
    rng = np.random.default_rng(shape[0])
    occupied = rng.random(shape) < 0.06
    distance = distance_image(occupied)
    origins = rng.random((300, 2)) * shape[::-1]
    angles = rng.uniform(-7, 7, 300)
    got = cast_rays(distance, origins, angles, 50.0, 1.0)
    for (x, y), psi, d in zip(origins, angles, got, strict=True):
        # A ray may slip past a corner that it cuts by less than a hundredth of a cell.
        assert naive(occupied, x, y, psi) - 0.01 <= d <= naive(occupied, x, y, psi, 0.01) + 0.01
    assert np.isfinite(got).sum() > 100


def test_a_diagonal_wall_of_single_cells_holds():
    occupied = np.eye(40, dtype=bool)
    rng = np.random.default_rng(0)
    origins = np.column_stack((rng.uniform(10, 30, 2000), rng.uniform(0, 5, 2000)))
    got = cast_rays(distance_image(occupied), origins, np.full(2000, np.pi / 2), 100.0, 1.0)
    expected = np.floor(origins[:, 0]) - origins[:, 1]
    np.testing.assert_allclose(got, expected, atol=0.02)


def test_far_from_the_origin_of_a_large_map():
    occupied = np.zeros((3, 32_000), dtype=bool)
    occupied[:, -1] = True
    distance = cast_rays(distance_image(occupied), (31_000.25, 1.5), 0.0, 2000.0, 1.0)
    assert distance == pytest.approx(998.75, abs=0.05)


def test_cells_are_told_apart_on_maps_of_more_cells_than_float32_counts():
    rng = np.random.default_rng(0)
    corner = rng.random((8, 40)) < 0.15
    large = np.zeros((4100, 4100), bool)
    large[-8:, -40:] = corner
    start, angles = rng.uniform((0, 0), (40, 8), (2000, 2)), rng.uniform(-np.pi, np.pi, 2000)
    small = cast_rays(distance_image(corner), start, angles, 60.0, 1.0)
    same = cast_rays(distance_image(large), start + (4060, 4092), angles, 60.0, 1.0)
    near = np.isclose(same, small, atol=0.02)  # a ray may graze a corner here and miss it there
    assert near.mean() > 0.99
    assert np.isfinite(small).mean() > 0.5


def test_a_ray_that_lands_just_off_the_map_meets_nothing_there():
    # The longest step from 9.6 cells before the border ends 1/512 behind it, where the next row of
    # the image begins: with the only wall.
    occupied = np.zeros((3, 21), bool)
    occupied[2, 0] = True
    step = np.float32(122**0.5 - 2**0.5 + 1 / 128)
    assert cast_rays(distance_image(occupied), (21 + 1 / 512 - step, 1.5), 0.0, 50.0, 1.0) == INF


@pytest.mark.parametrize("angles", [[], np.empty((0, 3))])
def test_no_rays(angles):
    origins = np.empty((*np.shape(angles), 2))
    got = cast_rays(distance_image(ROOM), origins, angles, 1.0, 1.0)
    assert got.shape == np.shape(angles)


@pytest.mark.parametrize(
    ("origin", "angle", "max_range", "resolution"),
    [
        ((np.nan, 1.0), 0.0, 1.0, 1.0),
        ((1.0, 1.0), INF, 1.0, 1.0),
        ((1.0, 1.0), 0.0, 0.0, 1.0),
        ((1.0, 1.0), 0.0, INF, 1.0),
        ((1.0, 1.0), [0.0, 0.0], [1.0, np.nan], 1.0),
        ((1.0, 1.0), 0.0, 1.0, 0.0),
        ((1.0, 1.0), 0.0, 1.0, np.nan),
    ],
)
def test_nonsense_is_refused(origin, angle, max_range, resolution):
    with pytest.raises((ConfigError, ValueError), match="finite"):
        cast_rays(distance_image(ROOM), origin, angle, max_range, resolution)
