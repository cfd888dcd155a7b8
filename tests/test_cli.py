"""The command line as a whole: help, versions, exit codes, the end of a run that fails."""

import ast
import builtins
import importlib
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from command import MAPS, ROOT, call, command, params_of, parsed, rows, simulating, spawn, tree

import imgloc
from imgloc.__main__ import main as imgloc_command
from imgloc.cli import app
from imgloc.cli.console import Group, emit
from imgloc.cli.demo import DEMO_MAPS
from imgloc.errors import ConfigError, MapError, OutputError, ScanError, as_options
from imgloc.io.maps import SEMANTICS
from imgloc.io.mapyaml import MODES
from imgloc.likelihoods.correlate import ENGINES
from imgloc.options import ALL_METHODS, Options, Reading
from imgloc.ranges import OneOf, declared
from imgloc.simulation.worlds import WORLDS

scans = simulating(MAPS / "curved.yaml", "-n", 40, "--rays", 40)


@pytest.mark.parametrize("name", [name for group in app._GROUPS.values() for name in group])
def test_a_command_is_listed_by_its_first_sentence(name: str) -> None:
    about = (app._COMMANDS | app._MAP | app._CACHE)[name]
    assert " ".join((app.command_of(name).__doc__ or "").split()).startswith(about)


def test_help_imports_nothing_heavy() -> None:
    heavy = ("numpy", "cv2", "skimage", "scipy", "yaml", "jinja2", "PIL", "pydantic", "matplotlib",
             "imgloc.pipeline", "imgloc.plans", "imgloc.lab.evaluation")  # fmt: skip
    code = (
        "from imgloc.cli.app import main\n"
        "for words in (['--help'], ['localize', '--help'], ['evaluate', '-h'],\n"
        "              ['map', 'show', '-h'], ['--version']):\n"
        "    try: main(words)\n"
        "    except SystemExit as e: assert not e.code, words\n"
        f"sys.exit(str([m for m in {heavy} if m in sys.modules] or ''))"
    )
    assert spawn(code=code).err.strip() == ""


def test_a_prepared_map_waits_for_no_library_that_it_does_not_use(scans, tmp_path):
    aside = ("skimage.util", "skimage.morphology", "scipy", "pydantic", "rich", "imgloc.filters")
    code = (
        "from imgloc.cli.app import main\n"
        "try: main(sys.argv[1:])\n"
        "except SystemExit as e: assert not e.code\n"
        f"print([m for m in {aside} if m in sys.modules], file=sys.stderr)"
    )
    words = ["localize", MAPS / "curved.yaml", scans, "--scans-index", "0", "--json"]
    for _ in range(2):
        run = spawn(*words, "--cache", tmp_path, code=code).ends(0)
    assert run.err.strip() == "[]"


def options_of(command: Any) -> set[str]:
    """Names of the options of a command and of all below it."""
    own = {name for p in params_of(command) for name in (*p.opts, *p.secondary_opts)}
    below = getattr(command, "commands", {}).values()
    return own.union({"--help"}, *map(options_of, below))


@cache
def texts_of(path: Path) -> tuple[str, ...]:
    """The strings of a file that are no docstrings, with 0 for what is filled in."""
    return tuple(_texts_of([*ast.walk(parsed(path))]))


def _texts_of(nodes: list[ast.AST]) -> Iterator[str]:
    pieces = {id(value) for node in nodes if isinstance(node, ast.JoinedStr)
              for value in node.values}  # fmt: skip
    docs = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}
    for node in nodes:
        if isinstance(node, ast.JoinedStr):
            parts = (v.value if isinstance(v, ast.Constant) else "0" for v in node.values)
            yield "".join(map(str, parts))
        elif isinstance(node, ast.Constant) and id(node) not in pieces | docs:
            yield str(node.value)


def test_messages_name_only_options_that_exist() -> None:
    known = options_of(tree()) | {"--ros-args"}  # of ROS
    assert {"--memory-budget", "--no-negate", "--what"} <= known
    named: dict[str, str] = {}
    for path in (ROOT / "imgloc").rglob("*.py"):
        for text in texts_of(path):
            words = re.findall(r"(?<![\w-])--[a-z][a-z-]*", as_options(text))
            named |= dict.fromkeys(words, path.name)
    assert "--resolution" in named  # a hint of imgloc.io.maps
    assert {word: where for word, where in named.items() if word not in known} == {}


