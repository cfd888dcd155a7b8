"""The paper's appendix, measured: how init time, storage and run time grow, and the work counted.

One quantity grows at a time, over a factor of eight: the area A (a world tiled), the map's
resolution rho_m (the polygons drawn with smaller cells), the resolution rho_theta of headings,
the number n of readings. Straight lines fitted to the logarithms give the exponents. Times are
those of this machine at this minute; counts are exact and the same everywhere.
"""

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from imgloc.errors import ConfigError
from imgloc.features.fields import bmap, vmap
from imgloc.features.raydistance import ray_distances
from imgloc.features.scanpoints import scan_points
from imgloc.features.surface import surface_points
from imgloc.features.visibility import visibility_frames
from imgloc.geometry import uniform_thetas
from imgloc.likelihoods.beam import beam
from imgloc.likelihoods.cbml import cbml, cbml_o, project
from imgloc.likelihoods.ght import ght, ght_v
from imgloc.model import Float32Array, FloatArray, OccupancyGrid, OrientedPoints
from imgloc.output.plots import blank
from imgloc.simulation.scans import sample_free_poses, simulate_ranges
from imgloc.simulation.worlds import WORLDS, render
from tools.paper.work import pixels_added, ray_cells, votes_cast
from tools.script import one_of

METHODS = ("cbml", "cbml-o", "ght", "ght-v", "beam")
AXES: Mapping[str, tuple[float, ...]] = {
    "A": (1, 2, 4, 8),
    "rho_m": (5, 10, 20, 40),
    "rho_theta": (15, 30, 60, 120),
    "n": (90, 180, 360, 720),
}
"""What grows: copies of the world, cells per metre, headings, readings."""
BASE: Mapping[str, float] = {"A": 1, "rho_m": 10, "rho_theta": 60, "n": 181}
"""The value of each axis while another one grows."""
QUANTITIES = ("init_s", "storage", "run_s", "init_work", "work")
TIMES = ("init_s", "run_s")
"""Those that two runs do not share."""
SIGMA = 0.1
"""Metres, of the blurred maps."""
_DIRECTIONS, _HORIZON = 64, 30.0


_CORRELATION = {"init_s": (1, 4, 0, 0), "storage": (1, 2, 0, 0), "run_s": (1, 2, 1, 1)}
_POWERS = {
    "cbml": _CORRELATION,
    "cbml-o": _CORRELATION,
    "ght": {"storage": (1, 1, 0, 0), "run_s": (1, 1, 0, 1)},
    "ght-v": {"init_s": (1, 2, 0, 0), "storage": (1, 1, 1, 0), "run_s": (1, 1, 0, 1)},
    "beam": {"init_s": (1, 3, 1, 0), "storage": (1, 2, 1, 0), "run_s": (1, 2, 1, 1)},
}
PAPER: Mapping[str, Mapping[str, Mapping[str, float]]] = {
    method: {quantity: dict(zip(AXES, powers, strict=True)) for quantity, powers in said.items()}
    for method, said in _POWERS.items()
}
"""Exponents of the appendix: method, quantity, axis. GHT's init time is 0 there."""


@dataclass(frozen=True)
class Sample:
    """One method, measured at one point of one axis; times are NaN if not timed.

    The surface points, which all but ``beam`` need, are the init of ``ght`` alone.
    """

    method: str  #: of :data:`METHODS`
    axis: str  #: of :data:`AXES`
    value: float  #: m^2 for ``A``, cells per metre, headings, readings
    init_s: float  #: seconds to prepare the map
    run_s: float  #: seconds for a scan
    storage: int  #: bytes of the arrays that a scan is compared with
    init_work: int  #: pixels walked over (filter taps, for blurred maps); rays, for ``ght-v``
    work: int  #: of a scan: votes, for ``ght`` and ``ght-v``; pixels added, for the others
    traced: int = 0  #: for ``beam``: cells that a ray tracer would walk over from all free cells


@dataclass(frozen=True)
class PowerLaw:
    """An exponent: `quantity` of `method` grows with this power of `axis`.

    `paper` is what the appendix says, or None where it says nothing.
    """

    method: str
    axis: str
    quantity: str
    exponent: float
    paper: float | None


