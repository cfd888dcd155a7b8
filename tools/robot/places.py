"""Where robots drive, with their true poses: bundled worlds, changed or not, and recorded logs."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from imgloc import LaserScan, MapFeatures, Pose2D, ScanSet, load_map, load_scans, prepare
from imgloc.errors import ConfigError
from imgloc.features.distance import distance_image
from imgloc.filters.follow import robot_poses
from imgloc.filters.motion import compose_poses, invert_poses, noisy_odometry
from imgloc.geometry import pose_errors, values_at
from imgloc.model import FloatArray, OccupancyGrid
from imgloc.simulation.scans import sample_free_poses, simulate_ranges
from imgloc.simulation.worlds import WORLDS, render
from tools.drive import path_between
from tools.filters import driven
from tools.recorded import logs_of
from tools.robot.kill import true_poses
from tools.trust.disturb import furnished, people, shut

SIMULATED = ("curved", "double_wall", "large")
_ANGLES = np.deg2rad(np.arange(-135, 135.5, 1.0))
_SPEED, _REACH = 0.5, 10.0  # metres a second, metres
_ROOM = 0.35  # metres from a wall
_APART = 3.0  # metres that a robot is carried at least


@dataclass(frozen=True)
class Place:
    """A map, and a log of a robot there, with poses, odometry and stamps."""

    name: str
    features: MapFeatures
    log: ScanSet

    def after(self, first: int, seconds: float, metres: float = 0.0) -> int:
        """The scan that is so much later than another one, and so much farther along the way."""
        stamps, way = known(self.log)[1], driven(self.log)
        later, farther = stamps[first] + seconds, way[first] + metres
        return int(max(np.searchsorted(stamps, later), np.searchsorted(way, farther)))

    def start(
        self, seconds: float, rng: np.random.Generator, away: FloatArray | None = None
    ) -> int | None:
        """A scan after which the log goes on for so long, 3 m away from a pose (3,), if any is."""
        truth, stamps, _ = known(self.log)
        good = stamps + seconds <= stamps[-1]
        if away is not None:
            good &= np.hypot(*(truth - away)[:, :2].T) >= _APART
        return int(rng.choice(np.flatnonzero(good))) if good.any() else None


def known(log: ScanSet) -> tuple[FloatArray, FloatArray, FloatArray]:
    """True poses (N, 3) of the robot's base, stamps (N,), odometry (N, 3); ConfigError if not."""
    poses = robot_poses(log)
    if poses is None or log.stamps is None or log.odom is None:
        raise ConfigError("expected a log with poses, stamps and odometry")
    return poses, log.stamps, log.odom


@cache
def world(name: str) -> MapFeatures:
    """A bundled world, prepared."""
    return prepare(render(WORLDS[name](), 0.05), name)


def simulated(
    name: str, metres: float, seed: int, *, changed: bool = False, rate: float = 4.0
) -> Place:
    """A drive with so many scans a second; furniture and doors have changed, if so asked."""
    features, rng = world(name), np.random.default_rng(seed)
    there = features.grid
    if changed:
        there = shut(furnished(there, rng), rng, share=0.2)
    truth = route(there, metres, _SPEED / rate, seed)
    ranges = simulate_ranges(
        there, truth, _ANGLES, sigma=0.02, seed=int(rng.integers(1 << 30)), range_max=_REACH
    )
    base, stamps = Pose2D(0.0, 0.0), 10 + np.arange(len(truth)) / rate
    scans = [LaserScan(r, _ANGLES, range_max=_REACH, T_base_laser=base) for r in ranges]
    some = tuple(people(s, rng, 4) if rng.random() < 0.1 else s for s in scans)
    return Place(name, features, ScanSet(some, truth, stamps, noisy_odometry(truth, rng)))


def route(grid: OccupancyGrid, metres: float, step: float, seed: int) -> FloatArray:
    """Poses (N, 3) of a drive through free places, `step` metres apart."""
    room = distance_image(grid.occupied) * grid.resolution
    clear, done = replace(grid, free=grid.free & (room > _ROOM)), list[FloatArray]()
    there = sample_free_poses(clear, 1, seed=seed)[0]
    while sum(map(len, done)) * step < metres:
        seed += 1
        goal = sample_free_poses(clear, 1, seed=seed)[0]
        if not 3 < np.hypot(*(goal - there)[:2]) < 60:
            continue
        try:
            path = path_between(clear, np.array([there[:2], goal[:2]]), step)
        except ValueError:
            continue
        at = path[:, :2] - [grid.origin.x, grid.origin.y]
        if len(path) >= 3 and values_at(grid.free, at, grid.resolution).all():
            done.append(path)
            there = path[-1]
    return np.concatenate(done)[: round(metres / step)]


def recorded(folders: Sequence[Path], logs: Sequence[tuple[str, str]]) -> list[Place]:
    """The logs in folders with ``map.yaml`` and ``scans.npz``, and files, each with map and start.

    ``MAP@X,Y,YAW`` has where a log begins; its true poses are those of a filter that is told so.
    """
    places = list[Place]()
    for folder in folders:
        features = prepare(load_map(folder / "map.yaml"), folder.name)
        places += [Place(name, features, scans) for name, scans in logs_of(folder)]
    for log, (name, _, start) in ((log, begin.rpartition("@")) for log, begin in logs):
        scans, path = load_scans(log).with_odometry(log)[0], Path(name)
        base = true_poses(path, scans, Pose2D(*map(float, start.split(","))))
        poses = compose_poses(base, np.array([[*scan.mount] for scan in scans.scans]))
        features = prepare(load_map(path), path.stem)
        places.append(Place(Path(log).stem, features, replace(scans, poses=poses)))
    return places


def both(a: ScanSet, b: ScanSet) -> ScanSet:
    """Two logs with poses, stamps and odometry as one, to take pieces of."""
    (_, first, odom), (_, then, more) = known(a), known(b)
    assert a.poses is not None
    assert b.poses is not None
    stamps = np.concatenate((first, then - then[0] + first[-1] + 1.0))
    poses, odom = np.concatenate((a.poses, b.poses)), np.concatenate((odom, more))
    return ScanSet(a.scans + b.scans, poses, stamps, odom)


def gone_on(pose: FloatArray, way: FloatArray) -> FloatArray:
    """The way (N, 3) of a robot as if it had begun at another pose (3,)."""
    return compose_poses(pose, compose_poses(invert_poses(way[0]), way))


def apart(pose: Pose2D, truth: FloatArray, most: tuple[float, float]) -> bool:
    """Whether a pose is farther from the true one (3,) than so many metres or radians."""
    return bool((pose_errors(np.array([[*pose]]), Pose2D(*truth))[0] > most).any())
