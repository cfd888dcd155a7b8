"""Batches: a row for each item whatever happens, none twice, and the same from everywhere."""

import csv
import json
import os
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import PIL.Image
import pytest
from batches import QUICK, in_threads, site_in, timeless
from command import ROOT, call
from places import room_with_a_post

from imgloc import ScanSet, doors, load_scans, numbers, run_batch, save_map, save_scans, simulate
from imgloc.doors import JOBS
from imgloc.errors import ConfigError, MapError, OutputError
from imgloc.geometry import wrap
from imgloc.model import OccupancyGrid, Pose2D
from imgloc.options import Known, Options, Sensor
from imgloc.output.drawings import DRAWINGS
from imgloc.output.export import columns_of
from imgloc.output.report import render_report
from imgloc.runs import results
from imgloc.runs.batch import find_items
from imgloc.runs.jobs import Item, Job, job_class, make_job
from imgloc.runs.opening import Desk, MapFiles, Means, ScanFiles
from imgloc.runs.results import LOCK, RESULTS, SUMMARY, Results, read_rows

ASKS = re.compile(r"number\(\s*f?\"(\w+)\.")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return site_in(tmp_path_factory.mktemp("site"))


def answers(item: Item, job: Job) -> list[dict]:
    """Rows of a job's answers to an item, where this process keeps its maps."""
    return [answer.row for answer in job.open(item, Means().desk())]


def test_a_row_for_each_item(site: Path, tmp_path: Path) -> None:
    seen = []
    summary = in_threads(site, tmp_path / "out", on_row=seen.append)
    assert (summary.items, summary.new, summary.known) == (6, 6, 6)
    assert summary.statuses == {"ok": 6}
    assert sum(summary.verdicts.values()) == 6
    found = list(read_rows(tmp_path / "out"))
    assert [row["scans"] for row in found] == [f"s{k}.npz" for k in range(6)]
    assert found == seen
    (answer,) = found[0]["answers"]
    assert answer["truth"].keys() == {"x", "y", "theta"}
    assert answer["hit"] == (answer["error"]["position"] <= 0.5)
    assert {len(v) for v in found[0]["hashes"].values()} == {40, 32}
    written = json.loads((tmp_path / "out" / SUMMARY).read_text())
    assert written["statuses"] == {"ok": 6}


def test_workers_change_no_row(site: Path, tmp_path: Path) -> None:
    run_batch(site / "floors", site / "scans", tmp_path / "two", QUICK, workers=2)
    in_threads(site, tmp_path / "one")
    assert timeless(tmp_path / "one") == timeless(tmp_path / "two")


def test_resuming_does_what_is_left(site: Path, tmp_path: Path) -> None:
    whole, out = tmp_path / "whole", tmp_path / "out"
    in_threads(site, whole)
    lines = (whole / RESULTS).read_bytes().splitlines(keepends=True)
    in_threads(site, out)
    for kept in (b"", lines[0][:50], b"".join(lines[:2]) + lines[2][:-1], b"".join(lines)):
        (out / RESULTS).write_bytes(kept)  # as a stop leaves it, in the middle of a row or not
        summary = in_threads(site, out, resume=True)
        assert summary.new == 6 - kept.count(b"\n")
        assert timeless(out) == timeless(whole)


def test_other_contents_and_parameters_are_done_again(site: Path, tmp_path: Path) -> None:
    scans, out = tmp_path / "scans", tmp_path / "out"
    scans.mkdir()
    for name in ("a.npz", "b.npz"):
        (scans / name).write_bytes((site / "scans" / "s0.npz").read_bytes())

    def run(job: Job = QUICK, **more):
        with ThreadPoolExecutor(1) as pool:
            return run_batch(
                site / "floors", scans, out, job, executor=pool, resume=True, **more
            ).new

    assert run() == 2
    assert run() == 0
    (scans / "b.npz").write_bytes((site / "scans" / "s1.npz").read_bytes())
    assert run() == 1
    coarse = make_job(options=Options(method="cbml", top=1), cell=0.2)
    assert run(coarse) == 2
    assert len((out / RESULTS).read_bytes().splitlines()) == 2  # one row of each
    (scans / "b.npz").write_bytes(b"")
    assert run(coarse) == 1
    assert run(coarse) == 0
    assert run(coarse, retry_failed=True) == 1
    (scans / "b.npz").write_bytes((site / "scans" / "s1.npz").read_bytes())
    assert run(coarse) == 1
    assert [row["status"] for row in read_rows(out)] == ["ok", "ok"]


