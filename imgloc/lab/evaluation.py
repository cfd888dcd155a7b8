"""Quality and time of a method that locates scans whose poses are known: `evaluate`.

>>> from imgloc.options import Sensor
>>> from imgloc.simulation.scans import simulate
>>> from imgloc.simulation.worlds import WORLDS, render
>>> from imgloc.pipeline import prepare
>>> grid = render(WORLDS["curved"](), 0.1)
>>> scans = simulate(grid, 2, 0, Sensor(rays=61))
>>> result = evaluate(prepare(grid), scans, method_options("ght-v"))
>>> result.summary.trials, result.lattice.poses_box, 0 < result.summary.index.value < 11
(2, 249600, True)
"""

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from math import nan, sqrt
from typing import Any

import numpy as np

from imgloc.errors import ConfigError, expect
from imgloc.features.mapfeatures import MapFeatures
from imgloc.geometry import (
    cell_of,
    centre_of,
    in_grid_frame,
    inside,
    pose_errors,
    poses_of,
    theta_bin,
    uniform_thetas,
)
from imgloc.io.scanset import ScanSet
from imgloc.lab.performance_index import (
    Index,
    density_at,
    density_in_cell,
    density_in_stack,
    global_maximum,
    performance_index,
)
from imgloc.likelihoods.stacks import likelihood
from imgloc.model import VERDICTS, FloatArray, LaserScan, Localization, Pose2D
from imgloc.options import FUSED, LOG_METHODS, TOLERANCES, Options, Tolerance
from imgloc.pipeline import localize
from imgloc.search.asked import effective
from imgloc.search.stacked import posterior_of

Z95 = 1.959964  #: quantile of the normal distribution for intervals of 95 %
PAPER_STEPS_DEG = {"cbml": 3.0, "cbml-o": 3.0, "ght": 30.0, "ght-v": 30.0, "beam": 3.0}
"""Steps of the headings in Sec. VI, degrees. The beam model, its reference, has the finer step."""
LISTED = 5  #: number of hypotheses of an answer that are compared with the true pose
PERCENTILES = (50, 90, 95)
_MIXTURE = 20  # hypotheses of `fused` that make its density
_FUSED_STEP_DEG = 3.0  # `fused` has no cells; its answers are compared in cells of this step


@dataclass(frozen=True)
class Share:
    """Share of trials in which something happened, with Wilson's interval."""

    hits: int
    trials: int
    value: float  #: hits / trials; NaN without trials
    low: float
    high: float


def share(happened: Iterable[bool]) -> Share:
    """Count hits, with Wilson's 95 % interval, which is sensible at 0 and 1, too.

    Examples
    --------
    >>> s = share([True] * 8 + [False] * 2)
    >>> s.hits, round(s.low, 3), round(s.high, 3)
    (8, 0.49, 0.943)
    >>> share([]).low, share([]).high
    (0.0, 1.0)
    """
    outcomes = [bool(h) for h in happened]
    hits, n = sum(outcomes), len(outcomes)
    if n == 0:
        return Share(0, 0, nan, 0.0, 1.0)
    # Importing scipy.stats takes 0.7 s and 40 MB,
    p, square = hits / n, Z95 * Z95 / n
    middle = (p + square / 2) / (1 + square)
    half = Z95 * sqrt(p * (1 - p) / n + square / (4 * n)) / (1 + square)
    return Share(hits, n, p, max(0.0, middle - half), min(1.0, middle + half))


@dataclass(frozen=True, eq=False)
class Trial:
    """Measurements of one scan; densities are relative ones, ``p V``, at the true pose."""

    free: float  #: density over free cells by the stack without calibration, as in the paper
    box: float  #: density over the whole box of the map by that stack
    calibrated: float  #: density over free cells by the posterior; ``fused``: in its lattice's cell
    outside: bool  #: whether the true pose is in no free cell of the map, so that `free` is 0
    exact: bool  #: whether the global maximum over free cells is the cell of the true pose
    near: bool  #: whether the global maximum is one of the 27 cells around the true pose
    errors: FloatArray  #: (M, 2) metres and radians to each of at most :data:`LISTED` hypotheses
    verdict: str
    ms: float  #: milliseconds of the whole answer
    stack_ms: float  #: milliseconds of the likelihood stack alone; NaN without a stack


@dataclass(frozen=True)
class Success:
    """Shares of right answers under one tolerance."""

    tolerance: Tolerance
    at_1: Share  #: the first hypothesis is right
    at_5: Share  #: one of the first five is
    unique_wrong: Share  #: the verdict is ``unique`` and the first hypothesis is wrong


@dataclass(frozen=True)
class Spread:
    """Median and 99th percentile of the trials; NaN if nothing was measured."""

    median: float
    p99: float


@dataclass(frozen=True)
class Cost:
    """Times: the only part of a summary that differs between two runs."""

    ms: Spread  #: milliseconds of the whole answer for a scan
    stack_ms: Spread  #: milliseconds of the likelihood stack alone


