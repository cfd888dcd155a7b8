"""How soon a localizer's faults are noticed, and how often one is seen that is none.

A robot drives in a bundled world, and a localizer gives its poses with 3 cm and 1 degree of noise.
After some way it goes wrong. The opinion is that of ``imgloc node --watch`` of each scan.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from imgloc import LaserScan, MapFeatures, Options, Pose2D, localize, prepare
from imgloc.features.distance import distance_image
from imgloc.filters.follow import Tracking
from imgloc.filters.motion import compose_poses, invert_poses, noisy_odometry
from imgloc.filters.watch import DISAGREES, Watch
from imgloc.model import FloatArray, OccupancyGrid
from imgloc.simulation.scans import sample_free_poses, simulate_ranges
from imgloc.simulation.worlds import WORLDS, render
from tools.drive import path_between
from tools.trust.disturb import furnished, people

FAULTS = {
    "carried off": "the robot is set down elsewhere; the localizer goes on from where it was",
    "wrong floor": "the robot drives on in another world; the map stays",
    "symmetric twin": "it goes on from where the scan fits second best, or at the opposite side",
    "next bay": "it goes on 3 m beside the robot",
    "slow drift": "0.2 m a metre, sideways",
    "frozen": "it repeats its last pose with new stamps",
    "jumped": "it goes on 1.5 to 5 m away, somewhere",
    "heading by 180": "it goes on with the heading turned by half",
    "stale": "its poses are those of 5 s ago",
    "wrong map version": "its map lies 1.5 m aside and is turned by 3 degrees",
    "wrong scale": "its map is a tenth too large",
    "covariance collapsed": "it is 1.2 m off, and says that it is sure to a millimetre",
}
_WORLDS = ("curved", "double_wall", "large")
_ANGLES = np.deg2rad(np.arange(-135, 135.5, 1.0))
_RATE, _SPEED, _REACH = 4.0, 0.5, 10.0  # scans a second, metres a second, metres
_BEFORE, _AFTER = 10.0, 12.0  # seconds
_ROOM = 0.35  # metres from a wall


@dataclass(frozen=True)
class Drive:
    """A drive, and the poses that the localizer gives along it."""

    truth: FloatArray  #: (N, 3)
    odom: FloatArray  #: (N, 3)
    claims: FloatArray  #: (N, 3)
    scans: list[LaserScan]


@dataclass(frozen=True)
class Noticed:
    """What became of one fault."""

    fault: str
    sure: bool  #: whether the poses were agreed with before
    seconds: float  #: from where the pose is off by a metre, or 20 degrees; infinite if never
    metres: float
    pose_right: bool  #: whether the pose that imgloc gives then is within half a metre
    false: int  #: times that it disagreed before the fault


def route(grid: OccupancyGrid, metres: float, seed: int) -> FloatArray:
    """Poses (N, 3) of a drive through free places, a scan's time apart."""
    room = distance_image(grid.occupied) * grid.resolution
    clear, done = replace(grid, free=grid.free & (room > _ROOM)), list[FloatArray]()
    step, there = _SPEED / _RATE, sample_free_poses(clear, 1, seed=seed)[0]
    while sum(map(len, done)) * step < metres:
        seed += 1
        goal = sample_free_poses(clear, 1, seed=seed)[0]
        if not 3 < np.hypot(*(goal - there)[:2]) < 60:
            continue
        try:
            path = path_between(clear, np.array([there[:2], goal[:2]]), step)
        except ValueError:
            continue
        cells = np.floor((path[:, 1::-1] - [grid.origin.y, grid.origin.x]) / grid.resolution)
        if len(path) < 3 or not grid.free[tuple(cells.astype(int).T)].all():
            continue
        done.append(path)
        there = path[-1]
    return np.concatenate(done)[: round(metres / step)]


