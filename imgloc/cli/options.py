"""Options that several commands have: how they are declared, parsed and checked."""

import functools
import inspect
import math
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, TypeVar

import typer

from imgloc.cli.console import configure
from imgloc.errors import ConfigError

if TYPE_CHECKING:
    from imgloc.io.maps import Reading as Reading
    from imgloc.io.scanset import Chosen as Chosen
    from imgloc.model import Pose2D
    from imgloc.options import Tolerance
    from imgloc.simulation.scans import Sensor as Sensor

F = TypeVar("F", bound=Callable[..., None])
Range = tuple[float, float, str]  # lowest, highest, unit
_UNITS = {"": 0, "K": 10, "M": 20, "G": 30, "T": 40}
RADIUS, TOLERANCE = 2.0, 0.8
"""How far from --near a robot may be, and turned how far, unless stated: metres, radians."""


# Names that the help needs, spelled out: to load where they are defined takes a while.
MethodName = StrEnum(
    "MethodName",
    (("FUSED", "fused"), ("CBML", "cbml"), ("CBML_O", "cbml-o"), ("GHT", "ght"),
     ("GHT_V", "ght-v"), ("BEAM", "beam")),
)  # fmt: skip
FilterName = StrEnum("FilterName", ("TRACKER", "GRID", "PARTICLE"))
EngineName = StrEnum("EngineName", ("AUTO", "FILTER2D", "SHIFT", "DFT", "REMAP"))
ModeName = StrEnum("ModeName", ("TRINARY", "SCALE", "RAW"))
SemanticsName = StrEnum("SemanticsName", ("NAV2", "ROS1"))


def byte_count(text: str) -> int:
    """Parse a number of bytes, with a unit of powers of 1024 or none."""
    found = re.fullmatch(r"(\d+(?:\.\d*)?)\s*([KMGT]?)(?:i?B)?", text.strip(), re.IGNORECASE)
    if found is None:
        raise typer.BadParameter(f"got {text!r}, expected a number of bytes such as 512M or 2G")
    return int(float(found[1]) * (1 << _UNITS[found[2].upper()]))


def numbers(
    least: int, rest: tuple[float, ...] = (), *, pose: str = "", angles: Sequence[int] = ()
) -> Callable[[str], tuple[float, ...]]:
    """Return a parser of `least` finite numbers with commas between them, or more.

    Of those that may follow, `rest` is what they are if they do not. The third may be the yaw of
    the option `pose`, which is refused if it was meant in degrees. Those at `angles`, and that yaw,
    may be written as degrees: 90deg.
    """
    angles, most = (2,) if pose else angles, least + len(rest)
    count = f"{least}" if least == most else f"{least} to {most}"

    def value_of(k: int, word: str) -> float:
        if k not in angles or not word.endswith("deg"):
            return float(word)
        if abs(degrees := float(word[:-3])) > 360:
            raise typer.BadParameter(f"got {word}, expected -360deg to 360deg")
        return math.radians(degrees)

    def parse(text: str) -> tuple[float, ...]:
        try:
            values = tuple(value_of(k, word.strip()) for k, word in enumerate(text.split(",")))
        except ValueError:
            values = ()
        if not least <= len(values) <= most or not all(map(math.isfinite, values)):
            raise typer.BadParameter(f"got {text!r}, expected {count} numbers with commas between")
        if pose:
            check_yaw(pose, values[2])
        return values + rest[len(values) - least :]

    return parse


def find_map(path: str | Path) -> Path:
    """The file of a bundled map that is called by its name, or `path` itself."""
    from imgloc.errors import MapError
    from imgloc.io.files import is_file, is_there
    from imgloc.io.maps import bundled_maps
    from imgloc.io.scans import SCAN_ENDINGS

    path = Path(path)
    if path.suffix.lower() in SCAN_ENDINGS and is_there(path):
        raise ConfigError(f"MAP: {path} is a file of scans; the order is MAP, then SCANS")
    if path.name != str(path) or path.suffix or is_there(path):
        return path
    try:
        bundled = bundled_maps() / f"{path}.yaml"
    except MapError:
        return path
    return bundled if is_file(bundled) else path


def find_scans(path: Path) -> Path:
    """`path` itself, unless it is an image."""
    from imgloc.io.images import IMAGE_ENDINGS, LOSSY_ENDINGS

    if path.suffix.lower() in (*IMAGE_ENDINGS, *LOSSY_ENDINGS):
        raise ConfigError(f"SCANS: {path} is an image; the order is MAP, then SCANS")
    return path


