"""Options that several commands have, and the checks of their values."""

import functools
import inspect
import os
from collections.abc import Callable
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypedDict, TypeVar

import typer

from imgloc.cli.console import configure
from imgloc.cli.files import find_map
from imgloc.cli.values import byte_count, check_yaw, numbers
from imgloc.errors import ConfigError

if TYPE_CHECKING:
    from imgloc.model import LaserScan

F = TypeVar("F", bound=Callable[..., None])


class MethodName(StrEnum):
    """Names of the methods; spelled out, as loading the methods themselves takes a while."""

    FUSED = "fused"
    CBML = "cbml"
    CBML_O = "cbml-o"
    GHT = "ght"
    GHT_V = "ght-v"
    BEAM = "beam"


class EngineName(StrEnum):
    """Engines of the correlations."""

    AUTO = "auto"
    FILTER2D = "filter2d"
    SHIFT = "shift"
    DFT = "dft"
    REMAP = "remap"


class ModeName(StrEnum):
    """How map_server reads greys."""

    TRINARY = "trinary"
    SCALE = "scale"
    RAW = "raw"


class SemanticsName(StrEnum):
    """Whose map_server."""

    NAV2 = "nav2"
    ROS1 = "ros1"


class Reading(TypedDict):
    """Keywords of :func:`imgloc.io.maps.load_map`, but for `allow_lossy`."""

    resolution: float | None
    origin: tuple[float, float, float] | None
    mode: str | None
    semantics: str
    occupied_thresh: float | None
    free_thresh: float | None
    negate: bool | None


MapPath = Annotated[
    Path,
    typer.Argument(
        metavar="MAP",
        callback=find_map,
        help="map_server YAML, an image with --resolution, or the name of a bundled map.",
    ),
]
ScansPath = Annotated[
    Path, typer.Argument(metavar="SCANS", help="Scans: .npz, .csv, .jsonl, .ndjson or .json.")
]
Flipped = Annotated[
    bool,
    typer.Option("--flipped", help="The sensor is upside down: its angles run clockwise."),
]
Force = Annotated[bool, typer.Option("--force", help="Overwrite output files that exist.")]
AsJson = Annotated[bool, typer.Option("--json", help="Machine-readable: a JSON object a line.")]
Threads = Annotated[
    int | None,
    typer.Option(
        min=1, metavar="N", help="Threads; no result depends on it. [default: all processors]"
    ),
]
MemoryBudget = Annotated[
    Any,
    typer.Option(
        metavar="BYTES",
        parser=byte_count,
        help="Refuse to take more memory, such as 512M or 2G. [default: half of what is available]",
    ),
]
AllowLossy = Annotated[bool, typer.Option("--allow-lossy", help="Accept a JPEG as the map.")]


def reading(
    resolution: Annotated[float | None, typer.Option(metavar="M", help="Metres per cell.")] = None,
    origin: Annotated[
        Any,
        typer.Option(
            metavar="X,Y,YAW",
            parser=numbers(3),
            help="Pose of the lower-left corner in the map frame: metres, metres, radians.",
        ),
    ] = None,
    mode: Annotated[ModeName | None, typer.Option(help="How greys are read.")] = None,
    semantics: Annotated[
        SemanticsName,
        typer.Option(help="Whose thresholds and transparency."),
    ] = SemanticsName.NAV2,
    occupied_thresh: Annotated[
        float | None,
        typer.Option(metavar="P", help="Occupied from here on, 0..1."),
    ] = None,
    free_thresh: Annotated[
        float | None,
        typer.Option(metavar="P", help="Free up to here, 0..1."),
    ] = None,
    negate: Annotated[
        bool | None,
        typer.Option("--negate/--no-negate", help="White is a wall."),
    ] = None,
) -> Reading:
    """Options that say how a map is read; they override its YAML."""
    if origin is not None:
        check_yaw("--origin", origin[2])
    return Reading(
        resolution=resolution,
        origin=origin,
        mode=None if mode is None else mode.value,
        semantics=semantics.value,
        occupied_thresh=occupied_thresh,
        free_thresh=free_thresh,
        negate=negate,
    )


def console(
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Say what is done.")] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks of errors.")] = False,
) -> None:
    """Options about what is said on standard error."""
    configure(verbose=verbose, debug=debug)


def with_options(*groups: Callable[..., Any]) -> Callable[[F], Callable[..., None]]:
    """Give a command the options of other functions.

    Each of `groups` is called with the options that its signature declares; what it returns is
    passed to the command under the function's name, if the command has such a parameter.
    """

    def decorate(command: F) -> Callable[..., None]:
        own = inspect.signature(command).parameters
        names = [group.__name__ for group in groups]
        shared = [inspect.signature(group).parameters for group in groups]
        parameters = [p for p in own.values() if p.name not in names]
        parameters += [p for part in shared for p in part.values()]

        @functools.wraps(command)
        def run(**values: Any) -> None:
            for name, group, part in zip(names, groups, shared, strict=True):
                made = group(**{key: values.pop(key) for key in part})
                if name in own:
                    values[name] = made
            command(**values)

        signature = inspect.Signature(
            [p.replace(kind=inspect.Parameter.KEYWORD_ONLY) for p in parameters]
        )
        run.__signature__ = signature  # type: ignore[attr-defined]
        run.__annotations__ = {p.name: p.annotation for p in parameters}
        return run

    return decorate


def examples(*lines: str) -> str:
    """Format examples for the end of a help text, one a line."""
    return "\b\nExamples:\n" + "\n".join("  " + line for line in lines)


def count_threads(wanted: int | None) -> int:
    """Return `wanted`, or the number of processors that this process may use."""
    if wanted is not None:
        return wanted
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def cut_scan(scan: "LaserScan", range_max: float | None, *, flipped: bool = False) -> "LaserScan":
    """Return the scan that a sensor with a shorter reach, or one upright, would have recorded.

    Raises
    ------
    ConfigError
        If it would not reach beyond `range_min`.
    """
    scan = scan.flipped if flipped else scan
    if range_max is None or range_max >= scan.range_max:
        return scan
    if range_max <= scan.range_min:
        raise ConfigError(
            f"--range-max: got {range_max:g}, expected more than range_min, {scan.range_min:g} m"
        )
    return replace(scan, range_max=range_max)