def test_a_map_beyond_the_memory_is_a_row(site: Path, tmp_path: Path) -> None:
    out, means = tmp_path / "out", Means(memory_budget=40 << 20)
    with ThreadPoolExecutor(1) as pool:
        found = run_batch(site / "floors", site / "scans", out, QUICK, means=means, executor=pool)
    assert found.statuses == {"failed": 6}
    row = next(read_rows(tmp_path / "out"))
    assert row["code"] == "config"
    assert "MiB of memory, the budget is 40 MiB" in row["message"]


# The folder.


def test_nothing_foreign_is_touched(site: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "notes.txt").write_text("mine")
    in_threads(site, out)
    before = (out / RESULTS).read_bytes()
    with pytest.raises(OutputError, match="`resume=True`"):
        in_threads(site, out)
    with pytest.raises(OutputError, match="job localize"), ThreadPoolExecutor(1) as pool:
        run_batch(site / "floors", None, out, make_job("check"), executor=pool, resume=True)
    assert (out / RESULTS).read_bytes() == before
    (out / "run.json").unlink()
    with pytest.raises(ConfigError, match=r"no run\.json"):
        in_threads(site, out, resume=True)
    assert (out / RESULTS).read_bytes() == before
    assert (out / "notes.txt").read_text() == "mine"
    with pytest.raises(OutputError, match="there is no folder"):
        in_threads(site, tmp_path / "a" / "b")
    theirs = tmp_path / "theirs"
    theirs.mkdir()
    for name in ("summary.json", "run.json"):
        (theirs / name).write_text("{}")
        for resume in (False, True):
            with pytest.raises(OutputError, match=r"of another program|of this version"):
                in_threads(site, theirs, resume=resume)
        assert (theirs / name).read_text() == "{}"
    (tmp_path / "file").write_text("mine")
    with pytest.raises(OutputError, match="is a file"):
        in_threads(site, tmp_path / "file")


