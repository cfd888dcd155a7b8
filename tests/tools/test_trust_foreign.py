"""Scans that are on no map: the questions, how answers are counted, and the tool."""

import numpy as np
import pytest

from imgloc import Hypothesis, Localization, Pose2D, save_map, simulate
from imgloc.features.distance import distance_image
from imgloc.features.raycast import cast_rays
from imgloc.simulation.worlds import WORLDS, render
from tools.plans.drawing import building, true_world
from tools.trust import foreign
from tools.trust.__main__ import main
from tools.trust.disturb import PRIORS, ROOMS, half_of
from tools.trust.foreign import (
    WITHOUT,
    Asked,
    at_home,
    floors_of,
    foreign_table,
    naming_table,
    on_other_floors,
    rooms_and_others,
    told,
)
from tools.trust.racks import CELL, CHANGES, in_racks
from tools.trust.things import PLACED, ROOM, THINGS


@pytest.fixture(scope="module", autouse=True)
def two_floors():
    """Of each building, instead of four, whose scans are simulated on the cells of the map."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(foreign, "FLOORS", 2)
        patch.setattr(foreign, "FINE", foreign.CELL)
        yield


@pytest.fixture(scope="module")
def floors(two_floors):
    return floors_of(3, 2)


def test_floors_share_their_shell_and_have_other_rooms(floors):
    first, second = (building(3, floor=k) for k in (0, 1))
    for a, b in zip(first.walls[:6], second.walls[:6], strict=True):
        np.testing.assert_array_equal(a[0], b[0])
        np.testing.assert_array_equal(a[1], b[1])
    assert len(first.walls) != len(second.walls) or any(
        np.any(a[0] != b[0]) for a, b in zip(first.walls[6:], second.walls[6:], strict=True)
    )
    again = building(3, floor=0)
    np.testing.assert_array_equal(true_world(first).occupied, true_world(again).occupied)
    assert floors[0][1].occupied.shape == floors[1][1].occupied.shape
    assert (floors[0][1].occupied != floors[1][1].occupied).any()


def test_each_scan_is_asked_for_where_it_is_and_where_it_is_not(floors):
    asked = [(grid, a) for grid, some in on_other_floors(floors) for a in some]
    own = [(grid, a) for grid, a in asked if a.row == "own floor"]
    assert len(own) == 2 * len(floors)
    assert all(a.pose is None for _, a in asked if a.row != "own floor")
    (_, grid, scans) = floors[1]
    other = next(some for g, some in on_other_floors(floors) if g is grid)
    here = {id(scan) for scan in scans.scans}
    assert all((id(a.scan) in here) == (a.row == "own floor") for a in other)
    flipped = next(g for g, a in asked if a.row == "mirrored plan")
    np.testing.assert_array_equal(flipped.occupied, floors[0][1].occupied[:, ::-1])


def test_halves_of_a_map_are_asked_for_scans_of_both():
    grid = render(WORLDS["curved"](), 0.1)
    maps = list(at_home([("curved", grid, simulate(grid, 8, 0))]))
    assert [len(some) for _, some in maps] == [n * (1 + len(PRIORS)) for n in (8, 2, 2, 2, 2)]
    for a, b in ((1, 2), (3, 4)):
        assert not (maps[a][0].free & maps[b][0].free).any()
        np.testing.assert_array_equal(maps[a][0].free | maps[b][0].free, grid.free)
    np.testing.assert_array_equal(half_of(grid, 2).free, maps[3][0].free)


def test_rooms_and_other_buildings_are_never_of_the_map():
    grids = {name: render(WORLDS[name](), 0.1) for name in ("curved", "visibility")}
    scans = {name: simulate(grid, 2, 0).scans for name, grid in grids.items()}
    for name, (_, some) in zip(grids, rooms_and_others(grids, scans, 1, 0, {}), strict=True):
        assert {a.row for a in some} == {"another building", *ROOMS}
        assert len(some) == 5 * (1 + len(PRIORS))
        assert all(a.pose is None and not any(a.scan is s for s in scans[name]) for a in some)
    alone = rooms_and_others(grids, scans, 1, 0, {"curved": "one", "visibility": "one"})
    assert all(a.row != "another building" for _, some in alone for a in some)


def test_unique_is_wrong_on_another_map_and_at_another_place(floors):
    scan = floors[0][2].scans[0]
    here = Hypothesis(Pose2D(1.0, 2.0, 0.3), 0.0, 0.95, np.eye(3))
    sure, unsure = (Localization((here,), v, 0.0, 1.0) for v in ("unique", "ambiguous"))
    at = np.array([1.0, 2.0, 0.3])
    for pose, answer, wrong in (
        (at, sure, False), (at + 2, sure, True), (at + 2, unsure, False), (None, sure, True),
        (None, unsure, False),
    ):  # fmt: skip
        assert told(Asked("some", "house", scan, pose), answer).wrong == wrong
    table = foreign_table([told(Asked("some", "house", scan, None), a) for a in (sure, unsure)])
    assert "| some | nothing known | 2 | 0 | 1 | 1 (50.0 %) | 1 | 0 |" in table
    named = naming_table([("right", "none"), ("undecided", "wrong")])
    assert "| floors without the true one | 2 | 0 (0.0 %) | 1 (50.0 %) | 0 (0.0 %) |" in named


def test_the_tool_prints_two_tables(capsys, tmp_path):
    path = tmp_path / "curved" / "map.yaml"
    path.parent.mkdir()
    save_map(path, render(WORLDS["curved"](), 0.1))
    assert main(["foreign", "-n", "1", "--buildings", "1", "--maps", str(path)]) == 0
    places, named = capsys.readouterr().out.split("\n\n")
    for row in (*ROOMS, "own floor", "another floor", "mirrored plan"):
        assert (
            f"| {row} | nothing known | {2 if 'floor' in row or 'plan' in row else 1} |" in places
        )
    assert "| floors with the true one | 2 |" in named
    assert main(["foreign", "-n", "0"]) == 2


def test_racks_change_where_they_say_and_the_robot_stands_beside_them():
    mapped, _ = in_racks("racks", 1, 3)
    for change, most in zip(CHANGES, (0.0, 0.04, 0.12, 0.2), strict=True):
        grid, scans = in_racks(change, 6, 3)
        np.testing.assert_array_equal(grid.occupied, mapped.occupied)
        seen = [
            cast_rays(distance_image(grid.occupied), pose[:2], pose[2] + scan.angles, 20.0, CELL)
            for scan, pose in scans.with_poses()
        ]
        off = [
            np.abs(scan.ranges[scan.valid] - far[scan.valid])
            for scan, far in zip(scans.scans, seen, strict=True)
        ]
        differ = float((np.concatenate(off) > 0.4).mean())
        assert differ < 0.01 if most == 0 else 0.01 < differ < 3 * most


def test_things_are_asked_for_at_home_and_away(capsys):
    assert main(["things", "-n", "1", "--worlds", "curved", "--buildings", "0"]) == 0
    lines = capsys.readouterr().out.split("\n")
    rows = {tuple(line.strip("| ").split(" | ")[:2]) for line in lines}
    names = ("undisturbed", ROOM, *THINGS, *CHANGES, "half the map", *ROOMS)
    assert {(name, WITHOUT) for name in names} | {pair[::-1] for pair in PLACED} <= rows
    assert main(["things", "-n", "0"]) == 2
