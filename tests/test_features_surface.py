"""The surface of a map: where it is, which way it faces, where there is none."""

import tracemalloc

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from skimage import measure

from imgloc.features import surface
from imgloc.features.surface import outlines, surface_points
from imgloc.geometry import wrap


def grid(*rows):
    """Occupied and free images of a drawing: '#' wall, '.' free, ' ' unknown; top row = high y."""
    cells = np.array([list(row) for row in rows])[::-1]
    return cells == "#", cells == "."


def degrees_off(alpha, truth):
    return np.abs(np.rad2deg(wrap(alpha - truth)))


def half_plane(angle, thickness=40.0, size=100):
    """A slab whose surface passes the centre of the image with its normal at `angle`."""
    y, x = np.mgrid[:size, :size] + 0.5
    normal = np.array([np.cos(angle), np.sin(angle)])
    depth = (x - size / 2) * normal[0] + (y - size / 2) * normal[1]
    return (depth <= 0) & (depth > -thickness), normal


def test_a_thin_wall_has_two_opposite_surfaces_half_a_cell_from_its_centre():
    wall = np.zeros((9, 60), bool)
    wall[4] = True
    points = surface_points(wall, ~wall, 0.1)
    middle = points.select(np.abs(points.xy[:, 0] - 3.0) < 2.0)
    up = np.sin(middle.alpha) > 0
    np.testing.assert_allclose(middle.xy[up, 1], 0.5, atol=1e-9)  # row 4 ends at y = 0.5
    np.testing.assert_allclose(middle.xy[~up, 1], 0.4, atol=1e-9)
    np.testing.assert_allclose(middle.alpha[up], np.pi / 2, atol=1e-9)
    np.testing.assert_allclose(middle.alpha[~up], -np.pi / 2, atol=1e-9)
    assert up.sum() == (~up).sum() == 40  # one per cell


def test_corners_keep_the_two_normals_of_their_walls():
    occupied = np.ones((40, 40), bool)
    occupied[10:30, 10:30] = False
    points = surface_points(occupied, ~occupied, 1.0)
    off_axis = np.abs(np.sin(2 * points.alpha)) > np.sin(np.deg2rad(30))
    assert off_axis.sum() <= 8  # at most two of the twenty-odd points per corner


def test_no_surface_towards_unknown_space_or_the_edge_of_the_map():
    occupied, free = grid(
        "............",
        "............",
        "############",
        "            ",
        "            ",
        "            ",
    )
    points = surface_points(occupied, free, 1.0)
    assert len(points) > 0
    assert (np.sin(points.alpha) > 0).all()
    border = np.zeros((20, 20), bool)
    border[0] = True
    assert (np.sin(surface_points(border, ~border, 1.0).alpha) > 0).all()


def test_single_unknown_cells_do_not_hide_a_wall():
    occupied = np.zeros((10, 40), bool)
    occupied[2] = True
    free = np.zeros((10, 40), bool)
    free[4:] = True  # row 3 is unknown
    points = surface_points(occupied, free, 1.0)
    assert (np.sin(points.alpha) > 0).sum() > 35
    assert len(surface_points(occupied, np.roll(free, 2, axis=0) & free, 1.0)) == 0


@pytest.mark.parametrize("angle_deg", [0, 3, 10, 26.6, 45, 80, 93, 171, 200, 300])
@pytest.mark.parametrize("thickness", [1.5, 40.0])
def test_slanted_walls(angle_deg, thickness):
    angle = np.deg2rad(angle_deg)
    occupied, normal = half_plane(angle, thickness)
    points = surface_points(occupied, ~occupied, 0.05)
    xy = points.xy / 0.05 - 50
    front = (np.abs(xy).max(axis=1) < 30) & (np.cos(points.alpha - angle) > 0)
    error = degrees_off(points.alpha[front], angle)
    # The surface of a slab 1.5 thick is drawn up to a quarter cell off, never a half.
    offset = xy[front] @ normal
    assert front.sum() > 50
    assert np.median(error) < 2.5
    assert error.max() < 8
    assert np.abs(np.median(offset)) < 0.3
    assert np.ptp(offset) < 0.9
    # sigma_alpha is honest: neither ten times too large nor too small.
    assert 0.5 < np.rad2deg(np.median(points.sigma_alpha[front])) < 5


