"""Several files, standard input, degrees, completion, and what is said after a run."""

import io
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from command import MAPS, call, rows, simulating, spawn
from places import room_with_a_post

from imgloc import Sensor, save_map, save_scans, simulate

OFF = "--no-cache"


scans = simulating("curved", "-n", 2, "--seed", 5, name="a.npz")


def through_stdin(monkeypatch: pytest.MonkeyPatch, data: bytes, *arguments: object):
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(data)))
    return call("localize", "curved", "-", OFF, *arguments)


def test_standard_input_is_read_whatever_it_is(scans, monkeypatch):
    with np.load(scans) as held:
        ranges, angles = held["ranges"][1], held["angles"]
    text = "".join(f"{a},{r}\n" for a, r in zip(angles, ranges, strict=True))
    wanted = rows(call("localize", "curved", scans, OFF, "--json").out)
    for data, index in ((scans.read_bytes(), 1), (text.encode(), 0)):
        run = through_stdin(monkeypatch, data, "--json", "--scans-index", index)
        (row,) = rows(run.out)
        assert row["pose"] == pytest.approx(wanted[1]["pose"], abs=1e-3)
    degrees = "".join(f"{k},{2 + k % 7}\n" for k in range(0, 200, 2))
    run = through_stdin(monkeypatch, degrees.encode(), "--threads", 10**10)
    assert (run.code, run.err.partition("the angles")[0]) == (0, "imgloc: standard input: ")
    run = through_stdin(monkeypatch, b"1,2,3\n4,5,6\n")
    assert (run.code, run.out) == (4, "")
    assert run.err.startswith("imgloc: error: standard input: line 1: angles: missing")
    assert through_stdin(monkeypatch, b"").err.startswith("imgloc: error: standard input: the file")
    twice = through_stdin(monkeypatch, b"1,2,3\n", "-")
    assert (twice.code, "standard input can be read only once" in twice.err) == (2, True)


@pytest.mark.parametrize(
    "words",
    [("sample", "curved", "-"), ("map", "show", "curved", "--what=likelihood", "--scans=-")],
)
def test_standard_input_has_a_name(words, scans, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(scans.read_bytes())))
    out = tmp_path / ("a.csv" if words[0] == "sample" else "a.png")
    call(*words, "--scans-index", 9, "--out", out).ends(2, "standard input has 2 scans")


def test_several_files_each_with_its_name_and_its_indices(scans: Path, tmp_path: Path) -> None:
    again = tmp_path / "b.npz"
    again.write_bytes(scans.read_bytes())
    table = call("localize", "curved", scans, again, OFF, "--picture", tmp_path / "p.png")
    lines = table.out.splitlines()
    assert [line for line in lines if line.endswith("npz:")] == [f"{scans}:", f"{again}:"]
    assert [line.split()[0] for line in lines if " unique " in line and "scans" not in line] == [
        "0",
        "1",
        "0",
        "1",
    ]
    assert sorted(p.name for p in tmp_path.glob("p-*")) == [f"p-000{k}.png" for k in range(4)]
    assert re.search(r"wrote 4 files, \S+p-0000\.png to \S+p-0003\.png", table.err)
    found = rows(call("localize", "curved", scans, again, OFF, "--json").out)
    assert [(row["parameters"]["scans"], row["index"]) for row in found] == [
        (str(path), k) for path in (scans, again) for k in (0, 1)
    ]
    call("localize", "curved", scans, tmp_path / "none.npz", OFF).ends(4, out="")


def test_after_a_run_it_is_said_how_it_went(scans: Path) -> None:
    run = call("localize", "curved", scans, scans, scans, OFF)
    said = r"6 scans: 6 unique; 6 of 6 first poses within 0\.5 m and 10 deg of the known ones, "
    assert re.search(said + r"median error 0\.\d+ m and \d\.\d+ deg\n$", run.err)
    one = call("localize", "curved", scans, OFF, "--scans-index", 0)
    assert "sd xy / m" in one.out
    assert re.search(r"common to one wall\nnot shown above: \d\.\d % of the probability", one.out)
    verbose = call("localize", "curved", scans, OFF, "-v").err
    assert re.search(r"a\.npz, scan 1: unique, localize \d+ ms", verbose)
    assert "{" not in verbose


def test_angles_may_be_degrees(scans: Path) -> None:
    place = rows(call("localize", "curved", scans, OFF, "--json", "--scans-index", 0).out)[0][
        "pose"
    ]
    x, y, degrees = place["x"], place["y"], np.rad2deg(place["theta"])
    near = f"{x:.3f},{y:.3f},{degrees:.2f}deg,1,5deg"
    words = ("--near", near, "--sensor", "0.2,0,90deg", "--json", "--scans-index", 0)
    (row,) = rows(call("localize", "curved", scans, OFF, *words).out)
    about = row["parameters"]["prior"]["near"]
    assert about["theta"] == pytest.approx(place["theta"], abs=1e-3)
    assert about["tolerance"] == pytest.approx(np.deg2rad(5))
    assert row["parameters"]["sensor"]["theta"] == pytest.approx(np.pi / 2)
    heading = ("--heading", "90deg,10deg", "--json", "--scans-index", 0)
    (row,) = rows(call("localize", "curved", scans, OFF, *heading).out)
    assert row["parameters"]["prior"]["heading"]["theta"] == pytest.approx(np.pi / 2)
    call("localize", "curved", scans, "--near", "1deg,2,3").ends(2)
    hint = call("localize", "curved", scans, "--near", "1,2,90")
    assert "are these degrees? write 90deg" in hint.err
    turned = call("localize", "curved", scans, "--heading", "400deg")
    assert (turned.code, "expected -360deg to 360deg" in turned.err) == (2, True)


