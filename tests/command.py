"""Runs of the command line: in this process for speed, or as the user runs it."""

import contextlib
import ctypes
import io
import json
import math
import shlex
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from imgloc.cli.app import main

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
    start = f"import sys; sys.path.insert(0, {str(ROOT)!r}); import imgloc.cli.app as a; a.main()"
    return [sys.executable, "-P", "-c", start, *map(str, arguments)]


def spawn(*arguments: object, cwd: Path | None = None) -> Run:
    """Run the real command."""
    done = subprocess.run(command(arguments), capture_output=True, cwd=cwd, timeout=60, check=False)
    return Run(
        done.returncode,
        done.stdout.decode("utf-8"),
        done.stderr.decode("utf-8", "backslashreplace"),
    )


def _without_privileges() -> None:
    """Let root, as any other user, look into no folder that nobody may look into."""
    for capability in (1, 2):  # CAP_DAC_OVERRIDE, CAP_DAC_READ_SEARCH
        ctypes.CDLL(None).prctl(24, capability)  # PR_CAPBSET_DROP


class Weighed(NamedTuple):
    run: Run
    seconds: float
    mib: float  # its peak, resident


def weighed(*arguments: object, stdin: str = "true") -> Weighed:
    """Run the real command behind the shell command `stdin`, and see how long and how large it is.

    The peak is the command's own account: what wait4() says is at least that of the parent.
    """
    if not Path("/proc/self/status").exists():
        pytest.skip("needs Linux: a process that knows its peak")
    tell = (
        "import atexit, sys, time; t = time.time()\n"
        "def tell():\n"
        "    peak = next(s for s in open('/proc/self/status') if s.startswith('VmHWM'))\n"
        "    sys.stderr.write(f'\\npeak {peak.split()[1]} {time.time() - t}')\n"
        "atexit.register(tell)\n"
    )
    program = command(arguments)
    program[3] = tell + program[3]
    line = f"{stdin} | {shlex.join(program)}"
    limited = f"ulimit -v 8000000; {line}"  # kB: a bomb must not end the machine
    done = subprocess.run(
        ["/bin/sh", "-c", limited],
        capture_output=True,
        timeout=60,
        check=False,
        preexec_fn=_without_privileges,
    )
    err, _, said = done.stderr.decode("utf-8", "backslashreplace").partition("\npeak ")
    peak, seconds = map(float, said.split()) if said else (math.inf, math.inf)  # it died
    return Weighed(Run(done.returncode, done.stdout.decode("utf-8"), err), seconds, peak / 1024)


def rows(text: str) -> list[dict[str, Any]]:
    """Parse JSON lines, strictly: NaN and Infinity are not JSON."""

    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} in JSON")

    return [json.loads(line, parse_constant=refuse) for line in text.splitlines()]


def untimed(text: str) -> list[str]:
    """Return JSON lines without their timings; the order of keys is kept."""
    return [json.dumps({**row, "timings_ms": None}) for row in rows(text)]
