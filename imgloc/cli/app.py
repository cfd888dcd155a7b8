"""The program: its commands, and their groups."""

import functools
import inspect
import os
import re
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import typer
from typer.main import get_command

from imgloc.__about__ import __version__
from imgloc.cli.console import Group, Subgroup, emit
from imgloc.doors import COMMANDS, opened

_OPTIONS = {"help_option_names": ["-h", "--help"], "max_content_width": 100}


def _version(wanted: bool) -> None:
    if wanted:
        emit(f"imgloc {__version__}")
        raise typer.Exit


def root(
    version: bool = typer.Option(
        False, "--version", callback=_version, is_eager=True, help="Print the version."
    ),
    verbose: bool = typer.Option(
        False, "--verbose", "-v", help="Log each step of a command to standard error."
    ),
    debug: bool = typer.Option(False, "--debug", help="Show the traceback of an error."),
) -> None:
    """Where am I on this map?

    Finds the pose of a 2-D laser scan in a map that is an image, without an initial guess, and
    whether to trust it.

    Exit codes: 0 ok, 1 internal or output, 2 usage, 3 bad map, 4 bad scan, 5 some maps or
    items failed, 6 not unique (with --strict), 130 interrupted by Ctrl-C.

    Examples
    --------
    imgloc demo
    imgloc map check office.yaml
    imgloc localize office.yaml scans.npz --picture answer.png
    imgloc simulate office.yaml -n 100 --out scans.npz
    imgloc localize office.yaml scans.npz --json > answers.jsonl
    """  # noqa: D400


#: The commands: the first sentence of each, by which all are listed.
_COMMANDS: Mapping[str, str] = {
    "demo": "Simulate a scan in a bundled map, localize it, draw the answer.",
    "inspect": "Look at a log or a map before it is used, and name what is wrong with it.",
    "convert": "Write the scans of any log as CSV, JSON lines, NPZ or MCAP.",
    "localize": "Find the pose of each scan in a map, without an initial guess.",
    "simulate": "Simulate scans at random free poses of a map.",
    "evaluate": "Measure methods on scans whose poses are known: simulated at random, or recorded.",
    "calibrate": "Fit the methods to a map, or with --scans the map's scale and walls to recorded "
    "scans.",
    "sample": "Draw poses from the calibrated posterior p(x | z) of each scan.",
    "atlas": "Draw where on this map, for this lidar, a single scan is enough.",
    "batch": "Run one job on every pair of map and scan file: one row each.",
    "report": "Write one page about a batch: verdicts, errors, times, maps, failures, pictures.",
    "export": "Write the results of a batch as one table, a row for each scan.",
    "track": "Follow a robot through a log of scans with odometry, from anywhere on the map.",
    "node": "Run a ROS 2 node that finds the robot on the map and publishes its first pose.",
    "which": "Say which of the maps in a folder each scan is from: one of them, none, or "
    "undecided.",
    "serve": "Answer over HTTP: where scans are, from which map; and a page at / that shows why.",
    "open": "Look at a map and scans in the browser: answers in place, and why.",
}
_MAP: Mapping[str, str] = {
    "check": "Report what is in a map, and what is likely to be wrong with it.",
    "show": "Draw a map, or what is computed from it, into a PNG.",
    "align": "Find where map B lies in the frame of map A, and how well the two agree.",
    "changes": "Find where a map has aged: walls that rays pass (gone), surfaces where it has none "
    "(new).",
    "plan": "Make a map of a floor plan: walls as they stand, doors open, nothing else.",
}
_CACHE: Mapping[str, str] = {
    "clear": "Remove all prepared maps; they are prepared anew when they are needed.",
}
_CACHED = "Show where prepared maps are kept, how many there are and what they take."
_GROUPS = {"": _COMMANDS, "map": _MAP, "cache": _CACHE}
_FILES = {"check": "map", "show": "map", "open": "serve", "clear": "cache"}


def command_of(name: str) -> Callable[..., None]:
    """The function of a command, whose file is loaded now; nothing else needs it.

    Examples
    --------
    >>> command_of("show").__module__, command_of("plan").__module__
    ('imgloc.cli.map', 'imgloc.plans.command')
    """
    file = f"imgloc.cli.{_FILES.get(name, name)}"
    found: Callable[..., None] = opened(COMMANDS.get(name, f"{file}:{name}"))
    return found


def told(function: Callable[..., None]) -> dict[str, Any]:
    r"""The help of a command and what is below it, as Typer takes them, of its docstring.

    Examples
    --------
    >>> told(command_of("clear"))["epilog"]
    '\x08\nExamples:\n  imgloc cache clear'
    """
    about, *parts = re.split(r"\n\n(\w+)\n-+\n", inspect.cleandoc(function.__doc__ or ""))
    more = dict(zip(parts[::2], parts[1::2], strict=True))
    lines = more.get("Examples", "").replace("\n", "\n  ")
    formats = f"\b\n{more['Formats']}\n\n" if "Formats" in more else ""
    return {"help": about, "epilog": f"{formats}\b\nExamples:\n  {lines}"}


def program(words: Iterable[str] | None = None) -> typer.Typer:
    """Make the program, with the options of those commands alone that a line of `words` names.

    To make all options takes a while, and no line needs more than its own; None is any line.
    """
    named = None if words is None else frozenset(words)
    from imgloc.cli.command import Command, command, with_options_of_program
    from imgloc.cli.program import Kept, Resources, Written

    shared: list[Any] = [Written, Resources, Kept]
    if named is None or named:
        from imgloc.cli.options import MapImages
        from imgloc.options import Chosen, Logs, Mounting

        shared = [MapImages, Logs, Chosen, Mounting, *shared]
    groups = {
        # No rich: help has to appear at once, and examples have to stay as they are typed.
        name: typer.Typer(
            cls=Subgroup if name else Group,
            no_args_is_help=name != "cache",
            invoke_without_command=name == "cache",
            rich_markup_mode=None,
            context_settings=_OPTIONS,
        )
        for name in _GROUPS
    }

    def made(name: str) -> Callable[..., None]:
        if named is not None and name not in named:
            return _unmade
        return command(command_of(name), *shared)

    for group, commands in _GROUPS.items():
        for name, first in commands.items():
            if (run := made(name)) is _unmade:
                groups[group].command(name, help=first)(run)
                continue
            # The file of a command may have a class of its own.
            kind = getattr(sys.modules[run.__module__], "RosCommand", Command)
            groups[group].command(name, cls=kind, **told(run))(run)
    app = groups[""]
    app.callback(**told(root))(with_options_of_program(root, *shared))
    app.add_typer(
        groups["map"], name="map", help="Look at maps, compare them, or make one of a floor plan."
    )
    run = made("cache")
    groups["cache"].callback(**({"help": _CACHED} if run is _unmade else told(run)))(run)
    app.add_typer(groups["cache"], name="cache")
    return app


def _unmade() -> None:
    """A command without its options, for a line that does not name it."""
    raise AssertionError


@functools.cache
def _program_of(names: frozenset[str]) -> Any:
    return get_command(program(names))


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line; it always ends in a SystemExit with the exit code.

    Parameters
    ----------
    arguments : sequence of str, optional
        Without the program's name; ``sys.argv[1:]`` by default.
    """
    words = sys.argv[1:] if arguments is None else list(arguments)
    known = {name for commands in _GROUPS.values() for name in commands} | {"cache"}
    # The completion of a shell has its words elsewhere.
    named = known if "_IMGLOC_COMPLETE" in os.environ else known & set(words)
    _program_of(frozenset(named))(words, prog_name="imgloc")
