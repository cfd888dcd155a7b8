"""The floor that a tilted laser sees: on tiny scans, against a literal count, and on a map."""

import math
from dataclasses import replace

import numpy as np
import pytest
from command import MAPS, call, rows

import imgloc
from imgloc import Evidence, Floor, LaserScan
from imgloc.features.floor import as_located, floors, left_out

ANGLES = np.deg2rad(np.arange(-180.0, 180.0))


def room(width: float = 16.0, height: float = 14.0) -> np.ndarray:
    """Ranges (360,) in the middle of a room, metres."""
    c, s = np.abs(np.cos(ANGLES)), np.abs(np.sin(ANGLES))
    return np.minimum(width / 2 / np.maximum(c, 1e-9), height / 2 / np.maximum(s, 1e-9))


def line(distance: float, direction: float) -> np.ndarray:
    """Ranges (360,) of a floor, metres."""
    ahead = np.cos(ANGLES - direction)
    return np.where(ahead > 0.05, distance / np.maximum(ahead, 0.05), np.inf)


def lines_of(scan: LaserScan) -> list[Floor]:
    """Lines ahead: a wall of the room to the side may be one, too."""
    return [floor for floor in floors(scan) if abs(floor.direction) < 0.1]


@pytest.mark.parametrize("direction", np.deg2rad([0.0, 0.4, 77.3, 180.0, -90.0, -135.5]))
def test_a_floor_is_found_where_it_is(direction: float) -> None:
    floor = line(3.0, direction)
    scan = LaserScan(np.minimum(room(), floor), ANGLES, range_max=20.0)
    found = floors(scan)[0]
    assert found.distance == pytest.approx(3.0, abs=0.02)
    assert abs(math.remainder(found.direction - direction, math.tau)) < math.radians(0.3)
    on = floor < room()
    assert found.share == pytest.approx(on.mean(), abs=0.02)
    rest = left_out(scan, found)
    assert not rest.valid[on].any()
    kept = room() < floor - 0.3
    assert np.array_equal(rest.ranges[kept], scan.ranges[kept])


def test_a_circle_is_a_floor_all_around() -> None:
    scan = LaserScan(np.minimum(room(), 7.5), ANGLES, range_max=20.0)
    circle = floors(scan)[-1]
    assert math.isnan(circle.direction)
    assert circle.distance == pytest.approx(7.5, abs=0.01)
    assert circle.share == pytest.approx(np.mean(room() > 7.5), abs=0.05)
    assert np.isnan(left_out(scan, circle).ranges[room() > 7.5]).all()


@pytest.mark.parametrize("beyond", [7.0, np.inf, 30.0])
def test_what_is_seen_through_is_no_floor(beyond: float) -> None:
    # A door of 20 degrees in the wall ahead; inf and 30 m are no return of a sensor of 20 m.
    ranges = np.minimum(room(), line(3.0, 0.0))
    ranges[np.abs(ANGLES) < np.deg2rad(10)] = beyond
    assert lines_of(LaserScan(ranges, ANGLES, range_max=20.0)) == []
    ranges[np.abs(ANGLES) < np.deg2rad(10)] = np.nan  # the floor may swallow a ray
    assert len(lines_of(LaserScan(ranges, ANGLES, range_max=20.0))) == 1


def test_a_near_wall_a_short_line_and_an_empty_scan_are_no_floor() -> None:
    near = LaserScan(np.minimum(room(), line(1.5, 0.0)), ANGLES, range_max=20.0)
    assert all(floor.distance > 2 for floor in floors(near))
    short = np.full(360, 0.5)
    short[100:130] = 3.0 / np.cos(ANGLES[100:130] - ANGLES[115])
    assert lines_of(LaserScan(short, ANGLES)) == []
    assert floors(LaserScan(np.full(360, np.inf), ANGLES)) == []
    assert floors(LaserScan([], [])) == []


def test_on_and_beyond_are_counted_as_literal_loops_do() -> None:
    rng = np.random.default_rng(4)
    ranges = np.minimum(np.minimum(room(), line(3.3, 0.05)) + 0.02 * rng.standard_normal(360), 19.0)
    (found,) = lines_of(LaserScan(ranges, ANGLES, range_max=20.0))
    on = beyond = 0
    for distance, angle in zip(ranges, ANGLES, strict=True):
        depth = distance * math.cos(angle - found.direction)
        on += abs(depth - found.distance) < 0.12
        beyond += depth > found.distance + 0.36
    assert found.share == on / 360
    assert beyond <= 0.02 * on


