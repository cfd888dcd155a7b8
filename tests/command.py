"""Runs of the command line: in this process for speed, or as the user runs it."""

import ast
import contextlib
import ctypes
import io
import json
import math
import os
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import typer
from typer.main import get_command

from imgloc.cli.app import main, program

ROOT = Path(__file__).resolve().parents[1]
MAPS = ROOT / "maps"


@cache
def parsed(path: Path) -> ast.Module:
    """The syntax tree of a file, which several tests look through."""
    return ast.parse(path.read_text("utf-8"))


@cache
def tree() -> Any:
    """The program with all commands."""
    return get_command(program())


def params_of(command: Any) -> list[Any]:
    """The parameters of a command, those of the program that it takes among them."""
    root = typer.Context(tree())
    own = command.get_params(root if command is tree() else typer.Context(command, parent=root))
    return [param for param in own if param.name != "help"]


class Run(NamedTuple):
    code: int
    out: str
    err: str

    def ends(self, code: int, *said: str, out: str | None = None) -> "Run":
        """Ends with this code and these words on standard error, and `out`, if given."""
        assert (self.code, [words for words in said if words not in self.err]) == (code, []), self
        assert out in (None, self.out)
        return self


def call(*arguments: object) -> Run:
    """Run imgloc's main() here."""
    return run(main, *arguments)


def simulating(*words: object, name: str = "scans.npz") -> Any:
    """A fixture: the file of scans that `imgloc simulate` makes of these words, once a module."""

    @pytest.fixture(scope="module")
    def scans(tmp_path_factory: pytest.TempPathFactory) -> Path:
        path = tmp_path_factory.mktemp("scans") / name
        call("simulate", *words, "--out", path).ends(0)
        return path

    return scans


def fed(text: str, *arguments: object) -> Run:
    """Run imgloc's main() here, with a text that comes through a pipe as standard input."""
    end, begin = os.pipe()

    def write() -> None:
        with contextlib.suppress(BrokenPipeError), os.fdopen(begin, "w") as pipe:
            pipe.write(text)

    writer, before = threading.Thread(target=write), sys.stdin
    writer.start()
    try:
        with os.fdopen(end) as sys.stdin:
            return call(*arguments)
    finally:
        sys.stdin = before
        writer.join()


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


#: Python must not take modules from the current folder; before 3.11 nothing says so.
SAFE = ("-P",) if sys.version_info >= (3, 11) else ()


#: What the command runs.
MAIN = "import imgloc.cli.app as a; a.main()"


def command(arguments: Sequence[object], code: str = MAIN) -> list[str]:
    """Return the real command, for subprocess, or other `code` with these arguments."""
    # -P: the folder that a test runs in is not on the path, as with the installed script.
    start = f"import sys; sys.path.insert(0, {str(ROOT)!r})\n{code}"
    return [sys.executable, *SAFE, "-c", start, *map(str, arguments)]


def spawn(*arguments: object, cwd: Path | None = None, code: str = MAIN) -> Run:
    """Run the real command, or other `code`, in a process of its own."""
    done = subprocess.run(command(arguments, code), capture_output=True, cwd=cwd, timeout=120)
    return Run(
        done.returncode,
        done.stdout.decode("utf-8"),
        done.stderr.decode("utf-8", "backslashreplace"),
    )


class Weighed(NamedTuple):
    run: Run
    seconds: float  # of the processor
    mib: float  # its peak, resident


# A process that has imported everything, and forks one for each command: to start Python and to
# import OpenCV takes longer than most commands. A fork begins with a peak of its own.
_FORKS = """
import json, os, resource, signal, sys
sys.path.insert(0, sys.argv[1])
import imgloc.cli.inputs, imgloc.io.bags, imgloc.pipeline, imgloc.runs.jobs
from imgloc.cli.app import main
from command import without_privileges
def peak():
    with open("/proc/self/status") as status:
        return next(int(s.split()[1]) for s in status if s.startswith("VmHWM"))
for line in sys.stdin:
    words, stdin, out, err, told = json.loads(line)
    pid = os.fork()
    if pid:
        print(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), flush=True)
        continue
    start = sum(os.times()[:4])  # the processor's: others use the machine, too
    signal.alarm(60)
    for fd, (path, flags) in enumerate([(stdin, os.O_RDONLY), (out, 577), (err, 577)]):
        os.dup2(os.open(path, flags), fd)
    resource.setrlimit(resource.RLIMIT_AS, (8_000_000 << 10,) * 2)  # of a bomb
    without_privileges()
    code = 0
    try:
        main(words)
    except SystemExit as end:
        code = end.code or 0
    except BaseException:
        import traceback
        traceback.print_exc()
        code = 1
    sys.stdout.flush()
    sys.stderr.flush()
    with open(told, "w") as file:
        json.dump([peak(), sum(os.times()[:4]) - start], file)
    os._exit(code)
"""


def without_privileges() -> None:
    """Let root, as any other user, look into no folder that nobody may look into."""
    libc, version = ctypes.CDLL(None), 0x20080522
    header, data = (ctypes.c_uint32 * 2)(version, 0), (ctypes.c_uint32 * 6)()
    if libc.capget(header, data) == 0:
        data[0] &= ~0b110  # of the effective ones: CAP_DAC_OVERRIDE, CAP_DAC_READ_SEARCH
        libc.capset(header, data)


@cache
def _forks() -> "subprocess.Popen[str]":
    path = os.pathsep.join((str(ROOT), str(ROOT / "tests")))
    return subprocess.Popen(
        [sys.executable, "-c", _FORKS, str(ROOT)], stdin=-1, stdout=-1, text=True,
        env={**os.environ, "PYTHONPATH": path},
    )  # fmt: skip


def weighed(*arguments: object, stdin: str = "true") -> Weighed:
    """Run the command in a process of its own behind the shell command `stdin`, and weigh it."""
    if not Path("/proc/self/status").exists():
        pytest.skip("needs Linux: a process that knows its peak")
    with tempfile.TemporaryDirectory() as name:
        stream, *files = (Path(name, part) for part in ("stdin", "out", "err", "told"))
        os.mkfifo(stream)
        with subprocess.Popen(
            ["/bin/sh", "-c", f"{stdin} > {stream}"], start_new_session=True
        ) as sh:
            print(
                json.dumps([[*map(str, arguments)], *map(str, (stream, *files))]),
                file=_forks().stdin, flush=True,
            )  # fmt: skip
            code = int(_forks().stdout.readline())
            with contextlib.suppress(ProcessLookupError):
                os.killpg(sh.pid, signal.SIGKILL)
        out, err, told = (file.read_bytes() if file.exists() else b"" for file in files)
    peak, seconds = json.loads(told) if told else (math.inf, math.inf)  # it died
    run = Run(code, out.decode("utf-8"), err.decode("utf-8", "backslashreplace"))
    return Weighed(run, seconds, peak / 1024)


def rows(text: str) -> list[dict[str, Any]]:
    """Parse JSON lines, strictly: NaN and Infinity are not JSON."""

    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} in JSON")

    return [json.loads(line, parse_constant=refuse) for line in text.splitlines()]


def untimed(text: str) -> list[str]:
    """Return JSON lines without their timings; the order of keys is kept."""
    return [json.dumps({**row, "timings_ms": None}) for row in rows(text)]
