"""Files that imgloc writes and reads again, when somebody else has had them: by the command."""

import csv
import json
import os
import shutil
import subprocess
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from command import call, command, untimed
from places import room_with_a_post

from imgloc import ScanSet, Sensor, save_map, save_scans, simulate
from imgloc.io import contents
from imgloc.io.mapyaml import image_named

needs_pipes = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes here")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A map, two scans, and the folder of a batch that has located them."""
    folder = tmp_path_factory.mktemp("made")
    grid = room_with_a_post()
    (folder / "maps").mkdir()
    save_map(folder / "maps" / "post.yaml", grid)
    scans = simulate(grid, 2, 1, Sensor(rays=60, fov=6.0, range_max=9.0))
    save_scans(folder / "scans.npz", ScanSet(scans.scans, poses=scans.poses))
    call("batch", *words(folder), "--pictures", "all").ends(0)
    return folder


@pytest.fixture
def folder(made: Path, tmp_path: Path) -> Path:
    """A copy of it that may be spoilt."""
    shutil.copytree(made, tmp_path / "made")
    return tmp_path / "made"


def words(folder: Path) -> list[object]:
    return [folder / "maps", folder / "scans.npz", "--out", folder / "out"]


def refused(said: str, *arguments: object, code: int = 1) -> None:
    """The command ends with one line."""
    run = call(*arguments)
    lines = [line for line in run.err.splitlines() if line.startswith("imgloc: error")]
    assert (run.code, len(lines)) == (code, 1), run.err
    assert said in lines[0]
    assert len(lines[0]) < 600


def change(path: Path, edit: Callable[[dict], object]) -> None:
    """Change the JSON of a file, of rows the first."""
    first, *rest = path.read_text().splitlines(keepends=True)
    rest = rest if path.suffix == ".jsonl" else [first + "".join(rest)]
    row = json.loads(first if path.suffix == ".jsonl" else rest.pop())
    edit(row)
    path.write_text("".join([json.dumps(row) + "\n", *rest]))


# Links, and what is no file.


@pytest.mark.parametrize("name", [".imgloc-batch.lock", "results.jsonl"])
def test_a_link_that_was_planted_empties_no_file(folder: Path, name: str) -> None:
    victim = folder / "victim"
    victim.write_text("mine")
    (folder / "out" / name).unlink()
    (folder / "out" / name).symlink_to(victim)
    refused(f"{name}: is a link", "batch", *words(folder), "--resume")
    assert victim.read_text() == "mine"


@pytest.mark.parametrize("name", [".imgloc-batch.lock", "results.jsonl"])
@pytest.mark.parametrize("content", ["mine", "mine\n", '{"map": 3}\n'])
def test_a_file_of_somebody_else_stays_as_it_is(folder: Path, name: str, content: str) -> None:
    path = folder / "out" / name
    path.write_text(content)
    said = "is no lock of a batch" if name.endswith("lock") else "line 1: no row of a batch"
    refused(said, "batch", *words(folder), "--resume")
    assert path.read_text() == content


def test_pictures_are_not_written_beyond_the_folder(folder: Path) -> None:
    out, elsewhere = folder / "other", folder / "elsewhere"
    for path in (out, elsewhere):
        path.mkdir()
    (out / "pictures").symlink_to(elsewhere)
    refused("pictures: is a link", "batch", *words(folder)[:2], "--out", out, "--pictures", "all")
    assert not list(elsewhere.iterdir())


@needs_pipes
@pytest.mark.parametrize("name", [".imgloc-batch.lock", "results.jsonl", "run.json"])
@pytest.mark.parametrize("kind", ["pipe", "zeros", "folder"])
def test_what_is_no_file_is_not_waited_for(folder: Path, name: str, kind: str) -> None:
    path = folder / "out" / name
    path.unlink()
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "zeros":
        path.symlink_to("/dev/zero")
    else:
        path.mkdir()
    refused(f"{name}: is a", "batch", *words(folder), "--resume")
    if not name.endswith("lock"):
        refused(f"{name}: is a", "report", folder / "out")


@needs_pipes
def test_a_page_that_is_no_file_is_not_waited_for(folder: Path) -> None:
    os.mkfifo(folder / "out" / "report.html")
    refused("report.html: exists already", "report", folder / "out")
    refused("report.html: is not a regular file", "report", folder / "out", "--force")


