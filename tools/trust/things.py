"""One thing that differs from the map: does it cost as one? At home, and where nothing is right.

A wall that is gone, panes of glass, a cart, a crowd and bays of a warehouse are each one thing,
however many readings fall on it. Beside them stand scans that are of no place of their map, so that
what is gained with the ones is not paid for with the others.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from imgloc import LaserScan, OccupancyGrid
from tools.trust.disturb import SCANS
from tools.trust.foreign import (
    WITHOUT,
    Asked,
    Place,
    Questions,
    at_home,
    floors_of,
    on_other_floors,
    rooms_and_others,
)
from tools.trust.racks import CHANGES, in_racks

THINGS = (
    "people", "a wall gone", "panes of glass", "a cart", "a crowd",
    "40 % of the rays stopped short",
)  # fmt: skip
"""Some of :data:`~tools.trust.disturb.SCANS`."""


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

    There are `n` scans of each rack, floor and simple room; the other arguments are those of
    :func:`~tools.trust.foreign.rooms_and_others`.
    """
    yield from one_row("undisturbed", at_home(places))
    for name, grid, scans in places:
        yield (
            grid,
            [
                Asked(thing, name, SCANS[thing](scan, np.random.default_rng((seed, k))), pose)
                for thing in THINGS
                for k, (scan, pose) in enumerate(scans.with_poses())
            ],
        )
    for change in CHANGES:
        grid, scans = in_racks(change, 2 * n, seed)
        yield grid, [Asked(change, "racks", *pair) for pair in scans.with_poses()]
    for k in range(buildings):
        yield from without(on_other_floors(floors_of(1000 * seed + k, n)))
    grids: dict[str, OccupancyGrid] = {name: grid for name, grid, _ in places}
    yield from without(rooms_and_others(grids, others, n, seed, same))


def without(questions: Questions) -> Questions:
    """The questions about which nothing is known."""
    for grid, some in questions:
        yield grid, [asked for asked in some if asked.prior == WITHOUT]


def one_row(name: str, questions: Questions) -> Questions:
    """The questions without priors; scans on their whole map stand in one row."""
    for grid, some in without(questions):
        yield grid, [replace(a, row=name) if a.row.endswith(name) else a for a in some]
