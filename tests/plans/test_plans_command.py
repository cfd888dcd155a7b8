"""`imgloc map plan`; what `map check` and `localize` say of a plan that is taken for a map."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from cabin import cabin
from command import MAPS, call, rows

from imgloc import load_map, load_scans, plan_to_map, save_scans
from imgloc.io.images import encode_png, read_image
from tools.plans.drawing import draw_plan
from tools.plans.measure import scans_of

PIXEL = 0.025


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A plan as PNG and as JPEG, its map made by the command, and scans of the building."""
    out = tmp_path_factory.mktemp("plan")
    image = draw_plan(cabin(), PIXEL)
    (out / "drawing.png").write_bytes(encode_png(image))
    (out / "drawing.jpg").write_bytes(cv2.imencode(".jpg", image)[1].tobytes())
    save_scans(out / "scans.npz", scans_of(cabin(), 3, 4))
    run = call(
        "map", "plan", out / "drawing.png", "--resolution", PIXEL, "-o", out / "map.yaml",
        "--picture", out / "seen.png",
    ).ends(0)  # fmt: skip
    (out / "said.txt").write_text(run.out)
    return out


def test_the_map_is_written_and_said_in_words(folder: Path) -> None:
    said = (folder / "said.txt").read_text()
    assert f"plan        {PIXEL} m a pixel" in said
    assert "building    9." in said
    assert "doors       2 swings, leaves of 0." in said
    assert "    text   " in said
    assert "    stairs and hatching" in said
    grid = load_map(folder / "map.yaml")
    assert grid.resolution == 0.05
    assert 35 < np.count_nonzero(grid.free) * 0.05**2 < 46
    assert not grid.free[0].any()
    assert "unknown" in (check := call("map", "check", folder / "map.yaml").out)
    assert "warnings    none" in check
    picture = read_image(folder / "seen.png").pixels
    assert len({tuple(colour) for colour in picture.reshape(-1, 3)[::37].tolist()}) > 6


def test_scans_are_located_on_the_map_and_not_on_the_plan(folder: Path) -> None:
    words = ("localize", folder / "map.yaml", folder / "scans.npz", "--no-cache", "--json")
    truths = load_scans(folder / "scans.npz").poses
    assert truths is not None
    for row, truth in zip(rows(call(*words).out), truths, strict=True):
        assert row["verdict"] in ("unique", "ambiguous")
        assert np.hypot(row["pose"]["x"] - truth[0], row["pose"]["y"] - truth[1]) < 0.3


def test_the_scale_may_be_two_points_and_a_plan_a_jpeg(folder: Path) -> None:
    # The lower dimension line, 9 m, from the upper left corner.
    left, right, low = 2.5 / PIXEL, 11.5 / PIXEL, 300
    out = folder / "again.yaml"
    run = call(
        "map", "plan", folder / "drawing.jpg", "--distance", f"{left},{low},{right},{low},9",
        "--out", out, "--json", "--origin", "1,2,90deg", "--cell", 0.1,
    ).ends(0)  # fmt: skip
    (row,) = rows(run.out)
    assert row["resolution"] == pytest.approx(PIXEL)
    assert row["size"]["width"] == pytest.approx(9.0, abs=0.1)
    assert row["walls"]["thickness"]["high"] == pytest.approx(0.3, abs=0.06)
    assert len(row["doors"]) == 2
    assert {"kind", "count", "area"} == set(row["removed"][0])
    grid = load_map(out)
    assert grid.origin.theta == pytest.approx(np.pi / 2)
    assert (row["cells"]["height"], row["cells"]["width"]) == grid.info.shape


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        ("", 2, "the scale is missing, expected --resolution, metres a pixel, or --distance"),
        ("--resolution 0.02 --distance 1,1,9,9,3", 2, "the scale is given twice"),
        ("--distance 1,1,9000,9,3", 2, "9000,9 is not on the image, which has 560 x 420 pixels"),
        ("--distance 5,5,5,5,3", 2, "expected two points and metres between them"),
        ("--distance 1,1,9,9,0", 2, "expected two points and metres between them"),
        ("--resolution 0.02 --thinnest 0.6", 2, "--thinnest 0.6: expected less than --thickest"),
        ("--resolution 0.0006", 3, "drawing.png: no walls found"),
        ("--resolution 0.025 --memory-budget 1M", 2, "crop the plan"),
    ],
)
def test_what_cannot_be_done_is_one_clear_line(folder, tmp_path, words, code, said):
    plan, out = folder / "drawing.png", tmp_path / "out.yaml"
    run = call("map", "plan", plan, "--out", out, *words.split()).ends(code, said, out="")
    assert len(run.err.splitlines()) == 1
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_overwritten_by_chance_and_the_plan_never(folder: Path) -> None:
    words = ("map", "plan", folder / "drawing.png", "--resolution", PIXEL, "--out")
    assert "exists already" in call(*words, folder / "map.yaml").err
    before = (folder / "drawing.png").read_bytes()
    call(*words, folder / "drawing.yaml", "--force").ends(1, "drawing.png: is read by this command")
    assert (folder / "drawing.png").read_bytes() == before
    words = (*words, folder / "new.yaml", "--picture", folder / "new.png")
    call(*words).ends(2, "is the image of the map")


