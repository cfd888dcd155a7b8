"""How much a search stands: one condition at a time, beside a far wider search.

Each condition changes one thing of the sensor, of its mounting or of the map. The oracle is the
same score, searched as widely as :mod:`tools.trust.exhaustive` does: where it is right and
`localize` is not, the search is to blame, and otherwise the score.

Twins whose scores are equal cannot be told apart by anyone: beside success@1 there is the share
of scans for which the right pose is among those that score as well as the first.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np

from imgloc import LaserScan, MapFeatures, Options, Pose2D, ScanSet, Sensor, localize, prepare
from imgloc.geometry import in_map_frame, pose_errors
from imgloc.lab.evaluation import Share, share
from imgloc.model import FloatArray, base_of
from imgloc.simulation.worlds import WORLDS, render
from tools.recorded import in_world
from tools.script import at_least_one, one_of, table_lines
from tools.trust.exhaustive import exhaustive

TOLERANCE = (0.5, float(np.deg2rad(10.0)))
"""Metres and radians within which a pose is right."""
TIE = 0.1
"""Nats: poses whose scores differ by no more are equally good."""
LISTED = 20
"""Hypotheses among which ties are looked for."""


@dataclass(frozen=True)
class Condition:
    """What is different."""

    sensor: Sensor = field(default_factory=Sensor)
    cell: float = 0.1  #: of the map, metres
    flipped: bool = False  #: the sensor hangs upside down, and says so


CONDITIONS: Mapping[str, Condition] = MappingProxyType(
    {
        "as in the paper": Condition(),
        "10 % of the rays stopped short": Condition(Sensor(outliers=0.1)),
        "30 % of the rays stopped short": Condition(Sensor(outliers=0.3)),
        "50 % of the rays stopped short": Condition(Sensor(outliers=0.5)),
        "10 % of the rays dropped": Condition(Sensor(dropped=0.1)),
        "reach of 5 m": Condition(Sensor(range_max=5.0)),
        "field of view 90 deg": Condition(Sensor(fov=np.pi / 2)),
        "field of view 270 deg": Condition(Sensor(fov=1.5 * np.pi)),
        "field of view 360 deg": Condition(Sensor(fov=2 * np.pi)),
        "31 rays": Condition(Sensor(rays=31)),
        "361 rays": Condition(Sensor(rays=361)),
        "1081 rays": Condition(Sensor(rays=1081)),
        "map at 2.5 cm": Condition(cell=0.025),
        "map at 5 cm": Condition(cell=0.05),
        "map at 20 cm": Condition(cell=0.2),
        "sensor off-centre": Condition(Sensor(mount=Pose2D(0.3, -0.2, 0.5))),
        "sensor upside down": Condition(Sensor(mount=Pose2D(0.3, 0.0, 0.2)), flipped=True),
    }
)
"""The conditions of the table by name."""


def upside_down(scan: LaserScan) -> LaserScan:
    """What a sensor with a symmetric fan records when it hangs upside down: clockwise.

    `--flipped` is to make up for it, see :attr:`~imgloc.model.LaserScan.flipped`.
    """
    return replace(scan, ranges=scan.ranges[::-1])


@dataclass(frozen=True)
class RobustnessTrial:
    """One scan: of the poses within :data:`TIE` of the best score, best first, which are right."""

    localize: tuple[bool, ...]  #: empty without a pose
    oracle: tuple[bool, ...]
    unique: bool  #: the verdict


@dataclass(frozen=True)
class RobustnessRow:
    """One condition over all worlds: shares of the scans.

    `localize` and `oracle` count a right pose that is the first or within :data:`TIE` of it.
    """

    condition: str
    localize: Share
    oracle: Share
    localize_first: Share  #: the first pose is right
    oracle_first: Share
    ties: Share  #: several poses of the oracle are within :data:`TIE`, one of them right
    unique: Share  #: the verdict
    wrong: Share  #: ``unique`` although the first pose is not right

    @property
    def behind(self) -> float:
        """Points of success@1 that the search lies behind the oracle."""
        return 100 * (self.oracle_first.value - self.localize_first.value)


def robustness(
    n: int = 20,
    seed: int = 0,
    *,
    worlds: Sequence[str] = tuple(WORLDS),
    conditions: Sequence[str] = tuple(CONDITIONS),
    threads: int = 1,
    advance: Callable[[], None] = lambda: None,
) -> tuple[RobustnessRow, ...]:
    """Measure the table; every condition has the same poses of the robot.

    Parameters
    ----------
    n : int
        Scans in each world and condition.
    seed : int
        Of the poses and the noise.
    worlds, conditions : sequence of str
        Some of :data:`~imgloc.simulation.worlds.WORLDS` and of :data:`CONDITIONS`.
    threads : int
        No result depends on it.
    advance : callable
        Called ``n * len(worlds) * len(conditions)`` times.

    Raises
    ------
    ConfigError
        If there is no trial, or no such world or condition.
    """
    at_least_one(n=n)
    one_of(worlds, WORLDS)
    one_of(conditions, CONDITIONS)
    rows = []
    for name in conditions:
        trials: list[RobustnessTrial] = []
        for world in worlds:
            features, scans = condition_of(world, CONDITIONS[name], n, seed, threads)
            trials += _trials(features, scans, threads, advance)
        rows.append(row_of(name, trials))
    return tuple(rows)


def recorded_row(
    name: str,
    features: MapFeatures,
    scans: ScanSet,
    *,
    threads: int = 1,
    advance: Callable[[], None] = lambda: None,
) -> RobustnessRow:
    """The same for a set of scans that were recorded with their poses (sensor, map frame).

    `threads` and `advance` as of :func:`robustness`; `advance` is called after each scan.
    """
    return row_of(name, list(_trials(features, scans, threads, advance)))


def row_of(name: str, trials: Sequence[RobustnessTrial]) -> RobustnessRow:
    """Count.

    Examples
    --------
    >>> row = row_of("twins", [RobustnessTrial((False,), (False, True), False)])
    >>> row.localize.hits, row.oracle.hits, row.oracle_first.hits, row.ties.hits
    (0, 1, 0, 1)
    """
    return RobustnessRow(
        name,
        share(any(t.localize) for t in trials),
        share(any(t.oracle) for t in trials),
        share(any(t.localize[:1]) for t in trials),
        share(any(t.oracle[:1]) for t in trials),
        share(len(t.oracle) > 1 and any(t.oracle) for t in trials),
        share(t.unique for t in trials),
        share(t.unique and not any(t.localize[:1]) for t in trials),
    )


def condition_of(
    world: str, condition: Condition, n: int, seed: int, threads: int
) -> tuple[MapFeatures, ScanSet]:
    """The map of a world and scans in it, as the condition has them."""
    features = prepare(render(WORLDS[world](), condition.cell), threads=threads)
    # The poses are those of the map at 10 cm, whatever its cells now.
    _, scans = in_world(world, n, seed, condition.sensor)
    if condition.flipped:
        told = tuple(upside_down(scan).flipped for scan in scans.scans)
        scans = replace(scans, scans=told)
    return features, scans


def _trials(
    features: MapFeatures, scans: ScanSet, threads: int, advance: Callable[[], None]
) -> Iterator[RobustnessTrial]:
    for scan, pose in scans.with_poses():
        yield _trial(features, scan, Pose2D(*pose), threads)
        advance()


def _trial(features: MapFeatures, scan: LaserScan, pose: Pose2D, threads: int) -> RobustnessTrial:
    """Compare both answers with the pose of the robot that carries the sensor."""
    options = Options(top=LISTED, threads=threads)
    answer, mount = localize(features, scan, options), scan.T_base_laser or Pose2D(0.0, 0.0)
    found = [h.pose for h in answer.hypotheses]
    scores = np.array([h.log_likelihood for h in answer.hypotheses])
    told: tuple[bool, ...] = ()
    if scan.valid.any():
        best = exhaustive(features, scan, options.fused, threads=threads)
        ideal = [in_map_frame(Pose2D(*p), features.grid) for p in best.poses[:LISTED]]
        told = tied(ideal, best.scores.log_likelihood[:LISTED], pose, mount)
    return RobustnessTrial(
        tied(found, scores, pose, mount), told, unique=answer.verdict == "unique"
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


def robustness_table(rows: Sequence[RobustnessRow]) -> str:
    """The rows as Markdown."""
    head = "condition | success@1 | oracle | behind | among equals, both | ties | unique | wrong"
    cells = (
        (r.condition, _interval(r.localize_first), _interval(r.oracle_first), f"{r.behind:.0f}",
         f"{_percent(r.localize)}, {_percent(r.oracle)}", _percent(r.ties), _percent(r.unique),
         f"{r.wrong.hits} of {r.wrong.trials}")
        for r in rows
    )  # fmt: skip
    return "\n".join(table_lines(head, cells))


def _percent(share: Share) -> str:
    return f"{100 * share.value:.0f} %"


def _interval(share: Share) -> str:
    return f"{_percent(share)} [{100 * share.low:.0f}, {100 * share.high:.0f}]"
