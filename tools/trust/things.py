"""One thing that differs from the map: does it cost as one? At home, and where nothing is right.

A wall that is gone, panes of glass, a cart, a crowd and bays of a warehouse are each one thing,
however many readings fall on it. Beside them stand scans that are of no place of their map, so that
what is gained with the ones is not paid for with the others. Of some the place is known roughly,
too: a scan that shows no more than a plain room on its map is then to be trusted.
"""

from collections.abc import Mapping, Sequence
from itertools import chain

import numpy as np

from imgloc import LaserScan, OccupancyGrid, simulate
from tools.trust.foreign import (
    UNDISTURBED,
    WITHOUT,
    Asked,
    Place,
    Questions,
    at_home,
    floors_of,
    on_other_floors,
    rooms_and_others,
    with_priors,
)
from tools.trust.racks import CELL, CHANGES, SENSOR, in_racks

THINGS = (
    "people", "a wall gone", "panes of glass", "a cart", "a crowd",
    "40 % of the rays stopped short",
)  # fmt: skip
"""Some of :data:`~tools.trust.disturb.SCANS`."""
ROOM = "plain room"
PLACED = [("place known to 3 m and 90 deg", row) for row in (UNDISTURBED, "a wall gone", ROOM)]
"""One of :data:`~tools.trust.disturb.PRIORS`, and the rows in which so much may be known."""


def things(
    places: Sequence[Place],
    others: Mapping[str, Sequence[LaserScan]],
    n: int,
    seed: int,
    *,
    buildings: int,
    same: Mapping[str, str],
) -> Questions:
    """Scans of `places` with things that differ, of racks and of floors, and of no place.

    There are `n` scans of each floor and simple room, `2 * n` of each rack and of plain rooms; the
    other arguments are those of :func:`~tools.trust.foreign.rooms_and_others`.
    """
    grids: dict[str, OccupancyGrid] = {name: grid for name, grid, _ in places}
    floors = (on_other_floors(floors_of(1000 * seed + k, n)) for k in range(buildings))
    home = at_home(places, (UNDISTURBED, *THINGS), seed)
    away = rooms_and_others(grids, others, n, seed, same)
    for grid, some in chain(home, in_halls(n, seed), *floors, away):
        yield grid, [a for a in some if a.prior == WITHOUT or (a.prior, a.row) in PLACED]


def in_halls(n: int, seed: int) -> Questions:
    """Scans of racks, and of empty rooms, each of which is a map and fits twice if turned."""
    for change in CHANGES:
        grid, scans = in_racks(change, 2 * n, seed)
        yield grid, [Asked(change, "racks", *pair) for pair in scans.with_poses()]
    for k in range(2 * n):
        sides = np.random.default_rng((seed, k)).uniform(3, 9, 2) / CELL
        walls = np.pad(np.zeros(sides.astype(int), bool), 4, constant_values=True)
        grid = OccupancyGrid(walls, ~walls, CELL)
        pairs = simulate(grid, 1, seed + k, SENSOR).with_poses()
        yield grid, [a for scan, pose in pairs for a in with_priors(ROOM, ROOM, scan, pose, pose)]
