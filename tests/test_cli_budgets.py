"""`--memory-budget` of the commands: said with -v, refused before anything is loaded or done."""

import os
import re
import shutil
import struct
import tracemalloc
import zlib
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from budgets import check_done, check_refused, words
from command import MAPS, call, simulating

from imgloc.io.images import image_size
from imgloc.io.scans import load_scans, scans_size
from imgloc.runs.opening import held_bytes

CURVED = MAPS / "curved.yaml"
SIMULATE = ["simulate", CURVED, "-n", 2, "--out", "{}/s.npz"]
SHOW = ["map", "show", CURVED, "--what", "bmap", "--out", "{}/m.png"]

LOCALIZE = ["localize", CURVED, "{}/../scans.npz", "--no-cache", "--threads", 1]
SAMPLE = ["sample", CURVED, "{}/../scans.npz", "--out", "{}/p.csv", "--threads", 1]
CHECK = ["map", "check", CURVED]
DEMO = ["demo", "--map", "curved", "--out", "{}/d.png"]


simulated = simulating(CURVED, "-n", 2, "--rays", 61)


@pytest.fixture
def folder(tmp_path: Path, simulated: Path) -> Path:
    """An empty one beside some scans."""
    shutil.copy(simulated, tmp_path)
    (tmp_path / "here").mkdir()
    return tmp_path / "here"


@pytest.mark.parametrize(
    ("command", "budget", "expected"),
    [
        (SIMULATE, "10M", ["simulating 2 scans of 181 rays on 1300 x 1600 cells", "fewer scans"]),
        (LOCALIZE, "60M", ["fused on 130 x 160 cells of 0.1 m", "features of 130 x 160 cells"]),
        ([*LOCALIZE, "--method", "beam"], "100M", ["beam on 130 x 160 cells", "--theta-step-deg"]),
        (SAMPLE, "60M", ["fused on 130 x 160 cells of 0.1 m", "features of 130 x 160 cells"]),
        ([*SAMPLE, "--method", "cbml"], "100M", ["cbml on 130 x 160 cells of 0.1 m", "a larger"]),
    ],
)
def test_over_budget_is_refused_with_sizes(command, budget, expected, folder):
    check_refused(command, budget, expected, folder)


@pytest.mark.parametrize(
    "command",
    [SIMULATE, SHOW, LOCALIZE, CHECK],
    ids=lambda command: " ".join(map(str, command[:2])),
)
def test_within_the_budget_it_is_said_and_done(command, folder, caplog):
    check_done(command, folder, caplog)


def test_which_leaves_out_maps_that_need_more(folder: Path) -> None:
    for ending in (".yaml", ".png"):
        for name in ("curved", "large"):
            shutil.copy(MAPS / f"{name}{ending}", folder)
    given = ("which", folder, folder.parent / "scans.npz", "--no-cache", "-v")
    run = call(*given, "--memory-budget", "90M").ends(5)
    assert run.err.count("left out: ") == 1
    assert "large.yaml: fused on 400 x 500 cells of 0.1 m" in run.err
    assert "with features of 400 x 500 cells" in run.err
    assert "the budget is 90 MiB: crop the map, or raise --memory-budget" in run.err
    assert re.search(r"curved.yaml: fused .*: at most \d+ MiB, the budget is 90 MiB", run.err)


@pytest.mark.parametrize("image", ["png", "pgm"])
def test_an_image_is_refused_by_its_header(image: str, tmp_path: Path) -> None:
    path = tmp_path / f"m.{image}"
    side = 1200
    if image == "pgm":
        path.write_bytes(b"P5 %d %d 255\n" % (side, side) + bytes(side * side))
    else:
        path.write_bytes(cv2.imencode(".png", np.zeros((side, side), np.uint8))[1])
    given = ("map", "check", path, "--resolution", 0.1, "--memory-budget")
    run = call(*given, "20M")
    assert (run.code, run.out) == (2, "")
    assert f"m.{image}: an image of 1200 x 1200 pixels needs" in run.err
    assert "crop the map, or raise --memory-budget" in run.err
    assert call(*given, "100M").code == 0


