"""Trials: a method locates a scan whose pose is known.

One trial at a time: the stack of a scan is measured and dropped before the next one is
computed, so that there is never more than one. :mod:`imgloc.experiments.summary` makes numbers
of the trials.
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from imgloc.experiments.index import (
    density_at,
    density_in_cell,
    density_in_stack,
    global_maximum,
)
from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.scanpoints import scan_points
from imgloc.geometry import (
    cell_of,
    centre_of,
    compose,
    inside,
    inverse,
    theta_bin,
    uniform_thetas,
    wrap,
)
from imgloc.io.scanset import ScanSet
from imgloc.likelihood.calibration import LOG_METHODS
from imgloc.model import FloatArray, LaserScan, Likelihood, Localization, Pose2D
from imgloc.pipeline import FUSED, Options, found_in_stack, in_map_frame, likelihood, localize
from imgloc.search.trust import judge
from imgloc.searches import NOTHING, probability_of

PAIR_METHODS = frozenset({"ght", "ght-v"})
"""Methods whose work is counted in pairs of points, not in poses and readings."""
LISTED = 5
"""Hypotheses of an answer that are compared with the true pose."""
_FUSED_STEP_DEG = 3.0  # of the cells in which the answer of `fused`, which has none, is compared


@dataclass(frozen=True)
class Trial:
    """What one scan has shown.

    Parameters
    ----------
    free, box : float
        Relative density, ``p V``, at the true pose; over free cells and over the whole box.
        Of a stack as it is, as in the paper.
    calibrated : float
        The same over free cells of the calibrated posterior; of ``fused``, which has no cells,
        that of the lattice's cell.
    outside : bool
        The true pose is not in a free cell of the map, so that `free` is 0.
    exact, near : bool
        The global maximum over free cells is the cell of the true pose; is it or a next one
        (of the 27).
    errors : (M, 2) float array
        Metres and radians from the true pose to each of at most `LISTED` hypotheses.
    verdict : str
    ms : float
        Time of the whole answer.
    stack_ms : float
        Time of the likelihood stack alone; NaN where there is none.
    stack_bytes : int
    work : int
        Poses times readings, or pairs of points; 0 without a stack.
    """

    free: float
    box: float
    calibrated: float
    outside: bool
    exact: bool
    near: bool
    errors: FloatArray
    verdict: str
    ms: float
    stack_ms: float
    stack_bytes: int
    work: int


def headings(options: Options) -> int:
    """Number of headings of the lattice in which cells of poses are compared."""
    step = np.deg2rad(_FUSED_STEP_DEG) if options.theta_step is None else options.theta_step
    return len(uniform_thetas(float(step)))


def run_trials(features: MapFeatures, scans: ScanSet, options: Options) -> Iterator[Trial]:
    """Locate scan after scan with one method and compare with the true poses.

    Parameters
    ----------
    features : MapFeatures
        What is not computed yet is so within the time of the first trial.
    scans : ScanSet
        With poses of the sensor in the map frame.
    options : Options
        See :func:`~imgloc.experiments.evaluate.method_options`.

    Yields
    ------
    Trial
        One for each scan.

    Raises
    ------
    ConfigError
        If an option is out of its range, or the stack over the memory budget.
    """
    poses = np.empty((0, 3)) if scans.poses is None else scans.poses
    for scan, pose in zip(scans.scans, poses, strict=True):
        trial = _trial_fused if options.method == FUSED else _trial_stack
        yield trial(features, scan, Pose2D(*pose), options)


def _trial_fused(features: MapFeatures, scan: LaserScan, truth: Pose2D, options: Options) -> Trial:
    """The default method: hypotheses are all that it says."""
    start = time.perf_counter()
    answer = localize(features, scan, options)
    ms = 1e3 * (time.perf_counter() - start)
    n, lattice = headings(options), features.lattice
    at = cell_of_pose(features, truth, n)
    found = None if answer.pose is None else cell_of_pose(features, answer.pose, n)
    cells = np.count_nonzero(features.free), lattice.height * lattice.width
    volumes = [count * lattice.resolution**2 * 2 * np.pi for count in cells]
    on_map = bool(inside(np.array(at[1:]), lattice))
    free = on_map and bool(features.free[at[1:]])
    poses = np.array([(h.pose.x, h.pose.y, h.pose.theta) for h in answer.hypotheses[:LISTED]])
    return Trial(
        free=density_at(answer, truth, volumes[0]) if free else 0.0,
        box=density_at(answer, truth, volumes[1]) if on_map else 0.0,
        calibrated=_on_lattice(features, answer, at, n) if free else 0.0,
        outside=not free,
        exact=found == at,
        near=found is not None and _next_to(found, at, n),
        errors=pose_errors(poses, truth),
        verdict=answer.verdict,
        ms=ms,
        stack_ms=float("nan"),
        stack_bytes=0,
        work=0,
    )


def _trial_stack(features: MapFeatures, scan: LaserScan, truth: Pose2D, options: Options) -> Trial:
    """One of the paper's methods: the whole stack is looked at."""
    start = time.perf_counter()
    stack = likelihood(features, scan, options)
    between = time.perf_counter()
    directions = scan.directions
    enough = directions >= max(1, options.trust.readings)
    answer = found_in_stack(features, scan, stack, options) if enough else NOTHING
    end = time.perf_counter()
    n, log = len(stack.thetas), stack.method in LOG_METHODS
    at, found = cell_of_pose(features, truth, n), global_maximum(stack.values, features.free)
    free = bool(inside(np.array(at[1:]), stack.grid)) and bool(features.free[at[1:]])
    probability = probability_of(features, scan, stack, options)
    poses = np.array([(h.pose.x, h.pose.y, h.pose.theta) for h in answer.hypotheses[:LISTED]])
    return Trial(
        free=density_in_stack(stack.values, at, features.free, log=log),
        box=density_in_stack(stack.values, at, log=log),
        calibrated=density_in_stack(probability, at, features.free),
        outside=not free,
        exact=found == at,
        near=_next_to(found, at, n),
        errors=pose_errors(poses, compose(inverse(features.grid.origin), truth)),
        verdict=judge(directions, answer.mass, answer.elsewhere, options.trust),
        ms=1e3 * (end - start),
        stack_ms=1e3 * (between - start),
        stack_bytes=stack.values.nbytes,
        work=_work(features, scan, stack),
    )