def test_formats_are_in_the_help_and_their_examples_are_read(tmp_path: Path) -> None:
    text = call("localize", "--help").out
    csv = re.search(r"( +# angle_min.*\n.*\n)", text)
    line = re.search(r"(\{\"angle_min\"[^}]*\})", text)
    (tmp_path / "a.csv").write_text("".join(s.strip() + "\n" for s in csv[1].splitlines()))
    (tmp_path / "a.json").write_text(line[1].replace(", ...", ""))
    for name, valid in (("a.csv", [11]), ("a.json", [4])):
        run = call("localize", "curved", tmp_path / name, OFF, "--json")
        assert [row["counts"]["valid"] for row in rows(run.out)] == valid
    for ending in (".npz", ".log", ".bag", ".yaml", "standard input"):
        assert ending in text


def test_completion_is_installed_and_completes(tmp_path: Path) -> None:
    script = tmp_path / "imgloc"
    root = str(Path(__file__).resolve().parents[1])
    script.write_text(
        f"#!{sys.executable}\nimport sys\nsys.path.insert(0, {root!r})\n"
        "from imgloc.cli.app import main\nmain()\n"
    )
    script.chmod(0o755)

    def run(*arguments: str, **more: str) -> str:
        env = {**os.environ, "HOME": str(tmp_path), "PATH": f"{tmp_path}:{os.environ['PATH']}"}
        env |= {"_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"} | more
        done = subprocess.run(
            [script, *arguments], env=env, capture_output=True, text=True, check=False, timeout=60
        )
        return done.stdout + done.stderr

    assert "imgloc" in run("--install-completion", "bash")
    assert list(tmp_path.glob(".bash_completions/imgloc*"))
    asked = {"_IMGLOC_COMPLETE": "complete_bash", "COMP_WORDS": "imgloc loc", "COMP_CWORD": "1"}
    assert run(**asked).split() == ["localize"]
    asked |= {"COMP_WORDS": "imgloc localize a.yaml --threads 2 --m", "COMP_CWORD": "5"}
    assert {"--method", "--memory-budget"} <= {*run(**asked).split()}


def test_the_help_of_the_whole_says_what_ctrl_c_ends_with() -> None:
    assert "130" in spawn("--help").out


QUICK = ("--method", "cbml", "--cell", 0.5, "--theta-step-deg", 30)


def twelve(folder: Path) -> tuple[Path, Path]:
    """A small map, and twelve small scans."""
    grid, scans = room_with_a_post(), folder / "a.npz"
    save_map(folder / "m.yaml", grid)
    save_scans(scans, simulate(grid, 12, 3, Sensor(rays=20, range_max=9.0)))
    return folder / "m.yaml", scans


def indices(*words: object) -> list[int]:
    run = call("localize", *words, OFF, "--json", *QUICK).ends(0)
    return [row["index"] for row in rows(run.out)]


def test_scans_are_chosen_by_lists_ranges_and_samples(tmp_path: Path) -> None:
    both = where, path = twelve(tmp_path)
    assert indices(*both, "--scans-index", "7,2,2") == [7, 2]
    assert indices(*both, "--scans-index", "3", "--scans-index", "8:") == [3, 8, 9, 10, 11]
    assert indices(*both, "--scans-index", "::5") == [0, 5, 10]
    some = indices(*both, "--sample", 3)
    assert some == sorted(some)
    assert len(set(some)) == 3
    assert some == indices(*both, "--sample", 3)
    assert set(indices(*both, "--scans-index", "::5", "--sample", 2)) < {0, 5, 10}
    words = ("evaluate", where, "--scans", path, "--method", "cbml", "--json", *QUICK[2:])
    (row,) = rows(call(*words, "--scans-index", "2:6").out)
    assert (row["trials"], row["source"]["index"]) == (4, "2:6")
    out = tmp_path / "a.csv"
    call("sample", *both, "--scans-index", "4,6", "-n", 5, "--out", out).ends(0)
    assert [line.split(",")[0] for line in out.read_text().splitlines()[1::5]] == ["4", "6"]
    found = tmp_path / "found"
    more = ("--scans-index", "1,5", "--workers", 1, "--tolerance", "0.3,10")
    call("batch", *both, "--out", found, *more, *QUICK).ends(0)
    assert [a["index"] for a in rows((found / "results.jsonl").read_text())[0]["answers"]] == [1, 5]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("localize", "--scans-index", "3-5"), "got '3-5', expected indices from 0, ranges A:B"),
        (("localize", "--scans-index", "1:4:0"), "got '1:4:0', expected indices from 0"),
        (("localize", "--scans-index", "4,12"), "got 12, expected 0 to 11: a.npz has 12 scans"),
        (
            ("localize", "--scans-index", "12:"),
            "got 12:, expected A:B with A below B and A at most 11: a",
        ),
        (
            ("localize", "--scans-index", "5:2"),
            "got 5:2, expected A:B with A below B and A at most 11: a",
        ),
        (("which", "--maps-index", "3"), "3: expected a name that ends in .npz"),
        (("evaluate", "--scans-index", "3"), "--scans-index: is for evaluate --scans, not"),
    ],
)
def test_what_is_no_choice_of_scans_is_said(words, expected, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    twelve(tmp_path)
    named = {"which": (MAPS, "a.npz"), "evaluate": ("curved",)}
    where = named.get(words[0], ("m.yaml", "a.npz"))
    call(words[0], *where, *words[1:]).ends(2, expected, out="")
