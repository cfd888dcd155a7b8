"""A warehouse whose bays change: racks that look alike, mapped before goods were moved.

Each change is one thing for whoever looks at it, and tens of readings for a sensor.
"""

from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType

import numpy as np

from imgloc import OccupancyGrid, ScanSet, Sensor, simulate
from imgloc.model import BoolArray
from tools.script import at_least_one

CELL, FINE = 0.05, 0.01  # metres: of the map, and of the image on which scans are simulated
_RACKS, _BAYS = 8, 20
_BAY, _DEEP, _AISLE, _ROUND, _WALL = 1.2, 1.1, 2.5, 5.0, 0.2  # metres
_EMPTY = 0.12  # share of the bays
SENSOR = Sensor(rays=541, fov=1.5 * np.pi, sigma=0.02, range_max=20.0)
Rng = np.random.Generator
#: Whether each bay is full, (racks, bays), and by how many metres each rack has moved, (racks,).
Stock = tuple[BoolArray, np.ndarray]


def _exchanged(stock: Stock, rng: Rng, share: float) -> Stock:
    """Some bays are emptied or filled."""
    full, moved = stock
    some = rng.choice(full.size, round(share * full.size), replace=False)
    other = full.copy()
    other.flat[some] ^= True
    return other, moved


def _moved(stock: Stock, rng: Rng) -> Stock:
    """One rack stands one bay farther on, or back."""
    full, moved = stock
    off = moved.copy()
    off[rng.integers(len(off))] = rng.choice((-_BAY, _BAY))
    return full, off


CHANGES: Mapping[str, Callable[[Stock, Rng], Stock]] = MappingProxyType(
    {
        "racks": lambda stock, _: stock,
        "racks, 3 % of the bays changed": partial(_exchanged, share=0.03),
        "racks, 10 % of the bays changed": partial(_exchanged, share=0.1),
        "racks, one moved by a bay": _moved,
    }
)


def drawn(stock: Stock, cell: float) -> OccupancyGrid:
    """The hall with its racks, as a map with cells of so many metres.

    Examples
    --------
    >>> full = np.ones((8, 20), bool)
    >>> drawn((full, np.zeros(8)), 0.1).occupied.shape
    (363, 344)
    """
    full, moved = stock
    width = _BAYS * _BAY + 2 * _ROUND
    height = _RACKS * _DEEP + (_RACKS - 1) * _AISLE + 2 * _ROUND - 2 * _WALL
    occupied = np.ones([round((side + 2 * _WALL) / cell) for side in (height, width)], bool)
    edge = round(_WALL / cell)
    occupied[edge:-edge, edge:-edge] = False
    for rack, bay in np.argwhere(full):
        x = _WALL + _ROUND + bay * _BAY + moved[rack]
        y = _ROUND + rack * (_DEEP + _AISLE)
        rows, columns = (
            slice(round(low / cell), round((low + side) / cell))
            for low, side in ((y, _DEEP), (x, _BAY))
        )
        occupied[rows, columns] = True
    return OccupancyGrid(occupied, ~occupied, cell)


def in_racks(change: str, n: int, seed: int) -> tuple[OccupancyGrid, ScanSet]:
    """The map of a warehouse, and `n` scans taken there after one of the :data:`CHANGES`."""
    at_least_one(n=n)
    rng = np.random.default_rng(seed)
    mapped = rng.random((_RACKS, _BAYS)) >= _EMPTY, np.zeros(_RACKS)
    there = CHANGES[change](mapped, rng)
    grid = drawn(mapped, CELL)
    # The robot stands where it is free before and after.
    both = OccupancyGrid(grid.occupied, grid.free & drawn(there, CELL).free, CELL)
    return grid, simulate(both, n, seed, SENSOR, drawn(there, FINE))
