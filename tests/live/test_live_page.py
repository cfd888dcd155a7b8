"""The page of `imgloc serve` in a real browser, against the real service."""

import base64
import contextlib
import json
import re
import shlex
import shutil
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest
from command import MAPS, call, rows
from places import drive
from serving import served

from imgloc import LaserScan, Localizer, OccupancyGrid, ScanSet, load_map, load_scans, save_scans
from imgloc.simulation.scans import simulate_ranges
from imgloc.simulation.worlds import WORLDS, render

pytest.importorskip("starlette", reason="starlette is not installed")
sync = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
uvicorn = pytest.importorskip("uvicorn", reason="uvicorn is not installed")
if shutil.which("chromium") is None:
    pytest.skip("chromium is not installed", allow_module_level=True)

ANGLES = np.deg2rad(np.arange(-180, 180, 3.0))
POSES = np.array([[4.0 + 0.5 * k, 8.0, 0.02 * k] for k in range(6)])
WAIT = 60_000  # milliseconds, which only what fails takes
sync.expect.set_options(timeout=WAIT)
EVIL = "<img src=x onerror=window.hit=1>"


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive through ``visibility`` with odometry."""
    path = tmp_path_factory.mktemp("log") / "log.npz"
    save_scans(path, replace(drive(POSES), poses=None))
    return path


@pytest.fixture(scope="module")
def service() -> Iterator[str]:
    """The address of `imgloc serve`."""
    with served(MAPS / "visibility.yaml") as one:
        yield one.address


@contextlib.contextmanager
def opened(browser: Any, address: str, **options: Any) -> Iterator[Any]:
    """The page, which says nothing to the console, and asks no other host."""
    context = browser.new_context(
        **{"viewport": {"width": 1400, "height": 900}, **options},
        permissions=["clipboard-read", "clipboard-write"],
    )
    context.set_default_timeout(WAIT)
    page, said, hosts = context.new_page(), list[str](), set[str]()
    page.on("console", lambda m: said.append(m.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on(
        "request", lambda one: hosts.add(urlsplit(one.url).netloc) if "://" in one.url else None
    )
    page.on("websocket", lambda one: hosts.add(urlsplit(one.url).netloc))
    page.goto(address)
    page.locator("body:not(.empty)").wait_for()
    yield page
    # What the browser itself notes of an answer that is an error is no word of the page.
    assert [text for text in said if not text.startswith("Failed to load resource")] == []
    assert {host for host in hosts if host} <= {urlsplit(address).netloc}
    context.close()


@pytest.fixture
def page(browser: Any, service: str, request: pytest.FixtureRequest) -> Iterator[Any]:
    with opened(browser, service, **getattr(request, "param", {})) as page:
        yield page


def drop(page: Any, *files: tuple[str, bytes]) -> None:
    """Drop files on the page, as from a file manager."""
    given = [[name, base64.b64encode(data).decode()] for name, data in files]
    page.evaluate(
        """(given) => {
            const dataTransfer = new DataTransfer();
            for (const [name, data] of given) {
                const bytes = Uint8Array.from(atob(data), (c) => c.charCodeAt(0));
                dataTransfer.items.add(new File([bytes], name));
            }
            for (const type of ["dragover", "drop"]) {
                document.getElementById("stage").dispatchEvent(
                    new DragEvent(type, { dataTransfer, bubbles: true, cancelable: true }));
            }
        }""",
        given,
    )


def answered(page: Any, index: int = 0) -> str:
    """Wait until a scan has been answered; what a screen reader says."""
    live = page.locator("#live")
    sync.expect(live).to_have_text(re.compile(rf"^Scan {index}: \S+\. "))
    return str(live.inner_text())


def located(page: Any, path: Path) -> str:
    """Drop a log on the page; what a screen reader says once its first scan has been answered."""
    drop(page, (path.name, path.read_bytes()))
    return answered(page)


def shown_pose(page: Any) -> tuple[float, float, float]:
    """x and y in metres and the heading in degrees at which the scan is drawn."""
    words = page.locator("#pose-where").inner_text().replace("−", "-")
    x, y, heading = map(float, re.findall(r"-?\d+\.\d+", words))
    return x, y, heading


def sensor_at(page: Any, px: float, py: float) -> tuple[float, float, float]:
    """Put the sensor at a pixel of the canvas by a double click; the pose that this is."""
    before = page.locator("#pose-where").inner_text()
    box = page.locator("#canvas").bounding_box()
    page.mouse.dblclick(box["x"] + px, box["y"] + py)
    sync.expect(page.locator("#pose-where")).not_to_have_text(before)
    return shown_pose(page)


def drag(page: Any, *points: tuple[float, float]) -> None:
    """Press, drag and release the mouse along pixels of the canvas."""
    box = page.locator("#canvas").bounding_box()
    (x, y), *rest = [(box["x"] + px, box["y"] + py) for px, py in points]
    page.mouse.move(x, y)
    page.mouse.down()
    for to in rest:
        page.mouse.move(*to, steps=4)
    page.mouse.up()


def copied(page: Any, key: str) -> str:
    """What a key has copied: c, the command, or y, Python."""
    page.keyboard.press(key)
    first = {"c": "^imgloc ", "y": "^import imgloc"}[key]
    sync.expect(page.locator("#copied")).to_have_value(re.compile(first))
    return str(page.locator("#copied").input_value())


def test_a_map_and_scans_that_are_dropped_are_answered_as_the_command_does(page, tmp_path):
    scans = tmp_path / "some.npz"
    assert call("simulate", MAPS / "curved.yaml", "-n", 3, "--out", scans).code == 0
    drop(
        page, *((f"curved.{end}", (MAPS / f"curved.{end}").read_bytes()) for end in ("yaml", "png"))
    )
    sync.expect(page.locator("#map option:checked")).to_have_text("curved")
    said = located(page, scans)
    row = rows(call("localize", MAPS / "curved.yaml", scans, "--scans-index", 0, "--json").out)[0]
    assert f"Scan 0: {row['verdict']}." in said
    listed = page.locator("#hypotheses li")
    assert listed.count() == min(20, len(row["hypotheses"]))
    best = row["hypotheses"][0]
    assert shown_pose(page) == pytest.approx(
        (best["x"], best["y"], np.rad2deg(best["theta"])), abs=0.051
    )
    assert page.locator("#word").inner_text() == row["verdict"]
    sync.expect(page.locator("#count-unexplained")).to_have_text(re.compile(r"\d"))
    kinds = {
        key: int(page.locator(f"#count-{key}").inner_text()) for key in ("agrees", "unexplained")
    }
    assert kinds["agrees"] > 0.8 * row["counts"]["valid"] > kinds["unexplained"]


def test_maps_of_one_name_are_told_apart_and_are_there_after_a_reload(page: Any) -> None:
    image, yaml = ((MAPS / f"curved.{end}").read_bytes() for end in ("png", "yaml"))
    drop(page, ("visibility.yaml", yaml), ("curved.png", image))
    chosen = page.locator("#map option:checked")
    sync.expect(chosen).to_have_text("visibility (2)")
    sync.expect(page.locator("#trouble")).to_be_hidden()
    page.reload()
    sync.expect(page.locator("#map option")).to_have_text(["visibility (1)", "visibility (2)"])
    other = page.context.browser.new_page()  # of somebody else
    other.goto(page.url)
    sync.expect(other.locator("#map option")).to_have_text(["visibility"])
    other.close()


@pytest.mark.parametrize("image", ["map", "hall 2"])
def test_a_map_that_is_called_map_has_the_name_of_its_folder_or_of_its_image(page, tmp_path, image):
    folder = tmp_path / "annex"
    folder.mkdir()
    text = (MAPS / "curved.yaml").read_text().replace("curved.png", f"{image}.png")
    (folder / "map.yaml").write_text(text)
    shutil.copy(MAPS / "curved.png", folder / f"{image}.png")
    (folder / "notes.txt").write_text("of the folder only its map is taken")
    drop(page, (f"{image}.png", (MAPS / "curved.png").read_bytes()), ("map.yaml", text.encode()))
    sync.expect(page.locator("#map option:checked")).to_have_text(image)
    box = page.locator("#canvas").bounding_box()
    devtools = page.context.new_cdp_session(page)
    for kind in ("dragEnter", "dragOver", "drop"):
        data = {"items": [], "files": [str(folder)], "dragOperationsMask": 1}
        where = {"type": kind, "x": box["x"] + 99, "y": box["y"] + 99, "data": data}
        devtools.send("Input.dispatchDragEvent", where)
    sync.expect(page.locator("#map option:checked")).to_have_text("annex")


def test_a_resolution_that_makes_a_map_of_kilometres_is_asked_for_twice(page: Any) -> None:
    drop(page, ("bare.png", (MAPS / "curved.png").read_bytes()))
    size, use = page.locator("#reading-size"), page.get_by_role("button", name="Use it")
    sync.expect(size).to_have_text(re.compile(r"^A map of \d+\.\d m × \d+\.\d m\.$"))
    page.get_by_label("Resolution").fill("10")
    sync.expect(size).to_contain_text("Is a pixel 10 m wide?")
    use.click()
    sync.expect(page.locator("#reading")).to_be_visible()
    use.click()
    sync.expect(page.locator("#map option:checked")).to_have_text("bare")


def test_an_image_alone_is_asked_for_its_resolution(page: Any) -> None:
    drop(page, ("bare.png", (MAPS / "curved.png").read_bytes()))
    page.get_by_label("Resolution").fill("0.1")
    page.locator("#origin-x").fill("-3")
    page.get_by_role("button", name="Use it").click()
    sync.expect(page.locator("#map option:checked")).to_have_text("bare")
    assert copied(page, "c") == "imgloc map check bare.png --resolution=0.1 --origin=-3,0,0\n"


def test_the_scan_is_dragged_turned_and_settled(page: Any, log: Path) -> None:
    located(page, log)
    best, score = shown_pose(page), page.locator("#pose-score")
    x0, y0, heading = sensor_at(page, 400, 300)
    x1, y1, _ = sensor_at(page, 500, 400)
    scale = (x1 - x0) / 100
    assert y0 - y1 == pytest.approx(100 * scale, abs=0.02)  # y is up
    before = score.inner_text()
    drag(page, (500, 400), (560, 370))
    sync.expect(page.locator("#pose-title")).to_have_text("Pose set by hand")
    assert shown_pose(page) == pytest.approx((x1 + 60 * scale, y1 + 30 * scale, heading), abs=0.02)
    sync.expect(score).not_to_have_text(before)
    # Its handle is 46 pixels ahead.
    turn = np.deg2rad(heading)
    drag(page, (560 + 46 * np.cos(turn), 370 - 46 * np.sin(turn)), (560, 250))
    assert shown_pose(page)[2] == pytest.approx(90, abs=1)
    # A little beside the best pose it falls back into it.
    page.keyboard.press("1")
    sync.expect(page.locator("#pose-title")).to_have_text("Hypothesis 1")
    for key in ("ArrowLeft", "ArrowUp", "ArrowUp", "q", "q"):
        page.keyboard.press(key)
    assert shown_pose(page) == pytest.approx((best[0] - 0.05, best[1] + 0.1, best[2] + 2), abs=0.11)
    sync.expect(page.locator("#pose-against")).to_contain_text("less likely")
    # The pose says when it has settled; the score may still be an answer to one of the keys.
    where = page.locator("#pose-where")
    beside = where.inner_text()
    page.keyboard.press("s")
    sync.expect(where).not_to_have_text(beside)
    sync.expect(page.locator("#note")).to_be_hidden()
    sync.expect(page.locator("#pose-against")).not_to_contain_text("more than")
    assert shown_pose(page) == pytest.approx(best, abs=0.11)


def test_a_reading_under_the_pointer_says_why(page: Any, log: Path) -> None:
    located(page, log)
    page.keyboard.press(".")
    tip = page.locator("#tip")
    sync.expect(tip).to_contain_text(re.compile(r"Reading 0: \d+\.\d\d m at −180\.0°"))
    sync.expect(tip).to_contain_text("The map explains it: it ends")
    page.keyboard.press("Shift+ArrowUp")
    page.keyboard.press("Shift+ArrowUp")
    sync.expect(tip).not_to_contain_text("The map explains it")
    # The pointer asks, too: at the end of the reading that is shown.
    where = tip.bounding_box()
    page.keyboard.press("Escape")
    sync.expect(tip).to_be_hidden()
    page.mouse.move(where["x"] - 14, where["y"] - 14)
    sync.expect(tip).to_contain_text("Reading ")


def test_what_is_known_changes_the_answer(page: Any, log: Path) -> None:
    first = located(page, log)
    best = shown_pose(page)
    sensor_at(page, 300, 300)
    x0, y0, _ = shown_pose(page)
    x1 = sensor_at(page, 400, 300)[0]
    scale = 100 / (x1 - x0)

    def pixel(x: float, y: float) -> tuple[float, float]:
        return 300 + (x - x0) * scale, 300 - (y - y0) * scale

    # A region that leaves the best pose out.
    page.keyboard.press("r")
    left, low = pixel(best[0] + 2, best[1] - 3)
    right, high = pixel(best[0] + 8, best[1] + 3)
    drag(page, (left, low), (right, high))
    sync.expect(page.locator("#known-words")).to_have_text(
        re.compile(r"^In a region of 3\d\.\d m²")
    )
    sync.expect(page.locator("#live")).not_to_have_text(first)
    x = shown_pose(page)[0]
    assert best[0] + 1.4 < x < best[0] + 8.6
    page.keyboard.press("x")
    sync.expect(page.locator("#live")).to_have_text(first)
    # An arrow at the best pose, that points the other way.
    page.get_by_role("button", name="Arrow").click()
    at = pixel(*best[:2])
    drag(page, at, (at[0] - 60, at[1]))
    sync.expect(page.locator("#known-words")).to_contain_text("heading")
    sync.expect(page.locator("#live")).not_to_have_text(first)
    assert abs(shown_pose(page)[2]) > 180 - 60
    page.keyboard.press("x")
    sync.expect(page.locator("#live")).to_have_text(first)
    page.get_by_label("Free space around the sensor").fill("0.3")
    page.get_by_label("Free space around the sensor").press("Enter")
    sync.expect(page.locator("#known-words")).to_have_text("At least 0.3 m from walls.")


def test_what_is_refused_is_not_known_and_leaves_no_answer(page: Any, log: Path) -> None:
    first = located(page, log)
    room, words = page.get_by_label("Free space around the sensor"), page.locator("#known-words")
    room.fill("0.3")
    room.press("Enter")
    sync.expect(words).to_have_text("At least 0.3 m from walls.")
    answered(page)
    sync.expect(page.locator("#note")).to_be_hidden()
    room.fill("99999")
    room.press("Enter")
    sync.expect(page.locator("#trouble")).to_contain_text("99999")
    sync.expect(page.locator("#word")).to_have_text("No answer")
    sync.expect(page.locator("#verdict")).not_to_have_class("unique")
    for part in ("#answer", "#pose"):
        sync.expect(page.locator(part)).to_be_hidden()
    sync.expect(words).to_have_text("At least 0.3 m from walls.")
    sync.expect(room).to_have_value("0.3")
    page.keyboard.press("Escape")
    page.get_by_role("button", name="Forget").click()
    sync.expect(page.locator("#live")).to_have_text(first)
    sync.expect(page.locator("#trouble")).to_be_hidden()
    sync.expect(page.locator("#answer")).to_be_visible()


def test_a_slider_goes_along_the_log_and_the_tracker_follows_it(page: Any, log: Path) -> None:
    located(page, log)
    slider = page.get_by_label("Scan", exact=True)
    slider.focus()
    page.keyboard.press("End")
    last = len(POSES) - 1
    assert f"Scan {last}: unique." in answered(page, last)
    assert shown_pose(page)[:2] == pytest.approx(POSES[last, :2], abs=0.1)
    page.keyboard.press("Home")
    answered(page, 0)
    page.get_by_role("button", name="The next scan").click()
    answered(page, 1)
    live, heard = page.locator("#live"), "window.heard = new Set()"
    page.evaluate(f"""() => {{ {heard}; new MutationObserver(() => heard.add(
        document.getElementById("live").textContent)).observe(
        document.getElementById("live"), {{ childList: true }}); }}""")
    page.get_by_role("button", name="Follow").click()
    sync.expect(page.locator("#tracked")).to_contain_text(re.compile("Tracker: (unique|ambiguous)"))
    sync.expect(live).to_contain_text(f"Scan {last}: unique.")
    assert any("the tracker says" in text for text in page.evaluate("[...heard]"))
    counts = [page.locator(f"#count-{kind}").inner_text() for kind in ("agrees", "unexplained")]
    assert int(counts[0]) > int(counts[1])
    numbers = f"Scan {last}. The first is 0, the last {last}."
    sync.expect(page.locator("#number")).to_have_text(numbers)
    sync.expect(page.get_by_role("button", name="Follow")).to_be_visible()
    tracked = page.locator("#tracked").inner_text()
    row = rows(call("track", MAPS / "visibility.yaml", log, "--json").out)[-1]
    assert f"Tracker: {row['verdict']}" in tracked
    x, y, *_ = map(float, re.findall(r"-?\d+\.\d+", tracked.replace("−", "-")))
    assert (x, y) == pytest.approx((row["pose"]["x"], row["pose"]["y"]), abs=0.011)


def test_true_poses_are_marked_and_saved(page: Any, log: Path, tmp_path: Path) -> None:
    drop(page, (log.name, log.read_bytes()))
    expected = {}
    for k in (0, 2):
        page.get_by_label("Scan", exact=True).fill(str(k))
        answered(page, k)
        page.get_by_role("button", name="Mark as true").click()
        expected[k] = shown_pose(page)
    sync.expect(page.locator("#marked")).to_have_text("2 of 6 scans have a true pose.")
    with page.expect_download() as given:
        page.get_by_role("button", name="Save as NPZ").click()
    out = tmp_path / given.value.suggested_filename
    assert out.name == "log-marked.npz"
    given.value.save_as(out)
    saved, whole = load_scans(out), load_scans(log)
    assert len(saved) == 2
    for row, k in enumerate(expected):
        assert np.array_equal(saved[row].ranges, whole[k].ranges)
        x, y, heading = expected[k]
        assert saved.poses[row] == pytest.approx((x, y, np.deg2rad(heading)), abs=0.006)
        assert saved.poses[row] == pytest.approx(POSES[k], abs=0.1)


def pixels(page: Any) -> bytes:
    return bytes(page.locator("#canvas").screenshot())


def changed(page: Any, before: bytes) -> None:
    """Wait until the canvas shows something else."""
    for _ in range(WAIT // 250):
        if pixels(page) != before:
            return
        page.wait_for_timeout(250)
    pytest.fail("the canvas has not changed")


STACKS = ["cbml", "cbml-o", "ght", "ght-v", "beam"]


def test_layers(page: Any, log: Path) -> None:
    located(page, log)
    sync.expect(page.locator("#note")).to_be_hidden()
    shown, chosen = pixels(page), page.get_by_label("Layer on the map")
    for layer in (*STACKS, "bmap", "vmap", "distance", "visibility", "atlas"):
        chosen.select_option(layer)
        if layer == "visibility":
            page.mouse.move(500, 450)
        key = {"visibility": "#layer-hint", "vmap": "#layer-hint", "atlas": "#atlas-key"}.get(
            layer, "#scale"
        )
        sync.expect(page.locator(key)).to_be_visible()
        sync.expect(page.locator("#trouble")).to_be_hidden()
        changed(page, shown)
        shown = pixels(page)
        if layer in STACKS[:-1]:  # beam is a point or two
            sync.expect(page.locator("#slice-words")).to_have_text("best of all headings")
            page.keyboard.press(">")
            sync.expect(page.locator("#slice-words")).to_have_text(re.compile(r"^heading −?\d+°$"))
            changed(page, shown)
            shown = pixels(page)


def test_the_copied_command_and_python_give_the_same_answer(page, log, monkeypatch):
    located(page, log)
    page.keyboard.press("k")  # what is known: about here
    answered(page)
    page.get_by_label("Free space around the sensor").fill("0.2")
    page.get_by_label("Free space around the sensor").press("Enter")
    said = answered(page)
    page.get_by_role("button", name="Copy as command").click()
    text = page.evaluate("navigator.clipboard.readText()")
    assert text == page.locator("#copied").input_value()
    monkeypatch.chdir(log.parent)
    program, *words = shlex.split(text)
    assert program == "imgloc"
    row = rows(call(*words, "--json").out)[0]
    assert f"Scan 0: {row['verdict']}." in said
    assert set(row["parameters"]["prior"]) == {"near", "clearance"}
    values: dict[str, Any] = {}
    exec(copied(page, "y"), values)
    assert values["answer"].best.x == pytest.approx(row["hypotheses"][0]["x"], abs=1e-6)
    # Of a pose that was set by hand, what its readings say.
    page.keyboard.press("ArrowUp")
    sync.expect(page.locator("#pose-title")).to_have_text("Pose set by hand")
    exec(copied(page, "y"), values)
    assert sum(values["rays"].counts.values()) == len(ANGLES)


def test_a_region_is_copied_and_what_was_copied_is_shown_until_it_changes(
    page: Any, log: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    located(page, log)
    page.get_by_role("button", name="Region").click()
    for corner in ((200, 300), (700, 300), (700, 650), (200, 650), (202, 303)):
        page.locator("#canvas").click(position={"x": corner[0], "y": corner[1]})
    sync.expect(page.locator("#known-words")).to_contain_text("In a region")
    answered(page)
    monkeypatch.chdir(log.parent)
    values: dict[str, Any] = {}
    exec(copied(page, "y"), values)
    best = values["answer"].best
    assert shown_pose(page)[:2] == pytest.approx((best.x, best.y), abs=0.011)
    text = copied(page, "c")
    sync.expect(page.locator("#note")).to_contain_text("It reads region.png: press “Save region”")
    with page.expect_download() as given:
        page.get_by_role("button", name="Save region").click()
    given.value.save_as(tmp_path / "region.png")
    monkeypatch.chdir(tmp_path)
    row = rows(call(*shlex.split(text.replace("log.npz", str(log)))[1:], "--json").out)[0]
    assert row["hypotheses"][0]["x"] == pytest.approx(best.x, abs=0.05)
    page.get_by_role("button", name="Forget").click()
    sync.expect(page.locator("#copied")).to_be_hidden()


def test_a_file_that_is_cut_says_what_is_left_out(page: Any) -> None:
    line = json.dumps({"ranges": [2.0] * 90, "angle_min": -1.5, "angle_increment": 0.033})
    drop(page, ("cut.jsonl", f"{line}\n{line[:99]}".encode()))
    sync.expect(page.locator("#file")).to_have_text("cut.jsonl")
    left = "cut.jsonl: line 2: the last line was cut off and is left out"
    sync.expect(page.locator("#trouble")).to_contain_text(left)


def test_no_name_is_read_as_html(page: Any, log: Path) -> None:
    drop(page, (f"{EVIL}.npz", log.read_bytes()))
    answered(page)
    assert page.locator("#file").inner_text() == f"{EVIL}.npz"
    yaml = (MAPS / "curved.yaml").read_bytes().replace(b"curved.png", f"'{EVIL}.png'".encode())
    drop(page, (f"{EVIL}.yaml", yaml), (f"{EVIL}.png", (MAPS / "curved.png").read_bytes()))
    drop(page, (f"{EVIL}.csv", EVIL.encode()))
    sync.expect(page.locator("#trouble")).to_contain_text("img src=x")
    assert "'<img src=x onerror=window.hit=1>.npz'" in copied(page, "c")
    assert page.evaluate("[window.hit ?? 0, document.images.length]") == [0, 0]


def test_the_help_sheet_has_all_keys(page: Any) -> None:
    page.keyboard.press("t")
    sync.expect(page.locator("#note")).to_contain_text("There is no scan yet")
    page.keyboard.press("?")
    sheet = page.get_by_role("dialog", name="Keys")
    sync.expect(sheet).to_be_visible()
    assert sheet.locator("kbd").count() >= 25
    assert "settle" in sheet.inner_text()
    page.keyboard.press("Escape")
    sync.expect(sheet).to_be_hidden()


SIZES = [
    {"viewport": {"width": width, "height": 844}, "color_scheme": scheme, "has_touch": width < 500}
    for width, scheme in ((390, "light"), (1400, "dark"))
]


@pytest.mark.parametrize("page", SIZES, indirect=True)
def test_it_fits_on_telephones_and_desks_by_day_and_by_night(page: Any, log: Path) -> None:
    located(page, log)
    width = page.viewport_size["width"]
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    for button in page.get_by_role("button").all():
        if button.is_visible():
            box = button.bounding_box()
            assert box["x"] >= 0
            assert box["x"] + box["width"] <= width
    dark = page.evaluate("matchMedia('(prefers-color-scheme: dark)').matches")
    ground = page.evaluate("getComputedStyle(document.body).backgroundColor")
    assert (sum(map(int, re.findall(r"\d+", ground)[:3])) < 3 * 128) is dark


INK = """() => {
    const canvas = document.getElementById("canvas"), { width, height } = canvas;
    const copy = new OffscreenCanvas(width, height);
    const context = copy.getContext("2d", { willReadFrequently: true });
    context.drawImage(canvas, 0, 0);
    const { data } = context.getImageData(0, 0, width, height);
    let top = height, bottom = 0;
    for (let y = 0; y < height; y += 1) for (let x = 150; x < width; x += 1) { // right of the scale
        const k = 4 * (y * width + x);
        if (data[k + 3] < 255 || data[k] + data[k + 1] + data[k + 2] > 180) continue;
        top = Math.min(top, y);
        bottom = y;
    }
    return [top, bottom];
}"""


@pytest.mark.parametrize("page", [{"viewport": {"width": width, "height": 900}}
                                  for width in (390, 820, 1400)], indirect=True)  # fmt: skip
def test_no_wall_lies_under_a_button_until_the_map_is_moved(page: Any, log: Path) -> None:
    def within(most: float = np.inf) -> float:
        """Wait until all walls are in view and no button is over them; the canvas' height."""
        buttons = """[...document.querySelectorAll(".tools")].map(
            (one) => one.offsetTop + one.offsetHeight)"""
        for _ in range(WAIT // 100):
            top, bottom = page.evaluate(INK)
            height = page.evaluate("document.getElementById('canvas').height")
            lowest = max(page.evaluate(buttons))
            if lowest < top < bottom < height - 20 and height <= most:
                return height
            page.wait_for_timeout(100)
        raise AssertionError((lowest, top, bottom, height, most))

    height = within()
    located(page, log)
    width = page.viewport_size["width"]
    within(height - (width > 832))  # the log takes room
    page.set_viewport_size({"width": width, "height": 700})
    within(height - 1)
    page.locator("#larger").click()
    before = page.evaluate(INK)
    page.set_viewport_size({"width": width, "height": 900})
    page.wait_for_timeout(500)
    after = page.evaluate(INK)
    assert after[1] - after[0] >= before[1] - before[0]  # what somebody has enlarged stays so


@pytest.mark.parametrize("width", [390, 900])
def test_far_poses_are_written_whole(browser: Any, service: str, log: Path, width: int) -> None:
    with opened(browser, service, viewport={"width": width, "height": 900}) as page:
        drop(page, ("far.png", (MAPS / "visibility.png").read_bytes()))
        where = {"resolution": 0.1, "origin-x": -1234.5, "origin-y": -2345.6}
        for field, value in where.items():
            page.locator(f"#{field}").fill(str(value))
        page.get_by_role("button", name="Use it").click()
        sync.expect(page.locator("#map option:checked")).to_have_text("far")
        located(page, log)
        sync.expect(page.locator("#pose-where")).to_contain_text("−1230.")
        rows = page.locator("#hypotheses .where")
        assert rows.count() > 1
        for row in rows.all():
            assert re.fullmatch(
                r"−\d+\.\d\d, −\d+\.\d\d m −?\d+\.\d°", " ".join(row.inner_text().split())
            )
            words = """(row) => {
                const range = document.createRange();
                range.selectNodeContents(row);
                const inner = range.getBoundingClientRect(), outer = row.parentElement;
                const { top, bottom } = outer.getBoundingClientRect();
                const { left } = row.nextSibling.getBoundingClientRect();
                return inner.right <= left && inner.bottom <= bottom && inner.top >= top;
            }"""
            assert row.evaluate(words)


def touched(page: Any, *moves: tuple[tuple[float, float], ...]) -> None:
    """Put fingers on the canvas, move them, and lift them: the pixels of all, move for move."""
    box, send = page.locator("#canvas").bounding_box(), page.context.new_cdp_session(page).send
    kinds = ["touchStart", *["touchMove"] * (len(moves) - 1), "touchEnd"]
    for kind, fingers in zip(kinds, (*moves, ()), strict=True):
        points = [
            {"x": box["x"] + x, "y": box["y"] + y, "id": k} for k, (x, y) in enumerate(fingers)
        ]
        send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})