@dataclass(frozen=True)
class Complexity:
    """All samples and the exponents fitted to them."""

    world: str
    samples: tuple[Sample, ...]
    fits: tuple[PowerLaw, ...]

    def exponent(self, method: str, axis: str, quantity: str) -> float:
        """The exponent of one fit; KeyError if it was not measured."""
        found = {(fit.method, fit.axis, fit.quantity): fit.exponent for fit in self.fits}
        return found[method, axis, quantity]


def measure(
    world: str = "curved",
    *,
    methods: tuple[str, ...] = METHODS,
    axes: Mapping[str, tuple[float, ...]] = AXES,
    repeats: int = 3,
    seed: int = 0,
    progress: Callable[[str], object] = lambda _: None,
) -> Complexity:
    """Measure how some :data:`METHODS` grow along some :data:`AXES`; the rest is :data:`BASE`.

    Of `repeats` the shortest time counts; 0 only counts, which needs no runs. `seed` of the pose
    and the noise; `progress` gets what is about to be measured. ConfigError for a world, method or
    axis that is not there, or fewer than two values.

    Examples
    --------
    >>> counted = measure(methods=("ght",), axes={"n": (90, 180)}, repeats=0)
    >>> abs(round(counted.exponent("ght", "n", "work"), 1))
    1.0
    """
    one_of([world], WORLDS)
    one_of(methods, METHODS)
    one_of(axes, AXES)
    for axis, values in axes.items():
        if len(values) < 2 or min(values) <= 0:
            raise ConfigError(f"axis {axis!r} needs at least two positive values, got {values}")
    samples = []
    for axis, values in axes.items():
        for value in values:
            progress(f"{axis} = {value:g}")
            case, value_si = _case_at(world, axis, value, seed)
            samples += [_sample(name, axis, value_si, case, repeats) for name in methods]
    return Complexity(world, tuple(samples), tuple(_fits(samples)))


def fit_exponent(x: npt.ArrayLike, y: npt.ArrayLike) -> float:
    """Least-squares slope of log y over log x.

    Examples
    --------
    >>> round(fit_exponent([1, 2, 4], [3, 12, 48]), 6)
    2.0
    """
    return float(np.polyfit(np.log(np.asarray(x, float)), np.log(np.asarray(y, float)), 1)[0])


def _fits(samples: list[Sample]) -> Iterator[PowerLaw]:
    for method, axis in dict.fromkeys((s.method, s.axis) for s in samples):
        mine = [s for s in samples if (s.method, s.axis) == (method, axis)]
        for quantity in (*QUANTITIES, "traced"):
            values = [getattr(s, quantity) for s in mine]
            if not all(v > 0 for v in values):  # NaN is not
                continue
            exponent = fit_exponent([s.value for s in mine], values)
            paper = {"work": "run_s", "traced": "init_s"}.get(quantity, quantity)
            said = PAPER[method].get(paper, {}).get(axis)
            yield PowerLaw(method, axis, quantity, exponent, said)


def _sample(method: str, axis: str, value: float, case: "_Case", repeats: int) -> Sample:
    recipe = _RECIPES[method](case)
    arrays, init_s = _timed(recipe.prepare, repeats)
    run_s = np.nan
    if repeats:
        # Written to: the page faults of fresh memory would be timed with the first run.
        out = np.ones((len(case.thetas), *case.grid.info.shape), np.float32)
        run_s = _timed(lambda: recipe.run(arrays, out), repeats)[1]
    init_work, work, traced = recipe.counts(arrays)
    storage = sum(array.nbytes for array in arrays)
    return Sample(method, axis, value, init_s, run_s, storage, init_work, work, traced)


def _timed(function: Callable[[], Any], repeats: int) -> tuple[Any, float]:
    """The last result and the shortest time, NaN when it was not to be timed."""
    times = []
    for _ in range(max(1, repeats)):
        start = time.perf_counter()
        result = function()
        times.append(time.perf_counter() - start)
    return result, min(times) if repeats else float("nan")


