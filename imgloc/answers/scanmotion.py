"""Agreement of scans and odometry of a log: what a scan sees lies where an earlier one saw it.

No map is needed. Two scans are laid over each other as the odometry moved the sensor between them;
the share of the readings that fall on each other is the agreement. If it is small, the same
is tried with what is often wrong: a sensor upside down or turned, other units, odometry that lags.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import combinations, permutations, product

import cv2
import numpy as np

from imgloc.features.scanpoints import evenly, scan_xy
from imgloc.geometry import transform_points
from imgloc.io.scanset import ScanSet
from imgloc.model import (
    BoolArray,
    FloatArray,
    IntArray,
    LaserScan,
    Pose2D,
    compose,
    inverse,
    wrapped_pose,
)
from imgloc.numbers import number

_FAR, _TURN, _WAY = number("scanmotion.apart")
_LOOKED, PAIRS, RAYS, LEAST, _AHEAD = number("scanmotion.tried")
_CELL, _NOISE = number("scanmotion.cell")
AGREES, POOR, _HALF, _TWO = number("scanmotion.agrees")
_LAGS = number("scanmotion.lags")
# Doubtful scans that are looked at in another way, and views that sensors have, radians.
TRIED, *VIEWS = number("diagnose.tried")
_STEP: float = number("scanmotion.mounts")  # between two turns of a place that are tried
_SIDE = 4000  # cells of an image of a scan; readings so far off are errors
Scan = Callable[[LaserScan], LaserScan]
Odometry = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True)
class Way:
    """A possible fault of a log, and what undoes it."""

    code: str
    value: float = 0.0  #: factor, angle in radians or seconds, as the code needs it
    scan: Scan = lambda scan: scan
    odom: Odometry = lambda odom: odom  #: of poses (N, 3)
    then: "Way | None" = None  #: what is wrong besides, and undone by `scan`, too

    @property
    def unit(self) -> float:
        """Factor on all lengths."""
        own = self.value if self.code == "units" else 1.0
        return own * (self.then.unit if self.then else 1.0)


@dataclass(frozen=True)
class Agreement:
    """Agreement of scans and odometry of a log, 0 to 1, as they are and with something undone."""

    share: float  #: NaN if the robot does not move enough
    best: Way | None = None  #: what makes them agree, if they do not
    two_lasers: bool = False  #: whether every other scan agrees with its like alone


def agreement(scans: ScanSet, odom: FloatArray) -> Agreement:
    """Agreement of scans with poses of the robot (N, 3), finite, in the odometry's frame."""
    if len(scans) < LEAST:
        return Agreement(math.nan)
    pairs = _pairs(odom, scans)
    here = _share(scans.scans.__getitem__, odom, pairs, Way(""))
    if math.isnan(here) or here >= AGREES:
        return Agreement(here)
    if len(scans.lasers) == 1 and _alternates(scans, odom):
        return Agreement(here, two_lasers=True)
    best, most = None, max(POOR, here / _HALF)
    ways = _ways(scans, odom)
    for way in [*ways, *_two(ways)]:
        share = _share(scans.scans.__getitem__, odom, pairs, way)
        if share > most * (_TWO if way.then and best else 1):
            best, most = way, share
    return Agreement(here, best)


def scaled_better(scans: ScanSet, factor: float) -> bool | None:
    """True if the odometry agrees better with the ranges multiplied by `factor` than as they are.

    None if the log has no odometry of a robot that moves, or it agrees with neither, or as well
    with both, within a standard deviation of such a share.
    """
    if scans.odom is None or len(scans) < 2:
        return None
    known, first = np.flatnonzero(np.isfinite(scans.odom).all(axis=1)).tolist(), scans.lasers[0]
    some = scans.take([k for k in known if scans[k].laser == first])
    odom, shares = np.asarray(some.odom), list[float]()
    gone = np.hypot(*np.diff(odom[:, :2], axis=0).T).cumsum()
    firsts = evenly(len(gone), _LOOKED)
    pairs = [*zip(firsts, 1 + np.searchsorted(gone, gone[firsts] + _WAY), strict=True)]
    for f in (1.0, factor):
        both = (
            (some[i].scaled(f), some[j].scaled(f), _step(odom, i, j))
            for i, j in pairs if j < len(odom)
        )  # fmt: skip
        shares.append(float(np.nanmean([0.0, *(overlap(*one, f) for one in both)])))
    most = max(shares)
    alike = np.square(shares[1] - shares[0]) * len(pairs) * RAYS < most * (1 - most)
    return None if alike or most <= POOR / 2 else shares[1] > shares[0]


