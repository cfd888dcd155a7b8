"""Why S is higher than the paper's: what the paper leaves open, changed one at a time.

python -m tools.paper.offset -n 20     # prints a table of S less the paper's, nats
"""

import argparse
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from imgloc import MapFeatures, Pose2D
from imgloc.geometry import uniform_thetas
from imgloc.lab.evaluation import cell_of_pose
from imgloc.lab.performance_index import density_in_stack, performance_index
from imgloc.likelihoods.stacks import stack_of
from imgloc.options import Sensor
from tools.paper.table import CELL, MAP_CELL, PAPER_S, PLACES, STEPS_DEG
from tools.recorded import in_world
from tools.script import ended, parser_of, progress

METHODS = tuple(PAPER_S)


@dataclass(frozen=True)
class Change:
    """What differs from the table of :mod:`tools.paper.table`."""

    map_cell: float = MAP_CELL  #: side of a cell of the map, metres
    cell: float = CELL  #: side of a cell of the poses, metres
    sigma: float = 0.1  #: of the kernel that blurs the maps of CBML and CBML-O, metres
    step_deg: float | None = None  #: between headings, of all methods
    box: bool = False  #: poses are possible everywhere in the rectangle of the map
    sensor: Sensor = field(default_factory=Sensor)


CHANGES: Mapping[str, Change] = MappingProxyType(
    {
        "as in the table": Change(),
        "map cells of 10 cm": Change(map_cell=0.1),
        "map cells of 20 cm, poses too": Change(map_cell=0.2, cell=0.2),
        "kernel K of 30 cm": Change(sigma=0.3),
        "kernel K of 1 m": Change(sigma=1.0),
        "headings every 30 degrees": Change(step_deg=30.0),
        "headings every 3 degrees": Change(step_deg=3.0),
        "poses in the whole rectangle": Change(box=True),
        "sensor of 8 m": Change(sensor=Sensor(range_max=8.0)),
        "noise of 10 cm": Change(sensor=Sensor(sigma=0.1)),
        "half of the rays see people": Change(sensor=Sensor(outliers=0.5)),
    }
)
"""What is changed, by name; each changes one thing."""


def index(world: str, change: Change, n: int, seed: int = 0) -> dict[str, float]:
    """S of each of :data:`METHODS` in a world, nats, where something is changed.

    Examples
    --------
    >>> sorted(index("curved", Change(cell=0.5, step_deg=30.0), 2))
    ['cbml', 'cbml-o', 'ght', 'ght-v']
    """
    grid, scans = in_world(world, n, seed, change.sensor, change.map_cell)
    features = MapFeatures(grid, cell=change.cell, sigma=change.sigma)
    space = None if change.box else features.free
    densities = dict[str, list[float]]()
    for scan, pose in scans.with_poses():
        for method in METHODS:
            thetas = uniform_thetas(np.deg2rad(change.step_deg or STEPS_DEG[method]))
            at = cell_of_pose(features, Pose2D(*pose), len(thetas))
            stack = stack_of(method, features, scan, thetas)
            densities.setdefault(method, []).append(density_in_stack(stack, at, space))
    return {method: performance_index(found).value for method, found in densities.items()}


def volumes(step_deg: float) -> dict[str, float]:
    """What S gains, nats, where its density and its volume are of other units than each other.

    Examples
    --------
    >>> {name: round(nats, 2) for name, nats in volumes(3.0).items()}["V an area"]
    -1.84
    """
    return {
        "V an area": -float(np.log(2 * np.pi)),
        "p of a cell, V in m2 rad": float(np.log(CELL**2 * np.deg2rad(step_deg))),
        "p of a cell, V in m2 deg": float(np.log(CELL**2 * step_deg)),
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Print S less the paper's for each change, method and world."""
    parser = parser_of("tools.paper.offset", __doc__)
    parser.add_argument("-n", type=int, default=20, help="trials in each world (default: 20)")
    given = parser.parse_args(arguments)
    return ended("offset", lambda: run(given))


def run(given: argparse.Namespace) -> int:
    """Do what the command line asks for."""
    print("| changed | " + " | ".join(METHODS) + " |")
    print("|---|" + "---|" * len(METHODS))
    base = dict[str, dict[str, float]]()
    with progress("changes", len(CHANGES) * len(PLACES)) as advance:
        for name, change in CHANGES.items():
            found = dict[str, dict[str, float]]()
            for world in PLACES:
                found[world] = index(world, change, given.n)
                advance()
            base = base or found
            print(_row(name, found))
    for name in volumes(1.0):
        moved = {
            world: {m: s + volumes(STEPS_DEG[m])[name] for m, s in by.items()}
            for world, by in base.items()
        }
        print(_row(name, moved))
    return 0


def _row(name: str, found: Mapping[str, Mapping[str, float]]) -> str:
    """A line of the table: S less the paper's in each world."""
    cells = [
        ", ".join(f"{by[m] - PAPER_S[m][world]:+.1f}" for world, by in found.items())
        for m in METHODS
    ]
    return f"| {name} | " + " | ".join(cells) + " |"


if __name__ == "__main__":
    sys.exit(main())
