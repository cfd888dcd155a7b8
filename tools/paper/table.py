"""The table of Sec. VI: five methods in three worlds, beside the paper's own numbers; and times.

Of a stack only what it gives to the true pose is needed, and where its maximum is; no peaks are
looked for. The beam model is the oracle: what could be known. Run times that the appendix calls
nearly equal are compared fairly: two methods take turns on the same scans, and what is counted
is the CPU time of the one thread in which they run, which other programs do not use up.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType

import numpy as np

from imgloc import LaserScan, MapFeatures, Pose2D, ScanSet
from imgloc.features.scanpoints import scan_points
from imgloc.geometry import theta_bin, uniform_thetas
from imgloc.lab.evaluation import PAPER_STEPS_DEG, Z95, Share, cell_of_pose, share
from imgloc.lab.performance_index import (
    FLOOR,
    Index,
    density_in_stack,
    global_maximum,
    performance_index,
)
from imgloc.likelihoods import stacks
from imgloc.likelihoods.ght import ght_v
from imgloc.model import Float32Array, FloatArray
from imgloc.options import DEFAULTS
from tools.recorded import in_world
from tools.script import at_least_one, one_of, take_turns

CELL = 0.1
"""Side of a cell of the pose space, metres: the paper's."""
MAP_CELL = 0.05
"""Side of a cell of the maps, metres. The paper's maps are lines; at 10 cm the staircase of a
slanted or curved wall displaces its surface by as much as the cell of a pose."""
OPTIONS = ("ght-v once",)
"""Sec. VII's suggestion, an option of GHT-V: one vote per scan point and cell."""
STEPS_DEG: Mapping[str, float] = MappingProxyType(
    PAPER_STEPS_DEG | dict.fromkeys(OPTIONS, PAPER_STEPS_DEG["ght-v"])
)
"""Methods of the table, and the steps of their headings in degrees: the paper's."""
WIDE_DEG = 30.0
"""The widest of those steps: cells in which all methods can be compared."""


@dataclass(frozen=True)
class Outcome:
    """What the stack of one scan gives."""

    density: float  #: relative density at the true pose, see :mod:`imgloc.lab.performance_index`
    bare: float | None  #: for ``beam``: the same if its readings are taken for independent
    exact: bool  #: the maximum is the cell of the true pose
    near: bool  #: it is that cell or one next to it, of the 27
    wide: bool  #: they share a cell, or would if headings were :data:`WIDE_DEG` apart
    ms: float  #: time of the stack


def place(world: str, n: int, seed: int, threads: int = 1) -> tuple[MapFeatures, ScanSet]:
    """The map of a world and scans in it, as ``imgloc evaluate`` makes them."""
    grid, scans = in_world(world, n, seed, cell=MAP_CELL)
    return MapFeatures(grid, cell=CELL, threads=threads), scans


def thetas_of(method: str) -> FloatArray:
    """Headings of a method of :data:`STEPS_DEG`, radians."""
    return uniform_thetas(np.deg2rad(STEPS_DEG[method]))


def stack_of(
    method: str,
    features: MapFeatures,
    scan: LaserScan,
    thetas: FloatArray,
    threads: int = 1,
    engine: str = "auto",
) -> Float32Array:
    """Likelihood stack (K, H, W) of a method of :data:`STEPS_DEG`; `engine` of correlations."""
    if method not in OPTIONS:
        return stacks.stack_of(method, features, scan, thetas, engine=engine, threads=threads)
    points = scan_points(scan.ranges, scan.angles, scan.valid)
    ours, shape = (features.surface, features.visibility, points), features.lattice.shape
    return ght_v(*ours, len(thetas), shape, CELL, threads=threads, once=True)