def _on_lattice(
    features: MapFeatures, answer: Localization, at: tuple[int, int, int], n: int
) -> float:
    """Relative density of an answer in a cell of free space."""
    lattice = features.lattice
    to_grid = replace(lattice, origin=inverse(lattice.origin))
    local = replace(answer, hypotheses=tuple(in_map_frame(h, to_grid) for h in answer.hypotheses))
    x, y = centre_of(np.array(at[1:]), lattice.resolution)
    thetas = uniform_thetas(2 * np.pi / n)
    poses = n * int(np.count_nonzero(features.free))
    side = lattice.resolution
    return density_in_cell(local, Pose2D(x, y, thetas[at[0]]), side, 2 * np.pi / n, poses)


def _work(features: MapFeatures, scan: LaserScan, stack: Likelihood) -> int:
    """Pairs of points that may vote, or poses of the box times the readings that count."""
    if stack.method in ("cbml", "beam"):
        return stack.values.size * int(scan.valid.sum())
    oriented = int(scan_points(scan.ranges, scan.angles, scan.valid).valid.sum())
    if stack.method in PAIR_METHODS:
        return oriented * int(features.surface.valid.sum())
    return stack.values.size * oriented


def pose_errors(poses: FloatArray, truth: Pose2D) -> FloatArray:
    """Distances in metres and angles in radians, (M, 2), from poses (M, 3) to the true one.

    Examples
    --------
    >>> pose_errors(np.array([[3.0, 4.0, 3.0]]), Pose2D(0, 0, -3.0)).round(3).tolist()
    [[5.0, 0.283]]
    """
    poses = np.asarray(poses, dtype=np.float64).reshape(-1, 3)
    away = np.hypot(poses[:, 0] - truth.x, poses[:, 1] - truth.y)
    return np.column_stack((away, np.abs(wrap(poses[:, 2] - truth.theta))))


def cell_of_pose(features: MapFeatures, pose: Pose2D, n: int) -> tuple[int, int, int]:
    """Cell ``(theta, row, col)`` of a pose of the map frame; may lie off the map."""
    local = compose(inverse(features.grid.origin), pose)
    row, col = cell_of(np.array([local.x, local.y]), features.lattice.resolution).tolist()
    return int(theta_bin(local.theta, n)), row, col


def _next_to(a: tuple[int, int, int], b: tuple[int, int, int], n: int) -> bool:
    """Whether no coordinate differs by more than one, theta around the circle."""
    turn = abs(a[0] - b[0])
    return min(turn, n - turn) <= 1 and max(abs(a[1] - b[1]), abs(a[2] - b[2])) <= 1
