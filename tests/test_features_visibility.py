"""The visibility map of GHT-V: Alg. 6, and the same by casting rays."""

import naive_visibility as naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imgloc.errors import ConfigError
from imgloc.features.surface import surface_points
from imgloc.features.visibility import (
    visibility_frames,
    visibility_image,
    visibility_points,
    visibility_relative,
)
from imgloc.geometry import wrap
from imgloc.model import OrientedPoints


def wall_point(x, y, alpha):
    return OrientedPoints([[x, y]], [alpha], [0.1], [True])


def room(height=40, width=60, thickness=2):
    occupied = np.ones((height, width), bool)
    occupied[thickness:-thickness, thickness:-thickness] = False
    return occupied


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 1000), st.integers(1, 13), st.floats(0.5, 6.0))
def test_points_equal_the_listing(seed, n_psi, horizon):
    rng = np.random.default_rng(seed)
    xy = rng.uniform(0, 6, (25, 2))[rng.integers(0, 25, rng.integers(0, 25))]  # some coincide
    np.testing.assert_allclose(
        visibility_points(xy, n_psi, horizon), naive.visibility(xy, n_psi, horizon), rtol=1e-6
    )


def test_psi_goes_from_the_point_to_what_it_sees():
    # The other point lies above: psi = 90 deg is entry 1 of 4 for the lower one.
    vis = visibility_points(np.array([[0.0, 0.0], [0.0, 2.0]]), 4, np.inf)
    np.testing.assert_array_equal(vis, [[np.inf, 2, np.inf, np.inf], [np.inf] * 3 + [2]])


def test_image_distances_are_from_the_surface_along_psi():
    occupied = room(40, 60, 2)  # free: x 2..58, y 2..38
    vis = visibility_image(occupied, wall_point(0.2, 2.0, 0.0), 0.1, 8, 30.0)
    assert vis.dtype == np.float32
    expected = [5.6, 1.8 * np.sqrt(2), 0, 0, 0, 0, 0, 1.8 * np.sqrt(2)]
    np.testing.assert_allclose(vis[0], expected, atol=0.06)


def test_psi_is_absolute_in_the_image_version_and_relative_in_frames():
    occupied = room(40, 60, 2)
    top = wall_point(3.0, 3.8, -np.pi / 2)  # looks down
    vis = visibility_image(occupied, top, 0.1, 4, 30.0)
    np.testing.assert_allclose(vis[0], [0, 0, 0, 3.6], atol=0.01)
    frames = visibility_frames(occupied, top, 0.1, 8, 30.0)
    assert frames.shape == (8, 1)
    # psi_1 is 45 deg counter-clockwise of the normal: to the lower right.
    right, left = frames[1, 0], frames[7, 0]
    np.testing.assert_allclose(frames[0, 0], 3.6, atol=0.01)
    np.testing.assert_allclose([right, left], [2.8 * np.sqrt(2)] * 2, atol=0.06)
    nearer = visibility_frames(occupied, wall_point(4.8, 3.8, -np.pi / 2), 0.1, 8, 30.0)
    np.testing.assert_allclose(nearer[[1, 7], 0], [1.0 * np.sqrt(2), 3.6 * np.sqrt(2)], atol=0.06)


def test_an_intervening_wall_stops_the_view():
    occupied = room(40, 60, 2)
    occupied[:, 30] = True
    vis = visibility_image(occupied, wall_point(0.2, 2.0, 0.0), 0.1, 4, 30.0)
    np.testing.assert_allclose(vis[0], [2.8, 0, 0, 0], atol=0.01)


def test_nothing_within_the_horizon_is_infinite_and_behind_is_zero():
    occupied = np.zeros((20, 60), bool)
    occupied[:, :2] = True
    surface = wall_point(0.2, 1.0, 0.0)
    np.testing.assert_array_equal(
        visibility_image(occupied, surface, 0.1, 4, 3.0)[0], [np.inf, 0, 0, 0]
    )
    occupied[:, 40:] = True  # 3.8 m away
    assert np.isinf(visibility_image(occupied, surface, 0.1, 4, 3.7)[0, 0])
    assert visibility_image(occupied, surface, 0.1, 4, 3.9)[0, 0] == pytest.approx(3.8, abs=0.01)


def test_points_without_a_normal_see_nothing():
    surface = OrientedPoints([[2.0, 2.0]], [np.nan], [np.inf], [False])
    assert not visibility_image(room(), surface, 0.1, 6, 9.0).any()
    assert not visibility_frames(room(), surface, 0.1, 6, 9.0).any()


