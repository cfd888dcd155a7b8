"""Two maps of one place: turned, cut, coarser, symmetric; scans in both; the command."""

import csv
import json
import math

import numpy as np
import pytest
from command import MAPS, call, fed
from places import hall

from imgloc import ConfigError, MapError, load_map, load_scans, save_map
from imgloc.geometry import transform_poses
from imgloc.io.files import map_name
from imgloc.lab.align import ScanAlignment, align_maps, align_scans, differences
from imgloc.lab.aligned import (
    ONLY_A,
    ONLY_B,
    alignment_text,
    draw_alignment,
    moved_text,
    read_poses,
)
from imgloc.model import Hypothesis, Localization, OccupancyGrid, Pose2D, compose, inverse
from tools.maps import turned


def room() -> np.ndarray:
    """Walls of a flat without any symmetry, 8 x 6 m at 0.1 m."""
    wall = np.pad(np.zeros((56, 76), bool), 2, constant_values=True)
    wall[2:40, 30:32] = wall[38:40, 30:60] = wall[20:22, 50:78] = True
    wall[45:50, 10:18] = True
    return wall


@pytest.fixture(scope="module")
def a():
    return OccupancyGrid(room(), ~room(), 0.1, Pose2D(-3.0, 2.0, 0.4))


@pytest.mark.parametrize(
    ("theta", "cell"), [(0.0, 0.1), (2.4, 0.07), (-math.pi / 2, 0.1), (math.pi, 0.13)]
)
def test_a_map_is_found_turned_by_any_angle_with_other_cells_and_origin(a, theta, cell):
    b, truth = turned(a, theta, cell, Pose2D(7.0, -4.0, -1.0))
    found = align_maps(a, b)
    assert found.verdict == "unique"
    off = compose(inverse(truth), found.pose)
    at = compose(inverse(truth), compose(found.pose, Pose2D(4.0, 3.0)))
    assert math.hypot(at.x - 4, at.y - 3) < 0.04
    assert abs(off.theta) < math.radians(0.3)
    agree = found.best.agreement
    assert agree.share > 0.95
    assert agree.overlap > 0.9
    assert agree.residual < 0.04
    poses = np.array([[1.0, 2.0, 3.0]])
    there = transform_poses(truth, poses)
    assert np.abs(found.move(poses) - there).max() < 0.06


def test_parts_of_a_map_that_share_half_come_first_where_they_belong(a):
    left, right = a.free.copy(), a.free.copy()
    left[:, 60:] = right[:, :20] = False
    parts = [
        OccupancyGrid(a.occupied & seen, free, 0.1, a.origin)
        for free, seen in ((left, np.arange(80) < 60), (right, np.arange(80) >= 20))
    ]
    b, truth = turned(parts[1], 1.0, 0.1, Pose2D(0.0, 0.0))
    found = align_maps(parts[0], b)
    assert found.verdict in ("unique", "ambiguous")  # other corners are much alike
    off = compose(inverse(truth), found.pose)
    assert math.hypot(off.x, off.y) < 0.06
    assert found.best.agreement.overlap < 0.8


def test_walls_that_are_drawn_thicker_do_not_pull_it_aside(a):
    thick = a.occupied.copy()
    for axis in (0, 1):
        thick |= np.roll(thick, 1, axis) | np.roll(thick, -1, axis)
    found = align_maps(a, OccupancyGrid(thick, a.free & ~thick, 0.1, a.origin))
    assert found.verdict == "unique"
    assert math.hypot(found.pose.x, found.pose.y) < 0.02
    assert 2 * found.best.bend.pose[4] == pytest.approx(0.2, abs=0.03)


def test_a_scale_is_found_if_it_is_free(a):
    b = OccupancyGrid(a.occupied, a.free, 0.111, Pose2D(0.0, 0.0))
    found = align_maps(a, b, scale=True)
    assert found.verdict == "unique"
    assert found.best.scale == pytest.approx(0.1 / 0.111, abs=0.004)


