"""The rooms of the house and the wall: what each may import, from the first to the last."""

import ast
from pathlib import Path

import pytest
from command import ROOT

from imgloc import doors

#: A module imports from its own room and from those before it.
ROOMS = (
    "__about__", "doors", "errors", "numbers", "ranges", "model", "geometry", "options", "io",
    "features", "likelihoods", "search", "pipeline", "answers", "choice", "filters", "simulation",
    "runs", "output", "cli",
)  # fmt: skip
BEHIND = ("plans", "lab")  #: the wall: what is before it knows these by name alone
#: What comes through the doors in the wall: commands, jobs of a batch, filters, a picture.
DOORS = [
    "atlas",
    "calibrate",
    "evaluate",
    "plan",
    "evaluate_item",
    "survey_item",
    "GridFilter",
    "GridOptions",
    "ParticleFilter",
    "ParticleOptions",
    "draw_survey",
]
PLACE = {name: k for k, name in enumerate((*ROOMS, *BEHIND))}
FILES = sorted(p.relative_to(ROOT) for p in (ROOT / "imgloc").rglob("*.py"))
#: The room of each file; `imgloc` itself and `python -m imgloc` are doors to all of them.
INSIDE = {path: path.parts[1].removesuffix(".py") for path in FILES}


def parsed(path: Path) -> ast.Module:
    return ast.parse((ROOT / path).read_text("utf-8"))


def imported(path: Path) -> set[str]:
    """Rooms of imgloc that a file imports when it runs, wherever in it."""
    tree = parsed(path)
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            node.body = []
    found = [n for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)]
    names = [f"{n.module}.{a.name}" for n in found for a in n.names]
    names += [a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names]
    return {name.split(".")[1] for name in names if name.startswith("imgloc.")}


def test_each_file_is_in_a_room_that_has_a_name() -> None:
    assert set(INSIDE.values()) - {"__init__", "__main__"} == set(PLACE)


def test_nothing_is_imported_from_a_later_room() -> None:
    arrows = [(str(path), other) for path, name in INSIDE.items() if name in PLACE
              for other in imported(path) if PLACE[other] > PLACE[name]]  # fmt: skip
    assert arrows == []


def test_a_room_behind_the_wall_imports_no_other_one() -> None:
    arrows = [(str(path), other) for path, name in INSIDE.items() if name in BEHIND
              for other in imported(path) if other in BEHIND and other != name]  # fmt: skip
    assert arrows == []


def test_the_wall_has_no_hole_but_the_doors() -> None:
    """Neither types nor names in strings, which importlib may take, are from behind it."""
    rooms, holes = tuple(f"imgloc.{name}" for name in BEHIND), []
    for path, name in INSIDE.items():
        if name in (*BEHIND, "doors", "__init__"):
            continue
        for node in ast.walk(parsed(path)):
            modules = [node.value] if isinstance(node, ast.Constant) else []
            if isinstance(node, ast.ImportFrom):
                modules = [f"{node.module}.{alias.name}" for alias in node.names]
            if any(isinstance(text, str) and text.startswith(rooms) for text in modules):
                holes.append((str(path), ast.unparse(node)))
    assert holes == []


@pytest.mark.parametrize("name", DOORS)
def test_every_door_opens(name: str) -> None:
    assert doors.behind(name).__module__.startswith(("imgloc.plans.", "imgloc.lab."))


def test_there_are_no_other_doors_and_each_is_used() -> None:
    assert sorted(doors._HOME_OF) == sorted(DOORS)
    words = {node.value for path, name in INSIDE.items() if name not in (*BEHIND, "doors")
             for node in ast.walk(parsed(path))
             if isinstance(node, ast.Constant) and isinstance(node.value, str)}  # fmt: skip
    assert words >= set(DOORS)
