"""A filter along a log: which scans it weighs, and which poses it publishes or withholds."""

import logging
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imgloc.errors import ConfigError, ScanError, expect
from imgloc.features.mapfeatures import MapFeatures
from imgloc.filters.belief import AMBIGUOUS, UNIQUE, Belief, Filter, deviations_of
from imgloc.filters.choose import make_filter
from imgloc.filters.evidence import DEVIATION, usable
from imgloc.filters.motion import (
    Way,
    compose_poses,
    increments,
    invert_poses,
    noisy_odometry,
    stands,
)
from imgloc.filters.repeats import Repeats, dragged, frozen, smooth
from imgloc.filters.scanodometry import APART, ScanOdometry
from imgloc.filters.tracker import TrackerOptions
from imgloc.geometry import in_grid_frame, rotate_covariance, transform_poses
from imgloc.io.scanset import ScanSet
from imgloc.model import FloatArray, IntArray, LaserScan, Pose2D, Protection
from imgloc.numbers import number
from imgloc.options import Every, Followed, Limits, Options
from imgloc.robot.lasers import Laser, Lasers
from imgloc.robot.stamps import ANEW, FINE, LEAP, OLD, Stamps
from imgloc.search.protection import protection

LOG = logging.getLogger("imgloc")

Reading = tuple[LaserScan, FloatArray | None]
"""A scan with its stamp, and the odometry's pose (3,) at that time; None without odometry."""
BLIND, WIDE, UNCONFIRMED, STANDING = "blind", "wide", "unconfirmed", "has not moved"
_LATEST = 1e18  # seconds
_FASTEST = 50.0  # metres a second: no robot on the ground is faster
# Share of the stamps that may go back, and by which share the way may be longer in their order.
_BACK, _LONGER = number("follow.sorted")
_FARTHEST = 1e6  # metres between two scans: beyond it a number is damaged


@dataclass(frozen=True)
class Moment:
    """The belief after a scan.

    Poses are the robot's in the map frame. If the scan has no `T_base_laser`, poses are the
    sensor's.
    """

    index: int  #: index of the scan
    stamp: float  #: stamp of the scan, seconds; NaN when unknown
    age: float  #: seconds since the last scan that was not blind
    looked: bool  #: whether this scan weighed the whole belief
    #: metres driven since the first scan, by odometry; NaN if it is not known: scans alone, which
    #: were too far apart, told the motion
    metres: float
    belief: Belief
    #: why a pose that holds the mass is withheld: ``blind`` (this scan says nothing), ``wide`` (the
    #: pose's standard deviation is above the limit), ``unconfirmed`` (too few scans along too short
    #: a way agree with it yet), ``has not moved`` (the robot has stood since the first scan, and
    #: scans of one place are one witness); empty if nothing is withheld
    withheld: str
    #: best pose, whatever the verdict; None if there is none
    best: Pose2D | None
    covariance: FloatArray  #: (3, 3) covariance of `best`, map frame: m², m rad and rad²
    #: standard deviations of `best`: metres along the longest axis, and radians
    deviation: tuple[float, float]
    map_odom: Pose2D | None  #: pose of the odometry's frame in the map, by `best`
    diagonal: float = np.inf  #: from corner to corner of the map, metres
    scale: float = 1.0  #: factor on the ranges, as scans of the way showed it, or as it was given
    thinner: float = 0.0  #: metres that each wall loses on each side, likewise
    bent: float = 0.0  #: standard deviation of the place of a piece of wall, metres, likewise

    @property
    def pose(self) -> Pose2D | None:
        """The best pose if it is ``unique``, so that it can be relied upon; else None."""
        return self.best if self.belief.verdict == UNIQUE else None

    @property
    def protection(self) -> tuple[Protection, ...]:
        """Radius and heading around `best` that hold the true pose, at 95, 99 and 99.9 %."""
        b = self.belief
        return protection(b.poses, b.mass, b.covariance, b.lost, farthest=self.diagonal)


