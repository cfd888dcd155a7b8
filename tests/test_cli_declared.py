"""Options are declared once: help, values, ranges, JSON and the library have the same."""

import ast
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Annotated, Any

import pytest
import typer
from command import MAPS, ROOT, Run, call, params_of, parsed, rows, tree

from imgloc.cli import app
from imgloc.cli.command import GONE, Only, Without, command, value_of
from imgloc.errors import _ARGUMENT, ConfigError, as_options
from imgloc.options import ALL_METHODS, Known, Options, Reading, Sensor
from imgloc.ranges import declared


def commands(
    below: Any = None, words: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Each command of the program, with its words."""
    below = tree() if below is None else below
    yield words, below
    for name, one in getattr(below, "commands", {}).items():
        yield from commands(one, (*words, name))


COMMANDS = {" ".join(words): one for words, one in commands() if words}


def flags(one: Any) -> list[str]:
    return [name for param in params_of(one) for name in (*param.opts, *param.secondary_opts)]


# Runs imgloc with each of these words, in one process; then it is refused a value.
ELSEWHERE = """
import json, sys, command, imgloc
print(json.dumps([command.call(*words) for words in json.loads(sys.argv[1])]))
imgloc.Options(naps=10)
"""


def test_an_option_that_is_added_in_one_place_is_everywhere(tmp_path: Path) -> None:
    for folder in ("imgloc", "maps"):
        shutil.copytree(ROOT / folder, tmp_path / folder, ignore=shutil.ignore_patterns("__pyc*"))
    file = tmp_path / "imgloc" / "options.py"
    code = file.read_text("utf-8")
    before = "    threads: Annotated[Count, Doc("
    assert code.count(before) == 1
    new = '    naps: Annotated[int, Within(0, 9, "naps")] = option(3, "Naps before each, naps.")\n'
    file.write_text(code.replace(before, new + before), "utf-8")

    localize = ["localize", "curved", "s.npz", "--json"]
    words = [["localize", "--help"], ["simulate", "curved", "-n", "1", "--out", "s.npz"], localize,
             [*localize, "--naps", "9"], [*localize, "--naps", "10"]]  # fmt: skip
    done = subprocess.run(
        [sys.executable, "-c", ELSEWHERE, json.dumps(words)],
        cwd=tmp_path, capture_output=True, text=True, check=False,
        env={**os.environ, "PYTHONPATH": os.pathsep.join((str(tmp_path), str(ROOT / "tests"))),
             "XDG_CACHE_HOME": str(tmp_path)},
    )  # fmt: skip
    text, _, three, nine, ten = (Run(*each) for each in json.loads(done.stdout))
    assert "--naps N Naps before each, naps. [0 to 9; default: 3]" in " ".join(text.out.split())
    assert [json.loads(run.out)["parameters"]["naps"] for run in (three, nine)] == [3, 9]
    said = "got 10, expected a whole number, naps, 0 to 9\n"
    assert (ten.code, ten.err) == (2, f"imgloc: error: --naps: {said}")
    assert f"Options.naps: {said}" in done.stderr


@pytest.mark.parametrize("words", COMMANDS)
def test_each_text_of_the_help_stands_on_its_own(words: str) -> None:
    leans = re.compile(
        r"\bas of\b|\bditto\b|\blikewise\b|\babove\b|\bthe same as\b|\bsaid\b|\btold\b|^Of |\btoo\)"
    )
    for param in params_of(COMMANDS[words]):
        text = param.help or ""
        if param.name in ("help", "install_completion", "show_completion"):
            continue
        assert re.match(r"[A-Z].{11,}[.\]]$", text, re.DOTALL), (param.name, text)
        assert not leans.search(text), (param.name, text)
        assert "default: None" not in text
        assert text.count("default: ") <= 1


@pytest.mark.parametrize("words", COMMANDS)
def test_no_option_has_two_meanings(words: str) -> None:
    names = flags(COMMANDS[words])
    assert len(names) == len(set(names))


@pytest.mark.parametrize(
    ("kind", "name", "text", "value"),
    [
        (Options, "top", "3", 3),
        (Options, "method", "ght-v", "ght-v"),
        (Sensor, "fov", "180", 3.141592653589793),
        (Known, "heading", "90deg", (1.5707963267948966, 0.8)),
        (Reading, "resolution", "0.05", 0.05),
    ],
)
def test_a_text_becomes_the_value_of_a_field(kind, name, text, value):
    (field,) = (part for part in declared(kind) if part.name == name)
    assert value_of(field, text) == value


@pytest.mark.parametrize(
    ("kind", "name", "text", "says"),
    [
        (Options, "top", "0", "--top: got 0, expected a whole number, 1 or more"),
        (Options, "top", "1e15", "--top: got 1e15, expected a whole number, 1 or more, at most 1"),
        (Options, "top", "x", "--top: got 'x', expected a whole number, 1 or more"),
        (Options, "method", "cmbl", "--method: got 'cmbl', expected one of fused, cbml"),
        (Sensor, "fov", "361", "--fov-deg: got 361, expected degrees, 0.01 to 360"),
        (Sensor, "sigma", "nan", "--sigma: got nan, expected metres, 0 to 10"),
        (Sensor, "mount", "1,2", "--sensor: got '1,2', expected 3 numbers with commas between"),
        (Known, "near", "1,2,90", "--near: got an angle of 90, expected radians, -6.2832 to"),
        (Known, "near", "1,2,0,0", "--near: got R 0, expected metres, 0.01 to 1e+06"),
        (Known, "near", "1,2,0,1,3.3", "--near: got T 3.3, expected radians, 0.001 to 3.2"),
    ],
)
def test_a_text_that_is_no_value_is_refused_by_the_option(kind, name, text, says):
    (field,) = (part for part in declared(kind) if part.name == name)
    with pytest.raises(ConfigError) as error:
        value_of(field, text)
    assert str(error.value).startswith(says)


def test_a_command_takes_fields_of_dataclasses() -> None:
    seen: list[Any] = []

    def some(
        search: Annotated[Options, Only("method", "top")],
        sensor: Annotated[Sensor, Without("mount", "rays", "fov")],
    ) -> None:
        """Do something."""
        seen.extend((search, sensor))

    app = typer.Typer()
    app.command()(command(some))
    made = typer.main.get_command(app)
    assert {"--method", "--top", "--sigma", "--range-max"} <= set(flags(made))
    assert not {"--engine", "--sensor", "--rays"} & set(flags(made))
    made(["--top", "4", "--sigma", "0.1"], standalone_mode=False)
    assert seen == [Options(top=4), Sensor(sigma=0.1)]


def test_errors_of_the_library_name_the_option() -> None:
    run = call("evaluate", MAPS / "curved.yaml", "--tolerance", "0.5,400")
    assert (run.code, "--tolerance: got 400 degrees" in run.err) == (2, True)
    run = call("localize", "curved", "s.npz", "--sensor", "9,0,0")
    assert (run.code, "--sensor: got 9,0: 9 m from the robot's base" in run.err) == (2, True)


ROOMS = ("io", "robot", "answers", "choice")  # whose messages any command may print
OWN = {"--force", "--start", "--explain", "--cache"}  # said of what was given, or of its own


def said_by(rooms: Iterable[str]) -> set[str]:
    """The options that messages of some rooms name, as the command line has them."""
    nodes = [n for room in rooms for path in (ROOT / "imgloc" / room).glob("*.py")
             for n in ast.walk(parsed(path))]  # fmt: skip
    docs = {node.value for node in nodes if isinstance(node, ast.Expr)}
    texts = {n.value for n in nodes if isinstance(n, ast.Constant) and n not in docs}
    found = (a[0] for text in texts if isinstance(text, str) for a in _ARGUMENT.finditer(text))
    return {as_options(argument).split()[0].replace("--no-", "--") for argument in found}


def test_what_a_hint_names_the_command_has_or_it_says_what_to_do_instead() -> None:
    ways = {f"--{name}" for name in GONE}
    every = {flag for one in COMMANDS.values() for flag in flags(one)}
    named = (said_by(ROOMS) & every) - OWN
    assert {"--topic", "--fov-deg", "--odom", "--negate", "--resolution"} <= named
    for words, one in COMMANDS.items():
        files = [p for p in params_of(one) if p.param_type_name == "argument"]
        if any("Folder" not in (p.help or "") for p in files):
            of_maps = {"--resolution"} if words == "convert" else set()
            assert sorted(named - {*flags(one)} - ways - of_maps) == [], words


def test_a_hint_with_an_option_of_other_commands_leads_on(tmp_path: Path) -> None:
    call("atlas", "curved", "--topic", "/a").ends(
        2, "--topic: is no option here; it reads no scans"
    )
    (tmp_path / "a.csv").write_text("1,2,3,4,5,6,7,8,9,10,11,12\n")
    said = "\nthis command has no --fov-deg: imgloc convert LOG scans.npz with it makes"
    assert said in call("batch", "curved", tmp_path / "a.csv", "--out", tmp_path / "out").out
    run = call("localize", "curved", tmp_path / "a.csv")
    assert "or --fov-deg" in run.err
    assert "this command has no" not in run.err


@pytest.mark.parametrize(("words", "said"), [
    ("batch curved s.npz --out o --threads 2", "--threads: is no option here; imgloc localize has"),
    ("report output --json", "--json: is no option here; this command would not notice it"),
    ("batch curved --out o --force", "--force: is no option here; nothing would be written over"),
    ("localize curved s.npz --cache=", "--cache: got nothing, expected a path"),
    ("serve curved --topic 1", "--topic: is no option here; imgloc convert LOG scans.npz with it"),
    ("demo --resolution 1", "--resolution: is no option here; it reads no map"),
    ("localize curved s.npz --resolution 0", "--resolution: got 0, expected metres, 0.001 to 10"),
    ("localize curved s.npz --threads 0", "--threads: got 0, expected a whole number, 1 or more"),
])  # fmt: skip
def test_an_option_of_the_program_is_refused_where_nothing_notices_it(words, said):
    call(*words.split()).ends(2, said, out="")
    switch = words.split()[-2 if words[-1].isdigit() else -1 :]
    call(*switch, *words.split()[: -len(switch)]).ends(2, said, out="")


@pytest.mark.parametrize("line", [
    "localize curved s.npz --threads", "localize curved s.npz --cache --json",
    "--memory-budget localize curved s.npz", "--cache --no-cache localize curved s.npz",
    "localize curved s.npz --topic --near 1,2,3", "batch curved s.npz --out --resume",
    "--cache demo",
])  # fmt: skip
def test_an_option_takes_no_option_and_no_command_for_its_value(line: str) -> None:
    call(*line.split()).ends(2, "requires an argument", out="")


def test_an_option_may_stand_between_the_words_of_a_command() -> None:
    lines = (["--json", "map", "check"], ["map", "--json", "check"], ["map", "check", "--json"])
    (out,) = {call(*line, "curved").out for line in lines}
    assert out.startswith('{"path": ')
    call("cache", "--json", "clear").ends(2, "--json: is no option here", out="")
    call("--picture", "a.txt", "localize", "curved", "s").ends(2, "a.txt: expected a name", out="")


def test_a_value_may_be_called_as_a_command_is(tmp_path: Path) -> None:
    call("--cache", "demo", "localize").ends(2, "Missing argument", out="")
    call("map", "--out", "check", "show", "curved").ends(2, "check: expected a name that", out="")
    assert f"folder   {tmp_path}\n" in call("cache", "--cache", tmp_path).out


def test_a_wrong_name_is_told_from_those_of_the_program() -> None:
    call("localize", "curved", "s.npz", "--jsno").ends(2, "No such option", "--json", out="")


def test_all_methods_are_measured_by_name() -> None:
    run = call("evaluate", "curved", "--method", "fused,sift")
    names = ",".join(ALL_METHODS)
    assert run.err == f"imgloc: error: --method: got 'sift', expected {names} or some of them\n"


def test_each_option_is_in_a_guide_or_an_example() -> None:
    pages = [ROOT / "README.md", *(ROOT / "tools" / "docs").glob("*.md")]
    lines = [app.told(app.command_of(k))["epilog"] for group in app._GROUPS.values() for k in group]
    text = "\n".join([*(page.read_text("utf-8") for page in pages), *lines])
    ours = {param.opts[0] for one in COMMANDS.values() for param in params_of(one)
            if param.opts[0].startswith("--")} - {"--version"}  # fmt: skip
    known = {*re.findall(r"--[a-z][a-z-]+", text)}
    known |= {f"--{name.replace('_', '-')}" for name in re.findall(r"`([a-z_]+)`", text)}
    assert sorted(ours - known) == []


def test_what_may_be_repeated_counts_wherever_it_stands(tmp_path: Path) -> None:
    call("simulate", "curved", "-n", 3, "--out", tmp_path / "s.npz").ends(0)
    words = ("localize", "curved", tmp_path / "s.npz", "--json", "--scans-index", 2)
    said = rows(call("--scans-index", 0, *words).out)
    assert [row["index"] for row in said] == [0, 2]


@pytest.mark.parametrize("words", [("localize", "curved", ""), ("serve", ""), ("inspect", "")])
def test_an_empty_path_is_no_folder(words: tuple[str, ...]) -> None:
    call(*words).ends(2, "got nothing, expected a path", out="")
