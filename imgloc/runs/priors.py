"""Knowledge of a pose before the scan is looked at, for scripts: ``Options(prior=...)``.

>>> wall = np.pad(np.zeros((8, 9), bool), 1, constant_values=True)
>>> grid = OccupancyGrid(wall, ~wall, 0.5)
>>> here = near(grid, 2.0, 2.0, 0.0, radius=1.0) & region(grid, ~wall)
>>> int(here.cells.sum()), here.heading
(12, (0.0, 0.8))
"""

import math
from pathlib import Path

import numpy as np

from imgloc.errors import ConfigError
from imgloc.features.mapfeatures import MapFeatures
from imgloc.io.files import PathLike
from imgloc.model import BoolArray, FloatArray, OccupancyGrid
from imgloc.options import RADIUS, TOLERANCE, Hint, Known, Prior, Radius, Turn
from imgloc.ranges import require
from imgloc.runs.localize import region_of
from imgloc.search.priors import prior_of


def near(
    place: OccupancyGrid | MapFeatures, x: float, y: float, theta: float, *,
    radius: float = RADIUS, tolerance: float = TOLERANCE, sd: tuple[float, float] | None = None,
    weight: float = 1.0,
) -> Prior:  # fmt: skip
    """Make the prior of a pose that is roughly known, as --near does; with `sd` as --sd does.

    Parameters
    ----------
    place : OccupancyGrid or MapFeatures
        The map.
    x, y, theta : float
        The pose of the sensor in the map frame: metres, metres, radians.
    radius, tolerance : float
        How far it may be off: metres, radians.
    sd : (float, float), optional
        Standard deviations, metres and radians, in place of `radius` and `tolerance`: poses nearer
        to it weigh more, and none is excluded.
    weight : float
        With `sd`: weight at the pose, 0.001 to 1, beside other poses.

    Returns
    -------
    Prior
        For ``Options(prior=...)``; with ``&`` it is joined with another one. With ``|`` several
        poses with `sd` are joined, of which one is right: tags, QR codes, radio.

    Raises
    ------
    ConfigError
        If a number is out of its range.
    """
    if sd is not None:
        require(tuple[Radius, Turn], sd, "sd")
        return prior_of(Known(hints=(Hint(x, y, theta, *sd, weight),)), _grid(place))
    return prior_of(Known(near=(x, y, math.fmod(theta, math.tau), radius, tolerance)), _grid(place))


def region(
    place: OccupancyGrid | MapFeatures, cells: BoolArray | FloatArray | PathLike, *,
    allow_lossy: bool = False,
) -> Prior:  # fmt: skip
    """Make the prior of a part of the map, as --region does; of weights, as --prior-image does.

    Parameters
    ----------
    place : OccupancyGrid or MapFeatures
        The map.
    cells : (H, W) bool array, or path
        Where the sensor may be, row 0 the lowest y; or an image as large as the map's, white there.
        Floats are weights, 0 to 1.
    allow_lossy : bool
        Accept an image with lossy compression.

    Returns
    -------
    Prior
        For ``Options(prior=...)``; with ``&`` it is joined with another one.

    Raises
    ------
    ConfigError
        If the size is not that of the map, or nothing is white.
    """
    grid = _grid(place)
    if not isinstance(cells, np.ndarray):
        cells = region_of(Path(str(cells)), grid, allow_lossy=allow_lossy)
    if cells.shape != grid.occupied.shape or cells.dtype.kind not in "bf":
        found = f"{cells.dtype} {cells.shape}"
        raise ConfigError(f"cells: got {found}, expected bool {grid.occupied.shape} as the map")
    if cells.dtype.kind == "f":
        weights = np.asarray(cells, np.float64)
        return Prior(None, None, {"prior_image": float(weights.mean())}, weights)
    return Prior(np.asarray(cells, bool), None, {"region": {"cells": int(cells.sum())}})


def _grid(place: OccupancyGrid | MapFeatures) -> OccupancyGrid:
    return place.grid if isinstance(place, MapFeatures) else place