@dataclass(frozen=True)
class Tracking(Followed):
    """Settings by which a robot is followed.

    Examples
    --------
    >>> Tracking(limits=Limits(0.2)).every
    Every(metres=0.5, radians=0.5235987755982988)
    """

    def follower(self, features: MapFeatures, options: Options, name: str = "log") -> "Follower":
        """Make the follower that takes the scans of one robot; errors call the log `name`."""
        made = self.made(features, options)
        return Follower(features, made, every=self.every, limits=self.limits, name=name)

    def made(self, features: MapFeatures, options: Options) -> Filter:
        """Make a filter that has seen nothing yet."""
        return make_filter(self.filter, features, options, seed=self.seed)


def follow(
    features: MapFeatures,
    scans: ScanSet | Iterable[Reading],
    filter_: Filter,
    *,
    every: Every | None = None,
    limits: Limits | None = None,
    start: Pose2D | None = None,
    deviation: tuple[float, float] = DEVIATION,
    name: str = "log",
) -> Iterator[Moment]:
    """Drive a filter along a log: yield one moment for each scan, as soon as the scan is there.

    Parameters
    ----------
    features : MapFeatures
        The map.
    scans : ScanSet, or iterable of (LaserScan, (3,) array or None)
        Scans in the order of time; a ScanSet in which few scans are out of it is sorted, with a
        warning. `laser` of each scan names its laser. An iterable yields each
        scan, with its stamp, and the odometry's pose at that time: metres, metres, radians.
        The next scan is taken from it after the moment of the last one has been used. Where a log
        has no odometry, or none that moves, the motion is found by the scans alone; else scans
        without odometry are left out. So is a scan of an iterable whose stamp goes back; if by more
        than a second, the second such one counts, because the clock was set back.
    filter_ : Filter
        A filter made for the same features. It is changed.
    every : Every, optional
        Way after which a scan weighs the whole belief. Until then the scans of that laser correct
        the best pose only.
    limits : Limits, optional
        Standard deviations beyond which a pose is withheld.
    start : Pose2D, optional
        Pose at the first scan, map frame. By default the robot may be anywhere.
    deviation : (float, float), optional
        Standard deviations of `start`, metres and radians.
    name : str
        Name of the log in error messages.

    Yields
    ------
    Moment
        The belief after each scan, map frame.

    Raises
    ------
    ScanError
        If the odometry is in millimetres, or stamps of a ScanSet run backwards. It is checked
        before its first moment.
    ConfigError
        If `start` is outside of the map.

    Examples
    --------
    >>> import imgloc
    >>> from imgloc.io.maps import bundled_maps
    >>> features = imgloc.prepare(imgloc.load_map(bundled_maps() / "curved.yaml"))
    >>> robot = imgloc.make_filter("tracker", features, imgloc.Options())
    >>> driver = ((scan, np.zeros(3)) for scan in imgloc.simulate(features.grid, 2, seed=1).scans)
    >>> [moment.belief.verdict for moment in follow(features, driver, robot)]
    ['ambiguous', 'ambiguous']
    """
    expect(features, MapFeatures, "features")
    if isinstance(scans, ScanSet):
        readings = _whole(scans, name)
    else:
        expect(scans, ScanSet if not isinstance(scans, Iterable) else Iterable, "scans")
        readings = _coming(scans, name)
    follower = Follower(features, filter_, every=every, limits=limits, name=name)
    if start is not None:
        follower.place(start, deviation, "start")
    for index, scan, odom, stamp in readings:
        if not isinstance(scans, ScanSet) and follower.judge(scan, stamp) == OLD:
            LOG.warning("%s: scan %d: its stamp, %.2f, goes back; left out", name, index, stamp)
        else:
            yield replace(follower.step(scan, odom, stamp), index=index)


