"""Every bad file, through the command line: one line, exit 3 or 4, nothing written."""

from pathlib import Path
from typing import NamedTuple

import pytest
from badfiles import BadFile, write_bad_files, yaml_with
from command import Run, call, spawn

CODES = {"map": 3, "scan": 4}
REAL = ("half.jpg", "undecodable scan")
DRAWN = ("all_free.png", "all_wall.png")  # to be looked at
REPORTED = (*DRAWN, "lossy.jpg", "lossy.webp", "too_long_side.png")


class Inputs(NamedTuple):
    bad: list[BadFile]
    map: Path
    scans: Path

    def words(self, file: BadFile, folder: Path) -> list[object]:
        """Localize with one bad input, asked to write a picture."""
        pair = (file.path, self.scans) if file.kind == "map" else (self.map, file.path)
        return ["localize", *pair, "--json", "--picture", folder / "out.png"]


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Inputs:
    folder = tmp_path_factory.mktemp("bad")
    bad = write_bad_files(folder)
    good, scans = folder / "good.yaml", folder / "good.npz"
    good.write_text(yaml_with("nothing", ""))
    assert call("simulate", good, "-n", 1, "--out", scans).code == 0
    return Inputs(bad, good, scans)


def judge(file: BadFile, run: Run, folder: Path) -> list[str]:
    """Return what is wrong with how a bad file was refused."""
    faults = []
    if run.code != CODES[file.kind]:
        faults.append(f"exit {run.code}")
    if run.out:
        faults.append("something on stdout")
    if run.err.count("\n") != 1 or not run.err.startswith("imgloc: error: "):
        faults.append("not one line of error")
    if not run.err.strip().isprintable():
        faults.append("what a terminal would obey")
    if file.expected not in run.err:
        faults.append(f"no {file.expected!r}")
    if list(folder.iterdir()):
        faults.append("something written")
    return [f"{file.name}: {fault}: {run.err}" for fault in faults]


def test_every_bad_file_is_one_clear_error(inputs, tmp_path, capfd):
    assert len(inputs.bad) > 100
    runs = ((file, call(*inputs.words(file, tmp_path))) for file in inputs.bad)
    assert not [fault for file, run in runs for fault in judge(file, run, tmp_path)]
    assert capfd.readouterr() == ("", "")  # no library has its own say, past Python


@pytest.mark.parametrize("name", REAL)
def test_the_real_command_says_the_same(name: str, inputs: Inputs, tmp_path: Path) -> None:
    found = [file for file in inputs.bad if file.name == name]
    if not found:
        pytest.skip("not to be had on this system")
    run = spawn(*inputs.words(found[0], tmp_path))
    assert not judge(found[0], run, tmp_path)


@pytest.mark.parametrize("command", ["check", "show", "simulate"])
def test_other_commands_refuse_bad_maps_too(command: str, inputs: Inputs, tmp_path: Path) -> None:
    before: list[object] = {
        "check": ["map", "check"],
        "show": ["map", "show", "--out", tmp_path / "out.png"],
        "simulate": ["simulate", "--out", tmp_path / "out.npz"],
    }[command]
    passed = REPORTED if command == "check" else DRAWN if command == "show" else ()
    maps = [file for file in inputs.bad if file.kind == "map" and file.name not in passed]
    runs = ((file, call(*before, file.path)) for file in maps)
    assert not [fault for file, run in runs for fault in judge(file, run, tmp_path)]
