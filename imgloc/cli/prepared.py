"""Prepared maps: from the cache if they are there, within the memory that may be taken."""

from typing import TYPE_CHECKING, Any

from imgloc.cli.console import LOG

if TYPE_CHECKING:
    from pathlib import Path

    from imgloc.features.mapfeatures import MapFeatures
    from imgloc.model import OccupancyGrid


def cache_folder(given: "Path | None", *, wanted: bool) -> "Path | None":
    """Where prepared maps are kept: the folder given, else the user's; None for nowhere."""
    from imgloc.errors import OutputError
    from imgloc.io.cache import default_folder

    if not wanted:
        return None
    try:
        return given or default_folder()
    except OutputError as error:  # nothing but time is lost
        LOG.warning("%s", error)
        return None


def open_features(
    grid: "OccupancyGrid",
    name: str,
    folder: "Path | None",
    memory_budget: int | None,
    **parameters: Any,
) -> "MapFeatures":
    """Prepare a map, with what the cache in `folder` has of it.

    Raises
    ------
    MapError
        If the map has no walls or no free cells.
    ConfigError
        If its features would take more than the budget, bytes; None is half of what is there.
    """
    from imgloc.features.budget import (
        MIB,
        check_budget,
        default_budget,
        prepare_bytes,
        surface_count,
    )
    from imgloc.features.store import load_features
    from imgloc.pipeline import prepare

    features = prepare(grid, name, **parameters)
    height, width = grid.occupied.shape
    need = prepare_bytes(
        (height, width), points=surface_count(grid), n_psi=features.n_psi, factor=features.factor
    )
    budget = default_budget() if memory_budget is None else memory_budget
    LOG.info(
        "%s: its features take at most %d MiB, the budget is %d MiB",
        name, -(-need // MIB), budget // MIB,
    )  # fmt: skip
    check_budget(
        need,
        budget,
        f"{name}: preparing {height} x {width} cells",
        "crop the map, use a coarser one, or raise --memory-budget",
    )
    return features if folder is None else load_features(grid, folder, parameters)


def keep_features(features: "MapFeatures", folder: "Path") -> None:
    """Keep in the cache what has been computed of a map and is not there yet."""
    from imgloc.features.store import save_features

    if save_features(features, folder):
        LOG.info("kept the prepared map in %s", folder)
