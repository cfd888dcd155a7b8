"""The commands of the README and of the guides run, or at least parse, as they are written."""

import re
import shlex
import shutil
from importlib.util import find_spec
from pathlib import Path

import pytest
import typer.main
from command import MAPS, ROOT, call

from imgloc.cli import app
from imgloc.io.maps import load_map, save_map
from imgloc.io.scans import load_scans, save_scans
from imgloc.simulation import simulate

README = (ROOT / "README.md").read_text("utf-8")
PAGES = {"README.md": README}
PAGES |= {p.name: p.read_text("utf-8") for p in sorted((ROOT / "tools" / "docs").glob("*.md"))}
# Of the README these take long; they have tests of their own.
SLOW = ("atlas", "evaluate")
BATCH = ("batch", "report", "export")


def commands(page: str) -> list[str]:
    """What is typed after `imgloc` in the blocks of a page."""
    blocks = re.findall(r"^```(?:sh|console)\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
    found = re.findall(r"^(?:\$ )?imgloc (.+?)(?: +#.*)?$", "\n".join(blocks), re.MULTILINE)
    return [line for line in found if " " in line]


TOUR = [line for line in commands(README) if not line.startswith((*SLOW, *BATCH))]


def test_the_tour_is_short_and_has_its_commands() -> None:
    assert len(README.splitlines()) <= 250
    assert len(TOUR) >= 11
    names = {line.split()[0] for line in commands(README)}
    assert names >= {"map", "localize", "which", "track", "atlas", "simulate", "sample", *BATCH}


@pytest.fixture
def robot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The files that the README speaks of, in the working folder."""
    grid = load_map(MAPS / "curved.yaml")
    save_map(tmp_path / "map.yaml", grid)
    scans = simulate(grid, 4, 1)
    save_scans(tmp_path / "scans.npz", scans)
    ranges, angles = scans[0].ranges, scans[0].angles
    text = "".join(f"{a},{r}\n" for a, r in zip(angles, ranges, strict=True))
    (tmp_path / "scan.csv").write_text(text)
    words = " ".join(f"{r:.3f}" for r in ranges)
    lines = [f"FLASER 181 {words} {k} 0 0 {k} 0 0 {k} robot {k}" for k in range(41)]
    for name in ("robot.log", "run.log"):
        (tmp_path / name).write_text("\n".join(lines))
    (tmp_path / "floors" / "gh25").mkdir(parents=True)
    for name in ("map.yaml", "map.png"):
        shutil.copy(tmp_path / name, tmp_path / "floors" / "gh25")
    for name in ("scans", "runs"):
        (tmp_path / name).mkdir()
        shutil.copy(tmp_path / "scan.csv", tmp_path / name)
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("line", TOUR)
@pytest.mark.usefixtures("robot")
def test_a_command_of_the_tour_runs(line: str) -> None:
    line = line.replace(" - < ", " ")
    if "--near" in line:  # that of somebody else's robot
        line = line.replace("3,2,90deg", "8,6,90deg,20,180deg")
    one = ["--index", "0"] if line.startswith("localize") and "--index" not in line else []
    run = call(*shlex.split(line), *one)
    assert run.code == 0, run.err


@pytest.mark.usefixtures("robot")
def test_the_batch_of_the_tour_its_page_and_its_table() -> None:
    lines = [c for c in commands(README) if c.startswith(BATCH)]
    assert [line.split()[0] for line in lines] == ["batch", "batch", "report", "export", "batch"]
    for line in lines:
        run = call(*shlex.split(line))
        assert run.code == 0, run.err
    assert Path("found/report.html").exists()
    assert Path("found/results.csv").exists()


@pytest.mark.usefixtures("robot")
def test_a_batch_of_pairs_runs() -> None:
    Path("pairs.csv").write_text("map,scans\nfloors/gh25/map.yaml,runs/scan.csv\n")
    run = call("batch", "pairs.csv", "--out", "found")
    assert run.code == 0, run.err
    assert run.out.startswith("1 items: 1 ok\n1 scans: 1 unique\n")


@pytest.mark.usefixtures("robot")
def test_the_lines_of_python_run() -> None:
    (block,) = re.findall(r"^```python\n(.*?)^```", README, re.MULTILINE | re.DOTALL)
    names: dict[str, object] = {}
    exec(block, names)
    assert Path("where.png").stat().st_size > 1000
    assert names["answer"].verdict == "unique"


@pytest.mark.usefixtures("robot")
def test_the_example_files_are_read() -> None:
    for name, start, count in (("a.csv", "# scans.csv", 2), ("a.json", "{", 1)):
        (block,) = re.findall(rf"^```\w*\n({re.escape(start)}[^`]*)```", README, re.MULTILINE)
        Path(name).write_text(block)
        assert len(load_scans(name)) == count


@pytest.mark.parametrize("name", list(PAGES))
def test_every_command_of_a_page_parses(name: str) -> None:
    for line in commands(PAGES[name]):
        command, words = typer.main.get_command(app), shlex.split(line)
        while hasattr(command, "commands"):
            command = command.commands[words.pop(0)]
        with command.make_context("imgloc", words):
            pass


@pytest.mark.parametrize("name", list(PAGES))
def test_what_a_page_names_is_there(name: str) -> None:
    folder = ROOT if name == "README.md" else ROOT / "tools" / "docs"
    for link in re.findall(r"\]\((?!https?:|#)([^)]+)\)", PAGES[name].replace("\n", " ")):
        assert (folder / link).exists(), link
    for module in re.findall(r"python -m (tools[\w.]*)", PAGES[name]):
        assert find_spec(module) is not None, module
    known, groups = {"--help"}, [typer.main.get_command(app)]
    while groups:
        command = groups.pop()
        known |= {o for p in command.params for o in (*p.opts, *p.secondary_opts)}
        groups += getattr(command, "commands", {}).values()
    assert set(re.findall(r"`(--[a-z-]+)", PAGES[name])) <= known