# Index, scan, odometry, stamp.
_Steps = Iterator[tuple[int, LaserScan, FloatArray | None, float]]
BY_SCANS = "no odometry that moves is used: the scans alone tell the motion"
FAR_APART = (
    "scan {} comes {:.3g} s after the one before: without odometry, scans more than {:g} s apart "
    "tell no motion, so the length of the way is unknown. Record odometry, or more scans a second"
)


def _coming(scans: Iterable[Reading], name: str) -> _Steps:
    """Yield scans, with odometry and their index, as they come.

    As long as none has had odometry, the motion is found by the scans alone; later ones that lack
    it are left out. At the end log how many.
    """
    left, index, by_scans = 0, -1, True
    for index, (scan, given) in enumerate(scans):
        odom = None if given is None or not np.isfinite(given).all() else given
        by_scans &= odom is None
        if odom is None and not by_scans:
            left += 1
        else:
            if index == 0 and odom is None:
                LOG.warning("%s: %s", name, BY_SCANS)
            yield index, scan, odom, scan.stamp
    if left:
        LOG.warning("%s: %d of %d scans have no odometry and were left out", name, left, index + 1)


def _whole(scans: ScanSet, name: str) -> _Steps:
    """Yield scans with odometry, each with its index, after a check of the whole log."""
    by_scans = not moves(scans)
    if by_scans:
        LOG.warning("%s: %s", name, BY_SCANS)
        known, indices = scans, list(range(len(scans)))
        odom = np.zeros((len(scans), 3))
    else:
        known, indices = scans.with_odometry(name)
        odom = np.empty((0, 3)) if known.odom is None else known.odom
    stamps = np.full(len(known), np.nan) if known.stamps is None else known.stamps
    if (far := np.flatnonzero(np.abs(stamps) > _LATEST)).size:
        _check_order(name, indices[far[0]], np.nan, float(stamps[far[0]]))
    if (lone := alone_ahead(stamps)).size:
        text = "%s: %d of %d scans, the first %d, have a stamp ahead of the next ones; left out"
        LOG.warning(text, name, len(lone), len(known), indices[lone[0]])
        kept = np.setdiff1d(np.arange(len(known)), lone).tolist()
        known, odom, stamps = known.take(kept), odom[kept], stamps[kept]
        indices = [indices[k] for k in kept]
    if (back := np.flatnonzero(np.diff(stamps) < 0)).size:
        ordered = in_order(stamps, odom)
        if ordered is None:
            _check_order(name, indices[back[0] + 1], *stamps[back[0] : back[0] + 2])
        else:
            how = "in the order of their stamps" if ordered[0] else "as they stand in the file"
            said = back_words(stamps, indices)
            LOG.warning("%s: %s; imgloc follows the scans %s", name, said, how)
            order, stamps = ordered[0] or list(range(len(known))), ordered[1]
            known, odom = known.take(order), odom[order]
            indices = [indices[k] for k in order]
    with np.errstate(over="ignore", invalid="ignore"):
        way, seconds = np.hypot(*increments(odom)[:, :2].T), np.diff(stamps)
    if (leaps := np.flatnonzero(~(way <= _FARTHEST))).size:
        _check_way(name, int(leaps[0]) + 1, float(way[leaps[0]]))
    moving = (way > 0) & (seconds > 0)
    if moving.any() and (speed := float(np.median(way[moving] / seconds[moving]))) > _FASTEST:
        raise ScanError(
            f"{name}: odom: it says {speed:.4g} m/s, expected metres; are these millimetres? "
            "divide them by 1000"
        )
    poses = [None] * len(known) if by_scans else list(odom)
    return zip(indices, known.scans, poses, stamps.tolist(), strict=True)


def moves(scans: ScanSet) -> bool:
    """Return whether a log has odometry, and that ever moves."""
    if scans.odom is None or not (known := np.isfinite(scans.odom).all(axis=1)).any():
        return False
    return len(scans) < 2 or bool(np.ptp(scans.odom[known], axis=0).any())