def test_the_library_speaks_of_arguments_and_the_command_line_of_options() -> None:
    # These name options, too.
    commands = {"cli", "commands", "command.py", "options.py", "settings.py"}
    for path in (ROOT / "imgloc").rglob("*.py"):
        if commands & set(path.relative_to(ROOT).parts):
            continue
        found = [text for text in texts_of(path) if re.search(r"(?<![\w-])--[a-z]", text)]
        assert not [text for text in found if "imgloc calibrate MAP --scans" not in text], path


def test_import_imgloc_is_cheap_and_offers_every_public_name() -> None:
    code = (
        "import imgloc\n"
        "assert 'numpy' not in sys.modules and 'load_map' in dir(imgloc)\n"
        "from imgloc import *\n"
        "assert load_map.__name__ == 'load_map' and 'fused' in ALL_METHODS"
    )
    spawn(code=code).ends(0)
    for name in imgloc.__all__:
        assert getattr(imgloc, name) is not None


def test_python_m_imgloc_says_its_version() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "imgloc", "--version"], cwd=ROOT, capture_output=True, check=True
    )
    assert done.stdout.decode().split() == ["imgloc", imgloc.__version__]


def test_names_spelled_out_for_the_help_are_those_of_the_code() -> None:
    said = {part.name: part.limit.names for kind in (Options, Reading) for part in declared(kind)
            if isinstance(part.limit, OneOf)}  # fmt: skip
    assert said == {
        "method": ALL_METHODS, "engine": ("auto", *ENGINES), "mode": MODES, "semantics": SEMANTICS
    }  # fmt: skip
    assert list(DEMO_MAPS) == list(WORLDS)


@pytest.mark.parametrize(
    ("error", "code", "line"),
    [
        (ConfigError("two\nlines"), 2, "imgloc: error: two lines\n"),
        (MapError("a.png: bad"), 3, "imgloc: error: a.png: bad\n"),
        (ScanError("a.npz: bad"), 4, "imgloc: error: a.npz: bad\n"),
        (OutputError("o.png: exists"), 1, "imgloc: error: o.png: exists\n"),
        (KeyboardInterrupt(), 130, "imgloc: interrupted\n"),
        (BrokenPipeError(), 141, ""),
        (MemoryError(), 1, "imgloc: error: out of memory"),
        (ValueError("a\nb"), 1, "imgloc: internal error: ValueError: a b"),
        (SystemExit(7), 7, ""),
        (typer.Exit(6), 6, ""),
    ],
    ids=lambda value: type(value).__name__,
)
def test_every_failure_is_one_line_and_its_exit_code(error, code, line, capsys):
    app = typer.Typer(cls=Group, pretty_exceptions_enable=False, rich_markup_mode=None)

    @app.command()
    def fail() -> None:
        raise error

    @app.command()
    def other() -> None: ...

    with pytest.raises(SystemExit) as caught:
        app(["fail"])
    assert caught.value.code == code
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith(line)
    assert err.count("\n") == bool(line)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--method", "cmbl"], "'cmbl', expected one of fused, cbml, cbml-o"),
        (["--top", "0"], "--top"),
        (["--scans-index", "-1"], "--scans-index"),
        (["--scans-index", "40"], "--scans-index: got 40, expected 0 to 39"),
        (["--origin", "1,2"], "expected 3 numbers"),
        (["--mode", "fancy"], "'fancy', expected one of trinary, scale, raw"),
        (["--resolution", "0"], "--resolution: got 0"),
        (["--free-thresh", "0.9"], "expected 0 <= free_thresh < occupied_thresh"),
        (["--theta-step-deg", "0"], "--theta-step-deg: got 0, expected degrees"),
        (["--range-max", "inf"], "--range-max: got inf"),
        (["--picture", "a.jpg"], "expected a name that ends in .png"),
        (["--nonsense"], "--nonsense"),
    ],
    ids=" ".join,
)
def test_usage_errors_exit_with_2(words: list[str], expected: str, scans: Path) -> None:
    code, out, err = call("localize", MAPS / "curved.yaml", scans, *words)
    assert (code, out) == (2, "")
    assert expected in " ".join(err.split())
    assert "Traceback" not in err


def test_debug_shows_the_traceback_and_keeps_the_exit_code(tmp_path: Path) -> None:
    code, _, err = call("map", "check", tmp_path / "gone.yaml", "--debug")
    assert code == 3
    assert "Traceback" in err
    assert err.splitlines()[-1].startswith("imgloc: error: ")
    assert "Traceback" not in call("map", "check", tmp_path / "gone.yaml").err