@pytest.mark.parametrize("page", SIZES[:1], indirect=True)
def test_a_finger_drags_the_scan_and_two_enlarge_the_map(page: Any, log: Path) -> None:
    located(page, log)
    x0, _, heading = sensor_at(page, 100, 200)
    x1, y1, _ = sensor_at(page, 200, 200)
    touched(page, ((200, 200),), ((230, 210),), ((250, 240),))
    scale = (x1 - x0) / 100
    sync.expect(page.locator("#pose-title")).to_have_text("Pose set by hand")
    moved = (x1 + 50 * scale, y1 - 40 * scale, heading)
    assert shown_pose(page) == pytest.approx(moved, abs=0.02)
    # Twice as far apart: a pixel is half as much, and what was in their middle is still there.
    touched(page, ((150, 200), (250, 200)), ((125, 200), (275, 200)), ((100, 200), (300, 200)))
    assert shown_pose(page) == pytest.approx(moved, abs=0.02)
    x2 = sensor_at(page, 200, 300)[0]
    assert x2 == pytest.approx(x1, abs=0.05)
    assert sensor_at(page, 300, 300)[0] - x2 == pytest.approx(50 * scale, abs=0.05)


def test_open_takes_the_options_of_a_log(browser: Any, log: Path, tmp_path: Path) -> None:
    folder = tmp_path / "attic"
    made(log, tmp_path / "turned mm.npz")
    folder.mkdir()
    shutil.copy(MAPS / "visibility.yaml", folder / "map.yaml")
    shutil.copy(MAPS / "visibility.png", folder)
    words = ("--flipped", "--range-scale", 0.001, "--scans-index", "2:4", "--range-max", 20)
    there = folder / "map.yaml", tmp_path / "turned mm.npz", *words
    with served("open", *there, BROWSER="true") as one, opened(browser, one.address) as page:
        assert "Scan 2: unique." in answered(page, 2)
        assert shown_pose(page)[:2] == pytest.approx(POSES[2, :2], abs=0.1)
        sync.expect(page.locator("#map option:checked")).to_have_text("attic")
        # What is in force is shown, another value replaces it, and it is of this log alone.
        flipped, reach = page.get_by_label("Upside down"), page.get_by_label("Reach")
        sync.expect(flipped).to_be_checked()
        sync.expect(reach).to_have_value("20")
        sync.expect(page.get_by_label("1 in the file is")).to_have_value("0.001")
        for value, longest in (("2", 2), ("", 30)):
            reach.fill(value)
            reach.press("Enter")
            beyond = int((load_scans(log)[2].ranges >= longest).sum())
            sync.expect(page.locator("#count-no_return")).to_have_text(str(beyond))
        flipped.uncheck()
        sync.expect(page.locator("#live")).not_to_contain_text("unique")
        assert "--flipped" not in copied(page, "c")
        drop(page, (log.name, log.read_bytes()))
        sync.expect(page.locator("#live")).to_contain_text("Scan 0: unique.")
        sync.expect(page.get_by_label("1 in the file is")).to_have_value("")


