"""The table of Sec. VI: five methods in three worlds, beside the paper's own numbers.

For the table a stack is needed only for what it gives to the true pose and for where its
maximum is; no peaks are looked for. The beam model is the oracle: what could be known.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from imgloc.errors import ConfigError
from imgloc.experiments.evaluate import PAPER_STEPS_DEG, method_options
from imgloc.experiments.index import Index, density_in_stack, global_maximum, performance_index
from imgloc.experiments.scansets import Sensor, simulate_set
from imgloc.experiments.shares import Z95, Share, share
from imgloc.experiments.worlds import WORLDS, render
from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.scanpoints import scan_points
from imgloc.geometry import cell_of, theta_bin, uniform_thetas
from imgloc.io.scanset import ScanSet
from imgloc.likelihood.beam import temperature
from imgloc.likelihood.ght import ght_v
from imgloc.likelihood.uncertainty import Uncertainty
from imgloc.model import Float32Array, FloatArray, LaserScan, Pose2D
from imgloc.pipeline import METHODS

CELL = 0.1
"""Side of a cell of the pose space, metres: the paper's."""
MAP_CELL = 0.05
"""Side of a cell of the maps, metres. The paper's maps are lines; at 10 cm the staircase of a
slanted or curved wall displaces its surface by as much as the cell of a pose."""
PLACES: Mapping[str, str] = MappingProxyType(
    {"visibility": "Fig. 2", "large": "Fig. 5", "curved": "curved env."}
)
"""The worlds of the table, and what the paper calls the one that each stands for."""
OPTIONS = ("ght-v once", "ght-v eq. 8")
"""Sec. VII's suggestions, each an option of GHT-V: one vote per scan point and cell; eq. 8."""
STEPS_DEG: Mapping[str, float] = MappingProxyType(
    PAPER_STEPS_DEG | dict.fromkeys(OPTIONS, PAPER_STEPS_DEG["ght-v"])
)
"""Methods of the table, and the steps of their headings in degrees: the paper's."""
PAPER_S: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {
        "cbml": {"visibility": -0.47, "large": -0.27, "curved": -0.35},
        "cbml-o": {"visibility": 0.71, "large": 0.65, "curved": 0.96},
        "ght": {"visibility": 2.85, "large": 2.10, "curved": 2.20},
        "ght-v": {"visibility": 3.71, "large": 2.93, "curved": 2.91},
    }
)
"""The paper's S, eq. 12, nats."""


