"""How large is the house? Lines, code, imports, arrows and numbers, beside what they may be.

    python -m tools.house               # a line a room, the sums and the goals
    python -m tools.house --without live --longest 20   # without a room; more of the functions

A line of code is no comment and no docstring; imports count. Exits with 1 where a goal is missed.
"""

import ast
import statistics
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from tools.script import parser_of, table_lines

ROOT = Path(__file__).resolve().parents[1]
ROOMS = (
    "__about__", "doors", "equality", "errors", "numbers", "ranges", "pose", "model", "geometry",
    "texts", "options", "robot", "io", "features", "likelihoods", "search", "pipeline", "answers",
    "choice", "filters", "simulation", "runs", "output", "live", "cli",
)  # fmt: skip
BEHIND = ("plans", "lab")
"""A module imports from its own room and from those before it; nothing from behind the wall."""
_PLACE = {name: k for k, name in enumerate((*ROOMS, *BEHIND))}
_PLAIN = (0, 1, 2)  # numbers that need no name: an empty sum, a step, a half


@dataclass(frozen=True)
class File:
    """What is counted of one file."""

    path: Path  #: from the root of the checkout
    lines: int
    code: int
    imports: tuple[str, ...]  #: modules of imgloc, wherever in the file they are imported
    functions: tuple[tuple[str, int], ...]  #: names, and lines of code
    numbers: int  #: numeric literals other than 0, 1 and 2

    @property
    def room(self) -> str:
        """The room that it is in."""
        return Path(self.path.parts[1]).stem


def code_lines(text: str, tree: ast.AST | None = None) -> set[int]:
    """Numbers of the lines that are code; `tree` is what the text is parsed to, if it is."""
    lines = enumerate((line.strip() for line in text.splitlines()), 1)
    code = {number for number, line in lines if line and not line.startswith("#")}
    texts, docs = set[int](), set[int]()  # of a text blank lines count, too
    for node in ast.walk(tree or ast.parse(text)):
        if isinstance(node, ast.Constant | ast.JoinedStr):
            texts.update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
        elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            docs.update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    return (code | texts) - docs


def imported(tree: ast.AST) -> Iterator[str]:
    """Modules of imgloc that a file imports when it runs, wherever in it."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.expr):  # most nodes, none of which imports
            continue
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            continue
        if isinstance(node, ast.ImportFrom) and node.module == "imgloc":
            yield from (f"imgloc.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and (node.module or "").startswith("imgloc."):
            yield str(node.module)
        elif isinstance(node, ast.Import):
            yield from (a.name for a in node.names if a.name.startswith("imgloc."))
        yield from imported(node)


def count(path: Path, root: Path = ROOT) -> File:
    """Count one file."""
    text = path.read_text("utf-8")
    tree = ast.parse(text)
    code, nodes = code_lines(text, tree), list(ast.walk(tree))
    functions = [n for n in nodes if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef)]
    values = [n.value for n in nodes if isinstance(n, ast.Constant)]
    return File(
        path.relative_to(root),
        len(text.splitlines()),
        len(code),
        tuple(dict.fromkeys(imported(tree))),
        tuple((f.name, len(code & {*range(f.lineno, 1 + (f.end_lineno or 0))})) for f in functions),
        sum(type(v) in (int, float) and v not in _PLAIN for v in values),
    )


@cache
def counted(folder: str, root: Path = ROOT) -> list[File]:
    """Count every Python file of a folder, stubs too."""
    paths = (root / folder).rglob("*.py*")
    return [count(path, root) for path in sorted(paths) if path.suffix in (".py", ".pyi")]


def arrows_up(files: Iterable[File]) -> list[str]:
    """Imports of a room that comes later, or of the other one behind the wall."""
    out = []
    for file in files:
        for name in file.imports if file.room in _PLACE else ():
            other = name.split(".")[1]
            beside = other in BEHIND and other != file.room
            if beside or _PLACE.get(other, 0) > _PLACE[file.room]:
                out.append(f"{file.path} -> {name}")
    return out


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse the command line, count, print; 1 if a goal is missed."""
    parser = parser_of("tools.house", __doc__)
    parser.add_argument("--longest", type=int, default=5, help="functions (default: %(default)s)")
    parser.add_argument("--without", nargs="+", default=[], metavar="ROOM", help="left out")
    given = parser.parse_args(arguments)
    files, tools = counted("imgloc"), counted("tools")
    files = [f for f in files if f.room not in given.without]
    order = sorted({f.room for f in files}, key=lambda room: (_PLACE.get(room, -1), room))
    groups = {room: [f for f in files if f.room == room] for room in order}
    groups["before the wall"] = [f for f in files if f.room not in BEHIND]
    groups |= {"imgloc": files, "tools": tools}
    sums = {
        name: (sum(f.lines for f in some), sum(f.code for f in some), sum(f.numbers for f in some))
        for name, some in groups.items()
    }
    head = "room | files | lines | code | numbers"
    for line in table_lines(head, ((k, len(groups[k]), *v) for k, v in sums.items())):
        print(line)
    long = sorted(((n, f.path, name) for f in files for name, n in f.functions), reverse=True)
    for n, path, name in long[: given.longest]:
        print(f"{n} lines of code: {name} in {path}")
    for arrow in (up := arrows_up(files)):
        print("back up:", arrow)
    goals = (
        ("lines of imgloc", sums["imgloc"][0], 20_500),
        ("code of imgloc", sums["imgloc"][1], 13_500),
        ("code before the wall", sums["before the wall"][1], 10_500),
        ("lines of tools", sums["tools"][0], 5_500),
        ("modules of imgloc that a file imports, median",
         round(statistics.median(len(f.imports) for f in files)), 6),
        ("arrows back up", len(up), 0),
    )  # fmt: skip
    cells = ((what, is_, most, "yes" if is_ <= most else "no") for what, is_, most in goals)
    for line in table_lines("what | is | at most | met", cells):
        print(line)
    return int(any(is_ > most for _, is_, most in goals))


if __name__ == "__main__":
    sys.exit(main())