def scans_of(world: OccupancyGrid, poses: FloatArray, rng: np.random.Generator) -> list[LaserScan]:
    """What the laser sees at poses (N, 3); people walk by at one scan of ten."""
    seed = int(rng.integers(1 << 30))
    ranges = simulate_ranges(world, poses, _ANGLES, sigma=0.02, seed=seed, range_max=_REACH)
    base = Pose2D(0.0, 0.0)
    found = [LaserScan(r, _ANGLES, range_max=_REACH, T_base_laser=base) for r in ranges]
    return [people(s, rng, 4) if rng.random() < 0.1 else s for s in found]


def drive_of(features: MapFeatures, other: OccupancyGrid, fault: str, seed: int) -> Drive:
    """A drive in a world with a fault from :data:`_BEFORE` seconds on."""
    rng, grid = np.random.default_rng(seed), features.grid
    n, k = round((_BEFORE + _AFTER) * _RATE), round(_BEFORE * _RATE)
    truth = route(grid, n * _SPEED / _RATE, 100 * seed)
    odom = noisy_odometry(truth, rng)
    claims, scans = truth.copy(), list[LaserScan]()
    after, at = truth[k:], truth[k]

    def from_there(pose: FloatArray) -> FloatArray:
        """The way after the fault as from another pose."""
        return compose_poses(pose, compose_poses(invert_poses(at), after))

    if fault == "carried off":
        elsewhere = route(grid, (n - k) * _SPEED / _RATE, 100 * seed + 50)
        began = noisy_odometry(elsewhere, rng)
        odom[k:] = compose_poses(odom[k], compose_poses(invert_poses(began[0]), began))
        claims[k:] = compose_poses(at, compose_poses(invert_poses(elsewhere[0]), elsewhere))
        truth[k:] = elsewhere
        scans = scans_of(grid, truth, rng)
    elif fault == "wrong floor":
        upstairs = route(other, (n - k) * _SPEED / _RATE, 100 * seed + 50)
        began = noisy_odometry(upstairs, rng)
        odom[k:] = compose_poses(odom[k], compose_poses(invert_poses(began[0]), began))
        claims[k:] = compose_poses(at, compose_poses(invert_poses(upstairs[0]), upstairs))
        scans = scans_of(grid, truth[:k], rng) + scans_of(other, upstairs, rng)
        truth[k:] = np.nan  # it is nowhere on the map
    else:
        scans = scans_of(grid, truth, rng)
    angle = rng.uniform(-np.pi, np.pi)
    side = np.array([np.cos(angle), np.sin(angle), 0.0])
    if fault == "symmetric twin":
        fits = localize(features, scans[k], Options(threads=1)).hypotheses
        far = [f.pose for f in fits if np.hypot(f.pose.x - at[0], f.pose.y - at[1]) > 1]
        size = np.array(grid.occupied.shape[::-1]) * grid.resolution
        turned = np.array([*(size - at[:2]), at[2] + np.pi])
        claims[k:] = from_there(np.array([*far[0]]) if far else turned)
    elif fault == "next bay":
        claims[k:] = from_there(at + 3.0 * side)
    elif fault == "slow drift":
        claims[k:] += np.arange(n - k)[:, None] * _SPEED / _RATE * 0.2 * side
    elif fault == "frozen":
        claims[k:] = at
    elif fault == "jumped":
        claims[k:] = from_there(at + rng.uniform(1.5, 5.0) * side)
    elif fault == "heading by 180":
        claims[k:] = from_there(at + (0.0, 0.0, np.pi))
    elif fault == "stale":
        claims[k:] = truth[k - round(5 * _RATE) : n - round(5 * _RATE)]
    elif fault == "wrong map version":
        claims[k:] = compose_poses(np.array([0, 0, np.deg2rad(3.0)]), after) + 1.5 * side
    elif fault == "wrong scale":
        claims[k:] = after * (1.1, 1.1, 1.0)
    elif fault == "covariance collapsed":
        claims[k:] = from_there(at + 1.2 * side)
    claims = claims + rng.normal(0.0, (0.03, 0.03, np.deg2rad(1.0)), claims.shape)
    stamped = [replace(s, stamp=10 + i / _RATE) for i, s in enumerate(scans)]
    return Drive(truth, odom, claims, stamped)