def pose_of(name: str, text: str) -> Any:
    """Declare the option `name` that is a pose: metres, metres, radians."""
    return option(None, "X,Y,YAW", text, parser=numbers(3, pose=name))


def option(
    default: Any, metavar: str, text: str, *names: str, within: Range | None = None, **more: Any
) -> Any:
    """Declare an option: what stands for its value in the help, and what it is.

    A value must be `within` a lowest and a highest one, in the unit that is the third.
    """
    if within is not None:

        def check(param: typer.CallbackParam, value: Any) -> Any:
            check_range(param.opts[0], value, *within)
            return value

        more["callback"] = check
    return typer.Option(default, *names, metavar=metavar, help=text, **more)


def flag(names: str, text: str, default: Any = False) -> Any:
    """Declare an option without a value."""
    return typer.Option(default, names, help=text)


MapPath = Annotated[
    Path,
    typer.Argument(
        metavar="MAP",
        callback=find_map,
        help="map_server YAML, an image with --resolution, or the name of a bundled map.",
    ),
]
ScansPath = Annotated[
    Path,
    typer.Argument(
        metavar="SCANS",
        callback=find_scans,
        help="Scans: .npz, .csv, .jsonl, .json; a CARMEN .log; a ROS .bag, .mcap, .db3 or the "
        "folder of a recording; .yaml of `ros2 topic echo -f`; - is standard input.",
    ),
]
ScansPaths = Annotated[
    list[Path],
    typer.Argument(
        metavar="SCANS...",
        callback=lambda paths: [find_scans(path) for path in paths],
        help="Files of scans, formats below; - is standard input.",
    ),
]
FORMATS = """
Scans (ranges in metres, angles in radians, counter-clockwise, 0 forward):
  .csv                    a scan a line; or two columns, angle and range, a reading a line:
                            # angle_min=-1.5708, angle_max=1.5708, range_max=30
                            2.31,2.30,nan,inf,1.02
                            2.33,2.31,2.29,inf,1.01
  .jsonl, .json           an object a line, with the names of sensor_msgs/LaserScan:
                            {"angle_min": -1.57, "angle_increment": 0.785, "range_max": 30,
                             "ranges": [2.31, 2.30, null, "inf", 1.02]}
  .npz                    ranges (N,B), angles (B,), range_max; poses (N,3), stamps, odom
  .log, .clf              CARMEN: FLASER, ROBOTLASER1, RAWLASER1, ODOM, PARAM
  .bag, .mcap, .db3       ROS 1 and 2, or the folder of a recording (pip install 'imgloc[ros]')
  .yaml                   ros2 topic echo -f /scan > scans.yaml
  -                       standard input, any of these
"""
_CLEARANCE = (0, 1000, "metres")
_READINGS = "Cut readings at M metres: there, no return."
Cut = Annotated[float | None, option(..., "M", _READINGS, within=(1e-3, 1e6, "metres"))]
Index = Annotated[int | None, option(..., "I", "Only scan I, counted from 0.", "--index", min=0)]
SHARE = (0, 1, "a share")
REACH = (0.01, 10_000, "metres")
Reach = Annotated[float, option(..., "M", "Reach of the sensor, metres.", within=REACH)]
Seed = Annotated[int, option(..., "N", "Seed of everything random.", min=0)]
SIDE = (0.001, 10, "metres")
Cell = Annotated[float, option(..., "M", "Cell of the poses, metres.", within=SIDE)]
STEP = (0.05, 180, "degrees")
_OWN = "Step of the headings. [default: the method's own]"
StepDeg = Annotated[float | None, option(..., "DEG", _OWN, within=STEP)]
_LISTED = "Hypotheses listed. [default: 5, or what holds 95 % of the mass]"
Top = Annotated[int | None, option(..., "N", _LISTED, min=1)]
_KEPT = "Where prepared maps are kept. [default: the user's cache folder]"
CacheDir = Annotated[Path | None, option(..., "DIR", _KEPT)]
NoCache = Annotated[bool, flag("--no-cache", "Prepare the map anew and keep nothing.", ...)]
Flipped = Annotated[
    bool, flag("--flipped", "The sensor is upside down: its angles run clockwise.", ...)
]
Force = Annotated[bool, flag("--force", "Overwrite output files that exist.", ...)]
AsJson = Annotated[bool, flag("--json", "Machine-readable: a JSON object a line.", ...)]
_MEMORY = "Refuse to take more memory, such as 512M or 2G. [default: half of what is available]"
MemoryBudget = Annotated[Any, option(..., "BYTES", _MEMORY, parser=byte_count)]
AllowLossy = Annotated[bool, flag("--allow-lossy", "Accept a JPEG as the map.", ...)]