def try_method(
    method: str,
    features: MapFeatures,
    scan: LaserScan,
    truth: FloatArray,
    threads: int = 1,
    engine: str = "auto",
) -> Outcome:
    """Compute a method's stack and look where the true pose (3,), grid frame, stands in it.

    The log-likelihoods of ``beam`` are divided by the temperature of
    :data:`imgloc.options.DEFAULTS`, as in an answer of ``imgloc localize``.
    """
    thetas = thetas_of(method)
    at = cell_of_pose(features, Pose2D(*truth), len(thetas))
    start = time.perf_counter()
    stack = stack_of(method, features, scan, thetas, threads, engine)
    ms = 1e3 * (time.perf_counter() - start)
    bare, log = None, method == "beam"
    if log:
        bare = density_in_stack(stack, at, features.free, log=True)
        stack *= np.float32(1 / DEFAULTS[method].temperature_at(method, int(scan.valid.sum())))
    found = global_maximum(stack, features.free)
    off = np.abs(np.subtract(found, at))
    off[0] = min(off[0], len(thetas) - off[0])  # around the circle
    wide = theta_bin(np.array((thetas[found[0]], truth[2])), round(360 / WIDE_DEG))
    return Outcome(
        density=density_in_stack(stack, at, features.free, log=log),
        bare=bare,
        exact=not off.any(),
        near=bool(off.max() <= 1),
        wide=bool(not off[1:].any() and (off[0] == 0 or wide[0] == wide[1])),
        ms=ms,
    )


PLACES: Mapping[str, str] = MappingProxyType(
    {"visibility": "Fig. 2", "large": "Fig. 5", "curved": "curved env."}
)
"""The worlds of the table, and what the paper calls the one that each stands for."""
PAPER_S: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {
        "cbml": {"visibility": -0.47, "large": -0.27, "curved": -0.35},
        "cbml-o": {"visibility": 0.71, "large": 0.65, "curved": 0.96},
        "ght": {"visibility": 2.85, "large": 2.10, "curved": 2.20},
        "ght-v": {"visibility": 3.71, "large": 2.93, "curved": 2.91},
    }
)
"""The paper's S, eq. 12, nats."""
_PLAIN = "ght-v"


@dataclass(frozen=True)
class Gain:
    """Mean of S's differences to plain GHT-V, scan by scan, with its standard error, nats."""

    value: float
    standard_error: float


