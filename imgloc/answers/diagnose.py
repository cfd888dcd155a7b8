"""Causes of scans that do not fit a map: tried on the scans, not guessed.

Upside down, other units, a map of another scale: each is one more answer for a few of the scans.
"""

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations

import numpy as np

from imgloc.answers.causes import Cause, Given, cause
from imgloc.answers.scanmotion import POOR, TRIED, VIEWS, agreement, scaled_better, widened
from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.scanpoints import evenly
from imgloc.io.maps import looks_drawn, looks_swapped
from imgloc.io.scanset import ScanSet
from imgloc.model import SURE, Evidence, LaserScan, Localization, Pose2D, base_of, compose, inverse
from imgloc.numbers import number
from imgloc.options import SCALES, Options, Prior, Shared, Trust
from imgloc.pipeline import localize
from imgloc.pose import difference

Said = Sequence[tuple[str, Evidence]]
"""Of each scan, the verdict and what it rests on."""
# Nats per reading; where the best pose lacks less, several places fit as they are.
_FITS: float = number("diagnose.fits")
# By how much the scales of scans differ that share one, what it differs from 1 at least, the share
# of the scans that fit nowhere with it at most, and how near to its bound it may not be known.
_NEAR, _SLIP, _NOWHERE, _BOUND = number("diagnose.scales")
# By which ranges are off, the likeliest first: millimetres, centimetres, feet; round slips of the
# resolution.
_AGREED = number("diagnose.agreed")  # metres, metres for each metre of way, degrees
# Medians above which ranges are no metres, may be millimetres, and are no centimetres; of them the
# share whose greatest is the longest one, and metres that no sensor sees.
_LONG, _ROOM, _HALL, _NEARER, _UNSEEN = number("diagnose.long")
UNITS = {"millimetres": 0.001, "centimetres": 0.01, "feet": 0.3048, "inches": 0.0254}  #: metres
# The first ones are tried together: from one to the next, scans fit with a scale between.
_FACTORS = (0.9, 1.1, 0.8, 1.25, 0.7, 1.4), (
    0.001, 0.01, 0.5, 2.0, 0.3048, 3.2808, 0.1, 10.0, 0.2, 5.0, 0.25, 4.0, 0.4, 2.5, 0.0254,
)  # fmt: skip


def is_doubtful(verdict: str, evidence: Evidence) -> bool:
    """Return whether a scan fits nowhere, or several places not well.

    Examples
    --------
    >>> is_doubtful("ambiguous", Evidence(misfit=0.1)), is_doubtful("ambiguous", Evidence(misfit=2))
    (False, True)
    """
    return verdict not in SURE or (verdict != "unique" and evidence.misfit >= _FITS)


