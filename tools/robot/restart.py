"""Is a robot that starts again told a wrong place? It stayed, was moved, or is somewhere else.

Each start is a robot in a bundled world that remembers a pose, and one scan, as of
``imgloc node --remember``. Half of the lasers see 360 degrees up to 12 m, half 270 up to 6 m.
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from imgloc import LaserScan, MapFeatures, Options, Pose2D, localize, prepare
from imgloc.geometry import pose_errors
from imgloc.live.remember import Kept, checked, identity
from imgloc.model import FloatArray, OccupancyGrid
from imgloc.simulation.scans import sample_free_poses, simulate_ranges
from imgloc.simulation.worlds import WORLDS, render
from tools.robot.kill import NEAR
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
    seconds: float  #: from the scan to the answer


def _scan(grid: OccupancyGrid, pose: FloatArray, laser: int, seed: int) -> LaserScan:
    angles, reach = _LASERS[laser]
    (ranges,) = simulate_ranges(grid, pose[None], angles, sigma=0.02, seed=seed, range_max=reach)
    return LaserScan(ranges, angles, range_max=reach, T_base_laser=Pose2D(0.0, 0.0))


def starts(n: int, seed: int) -> Iterator[Start]:
    """So many starts, the cases and worlds in turn."""
    known = {name: prepare(render(WORLDS[name](), 0.05), name) for name in _WORLDS}
    drawn = {name: prepare(dilated(f.grid, np.random.default_rng(0)), name)
             for name, f in known.items()}  # fmt: skip
    options = Options(threads=1)
    for k in range(n):
        rng = np.random.default_rng((seed, k))
        case, name = list(CASES)[k % len(CASES)], _WORLDS[(k // len(CASES)) % len(_WORLDS)]
        laser = int(rng.integers(2))
        features, world = known[name], known[name].grid
        here = sample_free_poses(world, 1, seed=2 * (seed + k))[0]
        kept = Kept(name, identity(world), Pose2D(*here), 0.0)
        truth = here + rng.uniform(-1, 1, 3) * (0.14, 0.14, 0.1)
        if not _free(world, truth):
            truth = here
        if case == "map redrawn":
            features = drawn[name]
        if case == "half a map":
            features = prepare(half(world, rng), name)
        if case in ("moved", "moved, changed", "half a map"):
            truth = sample_free_poses(world, 1, seed=2 * (seed + k) + 1)[0]
        if case in ("stayed, changed", "moved, changed"):
            world = furnished(world, rng)
            if not _free(world, truth):
                continue
        if case == "elsewhere":
            world = known[_WORLDS[(_WORLDS.index(name) + 1 + k % 3) % 4]].grid
            truth = sample_free_poses(world, 1, seed=2 * (seed + k) + 1)[0]
        if case == "twin":
            fits = localize(features, _scan(world, here, laser, k), options).hypotheses
            if len(fits) < 2 or not _free(world, at := np.array([*fits[1].pose])):
                continue
            truth = at
        scan = _scan(world, truth, laser, seed + k)
        if case == "stayed, people":
            scan = people(scan, rng)
        yield _started(case, features, kept, scan, None if case == "elsewhere" else truth)


def _started(
    case: str, features: MapFeatures, kept: Kept, scan: LaserScan, truth: FloatArray | None
) -> Start:
    begin = time.perf_counter()
    answer = localize(features, scan, Options(threads=1))
    said, pose = checked(kept, answer, identity(features.grid))
    seconds, wrong = time.perf_counter() - begin, False
    if pose is not None:
        wrong = truth is None  # and published, if it is restored or the node has --standing
        if truth is not None:
            errors = pose_errors(np.array([[*pose]]), Pose2D(*truth))[0]
            wrong = bool((errors > NEAR).any())
    return Start(case, said, wrong, seconds)


def _free(grid: OccupancyGrid, pose: FloatArray) -> bool:
    """Whether a robot can be there."""
    row, column = np.floor(pose[1::-1] / grid.resolution).astype(int)
    height, width = grid.free.shape
    return 0 <= row < height and 0 <= column < width and bool(grid.free[row, column])


def rows_of(every: list[Start]) -> Iterator[tuple[object, ...]]:
    """A row a case, and one of all: starts, what was said, wrong, times."""
    for case in (*CASES, "all"):
        some = [one for one in every if case in (one.case, "all")]
        if some:
            took = 1e3 * np.array([one.seconds for one in some])
            counts = [sum(one.said == s for one in some) for s in ("restored", "moved", "refused")]
            wrong = sum(one.wrong for one in some)
            yield case, len(some), *counts, wrong, f"{np.median(took):.0f}", f"{took.max():.0f}"
