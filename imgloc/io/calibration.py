"""Calibrations of a map, in a JSON file beside it: of its methods, scale, walls and faces.

The file names the cells for which it was made: a map that has been redrawn since is another map,
and what was fitted on the old one is not used.
"""

import contextlib
import json
import logging
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from imgloc.__about__ import __version__
from imgloc.errors import ConfigError, OutputError
from imgloc.io.cache import cells_digest
from imgloc.io.files import PathLike, display, is_file, write_text_atomic
from imgloc.io.own import read_json
from imgloc.model import OccupancyGrid
from imgloc.options import DEFAULTS, Calibration, Drawn, Options, Shared

LOG = logging.getLogger("imgloc")

_FORMAT = 1
_MOST = 1 << 20  # bytes; what is longer is not such a file
_UNUSABLE = (ValueError, ConfigError, OutputError)
_METHOD = dict.fromkeys(vars(Calibration()), float)
_SHARED = {
    "scale": float, "thinner": int, "bent?": float, "depth?": (float, None), "usual?": float,
    "straight?": bool,
}  # fmt: skip
_KIND = {"map_hash": str, "methods": {str: _METHOD}, "shared?": _SHARED}


def calibration_path(map_path: PathLike) -> Path:
    """The file beside a map: ``office.calibration.json`` for ``office.yaml``."""
    path = Path(map_path)
    return path.parent / f"{path.stem}.calibration.json"  # also of a folder that has no name: "."


def map_hash(grid: OccupancyGrid) -> str:
    """40 hexadecimal digits of a map's cells and resolution; where it lies does not count."""
    return cells_digest(grid, [grid.occupied.shape, float(grid.resolution).hex()], 20)


def save_calibrations(
    path: PathLike, grid: OccupancyGrid, calibrations: Mapping[str, Calibration],
    about: Mapping[str, Mapping[str, object]], *, shared: Shared | None = None, force: bool = False,
) -> None:  # fmt: skip
    """Write what was fitted on a map; what the file holds for other methods stays.

    `calibrations` and `about` (what decided them, as plain values: seed, trials, sensor ...) are by
    method, `shared` is the error of all its scans. With `force` a file that exists is changed, and
    one that is damaged or of another map replaced; without, it is an OutputError, as is what
    cannot be written.
    """
    kept, said = dict[str, Calibration](), None
    if force and is_file(path):
        with contextlib.suppress(*_UNUSABLE):
            kept, said, known = _read(Path(path), grid)
            shared = known if shared is None else shared
    old = said if isinstance(said, dict) else {}
    old = {name: old[name] for name in (*kept, "shared") if name in old}
    content = {
        "format": _FORMAT,
        "imgloc": __version__,
        "map_hash": map_hash(grid),
        "methods": {name: vars(fitted) for name, fitted in {**kept, **calibrations}.items()},
        "shared": vars(shared or Shared()),
        "about": {**old, **about},
    }
    write_text_atomic(path, json.dumps(content, indent=2, allow_nan=False) + "\n", force=force)


def calibrated(
    options: Options, map_path: PathLike, grid: OccupancyGrid, drawn: Drawn | None = None
) -> Options:
    """The options with what was calibrated for a map: for their method, and of its scale and walls.

    Without a file, or with one that is damaged or of another map, nothing was. What is stated of
    the walls, `drawn`, is more than what was calibrated.
    """
    methods, shared = load_calibrations(calibration_path(map_path), grid)
    shared = (drawn or Drawn()).on(shared, grid.resolution)
    return replace(options, calibration=methods.get(options.method), shared=shared)


def said_scale(map_path: PathLike) -> float:
    """The scale in the file beside a map, though it may be of another map; 1 without one.

    To know more takes the cells of the map.
    """
    file = calibration_path(map_path)
    with contextlib.suppress(*_UNUSABLE):
        if file.is_file():
            return Shared(float(_content(file).get("shared", vars(Shared()))["scale"])).scale
    return 1.0


def load_calibrations(path: PathLike, grid: OccupancyGrid) -> tuple[dict[str, Calibration], Shared]:
    """Read what was fitted on a map: by method, and of its scale and walls.

    Nothing, for the defaults to hold, if there is no file, or it is damaged or of another map; then
    a warning is logged with the reason.
    """
    if not is_file(path):
        return {}, Shared()
    try:
        methods, _, shared = _read(Path(path), grid)
    except _UNUSABLE as e:
        hint = "make it anew with `imgloc calibrate`"
        name = display(path)
        why = str(e).removeprefix(f"{name}: ")
        LOG.warning("%s: ignored, the defaults are used: %s; %s", name, why, hint)
        return {}, Shared()
    return methods, shared


def _read(file: Path, grid: OccupancyGrid) -> tuple[dict[str, Calibration], Any, Shared]:
    """Calibrations by method, their entries `about`, the shared error; or `_UNUSABLE`."""
    content = _content(file)
    if content["map_hash"] != map_hash(grid):
        raise ValueError("it was made for a map with other cells")
    methods, known = content["methods"], content.get("shared", vars(Shared()))
    if not methods.keys() <= DEFAULTS.keys():
        raise ValueError(f"methods: expected an object with keys of {', '.join(DEFAULTS)}")
    found = {
        name: _made(f"methods.{name}", Calibration, {key: float(values[key]) for key in _METHOD})
        for name, values in methods.items()
    }
    said = {key: known[key] for key in vars(Shared()) if known.get(key) is not None}
    exact = ("thinner", "straight")
    values = {key: value if key in exact else float(value) for key, value in said.items()}
    return found, content.get("about"), _made("shared", Shared, values)


def _made(key: str, kind: Any, values: Mapping[str, Any]) -> Any:
    """The value at a key of the file; a value out of its range is named as the file has it."""
    try:
        return kind(**values)
    except ConfigError as e:
        raise ValueError(str(e).replace(kind.__name__, key, 1)) from None


def _content(file: Path) -> Any:
    """The contents of a file; else `_UNUSABLE`."""
    return read_json(file, _KIND, limit=_MOST, what="calibration", version=_FORMAT, strict=True)