OPENED = {
    "--range-max=29": "longer.npz",
    "--flipped --sensor=0.3,0,-0.1": "turned.npz",
    "--range-scale=0.001 --scans-index=2:4 --range-max=9": "mm.npz",
    "--topic=/rear/scan --range-max=15": "two.bag",
    "--fov-deg=357": "plain.csv",
}


def made(log: Path, path: Path) -> None:
    """Write the scans of a log in another way, by the name of the file."""
    kept = load_scans(log)
    if path.suffix == ".npz":
        times, turn = (1000 if "mm" in path.stem else 1), (-1 if path.stem[0] == "t" else 1)
        times *= 1.04 if path.stem == "longer" else 1
        scans = [LaserScan(times * s.ranges, turn * s.angles, range_max=times * 30.0)
                 for s in kept.scans]  # fmt: skip
        save_scans(path, ScanSet(tuple(scans), None, kept.stamps, kept.odom))
    elif path.suffix == ".csv":
        rows = [",".join(f"{r:.4f}" for r in scan.ranges) for scan in kept.scans]
        path.write_text("\n".join(rows))
    else:
        from test_io_bags import SCAN, messages_of, write

        m, angles = messages_of(ros1=True), np.linspace(-1.5, 1.5, 181)
        seen = simulate_ranges(render(WORLDS["visibility"](), 0.05), POSES, angles, seed=2)
        rear = [("/rear/scan", SCAN, m.scan(2.0 + k, ranges=r)) for k, r in enumerate(seen)]
        write(path, "bag", [("/front/scan", SCAN, m.scan(1.0)), *rear])


