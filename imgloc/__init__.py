"""imgloc: where am I on this map? Global localization of a laser scan in a map image.

The names below are loaded when they are first used, so that ``import imgloc`` is cheap:

>>> from imgloc import Options, Pose2D
>>> Options(top=3).method, Pose2D(1.0, 2.0).theta
('fused', 0.0)

A full stack of one of the paper's methods is :func:`imgloc.pipeline.likelihood`; it is not
repeated here because :mod:`imgloc.likelihood` is the package of the algorithms.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from imgloc.errors import ConfigError, ImglocError, MapError, OutputError, ScanError
    from imgloc.io.mapcheck import MapReport, check_map
    from imgloc.io.maps import load_map, save_map
    from imgloc.io.scans import load_scans, save_scans
    from imgloc.io.scanset import ScanSet
    from imgloc.model import (
        GridInfo,
        Hypothesis,
        LaserScan,
        Likelihood,
        Localization,
        OccupancyGrid,
        OrientedPoints,
        Pose2D,
    )
    from imgloc.options import ALL_METHODS, METHODS, Options
    from imgloc.pipeline import localize, prepare

__version__ = "0.1.0"

__all__ = [
    "ALL_METHODS", "METHODS", "ConfigError", "GridInfo", "Hypothesis", "ImglocError",
    "LaserScan", "Likelihood", "Localization", "MapError", "MapReport", "OccupancyGrid",
    "Options", "OrientedPoints", "OutputError", "Pose2D", "ScanError", "ScanSet", "__version__",
    "check_map", "load_map", "load_scans", "localize", "prepare", "save_map", "save_scans",
]  # fmt: skip

_HOMES = {
    "imgloc.errors": "ConfigError ImglocError MapError OutputError ScanError",
    "imgloc.io.mapcheck": "MapReport check_map",
    "imgloc.io.maps": "load_map save_map",
    "imgloc.io.scans": "load_scans save_scans",
    "imgloc.io.scanset": "ScanSet",
    "imgloc.model": "GridInfo Hypothesis LaserScan Likelihood Localization OccupancyGrid "
    "OrientedPoints Pose2D",
    "imgloc.options": "ALL_METHODS METHODS Options",
    "imgloc.pipeline": "localize prepare",
}
_HOME_OF = {name: module for module, names in _HOMES.items() for name in names.split()}


def __getattr__(name: str) -> Any:
    """Load a public name from the module that defines it."""
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(_HOME_OF[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Every name, loaded or not."""
    return sorted({*globals(), *__all__})