class Follower:
    """Drives a filter scan after scan: :meth:`step` takes a scan and returns a moment.

    Parameters
    ----------
    features : MapFeatures
        The map.
    filter_ : Filter
        A filter made for the same features. It is changed.
    every : Every, optional
        Way after which a scan weighs the whole belief, metres and radians.
    limits : Limits, optional
        Standard deviations beyond which a pose is withheld.
    name : str
        Name of the log in error messages.

    Examples
    --------
    >>> import imgloc
    >>> from imgloc.io.maps import bundled_maps
    >>> features = imgloc.prepare(imgloc.load_map(bundled_maps() / "curved.yaml"))
    >>> robot = Follower(features, imgloc.make_filter("tracker", features, imgloc.Options()))
    >>> moment = robot.step(imgloc.simulate(features.grid, 1, seed=1)[0], np.zeros(3))
    >>> moment.index, moment.looked, moment.pose
    (0, True, None)
    """

    def __init__(
        self,
        features: MapFeatures,
        filter_: Filter,
        *,
        every: Every | None = None,
        limits: Limits | None = None,
        name: str = "log",
    ) -> None:
        self.features, self.filter, self.name = features, filter_, name
        self.every, self.limits = every or Every(), limits or Limits()
        self._lasers = Lasers()
        self._repeats = defaultdict[str, Repeats](Repeats)
        self._held = TrackerOptions().mass[0]  # from which one place is no longer one of several
        self._count, self._blind, self._metres, self._gone = 0, 0, 0.0, Way()
        self._scans = ScanOdometry(filter_.options)
        self._here, self._stands = np.zeros(3), True  # by odometry, since the first scan
        self._dark = 0.0  # seconds of blind scans that the filter has not counted yet
        self._odom: FloatArray | None = None
        self._stamp = self._said = float("nan")
        self._stamps = dict[str, float]()  # the last one of each laser
        self._judges = defaultdict[str, Stamps](lambda: Stamps(shared=True))

    def place(
        self, pose: Pose2D, deviation: tuple[float, float] = DEVIATION, given: str = "pose"
    ) -> None:
        """Start at a pose, map frame, with standard deviations in metres and radians.

        A pose outside of the map raises a ConfigError, which names the argument `given`; so does
        one that is not finite, or a deviation that is negative or not finite.
        """
        self.filter.place(start_of(given, pose, deviation, self.features), deviation)

    def judge(self, scan: LaserScan, stamp: float, now: float = np.nan) -> str:
        """Judge the stamp of a scan before its :meth:`step`: a word of :mod:`imgloc.robot.stamps`.

        `now` is the time of the clock that stamps are of, if it is known. If the clock was set
        back, or the last stamp was wrong, time begins anew.
        """
        judged = self._judges[scan.laser].take(stamp, now)
        if judged == ANEW:
            self._said = self._stamp = np.nan
            self._stamps.clear()
            self._scans = ScanOdometry(self.filter.options)
        # That another laser is so late says nothing of its clock.
        return OLD if judged == FINE and stamp < self._stamp - LEAP else judged

    def step(self, scan: LaserScan, odom: FloatArray | None, stamp: float | None = None) -> Moment:
        """Take a scan and the odometry's pose (3,) at its stamp: metres, metres, radians.

        Without odometry the motion is found by the scans alone. `stamp` is in seconds, by default
        the scan's own.

        Raises
        ------
        ScanError
            If the stamp is before that of the last scan. If the odometry is not finite, or jumps
            by more than 1,000 km.
        """
        k = self._count
        if odom is not None:
            try:
                odom = np.array(odom, dtype=np.float64)
            except (TypeError, ValueError):
                odom = np.full(1, np.nan)
            if odom.shape != (3,) or not np.isfinite(odom).all():
                said = f"odom[{k}]: got {odom.tolist()}, expected finite x, y and theta"
                raise ScanError(f"{self.name}: {said}")
        stamp = scan.stamp if stamp is None else stamp
        laser = self._lasers.of(scan)
        step, covariance, motion = np.zeros(3), None, None
        # Scans of several lasers may come a little out of order, each at its odometry's pose.
        _check_order(self.name, k, self._stamps.get(scan.laser, self._stamp - LEAP), stamp)
        if np.isnan(self._stamp):
            self._said = self._stamp = stamp
        if odom is not None and self._odom is not None:
            with np.errstate(over="ignore", invalid="ignore"):
                step = increments(np.stack((self._odom, odom)))[0]
            if k == 1 and np.hypot(*self._odom[:2]) > _FARTHEST:
                self._odom = odom  # the first one is the damaged one
            _check_way(self.name, k, float(np.hypot(*step[:2])))
        if odom is None and self._odom is not None:  # nothing tells the way since the last scan
            self._scans = ScanOdometry(self.filter.options)
        if odom is None or (k > 0 and self._odom is None):
            motion = self._scans.step(replace(scan, stamp=stamp))
            if self._odom is not None:
                motion = replace(motion, covariance=np.eye(3), lost=True)
            step, covariance = motion.increment, motion.covariance
        waited = max(0.0, float(np.nan_to_num(stamp - self._stamp)))
        self._count, self._odom, self._stamps[scan.laser] = k + 1, odom, stamp
        self._stamp = stamp if np.isnan(stamp) else max(self._stamp, stamp)
        if motion is not None and waited > APART:
            if not np.isnan(self._metres):
                LOG.warning("%s: %s", self.name, FAR_APART.format(k, waited, APART))
            self._metres = np.nan
        repeats = self._repeats[scan.laser]
        self._move(step, covariance, known=motion is None or not motion.lost)
        looked = self._take(scan, laser, repeats.since(scan), waited)
        repeats.believe(self.filter.belief)
        return self._moment(k, stamp, looked)

    def _move(self, step: FloatArray, covariance: FloatArray | None, *, known: bool) -> None:
        self.filter.move(step, covariance, known=known)
        moved = self._gone.gone(step)
        self._lasers.move(moved)
        for repeats in self._repeats.values():
            repeats.move(step)
        self._metres += float(moved[0])
        self._here = compose_poses(self._here, step)
        self._stands &= stands(self._here)

    def _take(self, scan: LaserScan, laser: Laser, again: FloatArray | None, waited: float) -> bool:
        """Take a scan, `again` after an equal one; return whether it weighed the whole belief."""
        blind = usable(scan, self.filter.options) is None
        if again is not None and not blind:
            repeats, belief = self._repeats[scan.laser], self.filter.belief
            if stands(again):
                if repeats.noiseless or smooth(scan):
                    return False  # nothing new, and nothing wrong
                blind = True
            else:
                metres = dragged(belief, repeats.place, again)
                blind = np.isinf(metres) or frozen(self.features, belief, scan, again)
                if not blind:
                    repeats.refer(scan, metres)
        if blind:
            self._blind += 1
            self._dark += waited
            if self._blind < len(self._lasers):  # another one has just seen something
                return False
            for one in self._lasers:  # the next scan that sees something weighs all
                one.way = np.full(2, np.inf)
            self.filter.miss(self._dark)
            self._dark = 0.0
            return False
        self._blind, self._dark, self._said = 0, 0.0, self._stamp
        far = laser.way >= np.array([self.every.metres, self.every.radians]) - 1e-9
        if not far.any() and not self.filter.watch(scan):
            return False
        self.filter.see(scan)
        laser.way = np.zeros(2)
        return True

    def _moment(self, index: int, stamp: float, looked: bool) -> Moment:
        belief, grid = self.filter.belief, self.features.grid
        best, covariance, map_odom = None, np.full((3, 3), np.nan), None
        deviation, withheld = (np.inf, np.inf), ""
        if len(belief.poses):
            pose = transform_poses(grid.origin, belief.poses[:1])[0]
            best = Pose2D(*pose)
            covariance = rotate_covariance(belief.covariance[0], grid.origin.theta)
            if self._odom is not None:
                map_odom = Pose2D(*compose_poses(pose, invert_poses(self._odom)))
            deviation = deviations_of(covariance)
        if self._blind >= len(self._lasers):  # else another laser has just seen something
            withheld = BLIND
        if belief.verdict == UNIQUE:
            if deviation[0] > self.limits.metres or deviation[1] > self.limits.radians:
                withheld = withheld or WIDE
            if withheld:
                belief = replace(belief, verdict=AMBIGUOUS)
        elif belief.verdict == AMBIGUOUS and not withheld:
            if not looked and self._stands:
                withheld = STANDING
            elif belief.mass[0] >= self._held:
                withheld = UNCONFIRMED
        age, shared = self._stamp - self._said, self.filter.options.shared
        return Moment(
            index, stamp, age, looked, self._metres, belief, withheld, best, covariance,
            deviation, map_odom, grid.diagonal,
            shared.scale, shared.thinner * grid.resolution, shared.bent,
        )  # fmt: skip