def test_map_check_knows_a_plan(folder: Path) -> None:
    for name in ("drawing.png", "drawing.jpg"):
        (row,) = rows(call("map", "check", folder / name, "--resolution", 0.02, "--json").out)
        codes = {w["code"]: w["text"] for w in row["warnings"]}
        assert "imgloc map plan turns the plan into a map" in codes["plan"], name
        assert "no-unknown" not in codes


def test_map_check_knows_maps_without_unknown_and_swapped_ones(tmp_path: Path) -> None:
    pixels = read_image(MAPS / "visibility.png").pixels
    inner = np.where(pixels == 0, 0, 254).astype(np.uint8)[6:-6, 6:-6]
    made = {"inner": np.pad(inner, 3), "swapped": 255 - pixels}
    for grey in (205, 128):
        made[f"swapped-{grey}"] = np.where(pixels == 205, grey, 255 - pixels).astype(np.uint8)
    for name, image in made.items():
        (path := tmp_path / f"{name}.png").write_bytes(encode_png(image))
        (row,) = rows(call("map", "check", path, "--resolution", 0.1, "--json").out)
        codes = {w["code"] for w in row["warnings"]}
        assert ("swapped" in codes) == (name != "inner"), name
        assert ("no-unknown" in codes) == (name == "inner"), name
        assert "plan" not in codes


def test_localize_says_that_its_map_is_a_plan_where_scans_do_not_fit(tmp_path: Path) -> None:
    (tmp_path / "plan.png").write_bytes(encode_png(draw_plan(cabin(), 0.1)))
    noise = np.random.default_rng(1).uniform(0.5, 9, (1, 14))
    np.savez(tmp_path / "s.npz", ranges=noise, angles=np.linspace(-3, 3, 14), range_max=20.0)
    words = ("localize", tmp_path / "plan.png", tmp_path / "s.npz", "--no-cache")
    why = "a floor plan? Then its text, furniture and door swings count as walls"
    call(*words, "--resolution", 0.1).ends(0, why, "imgloc map plan turns the plan into a map")


def planned(sheet: np.ndarray, folder: Path, *words: object) -> tuple[dict[str, Any], str]:
    """The row of the map of a sheet, and the warnings on one line."""
    (folder / "sheet.png").write_bytes(encode_png(sheet))
    run = call("map", "plan", folder / "sheet.png", "--resolution", PIXEL, "--json", "--force",
               "-o", folder / "map.yaml", *words).ends(0)  # fmt: skip
    return rows(run.out)[0], " ".join(run.err.split())


def test_a_title_that_is_taken_for_the_building_is_doubted_aloud(tmp_path: Path) -> None:
    sheet = np.full((720, 960), 255, np.uint8)
    for x, y, wide, high in ((60, 60, 840, 420), (90, 90, 360, 360), (480, 90, 360, 360)):
        cv2.rectangle(sheet, (x, y), (x + wide, y + high), 0, 1)  # rooms in the thinnest line
    for x in (180, 320, 460):
        cv2.circle(sheet, (x, 620), 52, 0, 8)  # letters of a title
    row, said = planned(sheet, tmp_path)
    assert "sheet.png: the building was most likely missed: only " in said
    assert "Look at --picture" in said
    assert row["free_share"] < 0.05
    assert row["doubt"].startswith("the building was most likely missed")


def two_rooms(x: int, y: int, side: int, size: tuple[int, int]) -> np.ndarray:
    """Draw two rooms with doors of 0.8 m; their walls are two lines 0.3 m apart. Pixels."""
    sheet, pen, apart, door = np.full(size, 255, np.uint8), 2, 12, round(0.8 / PIXEL)
    wide, high = 2 * side + 3 * apart, side + 2 * apart
    cv2.rectangle(sheet, (x, y), (x + wide, y + high), 0, pen)
    for left in (x + apart, x + 2 * apart + side):
        cv2.rectangle(sheet, (left, y + apart), (left + side, y + apart + side), 0, pen)
        middle = left + side // 2
        cv2.rectangle(sheet, (middle, y - pen), (middle + door, y + apart + pen), 255, -1)
        for end in (middle, middle + door):
            cv2.line(sheet, (end, y), (end, y + apart), 0, pen)
    return sheet