def doubts(
    features: MapFeatures, scans: ScanSet, said: Said, options: Options,
    given: Given | None = None, log: ScanSet | None = None,
) -> list[Cause]:  # fmt: skip
    """Say what most likely keeps most of some scans from being placed, and what mends it.

    Causes are tried in the order of how much they explain: a calibration that is wrong, units that
    the readings themselves give away, too few readings, a map with black and white swapped, a prior
    that leaves the place out, a mirrored sensor or map, ranges of another scale, a map that is a
    drawing. The first one that makes a few of the scans unique is the answer.

    Parameters
    ----------
    features, options
        Those of the answers.
    scans : ScanSet
        The scans, and their odometry if there is any.
    said : sequence of (str, Evidence)
        Verdict and evidence of each scan.
    given : Given, optional
        What was stated about the scans, so that no option is advised that was given already.
    log : ScanSet, optional
        All scans of the log that they are from, by default they alone: with odometry it shows
        whether a sensor or the map is mirrored, and whether ranges or the map have another scale.

    Returns
    -------
    list of Cause
        At most one; none if at least half of the scans fit, unless they do so as in :func:`bent`.
    """
    given, bent_ = given or Given(), bent(said, options.shared, features.grid.resolution)
    if (cell := features.grid.resolution) >= 1:
        high, wide = (cells * cell for cells in features.grid.occupied.shape)
        return [cause("centimetres", wide=wide, high=high, metres=cell / 100)]
    if found_floor := tilted(said):
        return found_floor
    doubtful = [k for k, answer in enumerate(said) if is_doubtful(*answer)]
    fit = 2 * len(doubtful) <= len(scans)
    if fit and not bent_:
        return []
    some = range(len(scans)) if fit else doubtful
    misfit = float(np.median([said[k][1].misfit for k in some]))
    own, one = scans.take(some), len(scans) == 1
    trial = _Trial(features, own, options, given, one, misfit, log or scans,
                   _fitting(scans, some), common_scale(said, options.shared.scale))  # fmt: skip
    if found := trial.calibration(is_bent=bool(bent_)):
        return [found]
    # Scans that a wrong view has stretched may fit in pieces.
    bent_ = [replace(one, text=trial.asked + one.text) for one in bent_]
    if fit:
        return bent_
    counts = Counter(verdict for verdict, _ in said)
    if found := trial.units():
        return [found]
    if 2 * counts["invalid"] > len(scans):
        return [too_few(trial.scans.scans, one=trial.one)]
    if looks_swapped(features.grid):
        return [cause("swapped")]
    found = trial.view() or trial.prior() or trial.mirrored() or trial.scale()
    if found or bent_:
        return [found] if found else bent_
    if looks_drawn(features.grid):
        return [cause("plan")]
    return [trial.elsewhere()] if 2 * counts["no-match"] > len(scans) or trial.asked else []


def misread(
    features: MapFeatures, scans: ScanSet, said: Said, options: Options,
    given: Given | None = None, log: ScanSet | None = None,
) -> Cause | None:  # fmt: skip
    """Say that scans fit far better if left and right are swapped, or on another scale.

    A mirrored sensor fits a corridor, where both sides are alike, and a laser of a short view fits
    a map whose cells are 10 % too large, though walls seem to be gone. The parameters are those of
    :func:`doubts`; here most of the scans may fit as they are.
    """
    bad, known = options.fused.strained, options.shared.scale
    moved = [k for k, (_, evidence) in enumerate(said) if evidence.scale != known]
    strained = (k for k, (v, e) in enumerate(said) if is_doubtful(v, e) or e.misfit >= bad)
    doubtful = sorted({*moved, *strained})
    if not doubtful:
        return None
    # Scans that were moved to another scale show that theirs is wrong: which is right is left.
    more = _FITS if 2 * len(moved) > len(said) else 0.0
    misfit = more + float(np.median([said[k][1].misfit for k in doubtful]))
    some, given = scans.take(doubtful), given or Given()
    trial = _Trial(features, some, options, given, len(scans) == 1, misfit, log or scans,
                   _fitting(scans, doubtful), common_scale(said, known))  # fmt: skip
    return trial.mirrored() or trial.scale()


def common_scale(said: Said, known: float) -> float | None:
    """The factor on the ranges that three scans or more were found to have, each by itself.

    Fewer have another one, as on a map of another place. `known` is stated; None for no factor.

    Examples
    --------
    >>> said = [("no-match", Evidence(scale=scale)) for scale in (1.057, 1.06, 1.062, 1.0, 0.95)]
    >>> common_scale(said, 1.0), common_scale(said[1:], 1.0)
    (1.0585, None)
    """
    moved = [evidence.scale / known for _, evidence in said if evidence.scale != known]
    middle = float(np.median(moved or [1.0]))
    alike = sum(abs(scale - middle) <= _NEAR for scale in moved)
    most = alike >= TRIED and 2 * alike > len(moved)
    return middle if most and abs(middle - 1) > _SLIP else None


def _fitting(scans: ScanSet, doubtful: Sequence[int]) -> list[str]:
    """The lasers of which most scans are not doubtful, if there are several."""
    every = Counter(scan.laser for scan in scans.scans)
    doubted = Counter(scans[k].laser for k in doubtful)
    sure = [laser for laser in every if 2 * doubted[laser] < every[laser]]
    return sure if len(every) > 1 else []


