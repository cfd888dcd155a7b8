"""Calibrations of a map's methods, in a JSON file beside the map.

The file says for which cells it was made: a map that has been redrawn since is another map, and
what was fitted on the old one is not used.
"""

import contextlib
import hashlib
import json
import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

import imgloc
from imgloc.errors import ConfigError
from imgloc.io.files import PathLike, display, write_text_atomic
from imgloc.model import OccupancyGrid
from imgloc.options import DEFAULTS, Calibration

LOG = logging.getLogger(__name__)

_FORMAT = 1
_ENDING = ".calibration.json"
_MOST = 1 << 20  # bytes; what is longer is not such a file
_UNUSABLE = (OSError, ValueError, RecursionError, ConfigError)


def calibration_path(map_path: PathLike) -> Path:
    """The file beside a map: ``office.calibration.json`` for ``office.yaml``.

    Examples
    --------
    >>> calibration_path("maps/office.yaml").name
    'office.calibration.json'
    """
    return Path(map_path).with_suffix(_ENDING)


def map_hash(grid: OccupancyGrid) -> str:
    """40 hexadecimal digits of a map's cells and resolution; where it lies does not count.

    Examples
    --------
    >>> wall = np.eye(3, dtype=bool)
    >>> here, finer = (OccupancyGrid(wall, ~wall, side) for side in (0.1, 0.05))
    >>> len(map_hash(here)), map_hash(here) == map_hash(finer)
    (40, False)
    """
    about = [grid.occupied.shape, float(grid.resolution).hex()]
    digest = hashlib.blake2b(json.dumps(about).encode(), digest_size=20)
    for mask in (grid.occupied, grid.free):
        digest.update(np.packbits(mask).tobytes())
    return digest.hexdigest()


def save_calibrations(
    path: PathLike,
    grid: OccupancyGrid,
    calibrations: Mapping[str, Calibration],
    about: Mapping[str, Mapping[str, object]],
    *,
    force: bool = False,
) -> None:
    """Write what was fitted on a map, beside what the file has of its other methods.

    Parameters
    ----------
    path : path
        Of :func:`calibration_path`, where it is found again.
    grid : OccupancyGrid
    calibrations : mapping of str to Calibration
        By method.
    about : mapping of str to mapping
        By method: what decided them, as plain values: seed, number of trials, sensor ...
    force : bool
        Change a file that exists. One that is damaged or of another map is replaced.

    Raises
    ------
    OutputError
        As :func:`~imgloc.io.files.write_bytes_atomic`.
    """
    kept: dict[str, Calibration] = {}
    kept_about: dict[str, object] = {}
    if force and Path(path).is_file():
        with contextlib.suppress(*_UNUSABLE):
            old = _content(Path(path))
            kept = _parse(old, grid)
            said = json.loads(json.dumps(old.get("about")), parse_constant=lambda _: None)
            if isinstance(said, dict):
                kept_about = {name: said[name] for name in kept if name in said}
    content = {
        "format": _FORMAT,
        "imgloc": imgloc.__version__,
        "map_hash": map_hash(grid),
        "methods": {name: vars(fitted) for name, fitted in {**kept, **calibrations}.items()},
        "about": {**kept_about, **about},
    }
    write_text_atomic(path, json.dumps(content, indent=2, allow_nan=False) + "\n", force=force)


def load_calibrations(path: PathLike, grid: OccupancyGrid) -> dict[str, Calibration]:
    """Read what was fitted on a map, if it was on this one.

    A file that is damaged or of another map is not used; a warning is logged that says why.

    Parameters
    ----------
    path : path
        Need not exist.
    grid : OccupancyGrid

    Returns
    -------
    dict of str to Calibration
        By method. Empty if there is nothing to be used: the defaults hold.
    """
    file = Path(path)
    if not file.is_file():
        return {}
    try:
        return _parse(_content(file), grid)
    except _UNUSABLE as e:
        LOG.warning(
            "%s: not used, the defaults are: %s; make it anew with `imgloc calibrate`",
            display(path), e,
        )  # fmt: skip
        return {}


def _content(file: Path) -> Any:
    with file.open("rb") as stream:
        text = stream.read(_MOST + 1)
    if len(text) > _MOST:
        raise ValueError(f"over {_MOST} bytes")
    return json.loads(text)


def _parse(content: Any, grid: OccupancyGrid) -> dict[str, Calibration]:
    if not isinstance(content, dict) or content.get("format") != _FORMAT:
        raise ValueError(f"expected an object with format {_FORMAT}")
    if content.get("map_hash") != map_hash(grid):
        raise ValueError("it was made for a map with other cells")
    methods = content.get("methods")
    if not isinstance(methods, dict) or not set(methods) <= set(DEFAULTS):
        raise ValueError(f"methods: expected an object with keys of {', '.join(DEFAULTS)}")
    return {name: _calibration(name, values) for name, values in methods.items()}


def _calibration(name: str, values: Any) -> Calibration:
    names = vars(Calibration()).keys()
    if not isinstance(values, dict) or values.keys() != names:
        raise ValueError(f"methods.{name}: expected an object with {', '.join(names)}")
    for key, value in values.items():
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ValueError(f"methods.{name}.{key}: got {value!r}, expected a number")
    return Calibration(**{key: float(value) for key, value in values.items()})