@pytest.mark.parametrize("cell", [0.125, 0.08])
def test_a_scale_at_either_end_of_the_range_is_found_and_not_beyond_it(a, cell):
    found = align_maps(a, OccupancyGrid(a.occupied, a.free, cell), scale=True)
    assert found.verdict == "unique"
    assert 0.8 <= found.best.scale <= 1.25
    assert found.best.scale == pytest.approx(0.1 / cell, abs=0.004)


def test_a_scale_beyond_the_range_is_no_match_and_is_named(a, tmp_path):
    save_map(tmp_path / "a.yaml", a)
    save_map(tmp_path / "b.yaml", OccupancyGrid(a.occupied, a.free, 0.13))
    pair = "map", "align", tmp_path / "a.yaml", tmp_path / "b.yaml", "--scale"
    row = json.loads(call(*pair, "--json").out)
    assert (row["verdict"], row["x"], row["scale"]) == ("no-match", None, None)
    assert row["others"][0]["scale"] == pytest.approx(0.1 / 0.13, abs=0.01)
    given = call(*pair)
    assert f"where the scale of B is {row['others'][0]['scale']:.3f}, expected 0.8 to 1.25" in (
        given.out
    )


def test_a_room_that_is_the_same_turned_by_half_is_ambiguous():
    grid = hall(50, 80)
    found = align_maps(grid, grid)
    assert found.verdict == "ambiguous"
    turns = sorted(round(abs(place.pose.theta), 2) for place in found.places[:2])
    assert turns == [0.0, 3.14]


def test_maps_of_different_places_do_not_match():
    found = align_maps(*(load_map(MAPS / f"{name}.yaml") for name in ("visibility", "double_wall")))
    assert found.verdict == "no-match"
    assert found.pose is None
    row = found.as_row()
    assert row["x"] is row["theta"] is row["residual"] is None
    with pytest.raises(MapError, match="do not match"):
        found.move(np.zeros((1, 3)))


def test_a_map_without_a_wall_is_refused(a):
    free = np.ones((9, 9), bool)
    with pytest.raises(MapError, match="b: no straight wall"):
        align_maps(a, OccupancyGrid(~free, free, 0.1))


def answer(*poses: Pose2D, verdict: str = "unique") -> Localization:
    mass = 1 / max(1, len(poses))
    return Localization(tuple(Hypothesis(p, 0.0, mass, np.eye(3)) for p in poses), verdict, 0.0, 1)


def test_scans_agree_on_a_transform_also_if_they_are_ambiguous_in_one_map():
    T, pairs = Pose2D(3.0, -1.0, 2.0), []
    for k in range(6):
        here = Pose2D(k, 0.3 * k * k, k)
        other = Pose2D(-9.0 + 3 * k, 5.0 * k, 1.0)
        there = [compose(T, here), other][:: -1 if k % 2 else 1]
        pairs.append((answer(*there, verdict="ambiguous"), answer(here)))
    pairs.append((answer(verdict="no-match"), answer(Pose2D(0, 0))))
    found = align_scans(pairs)
    assert (found.used, found.located) == (6, 6)
    off = compose(inverse(T), found.pose)
    assert np.abs((off.x, off.y, off.theta)).max() < 1e-9
    assert found.residual < 1e-9


def test_scans_that_are_no_match_vote_too_but_two_need_a_pose():
    T, off = Pose2D(3.0, -1.0, 2.0), Pose2D(0.0, 0.0)
    here = [Pose2D(k, 0.3 * k * k, k) for k in range(9)]
    pairs = [(answer(compose(T, pose)), answer(pose)) for pose in here[:2]]
    pairs[0] = (answer(compose(pairs[0][0].pose, Pose2D(0.2, 0.0))), pairs[0][1])
    unsure = [(answer(compose(T, p), off, verdict="no-match"), answer(p)) for p in here[2:]]
    found = align_scans(pairs + unsure)
    assert (found.used, found.given, found.located) == (9, 9, 2)
    away = compose(inverse(T), found.pose)
    assert np.abs((away.x, away.y, away.theta)).max() < 0.01
    assert align_scans(pairs[:1] + unsure).pose is None


