"""Would a test notice? Random small errors put into the code, one at a time, each tested.

    python -m tools.mutants --seed 0 -n 60       # of the rooms that an answer comes from
    python -m tools.mutants --seed 0 -n 20 --paths imgloc/features/raycast.py

A mutant changes one operator, sign, wrap, constant, `True`, `min` or the like. In a copy of the
checkout its own tests run first, then its room's, then all others and every example, the slow
commands last; the first test that fails kills it, or a test that takes too long. A test that kills
for the first time has to pass without the mutant. Prints a Markdown table; exits with 1 if one
survived. The same seed makes the same mutants of the same code, and the tests draw the same
examples; what one run has killed the next one skips.
"""

import argparse
import ast
import contextlib
import hashlib
import json
import multiprocessing
import os
import random
import re
import shutil
import signal
import sys
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import accumulate, islice, pairwise
from multiprocessing import connection
from pathlib import Path
from queue import SimpleQueue
from threading import Lock
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
ROOMS = "io features likelihoods search pipeline.py choice filters runs"
PATHS = tuple(f"imgloc/{room}" for room in ROOMS.split())
SLOW = r"tools/|test_(cli|lab_atlas|runs)"
ENDLESS = " did not end"
PATIENCE = 60.0  # seconds of a processor for one test, the slowest of which takes a tenth of that
WAITS = 5  # times as long by the clock: a test may wait for ever, and take nothing
SERVER = multiprocessing.get_context("forkserver")  # what every run needs is loaded once
STARTING = Lock()  # start() asks every process for its exit code, which can be read only once
SERVER.set_forkserver_preload(
    ["pytest", "hypothesis.strategies", "cv2", "skimage.measure", "rich", "typer"]
)
SYMBOLS: dict[type[ast.AST], tuple[str, tuple[str, ...]]] = {
    ast.Add: ("+", ("-",)), ast.Sub: ("-", ("+",)), ast.Mult: ("*", ("/", "+")),
    ast.Div: ("/", ("*",)), ast.FloorDiv: ("//", ("*", "/")), ast.Pow: ("**", ("*",)),
    ast.Mod: ("%", ("",)),  # a wrap that is left out
    ast.Lt: ("<", ("<=", ">")), ast.LtE: ("<=", ("<", ">=")), ast.Gt: (">", (">=", "<")),
    ast.GtE: (">=", (">", "<=")), ast.Eq: ("==", ("!=",)), ast.NotEq: ("!=", ("==",)),
    ast.And: ("and", ("or",)), ast.Or: ("or", ("and",)), ast.BitAnd: ("&", ("|",)),
    ast.BitOr: ("|", ("&",)), ast.Is: ("is", ("is not",)), ast.IsNot: ("is not", ("is",)),
}  # fmt: skip
SWAPS = "min max", "minimum maximum", "argmin argmax", "floor ceil", "sin cos", "any all"
NAMES = dict(pair for a, b in map(str.split, SWAPS) for pair in ((a, b), (b, a)))


class Mutant(NamedTuple):
    """One change: the bytes from `start` to `end` of a file become `text`."""

    path: str
    line: int
    start: int
    end: int
    text: str
    change: str


def mutants_of(path: str, source: bytes) -> list[Mutant]:
    """Every mutant of a file; messages, annotations and documentation are left alone.

    >>> [m.change for m in mutants_of("a.py", b"def f(n: int): return (n + 1) % 8")]
    ['(n + 1) % 8 -> (n + 1) ', 'n + 1 -> n - 1', '1 -> 2', '8 -> 9', '8 -> 16']
    """
    starts = [0, *accumulate(map(len, source.splitlines(keepends=True)))]
    out: list[Mutant] = []

    def span(node: ast.expr) -> tuple[int, int]:
        last = starts[(node.end_lineno or 1) - 1] + (node.end_col_offset or 0)
        return starts[node.lineno - 1] + node.col_offset, last

    def add(node: ast.expr, start: int, end: int, text: str) -> None:
        first, last = max(span(node)[0], start - 30), min(span(node)[1], end + 30)
        new = source[first:start] + text.encode() + source[end:last]
        parts = (part.decode(errors="ignore") for part in (source[first:last], new))
        said = (re.sub(r"\s+", " ", part) for part in parts)
        out.append(Mutant(path, node.lineno, start, end, text, " -> ".join(said)))

    for node in _changeable(ast.parse(source)):
        start, end = span(node)
        sides, ops = list[ast.expr](), list[ast.AST]()  # operands, what stands between them
        match node:
            case ast.BinOp():
                sides, ops = [node.left, node.right], [node.op]
            case ast.BoolOp():
                sides, ops = node.values, [node.op] * (len(node.values) - 1)
            case ast.Compare():
                sides, ops = [node.left, *node.comparators], [*node.ops]
            case ast.UnaryOp():  # a sign, a `not`, a `~`
                add(node, start, span(node.operand)[0], "")
            case ast.Constant(value=bool() | int() | float() as value):
                more = value + 1, value * 2 or 1
                for other in [not value] if isinstance(value, bool) else dict.fromkeys(more):
                    add(node, start, end, repr(other))
            case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name)) if name in NAMES:
                at = span(node.func)[1]
                add(node, at - len(name), at, NAMES[name])
        for (left, right), op in zip(pairwise(sides), ops, strict=True):
            old, others = SYMBOLS.get(type(op), ("", ()))
            between = source[span(left)[1] : span(right)[0]]
            between = re.sub(rb"#[^\n]*", lambda comment: b" " * len(comment[0]), between)
            at = span(left)[1] + between.find(old.encode())
            for new in others:
                add(node, at, at + len(old) if new else end, new)
    return out