@dataclass(frozen=True)
class _Trial:
    """Doubtful scans, which are tried in other ways."""

    features: MapFeatures
    scans: ScanSet
    options: Options
    given: Given
    one: bool  #: whether there is only one scan
    misfit: float  #: median of the scans as they were located, nats per reading
    log: ScanSet  #: the scans that they are from
    fitting: Sequence[str]  #: those of several lasers of which most scans fit as they are
    common: float | None  #: the factor on their ranges that most scans were found to have

    @property
    def tried(self) -> list[int]:
        """Indices of a few of the scans."""
        seeing = [k for k, scan in enumerate(self.scans.scans) if scan.directions]
        return [seeing[k] for k in evenly(len(seeing), TRIED).tolist()]

    @property
    def _others(self) -> "_Trial | None":
        """The same with the scans that were not tried, if they are as many."""
        rest = sorted({*range(len(self.scans))} - {*self.tried})
        return replace(self, scans=self.scans.take(rest)) if len(rest) >= TRIED else None

    def of(self, laser: str) -> "_Trial":
        """The same with the scans of one laser."""
        own = [k for k, scan in enumerate(self.scans.scans) if scan.laser == laser]
        return replace(self, scans=self.scans.take(own))

    @property
    def fits(self) -> str:
        return "this scan fits" if self.one else "scans like these fit"

    def unique(
        self, change: Callable[[LaserScan], LaserScan] | None = None, prior: Prior | None = None,
        shared: Shared | None = None, *, most: bool = False,
    ) -> list[Localization]:  # fmt: skip
        """Answers to a few scans that are changed, or with others of the options.

        The list is empty unless all of these scans, or `most` of them, are unique.
        """
        # Parts of a scan find a few places more, which takes longer than all the rest.
        quick = replace(self.options, fused=replace(self.options.fused, unfit=np.inf))
        quick = replace(quick, prior=prior or quick.prior, shared=shared or quick.shared)
        once = replace(quick, fused=replace(quick.fused, strained=np.inf))
        found = list[Localization]()
        for k in self.tried:
            scan = self.scans[k] if change is None else change(self.scans[k])
            found.append(localize(self.features, scan, once if shared is None else quick))
            # Most trials are in vain, and searches again for what fits badly take the longest.
            lacks = found[-1].evidence.misfit - self.options.shared.usual
            hopeful = found[-1].verdict == "unique" or lacks <= self.misfit
            if shared is None and hopeful and lacks > quick.fused.strained:
                found[-1] = localize(self.features, scan, quick)
            missed = sum(a.verdict != "unique" for a in found)
            if missed and (not most or 2 * missed >= len(self.tried)):
                return []
        return found

    def calibration(self, *, is_bent: bool) -> Cause | None:
        """The scans fit far better without what was calibrated for the map.

        If most of them fit, but only with another error than the one that was calibrated
        (`is_bent`), they are to fit without any.
        """
        used, without = self.options.shared, vars(self.given.uncalibrated)
        if not self.given.calibrated(used, keys := list(without)):
            return None

        def helps(left_out: Sequence[str]) -> bool:
            shared = replace(used, **{key: without[key] for key in left_out})
            found = self.unique(shared=shared)
            said = [(answer.verdict, answer.evidence) for answer in found]
            if is_bent:
                return bool(found) and not bent(said, shared, self.features.grid.resolution)
            fits = np.median([evidence.misfit for _, evidence in said] or [math.inf])
            return bool(self.misfit - fits >= _FITS)

        if not helps(keys):
            return None
        changed = [key for key in keys if self.given.calibrated(used, [key])]
        alone = (key for key in changed if len(changed) > 1 and helps([key]))
        wrong = [key] if (key := next(alone, "")) else changed
        return cause(
            "calibration", fits=self.fits, than="without", file=self.given.calibration,
            calibrated=self.given.calibrated(used, wrong),
        )  # fmt: skip

    def units(self) -> Cause | None:
        """Half of the ranges are longer than rooms are, or than the map: in which unit they fit."""
        longest = self.features.grid.diagonal
        middle, likely = units_of(self.scans.scans, longest)
        if not likely and middle <= longest:
            return None
        fits = (lambda s, f=f: s.scaled(f) for f in UNITS.values())
        found = (self.unique(change, most=True) for change in fits)
        fitting = ([name] for name, answers in zip(UNITS, found, strict=True) if answers)
        units = next(fitting, likely)
        beyond = "" if likely else f", but the map is {longest:.3g} m from corner to corner"
        return units_cause(middle, units, beyond, self.given.range_scale) if units else None

    def view(self) -> Cause | None:
        """The scans fit with another field of view than was stated."""
        view, misfits = self.given.view_of(self.scans[0]), dict[float, float]()
        for right in map(math.degrees, VIEWS if view else ()):
            if found := self.unique(lambda s, f=right / (view or 1): widened(s, f)):  # type: ignore[misc]
                misfits[right] = float(np.median([a.evidence.misfit for a in found]))
        lead, right = f"{self.fits} at one place ", min(misfits, key=misfits.__getitem__, default=0)
        return cause("view/stated", lead=lead, right=right, view=view) if misfits else None

    @property
    def asked(self) -> str:
        """A question for the field of view, if it was stated: it is the first suspect."""
        view = self.given.view_of(self.scans[0])
        return f"is `fov` right, {view:.4g} degrees? If so, " if view else ""

    def prior(self) -> Cause | None:
        """The scans fit elsewhere, at poses that what was given leaves out."""
        names = [f"`{name}`" for name in self.options.prior.about]
        anywhere = replace(self.options, prior=Prior())
        if names and not (found := self.unique(prior=Prior())):  # or at one of several places
            found = [localize(self.features, self.scans[k], anywhere) for k in self.tried]
            found = [a for a in found if self.misfit - a.evidence.misfit >= _FITS]
        if not names or not found or (pose := found[0].best) is None:
            return None
        asked = " and ".join(names)
        at = place_words(pose)
        where = f"at {at}" if self.one else f"at one place each, the first at {at}"
        leave, right = ("leaves", "is it") if len(names) == 1 else ("leave", "are they")
        return cause("prior", where=where, asked=asked, right=right, leave=leave)

    def mirrored(self) -> Cause | None:
        """The scans fit if left and right are swapped."""
        fits = [
            name for name in self.scans.lasers if name not in self.fitting
            and self.of(name).unique(lambda scan: scan.flipped, most=True)
        ]  # fmt: skip
        if not fits:
            return None
        if self.fitting:  # by these the map is not mirrored
            others = ",".join(name for name in self.log.lasers if name not in fits)
            return cause("two-lasers/mirrored", laser=", ".join(fits), others=others)
        agrees, odom = math.nan, self.log.odom
        if odom is not None and np.isfinite(odom).all():
            agrees = agreement(self.log, odom).share
        key = "mirrored/map" if agrees >= POOR else "mirrored"
        return cause(key, self.given, fits=self.fits)

    def scale(self) -> Cause | None:
        """The scans fit in other units, or the map has another resolution."""
        tried = (times := self._other_scale()) != 1
        if not tried and self.common is not None:
            times = self._refined(self.common)
        if times == 1:
            return None
        cells = self.features.grid.resolution / times
        nice = round(200 * cells) / 200  # of most maps it is whole half centimetres
        cells = nice if math.isclose(nice, cells, rel_tol=0.02) else cells
        better = scaled_better(self.log, times)
        key = {None: "scale", True: "scale/ranges", False: "scale/map"}[better]
        unit = next((name for name, value in UNITS.items() if value == times), None)
        why = f"are they {unit}?" if unit else "is the map's resolution right?"
        fits = f"{self.fits} at one place" if tried else "most scans fit best"
        fits, asked = self.asked + fits, times * self.given.range_scale
        return cause(key, fits=fits, times=times, why=why, factor=asked, cells=cells)

    def _refined(self, times: float) -> float:
        """A factor on the ranges that is found again from where it was: one search ends near.

        It is 1 if many scans fit nowhere with it, or it has moved: so it is on a map of another
        place. Where most scans have one place with it, it may be.
        """
        known, answers, begin = self.options.shared, list[Localization](), times
        for some in (self.tried, range(len(self.scans))):
            shared = replace(known, scale=float(np.clip(times * known.scale, *SCALES)))
            options = replace(self.options, shared=shared)
            answers = [localize(self.features, self.scans[k], options) for k in some]
            times = float(np.median([a.evidence.scale for a in answers])) / known.scale
        counts = Counter(answer.verdict for answer in answers)
        again = abs(times / begin - 1) <= _NEAR and counts["no-match"] < _NOWHERE * len(answers)
        most = self.options.fused.most_scaled
        again &= 1 / most + _BOUND < times < most - _BOUND
        return times if again or 2 * counts["unique"] > len(answers) else 1.0

    def _other_scale(self) -> float:
        """The factor on the ranges with which a few of the scans are unique; 1 if none is."""
        (near, far), shared = _FACTORS, self.options.shared
        times, least = 1.0, self.misfit - _FITS
        for factor in (*near, *far):
            if times != 1 and factor in far:
                break
            scaled, scale = partial(LaserScan.scaled, factor=factor), factor * shared.scale
            known = replace(shared, scale=np.clip(scale, *SCALES)) if factor in near else None
            found = self.unique(None if known else scaled, shared=known, most=True)
            if found and factor in far and self._others is not None:  # of many factors one may fit
                found = found if self._others.unique(scaled, most=True) else []
            lacks = float(np.median([answer.evidence.misfit for answer in found] or [np.inf]))
            if lacks <= least:
                scales = [answer.evidence.scale / shared.scale for answer in found]
                times, least = float(np.median(scales)) if known else factor, lacks
        return times

    def elsewhere(self) -> Cause:
        """Nothing helps: an old map if the scans agree about where they are, else another one."""
        none = self.asked + ("this scan does" if self.one else "most scans do")
        if (share := self._agreed()) is not None:
            return cause("old", none=none, share=share)
        names = " and ".join(f"`{name}`" for name in self.options.prior.about)
        return cause("map", none=none, also=f", with {names} or without" if names else "")

    def _agreed(self) -> float | None:
        """Share of the rays that fit, if the best poses of two scans lie as the odometry has them.

        Poses of another map do so as well as odometry.
        """
        tried, odometry = self.tried, self.scans.odom is not None
        path = self.scans.odom if odometry else self.scans.poses
        if path is None or not np.isfinite(path[tried]).all():
            return None
        quick = replace(self.options, fused=replace(self.options.fused, unfit=np.inf))
        found = list[tuple[Pose2D, Pose2D, float]]()  # where, by the map and the path; what fits
        for k in tried:
            answer, mount = localize(self.features, self.scans[k], quick), Pose2D(0.0, 0.0)
            if answer.best is not None:
                mount = (self.scans[k].T_base_laser if odometry else None) or mount
                found.append((base_of(answer.best, mount), Pose2D(*path[k]), answer.explained))
        for (a, before, one), (b, after, other) in combinations(found, 2):
            moved, there = compose(inverse(before), after), compose(inverse(a), b)
            most = _AGREED[0] + _AGREED[1] * math.hypot(moved.x, moved.y)
            off, turned = difference(there, moved)
            if off <= most and turned <= math.radians(_AGREED[2]):
                return (one + other) / 2
        return None