@pytest.mark.parametrize("words", OPENED)
def test_what_is_copied_gives_what_the_page_shows(browser, log, tmp_path, words):
    path = tmp_path / OPENED[words]
    made(log, path)
    shutil.copy(MAPS / "visibility.png", tmp_path)
    there = ["--resolution=0.1", tmp_path / "visibility.png", path, *words.split()]
    if "longer" in path.stem:  # is calibrated
        assert call("calibrate", *there[:2], "--scans", path).code == 0
    with served("open", *there, BROWSER="true") as one, opened(browser, one.address) as page:
        number = int((re.findall(r"index=(\d)", words) or "0")[0])
        said = answered(page, number)
        sync.expect(page.locator("#number")).to_contain_text(f"Scan {number}")
        texts = copied(page, "c"), copied(page, "y")
        shown, robot = shown_pose(page), page.locator("#pose-robot").inner_text()
    row = rows(call(*shlex.split(texts[0])[1:], "--json").out)[0]
    if base := row["hypotheses"][0].get("base"):
        assert robot.startswith(f"Robot: x {base['x']:.2f} m, y {base['y']:.2f} m")
    assert bool(robot) is bool(base) is ("--sensor" in words)
    values: dict[str, Any] = {}
    exec(texts[1], values)
    best = values["answer"].best
    assert f"Scan {row['index']}: {row['verdict']}. " in said
    assert values["answer"].verdict == row["verdict"] != "no-match"
    for x, y, theta in ([row["hypotheses"][0][key] for key in ("x", "y", "theta")], best):
        assert (x, y, np.rad2deg(theta)) == pytest.approx(shown, abs=0.051)