def reading(
    resolution: float | None = option(None, "M", "Metres per cell."),
    origin: Any = pose_of(
        "--origin", "Pose of the lower-left corner in the map frame: metres, metres, radians."
    ),
    mode: ModeName | None = typer.Option(None, help="How greys are read."),
    semantics: SemanticsName = typer.Option(
        SemanticsName.NAV2, help="Whose thresholds and transparency."
    ),
    occupied_thresh: float | None = option(None, "P", "Occupied from here on, 0..1."),
    free_thresh: float | None = option(None, "P", "Free up to here, 0..1."),
    negate: bool | None = flag("--negate/--no-negate", "White is a wall.", None),
) -> "Reading":
    """Options that say how a map is read; they override its YAML."""
    return {
        "resolution": resolution,
        "origin": origin,
        "mode": None if mode is None else mode.value,
        "semantics": semantics.value,
        "occupied_thresh": occupied_thresh,
        "free_thresh": free_thresh,
        "negate": negate,
    }


def chosen(
    index: list[str] | None = option(
        None,
        "LIST",
        "Only these scans, counted from 0: 3 or 3,7,10:20 (without 20) or ::10 (every tenth); "
        "may be repeated.",
    ),
    sample: int | None = option(
        None, "N", "Of these only N, at random; the same ones each time.", min=1
    ),
    sample_seed: int = option(1, "N", "Seed that decides which.", min=0),
) -> "Chosen":
    """Options of which scans of a file are looked at."""
    from imgloc.io.scanset import Chosen

    return Chosen(",".join(index) if index else None, sample, sample_seed)


class Resources(NamedTuple):
    """What a command may take to its end: threads, and bytes of memory."""

    threads: int
    memory_budget: int


def taken(
    threads: int | None = option(
        None, "N", "Threads; no result depends on it. [default: all processors]", min=1
    ),
    memory_budget: MemoryBudget = None,
) -> Resources:
    """Options of what a command may take."""
    import cv2

    cv2.setNumThreads(count_threads(threads))
    return Resources(count_threads(threads), fixed_budget(memory_budget))


def fixed_budget(memory_budget: int | None) -> int:
    """Bytes that a command may take to its end: by default half of what is there at its start."""
    from imgloc.features.budget import default_budget

    return default_budget() if memory_budget is None else memory_budget


def count_threads(wanted: int | None) -> int:
    """Return `wanted`, or the number of processors that this process may use."""
    if wanted is None and hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return wanted or os.cpu_count() or 1


def console(
    verbose: bool = typer.Option(False, "--verbose", "-v", help="Say what is done."),
    debug: bool = flag("--debug", "Show tracebacks of errors."),
) -> None:
    """Options about what is said on standard error."""
    configure(verbose=verbose, debug=debug)


class Known(NamedTuple):
    """What the options say of the pose, map frame; None where they say nothing."""

    near: tuple[float, float, float, float, float] | None
    heading: tuple[float, float] | None
    region: Path | None
    clearance: float | None


NEAR = option(
    None,
    "X,Y,YAW[,R[,T]]",
    "Only poses within R metres of a pose in the map frame and turned from it by at "
    f"most T radians, or 90deg. [default: R = {RADIUS:g}, T = {TOLERANCE:g}]",
    parser=numbers(3, (RADIUS, TOLERANCE), angles=(2, 4)),
)
HEADING = option(
    None,
    "YAW[,T]",
    "Only poses with this heading in the map frame (a compass), up to T; radians, or 90deg. "
    f"[default: T = {TOLERANCE:g}]",
    parser=numbers(1, (TOLERANCE,), angles=(0, 1)),
)


