"""The recipe with one step off: the numbers and functions of a step reach the answers."""

import json
import sys
from pathlib import Path

from imgloc.numbers import NUMBERS, number
from tools import vary
from tools.ablate import BASE, STEPS, main


def test_a_number_is_another_one_where_a_tool_runs(tmp_path, monkeypatch, capsys):
    code = "import sys, imgloc.numbers as n; print(sys.argv[1:], n.number('align.slack'))"
    (tmp_path / "some_tool.py").write_text(code)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "argv", [])
    monkeypatch.setitem(NUMBERS, "align.slack", NUMBERS["align.slack"])  # it is put back
    vary.main(["align.slack", "7.5", "some_tool", "--some"])
    assert capsys.readouterr().out == "['--some'] 7.5\n"


def test_each_step_changes_numbers_that_are_there_or_a_function() -> None:
    for step in STEPS.values():
        assert step.instead or step.numbers
        assert all(value != number(name) for name, value in step.numbers.items())


def test_a_step_that_is_off_changes_answers_and_is_measured_once(tmp_path: Path) -> None:
    before, page = dict(NUMBERS), tmp_path / "ablation-2030-01-02.md"
    given = ["room", "levels", "--worlds", "curved", "-n", "1", "--pieces", f"{tmp_path}/pieces"]
    assert main([*given, "--out", str(page)]) == 0
    assert before == NUMBERS  # those of this process
    lines = page.read_text("utf-8").splitlines()
    assert lines[0].endswith(", 2030-01-02")
    rows = [line.split("|") for line in lines if line.startswith("| ")]
    asis, room, levels = (dict(zip(map(str.strip, rows[0]), row, strict=True)) for row in rows[1:])
    (none,) = (name for name in asis if name.endswith("no-match"))
    assert int(room[none]) < int(asis[none])  # an empty room fits, and nothing is held against it
    assert abs(int(levels[none]) - int(asis[none])) <= 1  # a quarter of the nodes is nearly enough
    pieces = {path.name for path in (tmp_path / "pieces").iterdir()}
    assert pieces == {"asked.json", "searches.pickle", "as_it_is.json", "room.json", "levels.json"}
    kept = tmp_path / "pieces" / "room.json"
    kept.write_text(
        json.dumps([row | {"verdict": "unique"} for row in json.loads(kept.read_text())])
    )
    assert main([*given, "--out", str(page), "--force"]) == 0
    row = next(line for line in page.read_text("utf-8").splitlines() if line.startswith("| room"))
    assert [c.strip() for c in row.split("|")].count("1") > 2
    assert BASE in page.read_text("utf-8")


def test_answers_to_other_scans_are_not_mixed_in(tmp_path: Path, capsys) -> None:
    (tmp_path / "asked.json").write_text("{}", "utf-8")
    assert main(["room", "--worlds", "curved", "-n", "1", "--pieces", str(tmp_path)]) == 2
    assert "holds answers to other scans" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["asked.json"]


def test_a_step_that_is_not_there_is_refused_by_name(capsys) -> None:
    assert main(["magic"]) == 2
    assert "expected one of squares" in capsys.readouterr().err
