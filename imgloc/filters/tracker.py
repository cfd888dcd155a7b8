"""The hypothesis tracker: the modes of one scan, carried by odometry, judged by every scan.

The belief is a mixture of some dozens of Gaussians, and the chance of being **lost**, at none of
them. Odometry moves the Gaussians (the integral of eq. 1). A scan scores each of them at its own
place, whether or not a search would have found it there, and what the search finds besides is where
the lost mass goes: sensor resetting without particles. The mass of being lost grows by a small
leak, and by what a scan leaves unexplained at every place that is followed.

Scans that are taken close to each other see the same walls, with the same errors of the map: the
evidence of a scan counts in proportion to the way since the last one.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from imgloc.features.mapfeatures import MapFeatures
from imgloc.filters.belief import AMBIGUOUS, LOST, NOWHERE, UNIQUE, Belief, Habit, Habits
from imgloc.filters.evidence import (
    NO_PLACES,
    Places,
    Sight,
    View,
    misfit_at,
    misfit_near,
    search,
    settled,
    sight,
    stretched,
    usable,
    view_of,
)
from imgloc.filters.motion import MotionNoise, move_gaussians, way_of
from imgloc.geometry import wrap
from imgloc.model import FloatArray, IntArray, LaserScan
from imgloc.options import Options
from imgloc.search.hypotheses import masses, separated

_SURE = 1e5  # odds of being lost, at most
_MAPPED = 1.1  # log-odds of a scan being of its map, and found, where trust was fitted: 3 in 4
_MOST = 3.0  # nats that being lost can gain by one scan
_NOTHING, _RESET = 1e-7, 0.2  # mass of a component that is dropped; put in at once: a reset

Search = Callable[[LaserScan], Places]


@dataclass(frozen=True)
class TrackerOptions:
    """What a tracker makes of scans and odometry."""

    noise: MotionNoise = field(default_factory=MotionNoise)
    components: int = 40  #: at most
    births: int = 15  #: modes of one scan that may become components
    #: metres and radians of motion after which a scan says something entirely new
    fresh: tuple[float, float] = (3.0, 1.5)
    least: float = 0.1  #: share of a scan's evidence that counts without any motion
    drop: float = 8.0  #: nats that one scan can take from a component, at most
    #: chance of being carried off: for each scan's worth of motion, and where the best component
    #: fits abruptly worse than in the scan before. A place that has changed is approached.
    leak: tuple[float, float] = (0.0001, 0.02)
    patience: float = 0.6  #: odds of being lost that one scan can lead to, at most
    #: of the map, as far as scans share it: standard deviations, metres and radians
    error: tuple[float, float] = (0.03, 0.006)
    gate: float = 12.0  #: squared Mahalanobis distance up to which a pose may be a component's
    #: components nearer than this are one, metres and radians
    merge: tuple[float, float] = (0.3, 0.15)
    mass: float = 0.99  #: of the best component, to be ``unique``
    #: metres that it has to be followed for before it is: at first, and where it replaces another
    sure: tuple[float, float] = (1.5, 4.0)
    #: scans in a row that have to leave it so much, and readings that each needs to count
    agree: tuple[int, int] = (2, 30)
    #: metres between two searches while what is followed fits as usual: other places are then only
    #: looked at where they are followed. At first, and most; twice as far after each search that
    #: left the best component unique
    search: tuple[float, float] = (1.5, 6.0)
    known: float = 0.01  #: chance of being lost, at most, for that
    #: nats per reading that the best component may lack more than usual to stay ``unique``, and
    #: more than in the scan before to be no surprise
    surprise: tuple[float, float] = (0.5, 0.7)
    startle: float = 0.5  #: share of its evidence that a surprising scan has at least
    #: so many scans that fit best at another scale, by this logarithm in the median, and gain so
    #: many nats together, are given it: none of the logs that these filters were made with does
    stretch: tuple[int, float, float] = (6, 0.015, 150.0)
    resets: bool = True  #: whether lost mass is put where scans find places: sensor resetting


class Tracker:
    """A mixture of Gaussians over poses of the robot, grid frame; see :class:`Filter`.

    Parameters
    ----------
    features : MapFeatures
    options : Options, optional
        Of the search in each scan.
    how : TrackerOptions, optional
    find : callable, optional
        Gives the places that a scan allows, instead of a search.

    Examples
    --------
    >>> import imgloc
    >>> from imgloc.io.maps import bundled_maps
    >>> features = imgloc.prepare(imgloc.load_map(bundled_maps() / "curved.yaml"))
    >>> tracker = Tracker(features)
    >>> tracker.belief.verdict
    'lost'
    >>> tracker.see(imgloc.simulate(features.grid, 1, seed=1)[0])
    >>> len(tracker.belief.poses) > 0
    True
    """

    def __init__(
        self,
        features: MapFeatures,
        options: Options | None = None,
        how: TrackerOptions | None = None,
        find: Search | None = None,
    ) -> None:
        self.how = how or TrackerOptions()
        self.options = replace(options or Options(), top=1000)  # covariances of all
        self.features = features.thinner(self.options.shared.thinner)
        self._find = find or (lambda scan: search(self.features, scan, self.options))
        self._poses, self._covariance = NOWHERE.poses, NOWHERE.covariance
        self._mass, self._followed = np.empty(0), np.empty(0)
        self._lost, self._resets, self._agreed = 1.0, 0, 0
        self._unsearched, self._pause = 0.0, self.how.search[0]  # metres
        self._habits, self._scales = Habits(), list[tuple[float, float]]()

    def place(self, pose: FloatArray, deviation: tuple[float, float]) -> None:
        """Believe to be at a pose (3,), with deviations in metres and radians."""
        metres, radians = deviation
        self._poses = np.asarray(pose, dtype=np.float64).reshape(1, 3)
        self._covariance = np.diag([metres, metres, radians])[None] ** 2
        self._mass, self._followed, self._lost = np.ones(1), np.zeros(1), 0.0
        self._agreed = self.how.agree[0] - 1  # one scan has to agree with what was told
        self._habits.place()

    def move(self, increment: FloatArray) -> None:
        """Take a motion (3,) of the robot, in its frame before."""
        self._poses, self._covariance = move_gaussians(
            self._poses, self._covariance, increment, self.how.noise
        )
        self._habits.move(increment)
        metres = float(way_of(increment)[0])
        self._unsearched += metres
        self._followed = self._followed + metres

    def watch(self, scan: LaserScan) -> bool:
        """Whether a scan that is not to be looked at contradicts what is believed: look at it."""
        seen = usable(scan, self.options)
        if seen is None or not len(self._poses):
            return False
        return self._contradicted(view_of(seen, self.options), self._habits.of(seen))

    def _contradicted(self, view: View, habit: Habit) -> bool:
        """Whether the best component fits abruptly worse than before."""
        best = int(np.argmax(self._mass))
        at = slice(best, best + 1)
        misfit = misfit_near(
            self.features, view, self._poses[at], self.options, self._covariance[at]
        )
        if misfit > habit.last + self.how.surprise[1]:
            return True
        habit.last, habit.doubted = misfit, misfit > habit.usual + self.how.surprise[0]
        return False

    def see(self, scan: LaserScan) -> None:
        """Take a scan; one with too few readings says nothing."""
        seen = usable(scan, self.options)
        if seen is not None:
            self._see(seen)

    def _see(self, scan: LaserScan) -> None:
        how, known = self.how, len(self._poses)
        habit, view, found = self._habits.of(scan), view_of(scan, self.options), NO_PLACES
        new, habit.way = float(np.clip((habit.way / how.fresh).sum(), how.least, 1)), np.zeros(2)
        contradicted = known > 0 and self._contradicted(view, habit)
        strange = contradicted or self._habits.doubted or self._lost > how.known
        if strange or self._unsearched >= self._pause:
            found, self._unsearched = self._find(scan).best(2 * how.births), 0.0
            sure = not strange and self.belief.verdict == UNIQUE
            self._pause = min(2 * self._pause, how.search[1]) if sure else how.search[0]
        near = settled(self.features, view, self._poses, self._covariance)
        poses = np.concatenate((self._poses, near, view.robot(found.poses)))
        spread = np.concatenate((np.zeros((2 * known, 3, 3)), found.spread))
        if not len(poses):
            self._lost = 1.0
            return
        seen = sight(self.features, view, poses, self.options, spread)
        best = float(seen.log_likelihood.max())
        relative = np.maximum((seen.log_likelihood - best) * new, -how.drop)

        # Each component where it is, where it settles, or at a mode that may be it.
        at, gain = self._follow(seen, relative, new)
        leak = how.leak[0] * new
        if known:
            leader = float(seen.misfit[at[np.argmax(self._mass)]])
            if leader > habit.last + how.surprise[1]:
                leak, new = how.leak[1], max(new, how.startle)
                relative = np.maximum((seen.log_likelihood - best) * new, -how.drop)
                at, gain = self._follow(seen, relative, new)
            habit.doubted = leader > habit.usual + how.surprise[0]
        lost = self._lost + leak * (1 - self._lost)
        mass = self._mass * np.exp(gain)
        if known:
            mass *= (1 - lost) / self._mass.sum()
            gained = seen.gained - best + float(seen.log_likelihood[at].max())
            gone = lost * float(np.exp(new * min(_MOST, self._doubt(gained))))
            # Somebody may stand in the way once: a second scan has to agree, unless this one is
            # trusted to tell on its own where it is from.
            told = self._told(seen, 2 * known) if how.resets else 0.0
            odds = max(how.patience, told, np.exp(_MOST) * lost / (1 - lost))
            lost = min(gone, odds * float(mass.sum()))
        self._mass, self._lost = mass, lost
        self._settle(seen, at)
        self._normalise()
        if how.resets or not known:
            self._bear(seen, 2 * known, relative)
        self._tidy()
        agrees = (self._mass[:1] >= how.mass).any()
        self._agreed = self._agreed + (len(view.readings) >= how.agree[1]) if agrees else 0
        if len(self._mass):
            habit.learn(misfit_at(self.features, view, self._poses[:1], self.options))
            alone = self._lost < 0.5 and self._mass[0] >= how.mass * self._mass.sum()
            if alone and habit.last > self.options.fused.strained:
                self._stretch(view)

    def _stretch(self, view: View) -> None:
        """Allow for another scale of the readings, once some scans together fit far better so."""
        (count, least, gain), shared = self.how.stretch, self.options.shared
        self._scales.append(stretched(self.features, view, self._poses[0], self.options))
        scales, gains = np.array(self._scales[-count:]).T
        middle, most = float(np.median(scales)), np.log(self.options.fused.most_scaled)
        if len(gains) == count and gains.sum() > gain and least < abs(np.log(middle)) < most:
            shared = replace(shared, scale=shared.scale * middle)
            self.options, self._scales = replace(self.options, shared=shared), []

    def _doubt(self, gained: float) -> float:
        """How much likelier a scan is somewhere unknown than where it gains so much, nats.

        What a single scan is trusted by, without what was known before of the cases that is from.
        """
        elsewhere = self.options.trust.mass_elsewhere(gained, 1.0)
        return float(np.log(elsewhere / (1 - elsewhere))) + _MAPPED

    def _told(self, seen: Sight, first: int) -> float:
        """Odds of the places from the index `first` on, by a single scan; capped as doubt is."""
        log = seen.log_likelihood
        if first == len(log):
            return 0.0
        share = masses(log[first:], 1.0).max()
        gained = seen.gained - float(log.max() - log[first:].max())
        elsewhere = self.options.trust.mass_elsewhere(gained, float(share))
        return min(float(np.exp(_MOST)), (1 - elsewhere) / elsewhere)

    def _follow(self, seen: Sight, relative: FloatArray, new: float) -> tuple[IntArray, FloatArray]:
        """For each component the pose that it is at, and what it gains there, nats."""
        known = len(self._poses)
        apart = seen.poses - self._poses[:, None]
        apart[..., 2] = wrap(apart[..., 2])
        spread = self._covariance[:, None] + self._noise(seen)
        square = np.einsum("mci,mcij,mcj->mc", apart, np.linalg.inv(spread), apart)
        index = np.arange(known)
        square[index, index] = 0.0
        own = np.zeros(square.shape, np.bool_)
        own[index, index] = own[index, known + index] = own[:, 2 * known :] = True
        fit = np.where(own & (square < self.how.gate), seen.log_likelihood - square / 2, -np.inf)
        at = np.argmax(fit, axis=1)
        return at, np.maximum(relative[at] - new * square[index, at] / 2, -self.how.drop)

    def _noise(self, seen: Sight) -> FloatArray:
        metres, radians = self.how.error
        return np.asarray(seen.covariance + np.diag([metres, metres, radians]) ** 2)

    def _settle(self, seen: Sight, at: IntArray) -> None:
        """Kalman's update of the components by the poses they are at, if those are others."""
        P, R = self._covariance, self._noise(seen)[at]
        apart = seen.poses[at] - self._poses
        apart[:, 2] = wrap(apart[:, 2])
        gain = P @ np.linalg.inv(P + R)
        gain[at == np.arange(len(at))] = 0.0  # nothing was found but what was predicted
        self._poses = self._poses + (gain @ apart[..., None])[..., 0]
        self._poses[:, 2] = wrap(self._poses[:, 2])
        P = P - gain @ P
        self._covariance = (P + P.transpose(0, 2, 1)) / 2

    def _bear(self, seen: Sight, first: int, relative: FloatArray) -> None:
        """Put the lost mass where the scan fits: the poses from the index `first` on."""
        new, trust = np.arange(first, len(seen.poses)), self.options.trust
        if not len(new):
            return
        share = np.exp(relative[new])
        share /= share.sum()
        elsewhere = trust.mass_elsewhere(seen.gained, float(share.max()))
        given = self._lost * (1 - elsewhere)
        if given < _NOTHING:
            return
        self._resets += bool(len(self._poses)) and given > _RESET
        new, share = new[: self.how.births], share[: self.how.births]
        self._poses = np.concatenate((self._poses, seen.poses[new]))
        self._covariance = np.concatenate((self._covariance, self._noise(seen)[new]))
        self._mass = np.concatenate((self._mass, given * share))
        first_sure, again = self.how.sure
        ahead = first_sure - again if len(self._followed) else 0.0
        self._followed = np.concatenate((self._followed, np.full(len(new), ahead)))
        self._lost -= given * float(share.sum())

    def _normalise(self) -> None:
        if len(self._mass):  # so sure of being lost that nothing is left is never
            self._lost = min(self._lost, _SURE * float(self._mass.sum()))
        whole = self._lost + self._mass.sum()
        self._mass, self._lost = self._mass / whole, self._lost / whole

    def _tidy(self) -> None:
        """Join what has met, drop what is nothing, best first."""
        order = np.argsort(-self._mass, kind="stable")
        distance, angle = self.how.merge
        picked, owner = separated(
            self._poses[order], self.how.components, distance=distance, angle=angle
        )
        mass = np.bincount(owner[owner >= 0], self._mass[order][owner >= 0], len(picked)).astype(
            np.float64
        )
        kept = order[picked]
        followed = self._followed[order]
        longest = np.zeros(len(picked))
        np.maximum.at(longest, owner[owner >= 0], followed[owner >= 0])
        some = mass > _NOTHING
        some[:1] |= not self.how.resets
        self._poses, self._covariance = self._poses[kept[some]], self._covariance[kept[some]]
        self._mass, self._followed = mass[some], longest[some]
        self._normalise()

    @property
    def belief(self) -> Belief:
        """What is believed now."""
        order = np.argsort(-self._mass, kind="stable")
        mass = self._mass[order]
        verdict = AMBIGUOUS
        if self._lost > 0.5 or not len(mass):
            verdict = LOST
        elif not self._habits.doubted and self._agreed >= self.how.agree[0]:
            verdict = UNIQUE if self._followed[order[0]] >= self.how.sure[0] else AMBIGUOUS
        neff = float(np.square(mass.sum()) / max(1e-300, np.square(mass).sum()))
        return Belief(
            self._poses[order], mass, self._covariance[order], self._lost, verdict, neff,
            self._resets,
        )  # fmt: skip
