"""The program: its commands with their examples, and their groups."""

import functools
import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import typer
from typer.main import get_command

from imgloc.__about__ import __version__
from imgloc.cli.console import Group, Subgroup, emit
from imgloc.doors import COMMANDS, opened

_OPTIONS = {"help_option_names": ["-h", "--help"], "max_content_width": 100}

_EXAMPLES = (
    "imgloc demo",
    "imgloc map check office.yaml",
    "imgloc localize office.yaml scans.npz --picture answer.png",
    "imgloc simulate office.yaml -n 100 --out scans.npz",
    "imgloc localize office.yaml scans.npz --json > answers.jsonl",
)
_CACHED = "Show where prepared maps are kept, how many there are and what they take."
_CACHES = ("imgloc cache", "imgloc cache --json", "imgloc cache clear")
_HELP = """Where am I on this map?

Finds the pose of a 2-D laser scan in a map that is an image, without an initial guess, and says
whether to trust it.

Exit codes: 0 ok, 1 internal or output, 2 usage, 3 bad map, 4 bad scan, 5 some maps or
items failed, 6 not unique (with --strict), 130 interrupted by Ctrl-C.
"""


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
    """Options of the program itself."""


#: The commands: the first sentence of each, by which all are listed, and examples.
_COMMANDS: Mapping[str, tuple[str, ...]] = {
    "demo": (
        "Simulate a scan in a bundled map, localize it, draw the answer.",
        "imgloc demo",
        "imgloc demo --map corridor --seed 4",
    ),
    "inspect": (
        "Look at a log or a map before it is used, and name what is wrong with it.",
        "imgloc inspect run.log",
        "imgloc inspect office.yaml run.bag --picture run.png",
        "imgloc inspect office.yaml monday.log tuesday.log.gz --json",
    ),
    "convert": (
        "Write the scans of any log as CSV, JSON lines, NPZ or MCAP.",
        "imgloc convert run.bag scans.npz",
        "imgloc convert run.log scans.csv --range-scale 0.001",
        "imgloc convert scans.csv run.mcap --scans-index ::10",
    ),
    "localize": (
        "Find the pose of each scan in a map, without an initial guess.",
        "imgloc localize office.yaml scans.npz",
        "imgloc localize office.yaml scans.npz --scans-index 3 --picture answer.png",
        "imgloc localize office.yaml run.log --scans-index 7,100:120 --explain why.html",
        "imgloc localize office.png scan.csv --resolution 0.05 --origin -12.5,-8,0",
        "imgloc localize office.yaml monday.log tuesday.bag --sensor 0.2,0,180deg",
        "imgloc localize office.yaml - < scan.csv",
        "imgloc localize office.yaml scans.npz --json --strict > answers.jsonl",
        "imgloc localize office.yaml scans.npz --method ght-v --theta-step-deg 5",
    ),
    "simulate": (
        "Simulate scans at random free poses of a map.",
        "imgloc simulate office.yaml -n 100 --out scans.npz",
        "imgloc simulate office.yaml -n 20 --rays 360 --fov-deg 360 --outliers 0.2 --out hard.npz",
    ),
    "evaluate": (
        "Measure methods on scans whose poses are known: simulated at random, or recorded.",
        "imgloc evaluate curved visibility large --method cbml,cbml-o,ght,ght-v,beam",
        "imgloc evaluate office.yaml -n 50 --method fused --range-max 10 --tolerance 0.3,10",
        "imgloc evaluate office.yaml --scans scans.npz --sample 60 --json > results.jsonl",
        "imgloc evaluate a.yaml b.yaml --scans a.npz --scans b.npz --method fused,ght-v",
        "imgloc evaluate curved --method ght,ght-v --theta-step-deg 10 --cell 0.2",
    ),
    "calibrate": (
        "Fit the methods to a map, or with --scans the map's scale and walls to recorded scans.",
        "imgloc calibrate office.yaml",
        "imgloc calibrate office.yaml --method ght-v,beam --rays 360 --fov-deg 360 --range-max 12",
        "imgloc calibrate floor1.yaml floor2.yaml -n 15 --json",
        "imgloc calibrate curved visibility --dry-run",
    ),
    "sample": (
        "Draw poses from the calibrated posterior p(x | z) of each scan.",
        "imgloc sample office.yaml scans.npz --out particles.csv",
        "imgloc sample office.yaml scans.npz --scans-index 3 -n 2000 --seed 7 --out a.csv",
    ),
    "atlas": (
        "Draw where on this map, for this lidar, a single scan is enough.",
        "imgloc atlas office.yaml --out atlas.png",
        "imgloc atlas office.yaml --out atlas.png --csv atlas.csv --rays 360 --fov-deg 360",
        "imgloc atlas visibility --out atlas.png --range-max 5 --json",
    ),
    "batch": (
        "Run one job on every pair of map and scan file: one row each.",
        "imgloc batch floors --job check --out checked",
        "imgloc batch floors scans --out found --pictures doubtful",
        "imgloc batch floors scans --job which --out named --workers 8",
        "imgloc batch pairs.csv --out found --resume",
        "imgloc batch images scans --resolution 0.05 --out found --dask tcp://10.0.0.5:8786",
    ),
    "report": (
        "Write one page about a batch: verdicts, errors, times, maps, failures, pictures.",
        "imgloc report found",
        "imgloc report found --out site.html",
    ),
    "export": (
        "Write the results of a batch as one table, a row for each scan.",
        "imgloc export found",
        "imgloc export found --out answers.parquet",
    ),
    "track": (
        "Follow a robot through a log of scans with odometry, from anywhere on the map.",
        "imgloc track office.yaml run.log --tum out.tum --picture track.png",
        "imgloc track office.yaml run.bag --ros poses.yaml --json > track.jsonl",
        "imgloc track office.yaml log.npz --start 3,2,0 --sensor 0.3,0,0",
        "imgloc track office.yaml log.npz --video out.webm",
    ),
    "node": (
        "Run a ROS 2 node that finds the robot on the map and publishes its first pose.",
        "imgloc node",
        "imgloc node office.yaml --sensor 0.2,0,0 --track",
        "imgloc node floors --scan front --scan rear --sensor 0.3,0,0 --sensor -0.3,0,180deg",
        "imgloc node office.yaml --sensor 0,0,0 --ros-args -p use_sim_time:=true",
    ),
    "which": (
        "Say which of the maps in a folder each scan is from: one of them, none, or undecided.",
        "imgloc which floors scans.npz",
        "imgloc which floors scan.csv --range-max 20 --heading 90deg --json",
        "imgloc which sites --maps-index sites.npz",
        "imgloc which sites scans.npz --maps-index sites.npz --picture where.png",
    ),
    "serve": (
        "Answer over HTTP: where scans are, from which map; and a page at / that shows why.",
        "imgloc serve office.yaml",
        "imgloc serve floors --port 8080 --threads 4",
        "curl -X POST -T scans.npz 'http://127.0.0.1:8080/v1/localize?index=3'",
        "IMGLOC_TOKEN=... imgloc serve office.yaml --host 0.0.0.0",
    ),
    "open": (
        "Look at a map and scans in the browser: answers in place, and why.",
        "imgloc open office.yaml",
        "imgloc open office.yaml scans.npz",
    ),
}
_MAP: Mapping[str, tuple[str, ...]] = {
    "check": (
        "Report what is in a map, and what is likely to be wrong with it.",
        "imgloc map check office.yaml",
        "imgloc map check a.yaml --json",
        "imgloc map check office.png --resolution 0.05 --negate --write office-read.yaml",
    ),
    "show": (
        "Draw a map, or what is computed from it, into a PNG.",
        "imgloc map show office.yaml --out office-view.png",
        "imgloc map show office.yaml --what surface --out normals.png",
        "imgloc map show office.yaml --what visibility --at 3.5,2 --out fan.png",
        "imgloc map show office.yaml --what likelihood --scans scan.csv --out where.png",
    ),
    "align": (
        "Find where map B lies in the frame of map A, and how well the two agree.",
        "imgloc map align office.yaml office-new.yaml --picture both.png",
        "imgloc map align new.yaml old.yaml --move waypoints.csv --out waypoints-new.csv",
        "imgloc map align a.yaml b.yaml --scans run.bag --json",
        "imgloc map align a.yaml drawing.yaml --scale --write drawing-in-a.yaml",
    ),
    "changes": (
        "Find where a map has aged: walls that rays pass (gone), surfaces where it has none (new).",
        "imgloc map changes office.yaml run.log --out aged.png",
        "imgloc map changes office.yaml monday.bag tuesday.bag --update office-mended.yaml",
        "imgloc map changes office.yaml scans.npz --range-max 20 --json",
    ),
    "plan": (
        "Make a map of a floor plan: walls as they stand, doors open, nothing else.",
        "imgloc map plan drawing.png --resolution 0.02 --out office.yaml --picture plan-check.png",
        "imgloc map plan drawing.jpg --distance 210,880,1650,880,24.5 --out office.yaml",
    ),
}
_CACHE: Mapping[str, tuple[str, ...]] = {
    "clear": (
        "Remove all prepared maps; they are prepared anew when they are needed.",
        "imgloc cache clear",
    ),
}
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


def examples(*lines: str, more: str = "") -> str:
    """Format examples for the end of a help text, one a line, and `more` before, as it is."""
    text = "\b\nExamples:\n" + "\n".join("  " + line for line in lines)
    return (f"\b\n{more.strip()}\n\n" if more else "") + text


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
        for name, (about, *lines) in commands.items():
            if (run := made(name)) is _unmade:
                groups[group].command(name, help=about)(run)
                continue
            # The file of a command may have a class of its own, and what comes before examples.
            file = sys.modules[run.__module__]
            kind, more = getattr(file, "RosCommand", Command), getattr(file, "FORMATS", "")
            groups[group].command(name, cls=kind, epilog=examples(*lines, more=more))(run)
    app = groups[""]
    app.callback(help=_HELP, epilog=examples(*_EXAMPLES))(with_options_of_program(root, *shared))
    app.add_typer(
        groups["map"], name="map", help="Look at maps, compare them, or make one of a floor plan."
    )
    groups["cache"].callback(help=_CACHED, epilog=examples(*_CACHES))(made("cache"))
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