def alone_ahead(stamps: FloatArray) -> IntArray:
    """Indices of stamps (N,) that leap ahead, though the next ones go on from the one before.

    None where many do: such a log is made of two.

    Examples
    --------
    >>> alone_ahead(np.array([0.0, 0.2, 99.0, 0.6, 0.8])), alone_ahead(np.array([9.0, 9.2, 1.0]))
    (array([2]), array([], dtype=int64))
    >>> swapped, two = np.array([0.0, 2, 6, 4, 8]), np.array([9.0, 1, 9.2, 1.2, 9.4, 1.4])
    >>> len(alone_ahead(swapped)), len(alone_ahead(two))
    (0, 0)
    """
    before, after = np.append(-np.inf, stamps)[:-2], np.append(stamps, -np.inf)[2:]
    leap = (stamps[:-1] > stamps[1:] + LEAP) & (stamps[1:] >= before)
    leap &= (stamps[:-1] > after) | np.append(leap, [False] * 2)[2:]  # else it is in a wrong place
    return np.flatnonzero(leap & (leap.sum() <= max(1, _BACK * len(stamps))))


def in_order(stamps: FloatArray, odom: FloatArray) -> tuple[list[int], FloatArray] | None:
    """The order of scans of whose stamps (N,) a few go back, and stamps that do not.

    The way of the robot along the odometry (N, 3) shows whether scans or stamps are wrong: it is
    longer in the order of wrong stamps. Then the order is empty, for that of the file, and a wrong
    stamp becomes the one before. None if the clock was set back, or the log is made of two.

    Examples
    --------
    >>> x, stamps = np.arange(12.0), np.arange(12.0)
    >>> x[[5, 6]] = stamps[[5, 6]] = 6.0, 5.0
    >>> in_order(stamps, np.column_stack((x, x, 0 * x)))[0]
    [0, 1, 2, 3, 4, 6, 5, 7, 8, 9, 10, 11]
    >>> order, lifted = in_order(stamps, np.column_stack((np.sort(x), x, 0 * x))[:, [0, 0, 2]])
    >>> order, lifted[4:8].tolist()
    ([], [4.0, 6.0, 6.0, 7.0])
    >>> in_order(np.where(x > 7, x - 5.5, x), np.column_stack((x, x, 0 * x))) is None
    True
    """
    if not np.isfinite(stamps).all() or np.mean(np.diff(stamps) < 0) > _BACK:
        return None
    order = np.argsort(stamps, kind="stable")
    before, after = (
        float(np.hypot(*np.diff(p[:, :2], axis=0).T).sum()) for p in (odom, odom[order])
    )
    if after <= before + _LONGER * before:
        return order.tolist(), stamps[order]
    lifted = np.maximum.accumulate(stamps)
    return ([], lifted) if np.mean(lifted > stamps) <= _BACK else None