def test_one_of_several_lasers_is_named_on_the_page(page: Any, log: Path, tmp_path: Path) -> None:
    made(log, tmp_path / "two.bag")
    drop(page, ("two.bag", (tmp_path / "two.bag").read_bytes()))
    several = "scans of several lasers, fill in “Laser”, one of /front/scan (1), /rear/scan (6)"
    sync.expect(page.locator("#trouble")).to_contain_text(several)
    laser = page.get_by_label("Laser")
    laser.fill("/rear/scan")
    laser.press("Enter")
    assert "Scan 0: unique." in answered(page)
    page.locator("#canvas").focus()
    assert "--topic=/rear/scan" in copied(page, "c")
    drop(page, (log.name, log.read_bytes()))
    sync.expect(laser).to_be_hidden()


def test_how_scans_were_taken_is_said_on_the_page_and_hinted_at(page: Any, log: Path) -> None:
    path = log.with_name("turned mm.npz")
    made(log, path)
    assert "No pose on this map fits this scan." in located(page, path)
    sync.expect(page.locator("#pose-title")).to_contain_text("No pose was found")
    hint = page.locator("#hints")
    sync.expect(hint).to_contain_text("millimetres? Set “1 in the file is” to 0.001 m")
    page.get_by_label("1 in the file is").fill("0.001")
    page.get_by_label("1 in the file is").press("Enter")
    sync.expect(hint).to_contain_text("Tick “Upside down”")
    page.get_by_label("Upside down").check()
    sync.expect(page.locator("#live")).to_contain_text("Scan 0: unique.")
    sync.expect(hint).to_be_empty()
    assert shown_pose(page)[:2] == pytest.approx(POSES[0, :2], abs=0.1)
    assert "--flipped --range-scale=0.001" in copied(page, "c")