def test_the_second_run_names_the_first(site: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    with Results(out, {"job": "localize", "parameters": {}}):
        run = call("batch", site / "floors", site / "scans", "--out", out)
        run.ends(1, f"another run writes here, process {os.getpid()}")
    assert (out / LOCK).exists()
    assert in_threads(site, out, resume=True).new == 6


def test_a_damaged_row_is_an_error(site: Path, tmp_path: Path) -> None:
    in_threads(site, tmp_path / "out")
    path = tmp_path / "out" / RESULTS
    lines = path.read_bytes().splitlines(keepends=True)
    lines[1] = b"\x00\xff\n"
    path.write_bytes(b"".join(lines))
    for use in (lambda: in_threads(site, tmp_path / "out", resume=True),
                lambda: list(read_rows(tmp_path / "out"))):  # fmt: skip
        with pytest.raises(OutputError, match="line 2"):
            use()
    assert path.read_bytes() == b"".join(lines)


def test_a_row_that_is_too_long_is_no_row(site, tmp_path, monkeypatch):
    in_threads(site, out := tmp_path / "out")
    lines = (out / RESULTS).read_bytes().splitlines()
    longest = max(map(len, lines)) + 1
    monkeypatch.setattr(results, "_PART", 64)
    monkeypatch.setattr(results, "_MAX_ROW", 64 * -(-longest // 64))
    assert len(list(read_rows(out))) == 6
    monkeypatch.setattr(results, "_MAX_ROW", longest // 2)
    with pytest.raises(OutputError, match="line 1: no row of a batch"):
        list(read_rows(out))


def test_a_map_is_read_once_and_without_a_standard_error(site, monkeypatch):
    monkeypatch.setattr("sys.stderr", None)  # as where there is no console
    desk = Means().desk()
    grid = desk.grid(site / "floors" / "post.yaml", MapFiles())
    assert desk.grid(site / "floors" / "post.yaml", MapFiles()) is grid


def test_a_map_that_is_prepared_is_read_no_more_and_gives_way_to_the_next(site, tmp_path):
    one, other, options = site / "floors" / "post.yaml", tmp_path / "b.yaml", Options()
    save_map(other, room_with_a_post())
    desk, maps = Desk(), MapFiles()
    first = desk.features(one, maps, options)
    desk.grid(other, maps)
    assert desk.grid(one, maps) is first.grid
    assert desk.features(one, maps, options) is first
    desk.features(other, maps, options)
    assert desk.features(one, maps, options) is not first  # no share is for maps that wait
    desk.kept = 1.0
    first = desk.features(one, maps, options)
    desk.features(other, maps, options)
    assert desk.features(one, maps, options) is first


# Items.


def test_items_are_every_map_with_every_scan(site: Path, tmp_path: Path) -> None:
    floors = tmp_path / "floors"
    (floors / "b").mkdir(parents=True)
    save_map(floors / "a.yaml", room_with_a_post())
    save_map(floors / "b" / "map.yaml", room_with_a_post())
    (floors / "b" / "bare.png").write_bytes((floors / "a.png").read_bytes())
    found = find_items(floors, site / "scans", QUICK)
    assert len({item.id for item in found}) == 12
    assert [item.map for item in found][::6] == ["a", "b"]
    bare = find_items(floors, None, make_job("check", maps=MapFiles({"resolution": 0.1})))
    assert [item.map for item in bare] == ["a.yaml", "b/bare.png", "b"] or len(bare) == 3
    assert find_items(floors, site / "scans", QUICK, out=floors / "b")[-1].map == "a"
    (which,) = find_items(floors, site / "all.npz", make_job("which"))
    assert [name for name, _ in which.maps] == ["a", "b"]


def test_files_of_a_folder_are_told_by_what_they_hold(tmp_path: Path, caplog) -> None:
    table = "# angle_min=-1, angle_max=1, range_max=9\n1.5,2.5,nan,3\n"
    echoed = "header:\n  frame_id: laser\nangle_min: 0\nranges: [1, 2]\n---\n"
    taken = {"a.txt": table, "b": table, "c.txt": echoed, "d.yaml": echoed}
    left = {"README.txt": "The 2 scans.\n", "e.npy": "x", "f.png": "", "map.yaml": "image: f"}
    for name, text in (taken | left).items():
        (tmp_path / name).write_text(text)
    found = find_items(tmp_path, tmp_path, make_job("localize"))
    assert [(item.map, item.scans) for item in found] == [("map", name) for name in taken]
    assert "left out README.txt: no table" in caplog.text
    assert "left out e.npy: cannot be read: an array without angles" in caplog.text


def test_pairs(site: Path, tmp_path: Path) -> None:
    pairs = site / "pairs.csv"
    with pairs.open("w", newline="") as file:
        csv.writer(file).writerows(
            [("map", "scans"), ("floors/post.yaml", "scans/s1.npz"), ("gone.yaml", "all.npz")]
        )
    with ThreadPoolExecutor(1) as pool:
        found = run_batch(pairs, None, tmp_path / "out", QUICK, executor=pool)
    assert found.statuses == {"ok": 1, "failed": 1}
    (lost,) = [row for row in read_rows(tmp_path / "out") if row["status"] == "failed"]
    assert (lost["map"], lost["code"]) == ("gone.yaml", "map")
    assert "no such file" in lost["message"]


@pytest.mark.parametrize(
    ("maps", "scans", "job", "said"),
    [
        ("scans", "scans", "localize", "no map"),
        ("floors", "floors", "localize", "no scans"),
        ("floors", None, "localize", "needs scans"),
        ("floors", "scans", "check", "looks at maps alone"),
        ("bad.csv", None, "localize", "expected map,scans"),
        ("none.csv", None, "localize", "no pair"),
        ("long.csv", None, "localize", r"line 2: field larger than .* expected map,scans"),
    ],
)
def test_nothing_to_do_is_an_error(site: Path, maps, scans, job, said) -> None:
    (site / "bad.csv").write_text("a,b\n1,2\n")
    (site / "none.csv").write_text("map,scans\n")
    (site / "long.csv").write_text(f"map,scans\n{'a' * 200_000},b\n")
    with pytest.raises(ConfigError, match=said):
        find_items(site / maps, None if scans is None else site / scans, make_job(job))


# Jobs.


@pytest.mark.parametrize("job", ["check", "which"])
def test_every_command_s_work(site: Path, tmp_path: Path, job: str) -> None:
    scans = None if job == "check" else site / "scans" / "s0.npz"
    what = make_job(job, pictures="all", **({} if job == "check" else {"cell": 0.2}))
    with ThreadPoolExecutor(1) as pool:
        out = tmp_path / "out"
        means = Means(drawings=DRAWINGS)
        found = run_batch(site / "floors", scans, out, what, executor=pool, means=means)
    assert found.statuses == {"ok": 1}, next(read_rows(out))["message"]
    (row,) = read_rows(out)
    (answer,) = row["answers"]
    assert {"check": "shares", "which": "maps"}[job] in answer
    assert answer["pictures"]
    for name in answer["pictures"]:
        assert (out / "pictures" / name).read_bytes().startswith(b"\x89PNG")
    assert "Answer by answer" in render_report(out)
    assert columns_of(out)["status"] == ["ok"]


def test_a_job_of_somebody_else_is_a_class_and_a_name(site, tmp_path, monkeypatch):
    monkeypatch.setitem(doors.JOBS, "area", "strangers:Area")
    out = tmp_path / "out"
    with ThreadPoolExecutor(1) as pool:
        run_batch(site / "floors", None, out, make_job("area", step=0.5), executor=pool)
    (row,) = read_rows(out)
    free = room_with_a_post().free.sum() * 0.1**2
    assert row["answers"] == [{"size": {"squares": pytest.approx(free / 0.25)}, "unit": "squares"}]
    assert "size.squares" in render_report(out)
    assert columns_of(out)["size_squares"] == [pytest.approx(free / 0.25)]
    bare = np.ones((20, 30), bool)  # a map without walls is a map, too
    save_map(tmp_path / "bare.yaml", OccupancyGrid(~bare, bare, 0.1))
    with ThreadPoolExecutor(1) as pool:
        there = tmp_path / "there"
        run_batch(tmp_path / "bare.yaml", None, there, make_job("area"), executor=pool)
    (row,) = read_rows(there)
    assert row["answers"] == [{"size": {"squares": pytest.approx(6.0)}, "unit": "squares"}]
    with pytest.raises(TypeError, match="cell"):
        make_job("area", cell=0.2)


def test_a_worker_that_has_a_lossy_map_refuses_it_still(site: Path, tmp_path: Path) -> None:
    jpeg = tmp_path / "post.jpg"
    with PIL.Image.open(site / "floors" / "post.png") as image:
        image.convert("L").save(jpeg, quality=95)
    item = Item("post", "s0.npz", (("post", jpeg),), site / "scans" / "s0.npz")
    job = replace(QUICK, maps=MapFiles({"resolution": 0.1}, allow_lossy=True))
    assert answers(item, job)
    with pytest.raises(MapError, match="pass `allow_lossy=True`"):
        answers(item, replace(job, maps=MapFiles({"resolution": 0.1})))


def test_pictures_of_what_is_doubtful(site: Path, tmp_path: Path) -> None:
    one = load_scans(site / "all.npz")[0]
    far = type(one)(np.full(60, np.inf), one.angles, range_max=9.0)
    save_scans(tmp_path / "blind.npz", ScanSet((far,)))
    place, means = site / "floors", Means(drawings=DRAWINGS)
    for kind, count in (("none", 0), ("doubtful", 1), ("all", 1)):
        job, out = make_job(pictures=kind), tmp_path / kind
        with ThreadPoolExecutor(1) as pool:
            run_batch(place, tmp_path / "blind.npz", out, job, means=means, executor=pool)
        (row,) = read_rows(out)
        assert len(row["answers"][0].get("pictures", ())) == count
    # A pose that is sure is doubtful if the known one is another: not if it is right, or unknown.
    with ThreadPoolExecutor(1) as pool:
        run_batch(place, site / "all.npz", tmp_path / "sure", make_job(), executor=pool)
        (row,) = read_rows(tmp_path / "sure")
        sure = [a["index"] for a in row["answers"] if a["verdict"] == "unique"][:3]
        some = load_scans(site / "all.npz").take(sure)
        job, away = make_job(pictures="doubtful"), some.poses + (5.0, 0.0, 0.0)
        near = some.poses + (0.37, 0.0, 0.0)  # metres; to 0.5 m an answer is right
        known = {"right": some.poses, "near": near, "wrong": away, "none": None}
        for name, poses in known.items():
            save_scans(tmp_path / f"{name}.npz", replace(some, poses=poses))
            out = tmp_path / f"{name}-out"
            run_batch(place, tmp_path / f"{name}.npz", out, job, means=means, executor=pool)
            (row,) = read_rows(out)
            pictures = sum(bool(a.get("pictures")) for a in row["answers"])
            assert pictures == (3 if name == "wrong" else 0)


# The command.


def test_the_command_says_what_it_comes_to(site: Path, tmp_path: Path) -> None:
    words = ["batch", site / "floors", site / "scans", "--out", tmp_path / "out"]
    words += ["--method", "cbml", "--cell", 0.2, "--workers", 1]
    dry = call(*words, "--dry-run")
    assert (dry.code, dry.out) == (0, "6 items: 1 maps, 6 files of scans\n")
    assert not (tmp_path / "out").exists()
    (site / "scans" / "torn.csv").write_text("x")
    try:
        run = call(*words)
        again = call(*words, "--resume", "--dry-run")
        other = call(*words, "--resume", "--dry-run", "--top", 3)
        retried = call(*words, "--retry-failed", "--json")
    finally:
        (site / "scans" / "torn.csv").unlink()
    assert run.code == 5
    assert run.out.startswith("7 items: 6 ok, 1 failed\n6 scans: ")
    assert "of 6 scans with a known pose" in run.out
    assert again.out == "7 items: 1 maps, 7 files of scans; 7 are done\n"
    assert "; 6 were done with other options, files or versions, and are done anew" in other.out
    assert retried.code == 5
    assert json.loads(retried.out)["new"] == 1


@pytest.mark.parametrize(
    ("job", "words", "said"),
    [
        ("check", ["--method", "cbml"], "--method: is for localize, not for check"),
        ("check", ["--heading", "1"], "--heading: is for localize, which, not for check"),
        ("localize", ["--sure", "0.9"], "--sure: is for which, not for localize"),
        ("area", [], "--job: got 'area', expected one of localize, check, which"),
        ("localize", ["--near", "1,2,3"], "--near: is no option here; imgloc localize has it"),
        ("which", ["--method", "fused"], "--method: is for localize"),
    ],
)
def test_an_option_that_the_job_would_not_notice_is_refused(site, tmp_path, job, words, said):
    scans = [] if job == "check" else [site / "scans"]
    out = tmp_path / "out"
    run = call("batch", site / "floors", *scans, "--job", job, "--out", out, *words, "--dry-run")
    run.ends(2, said, out="")


def test_units_and_lasers_of_all_files(site: Path, tmp_path: Path) -> None:
    scans = load_scans(site / "all.npz")
    longer = tuple(scan.scaled(1000) for scan in scans.scans[:2])
    save_scans(tmp_path / "mm.npz", ScanSet(longer, poses=scans.poses[:2]))
    words = ["batch", site / "floors", tmp_path / "mm.npz", "--workers", 1, "--no-cache"]
    words += ["--method", "cbml", "--cell", 0.2]
    out = tmp_path / "out"
    assert call(*words, "--range-scale", 0.001, "--range-max", 8, "--out", out).code == 0
    (row,) = read_rows(out)
    with ThreadPoolExecutor(1) as pool:
        save_scans(tmp_path / "m.npz", ScanSet(scans.scans[:2], poses=scans.poses[:2]))
        there, job = tmp_path / "there", replace(QUICK, scans=ScanFiles(range_max=8.0))
        run_batch(site / "floors", tmp_path / "m.npz", there, job, executor=pool)
    (metres,) = read_rows(there)
    for a, b in zip(row["answers"], metres["answers"], strict=True):
        assert a["error"]["position"] == pytest.approx(b["error"]["position"], abs=1e-6)
    log, far = tmp_path / "run.log", " ".join(["2.0"] * 181)
    log.write_text(f"FLASER 181 {far} 0 0 0 0 0 0 1 robot 1\n")
    words[2] = log
    assert call(*words, "--topic", "FLASER", "--out", tmp_path / "front").code == 0
    assert call(*words, "--topic", "RLASER", "--out", tmp_path / "rear").code == 5
    (row,) = read_rows(tmp_path / "rear")
    assert "RLASER" in json.dumps(row)
    words[2] = tmp_path / "m.npz"  # a folder may hold files without topics, too
    assert call(*words, "--topic", "RLASER", "--out", tmp_path / "none").code == 0


def test_what_is_known_of_the_poses(site: Path, tmp_path: Path) -> None:
    one = site / "scans" / "s0.npz"
    truth = Pose2D(*np.load(one)["poses"][0])

    def poses(known: Known | None = None) -> list[Pose2D]:
        out = tmp_path / str(len(list(tmp_path.iterdir())))
        job = replace(QUICK, options=Options(method="cbml"), known=known or Known())
        with ThreadPoolExecutor(1) as pool:
            run_batch(site / "floors", one, out, job, executor=pool)
        (row,) = read_rows(out)
        return [Pose2D(h["x"], h["y"], h["theta"]) for h in row["answers"][0]["hypotheses"]]

    def turn(pose: Pose2D) -> float:
        return abs(float(wrap(pose.theta - truth.theta)))

    assert max(map(turn, poses())) > 0.5
    assert max(map(turn, poses(Known(heading=(truth.theta, 0.2))))) < 0.3
    near = poses(Known(near=(truth.x, truth.y, truth.theta, 0.5, 3.0)))
    assert max(np.hypot(p.x - truth.x, p.y - truth.y) for p in near) < 0.8
    assert min(min(p.x, p.y) for p in poses(Known(clearance=0.8))) > 0.5
    words = ["batch", site / "floors", one, "--out", tmp_path / "told", "--method", "cbml"]
    words += ["--cell", 0.2, "--heading", f"{truth.theta},0.2", "--clearance", 0.4, "--no-cache"]
    assert call(*words, "--workers", 1).code == 0
    (row,) = read_rows(tmp_path / "told")
    assert abs(row["answers"][0]["pose"]["theta"] - truth.theta) < 0.3
    (said,) = json.loads((tmp_path / "told" / "run.json").read_text())["parameters"].values()
    assert (said["known"]["clearance"], said["known"]["near"]) == (0.4, None)


@pytest.mark.parametrize("name", JOBS)
def test_other_numbers_make_other_rows_of_the_jobs_that_use_them(name, monkeypatch):
    """A job uses those that its module asks for, and the modules that this one imports."""
    before, module = make_job(name).digest, job_class(name).__module__
    loaded = subprocess.run(
        [sys.executable, "-c", f"import sys, {module}; print(*sys.modules)"],
        capture_output=True, text=True, check=True,
    ).stdout.split()  # fmt: skip
    paths = [ROOT / (module.replace(".", "/") + ".py") for module in loaded if "imgloc." in module]
    asked = {f for p in paths if p.exists() for f in ASKS.findall(p.read_text("utf-8"))}
    # What is said beside the rows, and what options.py hands to another job.
    asked -= {"diagnose", "logcheck", "scanmotion"} | ({"choose"} if name != "which" else set())
    asked -= {"changes"}
    for number, one in list(numbers.NUMBERS.items()):
        value = tuple(2 * v for v in one.value) if isinstance(one.value, tuple) else one.value + 1
        with monkeypatch.context() as changed:
            changed.setitem(numbers.NUMBERS, number, replace(one, value=value))
            other = make_job(name).digest != before
        assert other == (name != "check" and number.split(".")[0] in asked), number


def test_two_files_that_are_shown_by_one_name_are_refused(tmp_path: Path) -> None:
    """A letter that cannot be printed, and the letters that stand for it."""
    folder, maps = tmp_path / "scans", tmp_path / "maps"
    folder.mkdir()
    maps.mkdir()
    grid = room_with_a_post()
    save_map(maps / "a.yaml", grid)
    for name in ("r\x1bd.npz", "r\\x1bd.npz"):
        save_scans(folder / name, simulate(grid, 1, 1, Sensor(rays=30)))
    expected = "2 files are shown by this name"
    run = call("batch", maps, folder, "--out", tmp_path / "out", "--dry-run")
    assert (run.code, expected in run.err) == (2, True), run.err
    pairs = "map,scans\nmaps/a.yaml,scans/r\x1bd.npz\nmaps/a.yaml,scans/r\\x1bd.npz\n"
    (tmp_path / "pairs.csv").write_text(pairs)
    run = call("batch", tmp_path / "pairs.csv", "--out", tmp_path / "out", "--dry-run")
    assert (run.code, expected in run.err) == (2, True), run.err
    (tmp_path / "pairs.csv").write_text("map,scans\n" + 2 * "maps/a.yaml,scans/r\x1bd.npz\n")
    run = call("batch", tmp_path / "pairs.csv", "--out", tmp_path / "out", "--dry-run")
    assert (run.code, "1 items" in run.out) == (0, True)  # the same pair twice is one
