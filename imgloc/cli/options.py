"""Shared by several commands: arguments, files, and what each may take of the machine."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

from imgloc.cli.command import Given, Only
from imgloc.cli.program import AsJson as AsJson
from imgloc.cli.program import Force as Force
from imgloc.cli.program import Kept as Kept
from imgloc.cli.program import MemoryBudget as MemoryBudget
from imgloc.cli.program import Resources as Resources
from imgloc.cli.program import count_threads as count_threads
from imgloc.cli.program import fixed_budget as fixed_budget
from imgloc.errors import ConfigError, MapError
from imgloc.options import Count, Logs, Reading, Tolerance
from imgloc.ranges import Option
from imgloc.texts import metres_degrees


def find_map(path: str | Path) -> Path:
    """The file of a bundled map that is called by its name, or `path` itself."""
    from imgloc.io.bags import BAG_ENDINGS
    from imgloc.io.files import is_there
    from imgloc.io.maps import named_map
    from imgloc.io.remote import local
    from imgloc.io.scans import SCAN_ENDINGS

    path = local(path, MapError)
    ending = path.suffix.lower()
    if ending in SCAN_ENDINGS and ending not in BAG_ENDINGS and is_there(path):
        raise ConfigError(f"{path} is a file of scans, no map; the order is MAP, then SCANS")
    return named_map(path)


def find_file(path: str | Path) -> Path:
    """`path` itself; of an address a copy."""
    from imgloc.io.remote import local

    return local(path)


def find_scans(path: str | Path) -> Path:
    """`path` itself, unless it is an image; of an address a copy."""
    from imgloc.io.images import IMAGE_ENDINGS, LOSSY_ENDINGS
    from imgloc.io.remote import local

    path = local(path)
    if path.suffix.lower() in (*IMAGE_ENDINGS, *LOSSY_ENDINGS):
        raise ConfigError(f"{path} is an image; the order is MAP, then SCANS")
    return path


MapPath = Annotated[
    Path,
    Option(
        "Map: the YAML of map_server, an image with --resolution, a bag with an OccupancyGrid, or "
        "the name of a bundled map.",
        "MAP",
        parse=find_map,
    ),
]
SCANS = (
    "Scans: .npz, .csv, .jsonl, .json; a CARMEN .log; a ROS .bag, .mcap, .db3 or the folder of a "
    "recording; .yaml of `ros2 topic echo -f`; - is standard input."
)
ScansPath = Annotated[Path, Option(SCANS, "SCANS", parse=find_scans)]
ScansPaths = Annotated[
    list[Path],
    Option("Files of scans, formats below; - is standard input.", "SCANS...", parse=find_scans),
]
Picture = Annotated[
    Path | None,
    Option(
        "Draw the scan at each hypothesis into this file; of several scans into NAME-0003.png "
        "and so on.",
        metavar="PNG",
    ),
]
Strict = Annotated[bool, Option("Exit with code 6 unless every scan is unique.")]
Workers = Annotated[
    Count | None, Option("Processes; no result depends on their number. [default: all processors]")
]
ToleranceOf = Annotated[
    Tolerance,
    Option(
        "Distance in metres and turn in degrees from the true pose up to which an answer is a "
        "hit. [default: 0.5,10]",
        "--tolerance",
        metavar="M,DEG",
        parse=lambda text: Tolerance(*metres_degrees(text)),
    ),
]


class MapImages(Reading, total=False):
    """Options by which images of maps are read."""

    allow_lossy: Annotated[bool, Option("Accept a map image with lossy compression, such as JPEG.")]


#: Where the map's YAML has the other options; `imgloc map check --write` puts them there.
MapSize = Annotated[MapImages, Only("resolution")]


#: Where `imgloc convert` makes a file that needs no other of these options.
LogTaken = Annotated[Logs, Only("topic", "fov", "scale", "range_max")]


def refuse_others(given: Given, ways: Mapping[str, Sequence[str]], way: set[str]) -> None:
    """Refuse an option that was typed and that none of these ways to work would notice.

    `ways` has the ways that notice an option.
    """
    for name in sorted(given & ways.keys()):
        if way.isdisjoint(ways[name]):
            theirs = ", ".join(ways[name])
            raise ConfigError(f"{name}: is for {theirs}, not for {' or '.join(sorted(way))}")