def test_a_region_is_drawn_by_keys_alone(page: Any, log: Path) -> None:
    first = located(page, log)
    page.locator("#canvas").focus()
    for key in ("r", "Shift+ArrowLeft", "Enter", *["Shift+ArrowRight"] * 2, "Shift+ArrowDown"):
        page.keyboard.press(key)
    for _ in range(2):  # the opposite corner, twice
        page.keyboard.press("Enter")
    sync.expect(page.locator("#known-words")).to_contain_text("In a region of")
    sync.expect(page.locator("#live")).not_to_have_text(first)
    for key in ("a", "Enter", "Shift+ArrowUp", "Enter"):
        page.keyboard.press(key)
    sync.expect(page.locator("#known-words")).to_contain_text("heading 90 ± 45°")
    page.keyboard.press("r")
    page.locator("#canvas").click(position={"x": 300, "y": 300})
    page.locator("#canvas").click(position={"x": 303, "y": 301})
    sync.expect(page.locator("#note")).to_contain_text("no region")


def test_a_layer_that_takes_long_is_stopped_and_holds_nothing_up(page: Any, log: Path) -> None:
    located(page, log)
    asked = list[str]()
    # Nobody answers this one: as if it took for ever.
    page.route("**/likelihood?*method=beam*", lambda route: asked.append(route.request.url))
    page.get_by_label("Layer on the map").select_option("beam")
    sync.expect(page.locator("#working-words")).to_contain_text("Computing beam: ")
    page.get_by_label("Layer on the map").select_option("distance")  # it is given up
    sync.expect(page.locator("#scale-high")).to_have_text("3.0 m")
    sync.expect(page.locator("#working")).to_be_hidden()
    page.get_by_label("Layer on the map").select_option("beam")
    page.get_by_role("button", name="Stop").click()
    sync.expect(page.get_by_label("Layer on the map")).to_have_value("")
    sync.expect(page.locator("#working")).to_be_hidden()
    sync.expect(page.locator("#trouble")).to_be_hidden()
    assert len(asked) == 2
    page.unroute_all(behavior="ignoreErrors")


