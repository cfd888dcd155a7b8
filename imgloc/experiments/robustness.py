"""How much a search stands: one condition at a time, beside what no search can beat.

Each condition changes one thing of the sensor, of its mounting or of the map. The oracle is the
same score evaluated for all poses, :mod:`imgloc.experiments.exhaustive`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np

from imgloc.errors import ConfigError
from imgloc.experiments.exhaustive import exhaustive
from imgloc.experiments.runs import pose_errors
from imgloc.experiments.scansets import Sensor, simulate_set
from imgloc.experiments.shares import Share, share
from imgloc.experiments.worlds import WORLDS, render
from imgloc.features.mapfeatures import MapFeatures
from imgloc.geometry import compose, inverse
from imgloc.io.scanset import ScanSet
from imgloc.model import FloatArray, LaserScan, Pose2D
from imgloc.pipeline import Options, localize, prepare

TOLERANCE = (0.5, float(np.deg2rad(10.0)))
"""Metres and radians within which a pose is right."""
_FULL = 2 * np.pi


@dataclass(frozen=True)
class Condition:
    """What is different.

    Parameters
    ----------
    sensor : Sensor
    cell : float
        Of the map, metres.
    flipped : bool
        The sensor hangs upside down, and says so.
    """

    sensor: Sensor = field(default_factory=Sensor)
    cell: float = 0.1
    flipped: bool = False


def _sensor(**changed: object) -> Condition:
    return Condition(replace(Sensor(), **changed))  # type: ignore[arg-type]


CONDITIONS: Mapping[str, Condition] = MappingProxyType(
    {
        "as in the paper": Condition(),
        "10 % of the rays stopped short": _sensor(outliers=0.1),
        "30 % of the rays stopped short": _sensor(outliers=0.3),
        "50 % of the rays stopped short": _sensor(outliers=0.5),
        "10 % of the rays dropped": _sensor(dropped=0.1),
        "reach of 5 m": _sensor(range_max=5.0),
        "field of view 90 deg": _sensor(fov=np.pi / 2),
        "field of view 270 deg": _sensor(fov=1.5 * np.pi),
        "field of view 360 deg": _sensor(fov=_FULL),
        "31 rays": _sensor(rays=31),
        "361 rays": _sensor(rays=361),
        "1081 rays": _sensor(rays=1081),
        "map at 2.5 cm": Condition(cell=0.025),
        "map at 5 cm": Condition(cell=0.05),
        "map at 20 cm": Condition(cell=0.2),
        "sensor off-centre": _sensor(mount=Pose2D(0.3, -0.2, 0.5)),
        "sensor upside down": Condition(replace(Sensor(), mount=Pose2D(0.3, 0.0, 0.2)), 0.1, True),
    }
)
"""The conditions of the table by name."""


@dataclass(frozen=True)
class Row:
    """One condition over all worlds.

    Parameters
    ----------
    condition : str
    localize, oracle : Share
        Scans whose first pose is right.
    unique, wrong : Share
        Verdict ``unique``; and ``unique`` although the pose is not right.
    """

    condition: str
    localize: Share
    oracle: Share
    unique: Share
    wrong: Share

    @property
    def behind(self) -> float:
        """Points that the search lies behind the oracle."""
        return 100 * (self.oracle.value - self.localize.value)


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
        Some of :data:`~imgloc.experiments.worlds.WORLDS` and of :data:`CONDITIONS`.
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
        rows.append(_row(name, trials))
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
        trials.append(_trial(features, scan, scan, Pose2D(*pose), threads))
        advance()
    return _row(name, trials)


def _row(name: str, trials: Sequence[tuple[bool, bool, bool]]) -> Row:
    right, best, unique = (np.array(column) for column in zip(*trials, strict=True))
    return Row(name, share(right), share(best), share(unique), share(unique & ~right))


def _trials(
    world: str, condition: Condition, n: int, seed: int, threads: int
) -> list[tuple[bool, bool, bool]]:
    """For each scan: is the answer right, is the oracle, is the verdict ``unique``."""
    grid = render(WORLDS[world](), condition.cell)
    features = prepare(grid, threads=threads)
    # The poses are those of the map at 10 cm, whatever its cells now.
    scans = simulate_set(
        render(WORLDS[world](), 0.1), n, seed, condition.sensor, render(WORLDS[world](), 0.01)
    )
    truth = np.empty((0, 3)) if scans.poses is None else scans.poses
    return [
        _trial(
            features,
            upright(upside_down(scan)) if condition.flipped else scan,
            scan,
            Pose2D(*pose),
            threads,
        )
        for scan, pose in zip(scans.scans, truth, strict=True)
    ]


def _trial(
    features: MapFeatures, scan: LaserScan, mounted: LaserScan, pose: Pose2D, threads: int
) -> tuple[bool, bool, bool]:
    """Compare both answers with the pose of the robot that carries the sensor."""
    options = Options(threads=threads)
    answer = localize(features, scan, options)
    best = exhaustive(features, scan, options.fused, threads=threads)
    robot, to_map = base_pose(pose, mounted), features.grid.origin
    found = [] if answer.pose is None else [base_pose(answer.pose, mounted)]
    ideal = [base_pose(compose(to_map, Pose2D(*p)), mounted) for p in best.poses[:1]]
    return _right(found, robot), _right(ideal, robot), answer.verdict == "unique"


def upside_down(scan: LaserScan) -> LaserScan:
    """What a sensor with a symmetric fan records when it hangs upside down: clockwise."""
    return replace(scan, ranges=scan.ranges[::-1])


def upright(scan: LaserScan) -> LaserScan:
    """What is made of such a scan (``--flipped``): its angles run the other way."""
    return replace(scan, angles=-scan.angles)


def base_pose(pose: Pose2D, scan: LaserScan) -> Pose2D:
    """Pose of the robot, of its sensor's."""
    return compose(pose, inverse(scan.T_base_laser))


def _right(found: Sequence[Pose2D], truth: Pose2D) -> bool:
    poses: FloatArray = np.array([(p.x, p.y, p.theta) for p in found]).reshape(-1, 3)
    return bool((pose_errors(poses[:1], truth) <= TOLERANCE).all(axis=1).any())
