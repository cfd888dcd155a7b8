"""How large is the house? Code, imports, options, numbers and words, beside what they may be.

    python -m tools.house               # a line a room, the sums and the goals
    python -m tools.house --without live --longest 20   # without a room; more of the functions

A line of code is no comment and no docstring; imports count. Each count has a limit, which only
falls, and a goal. Exits with 1 where a count is above its limit.
"""

import ast
import re
import statistics
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from typer.main import get_command

from imgloc.cli.app import program
from imgloc.numbers import NUMBERS
from tools.script import parser_of, show, table_lines

ROOT = Path(__file__).resolve().parents[1]
ROOMS = (
    "__about__", "doors", "equality", "errors", "threads", "pose", "texts", "ranges", "numbers",
    "model", "geometry", "options", "robot", "io", "features", "likelihoods", "search", "pipeline",
    "answers", "choice", "filters", "simulation", "runs", "output", "live", "cli",
)  # fmt: skip
BEHIND = ("plans", "lab")
"""A module imports from its own room and from those before it; nothing from behind the wall."""
_PLACE = {name: k for k, name in enumerate((*ROOMS, *BEHIND))}
_PLAIN = (0, 1, 2)  # numbers that need no name: an empty sum, a step, a half
LONG = 60  # lines of code of a function, without what its signature declares
LIMITS: Mapping[str, tuple[int, int]] = {
    "code of imgloc": (30_668, 20_000),
    "code of lab and plans": (4_784, 3_700),
    "code of tools": (8_984, 8_000),
    "code of tests": (27_569, 26_000),
    f"functions of more than {LONG} lines": (0, 0),
    "modules of imgloc that a file imports, median": (5, 6),
    "arrows back up": (0, 0),
    "options of all commands": (195, 250),
    "numbers": (230, 150),
    "numbers that nobody measured": (30, 40),
    "docstrings that begin with What, Whether, How, Of": (0, 0),
    "docstrings in which things say or tell": (0, 0),
    "chains of three of": (0, 0),
}
"""What is counted: the limit, which is red above and only falls, and the goal."""
_BEGINS = re.compile(r"(What|Whether|How|Of)\b")
_SAYS = re.compile(r"\b(say|says|tell|tells)\b")
_CHAIN = re.compile(r"\bof\b([\w\s-]{1,30}\bof\b){2}")


@dataclass(frozen=True)
class File:
    """What is counted of one file."""

    path: Path  #: from the root of the checkout
    lines: int
    code: int
    imports: tuple[str, ...]  #: modules of imgloc, wherever in the file they are imported
    #: names, and lines of code; the signature, where commands declare options, is not counted
    functions: tuple[tuple[str, int], ...]
    numbers: int  #: numeric literals other than 0, 1 and 2
    docs: tuple[str, ...]  #: docstrings

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


_WITH_DOCS = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef


def _body(function: ast.FunctionDef | ast.AsyncFunctionDef) -> set[int]:
    return {*range(function.body[0].lineno, 1 + (function.end_lineno or 0))}


def options_declared() -> int:
    """How many options all commands have together, each counted where it is declared anew."""
    waiting, number = [get_command(program())], 0
    while waiting:
        command = waiting.pop()
        waiting += getattr(command, "commands", {}).values()
        number += sum(param.param_type_name == "option" for param in command.params)
    return number


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
        tuple((f.name, len(code & _body(f))) for f in functions),
        sum(type(v) in (int, float) and v not in _PLAIN for v in values),
        tuple(filter(None, (ast.get_docstring(n) for n in nodes if isinstance(n, _WITH_DOCS)))),
    )


@cache
def counted(folder: str, root: Path = ROOT) -> list[File]:
    """Count every Python file of a folder, stubs too, but no copy that Sphinx has made."""
    paths = sorted(p for p in (root / folder).rglob("*.py*") if p.suffix in (".py", ".pyi"))
    return [count(p, root) for p in paths if root / "tools/docs/gallery" not in p.parents]


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
    """Parse the command line, count, print; 1 if a count is above its limit."""
    parser = parser_of("tools.house", __doc__)
    parser.add_argument("--longest", type=int, default=5, help="functions (default: %(default)s)")
    parser.add_argument("--without", nargs="+", default=[], metavar="ROOM", help="left out")
    given = parser.parse_args(arguments)
    files = [f for f in counted("imgloc") if f.room not in given.without]
    order = sorted({f.room for f in files}, key=lambda room: (_PLACE.get(room, -1), room))
    groups = {room: [f for f in files if f.room == room] for room in order}
    groups["before the wall"] = [f for f in files if f.room not in BEHIND]
    groups |= {"imgloc": files, "tools": counted("tools"), "tests": counted("tests")}
    sums = {
        name: (sum(f.lines for f in some), sum(f.code for f in some), sum(f.numbers for f in some))
        for name, some in groups.items()
    }
    head = "room | files | lines | code | numbers"
    show(table_lines(head, ((k, len(groups[k]), *v) for k, v in sums.items())))
    long = sorted(((n, f.path, name) for f in files for name, n in f.functions), reverse=True)
    for n, path, name in long[: given.longest]:
        print(f"{n} lines of code: {name} in {path}")
    for arrow in (up := arrows_up(files)):
        print("back up:", arrow)
    docs = [text for file in files for text in file.docs]
    counts = (
        sums["imgloc"][1],
        sum(sums[room][1] for room in BEHIND if room in sums),
        sums["tools"][1],
        sums["tests"][1],
        sum(n > LONG for n, _, _ in long),
        round(statistics.median(len(f.imports) for f in files)),
        len(up),
        options_declared(),
        len(NUMBERS),
        sum("not measured" in one.costs for one in NUMBERS.values()),
        sum(bool(_BEGINS.match(text)) for text in docs),
        sum(bool(_SAYS.search(text)) for text in docs),
        sum(len(_CHAIN.findall(text)) for text in docs),
    )
    rows = [(what, n, *LIMITS[what]) for what, n in zip(LIMITS, counts, strict=True)]
    cells = (
        (*row, "above" if row[1] > row[2] else "goal" if row[1] > row[3] else "met") for row in rows
    )
    show(table_lines("what | is | limit | goal | so", cells))
    return int(any(is_ > limit for _, is_, limit, _ in rows))


if __name__ == "__main__":
    sys.exit(main())