def test_a_map_that_cannot_be_shown_says_why_and_comes_later(browser: Any, service: str) -> None:
    page, refused = browser.new_page(), list[str]()

    def refuse(route: Any) -> None:
        refused.append(route.request.url)
        body = json.dumps({"detail": "no answer within 3 s", "status": 504})
        if len(refused) > 1:
            route.continue_()
        else:
            route.fulfill(status=504, content_type="application/problem+json", body=body)

    page.route("**/image", refuse)
    page.goto(service)
    blank = page.locator("#blank")
    sync.expect(blank).to_have_text(
        "The map cannot be shown: no answer within 3 s. The page asks again."
    )
    sync.expect(blank).to_be_hidden()
    assert len(refused) == 2
    page.close()


def test_words_for_readings_are_those_of_the_explained_page() -> None:
    here = (Path(__file__).parents[2] / "imgloc/live/page/scan.js").read_text()
    there = (Path(__file__).parents[2] / "imgloc/output/templates/explain.html").read_text()
    kinds = re.findall(r'^  (\w+): "([^"]+)",$', here, re.M)
    assert len(kinds) == 6
    assert re.findall(r'^  "(\w+)": \("([^"]+)", ', there, re.M) == kinds


def test_the_page_sends_the_token_of_its_address_and_says_if_it_needs_one(browser, log) -> None:
    secret = "correct-horse-battery"
    with served(MAPS / "visibility.yaml", "--token", secret) as one:
        address = one.address.partition("#")[0].rstrip("/")
        with opened(browser, f"{address}/#token={secret}") as page:
            assert "Scan 0: unique." in located(page, log)
            page.get_by_role("button", name="Follow").click()
            sync.expect(page.locator("#tracked")).to_contain_text("Tracker: ")
            sync.expect(page.get_by_role("button", name="Follow")).to_be_visible()
        for end, said in (("", "has none"), ("#token=not-the-right-one", "does not accept")):
            page = browser.new_page()
            page.goto(f"{address}/{end}")
            trouble = page.locator("#trouble")
            sync.expect(trouble).to_contain_text(said)
            sync.expect(trouble).to_contain_text("#token=...")
            sync.expect(page.locator("#welcome")).to_be_hidden()
            trouble.get_by_role("button").click()  # nothing lies over it
            page.goto(f"{address}/#token={secret}")
            sync.expect(page.locator("#map")).to_have_value("visibility")
            page.close()


