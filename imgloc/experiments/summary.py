"""Numbers made of trials: shares with intervals, percentiles, cost."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imgloc.experiments.cost import Cost, cost_of
from imgloc.experiments.index import FLOOR, Index, performance_index
from imgloc.experiments.runs import LISTED, PAIR_METHODS, Trial
from imgloc.experiments.shares import Share, share
from imgloc.model import VERDICTS, FloatArray

PERCENTILES = (50, 90, 95)


@dataclass(frozen=True)
class Tolerance:
    """A hypothesis is right if it is nearer than this to the true pose: metres and radians."""

    position: float
    heading: float


TOLERANCES = (Tolerance(0.25, 0.25), Tolerance(0.5, float(np.deg2rad(10.0))))
"""Those that are always reported; the second is that of Cartographer's comparison."""


@dataclass(frozen=True)
class Success:
    """Shares of right answers under one tolerance.

    Parameters
    ----------
    tolerance : Tolerance
    at_1, at_5 : Share
        The first hypothesis is right; one of the first five is.
    unique_wrong : Share
        The verdict is ``unique`` and the first hypothesis is wrong.
    """

    tolerance: Tolerance
    at_1: Share
    at_5: Share
    unique_wrong: Share


@dataclass(frozen=True)
class Summary:
    """One method on one map.

    Parameters
    ----------
    method : str
    trials : int
    index, index_box : Index
        S, eq. 12, over poses in free cells and over the whole box of the map.
    index_calibrated : Index
        S of the calibrated posterior over free cells; of ``fused`` on the lattice of poses.
    outside : int
        Trials whose true pose is in no free cell.
    exact, near : Share
        The global maximum is in the cell of the true pose; in it or one next to it.
    success : tuple of Success
    position, heading : dict
        Percentiles of the first hypothesis' error, metres and radians; infinite where so many
        scans have no answer.
    verdicts : dict of Share
    unit : str or None
        What `ns_per_unit` counts.
    work : int
        Units of the median trial.
    stack_bytes, features_bytes : int
        Of the arrays themselves: the likelihood stack, and what the method keeps of the map.
    cost : Cost
    """

    method: str
    trials: int
    index: Index
    index_box: Index
    index_calibrated: Index
    outside: int
    exact: Share
    near: Share
    success: tuple[Success, ...]
    position: dict[str, float]
    heading: dict[str, float]
    verdicts: dict[str, Share]
    unit: str | None
    work: int
    stack_bytes: int
    features_bytes: int
    cost: Cost


def summarise(
    trials: Sequence[Trial],
    method: str,
    *,
    tolerances: Sequence[Tolerance] = TOLERANCES,
    floor: float = FLOOR,
    features_bytes: int = 0,
    first_ms: float = float("nan"),
) -> Summary:
    """Make numbers of the trials of one method on one map.

    Parameters
    ----------
    trials : sequence of Trial
        At least one.
    method : str
    tolerances : sequence of Tolerance
    floor : float
        See :mod:`imgloc.experiments.index`.
    features_bytes : int
        See :func:`~imgloc.experiments.cost.bytes_of`.
    first_ms : float

    Raises
    ------
    ConfigError
        If `floor` is out of its range.
    """
    first = np.array([t.errors[0] if len(t.errors) else (np.inf, np.inf) for t in trials])
    has_stack = any(t.stack_bytes for t in trials)
    return Summary(
        method=method,
        trials=len(trials),
        index=performance_index([t.free for t in trials], floor),
        index_box=performance_index([t.box for t in trials], floor),
        index_calibrated=performance_index([t.calibrated for t in trials], floor),
        outside=sum(t.outside for t in trials),
        exact=share(t.exact for t in trials),
        near=share(t.near for t in trials),
        success=tuple(_success(trials, tolerance) for tolerance in tolerances),
        position=_percentiles(first[:, 0]),
        heading=_percentiles(first[:, 1]),
        verdicts={v: share(t.verdict == v for t in trials) for v in VERDICTS},
        unit=None
        if not has_stack
        else "pair of points"
        if method in PAIR_METHODS
        else "pose and reading",
        work=int(np.median([t.work for t in trials])),
        stack_bytes=max(t.stack_bytes for t in trials),
        features_bytes=features_bytes,
        cost=cost_of(trials, first_ms),
    )


def right(trial: Trial, tolerance: Tolerance, first: int) -> bool:
    """Whether one of the `first` hypotheses is nearer than the tolerance to the true pose."""
    errors = trial.errors[:first]
    return bool(np.any((errors[:, 0] < tolerance.position) & (errors[:, 1] < tolerance.heading)))


def _success(trials: Sequence[Trial], tolerance: Tolerance) -> Success:
    wrong = [t.verdict == "unique" and not right(t, tolerance, 1) for t in trials]
    return Success(
        tolerance,
        share(right(t, tolerance, 1) for t in trials),
        share(right(t, tolerance, LISTED) for t in trials),
        share(wrong),
    )


def _percentiles(errors: FloatArray) -> dict[str, float]:
    """Without interpolation: half of infinity is of no use."""
    values = np.percentile(errors, PERCENTILES, method="inverted_cdf")
    return {f"p{q}": float(v) for q, v in zip(PERCENTILES, values, strict=True)}
