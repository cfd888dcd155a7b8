"""How an image is to be read as a map: YAML, options and defaults combined."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from imgloc.errors import ConfigError, MapError
from imgloc.io.files import PathLike, display, refuse_irregular
from imgloc.io.images import MAX_PIXELS
from imgloc.io.mapyaml import MODES, RESOLUTION_RANGE, MapYaml, load_map_yaml
from imgloc.io.occupancy import SEMANTICS
from imgloc.model import Pose2D

OCCUPIED_THRESH, FREE_THRESH = 0.65, 0.196
YAML_ENDINGS = (".yaml", ".yml")


@dataclass(frozen=True)
class MapSettings:
    """How an image is to be read as a map: its YAML, overridden by options, with defaults.

    `yaml` is None for a bare image.
    """

    image: Path
    resolution: float
    origin: Pose2D
    mode: str
    semantics: str
    negate: bool
    occupied_thresh: float
    free_thresh: float
    yaml: MapYaml | None = None


def resolve_settings(
    path: PathLike,
    resolution: float | None = None,
    origin: Pose2D | Sequence[float] | None = None,
    mode: str | None = None,
    semantics: str = "nav2",
    occupied_thresh: float | None = None,
    free_thresh: float | None = None,
    negate: bool | None = None,
    max_pixels: int = MAX_PIXELS,
) -> MapSettings:
    """Combine a map's YAML, if `path` is one, with options (which win) and defaults.

    Raises
    ------
    MapError, ConfigError
        As :func:`imgloc.io.maps.load_map`.
    """
    low, high = RESOLUTION_RANGE
    if resolution is not None and not low <= resolution <= high:
        raise ConfigError(f"--resolution: got {resolution}, expected metres, {low} to {high:g}")
    if mode is not None and mode not in MODES:
        raise ConfigError(f"--mode: got {mode!r}, expected one of {', '.join(MODES)}")
    if semantics not in SEMANTICS:
        raise ConfigError(f"--semantics: got {semantics!r}, expected one of {', '.join(SEMANTICS)}")
    if max_pixels < 1:
        raise ConfigError(f"--max-pixels: got {max_pixels}, expected at least 1")
    wanted = _origin_option(origin)
    name = display(path)
    said = load_map_yaml(path) if Path(path).suffix.lower() in YAML_ENDINGS else None
    if said is None:
        refuse_irregular(path, error=MapError, what="map YAML or image")
        if resolution is None:
            raise MapError(f"{name}: resolution: missing{_resolution_hint(Path(path))}")
        said_or_empty = MapYaml(Path(path), Path(path), origin=Pose2D(0.0, 0.0, 0.0))
    else:
        said_or_empty = said
    resolution = said_or_empty.resolution if resolution is None else resolution
    wanted = said_or_empty.origin if wanted is None else wanted
    if resolution is None:
        raise MapError(f"{name}: resolution: missing, expected metres per cell, as 0.05")
    if wanted is None:
        raise MapError(f"{name}: origin: missing, expected [x, y, yaw] in metres and radians")
    settings = MapSettings(
        image=said_or_empty.image,
        resolution=float(resolution),
        origin=wanted,
        mode=_first(mode, said_or_empty.mode, "trinary"),
        semantics=semantics,
        negate=_first(negate, said_or_empty.negate, False),
        occupied_thresh=_first(occupied_thresh, said_or_empty.occupied_thresh, OCCUPIED_THRESH),
        free_thresh=_first(free_thresh, said_or_empty.free_thresh, FREE_THRESH),
        yaml=said,
    )
    if not 0 <= settings.free_thresh < settings.occupied_thresh <= 1:
        given = occupied_thresh is not None or free_thresh is not None
        raise (ConfigError if given else MapError)(
            f"{name}: free_thresh {settings.free_thresh} and occupied_thresh "
            f"{settings.occupied_thresh}, expected 0 <= free_thresh < occupied_thresh <= 1"
        )
    return settings


def _first(*values: Any) -> Any:
    return next(v for v in values if v is not None)


def _origin_option(origin: Pose2D | Sequence[float] | None) -> Pose2D | None:
    if origin is None or isinstance(origin, Pose2D):
        return origin
    numbers = [float(v) for v in origin]
    if len(numbers) != 3 or not all(math.isfinite(v) for v in numbers):
        raise ConfigError(f"--origin: got {numbers}, expected x, y, yaw in metres and radians")
    return Pose2D(*numbers)


def _resolution_hint(path: Path) -> str:
    beside = [path.with_suffix(e) for e in YAML_ENDINGS if path.with_suffix(e).is_file()]
    if beside:
        return f"; give {display(beside[0])} instead of the image, or pass --resolution"
    return ", expected metres per cell; pass --resolution, or the map's YAML"