def opinions(features: MapFeatures, drive: Drive) -> Iterator[tuple[str, Pose2D | None]]:
    """What is said after each scan, and the pose that imgloc would give."""
    options = Options(threads=1)
    watch, own = Watch(features, options), Tracking().follower(features, options)
    for scan, odom, claim in zip(drive.scans, drive.odom, drive.claims, strict=True):
        here = Pose2D(*odom)
        watch.hear(scan.stamp, Pose2D(*claim), here)
        found = watch.step(scan, here, own.step(scan, odom))
        yield found.said, found.pose


def noticed(features: MapFeatures, other: OccupancyGrid, fault: str, seed: int) -> Noticed:
    """Whether, and how soon, one fault is noticed."""
    drive = drive_of(features, other, fault, seed)
    said = list(opinions(features, drive))
    k = round(_BEFORE * _RATE)
    off = np.abs(drive.claims - drive.truth)
    turned = np.abs(np.angle(np.exp(1j * off[:, 2]))) > np.deg2rad(20.0)
    wrong = ~(np.hypot(off[:, 0], off[:, 1]) <= 1.0) | turned
    begin = next((i for i in range(k, len(said)) if wrong[i]), len(said) - 1)
    when = next((i for i in range(begin, len(said)) if said[i][0] == DISAGREES), None)
    false = sum(a[0] != DISAGREES == b[0] for a, b in pairwise(said[:k]))
    if when is None:
        return Noticed(fault, said[k - 1][0] == "agrees", np.inf, np.inf, False, false)
    pose, truth = said[when][1], drive.truth[when]
    right = pose is not None and bool(np.hypot(pose.x - truth[0], pose.y - truth[1]) < 0.5)
    seconds = (when - begin) / _RATE
    return Noticed(fault, said[k - 1][0] == "agrees", seconds, seconds * _SPEED, right, false)


def faults(n: int, seed: int) -> Iterator[Noticed]:
    """So many drives, the faults and worlds in turn."""
    known = {name: prepare(render(WORLDS[name](), 0.05), name) for name in _WORLDS}
    for k in range(n):
        name = _WORLDS[(k // len(FAULTS)) % len(_WORLDS)]
        other = known[_WORLDS[(_WORLDS.index(name) + 1) % len(_WORLDS)]].grid
        yield noticed(known[name], other, list(FAULTS)[k % len(FAULTS)], seed + k)


def healthy(metres: float, seed: int) -> Iterator[tuple[float, dict[str, int]]]:
    """Drives without a fault in changed worlds: hours, and what was said how often.

    ``false`` counts how often it began to disagree.
    """
    for k in range(10**6):
        name, rng = _WORLDS[k % len(_WORLDS)], np.random.default_rng((seed, k))
        grid = render(WORLDS[name](), 0.05)
        features, world = prepare(grid, name), furnished(grid, rng)
        truth = route(world, metres, seed + 1000 * k)
        claims = truth + rng.normal(0.0, (0.03, 0.03, np.deg2rad(1.0)), truth.shape)
        scans = [
            replace(s, stamp=10 + i / _RATE) for i, s in enumerate(scans_of(world, truth, rng))
        ]
        said = [o[0] for o in opinions(features, Drive(truth, noisy_odometry(truth, rng), claims,
                                                       scans))]  # fmt: skip
        counts = {word: said.count(word) for word in ("agrees", "disagrees", "cannot tell")}
        began = sum(a != DISAGREES == b for a, b in pairwise(said))
        yield len(said) / _RATE / 3600, counts | {"false": began}


def rows_of(every: list[Noticed]) -> Iterator[tuple[object, ...]]:
    """A row a fault, and one of all."""
    for fault in (*FAULTS, "all"):
        some = [one for one in every if fault in (one.fault, "all")]
        if some:
            soon = [one.seconds <= 5 or one.metres <= 2 for one in some]
            late = np.array([one.seconds for one in some])
            right = sum(one.pose_right for one in some)
            agreed = sum(one.sure for one in some)
            yield (fault, len(some), agreed, f"{np.mean(soon):.2f}", f"{np.median(late):.1f}",
                   f"{late.max():.1f}", right, sum(one.false for one in some))  # fmt: skip
