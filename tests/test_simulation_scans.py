"""The simulator: where poses fall, what a scan reads, what its noise is."""

import numpy as np
import pytest

from imgloc import ConfigError, MapError, OccupancyGrid, Pose2D, Sensor, simulate
from imgloc.geometry import cell_of
from imgloc.simulation.scans import refine_grid, sample_free_poses, simulate_ranges
from imgloc.simulation.worlds import WORLDS, render


def box_grid(height=40, width=60, resolution=0.1):
    occupied = np.zeros((height, width), dtype=bool)
    occupied[[0, -1]] = occupied[:, [0, -1]] = True
    return OccupancyGrid(occupied, ~occupied, resolution)


def test_ranges_in_a_box_from_its_inside():
    poses = [(2.0, 1.0, 0.0), (2.0, 1.0, np.pi / 2)]
    ranges = simulate_ranges(box_grid(), poses, [0.0, np.pi / 2, np.pi, -np.pi / 2], sigma=0.0)
    np.testing.assert_allclose(ranges[0], [3.9, 2.9, 1.9, 0.9], atol=0.002)
    np.testing.assert_allclose(ranges[1], [2.9, 1.9, 0.9, 3.9], atol=0.002)


def test_noise_has_the_sigma_asked_for_and_no_bias():
    poses = np.tile((3.0, 2.0, 0.1), (400, 1))
    angles = np.linspace(-1, 1, 41)
    clean = simulate_ranges(box_grid(), poses[:1], angles, sigma=0.0)
    error = simulate_ranges(box_grid(), poses, angles, sigma=0.05, seed=3) - clean
    assert error.std() == pytest.approx(0.05, rel=0.03)
    assert abs(error.mean()) < 0.002
    assert abs(np.corrcoef(error[:, 0], error[:, 1])[0, 1]) < 0.2  # rays are independent


def test_beyond_range_max_there_is_no_return():
    ranges = simulate_ranges(box_grid(), [(2.0, 2.0, 0.0)], [0.0, np.pi], sigma=0.0, range_max=3.0)
    assert ranges[0, 0] == np.inf
    assert ranges[0, 1] == pytest.approx(1.9, abs=0.002)
    noisy = simulate_ranges(
        box_grid(), [(2.05, 2.0, 0.0)] * 500, [np.pi], sigma=0.1, range_max=1.95
    )
    assert noisy[np.isfinite(noisy)].max() <= 1.95
    assert np.isinf(noisy).mean() == pytest.approx(0.5, abs=0.1)


def test_readings_next_to_a_wall_stay_positive():
    ranges = simulate_ranges(box_grid(), [(0.11, 2.0, np.pi)] * 200, [0.0], sigma=0.1)
    assert ranges.min() > 0


def test_outliers_are_short_and_as_many_as_asked_for():
    poses = sample_free_poses(box_grid(), 100, 1)
    angles = np.linspace(-1.5, 1.5, 50)
    clean = simulate_ranges(box_grid(), poses, angles, sigma=0.0)
    dirty = simulate_ranges(box_grid(), poses, angles, sigma=0.0, outliers=0.3)
    changed = dirty != clean
    assert changed.mean() == pytest.approx(0.3, abs=0.03)
    assert np.all(dirty[changed] < clean[changed] + 1e-3)


def test_outliers_stand_where_there_is_no_wall_too():
    nothing = simulate_ranges(
        box_grid(), [(3.0, 2.0, 0.0)] * 50, [0.0], range_max=1.0, outliers=1.0
    )
    assert np.isfinite(nothing).mean() > 0.9


def test_dropped_readings_are_nan_and_leave_the_others_alone():
    poses = [(3.0, 2.0, 0.0)] * 40
    angles = np.linspace(-1.5, 1.5, 50)
    clean = simulate_ranges(box_grid(), poses, angles, seed=9)
    dropped = simulate_ranges(box_grid(), poses, angles, seed=9, dropped=0.2)
    lost = np.isnan(dropped)
    assert lost.mean() == pytest.approx(0.2, abs=0.03)
    np.testing.assert_array_equal(dropped[~lost], clean[~lost])