def test_a_demo_counts_the_stack_that_it_draws(folder, monkeypatch):
    monkeypatch.setattr("imgloc.features.budget.available_bytes", lambda: 180 << 20)
    run = call(*words(DEMO, folder))
    run.ends(2, "curved: cbml on 130 x 160 cells of 0.1 m", "use another --map", out="")
    assert not list(folder.iterdir())


@pytest.mark.parametrize(
    "command", [LOCALIZE, [*SAMPLE, "--method", "cbml"]], ids=lambda command: command[0]
)
def test_the_default_budget_is_that_of_the_start(command, folder, monkeypatch):
    left = [4 << 30]  # then others, and the features, have taken what there was
    monkeypatch.setattr("imgloc.features.budget.available_bytes", lambda: left.pop() if left else 0)
    assert call(*words(command, folder)).code == 0


# Every command that reads a map, {} is a folder with one and with scans.
READERS: list[list[object]] = [
    ["localize", "{}/m.yaml", "{}/s.npz", "--no-cache"],
    ["sample", "{}/m.yaml", "{}/s.npz", "--out", "{}/o.csv"],
    ["simulate", "{}/m.yaml", "--out", "{}/o.npz"],
    ["map", "show", "{}/m.yaml", "--out", "{}/o.png"],
    ["map", "check", "{}/m.yaml"],
    ["atlas", "{}/m.yaml", "--out", "{}/o.png", "--step", 50, "--headings", 1],
    ["calibrate", "{}/m.yaml", "--method", "cbml", "--dry-run"],
    ["evaluate", "{}/m.yaml", "--method", "cbml"],
    ["which", "{}", "{}/s.npz", "--no-cache"],
]


def damaged_png(side: int) -> bytes:
    """A grey image by its header; what follows cannot be inflated."""
    png = b"\x89PNG\r\n\x1a\n"
    for kind, data in (
        (b"IHDR", struct.pack(">IIBBBBB", side, side, 8, 0, 0, 0, 0)),
        (b"IDAT", b"no pixels"),
        (b"IEND", b""),
    ):
        png += struct.pack(">I", len(data)) + kind + data
        png += struct.pack(">I", zlib.crc32(kind + data))
    return png


@pytest.fixture
def sources(tmp_path: Path, simulated: Path) -> Callable[[bytes], Path]:
    """Make a folder with a map of the image given, and with two scans and their poses."""

    def make(image: bytes) -> Path:
        shutil.copy(simulated, tmp_path / "s.npz")
        (tmp_path / "m.png").write_bytes(image)
        (tmp_path / "m.yaml").write_text("{image: m.png, resolution: 0.05, origin: [0, 0, 0]}")
        return tmp_path

    return make


@pytest.mark.parametrize("command", READERS, ids=lambda command: " ".join(map(str, command[:2])))
def test_no_command_decodes_an_image_over_the_budget(command, sources):
    folder = sources(damaged_png(11_000))
    before = sorted(folder.iterdir())
    run = call(*words(command, folder), "--memory-budget", "500M").ends(2, out="")
    found = re.search(r"m.png: an image of 11000 x 11000 pixels needs (\d+) MiB of memory", run.err)
    assert 700 < int(found[1]) < 2000
    assert "the budget is 500 MiB: crop the map, or raise --memory-budget" in run.err
    assert sorted(folder.iterdir()) == before
    call(*words(command, folder), "--memory-budget", "2000M").ends(3, "m.png: damaged PNG data")


