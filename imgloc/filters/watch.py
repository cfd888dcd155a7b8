"""A second opinion of the poses that another localizer gives: agrees, disagrees, or undecided.

It holds each pose against a filter of its own that never hears of it, and while that filter is not
sure against one scan on the whole map. It changes nothing.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from imgloc.features.mapfeatures import MapFeatures
from imgloc.filters.belief import UNIQUE
from imgloc.filters.evidence import Sight, settled, sight, usable, view_of
from imgloc.filters.follow import BLIND, Moment
from imgloc.filters.tracker import TrackerOptions
from imgloc.geometry import in_grid_frame, pose_errors
from imgloc.model import LaserScan, Pose2D, base_of, compose, inverse, plain
from imgloc.numbers import number
from imgloc.options import Options, Trust
from imgloc.pipeline import localize

AGREES, DISAGREES, CANNOT = ("agrees", "disagrees", "cannot tell")
_NEAR: tuple[float, float] = number("watch.near")
_EACH: float = number("watch.each")
_LOOKS: tuple[int, int] = number("watch.looks")
# Metres without a pose, in which the own filter would be sure of one; nats of a pose that is sure.
_SILENT, _ = TrackerOptions.sure
_LEAD = math.log(Trust.mass) - math.log1p(-Trust.mass)


@dataclass(frozen=True)
class Opinion:
    """Opinion of the other localizer's pose."""

    said: str = CANNOT  #: ``agrees``, ``disagrees`` or ``cannot tell``
    why: str = "no pose has come yet"
    pose: Pose2D | None = None  #: that it would give, of the base, map frame; None if not sure
    since: float = float("nan")  #: stamp from which it is said, seconds

    def row(self, now: float) -> dict[str, Any]:
        """Plain values for JSON; `now`, seconds, is for the time since."""
        names = ("said", "why", "pose", "since")
        return dict(plain({n: getattr(self, n) for n in names} | {"seconds": now - self.since}))

    @property
    def text(self) -> str:
        """It in a sentence."""
        return f"{self.said}: {self.why}"


