"""The paper's appendix, measured: how init time, storage and run time grow, and the work counted.

One quantity grows at a time, over a factor of eight: the area A (a world tiled), the map's
resolution rho_m (the polygons drawn with smaller cells), the resolution rho_theta of headings,
the number n of readings. Straight lines fitted to the logarithms give the exponents. Times are
those of this machine at this minute; counts are exact and the same everywhere.
"""

import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from imgloc.errors import ConfigError
from imgloc.experiments.complexity_picture import draw
from imgloc.experiments.complexity_recipes import RECIPES, Case, case_at
from imgloc.experiments.complexity_types import (
    AXES,
    BASE,
    METHODS,
    PAPER,
    QUANTITIES,
    Complexity,
    Fit,
    Sample,
)
from imgloc.worlds import WORLDS

__all__ = [
    "AXES", "BASE", "METHODS", "PAPER", "QUANTITIES", "Complexity", "Fit", "Sample", "draw",
    "fit_exponent", "measure",
]  # fmt: skip


def measure(
    world: str = "curved",
    *,
    methods: tuple[str, ...] = METHODS,
    axes: Mapping[str, tuple[float, ...]] = AXES,
    repeats: int = 3,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> Complexity:
    """Measure how the methods grow.

    Parameters
    ----------
    world : str
        Of :data:`imgloc.worlds.WORLDS`.
    methods : tuple of str
        Some of :data:`METHODS`.
    axes : mapping of str to tuple of float
        Some of :data:`AXES`, or other values for them; the rest stays at :data:`BASE`.
    repeats : int
        How often a run is timed; the shortest time counts. 0 only counts, which needs no runs.
    seed : int
        Of the sensor's pose and of its noise.
    progress : callable, optional
        Told what is about to be measured.

    Returns
    -------
    Complexity

    Raises
    ------
    ConfigError
        If there is no such world, method or axis, or fewer than two values of one.

    Examples
    --------
    >>> counted = measure(methods=("ght",), axes={"n": (90, 180)}, repeats=0)
    >>> abs(round(counted.exponent("ght", "n", "work"), 1))
    1.0
    """
    if world not in WORLDS:
        raise ConfigError(f"there is no world {world!r}, expected one of {', '.join(WORLDS)}")
    for name in methods:
        if name not in METHODS:
            raise ConfigError(f"there is no method {name!r}, expected some of {', '.join(METHODS)}")
    for axis, values in axes.items():
        if axis not in AXES or len(values) < 2 or min(values) <= 0:
            raise ConfigError(
                f"axis {axis!r} with {values}: expected one of {', '.join(AXES)} with "
                "at least two positive values"
            )
    samples = []
    for axis, values in axes.items():
        for value in values:
            if progress is not None:
                progress(f"{axis} = {value:g}")
            case, value_si = case_at(world, axis, value, seed)
            samples += [_sample(name, axis, value_si, case, repeats) for name in methods]
    return Complexity(world, tuple(samples), tuple(_fits(samples)))


def _sample(method: str, axis: str, value: float, case: Case, repeats: int) -> Sample:
    recipe = RECIPES[method](case)
    arrays, init_s = _timed(recipe.prepare, repeats)
    run_s = np.nan
    if repeats:
        # Written to: the page faults of fresh memory would be timed with the first run.
        out = np.ones((len(case.thetas), *case.grid.info.shape), np.float32)
        run_s = _timed(lambda: recipe.run(arrays, out), repeats)[1]
    init_work, work, traced = recipe.count(arrays)
    storage = sum(array.nbytes for array in arrays)
    return Sample(method, axis, value, init_s, run_s, storage, init_work, work, traced)


def _timed(function: Callable[[], Any], repeats: int) -> tuple[Any, float]:
    """Return the last result and the shortest time, NaN when it was not to be timed."""
    times = []
    for _ in range(max(1, repeats)):
        start = time.perf_counter()
        result = function()
        times.append(time.perf_counter() - start)
    return result, min(times) if repeats else float("nan")


def fit_exponent(x: npt.ArrayLike, y: npt.ArrayLike) -> float:
    """Least-squares slope of log y over log x.

    Examples
    --------
    >>> round(fit_exponent([1, 2, 4], [3, 12, 48]), 6)
    2.0
    """
    return float(np.polyfit(np.log(np.asarray(x, float)), np.log(np.asarray(y, float)), 1)[0])


def _fits(samples: list[Sample]) -> Iterator[Fit]:
    for method, axis in dict.fromkeys((s.method, s.axis) for s in samples):
        mine = [s for s in samples if (s.method, s.axis) == (method, axis)]
        for quantity in (*QUANTITIES, "traced"):
            values = [getattr(s, quantity) for s in mine]
            if not all(v > 0 for v in values):  # NaN is not
                continue
            exponent = fit_exponent([s.value for s in mine], values)
            paper = {"work": "run_s", "traced": "init_s"}.get(quantity, quantity)
            said = PAPER[method].get(paper, {}).get(axis)
            yield Fit(method, axis, quantity, exponent, said)
