"""Ray-distance images against rays walked one by one, and where walls could leak."""

import cv2
import naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imgloc.errors import ConfigError
from imgloc.features.distance import distance_image
from imgloc.features.raycast import cast_rays
from imgloc.features.raydistance import ray_distances

SEEN = 50.0  # cells, farther than any of these maps is wide


def blobs(seed, height=24, width=31):
    noise = np.random.default_rng(seed).random((height, width)).astype(np.float32)
    return cv2.GaussianBlur(noise, (0, 0), 1.5) > 0.58


def test_distances_are_from_the_cell_centre_to_the_wall_s_face():
    wall = np.zeros((3, 7), bool)
    wall[:, 5] = True
    stack = ray_distances(wall, 0.1, 4, 2.0)
    assert stack.dtype == np.uint16
    assert stack.shape == (4, 3, 7)
    np.testing.assert_array_equal(stack[0, 1], [45, 35, 25, 15, 5, 0, 200])  # psi = 0 is +x
    np.testing.assert_array_equal(stack[2, 1], [200, 200, 200, 200, 200, 0, 5])


def test_psi_is_counter_clockwise_with_row_0_lowest():
    floor = np.zeros((6, 3), bool)
    floor[0] = True
    stack = ray_distances(floor, 1.0, 4, 50.0)
    np.testing.assert_array_equal(stack[3, :, 1], [0, 50, 150, 250, 350, 450])  # -y, down
    np.testing.assert_array_equal(stack[1, :, 1], [0, 5000, 5000, 5000, 5000, 5000])


@pytest.mark.parametrize("shape", [(7, 12), (8, 12), (7, 13), (8, 13), (1, 9), (9, 1)])
def test_quarter_turns_are_exact_for_odd_and_even_sides(shape):
    occupied = np.zeros(shape, bool)
    occupied[::3, ::4] = True  # no two touch
    stack = ray_distances(occupied, 1.0, 4, SEEN)
    for k, psi in enumerate(np.arange(4) * np.pi / 2):
        for row, col in np.argwhere(~occupied):
            truth = naive.ray(occupied, col + 0.5, row + 0.5, psi, SEEN)
            assert abs(stack[k, row, col] / 100 - truth) <= 0.02, (k, row, col)


def test_a_wall_that_touches_another_at_a_corner_is_met_a_quarter_cell_early_at_most():
    occupied = np.random.default_rng(3).random((16, 17)) < 0.15
    stack = ray_distances(occupied, 1.0, 4, SEEN)
    truth = np.array(
        [
            [
                naive.ray(occupied, col + 0.5, row + 0.5, psi, SEEN)
                for row, col in np.argwhere(~occupied)
            ]
            for psi in np.arange(4) * np.pi / 2
        ]
    )
    error = stack[:, ~occupied] / 100 - truth
    assert error.max() <= 0.02
    assert error.min() >= -0.3
    assert np.abs(np.median(error)) <= 0.02


@pytest.mark.parametrize("n_psi", [9, 16])
def test_against_walked_rays(n_psi):
    occupied = np.pad(blobs(1), 2, constant_values=True)
    stack = ray_distances(occupied, 1.0, n_psi, SEEN) / 100
    assert (stack[:, occupied] == 0).all()
    cells = np.argwhere(~occupied)[::7]
    error = np.array(
        [
            stack[k, row, col] - naive.ray(occupied, col + 0.5, row + 0.5, psi, SEEN)
            for k, psi in enumerate(np.arange(n_psi) * 2 * np.pi / n_psi)
            for row, col in cells
        ]
    )
    # Rays run up to half a cell beside the centre: rays that just miss a corner differ by much.
    assert abs(np.median(error)) < 0.15
    assert (np.abs(error) < 1.0).mean() > 0.85


@pytest.mark.parametrize("angle_deg", [0, 13, 45, 77, 120, 200, 301])
def test_slanted_faces_have_no_bias(angle_deg):
    angle, size = np.deg2rad(angle_deg), 160
    y, x = np.mgrid[:size, :size] + 0.5
    ahead = 30 - (x - 80) * np.cos(angle) - (y - 80) * np.sin(angle)  # distance to the face
    stack = ray_distances(ahead < 0, 1.0, 36, 99.0) / 100
    middle = np.hypot(x - 80, y - 80) < 15
    errors = []
    for k in range(36):
        incidence = np.cos(2 * np.pi * k / 36 - angle)
        if incidence > 0.75:
            errors.append((stack[k] - ahead / incidence)[middle])
    error = np.concatenate(errors)
    assert abs(error.mean()) < 0.1
    assert np.abs(error).max() < 1.6
    assert error.std() < 0.4