def _changeable(tree: ast.AST) -> Iterator[ast.expr]:
    """Expressions that decide a result, in the order of the source."""
    for name, value in ast.iter_fields(tree):
        if name in ("annotation", "returns", "decorator_list"):
            continue
        for node in value if isinstance(value, list) else [value]:
            if isinstance(node, ast.AST) and not isinstance(node, ast.Raise | ast.JoinedStr):
                yield from [node] if isinstance(node, ast.expr) else []
                yield from _changeable(node)


def mutated(source: bytes, mutant: Mutant) -> bytes:
    """The source with the change made."""
    return source[: mutant.start] + mutant.text.encode() + source[mutant.end :]


def compiles(source: bytes, mutant: Mutant) -> bool:
    """Whether the change leaves a program."""
    with contextlib.suppress(SyntaxError):
        return bool(compile(mutated(source, mutant), mutant.path, "exec", dont_inherit=True))
    return False


def stages(path: str, tests: Sequence[str]) -> list[list[str]]:
    """What to run for a mutant of a file: its own tests, its room's, the others, the slow ones.

    >>> tests = ["test_search_peaks.py", "test_search_refine.py", "test_model.py", "test_cli.py"]
    >>> for some in stages("imgloc/search/refine.py", tests): print(*some)
    tests/test_search_refine.py imgloc/search/refine.py
    tests/test_search_peaks.py imgloc/search
    tests/test_model.py imgloc
    tests/test_cli.py tools
    """
    room, *names = Path(path).with_suffix("").parts[1:]
    order: list[list[str]] = [[], [], [], []]
    for test in tests:
        name = Path(test).name
        mine = name.startswith("_".join(("test", room, *names)))
        order[0 if mine else 1 if name.startswith(f"test_{room}") else 3 if re.search(SLOW, test)
              else 2].append(f"tests/{test}")  # fmt: skip
    examples = path, "imgloc/" + room * bool(names), "imgloc", "tools"
    return [[*some, example.strip("/")] for some, example in zip(order, examples, strict=True)]


def killer(folder: Path, some: Sequence[str]) -> str:
    """The test that fails, "" if none does; what takes longer than `PATIENCE` has failed."""
    with tempfile.NamedTemporaryFile("r", encoding="utf-8", errors="replace") as out:
        run = SERVER.Process(target=_tested, args=(folder, some, out.name, PATIENCE))
        with STARTING:
            run.start()
        connection.wait([run.sentinel])
        with STARTING:
            run.join()
        with contextlib.suppress(ProcessLookupError):  # processes that a test has left
            os.killpg(run.pid or 0, signal.SIGKILL)
        said = out.read()
    if run.exitcode in (0, 5):  # 5: there is no test in these files
        return ""
    failed = re.search(r"^(?:FAILED|ERROR) (.+?)(?: - .*)?$", said, re.MULTILINE)
    began = re.findall(r"^\S+::\S+", said, re.MULTILINE)
    if failed is None and not began:
        raise RuntimeError(f"pytest did not come to the tests: {said[-500:]}")
    return failed[1] if failed else f"{began[-1]}{ENDLESS}"