def bent(said: Said, known: Shared, resolution: float) -> list[Cause]:
    """Say that most scans fit a map only with an error that all readings share, and what helps.

    The list is empty if fewer than half of the scans do, or if the error is `known` already. The
    map's cells are `resolution` metres wide.

    Examples
    --------
    >>> said = [("unique", Evidence(scale=1.05))] * 2 + [("no-match", Evidence(scale=0.97))]
    >>> bent(said, Shared(), 0.05)[0].text[:67]
    'most scans fit this map far better with their ranges multiplied by '
    >>> bent(said[1:], Shared(), 0.05), bent(said, Shared(1.05), 0.05)
    ([], [])
    >>> bent([("ambiguous", Evidence(thinner=0.1, bent=0.1))], Shared(), 0.1)[0].short
    'the walls are drawn thick: imgloc track'
    """
    count, placed = len(said), [evidence for verdict, evidence in said if verdict in SURE]
    scales = [e.scale for e in placed if e.scale != known.scale]
    drawn = [(e.thinner, e.bent) for _, e in said if placed and e.bent > known.bent]
    thinner = [e.thinner for e in placed if e.thinner > 0 and known.thinner == 0 and not e.bent]
    if 2 * len(drawn) > count:
        less, off = np.median(drawn, axis=0)
        return [cause("thick", less=less, off=off)]
    if 2 * len(scales) > count:
        factor = float(np.median(scales))
        cells = f"are its cells of {resolution / factor:.4g} m? Then correct its resolution"
        found = f"their ranges multiplied by {factor:.3f}: {cells}, as poses are in its metres"
        short = f"ranges x {factor:.3f}"
    elif 2 * len(thinner) > count:
        found = short = f"walls that are {np.median(thinner):.2f} m thinner on each side"
    else:
        return []
    fits = "this scan fits" if count == 1 else "most scans fit"
    return [cause("bent", fits=fits, found=found, brief=short)]