@settings(max_examples=25)
@given(st.floats(0, np.pi / 2), st.integers(2, 30))
def test_walls_one_pixel_wide_do_not_leak(angle, n_psi):
    image = np.zeros((80, 80), np.uint8)
    corners = [
        (round(40 + 35 * np.cos(angle + q)), round(40 + 35 * np.sin(angle + q)))
        for q in np.arange(4) * np.pi / 2
    ]
    cv2.polylines(image, [np.array(corners)], True, 1)  # joined at corners of cells only
    y, x = np.mgrid[:80, :80] - 40
    stack = ray_distances(image > 0, 0.1, n_psi, 30.0)
    assert stack[:, np.hypot(x, y) < 20].max() < 30 * 100
    assert stack[:, np.hypot(x, y) < 20].max() < 600


def test_cells_beside_a_wall_are_not_inside_it():
    # Free cells of a slanted corridor: looking along the wall must not read 0.
    y, x = np.mgrid[:80, :80] + 0.5
    angle = np.deg2rad(17)
    occupied = np.abs((y - 40) * np.cos(angle) - (x - 40) * np.sin(angle)) > 12
    inner = ~occupied & (np.abs(x - 40) < 20)
    stack = ray_distances(occupied, 1.0, 72, 99.0)
    away = np.cos(2 * np.pi * np.arange(72) / 72 - angle) > 0.9  # along the corridor
    assert (stack[away][:, inner] == 0).mean() < 0.01


@pytest.mark.parametrize("n_psi", [1, 5, 8])
def test_threads_do_not_matter(n_psi):
    occupied = blobs(5)
    np.testing.assert_array_equal(
        ray_distances(occupied, 0.1, n_psi, 9.0),
        ray_distances(occupied, 0.1, n_psi, 9.0, threads=3),
    )


def test_rays_start_at_the_centres_of_blocks():
    walls = np.zeros((2, 9), bool)  # the last block sticks out
    walls[:, [0, 1, 7]] = True
    stack = ray_distances(walls, 0.1, 2, 5.0, factor=2)
    #         solid, centre at 0.3, 0.5, in the wall's left half, beyond the wall
    assert stack[0, 0].tolist() == [0, 40, 20, 0, 500]
    assert stack[1, 0, :3].tolist() == [0, 10, 30]


@pytest.mark.parametrize("factor", [2, 3])
def test_blocks_see_the_walls_of_the_fine_map(factor):
    occupied = blobs(3, 61, 44)
    fine = distance_image(occupied)
    stack = ray_distances(occupied, 0.1, 8, 9.0, factor=factor)
    height, width = stack.shape[1:]
    y, x = (np.indices((height, width)) + 0.5) * factor * 0.1
    for k in range(8):
        seen = cast_rays(fine, np.stack((x, y), axis=-1), np.full(x.shape, k * np.pi / 4), 9.0, 0.1)
        expected = 100 * np.minimum(seen, 9.0)
        assert np.median(np.abs(stack[k] - expected)) <= 5  # half a fine cell


def test_without_walls_everything_is_out_of_range():
    assert (ray_distances(np.zeros((5, 6), bool), 0.1, 6, 12.34) == 1234).all()
    assert (ray_distances(np.ones((5, 6), bool), 0.1, 6, 12.34) == 0).all()


def test_readings_beyond_uint16_saturate():
    row = np.zeros((1, 700), bool)
    row[0, -1] = True
    stack = ray_distances(row, 1.0, 1, 655.35)
    assert stack[0, 0, 0] == 65535
    assert stack[0, 0, 100] == 59850  # 699 - 100.5 m


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("n_psi", (0,)),
        ("max_range", (0.0, 700.0, np.nan)),
        ("resolution", (0.0,)),
        ("occupied", [np.zeros(shape, bool) for shape in ((0, 4), 4, (2, 32767))]),
    ],
)
def test_wrong_parameters(name, values):
    good = {"occupied": np.zeros((4, 4), bool), "resolution": 0.1, "n_psi": 4, "max_range": 9.0}
    for value in values:
        with pytest.raises(ConfigError):
            ray_distances(**{**good, name: value})