def known(
    near: Any = NEAR,
    heading: Any = HEADING,
    region: Path | None = option(
        None, "PNG", "Only poses in the white part of an image as large as the map's."
    ),
    clearance: float | None = option(
        None,
        "M",
        "Only poses at least M metres from what is not free: the robot's size.",
        within=_CLEARANCE,
    ),
) -> Known:
    """Options of the prior."""
    check_known(near, heading)
    return Known(near, heading, region, clearance)


def check_known(near: tuple[float, ...] | None, heading: tuple[float, ...] | None) -> None:
    """Refuse poses in degrees, and limits out of their ranges."""
    if near is not None:
        check_range("--near, R", near[3], 0.01, 1e6, "metres")
    for option, given in (("--near", near), ("--heading", heading)):
        if given is not None:
            check_yaw(option, given[2 if given is near else 0])
            check_range(f"{option}, T", given[-1], 0.001, 3.2, "radians")


class Logs(NamedTuple):
    """What to take of a log, and what it may not say."""

    topic: str | None = None
    fov: float | None = None  # radians
    scale: float = 1.0


RANGE_SCALE: Any = option(
    1.0, "F", "Metres of a range: 0.001 of millimetres.", within=(1e-6, 1e6, "a factor")
)


def logs(
    topic: str | None = option(
        None,
        "NAME",
        "Of a log with several lasers, this one, or with commas some. [default: the front laser]",
    ),
    fov_deg: float | None = option(
        None,
        "DEG",
        "Angle from the first to the last ray, where the file does not say it.",
        within=(0.01, 360, "degrees"),
    ),
    range_scale: float = RANGE_SCALE,
) -> Logs:
    """Options of how files of scans are read."""
    return Logs(topic, None if fov_deg is None else math.radians(fov_deg), range_scale)


@dataclass(frozen=True)
class Mounting:
    """How the sensor sits on the robot."""

    sensor: tuple[float, float, float] | None
    flipped: bool

    def __post_init__(self) -> None:
        from imgloc.model import check_mount

        if self.pose is not None:
            check_mount(self.pose, "--sensor")

    @property
    def pose(self) -> "Pose2D | None":
        """Pose of the sensor on the robot, if it was given."""
        from imgloc.model import Pose2D

        return None if self.sensor is None else Pose2D(*self.sensor)


def mounting(
    sensor: Any = pose_of(
        "--sensor",
        "Pose of the sensor on the robot (metres; radians, or 90deg): poses of the base are given "
        "too.",
    ),
    flipped: Flipped = False,
) -> Mounting:
    """Options of the mounting."""
    return Mounting(sensor, flipped)


def sensor(
    rays: int = option(181, "N", "Readings of a scan.", min=1),
    fov_deg: float = option(
        180.0, "DEG", "Angle that a scan covers, degrees.", within=(0.01, 360, "degrees")
    ),
    sigma: float = option(
        0.02, "M", "Standard deviation of a reading's noise, metres.", within=(0, 10, "metres")
    ),
    outliers: float = option(
        0.0, "P", "Share of the rays that something unmapped stops, 0..1.", within=SHARE
    ),
    dropped: float = option(
        0.0, "P", "Share of the rays that give no measurement, 0..1.", within=SHARE
    ),
    clearance: float = option(
        0.3, "M", "Least distance of the robot from what is not free, metres.", within=_CLEARANCE
    ),
    mount: Any = pose_of(
        "--mount", "Pose of the sensor on the robot: metres, metres, radians. [default: 0,0,0]"
    ),
) -> "Sensor":
    """Options of a simulated sensor, but for its reach."""
    from imgloc.model import Pose2D
    from imgloc.simulation.scans import Sensor

    fov, pose = math.radians(fov_deg), Pose2D(*(mount or (0.0, 0.0, 0.0)))
    return Sensor(
        rays, fov, sigma, outliers=outliers, dropped=dropped, clearance=clearance, mount=pose
    )


def check_yaw(option: str, yaw: float) -> None:
    """Refuse an angle that was meant in degrees."""
    if abs(yaw) > 2 * math.pi + 1e-6:
        raise ConfigError(
            f"{option}: got a yaw of {yaw:g}, expected radians, -6.2832 to 6.2832; are these "
            f"degrees? write {yaw:g}deg, or multiply them by pi / 180"
        )


def check_range(option: str, value: float | None, low: float, high: float, unit: str) -> None:
    """Refuse a value that is not in ``low..high``; None, an option not given, passes."""
    if value is not None and not low <= value <= high:  # NaN fails both
        raise ConfigError(f"{option}: got {value:g}, expected {unit}, {low:g} to {high:g}")


