"""The localizability atlas: places, kinds, twins, the picture and the command."""

import csv
from pathlib import Path

import cv2
import numpy as np
import pytest
from command import MAPS, call, rows

from imgloc import ConfigError, LaserScan, MapError, OccupancyGrid, Options, Pose2D, prepare
from imgloc.geometry import in_grid_frame
from imgloc.lab.atlas import COLUMNS, TOP, Spot, as_csv, atlas_poses, survey, survey_part
from imgloc.lab.picture import ATLAS_COLOURS, REDS, draw_atlas
from imgloc.simulation.scans import ray_angles, simulate_ranges


def spot(pose: Pose2D, kind: str, twin: Pose2D | None = None) -> Spot:
    return Spot(pose, kind, 0.5, 0.0, 0.0, twin, 0.0)


def twin_rooms() -> OccupancyGrid:
    """Two rooms, each other's copies 6 m apart along x, and one that is like neither."""
    walls = np.zeros((52, 180), bool)
    for left in (0, 60):
        walls[[0, 51], left : left + 60] = True
        walls[:, left : left + 3] = True
        walls[:, left + 57 : left + 60] = True
        walls[15:25, left + 10 : left + 16] = True
        walls[35, left + 30 : left + 57] = True
    walls[[0, 51], 120:] = True
    walls[:, 179] = True
    walls[10:40, 150] = True
    walls[8:14, 168:174] = walls[35:40, 130:136] = True  # a bare room would be no evidence
    return OccupancyGrid(walls, ~walls, 0.1, Pose2D(5.0, -3.0, 0.0))


@pytest.fixture(scope="module")
def spots():
    grid = twin_rooms()
    poses = [Pose2D(2.5, 3.0, 0.3), Pose2D(8.5, 3.0, 0.3), Pose2D(16.0, 4.0, -1.0)]
    angles = ray_angles(181, np.pi * 1.5)
    ranges = simulate_ranges(grid, [(p.x, p.y, p.theta) for p in poses], angles, seed=1)
    scans = [(p, LaserScan(r, angles, range_max=30.0)) for p, r in zip(poses, ranges, strict=True)]
    return grid, scans, list(survey(grid, scans, Options(top=TOP)))


def test_twins_name_each_other(spots):
    _, _, (left, right, alone) = spots
    assert (left.kind, right.kind, alone.kind) == ("ambiguous", "ambiguous", "unique")
    for one, other in ((left, right), (right, left)):
        assert np.hypot(one.twin.x - other.pose.x, one.twin.y - other.pose.y) < 0.15
        assert one.mass + one.twin_mass > 0.9
    assert alone.mass > 0.9
    assert alone.error < 0.1


def test_poses_are_in_the_map_frame(spots):
    _, scans, found = spots
    assert found[0].pose.x == pytest.approx(scans[0][0].x + 5.0)
    assert found[0].pose.y == pytest.approx(scans[0][0].y - 3.0)


def test_workers_do_not_matter(spots):
    grid, scans, found = spots
    assert list(survey(grid, scans, Options(top=TOP), workers=2)) == found


def test_places_are_free_and_clear():
    free = np.ones((40, 60), bool)
    free[:, 30] = False
    grid = OccupancyGrid(~free, free, 0.1)
    poses = atlas_poses(grid, 0.5, 3, 0.3)
    assert len(poses) % 3 == 0
    assert np.unique(poses[:, 2]).round(3).tolist() == [0.0, 2.094, 4.189]
    assert (np.abs(poses[:, 0] - 3.05) >= 0.3).all()
    assert poses[:, :2].min() >= 0.3
    with pytest.raises(MapError, match="clearance"):
        atlas_poses(grid, 0.5, 1, 9.0)


def test_parts_of_a_survey_are_the_whole_whatever_their_length():
    features = prepare(twin_rooms())
    laser = LaserScan(np.ones(90), ray_angles(90, 2 * np.pi), range_max=20.0)
    how = {"step": 2.0, "headings": 2}
    whole = survey_part(features, laser, Options(), **how, seconds=1e9)
    assert whole["next"] is None
    assert whole["of"] == len(whole["spots"]) == len(atlas_poses(features.grid, 2.0, 2, 0.3))
    parts, start = [], 0
    while start is not None:
        part = survey_part(features, laser, Options(), **how, start=start, seconds=0.0)
        assert len(part["spots"]) == 1
        parts += part["spots"]
        start = part["next"]
    assert parts == whole["spots"]
    # Twins at x of 5 to 17 m; alone beyond.
    kinds = {
        kind: {s["x"] > 17.0 for s in parts if s["kind"] == kind}
        for kind in ("unique", "ambiguous")
    }
    assert kinds == {"unique": {True}, "ambiguous": {False}}
    with pytest.raises(ConfigError, match="expected less than"):
        survey_part(features, laser, Options(), **how, start=whole["of"])
    with pytest.raises(ConfigError, match="poses at places"):
        survey_part(features, laser, Options(), step=0.05, headings=4)


