"""The features of a map, kept in the map cache."""

import hashlib
from collections.abc import Mapping
from dataclasses import fields
from functools import cache
from pathlib import Path
from typing import Any

from imgloc.features.arrays import MAX_BYTES, features_from_arrays, features_to_arrays
from imgloc.features.mapfeatures import MapFeatures
from imgloc.io.cache import (
    cache_key,
    discard_entry,
    entry_names,
    entry_path,
    load_entry,
    store_entry,
)
from imgloc.io.files import PathLike
from imgloc.model import OccupancyGrid

_NO_MATTER = ("grid", "max_bytes", "threads")  # do not change a feature


def features_key(features: MapFeatures) -> str:
    """Key of the cache: the map, the parameters that change a feature, and the code.

    The version alone would give a developer yesterday's features.
    """
    names = [f.name for f in fields(features) if f.name not in _NO_MATTER]
    parameters: dict[str, object] = {name: getattr(features, name) for name in names}
    return cache_key(features.grid, parameters, code=_code())


def load_features(
    grid: OccupancyGrid, folder: PathLike, parameters: Mapping[str, Any]
) -> MapFeatures:
    """Return the features of a map, with what the cache in `folder` has of them.

    A bad entry is removed with a warning; :func:`save_features` makes a new one.
    """
    fresh = MapFeatures(grid, **parameters)
    key = features_key(fresh)
    arrays = load_entry(folder, key)
    if arrays is None:
        return fresh
    try:
        return features_from_arrays(grid, arrays, parameters)
    except ValueError as e:
        discard_entry(entry_path(folder, key), e)
        return fresh


def save_features(features: MapFeatures, folder: PathLike, *, max_bytes: int = MAX_BYTES) -> bool:
    """Keep what has been computed so far, if the cache in `folder` does not have it all.

    Returns
    -------
    bool
        Whether something was written.
    """
    key = features_key(features)
    arrays = features_to_arrays(features, max_bytes=max_bytes)
    if not arrays or arrays.keys() <= entry_names(folder, key):
        return False
    return store_entry(folder, key, arrays)


@cache
def _code() -> str:
    """Digest of the source of this package."""
    digest = hashlib.blake2b(digest_size=8)
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()
