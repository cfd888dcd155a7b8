"""The features of a map as named arrays, and back; kept in the map cache.

Kept is what takes longer to compute than to read; bmap and the free cells take a millisecond.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import fields
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from imgloc.features.distance import DistanceField
from imgloc.features.mapfeatures import MapFeatures, read_only
from imgloc.features.pyramid import Level
from imgloc.io import cache as entries
from imgloc.io.files import PathLike
from imgloc.model import OccupancyGrid, OrientedPoints

Array = npt.NDArray[Any]

#: Features that are kept.
KEPT = ("surface", "visibility", "pyramid", "vmap", "walls", "field", "straight")
_NO_MATTER = ("grid", "memory_budget", "threads")  # do not change a feature


def features_to_arrays(features: MapFeatures) -> dict[str, Array]:
    """The features computed so far: ``"walls"`` is an array, ``"surface.xy"`` a part of one."""
    out: dict[str, Array] = {}
    for name in KEPT:
        if name in vars(features):
            out |= _parts(name, getattr(features, name))
    return out


def features_from_arrays(
    grid: OccupancyGrid, arrays: Mapping[str, Array], parameters: Mapping[str, Any]
) -> MapFeatures:
    """Make features of which some need not be computed any more.

    `arrays` are those of :func:`features_to_arrays` for the same map; a missing one is computed
    when it is needed. `parameters` go to :class:`~imgloc.features.mapfeatures.MapFeatures`.
    ValueError for an array that is no feature, or of another type or shape than this map's.

    Examples
    --------
    >>> walls = np.eye(9, dtype=bool)
    >>> grid = OccupancyGrid(walls, ~walls, 0.1)
    >>> features = MapFeatures(grid, n_psi=36)
    >>> _ = features.surface, features.walls
    >>> sorted(arrays := features_to_arrays(features))
    ['surface.alpha', 'surface.sigma_alpha', 'surface.valid', 'surface.xy', 'walls']
    >>> features_from_arrays(grid, arrays, {"n_psi": 36}).walls.shape
    (9, 9)
    """
    features = MapFeatures(grid, **parameters)
    rest = dict(arrays)
    made = vars(features)
    for name in KEPT:
        prefix = f"{name}."
        parts = {k: rest.pop(k) for k in tuple(rest) if k == name or k.startswith(prefix)}
        if parts:
            parts = {k.removeprefix(prefix): read_only(v) for k, v in parts.items()}
            # Where functools.cached_property would put it.
            made[name] = _build(features, name, parts)
    if rest:
        raise ValueError(f"{', '.join(sorted(rest))}: no such feature")
    return features


def _parts(name: str, value: Any) -> dict[str, Array]:
    """A feature as named arrays."""
    if name == "surface":
        return {
            f"{name}.{part}": getattr(value, part)
            for part in ("xy", "alpha", "sigma_alpha", "valid")
        }
    if name == "pyramid":
        images = {f"{name}.image{i}": level.image for i, level in enumerate(value)}
        return images | {f"{name}.free{i}": level.free for i, level in enumerate(value)}
    return {name: np.asarray(value.table if name == "field" else value)}


def _take(
    parts: dict[str, Array], name: str, dtype: npt.DTypeLike, shape: tuple[int, ...]
) -> Array:
    """The array `name`, after a look at its type and shape."""
    array = parts.get(name)
    if array is None or array.dtype != dtype or array.shape != shape:
        found = "nothing" if array is None else f"{array.dtype} {array.shape}"
        raise ValueError(f"{name}: got {found}, expected {np.dtype(dtype)} {shape}")
    return array


def _build(features: MapFeatures, name: str, parts: dict[str, Array]) -> object:
    """A feature of its arrays."""
    lattice, shape = features.lattice, features.grid.info.shape
    if name == "surface":
        n = len(parts["xy"]) if "xy" in parts and parts["xy"].ndim else 0
        xy = _take(parts, "xy", np.float64, (n, 2))
        alpha, sigma_alpha = (_take(parts, k, np.float64, (n,)) for k in ("alpha", "sigma_alpha"))
        return OrientedPoints(xy, alpha, sigma_alpha, _take(parts, "valid", np.bool_, (n,)))
    if name == "visibility":
        if "surface" not in vars(features):
            raise ValueError("visibility without its surface")
        return _take(parts, name, np.float32, (features.n_psi, len(features.surface)))
    if name == "pyramid":
        levels, (height, width), resolution = [], lattice.shape, lattice.resolution
        for i in range((len(parts) + 1) // 2):
            image = _take(parts, f"image{i}", np.uint8, (height, width))
            free = _take(parts, f"free{i}", np.bool_, (height, width))
            levels.append(Level(image, free, resolution))
            height, width, resolution = -(-height // 2), -(-width // 2), 2 * resolution
        return tuple(levels)
    if name == "field":
        table = _take(parts, "field", np.int16, (shape[0] * shape[1] + 1, 4))
        return DistanceField(table, *shape, features.grid.resolution)
    if name == "straight":
        return bool(_take(parts, name, np.bool_, ()))
    if name == "walls":
        return _take(parts, name, np.float32 if features.peels else np.uint8, shape)
    return _take(parts, name, np.float32, (2, *lattice.shape))


def features_key(features: MapFeatures) -> str:
    """Key of the cache: the map, the parameters that change a feature, and the code.

    The version alone would give a developer yesterday's features.
    """
    names = [f.name for f in fields(features) if f.name not in _NO_MATTER]
    parameters: dict[str, object] = {name: getattr(features, name) for name in names}
    return entries.cache_key(features.grid, parameters, code=code_digest())


def load_features(
    grid: OccupancyGrid, folder: PathLike, parameters: Mapping[str, Any]
) -> MapFeatures:
    """Return the features of a map; those in the cache in `folder` are loaded.

    A bad entry is removed with a warning; :func:`save_features` makes a new one.
    """
    fresh = MapFeatures(grid, **parameters)
    key = features_key(fresh)
    arrays = entries.load_entry(folder, key)
    if arrays is None:
        return fresh
    try:
        return features_from_arrays(grid, arrays, parameters)
    except ValueError as e:
        entries.discard_entry(entries.entry_path(folder, key), e)
        return fresh


def save_features(features: MapFeatures, folder: PathLike) -> bool:
    """Keep what has been computed so far; return whether something had to be written."""
    key = features_key(features)
    arrays = features_to_arrays(features)
    if not arrays or arrays.keys() <= entries.entry_names(folder, key):
        return False
    return entries.store_entry(folder, key, arrays)


@cache
def code_digest() -> str:
    """Digest of the source of this package: features of another one may be others."""
    digest = hashlib.blake2b(digest_size=8)
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()