def test_walls_that_are_taken_for_two_are_warned_of(tmp_path: Path) -> None:
    sheet = two_rooms(100, 100, 160, (400, 600))
    good, said = planned(sheet, tmp_path)
    assert (good["doubt"], said) == (None, "")
    bad, said = planned(sheet, tmp_path, "--thickest", 0.2)
    assert "sheet.png: walls were most likely misread: " in said
    assert "look into gaps less than 0.5 m wide" in said
    assert good["framed_area"] == 0
    assert good["gaps_share"] < 0.1 < 0.23 < bad["gaps_share"]


def test_walls_that_are_too_thick_to_be_one_are_warned_of() -> None:
    sheet, pen, thick, side = np.full((440, 560), 255, np.uint8), 2, 34, 120
    cv2.rectangle(sheet, (90, 90), (90 + 2 * side + 3 * thick, 90 + side + 2 * thick), 0, pen)
    for x in (90 + thick, 90 + 2 * thick + side):
        cv2.rectangle(sheet, (x, 90 + thick), (x + side, 90 + thick + side), 0, pen)
    middle = 90 + thick + side
    for y in (160, 200):  # a door between the rooms
        cv2.line(sheet, (middle, y), (middle + thick, y), 0, pen)
    for x in (middle, middle + thick):
        sheet[163:198, x - 3 : x + 4] = 255
    found = plan_to_map(sheet, 0.025)  # walls 0.9 m thick with their lines
    assert found.gaps_share > 0.4
    assert "spaces less than 1.3 m wide without a door" in found.doubt
    assert plan_to_map(sheet, 0.025, thickest=1.4).doubt == ""


def test_a_frame_that_was_taken_for_the_building_is_warned_of(tmp_path: Path) -> None:
    sheet = two_rooms(400, 300, 104, (800, 1100))
    cv2.rectangle(sheet, (20, 20), (1080, 780), 0, 8)  # 36 times as large as the rooms
    row, said = planned(sheet, tmp_path)
    assert row["size"]["width"] > 26
    assert row["framed_area"] == pytest.approx(14, abs=2)
    assert "a rectangle surrounds a building of 1" in said


def test_a_yaml_beside_a_plan_says_its_scale_and_where_it_lies(folder, tmp_path):
    (tmp_path / "a.png").write_bytes((folder / "drawing.png").read_bytes())
    yaml = f"image: a.png\nresolution: {PIXEL}\norigin: [10, 20, 0]\n"
    (tmp_path / "a.yaml").write_text(yaml)
    run = call("map", "plan", tmp_path / "a.png", "-o", tmp_path / "map.yaml", "--json").ends(0)
    assert "missed" not in run.err
    (row,) = rows(run.out)
    assert (row["resolution"], row["doubt"]) == (PIXEL, None)
    assert row["free_share"] > 0.3
    here, there = load_map(tmp_path / "map.yaml"), load_map(folder / "map.yaml")
    np.testing.assert_array_equal(here.occupied, there.occupied)
    assert here.origin.x == pytest.approx(there.origin.x + 10)
    assert here.origin.y == pytest.approx(there.origin.y + 20)


def test_a_yaml_that_is_read_is_no_output_and_its_negate_counts(folder, tmp_path):
    image = read_image(folder / "drawing.png").pixels
    (tmp_path / "a.jpg").write_bytes(cv2.imencode(".jpg", 255 - image)[1].tobytes())
    yaml = f"image: a.jpg\nresolution: {PIXEL}\norigin: [0, 0, 0]\nnegate: 1\n"
    (tmp_path / "a.yaml").write_text(yaml)
    for words in ((), ("--force",)):
        command = ("map", "plan", tmp_path / "a.jpg", "-o", tmp_path / "a.yaml", *words)
        call(*command).ends(1, "a.yaml: is read by this command")
    assert (tmp_path / "a.yaml").read_text() == yaml
    for name in ("a", "b"):  # light on dark, and it is not
        (tmp_path / "a.yaml").write_text(yaml.replace("a.jpg", f"{name}.jpg"))
        (tmp_path / "a.yaml").rename(tmp_path / f"{name}.yaml")
        (tmp_path / "b.jpg").write_bytes((folder / "drawing.jpg").read_bytes())
        run = call("map", "plan", tmp_path / f"{name}.jpg", "-o", tmp_path / f"{name}-map.yaml",
                   "--json")  # fmt: skip
        doubted = run.code != 0 or rows(run.out)[0]["doubt"] is not None
        assert doubted == (name == "b"), run.err
        (tmp_path / f"{name}.yaml").rename(tmp_path / "a.yaml")