def back_words(stamps: FloatArray, indices: Sequence[int]) -> str:
    """Say where stamps (N,) of scans go back for the first time, and how often they do.

    Examples
    --------
    >>> back_words(np.array([976053569.80, 976053569.71, 976053570.1]), range(3))
    'the stamp of scan 1, 976053569.71, is 0.09 s before that of scan 0, 976053569.80'
    """
    back = np.flatnonzero(np.diff(stamps) < 0)
    k = int(back[0])
    first, second = stamp_words(float(stamps[k]), float(stamps[k + 1]))
    by = float(stamps[k] - stamps[k + 1])
    more = f", and so are {len(back) - 1:,} more" if len(back) > 1 else ""
    return (
        f"the stamp of scan {indices[k + 1]}, {second}, is {by:.3g} s before that of scan "
        f"{indices[k]}, {first}{more}"
    )


def stamp_words(a: float, b: float) -> tuple[str, str]:
    """Two stamps in seconds, with as many digits as distinguish them.

    Examples
    --------
    >>> stamp_words(976053569.801, 976053569.709)
    ('976053569.80', '976053569.71')
    """
    digits = next((d for d in range(2, 10) if f"{a:.{d}f}" != f"{b:.{d}f}"), 9)
    return f"{a:.{digits}f}", f"{b:.{digits}f}"