class Watch:
    """Compares poses with scans along a way.

    Parameters
    ----------
    features : MapFeatures
    options : Options

    Examples
    --------
    >>> import imgloc
    >>> from imgloc.io.maps import bundled_maps
    >>> features = imgloc.prepare(imgloc.load_map(bundled_maps() / "curved.yaml"))
    >>> scans, robot = imgloc.simulate(features.grid, 1, seed=1), imgloc.Tracking()
    >>> moment = robot.follower(features, imgloc.Options()).step(scans[0], None)
    >>> watch, true = Watch(features, imgloc.Options()), Pose2D(*scans.poses[0])
    >>> watch.hear(0.0, true, None)
    >>> watch.step(scans[0], None, moment).said
    'agrees'
    >>> watch.hear(1.0, Pose2D(true.x + 2, true.y), None)
    >>> opinions = [watch.step(scans[0], None, moment, stamp) for stamp in (1.0, 2.0)]
    >>> [opinion.said == DISAGREES for opinion in opinions]
    [False, True]
    """

    def __init__(self, features: MapFeatures, options: Options) -> None:
        self.features, self.options = features, options
        self._walls = features.thinner(options.shared.thinner)
        self.opinion = Opinion()
        self._claim: tuple[float, Pose2D, Pose2D | None] | None = None
        self._against = 0  # looks in a row that are against it
        self._looked = -np.inf  # stamp of the last look at one scan alone
        # Of each laser: the misfit at the pose before it leapt, nats per reading, when it did, and
        # the mass that the own filter gave the place then.
        self._fitted = dict[str, tuple[float, float, float]]()

    def hear(self, stamp: float, pose: Pose2D, odom: Pose2D | None) -> None:
        """Take a pose of the base, map frame, with its stamp and the odometry of that time."""
        self._claim = stamp, pose, odom

    def step(
        self, scan: LaserScan, odom: Pose2D | None, moment: Moment, stamp: float | None = None
    ) -> Opinion:
        """Compare the last pose with a scan, and with what the own filter believes after it."""
        stamp = moment.stamp if stamp is None else stamp
        stamp = 0.0 if np.isnan(stamp) else stamp
        judged = self._judge(scan, odom, moment, stamp)
        if judged is None:
            return self.opinion
        said, why, pose = judged
        self._against = self._against + 1 if said == DISAGREES else 0
        if 0 < self._against < _LOOKS[0]:
            said, why, pose = CANNOT, f"once: {why}", None
        since = self.opinion.since if said == self.opinion.said else stamp
        self.opinion = Opinion(said, why, pose, since)
        return self.opinion

    def _judge(
        self, scan: LaserScan, odom: Pose2D | None, moment: Moment, stamp: float
    ) -> tuple[str, str, Pose2D | None] | None:
        """Opinion, why, and the own pose; None if nothing new can be said."""
        if self._claim is None:
            return CANNOT, Opinion().why, None
        _, claim, then = self._claim
        if odom is not None and then is not None:
            way = compose(inverse(then), odom)
            claim = compose(claim, way)
            if (metres := float(np.hypot(way.x, way.y))) > _SILENT:
                return DISAGREES, f"no pose has come for {metres:.1f} m", moment.pose
        seen = self._seen(scan, base := in_grid_frame(claim, self.features.grid))
        near = (pose_errors(moment.belief.poses, base) <= _NEAR).all(axis=1)
        held = float(moment.belief.mass[near].sum())
        suddenly = self._misfit_leapt(scan.laser, seen, stamp, held)
        late = suddenly > _LOOKS[1] * _EACH
        if moment.belief.verdict == UNIQUE and moment.best is not None:
            judged = self._beside(claim, moment.best, scan)
            if late and judged[0] == AGREES:  # after so many scans it is things that differ
                self._fitted.pop(scan.laser, None)
            return judged
        if moment.withheld == BLIND or seen is None:
            return CANNOT, "the scans say nothing", None
        if stamp < self._looked + _EACH:  # one look is dear, and the next scan is hardly another
            return None
        self._looked = stamp
        answer = localize(self.features, scan, self.options)
        if answer.verdict == UNIQUE:
            return self._beside(claim, base_of(answer.hypotheses[0].pose, scan.mount), scan)
        if late:
            return DISAGREES, f"for {suddenly:.1f} s scans suddenly do not fit there", None
        if held > 1 - Trust.mass:  # one scan alone outweighs no place that holds
            return CANNOT, f"the scans before give it {held:.2f}, and this one fits no place", None
        # Looks at one place see the same things: each has to be as sure as all of them together.
        if seen.gained > -_LOOKS[0] * _LEAD:
            return CANNOT, "several places fit, or the scan says little", None
        odds = np.exp(-seen.gained)
        return DISAGREES, f"the scan is {odds:.3g} times as likely in no place", None

    def _seen(self, scan: LaserScan, base: Pose2D) -> Sight | None:
        """Fit of a scan at a pose, grid frame, or close by; None if the scan is blind."""
        if (used := usable(scan, self.options)) is None:
            return None
        view = view_of(used, self.options)
        at = settled(self._walls, view, np.array([[*base]]))
        return sight(self._walls, view, at, self.options)

    def _misfit_leapt(self, laser: str, seen: Sight | None, stamp: float, held: float) -> float:
        """Seconds for which scans have fitted far worse at a pose than just before; 0 if not.

        A changed place fits worse step by step, another place at once. Where scans fitted badly
        before, this means nothing; nor once the own filter gives the place more mass, `held`, than
        after the first of them: then these scans speak for it.
        """
        how, nothing = TrackerOptions(), (np.nan, stamp, np.nan)
        fitted, since, then = self._fitted.pop(laser, nothing)
        if seen is None:
            return 0.0
        leapt = fitted <= how.fits[1] and seen.misfit[0] > fitted + how.surprise[1]
        if not leapt or held > then:
            fitted, since, then = float(seen.misfit[0]), stamp, np.nan
        elif np.isnan(then):
            then = held
        self._fitted[laser] = fitted, since, then
        return stamp - since

    def _beside(
        self, claim: Pose2D, own: Pose2D, scan: LaserScan
    ) -> tuple[str, str, Pose2D | None]:
        metres, turned = apart = pose_errors(np.array([*claim]), own)
        words = f"{metres:.2f} m and {np.rad2deg(turned):.0f} deg apart"
        if (apart <= _NEAR).all():
            return AGREES, words, own
        # Among things on no map the own filter may be off itself by so little, and be sure.
        close = (apart <= 2 * np.array(_NEAR)).all()
        if close and (used := usable(scan, self.options)) is not None:
            both = np.array([[*in_grid_frame(pose, self.features.grid)] for pose in (own, claim)])
            view = view_of(used, self.options)
            mine, other = sight(self._walls, view, both, self.options).log_likelihood
            if mine - other < _LEAD:
                return CANNOT, f"{words}, and the scan fits both", None
        return DISAGREES, words, own