def test_unknown_cells_are_transparent():
    # Only `occupied` is passed: nothing else can stop a ray. A wall behind unknown space counts.
    occupied = room(40, 60, 2)
    vis = visibility_image(occupied, wall_point(5.8, 2.0, np.pi), 0.1, 2, 30.0)
    np.testing.assert_allclose(vis[0], [0, 5.6], atol=0.01)


def test_relative_turns_each_row_by_its_own_normal():
    vis = np.arange(8, dtype=np.float32).reshape(2, 4)
    out = visibility_relative(vis, np.array([-np.pi / 2, np.pi]))
    np.testing.assert_array_equal(out, [[3, 6], [0, 7], [1, 4], [2, 5]])
    assert out.flags.c_contiguous


def test_frames_equal_relative_for_normals_on_the_directions():
    occupied = room()
    surface = surface_points(occupied, ~occupied, 0.1)
    snapped = np.round(surface.alpha / (np.pi / 2)) * (np.pi / 2)
    surface = OrientedPoints(surface.xy, wrap(snapped), surface.sigma_alpha, surface.valid)
    absolute = visibility_image(occupied, surface, 0.1, 36, 20.0)
    frames = visibility_frames(occupied, surface, 0.1, 36, 20.0)
    assert frames.flags.c_contiguous
    np.testing.assert_allclose(visibility_relative(absolute, surface.alpha), frames, atol=2e-3)
    assert not frames[9:28].any()  # a quarter turn or more from the normal
    assert (frames[:9] > 0).all()


def test_both_versions_agree_in_a_round_room():
    # From a circle of radius R, at angle beta from the normal, the far wall is 2 R cos(beta) away.
    y, x = np.mgrid[:120, :120] + 0.5
    occupied = np.hypot(x - 60, y - 60) > 50
    surface = surface_points(occupied, ~occupied, 0.1)
    n_psi = 24
    by_image = visibility_image(occupied, surface, 0.1, n_psi, 20.0)
    by_points = visibility_points(surface.xy, n_psi, 20.0)
    out = surface.xy - 6.0
    inward = np.arctan2(-out[:, 1], -out[:, 0])
    beta = wrap(np.arange(n_psi) * (2 * np.pi / n_psi) - inward[:, None])
    seen = np.abs(beta) < np.deg2rad(60)
    truth = 10 * np.cos(beta)
    assert np.abs(by_image - truth)[seen].max() < 0.25
    # A bin of Alg. 6 holds the nearest point within half a bin, +-7.5 deg.
    nearest = 10 * np.cos(np.abs(beta) + np.pi / n_psi)
    assert (by_points - truth)[seen].max() < 0.25
    assert (by_points - nearest)[seen].min() > -0.25


def test_rays_of_fitted_points_do_not_start_inside_their_wall():
    y, x = np.mgrid[:120, :120] + 0.5
    occupied = np.abs((x - 60) * np.cos(0.3) + (y - 60) * np.sin(0.3)) > 40  # a slanted corridor
    surface = surface_points(occupied, ~occupied, 0.1)
    inner = surface.select(np.abs(surface.xy - 6).max(axis=1) < 4)
    front = visibility_frames(occupied, inner, 0.1, 8, 30.0)[0]
    assert np.median(front) == pytest.approx(8.0, abs=0.1)
    assert (front > 7).all()


@pytest.mark.parametrize(("n_psi", "horizon"), [(0, 1.0), (4, 0.0), (4, float("nan"))])
def test_wrong_parameters(n_psi, horizon):
    with pytest.raises(ConfigError, match=r"n_psi|horizon"):
        visibility_points(np.zeros((2, 2)), n_psi, horizon)
    with pytest.raises(ConfigError, match=r"n_psi|horizon"):
        visibility_image(room(), wall_point(1, 1, 0.0), 0.1, n_psi, horizon)
    with pytest.raises(ConfigError, match=r"n_psi|horizon"):
        visibility_frames(room(), wall_point(1, 1, 0.0), 0.1, n_psi, horizon)


def test_wrong_shapes():
    with pytest.raises(ConfigError, match="one normal per point"):
        visibility_relative(np.zeros((3, 4), np.float32), np.zeros(2))
    with pytest.raises(ConfigError, match="horizon must be finite"):
        visibility_image(room(), wall_point(1, 1, 0.0), 0.1, 4, np.inf)