def tilted(said: Said) -> list[Cause]:
    """Say that most scans fit only without readings that end on the floor, and what helps.

    Examples
    --------
    >>> from imgloc.model import Floor
    >>> tilted([("unique", Evidence(floor=Floor(5.0, 0.0, 0.3)))])[0].short
    'a line 5.0 m away is on no map: the floor?'
    """
    seen = [evidence.floor for _, evidence in said if evidence.floor is not None]
    if 2 * len(seen) <= len(said):
        return []
    metres, share = np.median([(floor.distance, floor.share) for floor in seen], axis=0)
    line = sum(math.isnan(floor.direction) for floor in seen) <= len(seen) / 2
    shape = "a line" if line else "a circle"
    fits = "this scan fits" if len(said) == 1 else "most scans fit"
    return [cause("floor", fits=fits, share=share, shape=shape, metres=metres)]


def bent_walls(
    found: Shared, known: Shared, resolution: float, given: Given | None = None
) -> Cause | None:
    """Say that a filter took the scans of a log for having another error than was `known`.

    If that is from a calibration file, the file is the cause.

    Examples
    --------
    >>> bent_walls(Shared(1.02), Shared(), 0.05).short
    'fits far better with ranges x 1.020: imgloc calibrate'
    """
    parts = list[str]()
    if found.scale != known.scale:
        parts.append(f"their ranges multiplied by {found.scale:.3f}")
    if found.thinner != known.thinner:
        parts.append(f"walls that are {found.thinner * resolution:.2f} m thinner on each side")
    if found.bent != known.bent:
        parts.append(f"walls that are bent by {found.bent:.2f} m")
    if not parts:
        return None
    together = " and ".join(parts)
    changed = [key for key, value in vars(known).items() if value != vars(found)[key]]
    if given is not None and (wrong := given.calibrated(known, changed)):
        than, file = f"with {together} than with", given.calibration
        return cause("calibration", fits="most scans fit", than=than, calibrated=wrong, file=file)
    if found.bent != known.bent:
        return cause("bent/walls", found=together)
    short = parts[0].replace("their ranges multiplied by", "ranges x")
    return cause("bent", fits="most scans fit", found=together, brief=short)


