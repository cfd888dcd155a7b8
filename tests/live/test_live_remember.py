"""The pose of a robot that was switched off: kept whole, and used only if a scan says so."""

import json
from dataclasses import asdict, replace

import numpy as np
import pytest
from command import MAPS

import imgloc
from imgloc import ConfigError, LaserScan, Pose2D
from imgloc.live.remember import MOVED, REFUSED, RESTORED, Kept, checked, identity, load_kept

KEPT = Kept("hall", "an identity", Pose2D(3.0, 2.0, 0.5), 1000.25)
TEXT = json.dumps(asdict(KEPT))


@pytest.fixture(scope="module")
def curved():
    return imgloc.prepare(imgloc.load_map(MAPS / "curved.yaml"))


def test_what_is_kept_is_read_again_and_replaces_what_was_there(tmp_path) -> None:
    file = tmp_path / "robot.json"
    assert load_kept(file) is None
    for kept in (KEPT, replace(KEPT, stamp=1001.0)):
        kept.save(file)
        assert load_kept(file) == kept
    assert [path.name for path in tmp_path.iterdir()] == ["robot.json"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "expected"),
        ("hello", "not JSON"),
        ("{}", "map"),
        (TEXT.replace("3.0", '"3"'), "pose.x"),
        (TEXT.replace("3.0", "NaN"), "pose.x"),
        (TEXT.replace("3.0", "1e999"), "pose.x"),
    ],
)
def test_a_file_that_is_none_is_named_and_left_alone(tmp_path, text, said) -> None:
    file = tmp_path / "robot.json"
    file.write_text(text)
    with pytest.raises(ConfigError, match=r"robot\.json") as raised:
        load_kept(file)
    assert said in str(raised.value)
    assert file.read_text() == text


def test_maps_are_told_apart_by_cells_resolution_and_origin(curved) -> None:
    grid = curved.grid
    moved = replace(grid, origin=Pose2D(1.0, 0.0))
    finer = replace(grid, resolution=grid.resolution / 2)
    redrawn = replace(grid, free=grid.free & (np.arange(grid.free.shape[1]) > 40))
    assert len({identity(one) for one in (grid, moved, finer, redrawn)}) == 4


def test_a_scan_decides_whether_a_remembered_pose_holds(curved) -> None:
    scans = imgloc.simulate(curved.grid, 1, seed=1)
    scan = replace(scans[0], T_base_laser=Pose2D(0.2, 0.0))
    true = imgloc.model.base_of(Pose2D(*scans.poses[0]), scan.T_base_laser)
    answer = imgloc.localize(curved, scan)
    here = Kept("curved", identity(curved.grid), true, 0.0)
    away = replace(here, pose=Pose2D(true.x + 2.0, true.y, true.theta))
    redrawn = replace(here, identity="x")
    for kept, expected in ((here, RESTORED), (away, MOVED), (redrawn, RESTORED)):
        said, pose = checked(kept, answer, identity(curved.grid))
        assert said == expected
        assert (pose.x, pose.y) == pytest.approx((true.x, true.y), abs=0.1)


def test_a_robot_that_was_moved_while_the_map_was_changed_is_told_nothing(curved) -> None:
    scans = imgloc.simulate(curved.grid, 1, seed=1)
    away = Kept("curved", "another map", Pose2D(1.0, 1.0), 0.0)
    answer = imgloc.localize(curved, scans[0])
    assert answer.verdict == "unique"
    assert checked(away, answer, identity(curved.grid)) == (REFUSED, None)


def test_a_scan_that_is_not_sure_refuses_even_the_place_that_fits_best(curved) -> None:
    scans = imgloc.simulate(curved.grid, 1, seed=1)
    few = LaserScan(scans[0].ranges[:12], scans[0].angles[:12], range_max=scans[0].range_max)
    answer = imgloc.localize(curved, few)
    assert answer.verdict != "unique"
    here = Kept("curved", identity(curved.grid), Pose2D(*scans.poses[0]), 0.0)
    assert checked(here, answer, identity(curved.grid)) == (REFUSED, None)