def odd_laser(scans: ScanSet, odom: FloatArray) -> tuple[str, float, float, str] | None:
    """The one of several lasers that disagrees with poses (N, 3) of the robot, if one does.

    Its name and share; the share if it is mended, and how. Another one agrees, and it would itself
    upside down, turned, or both: few scans agree by nature.
    """
    found, most = list[tuple[str, float, float, str]](), 0.0
    for name in scans.lasers:
        k = [k for k, scan in enumerate(scans.scans) if scan.laser == name]
        own, path = scans.take(k), odom[k]
        share = partial(_share, own.scans.__getitem__, path, _pairs(path, own))
        here, seen = share(Way("")), np.median([np.count_nonzero(s.valid) for s in own.scans])
        if seen < LEAST or math.isnan(here):
            continue
        most = max(most, here)
        if here < POOR:
            yaw = own[0].mount.theta
            ways = list[tuple[float, str]]()
            for turn, hangs in product(np.arange(0.0, math.tau, _STEP).tolist(), (False, True)):
                right = math.degrees(Pose2D(0.0, 0.0, yaw + turn).theta)
                parts = ["hangs upside down"] * hangs
                parts += [f"has a yaw of about {right:.0f} degrees"] * (turn > 0)
                way = Way("", scan=partial(_turned, turn=turn, hangs=hangs))
                ways.append((share(way), " and ".join(parts)))
            found.append((name, here, *max(ways)))
    odd = min(found, key=lambda one: one[1], default=None)
    return odd if odd is not None and min(odd[2], most) >= POOR else None


def straightening(scans: ScanSet, odom: FloatArray) -> dict[str, float] | None:
    """Agreement of scans with poses (N, 3) of the robot, forward and backward straightened.

    The shares are those of :func:`agreement`, by the direction; None if no scan states how long it
    took, or the robot does not move enough.
    """
    if not any(scan.time_increment for scan in scans.scans) or len(scans) < LEAST:
        return None
    speeds, pairs = scans.velocities, _pairs(odom, scans)

    def straight(way: str, k: int) -> LaserScan:
        return scans[k].straightened(speeds[k], backward=way == "backward")

    ways = ("forward", "backward")
    found = {way: _share(partial(straight, way), odom, pairs, Way("")) for way in ways}
    return None if any(map(math.isnan, found.values())) else found


def _alternates(scans: ScanSet, odom: FloatArray) -> bool:
    """Return whether each scan agrees with the one after the next, and not with the next."""
    starts = evenly(len(scans) - 2, 4 * PAIRS)

    def median(ahead: int, some: IntArray) -> float:
        shares = [overlap(scans[i], scans[i + ahead], _step(odom, i, i + ahead)) for i in some]
        return float(np.nanmedian([0.0, *shares]))

    alike = max(median(2, starts[starts % 2 == odd]) for odd in (0, 1))
    return bool(alike > max(POOR, median(1, starts[::2]) / _HALF))


def _ways(scans: ScanSet, odom: FloatArray) -> list[Way]:
    """Faults that are tried, the likeliest first."""
    turns = math.pi, math.pi / 2, -math.pi / 2
    views = [a / b for a, b in permutations(VIEWS, 2)]  # one taken for the other
    ways = [
        Way("flipped", scan=lambda s: s.flipped),
        Way("odometry-turn", odom=lambda o: o * (1, 1, -1)),
        *(Way("units", f, scan=partial(LaserScan.scaled, factor=f)) for f in (0.001, 0.01)),
        *(Way("mounting", turn, scan=partial(_turned, turn=turn)) for turn in turns),
        *(Way("view", f, scan=partial(widened, factor=f)) for f in views),
    ]
    times, unit = np.arange(len(odom), dtype=float), 1.0
    if scans.stamps is not None and np.isfinite(scans.stamps).all():
        times = scans.stamps - scans.stamps[0]
        if not (np.diff(times) > 0).all():
            return ways
        unit = float(np.median(np.diff(times)))
    shifts = [sign * late * unit for late in _LAGS for sign in (1, -1)]
    return ways + [Way("lag", s, odom=partial(_shifted, times=times, shift=s)) for s in shifts]


def _two(ways: Sequence[Way]) -> list[Way]:
    """Faults that come together: a raw frame is clockwise and turned, in millimetres besides."""
    some = [way for way in ways if way.code in ("units", "flipped", "mounting")]
    return [
        replace(a, scan=lambda s, a=a, b=b: b.scan(a.scan(s)), then=b)  # type: ignore[misc]
        for a, b in combinations(some, 2)
        if a.code != b.code
    ]


