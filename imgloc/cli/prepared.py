"""Prepared maps: from the cache if they are there, within the memory that may be taken."""

from typing import TYPE_CHECKING, Any

from imgloc.cli.budgets import COARSER, check_answer
from imgloc.cli.console import LOG

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from imgloc.features.mapfeatures import MapFeatures
    from imgloc.model import LaserScan, OccupancyGrid
    from imgloc.options import Options


def cache_folder(given: "Path | None", *, wanted: bool) -> "Path | None":
    """Where prepared maps are kept: the folder given, else the user's; None for nowhere."""
    from imgloc.errors import OutputError
    from imgloc.io import cache

    if not wanted:
        return None
    try:
        return given or cache.cache_folder()
    except OutputError as error:  # nothing but time is lost
        LOG.warning("%s", error)
        return None


def open_features(
    grid: "OccupancyGrid",
    name: str,
    folder: "Path | None",
    options: "Options",
    *,
    hint: str = COARSER,
    scans: "Sequence[LaserScan]" = (),
    **parameters: Any,
) -> "MapFeatures":
    """Prepare a map, with what the cache in `folder` has of it, to answer as `options` say.

    Raises
    ------
    MapError
        If the map has no walls or no free cells.
    ConfigError
        If its features, an answer and the `scans` would take more memory than the options'
        budget; `hint` is what to change.
    """
    from imgloc.features.store import load_features
    from imgloc.pipeline import prepare

    parameters["memory_budget"] = options.memory_budget
    features = prepare(grid, name, **parameters)
    check_answer(features, options, name, hint=hint, scans=scans)
    return features if folder is None else load_features(grid, folder, parameters)


def keep_features(features: "MapFeatures", folder: "Path") -> None:
    """Keep in the cache what has been computed of a map and is not there yet."""
    from imgloc.features.store import save_features

    if save_features(features, folder):
        LOG.info("kept the prepared map in %s", folder)
