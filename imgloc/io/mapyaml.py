"""The YAML beside a map image (ROS map_server), read without trusting it."""

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import yaml

from imgloc.errors import MapError
from imgloc.io.files import PathLike, display, read_file
from imgloc.model import Pose2D

MAX_YAML_BYTES = 65_536
MODES = ("trinary", "scale", "raw")
RESOLUTION_RANGE = (0.001, 10.0)
_KEYS = ("image", "resolution", "origin", "mode", "negate", "occupied_thresh", "free_thresh")
# YAML 1.1, hence PyYAML, takes `5e-2` and `-.5` for strings.
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
_COMMA = re.compile(r"[-+]?\d*,\d+")


@dataclass(frozen=True)
class MapYaml:
    """What a map's YAML says; None where it says nothing.

    Parameters
    ----------
    path, image : Path
        The YAML, and the image it names (relative to the YAML's folder).
    resolution : float or None
        Metres per cell.
    origin : Pose2D or None
        Pose of the lower-left corner of the lower-left pixel in the map frame.
    mode : str or None
        ``trinary``, ``scale`` or ``raw``.
    negate : bool or None
        Whether white is occupied.
    occupied_thresh, free_thresh : float or None
        Occupancies, 0..1.
    unknown_keys : tuple of str
        Keys that mean nothing here; often a slip of the pen.
    """

    path: Path
    image: Path
    resolution: float | None = None
    origin: Pose2D | None = None
    mode: str | None = None
    negate: bool | None = None
    occupied_thresh: float | None = None
    free_thresh: float | None = None
    unknown_keys: tuple[str, ...] = ()


def load_map_yaml(path: PathLike) -> MapYaml:
    """Read a map's YAML.

    At most 64 KB of plain YAML: aliases, tags, duplicate keys, several documents and deep
    nesting are refused, as no map needs them.

    Raises
    ------
    MapError
        Naming the file, the key, the value, and what was expected.
    """
    data = read_file(path, limit=MAX_YAML_BYTES, error=MapError, what="map YAML")
    return parse_map_yaml(data, Path(path))


def parse_map_yaml(data: bytes, path: Path) -> MapYaml:
    r"""Parse the text of a map's YAML; `path` names it and anchors the image's path.

    Raises
    ------
    MapError
        As :func:`load_map_yaml`.

    Examples
    --------
    >>> text = b"image: a.png\nresolution: 5e-2\norigin: [-.5, 0, 0]\n"
    >>> y = parse_map_yaml(text, Path("maps/a.yaml"))
    >>> y.resolution, y.origin.x, y.image.as_posix()
    (0.05, -0.5, 'maps/a.png')
    """
    name = display(path)
    values = _plain_mapping(data, name)
    image = values.get("image")
    if not isinstance(image, str) or not image.strip() or "\0" in image:
        _fail(name, "image", values, "the path of the image")
    mode = values.get("mode")
    if mode is not None:
        mode = mode.lower() if isinstance(mode, str) else None
        if mode not in MODES:
            _fail(name, "mode", values, "trinary, scale or raw")
    negate = values.get("negate")
    if negate not in (None, 0, 1, False, True):
        _fail(name, "negate", values, "0 or 1")
    origin = values.get("origin")
    return MapYaml(
        path,
        path.parent / image,
        _number_in(name, "resolution", values, RESOLUTION_RANGE, "metres per cell, 0.001 to 10"),
        None if origin is None else _origin(name, values),
        mode,
        None if negate is None else bool(negate),
        _number_in(name, "occupied_thresh", values, (0, 1), "an occupancy from 0 to 1"),
        _number_in(name, "free_thresh", values, (0, 1), "an occupancy from 0 to 1"),
        tuple(str(k) for k in values if k not in _KEYS),
    )


def _plain_mapping(data: bytes, name: str) -> dict[Any, Any]:
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as e:
        raise MapError(f"{name}: byte {e.start} is not UTF-8 text; expected a map YAML") from None
    try:
        _refuse_cleverness(text, name)
        root = yaml.compose(text, Loader=yaml.SafeLoader)
        if not isinstance(root, yaml.MappingNode):
            raise MapError(f"{name}: expected lines of 'key: value' (image, resolution, origin)")
        keys = [key.value if isinstance(key, yaml.ScalarNode) else "?" for key, _ in root.value]
        twice = next((k for k in keys if keys.count(k) > 1), None)
        if twice is not None:
            raise MapError(f"{name}: {twice}: given more than once, expected once")
        values: dict[Any, Any] = yaml.safe_load(text)
    except yaml.MarkedYAMLError as e:
        line = f" line {e.problem_mark.line + 1}:" if e.problem_mark else ""
        raise MapError(f"{name}:{line} not valid YAML: {e.problem}") from None
    except (yaml.YAMLError, ValueError, OverflowError, RecursionError) as e:
        reason = str(e).splitlines()[0] if str(e) else type(e).__name__
        raise MapError(f"{name}: not valid YAML: {reason}") from None
    return values


def _refuse_cleverness(text: str, name: str) -> None:
    """Refuse what a map does not need and what would make more of a text than it shows."""
    depth = documents = 0
    for event in yaml.parse(text, Loader=yaml.SafeLoader):
        documents += isinstance(event, yaml.DocumentStartEvent)
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        found = "nested too deeply" if depth > 8 else ""
        if isinstance(event, yaml.AliasEvent):
            found = f"YAML alias *{event.anchor}"
        elif isinstance(event, yaml.ScalarEvent | yaml.CollectionStartEvent) and event.tag:
            found = f"YAML tag {event.tag}"
        elif isinstance(event, yaml.ScalarEvent) and event.value == "<<":
            found = "merge key <<"
        line = event.start_mark.line + 1 if event.start_mark else 0
        if found:
            raise MapError(f"{name}: line {line}: {found}, expected plain values")
        if documents > 1:
            raise MapError(f"{name}: line {line}: a second document, expected one map")


def _fail(name: str, key: str, values: dict[Any, Any], expected: str) -> NoReturn:
    if key not in values:
        raise MapError(f"{name}: {key}: missing, expected {expected}")
    shown = repr(values[key])
    shown = shown if len(shown) <= 60 else shown[:57] + "..."
    hint = "; write a decimal point, not a comma" if _COMMA.search(shown) else ""
    raise MapError(f"{name}: {key}: got {shown}, expected {expected}{hint}")


def _number(value: Any) -> float:
    """Return a YAML scalar as a float, NaN if it is none."""
    if isinstance(value, str) and _NUMBER.fullmatch(value.strip()):
        return float(value)
    if isinstance(value, bool) or not isinstance(value, int | float):
        return math.nan
    return float(value) if abs(value) < 1e300 else math.inf


def _number_in(
    name: str, key: str, values: dict[Any, Any], limits: tuple[float, float], expected: str
) -> float | None:
    """The number of a key, within limits; None if there is none."""
    if values.get(key) is None:
        return None
    value = _number(values[key])
    if not limits[0] <= value <= limits[1]:
        _fail(name, key, values, expected)
    return value


def _origin(name: str, values: dict[Any, Any]) -> Pose2D:
    value = values["origin"]
    numbers = [_number(v) for v in value] if isinstance(value, list) else []
    if len(numbers) != 3 or not all(abs(n) < 1e9 for n in numbers):
        _fail(name, "origin", values, "[x, y, yaw] in metres and radians")
    if abs(numbers[2]) > 2 * math.pi + 1e-6:
        _fail(name, "origin", values, "a yaw in radians, -6.2832 to 6.2832")
    return Pose2D(*numbers)
