"""How soon a localizer's faults are noticed, and how often one is seen that is none.

A robot drives in a bundled world or along a recorded log, and a localizer gives its poses with 3 cm
and 1 degree of noise. After some way it goes wrong. The opinion is that of ``imgloc node --watch``
of each scan.
"""

import itertools
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imgloc import LaserScan, MapFeatures, Moment, Options, Pose2D, ScanSet, Tracking, localize
from imgloc.filters.motion import compose_poses
from imgloc.filters.watch import AGREES, DISAGREES, Opinion, Watch
from imgloc.geometry import transform_poses, wrap
from imgloc.model import BoolArray, FloatArray, base_of
from tools.filters import piece
from tools.robot.places import SIMULATED, Place, both, gone_on, known, simulated

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
_BEFORE, _AFTER = (10.0, 5.0), (12.0, 3.0)  # seconds and metres, at least
_DRIVEN = 60.0  # metres of a simulated drive, of which faults are pieces
NOISE = (0.03, 0.03, float(np.deg2rad(1.0)))
"""Standard deviations of the poses of a localizer that is right."""
OFF = (1.0, float(np.deg2rad(20.0)))
"""Metres and radians beyond which a localizer is wrong."""


@dataclass(frozen=True)
class Noticed:
    """What became of one fault."""

    fault: str
    sure: bool  #: whether the poses were agreed with before
    seconds: float  #: from where the pose is wrong, see :data:`OFF`; infinite if never
    metres: float
    pose_right: bool  #: whether the pose that imgloc gives then is within half a metre
    false: int  #: times that it disagreed before the fault


def off(claims: FloatArray, truth: FloatArray) -> BoolArray:
    """Whether each of the poses (N, 3) is wrong; any is where the robot is not on the map."""
    apart = np.hypot(*(claims - truth)[:, :2].T), np.abs(wrap(claims[:, 2] - truth[:, 2]))
    return np.asarray(~((apart[0] <= OFF[0]) & (apart[1] <= OFF[1])))


def spoiled(
    place: Place, other: Place | None, fault: str, rng: np.random.Generator
) -> tuple[ScanSet, FloatArray, FloatArray, int] | None:
    """A piece of a log, its true poses, those that a localizer gives, and where a fault begins.

    None if the log has no such piece.
    """
    begin = place.start(_BEFORE[0] + _AFTER[0], rng)
    there, log = {"carried off": place, "wrong floor": other}.get(fault), place.log
    k = len(log) if begin is None else place.after(begin, *_BEFORE)
    if begin is None or k + 1 >= len(log) or (fault == "wrong floor" and there is None):
        return None
    parts = [range(begin, place.after(k, *_AFTER))]
    if there is not None:
        first = there.start(_AFTER[0], rng, known(log)[0][k] if there is place else None)
        if first is None:
            return None
        n, last = len(log), there.after(first, *_AFTER)
        log, parts = both(log, there.log), [range(begin, k), range(n + first, n + last)]
    log, k = piece(log, *parts), k - begin
    poses, stamps, _ = known(log)
    truth, claims, after, at = poses.copy(), poses.copy(), poses[k:], poses[k]
    angle = rng.uniform(-np.pi, np.pi)
    side = np.array([np.cos(angle), np.sin(angle), 0.0])
    begun = {  # from where it goes on
        "next bay": at + 3.0 * side, "jumped": at + rng.uniform(1.5, 5.0) * side,
        "heading by 180": at + (0.0, 0.0, np.pi), "covariance collapsed": at + 1.2 * side,
    }.get(fault)  # fmt: skip
    if there is not None:
        begun, truth[k:] = poses[k - 1], after if there is place else np.nan
    if fault == "symmetric twin":
        begun = _twin(place.features, log[k], at)
    if begun is not None:
        claims[k:] = gone_on(begun, after)
    elif fault == "slow drift":
        way = np.cumsum(np.hypot(*np.diff(after[:, :2], axis=0, prepend=at[None, :2]).T))
        claims[k:] += 0.2 * way[:, None] * side
    elif fault == "frozen":
        claims[k:] = at
    elif fault == "stale":
        claims[k:] = truth[np.searchsorted(stamps, stamps[k:] - 5.0)]
    elif fault == "wrong map version":
        claims[k:] = compose_poses(np.array([0, 0, np.deg2rad(3.0)]), after) + 1.5 * side
    elif fault == "wrong scale":
        claims[k:] = after * (1.1, 1.1, 1.0)
    return log, truth, claims + rng.normal(0.0, NOISE, claims.shape), k


