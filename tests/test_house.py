"""The rooms of the house: what each may import, from the first to the last."""

import ast
from pathlib import Path

from command import ROOT

#: A module imports from its own room and from those before it.
ROOMS = (
    "__about__ doors errors ranges", "model", "geometry", "options", "io", "features",
    "likelihoods", "search", "pipeline",
    "answers", "choice", "filters", "simulation",
    "runs", "output", "cli", "plans", "lab",
)  # fmt: skip
PLACE = {name: k for k, room in enumerate(ROOMS) for name in room.split()}
FILES = sorted(p.relative_to(ROOT) for p in (ROOT / "imgloc").rglob("*.py"))


def imported(path: Path) -> set[str]:
    """Rooms and modules of imgloc that a file imports when it runs, wherever in it."""
    tree = ast.parse((ROOT / path).read_text("utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            node.body = []
    found = [n for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)]
    names = [f"{n.module}.{a.name}" for n in found for a in n.names]
    names += [a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names]
    return {name.split(".")[1] for name in names if name.startswith("imgloc.")}


def test_nothing_is_imported_from_a_later_room() -> None:
    inside = {path: path.parts[1].removesuffix(".py") for path in FILES}
    assert set(PLACE) == set(inside.values()) - {"__init__", "__main__"}  # doors to all rooms
    arrows = [(p, other) for p, name in inside.items() if name in PLACE for other in imported(p)
              if PLACE[other] > PLACE[name]]  # fmt: skip
    assert arrows == []
