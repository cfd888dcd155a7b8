"""Is a robot that starts again told a wrong place? It stayed, was moved, or is somewhere else.

Each start is a robot in a bundled world that remembers a pose, and one scan, as of
``imgloc node --remember``. Half of the lasers see 360 degrees up to 12 m, half 270 up to 6 m.
"""

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from imgloc import LaserScan, MapFeatures, Options, Pose2D, localize, prepare
from imgloc.geometry import cell_of, pose_errors
from imgloc.live.remember import OUTCOMES, Kept, checked, identity
from imgloc.model import BoolArray, FloatArray, OccupancyGrid
from imgloc.simulation.scans import sample_free_poses, simulate_ranges
from tools.robot.kill import NEAR
from tools.robot.places import Place, apart, known, world
from tools.trust.disturb import dilated, furnished, half, people

CASES = {
    "stayed": "it stands where it was, within 0.2 m and 6 degrees",
    "stayed, people": "and ten people stand around it",
    "stayed, changed": "and half of the furniture is gone, and boxes have come",
    "map redrawn": "it stayed, and the map is another one since: walls 2 cells thicker",
    "moved": "it is anywhere else in the world",
    "moved, changed": "and half of the furniture is gone, and boxes have come",
    "twin": "it is where its scan fits second best",
    "half a map": "it is anywhere, and the map lacks one half",
    "elsewhere": "it is in another world, and the map is still that of the first one",
}
"""What has happened while it was off."""
STAYED, MOVED = (0.2, 0.1), 3.0  # metres and radians, metres: of scans of a log
_WORLDS = ("corridor", "double_wall", "visibility", "curved")
_LASERS = (
    (np.deg2rad(np.arange(-180, 180, 1.0)), 12.0),
    (np.deg2rad(np.arange(-135, 135.5, 1.0)), 6.0),
)


@dataclass(frozen=True)
class Start:
    """What became of one start."""

    case: str
    said: str  #: restored, moved or refused
    wrong: bool  #: whether it was told a pose that is not where it is
    seconds: float  #: of a processor, from the scan to the answer


def _scan(grid: OccupancyGrid, pose: FloatArray, laser: int, seed: int) -> LaserScan:
    angles, reach = _LASERS[laser]
    (ranges,) = simulate_ranges(grid, pose[None], angles, sigma=0.02, seed=seed, range_max=reach)
    return LaserScan(ranges, angles, range_max=reach, T_base_laser=Pose2D(0.0, 0.0))


def starts(n: int, seed: int, places: Sequence[Place] = ()) -> Iterator[Start]:
    """So many starts, the cases and places in turn; by default in bundled worlds."""
    for k in range(n):
        case, turn = list(CASES)[k % len(CASES)], k // len(CASES)
        rng = np.random.default_rng((seed, k))
        found = _in_log(case, places, turn, rng) if places else _in_world(case, turn, seed + k, rng)
        if found is None:
            continue
        features, here, scan, truth = found
        grid = features.grid
        kept = Kept("map", identity(grid), Pose2D(*here), 0.0)
        if case in ("map redrawn", "half a map"):
            change = dilated if case == "map redrawn" else half
            features = prepare(change(grid, rng))
        if case == "stayed, people":
            scan = people(scan, rng)
        yield _started(case, features, kept, scan, truth)


#: The map as it was, the pose that is remembered, a scan, and where it was taken, if on the map.
_Found = tuple[MapFeatures, FloatArray, LaserScan, FloatArray | None]


def _in_log(
    case: str, places: Sequence[Place], turn: int, rng: np.random.Generator
) -> _Found | None:
    """A start at a scan of a recorded log; nobody can change its building."""
    place = at = places[turn % len(places)]
    truth, features = known(place.log)[0], place.features
    here = truth[rng.integers(len(truth))]
    off = pose_errors(truth, Pose2D(*here))
    some: BoolArray = off[:, 0] >= MOVED
    if case == "elsewhere":
        others = [p for p in places if p.features is not features] or [place]
        at = others[int(rng.integers(len(others)))]
        some = np.full(len(at.log), at is not place)
    elif case in ("stayed", "stayed, people", "map redrawn"):
        some = np.asarray((off <= STAYED).all(axis=1))
    if not some.any() or case in ("stayed, changed", "moved, changed", "twin"):
        return None
    then = int(rng.choice(np.flatnonzero(some)))
    return features, here, at.log[then], truth[then] if at is place else None


def _in_world(case: str, turn: int, seed: int, rng: np.random.Generator) -> _Found | None:
    """A start in a bundled world."""
    which, laser = turn % len(_WORLDS), int(rng.integers(2))
    features = world(_WORLDS[which])
    there = features.grid
    here = sample_free_poses(there, 1, seed=2 * seed)[0]
    truth = here + rng.uniform(-1, 1, 3) * (0.14, 0.14, 0.1)
    if not _free(there, truth):
        truth = here
    if case == "elsewhere":
        there = world(_WORLDS[(which + int(rng.integers(1, 4))) % 4]).grid
    if case in ("moved", "moved, changed", "half a map", "elsewhere"):
        truth = sample_free_poses(there, 1, seed=2 * seed + 1)[0]
    if case in ("stayed, changed", "moved, changed"):
        there = furnished(there, rng)
    if case == "twin":
        fits = localize(features, _scan(there, here, laser, seed), Options(threads=1)).hypotheses
        if len(fits) < 2:
            return None
        truth = np.array([*fits[1].pose])
    if not _free(there, truth):
        return None
    scan = _scan(there, truth, laser, seed)
    return features, here, scan, None if case == "elsewhere" else truth


def _started(
    case: str, features: MapFeatures, kept: Kept, scan: LaserScan, truth: FloatArray | None
) -> Start:
    begin = time.process_time()
    answer = localize(features, scan, Options(threads=1))
    said, pose = checked(kept, answer, identity(features.grid))
    seconds = time.process_time() - begin
    # And published, if it is restored or the node has --standing.
    wrong = pose is not None and (truth is None or apart(pose, truth, NEAR))
    return Start(case, said, wrong, seconds)


def _free(grid: OccupancyGrid, pose: FloatArray) -> bool:
    """Whether a robot can be there."""
    return bool(grid.free[tuple(cell_of(pose[None, :2], grid.resolution)[0])])


HEAD = "case | starts | restored | moved | refused | wrong | median ms | most ms"


def rows_of(every: list[Start]) -> Iterator[tuple[object, ...]]:
    """A row a case, and one of all: starts, what was said, wrong, times."""
    for case in (*CASES, "all"):
        some = [one for one in every if case in (one.case, "all")]
        if some:
            took = 1e3 * np.array([one.seconds for one in some])
            counts = [sum(one.said == s for one in some) for s in OUTCOMES]
            wrong = sum(one.wrong for one in some)
            yield case, len(some), *counts, wrong, f"{np.median(took):.0f}", f"{took.max():.0f}"
