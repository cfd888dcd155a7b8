"""Runs of the command line: in this process for speed, or as the user runs it."""

import contextlib
import io
import json
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from imgloc.cli import main

ROOT = Path(__file__).resolve().parents[1]
MAPS = ROOT / "maps"


class Run(NamedTuple):
    code: int
    out: str
    err: str


def call(*arguments: object) -> Run:
    """Run imgloc's main() here."""
    return run(main, *arguments)


def run(program: Callable[[list[str]], int | None], *arguments: object) -> Run:
    """Run a program's main() here, with its output caught."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = program([str(a) for a in arguments])
        except SystemExit as e:
            code = e.code
    assert isinstance(code, int | None)
    return Run(code or 0, out.getvalue(), err.getvalue())


def command(arguments: Sequence[object]) -> list[str]:
    """Return the real command, for subprocess."""
    # -P: the folder that a test runs in is not on the path, as with the installed script.
    start = f"import sys; sys.path.insert(0, {str(ROOT)!r}); from imgloc.cli import main; main()"
    return [sys.executable, "-P", "-c", start, *map(str, arguments)]


def spawn(*arguments: object, cwd: Path | None = None) -> Run:
    """Run the real command."""
    done = subprocess.run(command(arguments), capture_output=True, cwd=cwd, timeout=60, check=False)
    return Run(
        done.returncode,
        done.stdout.decode("utf-8"),
        done.stderr.decode("utf-8", "backslashreplace"),
    )


def rows(text: str) -> list[dict[str, Any]]:
    """Parse JSON lines, strictly: NaN and Infinity are not JSON."""

    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} in JSON")

    return [json.loads(line, parse_constant=refuse) for line in text.splitlines()]


def untimed(text: str) -> list[str]:
    """Return JSON lines without their timings; the order of keys is kept."""
    return [json.dumps({**row, "timings_ms": None}) for row in rows(text)]