def _turned(scan: LaserScan, turn: float, *, hangs: bool = False) -> LaserScan:
    """The scan of a sensor that is turned by so many radians, and hangs upside down besides."""
    scan = scan.flipped if hangs else scan
    mount = scan.mount
    return replace(scan, T_base_laser=Pose2D(mount.x, mount.y, mount.theta + turn))


def widened(scan: LaserScan, factor: float) -> LaserScan:
    """The scan with its field of view multiplied, about its middle."""
    middle = 0.5 * (scan.angles.min() + scan.angles.max())
    return replace(scan, angles=middle + factor * (scan.angles - middle))


def _shifted(odom: FloatArray, times: FloatArray, shift: float) -> FloatArray:
    """The odometry `shift` after each time."""
    at = times + shift
    columns = [odom[:, 0], odom[:, 1], np.unwrap(odom[:, 2])]
    return np.stack([np.interp(at, times, column) for column in columns], axis=1)


def _pairs(odom: FloatArray, scans: ScanSet) -> list[tuple[int, int]]:
    """Pairs of scans of a laser between which the robot went or turned enough, and no farther."""
    out, lasers = list[tuple[int, int]](), np.array([scan.laser for scan in scans.scans])
    for i in evenly(len(odom) - 1, _LOOKED).tolist():
        ahead = odom[i + 1 : i + 1 + _AHEAD]
        far = np.hypot(*(ahead[:, :2] - odom[i, :2]).T) > _FAR
        turned = np.abs(np.remainder(ahead[:, 2] - odom[i, 2] + math.pi, math.tau) - math.pi)
        alike = lasers[i + 1 : i + 1 + _AHEAD] == lasers[i]
        found = np.flatnonzero((far | (turned > _TURN)) & alike)
        if found.size:
            out.append((i, i + 1 + int(found[0])))
    return out


def _share(
    scan: Callable[[int], LaserScan], odom: FloatArray, pairs: Sequence[tuple[int, int]], way: Way
) -> float:
    """The lesser of two medians: of the pairs that turned most, and of those that went farthest.

    Turns show errors of angles, and ways those of lengths. `scan` gives the scan of an index.
    """
    moved = way.odom(odom)
    steps = [_step(odom, i, j) for i, j in pairs]
    turned = np.array([abs(step.theta) for step in steps])
    gone = np.array([math.hypot(step.x, step.y) for step in steps])

    @cache
    def fits(k: int) -> float:
        i, j = pairs[k]
        return overlap(way.scan(scan(i)), way.scan(scan(j)), _step(moved, i, j), way.unit)

    medians = list[float]()
    for order in (np.argsort(-turned, kind="stable"), np.argsort(turned - gone, kind="stable")):
        shares = [share for k in order[:PAIRS].tolist() if not math.isnan(share := fits(k))]
        if 2 * len(shares) >= PAIRS:
            medians.append(float(np.median(shares)))
        elif len(order) >= PAIRS:  # scans without readings agree with nothing
            medians.append(0.0)
    return min(medians, default=math.nan)


def _step(odom: FloatArray, i: int, j: int) -> Pose2D:
    """The motion between two of the poses (N, 3), in the earlier one's frame."""
    return compose(inverse(wrapped_pose(*odom[i])), wrapped_pose(*odom[j]))


def overlap(before: LaserScan, after: LaserScan, step: Pose2D, unit: float = 1.0) -> float:
    """Share of a scan's valid readings that fall on those of one before, NaN if few are valid.

    The robot's motion `step` is in its own frame. Cells are as fine as the ranges are short, so
    that no unit is better than another, but not finer than the noise; `unit` is the factor that
    the ranges were multiplied by.
    """
    one, other = (scan_xy(scan)[scan.valid] for scan in (before, after))
    if min(len(one), len(other)) < LEAST:
        return math.nan
    to = compose(compose(inverse(before.mount), step), after.mount)
    middle = float(np.median(np.hypot(*one.T)))
    if not middle > 0:
        return math.nan
    cell = max(_CELL * middle, _NOISE * unit)
    moved = transform_points(to, other[evenly(len(other), RAYS)])
    corner = one.min(axis=0) - 2 * cell
    filled = np.floor(np.minimum((one - corner) / cell, _SIDE - 3)).astype(np.int64)
    width, height = (filled.max(axis=0) + 3).tolist()
    image = np.zeros((height, width), np.uint8)
    image[filled[:, 1], filled[:, 0]] = 1
    image = cv2.dilate(image, np.ones((3, 3), np.uint8))
    at = np.floor(np.clip((moved - corner) / cell, -1, _SIDE)).astype(np.int64)
    inside: BoolArray = (at >= 0).all(axis=1) & (at[:, 0] < width) & (at[:, 1] < height)
    return float(np.count_nonzero(image[at[inside, 1], at[inside, 0]]) / len(at))