@dataclass(frozen=True)
class TableRow:
    """One method in one world."""

    world: str
    method: str
    step_deg: float  #: between headings
    index: Index  #: S over the poses in free cells
    bare: Index | None  #: for ``beam``: S if its readings are independent, as eq. 2 has them
    gain: Gain | None  #: for an option of GHT-V, if plain GHT-V is in the table too
    log_poses: float  #: the greatest S that there can be: everything in the right cell
    exact: Share  #: the global maximum is the cell of the true pose
    wide: Share  #: it would be if headings were 30 degrees apart
    near: Share  #: it is that cell or one next to it
    paper: float | None  #: the paper's S in the world that this one stands for
    ms: tuple[float, ...]  #: times of the stacks; the map is prepared within the first

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of S."""
        half = Z95 * self.index.standard_error
        return self.index.value - half, self.index.value + half


def table(
    n: int = 100,
    seed: int = 0,
    *,
    worlds: Sequence[str] = tuple(PLACES),
    methods: Sequence[str] = tuple(STEPS_DEG),
    threads: int = 1,
    advance: Callable[[], None] = lambda: None,
) -> tuple[TableRow, ...]:
    """Measure the table: `n` trials in each of some :data:`PLACES` by some of :data:`STEPS_DEG`.

    All methods locate the same scans, in turns, so that a busy moment of the machine is in the
    times of all of them. `advance` is called ``n * len(worlds) * len(methods)`` times.

    Examples
    --------
    >>> [(r.method, r.index.trials) for r in table(2, worlds=["curved"], methods=["ght"])]
    [('ght', 2)]
    """
    at_least_one(n=n)
    one_of(worlds, PLACES)
    one_of(methods, STEPS_DEG)
    rows: list[TableRow] = []
    for world in worlds:
        features, scans = place(world, n, seed, threads)
        trials: dict[str, list[Outcome]] = {method: [] for method in methods}
        for scan, pose in scans.with_poses():  # a world's map frame is its grid frame
            for method in methods:
                trials[method].append(try_method(method, features, scan, pose, threads))
                advance()
        free = int(np.count_nonzero(features.free))
        rows += [_row(world, method, free, trials) for method in methods]
    return tuple(rows)


def _row(
    world: str, method: str, free: int, all_trials: Mapping[str, Sequence[Outcome]]
) -> TableRow:
    trials = all_trials[method]
    bare = [t.bare for t in trials if t.bare is not None]
    paired = method in OPTIONS and _PLAIN in all_trials
    return TableRow(
        world=world,
        method=method,
        step_deg=STEPS_DEG[method],
        index=performance_index([t.density for t in trials]),
        bare=performance_index(bare) if bare else None,
        gain=gain(trials, all_trials[_PLAIN]) if paired else None,
        log_poses=float(np.log(len(thetas_of(method)) * free)),
        exact=share(t.exact for t in trials),
        wide=share(t.wide for t in trials),
        near=share(t.near for t in trials),
        paper=PAPER_S.get(method, {}).get(world),
        ms=tuple(t.ms for t in trials),
    )


def gain(trials: Sequence[Outcome], plain: Sequence[Outcome]) -> Gain:
    """Compare a method with another one on the same scans, which cancels what they share.

    Examples
    --------
    >>> a, b = ([Outcome(d, None, True, True, True, 1.0)] * 4 for d in (2.0, 1.0))
    >>> round(gain(a, b).value, 2), gain(a, b).standard_error
    (0.69, 0.0)
    """
    ours, theirs = (np.array([t.density for t in some]) for some in (trials, plain))
    by_scan = np.log((1 - FLOOR) * ours + FLOOR) - np.log((1 - FLOOR) * theirs + FLOOR)
    scatter = float(by_scan.std(ddof=1)) if len(by_scan) > 1 else float("nan")
    return Gain(float(by_scan.mean()), scatter / len(by_scan) ** 0.5)


PAIRS = (("cbml-o", "cbml", 1.3), ("ght-v", "ght", 1.1))
"""Method, its rival, and the ratio that still counts as "virtually the same"."""


@dataclass(frozen=True)
class Ratio:
    """CPU time of a method over that of its rival."""

    world: str
    method: str
    rival: str
    most: float  #: the ratio that still counts as the same
    ms: float  #: median over the scans of the medians of the repeats
    rival_ms: float
    value: float  #: median over the scans of the ratios of those medians


def measure_ratios(
    n: int = 5,
    repeats: int = 5,
    seed: int = 0,
    *,
    trials: int | None = None,
    worlds: Sequence[str] = tuple(PLACES),
    advance: Callable[[], None] = lambda: None,
) -> tuple[Ratio, ...]:
    """Compare the methods of :data:`PAIRS` on `n` scans of each world.

    They are the first of the table's if `seed` and `trials` are. Each stack is computed `repeats`
    times. `advance` is called ``n * len(worlds) * len(PAIRS)`` times.
    """
    out = []
    for world in worlds:
        features, scans = place(world, trials or n, seed)
        for method, rival, most in PAIRS:
            runs = [
                [partial(stack_of, m, features, scan, thetas_of(m)) for m in (method, rival)]
                for scan in scans.scans[:n]
            ]
            for run in runs[0]:  # features are computed before the clock counts
                run()
            times = []
            for pair in runs:
                times.append(np.median(take_turns(pair, repeats, time.thread_time), axis=1))
                advance()
            ours, theirs = np.array(times).T
            out.append(
                Ratio(
                    world, method, rival, most, 1e3 * float(np.median(ours)),
                    1e3 * float(np.median(theirs)), float(np.median(ours / theirs)),
                )
            )  # fmt: skip
    return tuple(out)