def test_a_transform_by_chance_has_too_little_mass():
    """All scans of a robot that stands are wrong by the same transform in another building."""
    few = Localization((Hypothesis(Pose2D(1, 2), 0.0, 0.05, np.eye(3)),), "ambiguous", 0.0, 1)
    pairs = [(answer(Pose2D(3, 4)), few)] * 8
    assert align_scans(pairs).pose is None
    assert align_scans(pairs[:6] + [(answer(Pose2D(3, 4)), answer(Pose2D(1, 2)))] * 2).used == 8


def test_a_scan_that_is_far_off_does_not_pull():
    T = Pose2D(1.0, 2.0, -0.5)
    here = [Pose2D(k, (-1) ** k, 0.7 * k) for k in range(7)]
    there = [compose(T, pose) for pose in here]
    there[3] = compose(there[3], Pose2D(0.3, 0.2, 0.05))
    found = align_scans([(answer(a), answer(b)) for a, b in zip(there, here, strict=True)])
    assert found.used == 7
    away = compose(inverse(T), found.pose)
    assert np.abs((away.x, away.y, away.theta)).max() < 0.005


def test_furniture_that_was_moved_does_not_pull_a_map_aside(a):
    """Rounded things beside walls, 0.1 m further along in one map than in the other."""
    rng = np.random.default_rng(5)
    rows, columns = np.mgrid[:120, :160] * 0.05
    walls = np.kron(a.occupied, np.ones((2, 2), bool))
    spots = np.column_stack((rng.uniform(0.5, 5.5, 60), rng.uniform(0.5, 7.5, 60)))
    grids = []
    for off in (0.0, 0.1):
        legs = [np.hypot(rows - y - off, columns - x) < 0.08 for y, x in spots]
        full = walls | np.any(legs, axis=0)
        grids.append(OccupancyGrid(full, ~full, 0.05))
    found = align_maps(*grids)
    moved = found.move(np.array([[x, y, 0.0] for y, x in spots])) - [(x, y, 0) for y, x in spots]
    assert np.abs(np.median(moved, axis=0)).max() < 0.005


def test_scans_that_differ_by_many_transforms_agree_on_none():
    rng = np.random.default_rng(1)
    pairs = [
        (answer(Pose2D(*rng.uniform(-9, 9, 3))), answer(Pose2D(*rng.uniform(-9, 9, 3))))
        for _ in range(8)
    ]
    found = align_scans(pairs)
    assert found.pose is None
    grid = OccupancyGrid(room(), ~room(), 0.1)
    row = align_maps(grid, grid).as_row() | {"a": "a", "b": "b", "scans": found.as_row()}
    text = alignment_text(row)
    assert "no transform fits more than half of them" in text
    row["scans"] = align_scans(pairs[:1]).as_row()
    assert "too few have a pose in both maps: 1, expected at least 2" in alignment_text(row)


def test_scans_decide_between_places_that_agree_as_well():
    grid = hall(50, 80)
    T = Pose2D(8.4, 5.4, math.pi)  # half a turn about the middle
    here = np.array([(1.0, 1.0, 0.2), (5.0, 2.0, 1.0)])
    scans = ScanAlignment(T, 2, 2, 2, 0.0, 0.0, here, transform_poses(T, here))
    found = align_maps(grid, grid, scans=scans)
    assert found.verdict == "unique"
    assert abs(found.pose.theta) == pytest.approx(math.pi, abs=1e-3)
    apart = differences(found, scans)
    assert apart["walls_apart"] < 0.02
    assert max(apart["corners_apart"]) < 0.05
    assert apart["halves_apart"] == pytest.approx([0, 0, 0, 0], abs=1e-9)
    elsewhere = ScanAlignment(Pose2D(2.0, 0.0), 2, 2, 2, 0.0, 0.0, here, here + (2, 0, 0))
    assert align_maps(grid, grid, scans=elsewhere).verdict == "ambiguous"