def test_poses_keep_their_clearance():
    grid = render(WORLDS["visibility"](), 0.1)
    poses = sample_free_poses(grid, 500, 4, clearance=0.5)
    row, column = cell_of(poses[:, :2], 0.1).T
    assert grid.free[row, column].all()
    corners = np.argwhere(~grid.free) * 0.1
    for x, y, _ in poses[::10]:
        gap = np.maximum(np.maximum(corners - (y, x), (y, x) - corners - 0.1), 0)
        assert np.hypot(*gap.T).min() > 0.5 - 1e-6


def test_poses_cover_free_space_evenly_inside_cells_too():
    free = np.zeros((7, 9), dtype=bool)
    free[3, 2] = free[5, 6] = True
    poses = sample_free_poses(OccupancyGrid(~free, free, 0.5), 4000, 7, clearance=0.0)
    right = poses[:, 0] > 2
    assert right.mean() == pytest.approx(0.5, abs=0.04)
    np.testing.assert_allclose(poses[right].min(axis=0)[:2], (3.0, 2.5), atol=0.01)
    np.testing.assert_allclose(poses[right].max(axis=0)[:2], (3.5, 3.0), atol=0.01)
    assert np.histogram(poses[:, 2], 8, (0, 2 * np.pi))[0].min() > 400


def test_the_border_of_the_map_is_not_free():
    free = np.ones((10, 10), dtype=bool)
    poses = sample_free_poses(OccupancyGrid(~free, free, 0.1), 300, 0, clearance=0.2)
    assert poses[:, :2].min() >= 0.2
    assert poses[:, :2].max() <= 0.8


def test_no_room_is_an_error_that_says_so():
    with pytest.raises(MapError, match=r"2\.5 m"):
        sample_free_poses(box_grid(), 1, 0, clearance=2.5)


def test_the_seed_decides_everything():
    grid = box_grid()
    one, again, other = (simulate(grid, 3, seed, Sensor(outliers=0.1)) for seed in (1, 1, 2))
    for a, b, c in zip(one.scans, again.scans, other.scans, strict=True):
        np.testing.assert_array_equal(a.ranges, b.ranges)
        assert not np.array_equal(a.ranges, c.ranges)
    np.testing.assert_array_equal(one.poses, again.poses)
    assert not np.array_equal(one.poses, other.poses)
    np.testing.assert_array_equal(one.poses, simulate(grid, 3, 1, Sensor(rays=7)).poses)


def test_the_sensor_of_the_paper_is_the_default():
    scans = simulate(box_grid(), 2, 0)
    assert [scan.ranges.shape for scan in scans.scans] == [(181,)] * 2
    assert scans.poses.shape == (2, 3)
    np.testing.assert_allclose(np.rad2deg(scans.scans[0].angles), np.arange(-90, 91))


def test_a_full_circle_has_no_ray_twice():
    angles = simulate(box_grid(), 1, 0, Sensor(rays=360, fov=2 * np.pi)).scans[0].angles
    np.testing.assert_allclose(np.diff(angles), np.deg2rad(1.0))
    assert angles[-1] == pytest.approx(np.pi - np.deg2rad(1.0))


