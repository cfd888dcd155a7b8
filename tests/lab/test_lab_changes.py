"""Where a map has aged: gone, new, people who walk by, frames, the mended map, the command."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command import call

from imgloc import ScanSet, load_map, map_changes, save_map, save_scans, sure_poses
from imgloc.features.distance import distance_image
from imgloc.features.raycast import cast_rays
from imgloc.geometry import transform_poses
from imgloc.lab.picture import GONE, NEW, draw_changes
from imgloc.model import Hypothesis, LaserScan, Localization, OccupancyGrid, Pose2D

ANGLES = np.deg2rad(np.arange(-180.0, 180.0))
CORNER = Pose2D(-3.0, 5.0, 0.7)
POSES = np.array([(x, y, x) for x in (1.0, 2.3, 6.5, 7.1) for y in (1.2, 4.7)])


def hall() -> np.ndarray:
    """Walls of 8 x 6 m at 0.1 m, with a corner that tells its ends apart."""
    wall = np.pad(np.zeros((56, 76), bool), 2, constant_values=True)
    wall[2:12, 12:22] = wall[50:58, 60:62] = True
    return wall


def scanned(wall: np.ndarray, poses: np.ndarray, stamps=None, sigma=0.01) -> list[LaserScan]:
    """Scans in walls at 0.1 m, poses in the grid frame."""
    rng, walls = np.random.default_rng(1), distance_image(wall)
    return [
        LaserScan(
            cast_rays(walls, p[:2], p[2] + ANGLES, 20.0, 0.1) + rng.normal(0, sigma, len(ANGLES)),
            ANGLES, range_max=20.0, stamp=math.nan if stamps is None else stamps[k],
        )
        for k, p in enumerate(poses)
    ]  # fmt: skip


def changed(old: np.ndarray, scans, poses=POSES):
    grid = OccupancyGrid(old, ~old, 0.1, CORNER)
    return map_changes(grid, scans, transform_poses(CORNER, poses))


@pytest.fixture
def moved():
    """A map with a block that now stands elsewhere."""
    old, now = hall(), hall()
    old[30:36, 38:44] = True  # 3.8 to 4.4 m, 3.0 to 3.6 m
    now[15:20, 50:58] = True
    return old, now


def test_a_map_that_has_not_changed_says_so():
    found = changed(hall(), scanned(hall(), POSES))
    assert found.gone_share == found.gone_m == found.new_m2 == 0
    assert found.pieces == ()
    assert found.seen_m > 20


def test_what_is_gone_and_what_is_new_are_found_where_they_are(moved):
    old, now = moved
    found = changed(old, scanned(now, POSES))
    block = np.zeros_like(old)
    block[30:36, 38:44] = True
    assert (found.gone & ~block).sum() == 0
    assert (found.gone & block).sum() >= 34
    assert found.gone_m == pytest.approx(2.4, abs=0.4)  # the four faces, corners cut
    row, column = np.nonzero(found.new)
    assert len(row) >= 15
    assert (row.min(), row.max()) >= (14, 19)
    assert row.max() <= 20
    assert column.min() >= 49
    assert column.max() <= 58
    kinds = [piece.kind for piece in found.pieces]
    assert sorted(set(kinds)) == ["gone", "new"]
    gone = found.pieces[kinds.index("gone")]
    (there,) = transform_poses(CORNER, np.array([(4.1, 3.3, 0.0)]))
    assert (gone.x, gone.y) == pytest.approx((there[0], there[1]), abs=0.08)
    assert gone.length == pytest.approx(0.6, abs=0.11)
    assert 3 <= gone.scans <= 8


def test_poses_that_are_a_little_off_change_nothing():
    poses = POSES + np.random.default_rng(2).normal(0, (0.02, 0.02, 0.004), POSES.shape)
    found = changed(hall(), scanned(hall(), POSES, sigma=0.02), poses)
    assert found.gone_share < 0.005
    assert found.new_m2 < 0.02


def test_people_who_walk_by_are_no_walls():
    scans = []
    for k, pose in enumerate(POSES):
        with_legs = hall()
        with_legs[28 + k : 31 + k, 30 + 2 * k : 33 + 2 * k] = True  # moves on from scan to scan
        scans += scanned(with_legs, pose[None])
    found = changed(hall(), scans)
    assert found.new_m2 == 0


def test_one_place_at_one_time_is_not_enough(moved):
    old, now = moved
    same = np.repeat(POSES[:1], 6, axis=0)
    assert changed(old, scanned(now, same), same).pieces == ()
    later = changed(old, scanned(now, same, stamps=[0, 1, 2, 500, 501, 900]), same)
    assert {piece.kind for piece in later.pieces} == {"gone", "new"}


def test_the_mended_map_is_the_map_as_it_is(moved):
    old, now = moved
    found = changed(old, scanned(now, POSES))
    again = map_changes(found.mended, scanned(now, POSES), transform_poses(CORNER, POSES))
    assert again.gone_share < 0.005
    assert again.new_m2 <= 0.05
    assert found.grid.occupied[33, 41]
    assert found.mended.free[33, 41]
    assert found.mended.occupied[16:19, 50].any()


def test_without_scans_nothing_is_said():
    found = changed(hall(), [], np.zeros((0, 3)))
    assert math.isnan(found.gone_share)
    assert found.as_row()["gone_share"] is None
    assert "no wall was looked at" in found.text("a.yaml", 4)
    with pytest.raises(ValueError, match="a pose for each of 1"):
        changed(hall(), scanned(hall(), POSES[:1]), POSES)


def test_only_sure_poses_count():
    def answer(verdict: str, complete: bool = True) -> Localization:
        one = Hypothesis(Pose2D(1.0, 2.0, 3.0), 0.0, 1.0, np.eye(3))
        return Localization((one,), verdict, 0.0, 1.0, complete=complete)

    answers = [answer("ambiguous"), answer("unique"), answer("no-match"), answer("unique", False)]
    sure, poses = sure_poses(answers)
    assert sure == [1]
    assert poses.tolist() == [[1.0, 2.0, 3.0]]
    assert sure_poses([])[1].shape == (0, 3)


def test_scans_that_leave_the_map_say_nothing_of_it():
    scans = scanned(hall(), POSES)
    far = changed(hall(), scans, POSES + (900.0, 0.0, 0.0))
    assert far.pieces == ()


def test_the_picture_has_both_colours_upside_up(moved):
    old, now = moved
    picture = draw_changes(changed(old, scanned(now, POSES)))
    for colour, (x, y) in ((GONE, (41, 33)), (NEW, (54, 17))):
        row, column = np.nonzero((picture.image == colour).all(axis=2))
        found = np.median(column), np.median(row)
        assert found == pytest.approx(picture.pixels(np.array([(x, y)]) * 0.1)[0], abs=35)


def test_the_command_counts_draws_and_mends(moved, tmp_path):
    old, now = moved
    path = tmp_path / "old.yaml"
    save_map(path, OccupancyGrid(old, ~old, 0.1, CORNER))
    before = (tmp_path / "old.png").read_bytes()
    save_scans(tmp_path / "log.npz", ScanSet(tuple(scanned(now, POSES))))
    given = call(
        "map", "changes", path, tmp_path / "log.npz", "--json", "--no-cache", "--out",
        tmp_path / "aged.png", "--update", tmp_path / "new.yaml",
    ).ends(0)  # fmt: skip
    row = json.loads(given.out)
    assert row["given"] == 8
    assert row["scans"] >= 6
    assert row["gone_m"] > 1.5
    assert row["new_m2"] > 0.1
    assert (tmp_path / "old.png").read_bytes() == before
    assert load_map(tmp_path / "new.yaml").free[33, 41]
    text = call("map", "changes", tmp_path / "new.yaml", tmp_path / "log.npz", "--no-cache").out
    assert ": 0.0 % of its walls are gone" in text
    both = ("--out", tmp_path / "b.png", "--update", tmp_path / "b.yaml")
    slip = call("map", "changes", path, tmp_path / "log.npz", *both)
    assert (slip.code, "--out, --update: both would write" in slip.err) == (2, True)
    assert not (tmp_path / "b.png").exists()
    slip = call("map", "changes", path, tmp_path / "log.npz", "--update", path, "--force")
    assert (slip.code, "is read by this command" in slip.err) == (1, True)


@pytest.fixture
def logs(moved, tmp_path, monkeypatch):
    """A map that has aged and two logs of four scans, in the working folder."""
    old, now = moved
    monkeypatch.chdir(tmp_path)
    save_map("old.yaml", OccupancyGrid(old, ~old, 0.1, CORNER))
    Path("logs").mkdir()
    scans = scanned(now, POSES)
    for name, some in (("a", scans[:4]), ("b", scans[4:])):
        save_scans(f"logs/{name}.npz", ScanSet(tuple(some)))


def aged(*given: object) -> dict:
    found = call("map", "changes", "old.yaml", *given, "--json", "--no-cache").ends(0)
    return json.loads(found.out)


def test_several_logs_count_together(logs):
    both = aged("logs/a.npz", "logs/b.npz")
    assert both["given"] == 8
    assert both["gone_m"] > 1.5
    assert aged("logs/a.npz")["given"] == 4


def test_a_log_with_odometry_is_followed_and_so_scans_count_that_see_little(logs, moved):
    way = np.column_stack((np.arange(1.0, 7.0, 0.3), np.full(20, 4.3), np.zeros(20)))
    scans = [
        replace(scan, ranges=np.where(np.abs(ANGLES) < 0.4, scan.ranges, np.nan)) if k % 2 else scan
        for k, scan in enumerate(scanned(moved[1], way))
    ]
    save_scans("way.npz", ScanSet(tuple(scans), odom=way))
    save_scans("alone.npz", ScanSet(tuple(scans)))
    alone, along = aged("alone.npz"), aged("way.npz")
    assert alone["given"] == along["given"] == 20
    assert along["scans"] > alone["scans"]
    assert along["gone_m"] > 0.9
    assert aged("way.npz", "way.npz") == along


def test_a_scan_that_several_files_have_counts_once(logs):
    once = aged("logs/a.npz", "logs/b.npz")
    Path("copy.npz").write_bytes(Path("logs/a.npz").read_bytes())
    twice = ("map", "changes", "old.yaml", "logs/a.npz", "logs/b.npz", "copy.npz", "logs/b.npz")
    found = call(*twice, "--json", "--no-cache")
    assert json.loads(found.out) == once
    assert "copy.npz: 4 of its scans are in a file before, and count once" in found.err
