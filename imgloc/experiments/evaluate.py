"""How well and at what cost a method locates scans whose poses are known: `evaluate`.

>>> from imgloc.experiments.scansets import Sensor, simulate_set
>>> from imgloc.experiments.worlds import WORLDS, render
>>> from imgloc.pipeline import prepare
>>> grid = render(WORLDS["curved"](), 0.1)
>>> scans = simulate_set(grid, 2, 0, Sensor(rays=61))
>>> result = evaluate(prepare(grid), scans, method_options("ght-v"))
>>> result.summary.trials, result.lattice.poses_box, 0 < result.summary.index.value < 11
(2, 249600, True)
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imgloc.errors import ConfigError
from imgloc.experiments.cost import bytes_of
from imgloc.experiments.index import FLOOR
from imgloc.experiments.runs import LISTED, headings, run_trials
from imgloc.experiments.summary import TOLERANCES, Summary, Tolerance, summarise
from imgloc.features.mapfeatures import MapFeatures
from imgloc.io.scanset import ScanSet
from imgloc.options import FUSED, Options
from imgloc.pipeline import effective

PAPER_STEPS_DEG = {"cbml": 3.0, "cbml-o": 3.0, "ght": 30.0, "ght-v": 30.0, "beam": 3.0}
"""Steps of the headings in Sec. VI, degrees; the beam model, its reference, gets the finer one."""
_MIXTURE = 20  # hypotheses of `fused` that its density is made of


@dataclass(frozen=True)
class Lattice:
    """The poses that are told apart.

    Parameters
    ----------
    cell : float
        Metres.
    theta_step : float
        Radians.
    poses, poses_box : int
        In free cells, and in all.
    log_poses : float
        S of a method that puts everything into the right free cell.
    """

    cell: float
    theta_step: float
    poses: int
    poses_box: int
    log_poses: float


@dataclass(frozen=True)
class Evaluation:
    """Results of one method on one map, with what decided them."""

    lattice: Lattice
    summary: Summary
    parameters: dict[str, object]


def method_options(method: str, theta_step: float | None = None, threads: int = 1) -> Options:
    """Options of an experiment: the paper's step of the headings unless another is given.

    Parameters
    ----------
    method : str
    theta_step : float, optional
        Radians; for ``fused`` that of its endpoint correlation.
    threads : int

    Examples
    --------
    >>> round(np.rad2deg(method_options("ght-v").theta_step))
    30
    """
    options = Options(method=method, threads=threads, top=LISTED)
    if method == FUSED:
        options = replace(options, top=_MIXTURE)
        if theta_step is not None:
            options = replace(options, fused=replace(options.fused, theta_step=theta_step))
        return options
    default = np.deg2rad(PAPER_STEPS_DEG.get(method, 3.0))
    return replace(options, theta_step=float(default if theta_step is None else theta_step))


def evaluate(
    features: MapFeatures,
    scans: ScanSet,
    options: Options,
    *,
    tolerances: Sequence[Tolerance] = TOLERANCES,
    floor: float = FLOOR,
    advance: Callable[[], None] = lambda: None,
) -> Evaluation:
    """Measure a method. Everything but ``summary.cost`` is the same in every run.

    Parameters
    ----------
    features : MapFeatures
        Fresh ones, if their bytes and the time of the first answer are to be this method's.
    scans : ScanSet
        With poses of the sensor in the map frame. The first one is located once more than the
        others, before the clock counts.
    options : Options
        See :func:`method_options`.
    tolerances : sequence of Tolerance
    floor : float
        See :mod:`imgloc.experiments.index`.
    advance : callable
        Called after each trial.

    Raises
    ------
    ConfigError
        If there are no scans or no poses, or an option is out of its range.
    """
    if not len(scans) or scans.poses is None:
        raise ConfigError("expected at least one scan, and the true pose of each")
    first = next(run_trials(features, scans, options)).ms
    trials = []
    for trial in run_trials(features, scans, options):
        trials.append(trial)
        advance()
    summary = summarise(
        trials,
        options.method,
        tolerances=tolerances,
        floor=floor,
        features_bytes=bytes_of(features),
        first_ms=first,
    )
    return Evaluation(_lattice(features, options), summary, effective(options, features))


def _lattice(features: MapFeatures, options: Options) -> Lattice:
    n, free = headings(options), int(np.count_nonzero(features.free))
    return Lattice(
        cell=features.lattice.resolution,
        theta_step=2 * np.pi / n,
        poses=n * free,
        poses_box=n * features.free.size,
        log_poses=float(np.log(n * free)),
    )
