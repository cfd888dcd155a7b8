"""How far ``engine="auto"`` is from the fastest engine of the correlation, case by case.

>>> row, = engine_rows(sizes=(40,), reaches=(10,), rays=(16,), headings=2, repeats=1)
>>> row["size"], sorted(row["ms"])
(40, ['auto', 'dft', 'filter2d', 'shift'])
"""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np

from imgloc.experiments.bench import in_turns
from imgloc.features.fields import bmap
from imgloc.features.raycast import cast_rays, distance_image
from imgloc.features.surface import surface_points
from imgloc.geometry import uniform_thetas
from imgloc.likelihood.correlate import correlate
from imgloc.likelihood.engines import ENGINES
from imgloc.model import FloatArray, OccupancyGrid
from imgloc.worlds import WORLDS, render

SIZES = (125, 250, 500, 1000)
"""Cells along a side of the map."""
REACHES = (25, 100, 300)
"""Cells that the sensor sees."""
RAYS = (32, 181, 720)

_CELL = 0.1
_SECONDS = 0.1  # that an engine is timed for in all its repeats, if one takes less
_MOST = 50  # repeats
_HOPELESS = 3.0  # times as slow as another: timed twice only


def engine_rows(
    sizes: Sequence[int] = SIZES,
    reaches: Sequence[int] = REACHES,
    rays: Sequence[int] = RAYS,
    *,
    headings: int = 8,
    repeats: int = 5,
) -> tuple[Mapping[str, Any], ...]:
    """Time CBML's correlation by every engine, for each size of map, reach and number of rays.

    Parameters
    ----------
    sizes, reaches, rays : sequences of int
        Cells, cells, readings.
    headings : int
        Of each stack. With few of them the choice, made once a stack, weighs more.
    repeats : int
        In turns, at least so many; the least time of an engine counts, on one thread.

    Returns
    -------
    tuple of mappings
        ``size``, ``reach``, ``rays``, ``ms`` of each engine and of ``auto``, the ``best``
        engine, and ``ratio``: auto's time to the best's.

    Raises
    ------
    ConfigError
        If there is to be no repeat.
    """
    rows: list[Mapping[str, Any]] = []
    thetas = uniform_thetas(2 * np.pi / headings) + 0.1  # none of them along the walls
    for size in sizes:
        grid = tiled(size)
        surface = surface_points(grid.occupied, grid.free, _CELL)
        image = np.rint(255 * bmap(surface.xy, (size, size), _CELL, _CELL)).astype(np.uint8)
        out = np.empty((headings, size, size), dtype=np.float32)
        for reach, n in product(reaches, rays):
            xy = seen(grid, reach, n)
            calls = {
                engine: lambda engine=engine, xy=xy, image=image, out=out: correlate(
                    image, xy, thetas, _CELL, engine=engine, out=out
                )
                for engine in (*ENGINES, "auto")
            }
            ms = _least(calls, repeats)
            best = min(ENGINES, key=ms.__getitem__)
            about = {"size": size, "reach": reach, "rays": n, "ms": ms, "best": best}
            rows.append(about | {"ratio": ms["auto"] / ms[best]})
    return tuple(rows)


def engine_summary(rows: Sequence[Mapping[str, Any]]) -> Mapping[str, float]:
    """Median and worst ratio of the time of ``auto`` to that of the best engine.

    Examples
    --------
    >>> engine_summary([{"ratio": 1.0}, {"ratio": 1.4}, {"ratio": 1.1}])
    {'median': 1.1, 'worst': 1.4, 'within 20 %': 0.6666666666666666}
    """
    ratio = np.array([row["ratio"] for row in rows])
    return {
        "median": float(np.median(ratio)),
        "worst": float(ratio.max()),
        "within 20 %": float((ratio <= 1.2).mean()),
    }


def tiled(size: int) -> OccupancyGrid:
    """The world ``large``, repeated or cut to `size` cells a side."""
    one = render(WORLDS["large"](), _CELL)
    height, width = one.occupied.shape
    times = (-(-size // height), -(-size // width))
    occupied, free = (np.tile(v, times)[:size, :size] for v in (one.occupied, one.free))
    return OccupancyGrid(occupied, free, _CELL)


def seen(grid: OccupancyGrid, reach: int, rays: int) -> FloatArray:
    """Points (rays, 2) that a sensor around the middle of a map sees, metres.

    A ray that meets no wall within `reach` cells ends there, so that there are as many points as
    rays and as long ones as said.
    """
    height, width = grid.occupied.shape
    row, column = np.nonzero(grid.free)
    at = int(np.hypot(row - height / 2, column - width / 2).argmin())
    start = (np.array([column[at], row[at]]) + 0.5) * _CELL
    angles = np.linspace(-np.pi, np.pi, rays, endpoint=False)
    length = reach * _CELL
    ranges = cast_rays(distance_image(grid.occupied), start, angles, length, _CELL)
    ranges = np.minimum(ranges, length)
    return np.column_stack((ranges * np.cos(angles), ranges * np.sin(angles)))


def _least(calls: Mapping[str, Callable[[], object]], repeats: int) -> dict[str, float]:
    """Least milliseconds of processor time of each call, taken in turns."""

    def least(names: Iterable[str], turns: int) -> dict[str, float]:
        cases = [(name, "call", 1.0, calls[name]) for name in names]
        return {t.name: min(t.seconds) for t in in_turns(cases, turns, time.process_time)}

    seconds = least(calls, min(2, repeats))
    fastest = min(seconds.values())
    near = [name for name, value in seconds.items() if value <= _HOPELESS * fastest]
    turns = max(repeats, min(_MOST, int(_SECONDS / fastest)))
    seconds |= least(near, turns)
    return {name: 1e3 * value for name, value in seconds.items()}