def test_headers_are_read_without_the_rest(tmp_path: Path) -> None:
    image, archive, text = (tmp_path / name for name in ("m.pgm", "s.npz", "s.csv"))
    image.write_bytes(b"P5 20000 6000 255\n")
    os.truncate(image, 120_000_018)  # the pixels take no room on the disk
    np.savez_compressed(archive, ranges=np.ones((9000, 360)), angles=np.ones(360))
    text.write_text("# angle_min=-1, angle_max=1\n" + "1.25,2.5,3.75\n" * 500_000)
    tracemalloc.start()
    try:
        assert image_size(image) == (20_000, 6000, 120_000_018, True)
        assert scans_size(archive).numbers == 9000 * 360 + 360
        assert scans_size(text).numbers == 500_002 + 1_000_001
        assert tracemalloc.get_traced_memory()[1] < 6 << 20
    finally:
        tracemalloc.stop()


SCAN_READERS: list[list[object]] = [
    ["localize", CURVED, "{}", "--no-cache", "--scans-index", 0],
    ["sample", CURVED, "{}", "--out", "{}.csv"],
    ["evaluate", CURVED, "--scans", "{}", "--method", "cbml"],
    ["which", MAPS, "{}", "--no-cache"],
]


@pytest.mark.parametrize(
    ("name", "command"),
    [("s.npz", command) for command in SCAN_READERS]
    + [(name, SCAN_READERS[0]) for name in ("s.csv", "s.jsonl", "s.json")],
)
def test_no_command_reads_scans_over_the_budget(name, command, tmp_path):
    path = tmp_path / name
    if name == "s.npz":
        np.savez(path, ranges=np.ones((1000, 999)), angles=np.linspace(-1, 1, 999))
        data = bytearray(path.read_bytes())
        data[5000] ^= 1  # a reading is not what its checksum says
        path.write_bytes(data)
        expected = "a file of up to 1,000 scans and 999,999 numbers needs 33 MiB"
    else:
        path.write_text("no, number, here\n" * 100_000)
        expected = "a file of up to 100,001 scans and 300,001 numbers needs"
    run = call(*words(command, path), "--memory-budget", "30M", "-v")
    run.ends(2, f"imgloc: {path}: a file of up to", expected, out="")
    assert run.err.endswith("take fewer scans, in several files, or raise --memory-budget\n")
    assert list(tmp_path.iterdir()) == [path]
    assert call(*words(command, path), "--memory-budget", "3G").code == 4


def test_scans_that_are_held_count_beside_the_answer(tmp_path: Path) -> None:
    path = tmp_path / "s.npz"
    np.savez_compressed(path, ranges=np.ones((1000, 999)), angles=np.linspace(-1, 1, 999))
    given = ("localize", CURVED, path, "--scans-index", 0, "--no-cache", "--threads", 1)
    run = call(*given, "--memory-budget", "60M")
    found = re.search(r"\((\d+) MiB\) with .*\((\d+) MiB\) and scans \((\d+) MiB\)", run.err)
    answer, features, scans = map(int, found.groups())
    assert 8 <= scans <= 40
    assert call(*given, "--memory-budget", f"{answer + features + 1}M").code == 2
    assert call(*given, "--memory-budget", f"{answer + features + scans}M").code == 0


def test_a_few_scans_out_of_many_hold_them_all(tmp_path: Path) -> None:
    one = np.ones((500, 999))
    np.savez(tmp_path / "s.npz", ranges=one, angles=one[0], poses=np.zeros((500, 3)))
    scans = load_scans(tmp_path / "s.npz")
    need = held_bytes(scans.scans[:2])
    assert one.nbytes < need < one.nbytes + 20_000
    assert held_bytes([scan.flipped for scan in scans.scans]) > 2 * one.nbytes
    assert held_bytes(()) == 0


def test_a_region_of_another_size_is_not_decoded(sources: Callable[[bytes], Path]) -> None:
    folder = sources(damaged_png(11_000))
    given = ("localize", CURVED, folder / "s.npz", "--no-cache", "--region", folder / "m.png")
    run = call(*given, "--memory-budget", "500M")
    run.ends(2, "m.png: 11000 x 11000 pixels, expected 160 x 130 as the map")