def place_words(pose: Pose2D) -> str:
    """A pose in words: metres and degrees."""
    return f"x {pose.x:.2f} m, y {pose.y:.2f} m, theta {math.degrees(pose.theta):.0f} degrees"


def too_few(scans: Sequence[LaserScan], *, one: bool = False) -> Cause:
    """The cause of scans that have too few readings, with what most of these are instead."""
    counts, why = few_readings(scans), "Look at range_min and range_max of the file"
    if not counts.endswith("?"):
        counts, why = f"{counts}.", why_invalid(scans)
    return cause("few", which="this scan has" if one else "most scans have", counts=counts, why=why)


def units_of(scans: Sequence[LaserScan], most: float = math.inf) -> tuple[float, list[str]]:
    """The median of the ranges, and their unit if it is so great that they are not metres.

    A room in millimetres may have the numbers of a hall in centimetres: then there are two units,
    unless the longest ranges would be longer than `most` metres, or than sensors see.

    Examples
    --------
    >>> room = LaserScan(np.linspace(0.3, 3.0, 50), np.linspace(-1, 1, 50))
    >>> [units_of([room.scaled(factor)])[1] for factor in (1, 100, 1000, 5000)]
    [[], ['centimetres'], ['millimetres', 'centimetres'], ['millimetres']]
    >>> units_of([room.scaled(1000)], 20.0)[1]
    ['millimetres']
    """
    ranges = np.concatenate([scan.ranges for scan in scans[:100]])
    known = ranges[np.isfinite(ranges) & (ranges > 0)]
    middle = float(np.median(known)) if len(known) else 0.0
    if middle <= _LONG / (2 if (known == np.rint(known)).all() else 1):  # no metres are whole
        return middle, []
    longest = np.quantile(np.unique(known), _NEARER, method="lower")  # the greatest may be a code
    hall = middle <= _HALL and UNITS["centimetres"] * longest <= min(most, _UNSEEN)
    return middle, list(UNITS)[middle <= _ROOM : 1 + hall] or list(UNITS)[:1]


