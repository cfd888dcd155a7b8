"""Would a test notice? Random small errors put into the code, one at a time, each tested.

    python -m tools.mutants --seed 0 -n 60       # of features, likelihood, search, the pipeline
    python -m tools.mutants --seed 0 -n 20 --paths imgloc/features/raycast.py

A mutant changes one operator, sign, wrap, constant, `True`, `min` or the like. In a copy of the
checkout its own tests run first, then its room's, then all but the slow commands; the first test
that fails kills it, or taking too long. Prints a Markdown table; exits with 1 if one survived. The
same seed makes the same mutants of the same code; what one run has killed the next one skips.
"""

import argparse
import ast
import contextlib
import hashlib
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import accumulate, pairwise
from pathlib import Path
from queue import SimpleQueue
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
PATHS = ("imgloc/features", "imgloc/likelihood", "imgloc/search", "imgloc/pipeline.py")
# Tests of commands and measurements: what they would notice, others do.
SLOW = r"test_(cli|paper_(?!claims)|bench|trust|atlas|mutants)"
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
        mutant = Mutant(path, node.lineno, start, end, text, " -> ".join(said))
        with contextlib.suppress(SyntaxError):
            compile(mutated(source, mutant), path, "exec", dont_inherit=True)
            out.append(mutant)

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


def stages(path: str, tests: Sequence[str]) -> list[list[str]]:
    """What to run for a mutant of a file: its own tests, its room's, the rest.

    >>> stages("imgloc/search/refine.py", ["test_search_peaks.py", "test_model.py", "test_cli.py"])
    [['imgloc/search/refine.py'], ['tests/test_search_peaks.py'], ['tests/test_model.py']]
    """
    names = Path(path).with_suffix("").parts[1:]
    mine = [t for t in tests if t.startswith(f"test_{'_'.join(names)}")]
    room = [t for t in tests if t.startswith(f"test_{names[0]}") and t not in mine]
    rest = [t for t in tests if t not in mine + room and not re.match(SLOW, t)]
    own, *others = ([f"tests/{t}" for t in some] for some in (mine, room, rest))
    return [own + [path], *(some for some in others if some)]


def killer(folder: Path, some: Sequence[str], timeout: float) -> str:
    """The test that fails, "" if none does; what takes longer than `timeout` seconds has failed."""
    command = [sys.executable, "-m", "pytest", "-xq", "-n0", "-p", "no:cacheprovider", *some]
    with subprocess.Popen(  # noqa: S603
        command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        env=os.environ | {"PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"},
        start_new_session=True,
    ) as run:  # fmt: skip
        try:
            said, _ = run.communicate(timeout=timeout)
        except subprocess.TimeoutExpired:
            os.killpg(run.pid, signal.SIGKILL)
            return f"more than {timeout:g} s"
    if run.returncode in (0, 5):  # 5: there is no test in these files
        return ""
    failed = re.search(r"^(?:FAILED|ERROR) (\S+)", said, re.MULTILINE)
    if failed is None and run.returncode == 4:
        raise RuntimeError(f"pytest was called wrongly: {said[-500:]}")
    return failed[1] if failed else f"pytest ended with {run.returncode}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse the command line, make mutants, test them, print the table."""
    parser = argparse.ArgumentParser("tools.mutants", description="Would a test notice?")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("-n", type=int, default=60, help="mutants (default: 60)")
    parser.add_argument("--paths", nargs="+", default=PATHS, help="files or folders of imgloc")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--timeout", type=float, default=300.0, help="seconds; 4, 9 times later on")
    given = parser.parse_args(arguments)
    files = {f.relative_to(ROOT).as_posix(): f for f in sorted((ROOT / "imgloc").rglob("*.py"))}
    sources = {p: f.read_bytes() for p, f in files.items() if p.startswith(tuple(given.paths))}
    every = [m for path, source in sources.items() for m in mutants_of(path, source)]
    chosen = random.Random(given.seed).sample(every, min(given.n, len(every)))  # noqa: S311
    digest = hashlib.sha256(repr(chosen).encode() + b"".join(sources.values())).hexdigest()
    journal = Path(tempfile.gettempdir()) / f"imgloc-mutants-{digest[:16]}.jsonl"
    told = journal.read_text("utf-8").splitlines() if journal.exists() else []
    done: dict[int, str] = {k: by for k, by in map(json.loads, told) if by}  # survivors: again
    tests = sorted(p.name for p in (ROOT / "tests").glob("test_*.py"))
    print(f"{len(chosen)} of {len(every)} mutants, kept in {journal}", file=sys.stderr)
    with tempfile.TemporaryDirectory() as temporary, journal.open("a", encoding="utf-8") as log:
        free: SimpleQueue[Path] = SimpleQueue()
        for name in map(str, range(given.workers)):
            copy = Path(temporary, name, "checkout")
            shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(".*", "__pycache__"))
            if (ROOT.parent / "shared").is_dir():  # real data, beside the checkout
                (copy.parent / "shared").symlink_to(ROOT.parent / "shared")
            free.put(copy)
        quick = [f"tests/{t}" for t in tests if not re.match(SLOW, t)]
        if not done and (broken := killer(copy, quick, 10 * given.timeout)):
            parser.exit(2, f"mutants: error: {broken} fails without a mutant\n")

        def test(k: int) -> None:
            mutant, folder = chosen[k], free.get()
            file, source = folder / mutant.path, sources[mutant.path]
            try:
                file.write_bytes(mutated(source, mutant))
                runs = enumerate(stages(mutant.path, tests), 1)
                told = (killer(folder, some, given.timeout * i**2) for i, some in runs)
                done[k] = next(filter(None, told), "")
                print(json.dumps([k, done[k]]), file=log, flush=True)
            finally:
                file.write_bytes(source)
                free.put(folder)

        with ThreadPoolExecutor(given.workers) as pool:
            list(pool.map(test, [k for k in range(len(chosen)) if k not in done]))
    print("| where | change | killed by |\n|---|---|---|")
    for k, m in enumerate(chosen):
        print(f"| {m.path}:{m.line} | `{m.change}` | {done[k] or '**SURVIVED**'} |")
    print(f"\n{sum(map(bool, done.values()))} of {len(chosen)} killed")
    return 0 if all(done.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
