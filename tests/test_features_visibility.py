"""The visibility map of GHT-V: by casting rays and by unwrapping the image, beside Alg. 6."""

import cv2
import naive
import numpy as np
import pytest

from imgloc.features.surface import surface_points
from imgloc.features.visibility import WAYS, unwrapped, visibility_frames
from imgloc.geometry import wrap
from imgloc.model import OrientedPoints

both = pytest.mark.parametrize("by", WAYS)


def wall_point(x, y, alpha):
    return OrientedPoints([[x, y]], [alpha], [0.1], [True])


def room(height=40, width=60, thickness=2):
    occupied = np.ones((height, width), bool)
    occupied[thickness:-thickness, thickness:-thickness] = False
    return occupied


def absolute(occupied, points, resolution, n_psi, horizon, by="march"):
    """(M, n_psi) in directions of the grid, for normals that are such directions."""
    vis = visibility_frames(occupied, points, resolution, n_psi, horizon, by=by)
    turn = np.rint(points.alpha * n_psi / (2 * np.pi)).astype(int)
    return np.stack([np.roll(column, k) for column, k in zip(vis.T, turn, strict=True)])


def test_psi_is_absolute_in_the_image_version_and_relative_in_frames():
    occupied = room(40, 60, 2)
    top = wall_point(3.0, 3.8, -np.pi / 2)  # looks down
    vis = absolute(occupied, top, 0.1, 4, 30.0)
    np.testing.assert_allclose(vis[0], [0, 0, 0, 3.6], atol=0.01)
    frames = visibility_frames(occupied, top, 0.1, 8, 30.0)
    assert frames.shape == (8, 1)
    # psi_1 is 45 deg counter-clockwise of the normal: to the lower right.
    right, left = frames[1, 0], frames[7, 0]
    np.testing.assert_allclose(frames[0, 0], 3.6, atol=0.01)
    np.testing.assert_allclose([right, left], [2.8 * np.sqrt(2)] * 2, atol=0.06)
    nearer = visibility_frames(occupied, wall_point(4.8, 3.8, -np.pi / 2), 0.1, 8, 30.0)
    np.testing.assert_allclose(nearer[[1, 7], 0], [1.0 * np.sqrt(2), 3.6 * np.sqrt(2)], atol=0.06)


@both
def test_a_wall_at_the_horizon_itself_is_seen(by):
    surface = wall_point(0.2, 2.0, 0.0)
    (far,) = visibility_frames(room(), surface, 0.1, 1, 30.0, by=by)[0]
    assert visibility_frames(room(), surface, 0.1, 1, float(far), by=by)[0, 0] == far
    assert visibility_frames(room(), surface, 0.1, 1, 0.99 * float(far), by=by)[0, 0] == np.inf


def test_nothing_within_the_horizon_is_infinite_and_behind_is_zero():
    occupied = np.zeros((20, 60), bool)
    occupied[:, :2] = True
    surface = wall_point(0.2, 1.0, 0.0)
    np.testing.assert_array_equal(absolute(occupied, surface, 0.1, 4, 3.0)[0], [np.inf, 0, 0, 0])
    occupied[:, 40:] = True  # 3.8 m away
    assert np.isinf(absolute(occupied, surface, 0.1, 4, 3.7)[0, 0])
    assert absolute(occupied, surface, 0.1, 4, 3.9)[0, 0] == pytest.approx(3.8, abs=0.01)


def test_points_without_a_normal_see_nothing():
    surface = OrientedPoints([[2.0, 2.0]], [np.nan], [np.inf], [False])
    for by in WAYS:
        assert not visibility_frames(room(), surface, 0.1, 6, 9.0, by=by).any()


@both
def test_unknown_cells_are_transparent(by):
    # Only `occupied` is passed: nothing else can stop a ray. A wall behind unknown space counts.
    occupied = room(40, 60, 2)
    vis = absolute(occupied, wall_point(5.8, 2.0, np.pi), 0.1, 2, 30.0, by)
    np.testing.assert_allclose(vis[0], [0, 5.6], atol=0.01)


def test_rows_from_the_normal_on():
    occupied = room()
    surface = surface_points(occupied, ~occupied, 0.1)
    frames = visibility_frames(occupied, surface, 0.1, 36, 20.0)
    assert frames.flags.c_contiguous
    assert not frames[9:28].any()  # a quarter turn or more from the normal
    assert (frames[:9] > 0).all()