def test_what_only_one_map_has_is_drawn_in_its_colour(a):
    more = a.occupied.copy()
    more[48:50, 50:60] = True
    more[45:50, 10:18] = False
    b = OccupancyGrid(more, ~more, 0.1, a.origin)
    picture = draw_alignment(a, b, align_maps(a, b))
    scale = picture.px_per_m / 10  # pixels of a cell
    for colour, cells, (x, y) in ((ONLY_A, 40, (14, 47.5)), (ONLY_B, 20, (55, 49))):
        row, column = np.nonzero((picture.image == colour).all(axis=2))
        assert len(row) / scale**2 == pytest.approx(cells, rel=0.1)
        found = np.median(column), np.median(row)
        assert found == pytest.approx(picture.pixels(np.array([(x, y)]) * 0.1)[0], abs=21)


def test_poses_keep_their_other_columns(a, tmp_path):
    path = tmp_path / "way.csv"
    path.write_text("name,Y,x,yaw\ndock,2,1,0.5\n\ndesk,4.5,3,-3\n")
    given = read_poses(path)
    assert given.poses.tolist() == [[1, 2, 0.5], [3, 4.5, -3]]
    rows = list(csv.reader(moved_text(given, align_maps(a, a)).splitlines()))
    assert rows[0] == ["name", "Y", "x", "yaw"]
    assert rows[1][0] == "dock"
    assert np.abs(np.array(rows[1][1:], float) - (2, 1, 0.5)).max() < 0.02


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a,b\n1,2\n", "got the columns a, b, expected x, y"),
        ("x,y\n1,two\n", "line 2: expected numbers"),
        ("x,y,theta\n1,2\n", "line 2"),
        ("x,y\n1,inf\n", "line 2"),
    ],
)
def test_a_csv_that_has_no_poses_is_refused(tmp_path, text, said):
    path = tmp_path / "way.csv"
    path.write_text(text)
    with pytest.raises(ConfigError, match=said):
        read_poses(path)


@pytest.fixture
def files(a, tmp_path):
    b, truth = turned(a, 0.7, 0.1, Pose2D(1.0, 1.0))
    save_map(tmp_path / "a.yaml", a)
    save_map(tmp_path / "b.yaml", b)
    (tmp_path / "way.csv").write_text("x,y,theta\n2,3,1\n")
    return tmp_path, truth


def test_the_command_says_where_b_lies_and_carries_poses_and_yaml_over(files):
    folder, truth = files
    (folder / "sub").mkdir()
    given = call(
        "map", "align", folder / "a.yaml", folder / "b.yaml", "--json", "--move",
        folder / "way.csv", "--out", folder / "out.csv", "--write", folder / "sub" / "in-a.yaml",
        "--picture", folder / "both.png",
    ).ends(0)  # fmt: skip
    row = json.loads(given.out)
    assert row["verdict"] == "unique"
    assert (row["x"], row["y"]) == pytest.approx((truth.x, truth.y), abs=0.05)
    assert row["theta"] == pytest.approx(truth.theta, abs=0.005)
    (moved,) = csv.DictReader((folder / "out.csv").read_text().splitlines())
    there = compose(truth, Pose2D(2, 3, 1))
    assert float(moved["x"]) == pytest.approx(there.x, abs=0.05)
    assert float(moved["theta"]) == pytest.approx(there.theta, abs=0.01)
    again = call("map", "align", folder / "a.yaml", folder / "sub" / "in-a.yaml", "--json")
    row = json.loads(again.out)
    assert np.abs((row["x"], row["y"], row["theta"])).max() < 0.01
    assert (folder / "both.png").stat().st_size > 1000
    assert len([line for line in given.err.splitlines() if "wrote" in line]) == 3


def test_the_text_has_the_pose_and_how_far_to_trust_it(files):
    folder, _ = files
    given = call("map", "align", folder / "a.yaml", folder / "b.yaml", "--strict").ends(0)
    assert "unique\n  pose       x " in given.out
    for word in ("agree", "residual", "bend", "overlap"):
        assert word in given.out


def test_nothing_is_written_of_maps_that_do_not_match(tmp_path):
    (tmp_path / "way.csv").write_text("x,y\n2,3\n")
    given = call(
        "map", "align", "curved", "visibility", "--move", tmp_path / "way.csv", "--out",
        tmp_path / "out.csv", "--write", tmp_path / "new.yaml",
    )  # fmt: skip
    assert given.code == 6
    assert "no-match\n  walls " in given.out
    assert "Either the maps show different places, or they share too little" in given.out
    assert "To find out, pass --scans: imgloc locates them in both maps." in given.out
    assert "no pose and no YAML is written" in given.err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["way.csv"]


