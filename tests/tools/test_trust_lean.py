"""Pairs of scans show by how much poses lean, whatever the map says."""

from dataclasses import replace

import numpy as np
import pytest
from command import run

from imgloc import Sensor, prepare
from imgloc.features.scanpoints import scan_points
from imgloc.simulation.scans import simulate
from tools.recorded import in_world
from tools.trust.__main__ import main
from tools.trust.lean import Lean, laid_over, lean, lean_of, lean_table, moved_between

SENSOR = Sensor(sigma=0.02, fov=np.pi, rays=181, range_max=10.0)


def points_of(scan):
    points = scan_points(scan.ranges, scan.angles, scan.valid)
    return points.select(np.flatnonzero(points.valid))


@pytest.fixture(scope="module")
def there():
    """Scans in a world, their true poses, and the pairs among them."""
    grid, _ = in_world("double_wall", 1, 1)
    scans = simulate(grid, 60, 3, SENSOR)
    poses = np.array([pose for _, pose in scans.with_poses()])
    return (grid, scans, poses, *moved_between(scans.scans, poses))


@pytest.mark.parametrize("forward", [-0.05, 0.0, 0.05])
def test_poses_that_are_moved_forward_lean_by_as_much(there, forward):
    _, _, poses, pairs, moved = there
    assert len(pairs) > 50
    ahead = np.column_stack((np.cos(poses[:, 2]), np.sin(poses[:, 2]), 0 * poses[:, 2]))
    mean, error = lean_of(poses + forward * ahead, np.zeros(len(poses)), pairs, moved)
    assert mean == pytest.approx(forward, abs=0.01)
    assert 0 < error < 0.01


def test_a_view_to_the_side_leans_to_the_side(there):
    _, _, poses, pairs, moved = there
    left = np.column_stack((-np.sin(poses[:, 2]), np.cos(poses[:, 2]), 0 * poses[:, 2]))
    views = np.full(len(poses), np.pi / 2)
    assert lean_of(poses + 0.05 * left, views, pairs, moved)[0] == pytest.approx(0.05, abs=0.01)


def test_two_scans_are_laid_over_each_other_from_a_start_that_is_off(there):
    _, scans, poses, pairs, moved = there
    (i, j), motion = pairs[0], moved[0]
    c, s = np.cos(poses[i, 2]), np.sin(poses[i, 2])
    true = np.array([[c, s], [-s, c]]) @ (poses[j] - poses[i])[:2]
    assert motion[:2] == pytest.approx(true, abs=0.03)
    a, b = points_of(scans[i]), points_of(scans[j])
    again = laid_over(a, b, motion + (0.1, -0.1, 0.03))
    assert again == pytest.approx(motion, abs=0.01)


def test_a_corridor_and_a_far_start_hold_no_motion(there):
    angles = np.deg2rad(np.arange(-90, 90.5))
    ranges = 1 / np.maximum(np.abs(np.sin(angles)), 0.05)
    wall = scan_points(ranges, angles, np.ones(len(angles), bool))
    wall = wall.select(np.flatnonzero(wall.valid))
    assert laid_over(wall, wall, np.zeros(3)) is None
    _, scans, _, pairs, moved = there
    a, b = (points_of(scans[k]) for k in pairs[0])
    assert laid_over(a, b, moved[0] + (3.0, 0.0, 0.0)) is None


def test_found_poses_do_not_lean_where_recorded_ones_do(there):

    grid, scans, poses, *_ = there
    ahead = np.column_stack((np.cos(poses[:, 2]), np.sin(poses[:, 2]), 0 * poses[:, 2]))
    told = lean("world", prepare(grid), replace(scans, poses=poses + 0.08 * ahead))
    assert told.scans > 30
    assert told.pairs > 20
    assert abs(told.found[0]) < 0.02
    assert told.recorded[0] == pytest.approx(0.08, abs=0.015)


def test_without_pairs_there_is_no_lean():
    none = np.empty((0, 2), dtype=np.int64)
    assert np.isnan(lean_of(np.zeros((1, 3)), np.zeros(1), none, np.empty((0, 3)))).all()
    row = Lean("a", 3, 2, (0.012, 0.003), (-0.05, 0.01))
    alone = Lean("b", 1, 0, (np.nan, np.nan), (np.nan, np.nan))
    assert lean_table([row, alone]).splitlines()[2:] == [
        "| a | 3 | 2 | +1.2 +- 0.3 | -5.0 +- 1.0 |", "| b | 1 | 0 | no pairs | no pairs |"
    ]  # fmt: skip


def test_the_command_prints_a_table(shared):
    found = run(main, "lean", "-n", 6, "--sets", shared / "data/gh25/map.yaml").ends(0)
    assert found.out.splitlines()[2].startswith("| gh25 | ")