def test_the_page_waits_for_maps_that_are_being_prepared(browser: Any) -> None:
    grid, prepared = load_map(MAPS / "visibility.yaml"), threading.Event()

    def made() -> OccupancyGrid:
        prepared.wait(60)
        return grid

    from imgloc.live.server import address_of, bound
    from imgloc.live.service import Service

    core = Localizer({"slow": made}, background=True)
    service = Service(core)
    with bound("127.0.0.1", 0) as socket:
        config = uvicorn.Config(service, lifespan="off", log_config=None)
        server = uvicorn.Server(config)
        run = threading.Thread(target=server.run, kwargs={"sockets": [socket]})
        run.start()
        try:
            page = browser.new_page()
            socket.listen()  # who comes before the server listens waits
            page.goto(address_of(socket))
            sync.expect(page.locator("#preparing")).to_contain_text("preparing slow")
            prepared.set()
            sync.expect(page.locator("#map")).to_have_value("slow")
            sync.expect(page.locator("#preparing")).to_be_hidden()
            page.close()
        finally:
            prepared.set()
            server.should_exit = True
            run.join(60)
            core.close()


def test_scans_that_the_service_has_dropped_are_sent_again(page: Any, log: Path) -> None:
    located(page, log)
    # The service holds a few files only: others push this one out.
    page.evaluate("""async () => {
        for (let k = 0; k < 9; k += 1) {
            const scan = { angles: [0, 1, 2], ranges: [1, 2, 3 + k], range_max: 9 };
            await fetch(`v1/scans?name=${k}.json`, { method: "POST", body: JSON.stringify(scan) });
        }
    }""")
    page.get_by_role("button", name="The next scan").click()
    assert "Scan 1: " in answered(page, 1)
    sync.expect(page.locator("#trouble")).to_be_hidden()
