"""Whether a robot that stands, or drives a little, is told a wrong place.

    python -m tools.standing                    # 200 scans that one look cannot settle
    python -m tools.standing -n 20 --seed 1     # fewer

Bundled worlds are the maps. The robot is in their twins: half of the furniture gone, boxes that
have come, one in 30 square metres. Scans count whose answer alone is ``ambiguous``, or ``unique``
and wrong. Each is seen 100 times with fresh noise from where the robot stands, then while it turns
once on the spot, and then along a drive of 6 m; `--standing` of ``imgloc node`` is asked once. The
same drive with the twin as the map is a bound for who has only the old map. It prints a line a
world, and exits with 1 if a robot that stood was told a place, or one that turned or drove a wrong
one.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imgloc import LaserScan, MapFeatures, Moment, Options, Pose2D, Tracking, localize, prepare
from imgloc.features.distance import distance_image
from imgloc.filters.motion import noisy_odometry
from imgloc.geometry import values_at
from imgloc.live.policy import alone
from imgloc.model import FloatArray, OccupancyGrid
from imgloc.simulation.scans import sample_free_poses, simulate_ranges
from imgloc.simulation.worlds import WORLDS, render
from tools.drive import path_between
from tools.robot.kill import NEAR
from tools.robot.places import apart
from tools.script import at_least_one, parser_of, progress, table_lines
from tools.trust.disturb import furnished

WORLDS_ASKED = ("corridor", "double_wall", "visibility", "curved")
_ANGLES = np.deg2rad(np.arange(-135, 135.5, 1.0))
REACH, NOISE, MISSING = 6.0, 0.02, 0.02  # metres, metres, share of readings without a return
TRIES, TURN, WAY, STEP, SOON = 100, 36, 6.0, 0.1, 3.0  # looks, looks, metres, metres, metres
_DRAWN = 40  # poses that are tried for each that counts


@dataclass(frozen=True)
class Outcome:
    """What became of one scan."""

    world: str
    verdict: str  #: of the scan alone
    standing: int  #: looks after which a pose was published while the robot stood
    alone: bool  #: whether one scan alone is told, by `--standing`
    alone_wrong: bool
    turned: int  #: poses published while it turns once on the spot
    turned_wrong: int  #: those that are wrong
    metres: float  #: driven until the first pose; NaN if there was none
    wrong: int  #: poses published along the way that are wrong
    bound: float  #: metres driven until the first pose on the map as the building is now


def wrong(pose: Pose2D | None, truth: FloatArray) -> bool:
    """Whether a pose is off by more than half a metre or 10 degrees."""
    return pose is not None and apart(pose, truth, NEAR)


def seen(grid: OccupancyGrid, poses: FloatArray, seed: int) -> list[LaserScan]:
    """What the laser sees at poses (N, 3), with fresh noise, and some readings missing."""
    ranges = simulate_ranges(grid, poses, _ANGLES, sigma=NOISE, seed=seed, range_max=REACH)
    gone = np.random.default_rng(seed).random(ranges.shape) < MISSING
    return [
        LaserScan(r, _ANGLES, range_max=REACH, stamp=0.2 * k)
        for k, r in enumerate(np.where(gone, np.nan, ranges))
    ]


def looks(features: MapFeatures, scans: Sequence[LaserScan], odom: FloatArray) -> Iterator[Moment]:
    """What is believed after each scan."""
    follower = Tracking().follower(features, Options(threads=1))
    for k, (scan, at) in enumerate(zip(scans, odom, strict=True)):
        yield follower.step(replace(scan, stamp=0.2 * k), at)


def first_of(moments: Sequence[Moment]) -> float:
    """Metres driven until the first pose is published; NaN if none is."""
    return next((STEP * k for k, one in enumerate(moments) if one.pose is not None), np.nan)


def way_from(grid: OccupancyGrid, pose: FloatArray, seed: int) -> FloatArray | None:
    """Poses (N, 3) of a drive of :data:`WAY` metres that begins at a place; None if none does."""
    room = distance_image(grid.occupied) * grid.resolution
    clear = replace(grid, free=grid.free & (room > 0.25))
    for goal in sample_free_poses(clear, 20, seed=seed):
        if np.hypot(*(goal - pose)[:2]) < WAY:
            continue
        try:
            path = path_between(clear, np.array([pose[:2], goal[:2]]), STEP)
        except ValueError:
            continue
        clear_way = values_at(clear.free, path[:, :2], grid.resolution).all()
        if len(path) >= WAY / STEP and clear_way:
            return path[: round(WAY / STEP)]
    return None


def outcomes(world: str, count: int, seed: int) -> Iterator[Outcome]:
    """So many scans of one world."""
    grid = render(WORLDS[world](), 0.05)
    features, rng = prepare(grid), np.random.default_rng(seed)
    twin = furnished(grid, rng)
    now, found = prepare(twin), 0
    for k, pose in enumerate(sample_free_poses(twin, _DRAWN * count, seed=seed)):
        path = way_from(twin, pose, seed + k)
        if found == count:
            return
        if path is None:
            continue
        (first,) = seen(twin, path[:1], seed + k)
        answer = localize(features, first, Options(threads=1))
        off = wrong(answer.pose, path[0])
        if answer.verdict not in ("ambiguous", "unique") or (
            answer.verdict == "unique" and not off
        ):
            continue
        found += 1
        still = np.repeat(path[:1], TRIES, axis=0)
        told = list(looks(features, seen(twin, still, 7 * seed + k), np.zeros((TRIES, 3))))
        turn = np.repeat(path[:1], TURN + 1, axis=0)
        turn[:, 2] += np.linspace(0, 2 * np.pi, TURN + 1)
        odom = noisy_odometry(turn, np.random.default_rng(seed + k))
        around = list(looks(features, seen(twin, turn, 8 * seed + k), odom))
        odom = noisy_odometry(path, np.random.default_rng(seed + k))
        drive = seen(twin, path, 9 * seed + k)
        along, best = (list(looks(f, drive, odom)) for f in (features, now))
        yield Outcome(
            world, answer.verdict, sum(m.pose is not None for m in told), alone(answer),
            alone(answer) and off, sum(m.pose is not None for m in around),
            sum(wrong(m.pose, truth) for m, truth in zip(around, turn, strict=True)),
            first_of(along), sum(wrong(m.pose, t) for m, t in zip(along, path, strict=True)),
            first_of(best),
        )  # fmt: skip


def row_of(world: str, some: Sequence[Outcome]) -> tuple[object, ...]:
    """The cells of the table for a world."""
    metres, bound = np.array([(o.metres, o.bound) for o in some]).reshape(-1, 2).T
    known = metres[np.isfinite(metres)]
    unique, told = sum(o.verdict == "unique" for o in some), sum(o.standing > 0 for o in some)
    alone = f"{sum(o.alone for o in some)}, {sum(o.alone_wrong for o in some)}"
    turned = f"{sum(o.turned > 0 for o in some)}, {sum(o.turned_wrong > 0 for o in some)}"
    soon = [f"{np.mean(way <= SOON):.2f}" if some else "-" for way in (metres, bound)]
    median = f"{np.median(known):.1f}" if len(known) else "-"
    missed = sum(o.wrong > 0 for o in some)
    return world, len(some), unique, told, alone, turned, len(known), missed, *soon, median


def main() -> int:
    """Parse the command line, measure, print a table."""
    parser = parser_of("tools.standing", __doc__, seed=0)
    parser.add_argument("-n", type=int, default=200, help="scans (default: %(default)s)")
    given = parser.parse_args()
    at_least_one(n=given.n)
    each, every = -(-given.n // len(WORLDS_ASKED)), list[Outcome]()
    with progress("standing", each * len(WORLDS_ASKED)) as advance:
        for world in WORLDS_ASKED:
            for outcome in outcomes(world, each, given.seed):
                every.append(outcome)
                advance()
    groups = {world: [o for o in every if o.world == world] for world in WORLDS_ASKED}
    rows = [row_of(*group) for group in (groups | {"all": every}).items()]
    head = (
        "world | scans | alone unique and wrong | told while standing | --standing: told, wrong | "
        "told by a turn, wrong | told on the way | wrong | within 3 m | on the true map | median m"
    )
    print(*table_lines(head, rows), sep="\n")
    return int(any(o.standing or o.turned_wrong or o.wrong for o in every))


if __name__ == "__main__":
    raise SystemExit(main())
