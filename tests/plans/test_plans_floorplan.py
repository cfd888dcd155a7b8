"""From drawings of a building whose walls are known to its map; and what is no plan."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from cabin import cabin

from imgloc import ConfigError, FloorPlan, MapError, Pose2D, load_plan, plan_to_map
from imgloc.io.images import encode_png
from imgloc.model import BoolArray
from imgloc.plans.building import KINDS, THICKEST, enclosed, inside_of, standing
from imgloc.plans.doors import Door
from imgloc.plans.floorplan import STEPS, _kinds, _pen, _sheet, _swings
from imgloc.plans.masks import opened
from tools.plans.drawing import Image, draw_plan, inside, solid
from tools.plans.measure import shares_found
from tools.plans.sheets import Sheet, drawn, framed, inked, padded, photographed, titled, turned

CELL = 0.05


def upright(image: Image) -> Image:
    """Row 0 the lowest, as the algorithms have it."""
    return np.ascontiguousarray(image[::-1])


def grown(mask: BoolArray, cells: int = 1) -> BoolArray:
    size = (2 * cells + 1,) * 2
    return cv2.dilate(mask.astype(np.uint8), np.ones(size, np.uint8)) > 0


def on_sheet(found: FloorPlan, shape: tuple[int, int]) -> tuple[BoolArray, BoolArray]:
    """What is occupied and what is free, in the cells of the whole sheet."""
    grid = found.grid
    column, row = (round(c / CELL) for c in (grid.origin.x, grid.origin.y))
    height, width = grid.info.shape
    sheet = np.zeros((2, shape[0] + 40, shape[1] + 40), np.bool_)
    sheet[:, row + 20 : row + 20 + height, column + 20 :][:, :, :width] = grid.occupied, grid.free
    return sheet[0, 20:-20, 20:-20], sheet[1, 20:-20, 20:-20]


@pytest.fixture(scope="module")
def plain() -> tuple[Image, FloorPlan]:
    """A plan with filled walls, and what was found on it."""
    plan = upright(draw_plan(cabin(), 0.02))
    return plan, plan_to_map(plan, 0.02)


@pytest.mark.parametrize(
    ("style", "resolution", "noise", "turn"),
    [
        ("filled", 0.01, 30, 0.4), ("outlined", 0.025, 50, 0.25), ("hatched", 0.015, None, 0.0),
        ("grey", 0.05, None, 0.0),
    ],
)  # fmt: skip
def test_walls_stand_where_they_were_drawn(style, resolution, noise, turn):
    b = cabin(turn=turn)
    found = plan_to_map(upright(draw_plan(b, resolution, style, noise=noise)), resolution)
    walls, within = solid(b, CELL), inside(b, CELL)
    occupied, free = on_sheet(found, walls.shape)
    # The pillar of an outlined plan is a square like a stool, and the ends of walls are rounded.
    assert np.mean(grown(occupied)[walls]) > 0.96
    assert np.mean(grown(walls)[occupied]) > 0.98
    assert np.mean(free[within & ~grown(walls)]) > 0.97
    assert not free[~grown(within, 4)].any()  # but for the doorstep
    assert found.thickness[0] == pytest.approx(0.12, abs=0.05)
    # Where walls are outlined and tinted, the outline is part of them.
    assert found.thickness[2] == pytest.approx(0.3, abs=0.02 + 2 * resolution)
    assert found.length == pytest.approx(2 * (8.7 + 5.2) + 5.2 - 1.9, rel=0.12)
    if turn == 0:
        assert found.size == pytest.approx(b.size, abs=0.03 + 2 * resolution)


def test_what_is_drawn_besides_walls_is_named_and_gone(plain: tuple[Image, FloorPlan]) -> None:
    b, found = cabin(), plain[1]
    assert found.size == pytest.approx(b.size, abs=0.06)
    assert found.doors == pytest.approx((0.9, 1.0), abs=0.05)
    counts = {removed.kind: removed.count for removed in found.removed}
    assert counts["door swings"] == 2
    least = {"text": 12, "furniture and symbols": 1, "stairs and hatching": 1}
    for kind, count in (least | {"outside the building": 5}).items():
        assert counts[kind] >= count, kind
    bare = plan_to_map(upright(draw_plan(b, 0.02, clutter=False)), 0.02)
    assert sum(removed.area for removed in bare.removed) < 0.05  # of the lines of the window
    here, there = (on_sheet(f, solid(b, CELL).shape)[0] for f in (found, bare))
    assert not (here & ~grown(there)).any()
    assert not (there & ~grown(here)).any()


def test_a_hatched_wall_that_is_more_ink_than_paper_is_one_wall() -> None:
    found = plan_to_map(upright(draw_plan(cabin(), 0.04, "hatched")), 0.04)
    assert found.thickness[1] == pytest.approx(0.3, abs=0.05)
    assert found.length == pytest.approx(2 * (8.7 + 5.2) + 5.2 - 1.9, rel=0.2)


def test_walls_of_single_lines_are_found_where_nothing_thicker_is() -> None:
    b = cabin()
    found = plan_to_map(upright(draw_plan(b, 0.03, "lines")), 0.03)
    walls = solid(b, CELL)
    occupied, free = on_sheet(found, walls.shape)
    assert np.mean(grown(walls)[occupied]) > 0.95
    assert found.free_area == pytest.approx(8.7 * 5.2, rel=0.06)
    assert free[round((2.5 + 3.9) / CELL), round((2.5 + 5.2) / CELL)]  # the door


def test_a_threshold_does_not_close_a_door(plain: tuple[Image, FloorPlan]) -> None:
    plan = plain[0].copy()
    # In the door of the inner wall: two lines from jamb to jamb.
    bottom, top = (round((2.5 + 0.25 + s) / 0.02) for s in (3.4, 4.3))
    for x in (5.2 - 0.06, 5.2 + 0.06):
        column = round((2.5 + x) / 0.02)
        cv2.line(plan, (column, bottom), (column, top), 0, 1)
    found = plan_to_map(plan, 0.02)
    free = on_sheet(found, solid(cabin(), CELL).shape)[1]
    assert free[round((2.5 + 0.25 + 3.85) / CELL), round((2.5 + 5.2) / CELL)]


def test_light_on_dark_and_a_frame_round_the_sheet(plain: tuple[Image, FloorPlan]) -> None:
    plan, wanted = plain[0], plain[1].grid
    blue = plan_to_map(255 - plan, 0.02)
    assert blue.inverted
    assert np.array_equal(blue.grid.occupied, wanted.occupied)
    high, wide = plan.shape
    framed = cv2.rectangle(plan.copy(), (12, 12), (wide - 13, high - 13), 0, 5)
    found = plan_to_map(framed, 0.02)
    assert found.removed[-1].kind == "a frame round the sheet"
    assert np.mean(found.grid.occupied != wanted.occupied) < 0.002


def house(sheet: Image, x: int, y: int) -> None:
    """Two rooms of 4 x 5 m, with a door between them and one outside; 0.02 m a pixel."""
    cv2.rectangle(sheet, (x, y), (x + 412, y + 262), 0, 12)
    sheet[y : y + 262, x + 200 : x + 212] = 0
    sheet[y + 100 : y + 140, x + 200 : x + 212] = 255
    sheet[y + 100 : y + 140, x + 404 : x + 421] = 255


def title_near(plan: Image) -> None:
    """A frame whose title block is 1.1 m from the house."""
    cv2.rectangle(plan, (10, 10), (689, 489), 0, 5)
    for y in (380, 420, 460):
        plan[y : y + 4, 400:690] = 0
    plan[380:490, 400:404] = 0


@pytest.mark.parametrize(
    "frame",
    [title_near, lambda plan: cv2.rectangle(plan, (117, 57), (689, 489), 0, 5)],
    ids=["title block near", "lines along two walls"],
)
def test_a_frame_may_be_near_the_building(frame: Callable[[Image], None]) -> None:
    plan = np.full((500, 700), 255, np.uint8)
    house(plan, 120, 60)
    alone = plan_to_map(plan, 0.02)
    frame(plan)
    found = plan_to_map(plan, 0.02)
    assert found.free_area == pytest.approx(alone.free_area, rel=0.01)
    assert found.size == pytest.approx(alone.size, abs=CELL + 0.02)  # a stub of the frame
    assert found.doubt == alone.doubt == ""


def test_lines_that_a_scanner_cut_are_walls() -> None:
    plan = np.full((400, 600), 255, np.uint8)
    house(plan, 90, 60)
    whole = plan_to_map(plan, 0.02)
    for x in (150, 210, 270):  # pieces of 1.2 m
        plan[54:68, x : x + 3] = plan[316:330, x : x + 3] = 255
    cut = plan_to_map(plan, 0.02)
    assert np.count_nonzero(cut.grid.occupied) > 0.95 * np.count_nonzero(whole.grid.occupied)
    assert cut.free_area == pytest.approx(whole.free_area, rel=0.03)


@pytest.mark.parametrize("hole", [1, 2, 3])
def test_a_disc_does_not_get_through_a_hole_in_a_thin_wall(hole: int) -> None:
    room = np.zeros((60, 80), np.bool_)
    cv2.rectangle(walls := room.astype(np.uint8), (10, 10), (70, 50), 1, 1)
    walls[30 : 30 + hole, 70] = 0
    assert np.count_nonzero(enclosed(walls > 0, 8.0)) >= 59 * 39


def test_a_hall_with_rooms_in_it_is_no_frame() -> None:
    plan = np.full((700, 900), 255, np.uint8)
    cv2.rectangle(plan, (100, 50), (800, 650), 0, 12)
    house(plan, 105, 50)
    plan[640:660, 300:400] = 255  # the door of the hall
    assert plan_to_map(plan, 0.02).free_area == pytest.approx(14 * 12, rel=0.1)


def test_a_closed_hall_with_a_room_at_one_end_is_no_frame() -> None:
    plan = np.full((700, 900), 255, np.uint8)
    cv2.rectangle(plan, (100, 50), (800, 650), 0, 10)
    plan[50:650, 280:290] = 0
    found = plan_to_map(plan, 0.02)
    assert found.free_area == pytest.approx(13.8 * 11.8, rel=0.1)


def test_of_two_buildings_the_larger_is_the_map_and_the_other_is_warned_of() -> None:
    plan = np.full((400, 1200), 255, np.uint8)
    house(plan, 60, 60)
    alone = plan_to_map(plan, 0.02)
    assert alone.other_area == 0
    smaller = cv2.resize(plan[50:340, 50:490], None, fx=0.8, fy=0.8, interpolation=cv2.INTER_AREA)
    plan[50 : 50 + len(smaller), 660 : 660 + smaller.shape[1]] = smaller  # 3.7 m apart
    found = plan_to_map(plan, 0.02)
    assert found.free_area == pytest.approx(alone.free_area, rel=0.01)
    assert found.other_area == pytest.approx(0.64 * alone.free_area, rel=0.1)
    assert "walls enclose another 2" in found.doubt


def test_the_paper_between_two_buildings_is_no_gap() -> None:
    taken = np.zeros((320, 560), np.uint8)
    for x in (20, 302):  # 4 m apart
        cv2.rectangle(taken, (x, 20), (x + 200, 300), 1, 4)
        taken[280:, x + 90 : x + 110] = 0  # a door
    inside, _ = inside_of(taken > 0, 0.05, None)
    assert np.count_nonzero(inside) == pytest.approx(200 * 280, rel=0.05)


@pytest.mark.parametrize("letter", [False, True])
def test_a_corner_between_two_doors_belongs_to_the_building(letter: bool) -> None:
    plan = np.full((500, 600), 255, np.uint8)
    cv2.rectangle(plan, (50, 50), (550, 450), 0, 8)  # 10 x 8 m, a pixel is 0.02 m
    cv2.rectangle(plan, (300, 50), (550, 450), 0, 8)
    for x, y, wide, high in ((46, 300, 8, 120), (80, 446, 120, 8), (296, 150, 8, 90)):
        cv2.rectangle(plan, (x, y), (x + wide, y + high), 255, -1)
    if letter:  # as bold as walls, in a room: no wall
        cv2.rectangle(plan, (150, 150), (158, 190), 0, -1)
    found = plan_to_map(upright(plan), 0.02)
    assert found.free_area > 70  # m2; without the corner half of the house is outside
    occupied, _ = on_sheet(found, (200, 240))
    assert occupied[18:23, 18:23].any()
    assert not occupied[130:135, 60:65].any()


def test_a_ruled_table_is_warned_of() -> None:
    table = np.full((600, 800), 255, np.uint8)
    for x in range(50, 800, 100):
        table[50:555, x : x + 5] = 0
    for y in range(50, 600, 100):
        table[y : y + 5, 50:755] = 0
    assert "a table or a grid" in plan_to_map(table, 0.02).doubt


def test_the_frame_of_the_map_is_that_of_the_plan(plain: tuple[Image, FloorPlan]) -> None:
    plan, here = plain
    there = plan_to_map(plan, 0.02, origin=Pose2D(10.0, -3.0, np.pi / 2))
    x, y = here.grid.origin.x, here.grid.origin.y
    assert (x, y) == pytest.approx((2.0, 2.0), abs=0.051)
    assert there.grid.origin.x == pytest.approx(10.0 - y)
    assert there.grid.origin.y == pytest.approx(-3.0 + x)
    assert there.grid.origin.theta == pytest.approx(np.pi / 2)


def test_what_is_no_plan_is_refused() -> None:
    rng = np.random.default_rng(3)
    blurred = cv2.GaussianBlur(rng.uniform(0, 255, (300, 400)), (0, 0), 9)
    photo = cv2.normalize(blurred, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    recorded = np.full((200, 300), 205, np.uint8)
    recorded[50:150, 60:250] = 254
    cv2.rectangle(recorded, (60, 50), (249, 149), 0, 2)
    words = cv2.putText(np.full((400, 600), 255, np.uint8), "TITLE", (50, 200), 0, 1, 0, 2)
    shed = np.full((400, 600), 255, np.uint8)
    shed[100:110, 100:500] = shed[100:350, 100:110] = 0  # two walls
    for image, said in (
        (photo, "light as paper, expected a drawing: a photo"),
        (recorded, "greys of a map that a robot made"),
        (np.full((50, 50), 255, np.uint8), "one tone only"),
        (words, "no walls found"),
        (shed, "they enclose nothing"),
    ):
        with pytest.raises(MapError, match=said):
            plan_to_map(image, 0.02)
    with pytest.raises(MapError, match="nothing is dark as ink"):
        plan_to_map(np.maximum(shed, 100), 0.02, ink=0.99)
    with pytest.raises(ConfigError, match=r"`thickest=0\.5`"):
        plan_to_map(shed, 0.02, thinnest=0.6)


def test_a_plan_that_is_wall_all_over_has_no_walls() -> None:
    for shape in ((3, 15), (15, 3), (1, 1), (8, 8)):
        plan = np.full(shape, 200, np.uint8)
        plan.ravel()[-1] = 190
        with pytest.raises(MapError):
            plan_to_map(plan, 0.01, inverted=True)
    assert [mask.all() for mask in standing(*np.ones((2, 400, 8), np.bool_), 0.0125)] == [1, 0]


@pytest.mark.parametrize("thickness", range(1, 10))
def test_what_is_as_thick_stays_where_it_was(thickness: int) -> None:
    bars = np.zeros((60, 60), np.bool_)
    bars[20 : 20 + thickness, 15:45] = bars[40 : 39 + thickness, 15:45] = True
    result = opened(bars, thickness)
    assert np.flatnonzero(result.any(axis=1)).tolist() == list(range(20, 20 + thickness))
    assert not (result & ~bars).any()
    for axis in (0, 1):
        assert np.array_equal(np.flip(opened(np.flip(bars, axis), thickness), axis), result)


def test_the_map_of_a_shifted_or_mirrored_plan_is_shifted_or_mirrored() -> None:
    resolution = 0.02
    plan, cells = upright(draw_plan(cabin(), resolution, "filled")), round(4 * CELL / resolution)
    plan = np.pad(plan, [(0, -side % cells) for side in plan.shape], constant_values=255)
    grid = plan_to_map(plan, resolution).grid
    high, wide = (side * resolution for side in plan.shape)
    for axis in (0, 1):
        mirrored = plan_to_map(np.ascontiguousarray(np.flip(plan, axis)), resolution).grid
        assert np.array_equal(np.flip(mirrored.occupied, axis), grid.occupied)
        assert np.array_equal(np.flip(mirrored.free, axis), grid.free)
        at, before = ((g.origin.y, g.origin.x)[axis] for g in (mirrored, grid))
        side = grid.info.shape[axis] * grid.resolution
        assert at == pytest.approx((high, wide)[axis] - before - side, abs=1e-9)
    shifted = plan_to_map(np.pad(plan, [(0, 0), (cells, 0)], constant_values=255), resolution).grid
    assert np.array_equal(shifted.occupied, grid.occupied)
    assert shifted.origin.x - grid.origin.x == pytest.approx(4 * CELL)


@pytest.mark.parametrize("width", [2, 3, 5])
def test_the_pen_is_as_wide_as_the_strokes_of_letters(width: int) -> None:
    sheet = np.zeros((60, 300), np.bool_)
    for x in range(10, 290, 40):  # seven times an L
        sheet[10:40, x : x + width] = sheet[40 - width : 40, x : x + 25] = True
    assert _pen(sheet, 50.0) == pytest.approx(width, abs=0.4)
    assert _pen(sheet[:, :170], 50.0) == 0  # four are too few


def test_a_pillar_is_filled_wide_and_about_square() -> None:
    walls = np.zeros((200, 200), np.bool_)
    boxes = {"pillar": (5, 5, 10, 10), "thin": (5, 30, 8, 8), "wide": (30, 5, 10, 50)}
    boxes |= {"empty": (60, 30, 12, 12), "long": (100, 5, 10, 76)}
    for y, x, high, wide in boxes.values():
        walls[y : y + high, x : x + wide] = True
    drawn = walls.copy()
    drawn[62:70, 32:40] = False
    long, pillars = standing(walls, drawn, 0.02)
    found = [{n for n, (y, x, _, _) in boxes.items() if m[y, x]} for m in (long, pillars)]
    assert found == [{"long"}, {"pillar"}]


@pytest.mark.parametrize("leaf", [True, False])
def test_an_arc_is_a_door_if_it_has_a_leaf(leaf: bool) -> None:
    walls = np.zeros((120, 200), np.uint8)
    walls[20:30, :60] = walls[20:30, 105:] = 1  # 0.2 m thick, with an opening of 0.9 m
    drawn = cv2.ellipse(walls.copy(), (60, 25), (45, 45), 0, 0, 90, 1, 1)
    if leaf:
        drawn = cv2.line(drawn, (60, 25), (60, 70), 1, 1)
    found = _swings(drawn > 0, walls > 0, 0.02)
    assert len(found) == leaf
    if leaf:
        assert found[0].hinge == pytest.approx((60, 25), abs=4)
        assert found[0].width == pytest.approx(45, abs=4)


@pytest.mark.parametrize("middle_deg", [0, 45, 90, 135, 180, 225, 270, 315])
def test_the_swing_of_a_door_is_a_quarter_circle(middle_deg: int) -> None:
    ring = cv2.circle(np.zeros((120, 120), np.uint8), (60, 60), 45, 1, 1) > 0
    hinge, middle = np.array([60.0, 60.0]), np.deg2rad(middle_deg)
    a, b = (hinge + 45 * np.array([np.cos(t), np.sin(t)]) for t in middle + [-np.pi / 4, np.pi / 4])
    none = np.zeros_like(ring)
    kinds = _kinds(ring, none, ~none, none, none, [Door(hinge, a, b, 45.0, False)], 0.02)
    y, x = np.nonzero(kinds == KINDS.index("door swings"))
    off = np.rad2deg(np.abs(np.angle(np.exp(1j * (np.arctan2(y - 60, x - 60) - middle)))))
    assert off.max() == pytest.approx(45, abs=6)  # it is drawn 6 pixels wide
    assert len(off) == pytest.approx(np.count_nonzero(ring) / 4, rel=0.15)


@pytest.mark.parametrize("resolution", [0.01, 0.02])  # finer than what is worked on, and coarser
def test_ink_is_what_is_as_dark_as_that(resolution: float) -> None:
    plan = np.full((60, 60), 255, np.uint8)
    plan[20:40, 10:30], plan[20:40, 30:50] = 102, 103  # a darkness of 0.6, and less
    drawn, bold, parts = _sheet(plan, resolution, 0.05, 0.6)
    scale = resolution / (0.05 / parts)
    for mask in (drawn, bold):
        row = mask[round(30 * scale)]
        assert row[round(12 * scale) : round(28 * scale)].all()
        assert not row[round(32 * scale) :].any()


def test_recorded_maps_are_no_plans(shared: Path) -> None:
    maps = sorted((shared / "data").glob("map_*/map.png"))
    assert maps
    for path in maps:
        with pytest.raises(MapError, match="a robot made"):
            plan_to_map(load_plan(path), 0.05)


@pytest.fixture(scope="module")
def cabin_sheet() -> Sheet:
    """The cabin on a sheet with room around it, in colour."""
    return padded(drawn(cabin(), 0.025, "outlined"), 1.0, 2.0, 5.0, 2.0)


@pytest.mark.parametrize(
    "change",
    [
        lambda s: turned(framed(s), 2.0, 90),
        lambda s: photographed(titled(s, "FLOOR 2", 1.0), 3),
        lambda s: inked(titled(s, "FLOOR 2", 1.0), (230, 230, 120), (40, 30, 30)),
    ],
    ids=["turned", "photographed", "light on dark"],
)
def test_the_building_is_found_on_a_whole_sheet(cabin_sheet, change, tmp_path):
    sheet = change(replace(cabin_sheet, image=cabin_sheet.image.copy()))
    (tmp_path / "sheet.png").write_bytes(encode_png(sheet.image))
    found = plan_to_map(load_plan(tmp_path / "sheet.png"), sheet.resolution, origin=sheet.origin)
    free, walls = shares_found(found.grid, cabin())
    assert free > 0.93  # 0.936 to 0.981, as the sheet lies on the cells
    assert walls > 0.85
    assert found.free_area < 1.15 * 8.7 * 5.2  # and nothing else is


def test_thicker_walls_as_two_lines_are_looked_for_unless_it_is_given(plain):
    b = cabin()
    b.walls = [(a, end, 0.7 if thick == 0.3 else thick) for a, end, thick in b.walls]
    plan = upright(draw_plan(b, 0.025, "outlined", clutter=False))
    assert plan_to_map(plan, 0.025).thickest == THICKEST[-1]
    assert plan_to_map(plan, 0.025, thickest=1.1).thickest == 1.1
    assert plain[1].thickest == THICKEST[0]


def test_each_step_is_counted_at_most_once(plain: tuple[Image, FloorPlan]) -> None:
    steps = list[None]()
    plan_to_map(plain[0], 0.02, advance=lambda: steps.append(None))
    assert 2 < len(steps) <= STEPS