def _check_order(name: str, k: int, before: float, stamp: float) -> None:
    if abs(stamp) > _LATEST:
        raise ScanError(f"{name}: stamps[{k}]: got {stamp:g}, expected seconds")
    if stamp < before:
        last, this = stamp_words(before, stamp)
        raise ScanError(
            f"{name}: stamps[{k}]: {this} after {last}, {before - stamp:.3g} s back, expected the "
            "order of time; was the clock set back, or are these two logs? Cut the log there"
        )


def _check_way(name: str, k: int, metres: float) -> None:
    if not metres <= _FARTHEST:
        raise ScanError(
            f"{name}: odom[{k}]: it is {metres:.4g} m from the one before, expected at most "
            f"{_FARTHEST:,.0f} m; the log is damaged, cut it there"
        )


def robot_poses(scans: ScanSet) -> FloatArray | None:
    """Known poses (N, 3) of the robot, map frame; of the sensor if its mounting is unknown."""
    if scans.poses is None:
        return None
    return compose_poses(scans.poses, invert_poses(np.array([[*s.mount] for s in scans.scans])))


def with_odometry(scans: ScanSet, seed: int = 0) -> tuple[ScanSet, str]:
    """The log with odometry, and its kind: recorded, or made of the poses with noise and a bias."""
    if scans.odom is not None:
        return scans, "recorded"
    truth = robot_poses(scans)
    if truth is None:
        raise ConfigError("expected odometry, or the poses of the scans to make it of")
    odom = noisy_odometry(truth, np.random.default_rng(seed))
    return replace(scans, odom=odom), "of the poses, with noise and bias"


def start_of(
    given: str, pose: Pose2D, deviation: tuple[float, float], features: MapFeatures
) -> FloatArray:
    """A pose to start at in the grid frame, (3,).

    A ConfigError names `given` if it is no pose, or is not on the map. `deviation` has its standard
    deviations, metres and radians.
    """
    if not all(0 <= value < np.inf for value in deviation):
        raise ConfigError(f"{given}: deviation {deviation}, expected metres and radians from 0")
    if not np.isfinite([*pose]).all():
        raise ConfigError(f"{given}: got {pose}, expected finite metres and radians")
    local, grid = in_grid_frame(pose, features.grid), features.grid
    height, width = np.array(grid.occupied.shape) * grid.resolution
    if not (0 <= local.x <= width and 0 <= local.y <= height):
        raise ConfigError(
            f"{given}: {pose.x:g},{pose.y:g} is outside of the map, which has {width:.1f} x "
            f"{height:.1f} m, its lower-left corner at {grid.origin.x:g},{grid.origin.y:g}"
        )
    return np.array([local.x, local.y, local.theta])
