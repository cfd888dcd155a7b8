"""How each method is prepared, run and counted by :mod:`imgloc.experiments.complexity`."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from imgloc.experiments.complexity_types import BASE
from imgloc.experiments.simulate import sample_free_poses, simulate
from imgloc.experiments.worlds import WORLDS, render
from imgloc.features.fields import bmap, vmap
from imgloc.features.raydistance import ray_distances
from imgloc.features.scanpoints import scan_points
from imgloc.features.surface import surface_points
from imgloc.features.visibility import visibility_frames
from imgloc.geometry import uniform_thetas
from imgloc.likelihood.beam import beam
from imgloc.likelihood.cbml import cbml, cbml_o, project
from imgloc.likelihood.ght import ght, ght_v
from imgloc.model import Float32Array, FloatArray, OccupancyGrid, OrientedPoints
from tools.paper.work import pixels_added, ray_cells, votes_cast

SIGMA = 0.1
"""Metres, of the blurred maps."""
_DIRECTIONS, _HORIZON = 64, 30.0


@dataclass(frozen=True)
class Case:
    """A map and a scan to be compared, and how finely.

    `points` are those of the scan, whose readings are `ranges` at `angles`; `thetas` (K,) are the
    headings of the stack.
    """

    grid: OccupancyGrid
    surface: OrientedPoints
    points: OrientedPoints
    ranges: FloatArray
    angles: FloatArray
    thetas: FloatArray


def case_at(world: str, axis: str, value: float, seed: int) -> tuple[Case, float]:
    """Build the map and the scan for a value of an axis; also that value in SI units."""
    at = {**BASE, axis: value}
    grid = render(WORLDS[world](), 1 / at["rho_m"])
    copies, across = round(at["A"]), 1
    while across * across < copies and copies % (2 * across) == 0:
        across *= 2
    tiles = (copies // across, across)
    grid = OccupancyGrid(np.tile(grid.occupied, tiles), np.tile(grid.free, tiles), grid.resolution)
    fine = render(WORLDS[world](), 0.01)  # the scan knows neither cells nor copies
    pose = sample_free_poses(fine, 1, seed, clearance=0.5)
    angles = np.linspace(-np.pi / 2, np.pi / 2, round(at["n"]))
    ranges = simulate(fine, pose, angles, seed=seed)[0]
    headings = round(at["rho_theta"])
    case = Case(
        grid=grid,
        surface=surface_points(grid.occupied, grid.free, grid.resolution),
        points=scan_points(ranges, angles, np.isfinite(ranges)),
        ranges=ranges,
        angles=angles,
        thetas=uniform_thetas(2 * np.pi / headings),
    )
    area = grid.occupied.size * grid.resolution**2
    return case, area if axis == "A" else float(value)


Arrays = tuple[npt.NDArray[Any], ...]


@dataclass(frozen=True)
class Recipe:
    """A method on one case.

    Parameters
    ----------
    prepare : callable
        Returns the arrays that scans are compared with.
    run : callable
        Of those arrays and a stack to fill.
    count : callable
        Of those arrays: `init_work`, `work` and `traced` of
        :class:`~imgloc.experiments.complexity_types.Sample`.
    """

    prepare: Callable[[], Arrays]
    run: Callable[[Arrays, Float32Array], object]
    count: Callable[[Arrays], tuple[int, int, int]]


def _taps(case: Case) -> int:
    """Multiplications of a separable Gaussian: OpenCV's kernel reaches four sigma."""
    return case.grid.occupied.size * 2 * (round(8 * SIGMA / case.grid.resolution + 1) | 1)


def _cbml(c: Case) -> Recipe:
    shape, cell = c.grid.info.shape, c.grid.resolution
    return Recipe(
        lambda: (bmap(c.surface.xy, shape, cell, SIGMA),),
        lambda a, out: cbml(a[0], c.points.xy, c.thetas, cell, engine="shift", out=out),
        lambda _: (_taps(c), pixels_added(c.points.xy, c.thetas, shape, cell), 0),
    )


def _cbml_o(c: Case) -> Recipe:
    shape, cell = c.grid.info.shape, c.grid.resolution

    def prepare() -> Arrays:
        field = vmap(c.surface, shape, cell, SIGMA)
        return field, project(field, _DIRECTIONS)

    def run(a: Arrays, out: Float32Array) -> object:
        return cbml_o(
            a[0], c.points, c.thetas, cell,
            directions=_DIRECTIONS, engine="shift", projections=a[1], out=out,
        )  # fmt: skip

    def count(a: Arrays) -> tuple[int, int, int]:
        oriented = c.points.xy[c.points.valid]
        return 2 * _taps(c) + a[1].size, pixels_added(oriented, c.thetas, shape, cell), 0

    return Recipe(prepare, run, count)


def _ght(c: Case) -> Recipe:
    shape, cell = c.grid.info.shape, c.grid.resolution

    def prepare() -> Arrays:
        s = surface_points(c.grid.occupied, c.grid.free, cell)
        return s.xy, s.alpha, s.sigma_alpha, s.valid

    return Recipe(
        prepare,
        lambda _, out: ght(c.surface, c.points, len(c.thetas), shape, cell, out=out),
        lambda _: (c.grid.occupied.size, votes_cast(c.surface, None, c.points), 0),
    )


def _ght_v(c: Case) -> Recipe:
    shape, cell, s = c.grid.info.shape, c.grid.resolution, c.surface

    def prepare() -> Arrays:  # as many directions as headings: more are of no use, Sec. V
        seen = visibility_frames(c.grid.occupied, s, cell, len(c.thetas), _HORIZON)
        return s.xy, s.alpha, s.sigma_alpha, s.valid, seen

    return Recipe(
        prepare,
        lambda a, out: ght_v(s, a[-1], c.points, len(c.thetas), shape, cell, out=out),
        lambda a: (int(np.count_nonzero(a[-1])), votes_cast(s, a[-1], c.points), 0),
    )


def _beam(c: Case) -> Recipe:
    shape, cell = c.grid.info.shape, c.grid.resolution
    valid = np.isfinite(c.ranges)

    def count(a: Arrays) -> tuple[int, int, int]:
        metres = 0.01 * float(a[0][:, c.grid.free].sum(dtype=np.float64))
        traced = round(metres / cell)
        return ray_cells(shape, len(c.thetas)), a[0].size * int(valid.sum()), traced

    return Recipe(
        lambda: (ray_distances(c.grid.occupied, cell, len(c.thetas), _HORIZON),),
        lambda a, _: beam(a[0], c.ranges, c.angles, valid, ~valid, c.thetas),
        count,
    )


RECIPES: Mapping[str, Callable[[Case], Recipe]] = MappingProxyType(
    {"cbml": _cbml, "cbml-o": _cbml_o, "ght": _ght, "ght-v": _ght_v, "beam": _beam}
)