class _Patience:
    """Ends the process with a test that takes too long, by its own time, whatever else runs.

    A test that waits for what never comes ends by the clock.
    """

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds

    def pytest_runtest_logstart(self) -> None:
        """Count from here."""
        signal.setitimer(signal.ITIMER_PROF, self.seconds)
        signal.setitimer(signal.ITIMER_REAL, WAITS * self.seconds)


def _tested(folder: Path, some: Sequence[str], out: str, patience: float) -> None:
    """Run pytest in this process, forked from one that has loaded all libraries, not imgloc."""
    os.setsid()
    with Path(out).open("wb") as file:
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
    os.chdir(folder)
    os.environ |= {"PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}
    sys.dont_write_bytecode = True
    sys.path[:] = [str(folder), *(p for p in sys.path if p not in ("", str(ROOT)))]
    for name in [n for n in sys.modules if n.partition(".")[0] in ("imgloc", "tools")]:
        del sys.modules[name]
    import pytest

    code = pytest.main(
        ["-xv", "-n0", "-p", "no:cacheprovider", "--hypothesis-seed=0", f"--rootdir={folder}",
         "-W", "ignore::pytest.PytestAssertRewriteWarning",  # of what is loaded already
         "--deselect=tests/tools/test_mutants.py", *some],
        plugins=[_Patience(patience)],
    )  # fmt: skip
    sys.stdout.flush()
    os._exit(int(code))


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse the command line, make mutants, test them, print the table."""
    parser = argparse.ArgumentParser("tools.mutants", description="Would a test notice?")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("-n", type=int, default=60, help="mutants (default: 60)")
    parser.add_argument("--paths", nargs="+", default=PATHS, help="files or folders of imgloc")
    parser.add_argument("--near", action="store_true", help="only tests of the file and its room")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    given = parser.parse_args(arguments)
    files = {f.relative_to(ROOT).as_posix(): f for f in sorted((ROOT / "imgloc").rglob("*.py"))}
    sources = {p: f.read_bytes() for p, f in files.items() if p.startswith(tuple(given.paths))}
    every = [m for path, source in sources.items() for m in mutants_of(path, source)]
    random.Random(given.seed).shuffle(every)  # noqa: S311
    chosen = list(islice((m for m in every if compiles(sources[m.path], m)), given.n))
    digest = hashlib.sha256(repr(chosen).encode() + b"".join(sources.values())).hexdigest()
    journal = Path(tempfile.gettempdir()) / f"imgloc-mutants-{digest[:16]}.jsonl"
    told = journal.read_text("utf-8").splitlines() if journal.exists() else []
    done: dict[int, str] = {k: by for k, by in map(json.loads, told) if by}  # survivors: again
    folder = ROOT / "tests"
    tests = sorted(p.relative_to(folder).as_posix() for p in folder.rglob("test_*.py"))
    print(f"{len(chosen)} of {len(every)} mutants, kept in {journal}", file=sys.stderr)
    with tempfile.TemporaryDirectory() as temporary, journal.open("a", encoding="utf-8") as log:
        free: SimpleQueue[Path] = SimpleQueue()
        for name in map(str, range(given.workers)):
            copy = Path(temporary, name, "checkout")
            shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(".*", "__pycache__"))
            if (ROOT.parent / "shared").is_dir():  # real data, beside the checkout
                (copy.parent / "shared").symlink_to(ROOT.parent / "shared")
            free.put(copy)
        sound = {""}  # tests that pass without a mutant

        def test(k: int) -> None:
            mutant, folder = chosen[k], free.get()
            file, source = folder / mutant.path, sources[mutant.path]
            file.write_bytes(mutated(source, mutant))
            order = stages(mutant.path, tests)[: 2 if given.near else None]
            by = next(filter(None, (killer(folder, some) for some in order)), "")
            file.write_bytes(source)
            unsound = by not in sound and killer(folder, [by.removesuffix(ENDLESS)])
            free.put(folder)
            if unsound:
                raise RuntimeError(f"{by} fails without a mutant")
            sound.add(by)
            done[k] = by
            print(json.dumps([k, by]), file=log, flush=True)

        with ThreadPoolExecutor(given.workers) as pool:
            list(pool.map(test, [k for k in range(len(chosen)) if k not in done]))
    print("| where | change | killed by |\n|---|---|---|")
    for k, m in enumerate(chosen):
        print(f"| {m.path}:{m.line} | `{m.change}` | {done[k] or '**SURVIVED**'} |")
    print(f"\n{sum(map(bool, done.values()))} of {len(chosen)} killed")
    return 0 if all(done.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
