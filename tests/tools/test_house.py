"""The rooms of the house and the wall: what each may import, from the first to the last."""

import ast
from pathlib import Path

import pytest
from command import ROOT, parsed

from imgloc import doors
from tools import house

#: What comes through the doors in the wall by name, beside commands: filters, hints, a survey.
DOORS = ["aging_hint", "survey_part", "GridFilter", "ParticleFilter", "ParticleOptions"]


def files() -> list[house.File]:
    return house.counted("imgloc")  # counted once, where a test asks


def test_each_file_is_in_a_room_that_has_a_name() -> None:
    names = {file.room for file in files()}
    assert names - {"__init__", "__main__"} == {*house.ROOMS, *house.BEHIND}


def test_nothing_is_imported_from_a_later_room_or_from_another_one_behind_the_wall() -> None:
    assert house.arrows_up(files()) == []


@pytest.mark.parametrize(
    ("path", "text", "arrows"),
    [
        ("imgloc/search/a.py", "def f():\n    from imgloc import pipeline", ["imgloc.pipeline"]),
        (
            "imgloc/lab/a.py",
            "import imgloc.plans.files\nimport imgloc.cli.app",
            ["imgloc.plans.files"],
        ),
        ("imgloc/search/b.py", "from imgloc.io import maps\nfrom imgloc.search import a", []),
        ("imgloc/io/a.py", "if TYPE_CHECKING:\n    from imgloc.search.a import f", []),
    ],
)
def test_arrows_that_go_back_are_seen(tmp_path: Path, path: str, text: str, arrows) -> None:
    (tmp_path / path).parent.mkdir(parents=True)
    (tmp_path / path).write_text(text)
    found = house.arrows_up(house.counted("imgloc", tmp_path))
    assert found == [f"{path} -> {name}" for name in arrows]


def test_lines_are_counted(tmp_path: Path) -> None:
    text = (
        '"""What."""\nimport os\n\n\ndef f(x):\n    """Why."""\n    # how\n'
        "    return [x, 3, 1][\n        True]\n"
    )
    (tmp_path / "imgloc").mkdir()
    (tmp_path / "imgloc" / "a.py").write_text(text)
    (file,) = house.counted("imgloc", tmp_path)
    assert (file.room, file.lines, file.code, file.numbers) == ("a", 9, 4, 1)
    assert file.functions == (("f", 2),)
    assert file.docs == ("What.", "Why.")


def test_a_count_above_its_limit_is_red(capsys, monkeypatch) -> None:
    some = files()
    monkeypatch.setattr(house, "counted", lambda name: some if name == "imgloc" else some[:1])
    monkeypatch.setitem(house.LIMITS, "numbers", (3, 1))
    assert house.main(["--without", "io"]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert [line for line in lines if line.endswith(" 3 | 1 | above |")]
    assert not [line for line in lines if line.startswith("| io |")]


def test_the_wall_has_no_hole_but_the_doors() -> None:
    """Neither types nor names in strings, which importlib may take, are from behind it."""
    rooms, holes = tuple(f"imgloc.{name}" for name in house.BEHIND), []
    for file in files():
        if file.room in (*house.BEHIND, "doors", "__init__"):
            continue
        for node in ast.walk(parsed(ROOT / file.path)):
            modules = [node.value] if isinstance(node, ast.Constant) else []
            if isinstance(node, ast.ImportFrom):
                modules = [f"{node.module}.{alias.name}" for alias in node.names]
            if any(isinstance(text, str) and text.startswith(rooms) for text in modules):
                holes.append((str(file.path), ast.unparse(node)))
    assert holes == []


@pytest.mark.parametrize("name", DOORS)
def test_every_door_opens(name: str) -> None:
    assert doors.behind(name).__module__.startswith(("imgloc.plans.", "imgloc.lab."))


def test_there_are_no_other_doors_and_each_is_used() -> None:
    assert sorted(doors._HOME_OF) == sorted(DOORS)
    words = {node.value for file in files() if file.room not in (*house.BEHIND, "doors")
             for node in ast.walk(parsed(ROOT / file.path))
             if isinstance(node, ast.Constant) and isinstance(node.value, str)}  # fmt: skip
    assert words >= set(DOORS)


def test_the_way_from_scan_to_answer_fits_a_screen() -> None:
    lines = (ROOT / "imgloc/pipeline.py").read_text("utf-8").splitlines()
    steps = {f.name: f for f in parsed(ROOT / "imgloc/pipeline.py").body
             if isinstance(f, ast.FunctionDef)}  # fmt: skip
    code = 0
    for name in ("localize", "find_modes_by_steps", "find_adapted_modes"):
        (docs, *body), last = steps[name].body, steps[name].end_lineno
        assert isinstance(docs, ast.Expr)
        code += sum(bool(line.strip()) for line in lines[body[0].lineno - 1 : last])
    assert code <= 80
    assert len(lines) <= 350


@pytest.mark.parametrize("name", doors.JOBS)
def test_every_job_is_where_its_name_says(name: str) -> None:
    assert doors.opened(doors.JOBS[name]).name == name