@pytest.mark.parametrize("radius", [3.0, 8.0, 20.0])
@pytest.mark.parametrize("hollow", [False, True])
def test_round_surfaces(radius, hollow):
    y, x = np.mgrid[:60, :60] + 0.5
    disc = np.hypot(x - 30.2, y - 29.7) < radius
    occupied = ~disc if hollow else disc
    points = surface_points(occupied, ~occupied, 1.0)
    out = points.xy - (30.2, 29.7)
    truth = np.arctan2(out[:, 1], out[:, 0]) + (np.pi if hollow else 0)
    error = degrees_off(points.alpha, truth)
    assert np.median(error) < 6
    assert np.percentile(error, 90) < 15
    assert np.abs(np.hypot(*out.T) - radius).max() < 0.8
    assert len(points) == pytest.approx(2 * np.pi * radius, rel=0.1)


@pytest.mark.parametrize("radius", [17, 20, 24])
def test_a_gentle_curve_is_followed_by_more_than_the_narrowest_window(radius):
    y, x = np.mgrid[:60, :60] + 0.5
    disc = np.hypot(x - 30.2, y - 29.7) < radius
    points = surface_points(disc, ~disc, 1.0)
    out = points.xy - (30.2, 29.7)
    assert np.median(degrees_off(points.alpha, np.arctan2(*out.T[::-1]))) < 1.8
    assert np.rad2deg(np.median(points.sigma_alpha)) < 3  # of seven points it would be four


def test_a_single_cell_has_four_uncertain_normals():
    occupied, free = grid(".....", ".....", "..#..", ".....", ".....")
    points = surface_points(occupied, free, 1.0)
    assert sorted(np.rad2deg(points.alpha).round().astype(int) % 360) == [0, 90, 180, 270]
    tips = points.xy - 2.5
    np.testing.assert_allclose(
        tips, 0.5 * np.column_stack((np.cos(points.alpha), np.sin(points.alpha))), atol=1e-6
    )
    assert (points.sigma_alpha > np.deg2rad(20)).all()


def test_a_diagonal_wall_one_pixel_wide_holds_together():
    occupied = np.eye(40, dtype=bool)
    points = surface_points(occupied, ~occupied, 1.0)
    middle = points.select(np.abs(points.xy - 20).max(axis=1) < 12)
    across = np.abs(np.sin(middle.alpha - np.pi / 4))
    assert (across > np.cos(np.deg2rad(10))).all()  # two straight faces, no teeth


@pytest.mark.parametrize("fill", [False, True])
def test_without_a_boundary_there_are_no_points(fill):
    occupied = np.full((6, 7), fill)
    points = surface_points(occupied, ~occupied, 0.1)
    assert len(points) == 0
    assert points.xy.shape == (0, 2)


def test_resolution_scales_the_points_only():
    occupied, _ = half_plane(0.3)
    a, b = surface_points(occupied, ~occupied, 1.0), surface_points(occupied, ~occupied, 0.05)
    np.testing.assert_allclose(a.xy * 0.05, b.xy)
    np.testing.assert_array_equal(a.alpha, b.alpha)


def blobs(seed, size=48):
    noise = np.random.default_rng(seed).random((size, size)).astype(np.float32)
    return cv2.GaussianBlur(noise, (0, 0), 2.0) > 0.52


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=200, deadline=None)
def test_outlines_are_those_of_marching_squares(seed):
    rng = np.random.default_rng(seed)
    occupied = rng.random(rng.integers(1, 15, 2)) < rng.random()
    found = measure.find_contours(
        np.pad(occupied, 1).astype(float), 0.5, fully_connected="high", positive_orientation="high"
    )
    vertices, size = outlines(occupied)
    assert size.tolist() == [len(polygon) for polygon in found]
    np.testing.assert_array_equal(
        vertices, np.concatenate([np.zeros((0, 2)), *found])[:, ::-1] - 0.5
    )


@pytest.mark.parametrize("shape", [(0, 4), (3, 0), (2, 3)])
def test_nothing_has_no_outline(shape):
    vertices, size = outlines(np.zeros(shape, bool))
    assert vertices.shape == (0, 2)
    assert size.tolist() == []


