"""The commands of the README and of the guides run, or at least parse, as they are written."""

import io
import re
import shlex
import shutil
import sys
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
import typer
from command import ROOT, call, params_of, tree
from places import room_with_a_post

from imgloc import Pose2D, Sensor, load_scans, save_map, save_scans, simulate
from imgloc.cli import app

README = (ROOT / "README.md").read_text("utf-8")
PAGES = {"README.md": README}
PAGES |= {p.name: p.read_text("utf-8") for p in sorted((ROOT / "tools" / "docs").glob("*.md"))}
TOUR = PAGES["start.md"]


def commands(page: str) -> list[str]:
    """What is typed after `imgloc` in the blocks of a page."""
    blocks = re.findall(r"^```(?:sh|console)\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
    found = re.findall(r"^(?:\$ )?imgloc (.+?)(?: +#.*)?$", "\n".join(blocks), re.MULTILINE)
    return [line for line in found if " " in line]


def test_the_readme_is_short_and_the_tour_has_its_commands() -> None:
    assert len(README.splitlines()) <= 90
    assert len(README.split()) <= 700
    assert [line.split()[0] for line in commands(README)] == ["inspect", "localize", "track"]
    names = {line.split()[0] for line in commands(TOUR)}
    assert names >= {"inspect", "map", "localize", "which", "track", "atlas", "simulate", "sample"}
    assert names >= {"batch", "report", "export"}


@pytest.fixture
def robot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The files that the README speaks of, in the working folder."""
    grid = room_with_a_post()
    scans = simulate(grid, 4, 2, Sensor(range_max=9.0))
    x, y, _ = np.asarray(scans.poses)[0]
    moved = Pose2D(3 - x, 2 - y)  # the first robot is where --near says
    save_map(tmp_path / "map.yaml", replace(grid, origin=moved))
    poses = np.asarray(scans.poses) + (moved.x, moved.y, 0)
    save_scans(tmp_path / "scans.npz", replace(scans, poses=poses))
    ranges, angles = scans[0].ranges, scans[0].angles
    text = "".join(f"{a},{r}\n" for a, r in zip(angles, ranges, strict=True))
    (tmp_path / "scan.csv").write_text(text)
    words = " ".join(f"{r:.3f}" for r in ranges)
    lines = [f"FLASER 181 {words} {k} 0 0 {k} 0 0 {k} robot {k}" for k in range(5)]
    for name in ("robot.log", "run.log"):
        (tmp_path / name).write_text("\n".join(lines))
    (tmp_path / "floors" / "gh25").mkdir(parents=True)
    for name in ("map.yaml", "map.png"):
        shutil.copy(tmp_path / name, tmp_path / "floors" / "gh25")
    for name in ("scans", "runs"):
        (tmp_path / name).mkdir()
        shutil.copy(tmp_path / "scan.csv", tmp_path / name)
    pairs = "map,scans\nfloors/gh25/map.yaml,runs/scan.csv\n"
    (tmp_path / "pairs.csv").write_text(pairs)
    monkeypatch.chdir(tmp_path)


@pytest.mark.usefixtures("robot")
def test_every_command_of_the_readme_runs_as_it_is_written(monkeypatch: pytest.MonkeyPatch) -> None:
    for line in commands(README) + commands(TOUR) + commands(PAGES["compared.md"]):
        line, _, read = line.partition(" < ")
        if read:
            monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(Path(read).read_bytes())))
        call(*shlex.split(line)).ends(0)
    for name in ("where.png", "why.html", "heat.png", "atlas.png", "floors.npz", "sim.npz",
                 "particles.csv", "out.tum", "track.png", "found/report.html",
                 "found/results.csv"):  # fmt: skip
        assert Path(name).exists(), name


@pytest.mark.usefixtures("robot")
def test_the_lines_of_python_run() -> None:
    for page in (README, TOUR):
        (block,) = re.findall(r"^```python\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
        names: dict[str, object] = {}
        for _ in range(2):  # as a reader does who has changed a line
            exec(block, names)
        assert Path("where.png").stat().st_size > 1000
        assert names["answer"].verdict == "unique"
        Path("where.png").unlink()


@pytest.mark.usefixtures("robot")
def test_the_example_files_are_read() -> None:
    (words,) = re.findall(r"`imgloc (localize curved scan.csv)`", TOUR)
    for name, start in (("scan.csv", "# scan.csv"), ("a.json", "{")):
        (block,) = re.findall(rf"^```\w*\n({re.escape(start)}[^`]*)```", TOUR, re.MULTILINE)
        Path(name).write_text(block)
        assert len(load_scans(name)) == 1
        run = call(*words.replace("scan.csv", name).split())
        assert run.out.startswith("scan 0: unique\n"), run.out
        assert float(re.findall(r"x (\S+) m", run.out)[0]) == pytest.approx(12.0, abs=0.03)


@pytest.mark.parametrize("name", list(PAGES))
def test_every_command_of_a_page_parses(name: str) -> None:
    root = typer.Context(tree())
    for line in commands(PAGES[name]):
        command, words = tree(), shlex.split(line)
        while hasattr(command, "commands"):
            command = command.commands[words.pop(0)]
        with command.make_context("imgloc", words, parent=root):
            pass


@pytest.mark.parametrize("name", list(PAGES))
def test_what_a_page_names_is_there(name: str) -> None:
    folder = ROOT if name == "README.md" else ROOT / "tools" / "docs"
    for link in re.findall(r"\]\((?!https?:|#)([^)]+)\)", PAGES[name].replace("\n", " ")):
        assert (folder / link).exists(), link
    for module in re.findall(r"python -m (tools[\w.]*)", PAGES[name]):
        assert find_spec(module) is not None, module
    known, groups = {"--help"}, [tree()]
    while groups:
        command = groups.pop()
        known |= {o for p in params_of(command) for o in (*p.opts, *p.secondary_opts)}
        groups += getattr(command, "commands", {}).values()
    assert set(re.findall(r"`(--[a-z-]+)", PAGES[name])) <= known


def test_the_lines_that_convert_a_log_make_scans_of_it(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("own.txt").write_text("12.5 100 200 90 231 230 102\n13.5 110 200 90 231 230 103\n")
    (block,) = re.findall(r"^```python\n(.*?)^```", PAGES["logs.md"], re.MULTILINE | re.DOTALL)
    exec(block, {})
    scans = load_scans("own.csv")
    assert scans.stamps.tolist() == [12.5, 13.5]
    assert scans.odom[1].tolist() == pytest.approx([1.1, 2, np.pi / 2], abs=1e-5)
    assert scans[1].ranges.tolist() == [2.31, 2.3, 1.03]


SLOW = {"node", "serve", "open", "evaluate", "calibrate", "plan", "clear"}
"""Commands that wait for others, take minutes, or need a drawing; these examples only parse."""
_EXAMPLE = r"^  (imgloc (?!.*(?:\.bag|dask|\.gz|--job check)).*)"
EXAMPLES = {
    name: re.findall(_EXAMPLE, app.told(app.command_of(name))["epilog"], re.MULTILINE)
    for name in app._COMMANDS | app._MAP
    if name not in SLOW
}


@pytest.mark.usefixtures("robot")
def test_an_example_of_each_command_runs() -> None:
    scans = load_scans("scans.npz")
    drive = scans.take([0] * 6)
    odom = np.column_stack([0.1 * np.arange(6), np.zeros((6, 2))])
    save_scans("log.npz", replace(drive, poses=None, stamps=np.arange(6.0), odom=odom))
    for name in ("office", "a", "b", "office-new"):
        for ending in ("yaml", "png"):
            shutil.copy(f"map.{ending}", f"{name}.{ending}")
        said = Path("map.yaml").read_text("utf-8").replace("map.png", f"{name}.png")
        Path(f"{name}.yaml").write_text(said)
    shutil.copy("run.log", "monday.log")
    assert len(EXAMPLES) >= 15
    for name, lines in EXAMPLES.items():
        words = shlex.split(lines[0].partition(" < ")[0].partition(" > ")[0])[1:]
        call(*words, *_enough(name)).ends(0)


def _enough(command: str) -> list[str]:
    """What makes an example quick, or lets it write where the one before wrote."""
    more = {"atlas": ["--step", "3"], "batch": ["--workers", "1"], "report": ["--force"],
            "simulate": ["-n", "4", "--force"]}  # fmt: skip
    return more.get(command, [])
