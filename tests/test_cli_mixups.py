"""What users mix up, through the command: one line that names the cause and what mends it."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from command import MAPS, Run, call, rows

from imgloc import ScanSet, Sensor, load_scans, save_scans, simulate
from imgloc.io.images import encode_png, read_image
from imgloc.simulation.worlds import WORLDS, render

OFF = "--no-cache"


@pytest.fixture(scope="module")
def scans(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scans") / "a.npz"
    sensor = Sensor(rays=180, fov=2 * np.pi)
    save_scans(path, simulate(render(WORLDS["curved"](), 0.1), 2, 5, sensor))
    return path


def changed(path: Path, name: str, **more: object) -> Path:
    """The scans with arrays replaced."""
    with np.load(path) as held:
        arrays = dict(held) | {k: v(held) if callable(v) else v for k, v in more.items()}
    target = path.with_name(name)
    np.savez(target, **arrays)
    return target


@pytest.mark.parametrize(
    ("factor", "reach", "hint"),
    [
        (1000.0, 30_000.0, "half of the ranges.*are they millimetres. Try --range-scale 0.001"),
        (1000.0, 30.0, "half of the ranges.*are they millimetres. Try --range-scale 0.001"),
        (100.0, 3000.0, "half of the ranges.*are they centimetres. Try --range-scale 0.01"),
        (0.5, 15.0, "multiplied by 2: is the map's resolution right. .*or --resolution 0.05"),
    ],
)
def test_units_are_mended(scans: Path, factor: float, reach: float, hint: str) -> None:
    path = changed(scans, "b.npz", ranges=lambda a: factor * a["ranges"], range_max=reach)
    run = call("localize", "curved", path, OFF).ends(0)
    assert re.search(hint, run.err), run.err
    if factor == 0.5:  # the page and the picture of one of them say it, too
        page = path.with_suffix(".html")
        said = call(
            "localize", "curved", path, OFF, "--scans-index", 1, "--explain", page, "--force"
        )
        assert re.search("this scan fits at one place if ranges are " + hint[:14], said.err)
        assert "What to look at next" in page.read_text("utf-8")
    (option,) = re.findall(r"--range-scale (\S+?)[,\s]", run.err + "\n")
    mended = rows(call("localize", "curved", path, OFF, "--json", "--range-scale", option).out)
    assert [row["verdict"] for row in mended] == ["unique", "unique"]


def test_units_that_numbers_do_not_tell_are_both_named_and_a_map_decides(scans: Path) -> None:
    path = changed(scans, "e.npz", ranges=lambda a: 300 * a["ranges"], range_max=np.inf)
    run = call("inspect", path).ends(0)
    either = "are they millimetres (--range-scale 0.001) or centimetres (--range-scale 0.01)?\n"
    assert either in run.out
    assert "--range-scale" not in run.out.split("next")[1]
    path = changed(scans, "e.npz", ranges=lambda a: 1000 * a["ranges"].clip(0, 8), range_max=8000)
    assert either in call("inspect", path).out
    assert "--range-scale 0.001" in call("inspect", "curved", path).out.split("next")[1]


@pytest.mark.parametrize(("view", "said"), [
    (270, "one place if the field of view is 270 degrees, not 360. Try --fov-deg 270"),
    (100, "is --fov-deg right, 360 degrees? If so, "),
])  # fmt: skip
def test_a_stated_view_is_the_first_suspect(view: int, said: str, tmp_path: Path) -> None:
    grid, path = render(WORLDS["curved"](), 0.1), tmp_path / "a.csv"
    seen = simulate(grid, 2, 5, Sensor(rays=1 + view, fov=np.deg2rad(view))).scans
    path.write_text("\n".join(",".join(f"{r:.3f}" for r in scan.ranges) for scan in seen))
    assert said in call("localize", "curved", path, "--fov-deg", 360).err
    run = call("inspect", "curved", path, "--fov-deg", 360)
    assert said in run.out
    assert ("--fov-deg 270" in run.out.split("next")[1]) == (view == 270)


def test_a_map_that_no_scan_is_sure_of_is_no_good_one(scans: Path) -> None:
    run = call("inspect", "double_wall", scans)
    assert "on the map  undecided, 2 scans tried: 1 ambiguous, 1 no-match" in run.out
    assert "map: none of the scans tried have one place on this map, and the recorded" in run.out
    assert "on the map  good, 2 scans tried: 2 unique" in call("inspect", "curved", scans).out


def test_what_changes_nothing_is_said(scans: Path) -> None:
    run = call("localize", "curved", scans, OFF, "--max-turn-deg", 30)
    assert "--max-speed and --max-turn-deg change nothing: the scans have no time_in" in run.err
    run = call("localize", "curved", scans, OFF, "--negate")
    assert "look swapped; where --negate was passed leave it out" in run.err


def test_scans_of_another_place_end_with_what_to_look_at(scans: Path) -> None:
    noise = np.random.default_rng(1).uniform(0.5, 9, (2, 180))
    run = call("localize", "curved", changed(scans, "c.npz", ranges=noise), OFF)
    assert "most scans do not fit this map: is it the map of this place?" in run.err
    none = changed(scans, "d.npz", ranges=np.full((2, 180), np.nan))
    run = call("localize", "curved", none, OFF)
    assert "too few readings to be placed: of 360 readings 0 valid" in run.err
    assert "360 nan" in run.err


def test_a_map_with_black_and_white_swapped_is_told_by_check_and_localize(tmp_path, scans):
    pixels = read_image(MAPS / "curved.png").pixels
    grey = np.where(pixels == 254, 0, np.where(pixels == 0, 254, 205)).astype(np.uint8)
    (tmp_path / "m.png").write_bytes(encode_png(grey))
    said = (MAPS / "curved.yaml").read_text().replace("curved.png", "m.png")
    (tmp_path / "m.yaml").write_text(said)
    check = call("map", "check", tmp_path / "m.yaml")
    assert "swapped: free space is as thin as walls" in check.out
    run = call("localize", tmp_path / "m.yaml", scans, OFF)
    assert "try --no-negate, else --negate with --occupied-thresh 0.9" in run.err
    mend = ("--negate", "--occupied-thresh", 0.9)
    run = call("localize", tmp_path / "m.yaml", scans, OFF, "--json", *mend)
    assert [row["verdict"] for row in rows(run.out)] == ["unique", "unique"]
    assert "swapped" not in run.err
    for name in WORLDS:
        assert "swapped" not in call("map", "check", name).out


def test_a_resolution_that_makes_a_doll_s_house_is_told(tmp_path: Path) -> None:
    for cell, said in (("0.005", "0.005 m per cell, right?"), ("5", "Try --resolution 0.05")):
        assert said in call("map", "check", "curved", "--resolution", cell).out
    assert "scale" not in call("map", "check", "curved").out


def test_map_and_scans_in_the_wrong_order(scans: Path) -> None:
    order = "the order is MAP, then SCANS"
    for arguments, code in (
        ((scans, MAPS / "curved.yaml"), 2),
        ((MAPS / "curved.yaml", MAPS / "curved.png"), 2),
        ((MAPS / "curved.yaml", MAPS / "curved.yaml"), 4),
    ):
        call("localize", *arguments).ends(code, order, out="")


def test_a_folder_is_named_with_what_is_in_it(scans: Path) -> None:
    run = call("localize", MAPS, scans)
    run.ends(3, "is a folder, expected a map YAML or image", "in it there is corridor.png")
    call("localize", "curved", MAPS).ends(4, "is a folder, expected a file of scans")


def test_degrees_are_named_by_their_key(tmp_path: Path) -> None:
    path = tmp_path / "a.jsonl"
    path.write_text('{"ranges": [1, 2, 3], "angle_min": -1.5, "angle_increment": 57.3}\n')
    run = call("localize", "curved", path)
    run.ends(4, "line 1: angle_increment: got 57.3, expected radians; are these degrees?")
    path.write_text('{"ranges": [1, 2], "angle_min": -1, "angle_max": 1, "pose": [0, 0, 90]}\n')
    run = call("localize", "curved", path)
    assert "pose: got a theta of 90, expected radians; are these degrees?" in run.err


def test_a_prior_off_the_map_and_a_missing_image_are_named(scans: Path, tmp_path: Path) -> None:
    run = call("localize", "curved", scans, OFF, "--near", "500,500,0", "--clearance", 0.2)
    assert run.code == 2
    assert "--near 500,500,0 with --clearance 0.2: the prior leaves no cell" in run.err
    assert "the map has 16.0 x 13.0 m, its lower-left corner at 0,0" in run.err
    said = (MAPS / "curved.yaml").read_text().replace("curved.png", "gone.png")
    (tmp_path / "m.yaml").write_text(said)
    run = call("localize", tmp_path / "m.yaml", scans, OFF)
    run.ends(3, "gone.png: no such file; ", "m.yaml names it as its image")


def lines_of(scans: Path, count: int) -> list[str]:
    """JSON lines of the first of some scans, with its pose."""
    scan, pose = load_scans(scans)[0], load_scans(scans).poses[0].tolist()
    line = {"ranges": scan.ranges.tolist(), "angles": scan.angles.tolist(), "range_max": 10}
    return [json.dumps(line | {"pose": pose})] * count


def test_evaluate_says_at_once_how_scans_are_given(scans: Path) -> None:
    run = call("evaluate", "curved", scans)
    run.ends(2, f"{scans} is a file of scans, expected a map: pass --scans {scans}", out="")
    assert call("evaluate", "curved", "--scans", scans, "--method", "fused").code == 0
    call("evaluate", "curved", "gone.yaml", "-n", "100000").ends(3, "gone.yaml: no such file")


def test_evaluate_and_batch_end_with_the_lines_that_were_left_out(scans, tmp_path):
    log = tmp_path / "a.jsonl"
    log.write_text("\n".join([*lines_of(scans, 110), '{"ranges": [1,']) + "\n")
    few = ("--sample", 2)
    run = call("evaluate", "curved", "--scans", log, "--method", "fused", *few).ends(0)
    assert "a.jsonl: left out 1 of 111 lines" in run.err.splitlines()[-1]
    run = call("batch", MAPS / "curved.yaml", log, "--out", tmp_path / "out", OFF, *few).ends(0)
    assert "left out 1 of 111 lines, which are broken" in run.out.splitlines()[-2]


def test_a_batch_of_nothing_leaves_nothing_behind(scans: Path, tmp_path: Path) -> None:
    out, gone = tmp_path / "out", tmp_path / "nofolder"
    for arguments, code in (((gone, scans), 3), (("curved", gone), 4), ((gone,), 3)):
        job = () if len(arguments) > 1 else ("--job", "check")
        run = call("batch", *arguments, "--out", out, *job, OFF)
        assert (run.code, "nofolder: no such file or folder" in run.err) == (code, True), run.err
        assert not out.exists()
        assert not gone.exists()


def test_a_batch_ends_with_why_items_failed(scans: Path, tmp_path: Path) -> None:
    folder = tmp_path / "runs"
    folder.mkdir()
    (folder / "good.npz").write_bytes(scans.read_bytes())
    for name in ("a.log", "b.log"):
        (folder / name).write_bytes(b"")
    (folder / "cut.npz").write_bytes(scans.read_bytes()[:200])
    run = call("batch", MAPS / "curved.yaml", folder, "--out", tmp_path / "out", OFF).ends(5)
    failed = {line for line in run.out.splitlines() if line.startswith("failed")}
    empty = "failed: a.log on curved.yaml and 1 more: the file is empty, expected a scan file"
    assert empty in failed
    assert any(line.startswith("failed: cut.npz on curved.yaml: damaged NPZ") for line in failed)
    assert len(failed) == 2


def hint_of(run: Run) -> str:
    """The only hint of a run: what stands below the words about all scans."""
    lines = [line.removeprefix("imgloc: ") for line in run.err.splitlines()]
    (hint,) = (line for line in lines if "recorded poses" not in line and "scans: " not in line)
    return hint


@pytest.mark.parametrize("given", [("--heading", "-1,0.1"), ("--near", "3,3,1,0.4,0.2")])
def test_a_wrong_prior_is_named_with_the_place_that_it_leaves_out(scans, given):
    right = rows(call("localize", "curved", scans, OFF, "--json").out)
    run = call("localize", "curved", scans, OFF, *given)
    pose = right[0]["pose"]
    at = f"x {pose['x']:.2f} m, y {pose['y']:.2f} m"
    assert f"the first at {at}" in hint_of(run)
    assert hint_of(run).endswith(f"lies outside {given[0]}: is it right?")
    one = call("localize", "curved", scans, OFF, *given, "--scans-index", 0)
    assert hint_of(one).startswith(f"the best fit, at {at}")


def test_priors_that_leave_the_place_out_are_named_together(scans: Path) -> None:
    run = call("localize", "curved", scans, OFF, "--near", "3,3,1,0.4,0.2", "--clearance", 0.2)
    assert hint_of(run).endswith("lies outside --near and --clearance: are they right?")


def test_a_hint_about_few_readings_is_two_sentences(scans: Path) -> None:
    run = call("localize", "curved", scans, OFF, "--range-max", 0.01)
    assert "0 nan. Most rays met nothing within range_max, 0.01 m: is it right" in hint_of(run)


@pytest.mark.parametrize("folder", [".", "/"])
def test_a_folder_without_a_name_is_no_map(scans, tmp_path, monkeypatch, folder):
    monkeypatch.chdir(tmp_path)
    for use in (
        ("localize", folder, scans), ("track", folder, scans), ("map", "check", folder),
        ("map", "show", folder, "--out", "a.png"), ("map", "plan", folder, "--out", "p.yaml"),
        ("map", "align", folder, "curved"), ("map", "changes", folder, scans),
        ("sample", folder, scans, "--out", "a.csv"), ("atlas", folder, "--out", "a.png"),
        ("calibrate", folder, "--scans", scans), ("evaluate", folder),
        ("simulate", folder, "--out", "a.npz"),
    ):  # fmt: skip
        run = call(*use)
        assert (run.code, f"error: {folder}: is a folder, expected a" in run.err) == (3, True), run
    assert not list(tmp_path.iterdir())


def test_what_was_given_is_not_advised_again(scans: Path) -> None:
    run = call("localize", "double_wall", scans, OFF, "--flipped")
    assert "--flipped" not in run.err
    run = call("localize", "curved", scans, OFF, "--flipped")
    assert hint_of(run).endswith("Leave out --flipped")
    run = call("localize", "curved", scans, OFF, "--range-scale", 2)
    assert "Try --range-scale 1, or" in hint_of(run)


def test_a_mirrored_map_has_one_hint_and_the_command_with_it_works(scans, tmp_path):
    (tmp_path / "m.png").write_bytes(
        encode_png(np.ascontiguousarray(read_image(MAPS / "curved.png").pixels[:, ::-1]))
    )
    said = (MAPS / "curved.yaml").read_text().replace("curved.png", "m.png")
    (tmp_path / "m.yaml").write_text(said)
    run = call("localize", tmp_path / "m.yaml", scans, OFF)
    assert hint_of(run).endswith("or the map's image mirrored? Try --flipped")
    run = call("localize", tmp_path / "m.yaml", scans, OFF, "--flipped", "--json")
    assert [row["verdict"] for row in rows(run.out)] == ["unique", "unique"]


def test_a_row_of_the_report_opens_a_page_that_explains_the_answer(scans, tmp_path):
    noise = np.random.default_rng(1).uniform(0.5, 9, (1, 180))
    mixed = changed(scans, "mixed.npz", ranges=lambda a: np.concatenate((noise, a["ranges"])),
                    poses=lambda a: np.concatenate((np.zeros((1, 3)), a["poses"])))  # fmt: skip
    out = tmp_path / "out"
    shown = ("--pictures", "all", OFF)
    assert call("batch", MAPS / "curved.yaml", mixed, "--out", out, *shown).code == 0
    (row,) = (json.loads(line) for line in (out / "results.jsonl").read_text().splitlines())
    pages = [answer.get("page") for answer in row["answers"]]
    assert [page is not None for page in pages] == [True, False, False]
    text = (out / "pictures" / pages[0]).read_text("utf-8")
    assert "curved: mixed.npz, scan 0: no-match" in text
    assert call("report", out).code == 0
    assert json.dumps(pages[0]) in (out / "report.html").read_text("utf-8")


def test_a_corridor_scanned_upside_down_has_not_aged(shared: Path, tmp_path: Path) -> None:
    # Both sides of it are alike, so that most scans fit it mirrored, but for the doors.
    place = shared / "data" / "fr079"
    some = load_scans(place / "scans.npz").scans[:28:2]
    save_scans(tmp_path / "turned.npz", ScanSet(tuple(scan.flipped for scan in some)))
    run = call("localize", place / "map.yaml", tmp_path / "turned.npz")
    assert run.out.count(" unique ") > 7
    assert "aged" not in run.err
    assert hint_of(run).startswith("scans like these fit at one place if mirrored: ")
    assert hint_of(run).endswith("Try --flipped")