@dataclass(frozen=True)
class Summary:
    """One method on one map."""

    method: str
    trials: int
    index: Index  #: S, eq. 12, over poses in free cells
    index_box: Index  #: S over the whole box of the map
    index_calibrated: Index  #: S of the posterior over free cells; ``fused``: on the lattice
    outside: int  #: number of trials whose true pose is in no free cell
    exact: Share  #: trials whose global maximum is in the cell of the true pose
    near: Share  #: trials whose global maximum is in that cell or one next to it
    success: tuple[Success, ...]
    position: dict[str, float]  #: percentiles of the first hypothesis' error, metres
    #: percentiles of its error in radians; infinite if so many trials have no answer
    heading: dict[str, float]
    verdicts: dict[str, Share]
    cost: Cost


@dataclass(frozen=True)
class Lattice:
    """The lattice of the poses that a method distinguishes."""

    cell: float  #: side of a cell, metres
    theta_step: float  #: step between headings, radians
    poses: int  #: number of poses in free cells
    poses_box: int  #: number of all poses
    log_poses: float  #: S of a method that gives all probability to the right free cell, nats


@dataclass(frozen=True)
class Evaluation:
    """Results of one method on one map, with the parameters that decided them."""

    lattice: Lattice
    summary: Summary
    parameters: dict[str, object]

    def as_row(self, name: str, source: Mapping[str, object]) -> dict[str, Any]:
        """The row of a map, called `name`, as `imgloc evaluate --json` writes it."""
        return {
            "map": name, **asdict(self.summary), "lattice": asdict(self.lattice), "source": source,
            "parameters": self.parameters,
        }  # fmt: skip


def method_options(method: str, theta_step: float | None = None, threads: int = 1) -> Options:
    """Options of a method in an experiment.

    `theta_step` is the step between headings, radians, by default that of the paper. For ``fused``
    it is the step of the endpoint correlation.

    Examples
    --------
    >>> round(np.rad2deg(method_options("ght-v").theta_step))
    30
    """
    if method == FUSED:
        return Options(threads=threads, top=_MIXTURE).stepped(theta_step)
    paper = float(np.deg2rad(PAPER_STEPS_DEG.get(method, 3.0)))
    step = paper if theta_step is None else theta_step
    return Options(method, LISTED, step, threads=threads)


def evaluate(
    features: MapFeatures, scans: ScanSet, options: Options, *,
    tolerances: Sequence[Tolerance] = TOLERANCES, advance: Callable[[], None] = lambda: None,
) -> Evaluation:  # fmt: skip
    """Measure a method on scans with known poses. All but ``summary.cost`` is the same in each run.

    Parameters
    ----------
    features : MapFeatures
        The map.
    scans : ScanSet
        Scans with the true poses of the sensor, map frame. The first scan is located once more than
        the others, before time is measured.
    options : Options
        Options of the method, for example from :func:`method_options`.
    advance : callable
        Called after each trial.

    Raises
    ------
    ConfigError
        If there are no scans or no poses, or an option is out of its range.
    """
    expect(features, MapFeatures, "features")
    expect(scans, ScanSet, "scans")
    expect(options, Options, "options")
    if not len(scans) or scans.poses is None:
        raise ConfigError("expected at least one scan, and the true pose of each")
    next(run_trials(features, scans, options))
    trials = []
    for trial in run_trials(features, scans, options):
        trials.append(trial)
        advance()
    summary = summarise(trials, options.method, tolerances=tolerances)
    n, cell = headings(options), features.lattice.resolution
    poses = n * int(np.count_nonzero(features.free))
    lattice = Lattice(cell, 2 * np.pi / n, poses, n * features.free.size, float(np.log(poses)))
    return Evaluation(lattice, summary, effective(options, features))


def headings(options: Options) -> int:
    """Number of headings in the lattice whose cells are compared."""
    step = np.deg2rad(_FUSED_STEP_DEG) if options.theta_step is None else options.theta_step
    return len(uniform_thetas(float(step)))


def run_trials(features: MapFeatures, scans: ScanSet, options: Options) -> Iterator[Trial]:
    """Locate scan after scan with one method, and compare each answer with the true pose.

    The arguments are those of :func:`evaluate`. The time of the first trial includes features that
    are not computed yet. The stack of a scan is dropped before the next one is computed.
    """
    for scan, pose in scans.with_poses():
        yield _trial(features, scan, Pose2D(*pose), options)