# What is in them.


@pytest.mark.parametrize("name", ["/etc/hostname", "../run.json", "a/b.png", "..", "x.jpg"])
def test_only_pictures_of_the_folder_come_into_its_page(folder: Path, name: str) -> None:
    rows = folder / "out" / "results.jsonl"
    change(rows, lambda row: row["answers"][0].update(pictures=[name]))
    refused("line 1: no row of a batch (answers.0.pictures.0: got ", "report", folder / "out")
    assert not (folder / "out" / "report.html").exists()


def test_a_picture_that_is_a_link_does_not_come_into_the_page(folder: Path) -> None:
    secret = folder / "secret"
    secret.write_text("mine")
    picture = next((folder / "out" / "pictures").glob("*.png"))
    picture.unlink()
    picture.symlink_to(secret)
    refused(f"{picture.name}: is a link", "report", folder / "out")
    shutil.rmtree(folder / "out" / "pictures")
    (folder / "out" / "pictures").symlink_to(folder)
    refused("pictures: is a link", "report", folder / "out")


HUGE = 10**400


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        ({"map": []}, "map: got [], expected a text"),
        ({"answers": 5}, "answers: got 5, expected a list"),
        ({"answers": [None]}, "answers.0: got None, expected an object"),
        ({"answers": [{}]}, "answers.0: no index"),
        ({"cost": None}, "cost: got None"),
        ({"cost": {"seconds": HUGE}}, "cost.seconds: got 1000"),
        ({"cost": {"seconds": 1 << 64}}, "cost.seconds: got 18446744073709551616"),
        ({"status": []}, "status: got [], expected one of crashed, failed, ok"),
        ({"more": {"a": float("inf")}}, ""),
        ({"more": "\ud800"}, "more: got '\\ud800'"),
        ({"\x1b[31m": [HUGE]}, r"\x1b[31m.0: got 1"),
    ],
)
def test_a_row_that_was_edited(folder: Path, edit: dict, said: str) -> None:
    out = folder / "out"
    change(out / "results.jsonl", lambda row: row.update(edit))
    uses = [["report", out], ["export", out, "--force"], ["batch", *words(folder), "--resume"]]
    for use in uses:
        if said:
            refused(f"results.jsonl, line 1: no row of a batch ({said}", *use)
        else:  # what JSON has not is null
            assert call(*use).code == 0


@pytest.mark.parametrize("use", ["report", "export"])
@pytest.mark.parametrize(("folder", "lacks"), [("logs", "run.json"), ("none", "such folder")])
def test_a_folder_that_is_no_batch_is_a_slip(tmp_path: Path, use, folder, lacks) -> None:
    (tmp_path / "logs").mkdir()
    said = f"{folder}: no {lacks}, expected a folder of results of 'imgloc batch'"
    call(use, tmp_path / folder).ends(2, said)
    assert [*tmp_path.rglob("*")] == [tmp_path / "logs"]


def test_a_floor_that_is_null_and_a_missing_cost_are_no_defects(folder: Path) -> None:
    def edit(row: dict) -> None:
        row["answers"][0]["evidence"]["floor"], row["cost"] = None, {}

    change(folder / "out" / "results.jsonl", edit)
    for use in (["report", folder / "out"], ["export", folder / "out", "--force"]):
        assert call(*use).code == 0
    assert call("batch", *words(folder), "--resume").code == 0


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        ({"maps": 5}, "maps: got 5, expected a text"),
        ({"parameters": {"a": 5}}, "parameters.a: got 5, expected an object"),
        ({"job": []}, "job: got [], expected a text"),
        ({"format": 7}, "is no run.json of this version"),
    ],
)
def test_what_decided_the_rows_was_edited(folder: Path, edit: dict, said: str) -> None:
    out = folder / "out"
    change(out / "run.json", lambda row: row.update(edit))
    for use in (["report", out], ["export", out], ["batch", *words(folder), "--resume"]):
        refused(said, *use)