@dataclass(frozen=True)
class Row:
    """One method in one world.

    Parameters
    ----------
    world, method : str
    step_deg : float
        Between headings.
    index : Index
        S over the poses in free cells.
    bare : Index or None
        For ``beam``: S if its readings are taken for independent, as eq. 2 has them.
    log_poses : float
        The greatest S that there can be: everything in the right cell.
    exact, near : Share
        The global maximum is the cell of the true pose; that or one next to it.
    paper : float or None
        The paper's S in the world that this one stands for.
    ms : (n,) tuple of float
        Times of the likelihood stacks, one for each trial; they differ from run to run.
    """

    world: str
    method: str
    step_deg: float
    index: Index
    bare: Index | None
    log_poses: float
    exact: Share
    near: Share
    paper: float | None
    ms: tuple[float, ...]

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of S."""
        half = Z95 * self.index.standard_error
        return self.index.value - half, self.index.value + half

    @property
    def median_ms(self) -> float:
        """Median of the times."""
        return float(np.median(self.ms))


@dataclass(frozen=True)
class _Trial:
    density: float
    bare: float | None
    exact: bool
    near: bool
    ms: float


def table(
    n: int = 100,
    seed: int = 0,
    *,
    worlds: Sequence[str] = tuple(PLACES),
    methods: Sequence[str] = tuple(STEPS_DEG),
    threads: int = 1,
    advance: Callable[[], None] = lambda: None,
) -> tuple[Row, ...]:
    """Measure the table.

    All methods locate the same scans, in turns, so that a busy moment of the machine is in the
    times of all of them.

    Parameters
    ----------
    n : int
        Trials in each world.
    seed : int
        Of the poses and the noise.
    worlds, methods : sequence of str
        Some of :data:`PLACES` and of :data:`STEPS_DEG`.
    threads : int
        No number but the times depends on it.
    advance : callable
        Called ``n * len(worlds) * len(methods)`` times.

    Raises
    ------
    ConfigError
        If there are no trials, or no such world or method.

    Examples
    --------
    >>> [(r.method, r.index.trials) for r in table(2, worlds=["curved"], methods=["ght"])]
    [('ght', 2)]
    """
    if n < 1:
        raise ConfigError(f"n must be at least 1, got {n}")
    for name, known in [(w, PLACES) for w in worlds] + [(m, STEPS_DEG) for m in methods]:
        if name not in known:
            raise ConfigError(f"expected one of {', '.join(known)}, got {name!r}")
    rows: list[Row] = []
    for world in worlds:
        features, scans = place(world, n, seed, threads)
        trials: dict[str, list[_Trial]] = {method: [] for method in methods}
        for method in methods:  # features are computed before the clock counts
            _trial(method, features, scans.scans[0], _truth(scans, 0), threads)
        for k, scan in enumerate(scans.scans):
            for method in methods:
                trials[method].append(_trial(method, features, scan, _truth(scans, k), threads))
                advance()
        rows += [_row(world, method, features, trials[method]) for method in methods]
    return tuple(rows)


def place(world: str, n: int, seed: int, threads: int = 1) -> tuple[MapFeatures, ScanSet]:
    """The map of a world and scans in it, as ``imgloc evaluate`` makes them."""
    grid = render(WORLDS[world](), MAP_CELL)
    scans = simulate_set(grid, n, seed, Sensor(), render(WORLDS[world](), 0.01))
    return MapFeatures(grid, cell=CELL, threads=threads), scans


def stack_of(
    method: str, features: MapFeatures, scan: LaserScan, thetas: FloatArray, threads: int = 1
) -> Float32Array:
    """Likelihood stack (K, H, W) of a method of :data:`STEPS_DEG`."""
    if method not in OPTIONS:
        options = method_options(method, threads=threads)
        return METHODS[method].stack(features, scan, thetas, options)
    points = scan_points(scan.ranges, scan.angles, scan.valid)
    return ght_v(
        features.surface,
        features.visibility,
        points,
        len(thetas),
        features.lattice.shape,
        CELL,
        threads=threads,
        once=method == "ght-v once",
        uncertainty=Uncertainty() if method == "ght-v eq. 8" else None,
    )


def _truth(scans: ScanSet, k: int) -> Pose2D:
    """True pose of a scan; the map frame of a world is its grid frame."""
    poses = np.empty((0, 3)) if scans.poses is None else scans.poses
    return Pose2D(*poses[k])


def _trial(
    method: str, features: MapFeatures, scan: LaserScan, truth: Pose2D, threads: int
) -> _Trial:
    thetas = uniform_thetas(np.deg2rad(STEPS_DEG[method]))
    row, col = cell_of(np.array((truth.x, truth.y)), CELL).tolist()
    at = int(theta_bin(truth.theta, len(thetas))), row, col
    start = time.perf_counter()
    stack = stack_of(method, features, scan, thetas, threads)
    ms = 1e3 * (time.perf_counter() - start)
    bare, log = None, method == "beam"
    if log:
        bare = density_in_stack(stack, at, features.free, log=True)
        stack *= np.float32(1 / temperature(int(scan.valid.sum())))
    off = np.abs(np.subtract(global_maximum(stack, features.free), at))
    off[0] = min(off[0], len(thetas) - off[0])  # around the circle
    return _Trial(
        density=density_in_stack(stack, at, features.free, log=log),
        bare=bare,
        exact=not off.any(),
        near=bool(off.max() <= 1),
        ms=ms,
    )


def _row(world: str, method: str, features: MapFeatures, trials: Sequence[_Trial]) -> Row:
    bare = [t.bare for t in trials if t.bare is not None]
    poses = len(uniform_thetas(np.deg2rad(STEPS_DEG[method]))) * np.count_nonzero(features.free)
    return Row(
        world=world,
        method=method,
        step_deg=STEPS_DEG[method],
        index=performance_index([t.density for t in trials]),
        bare=performance_index(bare) if bare else None,
        log_poses=float(np.log(poses)),
        exact=share(t.exact for t in trials),
        near=share(t.near for t in trials),
        paper=PAPER_S.get(method, {}).get(world),
        ms=tuple(t.ms for t in trials),
    )