def _trial(features: MapFeatures, scan: LaserScan, truth: Pose2D, options: Options) -> Trial:
    start = time.perf_counter()
    # The default method only gives hypotheses. The paper's methods are measured by their stacks.
    stack = None if options.method == FUSED else likelihood(features, scan, options)
    between = time.perf_counter()
    answer = localize(features, scan, options, stack=stack)
    end = time.perf_counter()
    n = headings(options) if stack is None else len(stack.thetas)
    at = cell_of_pose(features, truth, n)
    on_map = bool(inside(np.array(at[1:]), features.lattice))
    free = on_map and bool(features.free[at[1:]])
    if stack is None:
        found = None if answer.best is None else cell_of_pose(features, answer.best, n)
        cells = np.count_nonzero(features.free), features.free.size
        volumes = [count * features.lattice.resolution**2 * 2 * np.pi for count in cells]
        densities = (
            density_at(answer, truth, volumes[0]) if free else 0.0,
            density_at(answer, truth, volumes[1]) if on_map else 0.0,
            _on_lattice(features, answer, at, n) if free else 0.0,
        )
    else:
        found, log = global_maximum(stack.values, features.free), stack.method in LOG_METHODS
        posterior = posterior_of(features, scan, stack, options)
        box = density_in_stack(stack.values, at, log=log)
        inner = density_in_stack(stack.values, at, features.free, log=log)
        densities = (inner, box, density_in_stack(posterior, at, features.free))
    return Trial(
        *densities, outside=not free, exact=found == at,
        near=found is not None and _next_to(found, at, n),
        errors=pose_errors(poses_of(answer.hypotheses[:LISTED]), truth), verdict=answer.verdict,
        ms=1e3 * (end - start), stack_ms=nan if stack is None else 1e3 * (between - start),
    )  # fmt: skip


def _on_lattice(
    features: MapFeatures, answer: Localization, at: tuple[int, int, int], n: int
) -> float:
    """Relative density of an answer in the cell of the true pose, over free cells."""
    lattice, step = features.lattice, 2 * np.pi / n
    answer = replace(answer, hypotheses=tuple(in_grid_frame(h, lattice) for h in answer.hypotheses))
    x, y = centre_of(np.array(at[1:]), lattice.resolution)
    centre = Pose2D(x, y, uniform_thetas(step)[at[0]])
    poses = n * int(np.count_nonzero(features.free))
    return density_in_cell(answer, centre, lattice.resolution, step, poses)


def cell_of_pose(features: MapFeatures, pose: Pose2D, n: int) -> tuple[int, int, int]:
    """Cell ``(theta, row, col)`` of a pose in the map frame; it may lie off the map."""
    local = in_grid_frame(pose, features.lattice)
    row, col = cell_of(np.array([local.x, local.y]), features.lattice.resolution).tolist()
    return int(theta_bin(local.theta, n)), row, col


def _next_to(a: tuple[int, int, int], b: tuple[int, int, int], n: int) -> bool:
    """Return whether no coordinate differs by more than one, theta around the circle."""
    turn = abs(a[0] - b[0])
    return min(turn, n - turn) <= 1 and max(abs(a[1] - b[1]), abs(a[2] - b[2])) <= 1


def summarise(
    trials: Sequence[Trial], method: str, *, tolerances: Sequence[Tolerance] = TOLERANCES,
) -> Summary:  # fmt: skip
    """Summarise the trials, at least one, of one method on one map.

    `tolerances` set how near to the true pose a hypothesis is right.
    """
    first = np.array([t.errors[0] if len(t.errors) else (np.inf, np.inf) for t in trials])
    return Summary(
        method=method,
        trials=len(trials),
        index=performance_index([t.free for t in trials]),
        index_box=performance_index([t.box for t in trials]),
        index_calibrated=performance_index([t.calibrated for t in trials]),
        outside=sum(t.outside for t in trials),
        exact=share(t.exact for t in trials),
        near=share(t.near for t in trials),
        success=tuple(_success(trials, tolerance) for tolerance in tolerances),
        position=_percentiles(first[:, 0]),
        heading=_percentiles(first[:, 1]),
        verdicts={v: share(t.verdict == v for t in trials) for v in VERDICTS},
        cost=Cost(
            ms=_spread([t.ms for t in trials]), stack_ms=_spread([t.stack_ms for t in trials])
        ),
    )


def right(trial: Trial, tolerance: Tolerance, first: int) -> bool:
    """True if one of the `first` hypotheses is nearer than the tolerance to the true pose."""
    errors = trial.errors[:first]
    return bool(np.any((errors[:, 0] < tolerance.position) & (errors[:, 1] < tolerance.heading)))


def _success(trials: Sequence[Trial], tolerance: Tolerance) -> Success:
    at_1 = [right(t, tolerance, 1) for t in trials]
    at_5 = share(right(t, tolerance, LISTED) for t in trials)
    wrong = (t.verdict == "unique" and not ok for t, ok in zip(trials, at_1, strict=True))
    return Success(tolerance, share(at_1), at_5, share(wrong))


def _percentiles(errors: FloatArray) -> dict[str, float]:
    """Percentiles without interpolation, because errors may be infinite."""
    values = np.percentile(errors, PERCENTILES, method="inverted_cdf")
    return {f"p{q}": float(v) for q, v in zip(PERCENTILES, values, strict=True)}


def _spread(values: Sequence[float]) -> Spread:
    if not len(values) or np.isnan(values).any():
        return Spread(nan, nan)
    median, p99 = np.percentile(values, (50, 99))
    return Spread(float(median), float(p99))