@both
def test_a_round_room(by):
    # From a circle of radius R, at angle beta from the normal, the far wall is 2 R cos(beta) away.
    y, x = np.mgrid[:120, :120] + 0.5
    occupied = np.hypot(x - 60, y - 60) > 50
    surface = surface_points(occupied, ~occupied, 0.1)
    n_psi = 24
    vis = visibility_frames(occupied, surface, 0.1, n_psi, 20.0, by=by).T
    out = surface.xy - 6.0
    inward = np.arctan2(-out[:, 1], -out[:, 0])
    psi = np.arange(n_psi) * (2 * np.pi / n_psi)
    beta = wrap(psi + (surface.alpha - inward)[:, None])
    seen = (np.abs(beta) < np.deg2rad(60)) & (np.abs(wrap(psi)) < np.deg2rad(80))
    truth = 10 * np.cos(beta)
    assert np.abs(vis - truth)[seen].max() < 0.25
    # A bin of Alg. 6 holds the nearest point within half a bin, +-7.5 deg, of the grid.
    by_points = naive.visibility(surface.xy, n_psi, 20.0)
    beta = wrap(psi - inward[:, None])
    seen = np.abs(beta) < np.deg2rad(60)
    nearest = 10 * np.cos(np.abs(beta) + np.pi / n_psi)
    assert np.abs(by_points - nearest)[seen].max() < 0.6


@both
def test_what_is_seen_is_what_a_walk_along_the_ray_meets(by):
    noise = np.random.default_rng(3).random((90, 110)).astype(np.float32)
    occupied = np.pad(cv2.GaussianBlur(noise, (0, 0), 4.0) > 0.51, 3, constant_values=True)
    surface = surface_points(occupied, ~occupied, 1.0)
    surface = surface.select(np.arange(0, len(surface), 9))
    n_psi = 12
    vis = visibility_frames(occupied, surface, 1.0, n_psi, 60.0, by=by)
    off, total, wrong = [], 0, 0
    for j in range(len(surface)):
        for k in (10, 11, 0, 1, 2):  # within 60 degrees of the normal
            angle = surface.alpha[j] + k * 2 * np.pi / n_psi
            normal = np.array([np.cos(surface.alpha[j]), np.sin(surface.alpha[j])])
            starts = [surface.xy[j] + step * normal for step in (0.5, 1.0, 1.5)]
            clear = [not occupied[int(y), int(x)] for x, y in starts]
            first = clear.index(True)
            seen = naive.ray(occupied, *starts[first], angle, 60.0)
            seen += (first + 1) / 2 * np.cos(angle - surface.alpha[j])
            total += 1
            if np.isinf(vis[k, j]) or seen > 60.0:
                wrong += not (np.isinf(vis[k, j]) and seen > 59.0)
            else:
                off.append(vis[k, j] - seen)
                wrong += abs(off[-1]) > 1.0  # the tolerance: one cell
    assert total > 200
    assert np.median(np.abs(off)) < 0.15
    assert wrong <= 0.06 * total  # rays that pass a corner on the other side


def test_unwrapping_is_that_of_opencv():
    image = np.random.default_rng(0).integers(0, 256, (30, 40), dtype=np.uint8)
    ours = unwrapped(image, np.array([[20.5, 15.5]]), np.arange(8)[:, None] * np.pi / 4, 10.0)
    theirs = cv2.warpPolar(image, (20, 8), (20.0, 15.0), 10.0, cv2.INTER_LINEAR)
    assert np.abs(ours[:, :20].astype(int) - theirs).max() <= 6  # positions in steps of 1/32


def test_a_ray_starts_in_the_first_cell_that_is_clear():
    row = np.array([[1, 1, 0, 1]], bool)  # the point is fitted 0.4 cells into the wall
    for x, sees in ((0.6, 2.4), (1.1, 1.9), (1.6, 1.4)):
        frames = visibility_frames(row, wall_point(x, 0.5, 0.0), 1.0, 1, 9.0)
        assert frames[0, 0] == pytest.approx(sees, abs=0.01)


def test_rays_of_fitted_points_do_not_start_inside_their_wall():
    y, x = np.mgrid[:120, :120] + 0.5
    occupied = np.abs((x - 60) * np.cos(0.3) + (y - 60) * np.sin(0.3)) > 40  # a slanted corridor
    surface = surface_points(occupied, ~occupied, 0.1)
    inner = surface.select(np.abs(surface.xy - 6).max(axis=1) < 4)
    front = visibility_frames(occupied, inner, 0.1, 8, 30.0)[0]
    assert np.median(front) == pytest.approx(8.0, abs=0.1)
    assert (front > 7).all()