@dataclass(frozen=True)
class _Case:
    """A map and a scan to be compared: its readings, their points, and the stack's headings."""

    grid: OccupancyGrid
    surface: OrientedPoints
    points: OrientedPoints
    ranges: FloatArray
    angles: FloatArray
    thetas: FloatArray


def _case_at(world: str, axis: str, value: float, seed: int) -> tuple[_Case, float]:
    """Build the map and the scan for a value of an axis; also that value in SI units."""
    at = {**BASE, axis: value}
    grid = render(WORLDS[world](), 1 / at["rho_m"])
    copies, across = round(at["A"]), 1
    while across * across < copies and copies % (2 * across) == 0:
        across *= 2
    tiles = (copies // across, across)
    grid = OccupancyGrid(np.tile(grid.occupied, tiles), np.tile(grid.free, tiles), grid.resolution)
    fine = render(WORLDS[world](), 0.01)  # the scan knows neither cells nor copies
    angles = np.linspace(-np.pi / 2, np.pi / 2, round(at["n"]))
    pose = sample_free_poses(fine, 1, seed, clearance=0.5)
    ranges = simulate_ranges(fine, pose, angles, seed=seed)[0]
    case = _Case(
        grid=grid,
        surface=surface_points(grid.occupied, grid.free, grid.resolution),
        points=scan_points(ranges, angles, np.isfinite(ranges)),
        ranges=ranges,
        angles=angles,
        thetas=uniform_thetas(2 * np.pi / round(at["rho_theta"])),
    )
    area = grid.occupied.size * grid.resolution**2
    return case, area if axis == "A" else float(value)


_Arrays = tuple[npt.NDArray[Any], ...]


class _Recipe(NamedTuple):
    """A method on one case: what prepares it, what runs it and what counts its work."""

    prepare: Callable[[], _Arrays]  # that scans are compared with
    run: Callable[[_Arrays, Float32Array], object]  # fills a stack
    counts: Callable[[_Arrays], tuple[int, int, int]]  # init_work, work and traced


def _taps(case: _Case) -> int:
    """Multiplications of a separable Gaussian: OpenCV's kernel reaches four sigma."""
    return case.grid.occupied.size * 2 * (round(8 * SIGMA / case.grid.resolution + 1) | 1)


def _cbml(c: _Case) -> _Recipe:
    shape, cell = c.grid.info.shape, c.grid.resolution
    return _Recipe(
        lambda: (bmap(c.surface.xy, shape, cell, SIGMA),),
        lambda a, out: cbml(a[0], c.points.xy, c.thetas, cell, engine="shift", out=out),
        lambda _: (_taps(c), pixels_added(c.points.xy, c.thetas, shape, cell), 0),
    )


def _cbml_o(c: _Case) -> _Recipe:
    shape, cell = c.grid.info.shape, c.grid.resolution

    def prepare() -> _Arrays:
        field = vmap(c.surface, shape, cell, SIGMA)
        return field, project(field, _DIRECTIONS)

    added = pixels_added(c.points.xy[c.points.valid], c.thetas, shape, cell)
    return _Recipe(
        prepare,
        lambda a, out: cbml_o(
            a[0], c.points, c.thetas, cell,
            directions=_DIRECTIONS, engine="shift", projections=a[1], out=out,
        ),
        lambda a: (2 * _taps(c) + a[1].size, added, 0),
    )  # fmt: skip


def _arrays(s: OrientedPoints) -> _Arrays:
    return s.xy, s.alpha, s.sigma_alpha, s.valid


def _ght(c: _Case) -> _Recipe:
    shape, cell = c.grid.info.shape, c.grid.resolution
    return _Recipe(
        lambda: _arrays(surface_points(c.grid.occupied, c.grid.free, cell)),
        lambda _, out: ght(c.surface, c.points, len(c.thetas), shape, cell, out=out),
        lambda _: (c.grid.occupied.size, votes_cast(c.surface, None, c.points), 0),
    )


def _ght_v(c: _Case) -> _Recipe:
    shape, cell, s, n = c.grid.info.shape, c.grid.resolution, c.surface, len(c.thetas)
    return _Recipe(
        # As many directions as headings: more are of no use, Sec. V.
        lambda: (*_arrays(s), visibility_frames(c.grid.occupied, s, cell, n, _HORIZON)),
        lambda a, out: ght_v(s, a[-1], c.points, n, shape, cell, out=out),
        lambda a: (int(np.count_nonzero(a[-1])), votes_cast(s, a[-1], c.points), 0),
    )


def _beam(c: _Case) -> _Recipe:
    shape, cell = c.grid.info.shape, c.grid.resolution
    valid = np.isfinite(c.ranges)

    def count(a: _Arrays) -> tuple[int, int, int]:
        metres = 0.01 * float(a[0][:, c.grid.free].sum(dtype=np.float64))
        added = a[0].size * int(valid.sum())
        return ray_cells(shape, len(c.thetas)), added, round(metres / cell)

    return _Recipe(
        lambda: (ray_distances(c.grid.occupied, cell, len(c.thetas), _HORIZON),),
        lambda a, _: beam(a[0], c.ranges, c.angles, valid, c.thetas),
        count,
    )


_RECIPES: Mapping[str, Callable[[_Case], _Recipe]] = {
    "cbml": _cbml, "cbml-o": _cbml_o, "ght": _ght, "ght-v": _ght_v, "beam": _beam,
}  # fmt: skip
_ROWS = {
    "init_s": "init time, s",
    "storage": "storage, bytes",
    "run_s": "run time, s",
    "work": "votes or pixels",
}
_LABELS = {
    "A": "area A, m²",
    "rho_m": "map resolution ρ_m, cells/m",
    "rho_theta": "angle resolution ρ_θ, headings",
    "n": "readings n",
}


COLOURS = {
    "cbml": "#d55e00", "cbml-o": "#e69f00", "ght": "#56b4e9", "ght-v": "#0072b2", "beam": "#555555",
}  # fmt: skip
"""Of the methods, in all curves."""


def draw(complexity: Complexity) -> npt.NDArray[np.uint8]:
    """Draw all samples as one log-log picture, (H, W, 3) BGR; the paper's exponents in brackets."""
    axes = list(dict.fromkeys(s.axis for s in complexity.samples))
    rows = [q for q in _ROWS if any(f.quantity == q for f in complexity.fits)]
    figure, pixels = blank(3.4 * len(axes), 2.8 * len(rows), layout="constrained", dpi=110)
    panels = figure.subplots(len(rows), len(axes), squeeze=False, sharex="col", sharey="row")
    for quantity, line in zip(rows, panels, strict=True):
        line[0].set_ylabel(_ROWS[quantity])
        for axis, panel in zip(axes, line, strict=True):
            for fit in complexity.fits:
                if (fit.quantity, fit.axis) != (quantity, axis):
                    continue
                mine = [s for s in complexity.samples if (s.method, s.axis) == (fit.method, axis)]
                said = "" if fit.paper is None else f" ({fit.paper:g})"
                x, y = [s.value for s in mine], [getattr(s, quantity) for s in mine]
                label = f"{fit.method} {round(fit.exponent, 2) + 0.0:.2f}{said}"
                colour = COLOURS[fit.method]
                panel.loglog(x, y, "o-", color=colour, markersize=3.5, linewidth=1.2, label=label)
            panel.minorticks_off()
            ticks = sorted({s.value for s in complexity.samples if s.axis == axis})
            panel.set_xticks(ticks, [f"{t:,.0f}" if t >= 100 else f"{t:.3g}" for t in ticks])
            panel.grid(alpha=0.25)
            panel.legend(fontsize=6.5, loc="upper left", ncols=2, framealpha=1, edgecolor="none")
        low, high = line[0].get_ylim()
        line[0].set_ylim(low, high * (high / low) ** 0.35)  # room for the legends
    for axis, panel in zip(axes, panels[-1], strict=True):
        panel.set_xlabel(_LABELS[axis])
    figure.suptitle(f"Growth in the world '{complexity.world}': exponents fitted (the paper's)")
    return pixels()