@pytest.mark.parametrize("name", ["run.json", "results.jsonl", "summary.json"])
@pytest.mark.parametrize("content", ["[" * 100_000, '{"a":' * 30_000, "\xff", "9" * 5000, "[1]"])
def test_deep_or_broken_json_is_refused(folder: Path, name: str, content: str) -> None:
    (folder / "out" / name).write_text(content + "\n", "latin-1")
    refused(name, "report", folder / "out")


def test_a_file_that_is_mostly_a_hole_takes_no_memory(folder: Path) -> None:
    for name in ("results.jsonl", "run.json"):
        with (folder / "out" / name).open("r+b") as file:
            file.truncate(1 << 40)
        refused(name, "report", folder / "out")


# A spreadsheet.


def test_no_cell_of_the_table_is_a_formula(folder: Path) -> None:
    (folder / "scans").mkdir()
    for name in ("=1+1.npz", "@SUM(1).npz", "\tx.npz"):
        shutil.copy(folder / "scans.npz", folder / "scans" / name)
    call("batch", folder / "maps", folder / "scans", "--out", folder / "new").ends(0)
    assert call("export", folder / "new").code == 0
    with (folder / "new" / "results.csv").open(newline="") as file:
        table = list(csv.DictReader(file))
    assert {line["scans"] for line in table} == {"'=1+1.npz", "'@SUM(1).npz", r"\tx.npz"}
    assert min(float(line["second_mass"]) for line in table) >= 0
    # What was allowed for, which the map and these scans do not need.
    assert {(line["scale"], line["thinner"], line["bent"]) for line in table} == {
        ("1.0", "0.0", "0.0")
    }
    assert all(float(line["x"]) for line in table)  # numbers stay numbers
    texts = [cell for line in table for cell in line.values() if not cell[1:2].isdigit()]
    assert not [cell for cell in texts if cell.startswith(("=", "+", "-", "@", "\t", "\r"))]


def test_a_message_of_megabytes_is_not_written_for_each_answer(folder: Path) -> None:
    path = folder / "out" / "results.jsonl"
    rows = [json.loads(line) for line in path.read_text().splitlines()]
    rows[0]["message"] = "x" * 1_000_000
    rows[0]["answers"] *= 25
    path.write_text("".join(json.dumps(row) + "\n" for row in rows))
    call("export", folder / "out").ends(0)
    assert (folder / "out" / "results.csv").stat().st_size < 60 * 6000


# A folder that goes while it is written.


@pytest.mark.parametrize("how", ["deleted", "moved"])
def test_a_folder_that_goes_in_the_middle_is_noticed_at_the_next_row(folder, how):
    for k in range(60):
        shutil.copy(folder / "maps" / "post.yaml", folder / "maps" / f"m{k:03d}.yaml")
    out = folder / "new"
    run = subprocess.Popen(
        command(["batch", folder / "maps", "--job", "check", "--out", out, "--workers", 1]),
        stderr=subprocess.PIPE,
    )
    rows = out / "results.jsonl"
    while run.poll() is None and not (rows.exists() and rows.stat().st_size):
        time.sleep(0.005)
    if how == "deleted":
        shutil.rmtree(out)
    else:
        out.rename(folder / "elsewhere")
    _, said = run.communicate(timeout=30)
    assert run.returncode == 1
    assert b"new: results.jsonl has been deleted or moved" in said
    if how == "moved":
        kept = (folder / "elsewhere" / "results.jsonl").read_bytes().splitlines()
        assert 1 <= len(kept) < 61
        (folder / "elsewhere").rename(out)
        again = call("batch", folder / "maps", "--job", "check", "--out", out, "--resume")
        assert again.out.startswith("61 items: 61 ok"), again.err
        assert len(rows.read_bytes().splitlines()) == 61


# Going on with much that is done.


def test_each_map_is_read_once_to_know_that_it_is_done(folder, monkeypatch):
    for k in range(30):
        text = (folder / "maps" / "post.yaml").read_text() + f"# {k}\n"
        (folder / "maps" / f"m{k:03d}.yaml").write_text(text)
    words = ["batch", folder / "maps", "--job", "check", "--out", folder / "new"]
    assert call(*words).code == 0
    contents._image_of.cache_clear()
    asked = []

    def counted(path: Path) -> Path:
        asked.append(path)
        return image_named(path)

    monkeypatch.setattr(contents, "image_named", counted)
    run = call(*words, "--resume")
    assert "; 31 are done" in run.err
    assert len(asked) == len(set(asked)) == 31