def test_verbose_logs_to_stderr_alone(scans: Path) -> None:
    words = ("localize", MAPS / "curved.yaml", scans, "--json", "--scans-index", 3)
    loud, quiet = call(*words, "-v"), call(*words)
    assert len(rows(loud.out)) == 1
    assert "scan 3: " in loud.err
    assert quiet.err == ""


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_interrupt_exits_with_130_and_without_a_traceback(scans: Path, tmp_path: Path) -> None:
    with np.load(scans) as few:  # so many that they are not done before the signal arrives
        many = {"ranges": np.tile(few["ranges"], (100, 1)), "angles": few["angles"]}
    np.savez(tmp_path / "many.npz", **many, range_max=30.0)
    log = tmp_path / "many.npz"
    words = command(["localize", MAPS / "curved.yaml", log, "--json", "--threads", "1"])
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as run:
        assert rows(run.stdout.readline().decode())[0]["index"] == 0  # flushed one by one
        run.send_signal(signal.SIGINT)
        out, err = run.communicate(timeout=30)
    assert run.returncode == 130
    assert err.decode() == "imgloc: interrupted\n"
    assert len(rows(out.decode())) < 3999


def test_an_interrupt_while_the_command_line_is_loaded(monkeypatch, capsys):
    real = builtins.__import__

    def interrupted(name: str, *rest: Any) -> Any:
        if name == "imgloc.cli.app":
            raise KeyboardInterrupt
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", interrupted)
    with pytest.raises(SystemExit) as end:
        imgloc_command()
    assert end.value.code == 130
    assert capsys.readouterr() == ("", "imgloc: interrupted\n")


@pytest.mark.skipif(os.name != "posix", reason="pipes of POSIX")
def test_a_closed_pipe_ends_the_run_quietly(scans: Path) -> None:
    words = command(["localize", MAPS / "curved.yaml", scans, "--json", "--threads", "1"])
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as run:
        run.stdout.readline()
        run.stdout.close()
        assert run.stderr.read() == b""
        assert run.wait(30) == 141


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
def test_a_full_disk_under_stdout_is_one_line() -> None:
    with Path("/dev/full").open("wb") as full:
        done = subprocess.run(
            command(["map", "check", MAPS / "curved.yaml"]),
            stdout=full, stderr=subprocess.PIPE, check=False,
        )  # fmt: skip
    assert done.returncode == 1
    assert done.stderr.decode().startswith("imgloc: error: standard output: cannot be written")
    assert done.stderr.count(b"\n") == 1


@pytest.mark.skipif(os.name != "posix", reason="terminals of POSIX")
def test_progress_is_shown_on_a_terminal_and_stdout_stays_clean(scans: Path) -> None:
    pty = importlib.import_module("pty")
    leader, follower = pty.openpty()
    words = ["localize", MAPS / "curved.yaml", scans, "--json", "--scans-index", "0"]
    with subprocess.Popen(
        command(words), stdout=subprocess.PIPE, stderr=follower, env={**os.environ, "TERM": "xterm"}
    ) as run:
        out, _ = run.communicate(timeout=60)
        time.sleep(0.1)
        shown = os.read(leader, 100_000).decode()
    os.close(leader)
    os.close(follower)
    assert "localize" in shown
    assert len(rows(out.decode())) == 1
    assert b"\x1b" not in out


def test_emit_survives_without_a_stdout(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdout", None)
    emit("nobody hears this")


def test_demo_runs_twice_in_an_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    first, second = call("demo"), call("demo")
    assert (first.code, second.code) == (0, 0)
    assert "map double_wall, seed 0: unique" in first.out
    error = next(line for line in first.out.splitlines() if "error" in line).split()
    assert float(error[1]) < 0.1
    assert first.out.endswith("picture: imgloc-demo.png\n")
    assert second.out.endswith("picture: imgloc-demo-1.png\n")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["imgloc-demo-1.png", "imgloc-demo.png"]
    pictures = [p.read_bytes() for p in tmp_path.iterdir()]
    assert pictures[0] == pictures[1]


def test_demo_with_a_name_never_overwrites(tmp_path: Path) -> None:
    out = tmp_path / "mine.png"
    out.write_text("mine")
    words = ("demo", "--map", "curved", "--seed", 2, "--out", out)
    assert call(*words).code == 1
    assert out.read_text() == "mine"
    assert call(*words, "--force").code == 0
    assert out.read_bytes().startswith(b"\x89PNG")
