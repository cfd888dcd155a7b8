"""imgloc: where am I on this map? Global localization of a laser scan in a map image.

The names below are loaded when they are first used, so that ``import imgloc`` is cheap:

>>> import imgloc
>>> from imgloc.io.maps import bundled_maps
>>> features = imgloc.prepare(imgloc.load_map(bundled_maps() / "curved.yaml"))
>>> scans = imgloc.simulate(features.grid, 1, seed=1)
>>> imgloc.localize(features, scans[0]).verdict
'unique'
"""

import importlib
from typing import TYPE_CHECKING, Any

from imgloc.__about__ import __version__

if TYPE_CHECKING:
    from imgloc.answers.explain import Explanation, explain
    from imgloc.answers.sample import sample_poses
    from imgloc.choice.choose import Choice, which
    from imgloc.errors import ConfigError, ImglocError, MapError, OutputError, ScanError
    from imgloc.features.mapfeatures import MapFeatures
    from imgloc.filters.choose import make_filter
    from imgloc.filters.follow import Every, Limits, Moment, Tracking, follow
    from imgloc.io.mapcheck import MapReport, check_map
    from imgloc.io.maps import load_map, save_map
    from imgloc.io.scans import load_scans, save_scans
    from imgloc.io.scanset import ScanSet
    from imgloc.lab.evaluation import Evaluation, evaluate
    from imgloc.live.line import Dropped
    from imgloc.live.localizer import Answer, Localizer
    from imgloc.live.sites import Site
    from imgloc.model import (
        Evidence,
        GridInfo,
        Hypothesis,
        LaserScan,
        Likelihood,
        Localization,
        OccupancyGrid,
        OrientedPoints,
        Pose2D,
    )
    from imgloc.options import (
        ALL_METHODS,
        METHODS,
        Calibration,
        FusedOptions,
        Options,
        Prior,
        Shared,
        Trust,
    )
    from imgloc.output.pictures import Picture, draw
    from imgloc.pipeline import likelihood, localize, prepare
    from imgloc.plans.files import load_plan
    from imgloc.plans.floorplan import FloorPlan, plan_to_map
    from imgloc.runs.batch import BatchSummary, run_batch
    from imgloc.runs.jobs import Job
    from imgloc.search.priors import Known
    from imgloc.simulation.scans import Sensor, simulate

__all__ = [
    "ALL_METHODS", "METHODS", "Answer", "BatchSummary", "Calibration", "Choice", "ConfigError",
    "Dropped", "Evaluation",
    "Every", "Evidence", "Explanation", "FloorPlan", "FusedOptions", "GridInfo", "Hypothesis",
    "ImglocError", "Job", "Known", "LaserScan", "Likelihood", "Limits", "Localization", "Localizer",
    "MapError", "MapFeatures", "MapReport", "Moment", "OccupancyGrid", "Options", "OrientedPoints",
    "OutputError", "Picture", "Pose2D", "Prior", "ScanError", "ScanSet", "Sensor", "Shared", "Site",
    "Tracking", "Trust", "__version__", "check_map", "draw", "evaluate", "explain", "follow",
    "likelihood", "load_map", "load_plan", "load_scans", "localize", "make_filter", "plan_to_map",
    "prepare", "run_batch", "sample_poses", "save_map", "save_scans", "simulate", "which",
]  # fmt: skip

_HOMES = {
    "imgloc.runs.batch": "BatchSummary run_batch",
    "imgloc.choice.choose": "Choice which",
    "imgloc.errors": "ConfigError ImglocError MapError OutputError ScanError",
    "imgloc.lab.evaluation": "Evaluation evaluate",
    "imgloc.answers.explain": "Explanation explain",
    "imgloc.plans.floorplan": "FloorPlan plan_to_map",
    "imgloc.features.mapfeatures": "MapFeatures",
    "imgloc.filters.choose": "make_filter",
    "imgloc.io.mapcheck": "MapReport check_map",
    "imgloc.io.maps": "load_map save_map",
    "imgloc.plans.files": "load_plan",
    "imgloc.io.scans": "load_scans save_scans",
    "imgloc.io.scanset": "ScanSet",
    "imgloc.runs.jobs": "Job",
    "imgloc.live.line": "Dropped",
    "imgloc.live.localizer": "Answer Localizer",
    "imgloc.live.sites": "Site",
    "imgloc.model": "Evidence GridInfo Hypothesis LaserScan Likelihood Localization OccupancyGrid "
    "OrientedPoints Pose2D",
    "imgloc.options": "ALL_METHODS METHODS Calibration FusedOptions Options Prior Shared Trust",
    "imgloc.output.pictures": "Picture draw",
    "imgloc.pipeline": "likelihood localize prepare",
    "imgloc.answers.sample": "sample_poses",
    "imgloc.search.priors": "Known",
    "imgloc.simulation.scans": "Sensor simulate",
    "imgloc.filters.follow": "Every Limits Moment Tracking follow",
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