def test_csv_has_named_columns() -> None:
    nan = float("nan")
    text = as_csv([Spot(Pose2D(1.0, 2.0, 0.5), "no-match", 0.0, nan, nan, None, 0.0)])
    (row,) = csv.DictReader(text.splitlines())
    assert tuple(row) == COLUMNS
    assert (row["kind"], row["error"], row["twin_x"]) == ("no-match", "", "")


def test_a_wedge_points_along_its_heading() -> None:
    free = np.ones((20, 20), bool)
    grid = OccupancyGrid(~free, free, 0.1, Pose2D(1.0, 0.0, np.pi / 2))
    # In the map frame, whose x is the grid's -y: heading 0 is down in the picture.
    spots = [
        spot(Pose2D(0.0, 1.0, theta), kind) for theta, kind in ((0.0, "unique"), (np.pi, "wrong"))
    ]
    picture = draw_atlas(grid, spots, step=1.0, headings=4)
    place = in_grid_frame(Pose2D(0.0, 1.0), grid)
    ((x, y),) = picture.pixels(np.array([(place.x, place.y)])).tolist()
    near = picture.image[round(y) - 80 : round(y) + 80, round(x) - 80 : round(x) + 80]
    down, up = (np.argwhere((near == ATLAS_COLOURS[s.kind]).all(axis=2)) for s in spots)
    assert abs(down[:, 1].mean() - np.median(up[:, 1])) < 5
    assert down[:, 0].mean() > np.median(up[:, 0]) + 40


def test_the_more_places_fit_the_redder() -> None:
    free = np.ones((30, 30), bool)
    pose, twin = Pose2D(1.5, 1.5), Pose2D(2.0, 2.0)
    for places, (_, colour, _) in zip((2, 3, 9), REDS, strict=True):
        some = [Spot(pose, "ambiguous", 0.4, 0.0, 0.0, twin, 0.3, places)]
        image = draw_atlas(OccupancyGrid(~free, free, 0.1), some, step=1.0, headings=1).image
        shown = [(image == red).all(axis=2).sum() > 999 for _, red, _ in REDS]
        assert shown == [red == colour for _, red, _ in REDS]


def test_the_legend_counts(tmp_path: Path) -> None:
    free = np.ones((30, 30), bool)
    grid = OccupancyGrid(~free, free, 0.1)
    spots = [spot(Pose2D(1.0, 1.0), "ambiguous", Pose2D(2.0, 2.0)), spot(Pose2D(2.0, 1.0), "wrong")]
    picture = draw_atlas(grid, spots, step=0.5, headings=1)
    low = round(float(picture.pixels(np.zeros((1, 2)))[0, 1])) + 40
    legend = picture.image[low:]
    assert (legend == ATLAS_COLOURS["wrong"]).all(axis=2).sum() > 50
    assert not (legend == ATLAS_COLOURS["no-match"]).all(axis=2).any()


ATLAS = ("atlas", MAPS / "curved.yaml", "--step", 3, "--headings", 2, "--rays", 61)


def test_the_command_writes_a_picture_a_table_and_numbers(tmp_path: Path) -> None:
    png, table = tmp_path / "a.png", tmp_path / "a.csv"
    code, out, err = call(*ATLAS, "--out", png, "--csv", table, "--json", "--workers", 1)
    assert (code, err) == (0, "")
    (found,) = rows(out)
    with table.open() as file:
        listed = list(csv.DictReader(file))
    assert len(listed) == found["poses"] == 2 * found["places"]
    kinds = [row["kind"] for row in listed]
    assert kinds.count("unique") == found["unique"]["hits"]
    assert 0.001 < found["bound"] == np.median([float(row["bound"]) for row in listed]) < 0.1
    assert found["unique"]["low"] <= found["unique"]["value"] <= found["unique"]["high"]
    assert cv2.imdecode(np.fromfile(png, np.uint8), cv2.IMREAD_COLOR).shape[1] >= 1000
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.csv", "a.png"]
    call(*ATLAS, "--out", png, "--json").ends(1, out="")


@pytest.mark.parametrize(
    ("options", "code", "expected"),
    [
        (("--step", 0.02, "--headings", 72), 2, "expected at most 20,000"),
        (("--step", 0), 2, "--step"),
        (("--clearance", 40), 3, "clearance"),
        (("--out", "a.jpg"), 2, ".png"),
    ],
)
def test_refuses(tmp_path: Path, options, code: int, expected: str) -> None:
    words = ["atlas", MAPS / "curved.yaml", "--out", tmp_path / "a.png", *options]
    call(*words).ends(code, expected, out="")
    assert not list(tmp_path.iterdir())