def number_of(option: str, text: str, low: float, high: float, unit: str) -> float:
    """Parse a number that is to be in ``low..high``; the errors name the option."""
    try:
        value = float(text)
    except ValueError:
        raise ConfigError(f"{option}: got {text!r}, expected a number") from None
    check_range(option, value, low, high, unit)
    return value


def tolerance_of(text: str) -> "Tolerance":
    """How near a known pose is a hit, of --tolerance M,DEG."""
    from imgloc.options import Tolerance

    metres, comma, degrees = text.partition(",")
    if not comma:
        raise ConfigError(f"--tolerance: got {text!r}, expected metres and degrees, M,DEG")
    away = number_of("--tolerance", metres, 1e-6, 1e6, "metres")
    return Tolerance(away, math.radians(number_of("--tolerance", degrees, 1e-6, 360, "degrees")))


def methods_of(text: str, known: Sequence[str]) -> list[str]:
    """Names of methods with commas between, each once, in the order given."""
    return names_of("--methods", text, known)


def names_of(option: str, text: str, known: Sequence[str]) -> list[str]:
    """Names with commas between, each once, in the order given; all have to be `known`."""
    names = [name.strip() for name in text.split(",")]
    if (name := next((n for n in names if n not in known), None)) is not None:
        raise ConfigError(f"{option}: got {name!r}, expected {','.join(known)} or some of them")
    return list(dict.fromkeys(names))


def for_each(
    option: str,
    texts: Sequence[str] | None,
    methods: Sequence[str],
    low: float,
    high: float,
    unit: str,
) -> dict[str, float]:
    """Values by method of an option given as VALUE, for all, or METHOD=VALUE.

    Examples
    --------
    >>> for_each("--cell", ["ght=0.2", "0.1"], ["ght", "beam"], 0, 1, "metres")
    {'ght': 0.2, 'beam': 0.1}
    """
    out: dict[str, float] = {}
    for text in sorted(texts or (), key=lambda t: "=" in t):  # those for one method win
        name, _, number = text.rpartition("=")
        if name and name not in methods:
            raise ConfigError(f"{option}: got {text!r}, {name!r} is not one of --methods")
        value = number_of(option, number, low, high, unit)
        out |= dict.fromkeys([name] if name else methods, value)
    return out


def with_options(*groups: Callable[..., Any]) -> Callable[[F], Callable[..., None]]:
    """Give a command the options of other functions.

    Each of `groups` is called with the options that its signature declares; what it returns is
    passed to the command under the function's name, if the command has such a parameter.
    """
    shared = {group: inspect.signature(group).parameters for group in groups}

    def decorate(command: F) -> Callable[..., None]:
        own = inspect.signature(command).parameters
        names = {group.__name__ for group in groups}
        parameters = [p for p in own.values() if p.name not in names]
        parameters += [p for part in shared.values() for p in part.values()]

        @functools.wraps(command)
        def run(**values: Any) -> None:
            for group, part in shared.items():
                made = group(**{key: values.pop(key) for key in part})
                if group.__name__ in own:
                    values[group.__name__] = made
            command(**values)

        parameters = [p.replace(kind=inspect.Parameter.KEYWORD_ONLY) for p in parameters]
        run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        run.__annotations__ = {p.name: p.annotation for p in parameters}
        return run

    return decorate


def given(context: typer.Context, of: Mapping[str, Sequence[str]], ways: set[str]) -> set[str]:
    """Names of the options that were given, none of which is of other ways to work alone.

    `of` says of which ways an option is that others would not notice.
    """
    names = set()
    for parameter in context.command.params:
        name = parameter.name or ""
        source = context.get_parameter_source(name)
        if source is None or source.name != "COMMANDLINE":
            continue
        names.add(name)
        if name in of and ways.isdisjoint(of[name]):
            option, theirs = max(parameter.opts, key=len), ", ".join(of[name])
            raise ConfigError(f"{option}: is of {theirs}, not of {' or '.join(sorted(ways))}")
    return names


def examples(*lines: str, more: str = "") -> str:
    """Format examples for the end of a help text, one a line, and `more` before, as it is."""
    text = "\b\nExamples:\n" + "\n".join("  " + line for line in lines)
    return (f"\b\n{more.strip()}\n\n" if more else "") + text