def _twin(features: MapFeatures, scan: LaserScan, at: FloatArray) -> FloatArray:
    """Where a scan taken at a pose (3,) fits second best, or the opposite side of the map."""
    fits = localize(features, scan, Options(threads=1)).hypotheses
    some = [base_of(f.pose, scan.mount) for f in fits]
    far = [[*p] for p in some if np.hypot(p.x - at[0], p.y - at[1]) > OFF[0]]
    grid = features.grid
    middle = np.array([*grid.occupied.shape[::-1], 0.0]) * grid.resolution / 2
    x, y, _ = transform_poses(grid.origin, middle[None])[0]
    return np.array(far[0] if far else [2 * x - at[0], 2 * y - at[1], at[2] + np.pi])


def opinions(
    features: MapFeatures, log: ScanSet, claims: Iterable[FloatArray]
) -> Iterator[tuple[Opinion, Moment, float]]:
    """The opinion after each scan, what imgloc believes, and for how many seconds it thought.

    The seconds are of a processor, and of the belief alone.
    """
    options = Options(threads=1)
    watch, own = Watch(features, options), Tracking().follower(features, options)
    _, stamps, odometry = known(log)
    # A claim is taken once the opinion of the one before is out: it may hang on that.
    for scan, stamp, odom, claim in zip(log.scans, stamps.tolist(), odometry, claims, strict=True):
        here, now = Pose2D(*odom), replace(scan, stamp=stamp)
        watch.hear(stamp, Pose2D(*claim), here)
        begin = time.process_time()
        moment = own.step(now, odom)
        took = time.process_time() - begin
        yield watch.step(now, here, moment), moment, took


def began(said: Sequence[str]) -> int:
    """How often a disagreement began."""
    return sum(a != DISAGREES == b for a, b in itertools.pairwise(("", *said)))


def noticed(
    place: Place, other: Place | None, fault: str, rng: np.random.Generator
) -> Noticed | None:
    """Whether, and how soon, one fault is noticed; None if it moves no pose far enough."""
    made = spoiled(place, other, fault, rng)
    if made is None:
        return None
    log, truth, claims, k = made
    wrong = off(claims, truth)
    if not wrong[k:].any():
        return None
    begin, when, said = k + int(np.argmax(wrong[k:])), None, list[Opinion]()
    for i, (opinion, *_) in enumerate(opinions(place.features, log, claims)):
        said.append(opinion)
        if i >= begin and opinion.said == DISAGREES:
            when = i
            break
    sure, false = said[k - 1].said == AGREES, began([one.said for one in said[:k]])
    if when is None:
        return Noticed(fault, sure, np.inf, np.inf, False, false)
    _, stamps, odom = known(log)
    pose, there = said[when].pose, truth[when]
    right = pose is not None and bool(np.hypot(pose.x - there[0], pose.y - there[1]) < 0.5)
    metres = float(np.hypot(*np.diff(odom[begin : when + 1, :2], axis=0).T).sum())
    return Noticed(fault, sure, float(stamps[when] - stamps[begin]), metres, right, false)


def faults(n: int, seed: int, places: Sequence[Place] = ()) -> Iterator[Noticed]:
    """So many drives, the faults in turn in each place; by default in bundled worlds."""
    some, each = list(places), len(FAULTS)
    for k in range(n):
        if not places and k % (each * len(SIMULATED)) == 0:
            some = [simulated(name, _DRIVEN, seed + 10 * k) for name in SIMULATED]
        at = (k + k // each) % len(some)  # each fault comes to each place, in turn
        others: list[Place | None] = [p for p in some if p.features is not some[at].features]
        rng = np.random.default_rng((seed, k))
        one = noticed(
            some[at], others[k % len(others)] if others else None, list(FAULTS)[k % each], rng
        )
        if one is not None:
            yield one


def healthy(
    metres: float, seed: int, places: Sequence[Place] = ()
) -> Iterator[tuple[float, Counter[str]]]:
    """Drives without a fault in changed worlds or along logs: hours, and what was said how often.

    ``false`` counts how often it began to disagree.
    """
    for k in itertools.count():
        rng = np.random.default_rng((seed, k))
        if places:
            place = places[k % len(places)]
        else:
            place = simulated(SIMULATED[k % len(SIMULATED)], metres, seed + 1000 * k, changed=True)
        truth, stamps, _ = known(place.log)
        claims = truth + rng.normal(0.0, NOISE, truth.shape)
        said = [o.said for o, *_ in opinions(place.features, place.log, claims)]
        yield float(np.ptp(stamps)) / 3600, Counter(said) + Counter(false=began(said))


HEAD = (
    "fault | drives | agreed before | within 5 s or 2 m | median s | most s | own pose right | "
    "false before"
)


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