@pytest.mark.parametrize(("limit", "value", "bands"), [("_SIDES", 400, 4), ("_CELLS", 1800, 4)])
def test_bands_of_rows_sample_the_same_surface(monkeypatch, limit, value, bands):
    occupied = np.pad(blobs(5, 80), 6, mode="reflect").T[::-1]  # a view
    whole = surface_points(occupied, ~occupied, 1.0)
    monkeypatch.setattr(surface, limit, value)
    assert len(surface._bands(occupied)) >= bands
    parts = surface_points(occupied, ~occupied, 1.0)
    assert len(parts) == pytest.approx(len(whole), abs=40)
    # Elsewhere on the same lines, a cell apart at most, across the seams too.
    for one, other in ((whole, parts), (parts, whole)):
        off = other.xy[None] - one.xy[:, None]
        turn = np.abs(wrap(other.alpha[None] - one.alpha[:, None]))
        alike = turn < np.deg2rad(15)
        near = np.where(alike, np.hypot(*np.moveaxis(off, -1, 0)), np.inf)
        assert (near.min(axis=1) < 0.9).mean() > 0.97
        normal = np.stack((np.cos(one.alpha), np.sin(one.alpha)), axis=-1)[:, None]
        across = np.abs((off * normal).sum(axis=-1))[np.arange(len(one)), near.argmin(axis=1)]
        assert np.median(across) < 0.02
        assert np.quantile(across, 0.95) < 0.25


def test_a_surface_takes_little_memory(monkeypatch):
    occupied, sides = blobs(1, 400), 6000  # six bands; in one it takes three times as much
    monkeypatch.setattr(surface, "_SIDES", sides)
    tracemalloc.start()
    try:
        count = len(surface_points(occupied, ~occupied, 0.05))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert count > 4 * sides
    assert peak < 200 * sides + 150 * count + 10 * occupied.size  # a band, its results, the map


@settings(max_examples=25)
@given(st.integers(0, 10_000))
def test_points_lie_between_wall_and_free_space_and_face_it(seed):
    occupied = blobs(seed)
    points = surface_points(occupied, ~occupied, 1.0)
    padded = np.pad(occupied, 2, constant_values=True)
    normal = np.column_stack((np.cos(points.alpha), np.sin(points.alpha)))

    def is_wall(offset):
        col, row = np.floor(points.xy + offset * normal).astype(int).T + 2
        return padded[row, col]

    assert points.valid.all()
    assert (~is_wall(0.5) | ~is_wall(1.5)).all()
    assert (is_wall(-0.5) | is_wall(-1.0) | is_wall(0.0)).mean() > 0.97
    assert ((points.alpha >= -np.pi) & (points.alpha <= np.pi)).all()
    again = surface_points(occupied, ~occupied, 1.0)
    assert points.xy.tobytes() == again.xy.tobytes()  # deterministic


@settings(max_examples=15)
@given(st.integers(0, 10_000), st.integers(1, 3))
def test_turning_the_map_turns_the_surface(seed, quarters):
    occupied = blobs(seed)
    size = len(occupied)
    points = surface_points(occupied, ~occupied, 1.0)
    # np.rot90 with axes (1, 0) turns row-0-is-low images counter-clockwise in x, y.
    turned = np.rot90(occupied, quarters, axes=(1, 0))
    other = surface_points(turned, ~turned, 1.0)
    angle = quarters * np.pi / 2
    c, s = np.round((np.cos(angle), np.sin(angle)))
    back = (other.xy - size / 2) @ np.array([[c, -s], [s, c]]) + size / 2
    d = np.hypot(*(points.xy[:, None] - back[None]).transpose(2, 0, 1))
    turn = np.abs(wrap(points.alpha[:, None] - (other.alpha[None] - angle)))
    # The samples may sit elsewhere on the same curve, with the same normals nearby.
    assert (np.where(turn < np.deg2rad(40), d, np.inf).min(axis=1) < 1.5).mean() > 0.95
    assert len(other) == pytest.approx(len(points), rel=0.05)


@pytest.mark.parametrize("name", ["fr079", "map_mit_basement"])
def test_real_maps(shared, name):
    data = np.fromfile(shared / "data" / name / "map.png", np.uint8)
    image = np.flipud(cv2.imdecode(data, cv2.IMREAD_UNCHANGED))
    points = surface_points(image == 0, image == 254, 0.05)
    assert len(points) > 5000
    assert points.valid.mean() > 0.99
    # Buildings are right-angled: the four main directions hold most of the surface.
    fold = np.angle(np.exp(4j * points.alpha).sum()) / 4
    assert (np.abs(np.sin(2 * (points.alpha - fold))) < np.sin(np.deg2rad(20))).mean() > 0.5