def test_readings_are_left_out_before_they_are_scaled() -> None:
    scan = LaserScan([3.0, 4.0], [0.0, 1.5], range_max=9.0)
    used = as_located(scan, Evidence(scale=2.0, floor=Floor(3.0, 0.0, 0.5)))
    assert np.isnan(used.ranges[0])
    assert used.ranges[1] == 8.0
    assert as_located(scan, Evidence()).ranges.tolist() == [3.0, 4.0]


@pytest.fixture(scope="module")
def tilted() -> tuple[imgloc.OccupancyGrid, imgloc.ScanSet]:
    """Scans of a laser whose floor is a line 4 m ahead."""
    grid = imgloc.load_map(MAPS / "large.yaml")
    scans = imgloc.simulate(grid, 6, seed=3)
    some = []
    for scan in scans.scans:
        ahead = np.cos(scan.angles)
        floor = np.where(ahead > 0.05, 4.0 / np.maximum(ahead, 0.05), np.inf)
        some.append(replace(scan, ranges=np.minimum(scan.ranges, floor)))
    return grid, replace(scans, scans=tuple(some))


def test_a_tilted_laser_is_located_and_the_floor_is_named(tilted, tmp_path) -> None:
    _, scans = tilted
    imgloc.save_scans(tmp_path / "tilted.npz", scans)
    run = call("localize", MAPS / "large.yaml", tmp_path / "tilted.npz", "--json").ends(0)
    found = rows(run.out)
    floored = [row for row in found if row["evidence"]["floor"] > 0]
    assert len(floored) >= 4
    for row, pose in zip(found, scans.poses, strict=True):
        if row["evidence"]["floor"] > 0 and row["verdict"] == "unique":
            at = row["pose"]
            assert math.hypot(at["x"] - pose[0], at["y"] - pose[1]) < 0.25
            assert row["evidence"]["floor_distance"] == pytest.approx(4.0, abs=0.1)
            assert row["evidence"]["floor_direction"] == pytest.approx(0.0, abs=0.02)
            assert row["explained"] < 1 - row["evidence"]["floor"] + 0.1
    assert sum(row["verdict"] == "unique" for row in floored) >= 2
    run = call("localize", MAPS / "large.yaml", tmp_path / "tilted.npz", "--scans-index", 0)
    assert "of the rays: they end on a line 4.0 m away at" in run.out
    assert "is the laser tilted" in run.err
    run = call("batch", MAPS / "large.yaml", tmp_path / "tilted.npz", "--out", tmp_path / "out")
    assert "is the laser tilted" in run.out


def test_a_reading_at_the_edge_of_a_bin_is_on_its_floor() -> None:
    # 3.00 m is a whole number of bins of 0.12 m.
    ranges = [3.00, 0.50, 1.00, 0.30, 0.50, 0.50, 0.50, 1.00, 0.50, 0.50]
    for scan in (
        LaserScan(ranges, np.linspace(0, np.pi, 10), range_max=30.0),
        *(LaserScan(np.full(360, far), ANGLES, range_max=30.0) for far in (3.0, 6.0, 12.0, 10.32)),
    ):
        for floor in floors(scan):
            assert math.isfinite(floor.distance)
            assert floor.share >= 0.1
    circle = floors(LaserScan(np.full(360, 12.0), ANGLES, range_max=30.0))[-1]
    assert (circle.distance, circle.share) == (12.0, 1.0)


@pytest.mark.parametrize("seed", range(40))
def test_what_is_returned_keeps_all_limits(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ranges = np.minimum(room(*rng.uniform(3, 16, 2)), line(*rng.uniform((1.5, -3), (6, 3))))
    ranges += rng.choice([0.0, 0.02, 0.1]) * rng.standard_normal(360)
    scan = LaserScan(np.maximum(ranges, 0.01), ANGLES, range_max=20.0)
    for floor in floors(scan):
        assert floor.distance >= 2.0
        assert floor.share >= 0.1
        turn = 1 if math.isnan(floor.direction) else np.cos(ANGLES - floor.direction)
        beyond = np.sum(scan.ranges * turn > floor.distance + 0.24)
        assert beyond <= 0.02 * floor.share * 360


def test_a_place_where_a_lorry_stands_wins_against_one_where_it_would_be_floor() -> None:
    grid = imgloc.load_map(MAPS / "large.yaml")
    scan, pose = list(imgloc.simulate(grid, 36, seed=3).with_poses())[-1]
    ahead, across = np.cos(scan.angles), 2.2 * np.tan(scan.angles)
    side = np.where((ahead > 0) & (np.abs(across) < 2.5), 2.2 / ahead, np.inf)
    lorry = replace(scan, ranges=np.minimum(scan.ranges, side))
    assert floors(lorry)
    answer = imgloc.localize(imgloc.prepare(grid), lorry)
    assert answer.evidence.floor is None
    assert math.hypot(answer.best.x - pose[0], answer.best.y - pose[1]) < 0.1
