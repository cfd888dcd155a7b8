"""The YAML beside a map image (ROS map_server), read without trusting it."""

import math
import re
from collections.abc import Callable, Container
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from imgloc.errors import MapError
from imgloc.io.files import PathLike, display, open_file, read_file
from imgloc.io.plainyaml import plain_yaml
from imgloc.io.text import decoded
from imgloc.model import Pose2D

MAX_YAML_BYTES = 65_536
YAML_ENDINGS = (".yaml", ".yml")
_MOST = 256  # keys and values; imgloc knows nine keys
MODES = ("trinary", "scale", "raw")
SEMANTICS = ("nav2", "ros1")
RESOLUTION_RANGE = (0.001, 10.0)
# YAML 1.1, hence PyYAML, takes `5e-2` and `-.5` for strings.
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
_COMMA = re.compile(r"[-+]?\d*,\d+")


def _number(value: Any) -> float:
    """Return a YAML scalar as a float, NaN if it is none."""
    if isinstance(value, str) and _NUMBER.fullmatch(value.strip()):
        return float(value)
    if isinstance(value, bool) or not isinstance(value, int | float):
        return math.nan
    return float(value) if abs(value) < 1e300 else math.inf


def _number_in(low: float, high: float) -> Callable[[Any], float | None]:
    return lambda value: number if low <= (number := _number(value)) <= high else None


def _triple(value: Any) -> list[float] | None:
    numbers = [_number(v) for v in value] if isinstance(value, list) else []
    return numbers if len(numbers) == 3 and all(abs(n) < 1e9 for n in numbers) else None


def _path(value: Any) -> str | None:
    return value if isinstance(value, str) and value.strip() and "\0" not in value else None


def _pose(value: list[float]) -> Pose2D | None:
    return Pose2D(*value) if abs(value[2]) <= 2 * math.pi + 1e-6 else None


_CHECKS: tuple[tuple[str, Callable[[Any], Any], str], ...] = (
    ("image", _path, "the path of the image"),
    ("mode", lambda v: m if (m := str(v).lower()) in MODES else None, "trinary, scale or raw"),
    ("semantics", lambda v: v if v in SEMANTICS else None, "nav2 or ros1"),
    ("negate", lambda v: bool(v) if v in (0, 1) else None, "0 or 1"),
    ("resolution", _number_in(*RESOLUTION_RANGE), "metres per cell, 0.001 to 10"),
    ("origin", _triple, "[x, y, yaw] in metres and radians"),
    ("origin", _pose, "a yaw in radians, -6.2832 to 6.2832"),
    ("occupied_thresh", _number_in(0, 1), "an occupancy from 0 to 1"),
    ("free_thresh", _number_in(0, 1), "an occupancy from 0 to 1"),
    ("movable", _number_in(1, 254), "a grey level of the image, 1 to 254"),
)
"""Keys of the YAML: what makes a value of them, or None of a wrong one, and what is expected."""
_KEYS = frozenset(key for key, _, _ in _CHECKS)


@dataclass(frozen=True)
class MapYaml:
    """The contents of a map's YAML; None for a key that it has not."""

    path: Path
    image: Path  #: relative to the YAML's folder
    resolution: float | None = None  #: metres per cell
    origin: Pose2D | None = None  #: of the lower-left corner of the lower-left pixel, map frame
    mode: str | None = None  #: ``trinary``, ``scale`` or ``raw``
    semantics: str | None = None  #: ``nav2`` or ``ros1``; a key of imgloc's own
    negate: bool | None = None  #: whether white is occupied
    occupied_thresh: float | None = None  #: an occupancy, 0..1, as the next
    free_thresh: float | None = None
    movable: float | None = None  #: grey level of what may stand there or not; map_server: free
    unknown_keys: tuple[str, ...] = ()  #: mean nothing here; often a slip of the pen

    @property
    def slips(self) -> list[str]:
        """Unknown keys that are nearly a known one."""
        return [k for k in self.unknown_keys if get_close_matches(k, _KEYS, cutoff=0.8)]


def load_map_yaml(path: PathLike, given: Container[str] = ()) -> MapYaml:
    """Read a map's YAML, of at most 64 KB; in all else as :func:`parse_map_yaml`."""
    with open_file(path, limit=1 << 40, error=MapError, what="map YAML") as (file, _):
        if re.search(rb"^(info|data):", file.read(MAX_YAML_BYTES), re.MULTILINE):
            said = "a map as ros2 topic echo prints it; map_saver_cli saves it as image and YAML"
            raise MapError(f"{display(path)}: {said}")
    data = read_file(path, limit=MAX_YAML_BYTES, error=MapError, what="map YAML")
    return parse_map_yaml(data, Path(path), given)


def image_named(path: PathLike) -> Path:
    """The image that a map's YAML names; nothing else of the YAML is judged."""
    return load_map_yaml(path, _KEYS - {"image"}).image


def parse_map_yaml(data: bytes, path: Path, given: Container[str] = ()) -> MapYaml:
    r"""Parse the text of a map's YAML; `path` names it and anchors the image's path.

    The values of keys that are `given` elsewhere may be wrong: then nothing is said of them.

    MapError names the file, the key, the value, and what was expected; or what is not plain, see
    :func:`~imgloc.io.plainyaml.plain_yaml`.

    Examples
    --------
    >>> text = b"image: a.png\nresolution: 5e-2\norigin: [-.5, 0, 0]\n"
    >>> y = parse_map_yaml(text, Path("maps/a.yaml"))
    >>> y.resolution, y.origin.x, y.image.as_posix()
    (0.05, -0.5, 'maps/a.png')
    """
    name = display(path)
    try:
        text = decoded(data)
    except UnicodeDecodeError as e:
        raise MapError(f"{name}: byte {e.start} is not UTF-8 text; expected a map YAML") from None
    values = plain_yaml(text, name, MapError, most=_MOST)
    if not isinstance(values, dict):
        raise MapError(f"{name}: expected lines of 'key: value' (image, resolution, origin)")
    said: dict[str, Any] = {key: values.get(key) for key in _KEYS}
    for key, convert, expected in _CHECKS:
        if said[key] is None and key != "image":
            continue
        said[key] = convert(said[key])
        if said[key] is None and key not in given:
            if key not in values:
                hint = f", got {', '.join(map(str, values))}"[:80] * (key == "image")
                raise MapError(f"{name}: {key}: missing, expected {expected}{hint}")
            shown = repr(values[key])
            shown = shown if len(shown) <= 60 else shown[:57] + "..."
            hint = "; write a decimal point, not a comma" if _COMMA.search(shown) else ""
            hint += f"; or pass `{key}`" if key != "image" else ""
            raise MapError(f"{name}: {key}: got {shown}, expected {expected}{hint}")
    unknown = tuple(str(key) for key in values if key not in _KEYS)
    return MapYaml(path, path.parent / said.pop("image"), unknown_keys=unknown, **said)