# What is calibrated beside a map.


@pytest.mark.parametrize("value", ["1e999", "9" * 400, "[" * 5000, '"0"'])
def test_a_damaged_calibration_beside_a_map_is_a_warning(folder: Path, value: str) -> None:
    path = folder / "maps" / "post.calibration.json"
    text = '{"format": 1, "map_hash": "a", "methods": {}, "shared": {"scale": 1, "thinner": HERE}}'
    path.write_text(text.replace("HERE", value))
    words = ["localize", folder / "maps" / "post.yaml", folder / "scans.npz", "--scans-index", 0]
    run = call(*words, "--method", "cbml", "--cell", 0.2, "--no-cache").ends(0)
    (line,) = run.err.splitlines()
    assert "post.calibration.json: ignored, the defaults are used: is no calibration: " in line


# The index of many maps.


def build(folder: Path) -> Path:
    index = folder / "index.npz"
    call("which", folder / "maps", "--maps-index", index, "--no-cache").ends(0)
    return index


def with_about(index: Path, edit: Callable[[dict], object], **arrays: np.ndarray) -> None:
    """Change what an index says of its levels, or their arrays."""
    with np.load(index) as archive:
        found = dict(archive)
    about = json.loads(found["about"].tobytes())
    edit(about)
    found["about"] = np.frombuffer(json.dumps(about).encode(), np.uint8)
    np.savez(index, **found | arrays)


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        ({"maps": []}, "maps: got [], expected an object"),
        ({"maps": {"a": 5}}, "maps.a: got 5, expected a list of 2"),
        ({"written": "x"}, "written: got 'x', expected a whole number"),
        ({"written": HUGE}, "written: got 1000"),
        ({"levels": [["a", 1, 1, 0.1]]}, "levels.0: got ['a', 1, 1, 0.1], expected a list of 5"),
        ({"levels": [["a", -1, -1, 0.1, 0]]}, "levels of other sizes"),
        ({"levels": [["a", 10**9, 10**9, 0.1, 0]]}, "levels of other sizes"),
        ({"format": None}, "format: got None"),
    ],
)
def test_an_index_that_was_edited(folder: Path, edit: dict, said: str) -> None:
    index = build(folder)
    with_about(index, lambda about: about.update(edit))
    words = ["which", folder / "maps", folder / "scans.npz", "--maps-index", index]
    refused(f"index.npz: is no index of maps ({said}", *words)


def test_an_index_is_not_inflated(folder: Path) -> None:
    index = build(folder)
    with np.load(index) as archive:
        arrays = dict(archive) | {"images": np.zeros(1 << 28, np.uint8)}
    np.savez_compressed(index, **arrays)
    assert index.stat().st_size < 1 << 20
    tracemalloc.start()
    words = ["which", folder / "maps", folder / "scans.npz", "--maps-index", index]
    refused("index.npz: is no index of maps (the magic string is not correct", *words)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1 << 25


# An entry of the cache.


@needs_pipes
@pytest.mark.parametrize("kind", ["pipe", "zeros", "text", "pickle"])
def test_an_entry_of_the_cache_that_is_none(folder: Path, kind: str) -> None:
    words = ["localize", folder / "maps" / "post.yaml", folder / "scans.npz", "--scans-index", 0]
    words += ["--cache", folder / "cache", "--json"]
    good = call(*words)
    (entry,) = (folder / "cache").glob("*.npz")
    entry.unlink()
    if kind == "pipe":
        os.mkfifo(entry)
    elif kind == "zeros":
        entry.symlink_to("/dev/zero")
    elif kind == "text":
        entry.write_text("not an archive")
    else:
        with entry.open("wb") as file:
            np.savez(file, key=np.array(entry.stem), walls=np.array([{}], dtype=object))
    run = call(*words)
    assert (run.code, untimed(run.out)) == (0, untimed(good.out))
    (line,) = run.err.splitlines()
    assert entry.name in line
    assert "bad cache entry, built anew: " in line
    assert "pickle" not in line
    assert entry.is_file()
    assert not entry.is_symlink()
    assert not call(*words).err