def test_without_a_match_no_number_stands_for_the_map(tmp_path):
    row = json.loads(call("map", "align", "curved", "visibility", "--json").out)
    assert row.pop("verdict") == "no-match"
    others = row.pop("others")
    assert 0 < others[0]["agreement"] < 1
    assert set(row) - {"a", "b"} == set(others[0])
    assert all(value is None for key, value in row.items() if key not in ("a", "b"))
    text = call("map", "align", "curved", "visibility").out
    assert f"  {100 * others[0]['agreement']:.0f} % agree at the best place" in text


def test_slips_of_the_command_are_named(files):
    folder, _ = files
    pair = "map", "align", folder / "a.yaml", folder / "b.yaml"
    given = call(*pair, "--move", folder / "way.csv")
    assert (given.code, "--move, --out" in given.err) == (2, True)
    given = call(*pair, "--write", folder / "b.yaml", "--force")
    assert (given.code, "is read by this command" in given.err) == (1, True)
    given = call(*pair[:3], folder / "none.yaml")
    assert (given.code, "none.yaml: no such file" in given.err) == (3, True)


def test_scans_are_located_in_both(tmp_path):
    scans = tmp_path / "scans.npz"
    assert call("simulate", "visibility", "-n", "6", "--out", scans).code == 0
    grid = load_map(MAPS / "visibility.yaml")
    b, truth = turned(grid, 2.0, grid.resolution, Pose2D(0.0, 0.0))
    save_map(tmp_path / "b.yaml", b)
    given = call("map", "align", "visibility", tmp_path / "b.yaml", "--scans", scans, "--json")
    row = json.loads(given.out)
    assert row["scans"]["used"] >= 4
    assert max(row["scans"]["corners_apart"]) < 0.3
    assert len(row["scans"]["halves_apart"]) == 4
    assert row["scans"]["walls_apart"] < 0.05
    assert row["scans"]["pose"]["theta"] == pytest.approx(truth.theta, abs=0.01)
    pair = ("map", "align", "visibility", tmp_path / "b.yaml", "--scans")
    lines = [  # standard input, which can be read only once
        {"angle_min": s.angles[0], "angle_max": s.angles[-1], "range_max": s.range_max,
         "ranges": [r if np.isfinite(r) else None for r in s.ranges.tolist()]}
        for s in load_scans(scans).scans
    ]  # fmt: skip
    said = fed("".join(json.dumps(line) + "\n" for line in lines), *pair, "-")
    assert (said.code, "walls differ there by 0.0" in said.out) == (0, True), said


def test_the_picture_and_the_words_name_maps_that_are_called_map_by_their_folders(tmp_path):
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
        for ending in (".yaml", ".png"):
            text = (MAPS / f"curved{ending}").read_bytes().replace(b"curved.png", b"map.png")
            (tmp_path / name / f"map{ending}").write_bytes(text)
    one, other = (tmp_path / name / "map.yaml" for name in ("first", "second"))
    done = call("map", "align", one, other, "--picture", tmp_path / "p.png").ends(0)
    assert "walls of both are as thick" in done.out
    assert (map_name(one), map_name(other)) == ("first", "second")


@pytest.mark.parametrize(("least", "verdict"), [(30.0, "unique"), (40.0, "no-match")])
def test_walls_that_agree_are_counted_in_metres_too(least, verdict, monkeypatch) -> None:
    walls = np.pad(np.zeros((60, 80), bool), 2, constant_values=True)
    walls[24:26, 2:44] = walls[24:44, 44:46] = True
    maps = []
    for seed in (1, 2):  # boxes elsewhere
        occupied, rng = walls.copy(), np.random.default_rng(seed)
        for r, c in (rng.integers(3, [52, 72]) for _ in range(8)):
            occupied[r : r + 6, c : c + 6] = True
        maps.append(OccupancyGrid(occupied, ~occupied, 0.06))
    monkeypatch.setattr("imgloc.lab.align._SURE", least)
    assert align_maps(*maps).verdict == verdict