def test_scans_on_the_polygons_do_not_know_the_cells():
    world = WORLDS["curved"]()
    grid, fine = render(world, 0.1), render(world, 0.01)
    found = simulate(grid, 4, 5, Sensor(sigma=0.0), fine)
    scans, angles = np.array([scan.ranges for scan in found.scans]), found.scans[0].angles
    poses = np.asarray(found.poses)
    np.testing.assert_array_equal(scans, simulate_ranges(fine, poses, angles, sigma=0.0))
    cells = simulate_ranges(grid, poses, angles, sigma=0.0)
    guess = simulate_ranges(refine_grid(grid), poses, angles, sigma=0.0)
    error = [np.median(np.abs(r - scans)) for r in (cells, guess)]
    assert error[1] < 0.6 * error[0]  # smooth outlines are closer to the truth than stairs
    assert error[1] < 0.03


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"sigma": -0.1}, "sigma"),
        ({"sigma": np.nan}, "sigma"),
        ({"outliers": 1.2}, "outliers"),
        ({"dropped": -0.1}, "dropped"),
        ({"range_max": 0.0}, "range_max"),
        ({"rays": 0}, "rays"),
        ({"fov": 7.0}, "fov"),
    ],
)
def test_nonsense_is_refused(changes, match):
    with pytest.raises(ConfigError, match=match):
        simulate(box_grid(), 1, 0, Sensor(**changes))


@pytest.mark.parametrize("thickness", [1, 2, 3, 5])
def test_refined_walls_stay_where_they_were(thickness):
    occupied = np.zeros((20, 30), dtype=bool)
    occupied[:, 10 : 10 + thickness] = True
    fine = refine_grid(OccupancyGrid(occupied, ~occupied, 0.1))
    edges = np.flatnonzero(np.diff(fine.occupied[100].astype(int))) + 1
    np.testing.assert_allclose(edges, [100, 100 + 10 * thickness], atol=1)


def test_refined_gaps_stay_open_and_diagonal_walls_closed():
    occupied = np.ones((12, 12), dtype=bool)
    occupied[6] = False
    gap = refine_grid(OccupancyGrid(occupied, ~occupied, 0.1))
    assert not gap.occupied[62:68].any()
    wall = np.eye(12, dtype=bool)
    fine = refine_grid(OccupancyGrid(wall, ~wall, 0.1))
    assert fine.occupied[5:-5].any(axis=1).all()
    assert fine.occupied[:, 5:-5].any(axis=0).all()


def test_refined_stairs_become_slopes():
    occupied = np.add.outer(2 * np.arange(20), np.arange(60)) > 60  # a slope of 1 : 2
    fine = refine_grid(OccupancyGrid(occupied, ~occupied, 0.1))
    edge = np.argmax(fine.occupied[30:170], axis=1)
    line = np.polyval(np.polyfit(np.arange(30, 170), edge, 1), np.arange(30, 170))
    coarse = np.argmax(np.repeat(np.repeat(occupied, 10, 0), 10, 1)[30:170], axis=1)
    assert np.abs(edge - line).max() < 0.6 * np.abs(coarse - line).max()


def test_refining_keeps_the_place_and_the_classes():
    world = WORLDS["corridor"]()
    grid = render(world, 0.1)
    grid = OccupancyGrid(grid.occupied, grid.free, 0.1, Pose2D(1, 2, 3))
    fine = refine_grid(grid)
    assert fine.resolution == pytest.approx(0.01)
    assert fine.origin == grid.origin
    assert not np.any(fine.occupied & fine.free)
    truth = render(world, 0.01)
    assert np.mean(fine.occupied != truth.occupied) < 0.01
    assert np.mean(fine.free != truth.free) < 0.01


@pytest.mark.parametrize(("cells", "factor"), [(90_000, 3), (10_000, 1)])
def test_refining_is_bounded(cells, factor, monkeypatch):
    monkeypatch.setattr("imgloc.simulation.scans._MAX_CELLS", cells)
    fine = refine_grid(box_grid(100, 100)).occupied
    assert fine.shape == (100 * factor, 100 * factor)


def test_a_sensor_that_is_never_over_free_cells_is_refused():
    free = np.ones((20, 20), bool)
    with pytest.raises(MapError, match="hardly ever in a free cell"):
        sample_free_poses(OccupancyGrid(~free, free, 0.1), 1, 0, 0.1, Pose2D(4.0, 0.0))