def units_cause(middle: float, units: Sequence[str], beyond: str = "", scale: float = 1) -> Cause:
    """The cause that ranges, which were multiplied by `scale`, are in one or two other units."""
    one, other = UNITS[units[0]] * scale, UNITS[units[-1]] * scale
    key, about = ("units", "units/either")[len(units) > 1], {"middle": middle, "beyond": beyond}
    return cause(key, None, unit=units[0], factor=one, other=other, **about)


def why_invalid(scans: Sequence[LaserScan]) -> str:
    """Why scans have too few directions with a valid reading: a sentence for each cause.

    Examples
    --------
    >>> why_invalid([LaserScan(np.ones(5), np.arange(5.0), range_max=9.0)])
    'Each scan has 5 rays; it takes valid readings in 10 directions or more'
    >>> why_invalid([LaserScan(np.ones(50), np.zeros(50), range_max=9.0)])
    'All rays point in 1 direction(s): is angle_increment right?'
    """
    least = Trust().readings
    rays, valid, directions = (
        int(np.median([count(scan) for scan in scans]))
        for count in (lambda s: len(s.ranges), lambda s: s.counts["valid"], lambda s: s.directions)
    )
    if rays < least:
        return f"Each scan has {rays} rays; it takes valid readings in {least} directions or more"
    if valid >= least:
        return f"All rays point in {directions} direction(s): is angle_increment right?"
    ranges = np.concatenate([scan.ranges for scan in scans])
    low, high = np.median([(scan.range_min, scan.range_max) for scan in scans], axis=0)
    causes = {
        "Most readings are 0, which drivers write where the sensor sees nothing": ranges == 0,
        "Most readings are NaN: the driver calls them invalid": np.isnan(ranges),
        f"Most readings are nearer than range_min, {low:g} m: is it right?": ranges <= low,
        f"Most rays met nothing within range_max, {high:g} m: is it right, and is the sensor free "
        "to see?": ranges >= high,
    }
    few = f"It takes valid readings in {least} directions or more; a scan has {valid}"
    return next((text for text, which in causes.items() if 2 * which.sum() > which.size), few)


def few_readings(scans: Sequence[LaserScan]) -> str:
    """Readings of scans that have too few of them: probably millimetres, or their counts.

    Examples
    --------
    >>> few_readings([LaserScan([np.nan, 20.0, 3.0], [0.0, 1.0, 2.0], range_max=10.0)])
    'of 3 readings 1 valid, 1 no return, 0 too close, 1 nan'
    """
    (middle, units), limit = units_of(scans), max(scan.range_max for scan in scans)
    if units and middle > limit:
        found = f"most ranges are far beyond range_max (half are above {middle:g}, range_max is "
        return f"{found}{limit:g}): are they {' or '.join(units)}?"
    total = {key: sum(scan.counts[key] for scan in scans) for key in scans[0].counts}
    unused = ", ".join(f"{n:,} {key.replace('_', ' ')}" for key, n in total.items())
    return f"of {sum(total.values()):,} readings {unused}"
