"""The commands of the README's tour run as they are written."""

import re
import shlex
import shutil
from pathlib import Path

import pytest
from command import MAPS, ROOT, call

from imgloc.io.maps import load_map, save_map
from imgloc.io.scans import load_scans, save_scans
from imgloc.simulation import simulate

README = (ROOT / "README.md").read_text("utf-8")
SECTION = README[README.index("## From my robot") : README.index("## Files")]
COMMANDS = re.findall(r"^(?:\$ )?imgloc (.+?)(?: +#.*)?$", SECTION, re.MULTILINE)
# Others have tests of their own, or write into the user's shell.
SLOW = ("atlas", "calibrate", "which", "simulate", "--install", "batch", "report", "export")


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
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("line", [c for c in COMMANDS if not c.startswith(SLOW)])
@pytest.mark.usefixtures("robot")
def test_a_command_of_the_tour_runs(line: str) -> None:
    line = line.replace(" - < ", " ")
    extra = ["--index", "0"] if line.startswith("localize") and "--index" not in line else []
    if "--near" in line:  # that of somebody else's robot
        line = line.replace("3,2,90deg", "8,6,90deg,20,180deg")
    run = call(*shlex.split(line), *extra)
    assert run.code == 0, run.err


@pytest.mark.usefixtures("robot")
def test_the_batch_of_the_tour_its_page_and_its_table() -> None:
    pytest.importorskip("pyarrow", reason="pyarrow writes Parquet")
    for folder, names in (("floors", ("map.yaml", "map.png")), ("scans", ("scan.csv",))):
        Path(folder).mkdir()
        for name in names:
            shutil.copy(name, folder)
    lines = [c for c in COMMANDS if c.startswith(("batch", "report", "export"))]
    assert len(lines) == 3
    for line in lines:
        run = call(*shlex.split(line))
        assert run.code == 0, run.err
    assert Path("found/report.html").exists()


@pytest.mark.usefixtures("robot")
def test_the_example_files_are_read() -> None:
    for name, start, count in (("a.csv", "# scans.csv", 2), ("a.json", "{", 1)):
        (block,) = re.findall(rf"^```\w*\n({re.escape(start)}[^`]*)```", README, re.MULTILINE)
        Path(name).write_text(block)
        assert len(load_scans(name)) == count
