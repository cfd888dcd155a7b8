"""How much a search stands: one condition at a time, beside a far wider search.

Each condition changes one thing of the sensor, of its mounting or of the map. The oracle is the
same score, searched as widely as :mod:`imgloc.experiments.exhaustive` does: where it is right and
`localize` is not, the search is to blame, and otherwise the score.

Twins whose scores are equal cannot be told apart by anyone: beside success@1 there is the share
of scans for which the right pose is among those that score as well as the first.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from imgloc.errors import ConfigError
from imgloc.evaluate import Share, pose_errors, share
from imgloc.experiments.conditions import CONDITIONS, Condition, upside_down
from imgloc.experiments.exhaustive import exhaustive
from imgloc.features.mapfeatures import MapFeatures
from imgloc.geometry import base_of, compose
from imgloc.io.scanset import ScanSet
from imgloc.model import FloatArray, LaserScan, Pose2D
from imgloc.pipeline import Options, localize, prepare
from imgloc.simulate import simulate_set
from imgloc.worlds import WORLDS, render

TOLERANCE = (0.5, float(np.deg2rad(10.0)))
"""Metres and radians within which a pose is right."""
TIE = 0.1
"""Nats: poses whose scores differ by no more are equally good."""
LISTED = 20
"""Hypotheses among which ties are looked for."""


@dataclass(frozen=True)
class Row:
    """One condition over all worlds.

    Parameters
    ----------
    condition : str
    localize, oracle : Share
        Scans for which the first pose, or one within :data:`TIE` of its score, is right.
    localize_first, oracle_first : Share
        Scans for which the first pose is right.
    ties : Share
        Scans for which several poses of the oracle are within :data:`TIE`, one of them right.
    unique, wrong : Share
        Verdict ``unique``; and ``unique`` although the first pose is not right.
    """

    condition: str
    localize: Share
    oracle: Share
    localize_first: Share
    oracle_first: Share
    ties: Share
    unique: Share
    wrong: Share

    @property
    def behind(self) -> float:
        """Points of success@1 that the search lies behind the oracle."""
        return 100 * (self.oracle_first.value - self.localize_first.value)


@dataclass(frozen=True)
class Trial:
    """One scan: of the poses that score best, is any right, and is the first.

    Parameters
    ----------
    localize, oracle : tuple of bool
        For each pose within :data:`TIE` of the best score, best first: is it right? Empty
        without a pose.
    unique : bool
        The verdict.
    """

    localize: tuple[bool, ...]
    oracle: tuple[bool, ...]
    unique: bool


def robustness(
    n: int = 20,
    seed: int = 0,
    *,
    worlds: Sequence[str] = tuple(WORLDS),
    conditions: Sequence[str] = tuple(CONDITIONS),
    threads: int = 1,
    advance: Callable[[], None] = lambda: None,
) -> tuple[Row, ...]:
    """Measure the table; every condition has the same poses of the robot.

    Parameters
    ----------
    n : int
        Scans in each world and condition.
    seed : int
        Of the poses and the noise.
    worlds, conditions : sequence of str
        Some of :data:`~imgloc.worlds.WORLDS` and of
        :data:`~imgloc.experiments.conditions.CONDITIONS`.
    threads : int
        No result depends on it.
    advance : callable
        Called ``n * len(worlds) * len(conditions)`` times.

    Raises
    ------
    ConfigError
        If there is no trial, or no such world or condition.
    """
    if n < 1:
        raise ConfigError(f"n must be at least 1, got {n}")
    for name, known in [(w, WORLDS) for w in worlds] + [(c, CONDITIONS) for c in conditions]:
        if name not in known:
            raise ConfigError(f"expected one of {', '.join(known)}, got {name!r}")
    rows = []
    for name in conditions:
        condition = CONDITIONS[name]
        trials = []
        for world in worlds:
            for trial in _trials(world, condition, n, seed, threads):
                trials.append(trial)
                advance()
        rows.append(row_of(name, trials))
    return tuple(rows)


def recorded_row(
    name: str,
    features: MapFeatures,
    scans: ScanSet,
    *,
    threads: int = 1,
    advance: Callable[[], None] = lambda: None,
) -> Row:
    """The same for scans that were recorded with their poses.

    Parameters
    ----------
    name : str
        Of the set.
    features : MapFeatures
    scans : ScanSet
        With poses of the sensor, map frame.
    threads, advance
        As of :func:`robustness`; `advance` is called after each scan.
    """
    trials = []
    truth = np.empty((0, 3)) if scans.poses is None else scans.poses
    for scan, pose in zip(scans.scans, truth, strict=True):
        trials.append(_trial(features, scan, Pose2D(*pose), threads))
        advance()
    return row_of(name, trials)


def row_of(name: str, trials: Sequence[Trial]) -> Row:
    """Count.

    Examples
    --------
    >>> row = row_of("twins", [Trial((False,), (False, True), False)])
    >>> row.localize.hits, row.oracle.hits, row.oracle_first.hits, row.ties.hits
    (0, 1, 0, 1)
    """
    return Row(
        name,
        share(any(t.localize) for t in trials),
        share(any(t.oracle) for t in trials),
        share(any(t.localize[:1]) for t in trials),
        share(any(t.oracle[:1]) for t in trials),
        share(len(t.oracle) > 1 and any(t.oracle) for t in trials),
        share(t.unique for t in trials),
        share(t.unique and not any(t.localize[:1]) for t in trials),
    )


def _trials(world: str, condition: Condition, n: int, seed: int, threads: int) -> Iterator[Trial]:
    grid = render(WORLDS[world](), condition.cell)
    features = prepare(grid, threads=threads)
    # The poses are those of the map at 10 cm, whatever its cells now.
    scans = simulate_set(
        render(WORLDS[world](), 0.1), n, seed, condition.sensor, render(WORLDS[world](), 0.01)
    )
    truth = np.empty((0, 3)) if scans.poses is None else scans.poses
    for scan, pose in zip(scans.scans, truth, strict=True):
        told = upside_down(scan).flipped if condition.flipped else scan
        yield _trial(features, told, Pose2D(*pose), threads)


def _trial(features: MapFeatures, scan: LaserScan, pose: Pose2D, threads: int) -> Trial:
    """Compare both answers with the pose of the robot that carries the sensor."""
    options = Options(top=LISTED, threads=threads)
    answer = localize(features, scan, options)
    found = [h.pose for h in answer.hypotheses]
    scores = np.array([h.log_likelihood for h in answer.hypotheses])
    if scan.valid.any():
        best = exhaustive(features, scan, options.fused, threads=threads)
        ideal = [compose(features.grid.origin, Pose2D(*p)) for p in best.poses[:LISTED]]
        told = tied(ideal, best.evidence.log_likelihood[:LISTED], pose, scan.T_base_laser)
    else:
        told = ()
    return Trial(
        tied(found, scores, pose, scan.T_base_laser), told, unique=answer.verdict == "unique"
    )


def tied(
    poses: Sequence[Pose2D], scores: FloatArray, truth: Pose2D, mount: Pose2D
) -> tuple[bool, ...]:
    """Which of the poses that score within :data:`TIE` of the best are right, best first.

    Parameters
    ----------
    poses : sequence of Pose2D
        Of the sensor, best first.
    scores : (C,) float array
        Nats.
    truth : Pose2D
        Of the sensor.
    mount : Pose2D
        Of the sensor on the robot, whose poses are compared.

    Examples
    --------
    >>> here, there = Pose2D(0.0, 0.0), Pose2D(9.0, 0.0)
    >>> tied([there, here, here], np.array([5.0, 4.95, 3.0]), here, Pose2D(0.0, 0.0))
    (False, True)
    """
    equal = int(np.sum(scores >= scores[:1] - TIE))
    robots = [base_of(p, mount) for p in poses[:equal]]
    errors = pose_errors(
        np.array([(p.x, p.y, p.theta) for p in robots]).reshape(-1, 3), base_of(truth, mount)
    )
    return tuple(bool(np.all(error <= TOLERANCE)) for error in errors)
