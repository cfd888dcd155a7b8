"""The hypothesis tracker: the modes of one scan, carried by odometry, judged by every scan.

The belief is a mixture of some dozens of Gaussians, and the probability of being **lost**, at none
of them. Odometry moves the Gaussians (the integral of eq. 1). A scan scores each Gaussian at its
own place, even if a search would not find that place. Other places that the search finds take the
lost mass: sensor resetting without particles. The lost mass grows by a small leak with each scan.
It grows more if a scan fits badly at every place that is followed.

Scans that are taken close to each other see the same walls, with the same errors of the map. The
evidence of a scan therefore counts in proportion to the way since the last scan.
"""

from collections.abc import Callable, Generator
from dataclasses import dataclass, field, replace

import numpy as np

from imgloc.features.mapfeatures import MapFeatures
from imgloc.filters.belief import AMBIGUOUS, LOST, NOWHERE, UNIQUE, Belief
from imgloc.filters.evidence import (
    DEVIATION,
    GATE,
    NO_PLACES,
    Places,
    Sight,
    View,
    misfit_at,
    search_by_steps,
    settled,
    sight,
    squares,
    usable,
    view_of,
)
from imgloc.filters.motion import MotionNoise, Way, compose_poses, move_gaussians, way_of
from imgloc.geometry import pose_errors, wrap
from imgloc.model import BoolArray, FloatArray, IntArray, LaserScan
from imgloc.numbers import number
from imgloc.options import (
    Bending,
    Count,
    Factor,
    Length,
    LogOdds,
    Metres,
    Nats,
    Options,
    Radians,
    Share,
    Shared,
    Step,
)
from imgloc.ranges import Checked
from imgloc.robot.lasers import Laser, Lasers
from imgloc.search.adapt import (
    BENT,
    Told,
    drawn_gain,
    drawn_walls,
    image_gain,
    judged,
    told_by,
)
from imgloc.search.hypotheses import masses, separated
from imgloc.search.weigh import MODES

_MOST: float = number("tracker.most")  # nats that being lost can gain by one scan

Search = Callable[[LaserScan], Places]


@dataclass(frozen=True)
class TrackerOptions(Checked):
    """Settings of the tracker."""

    noise: MotionNoise = field(default_factory=MotionNoise)
    #: metres and radians of motion after which all of a scan's evidence is new. A ``unique``
    #: component with which no scan has agreed for so many metres is so no longer.
    fresh: tuple[Length, Step] = number("TrackerOptions.fresh")
    #: factor on `fresh` on bent walls, where scans share the errors of more pieces of wall, unless
    #: the robot was given a pose at the start
    blurred: Factor = number("TrackerOptions.blurred")
    #: share of a scan's evidence that counts without any motion
    least: Share = number("TrackerOptions.least")
    #: probability that the robot is carried off during one scan's worth of motion: usually, and if
    #: the best component fits abruptly worse than in the scan before. A changed place fits worse
    #: step by step, because the robot drives up to it. One scan takes no more nats from a component
    #: than the first one is worth: somebody may stand in the way.
    leak: tuple[Share, Share] = number("TrackerOptions.leak")
    #: standard deviations of the map's error that all scans share, metres and radians
    error: tuple[Metres, Radians] = number("TrackerOptions.error")
    #: components nearer than this, metres and radians, are joined
    merge: tuple[Metres, Radians] = number("TrackerOptions.merge")
    #: least mass of a ``unique`` component: usually, and on bent walls, where scans share errors
    mass: tuple[Share, Share] = number("TrackerOptions.mass")
    #: metres for which a component must be followed before it is ``unique``: the first one, and one
    #: that replaces another
    sure: tuple[Metres, Metres] = number("TrackerOptions.sure")
    #: scans in a row that must leave a component the mass to be ``unique``, and readings that each
    #: needs. After the first one a scan is weighed once more than `least` of its evidence is new.
    agree: tuple[Count, Count] = number("TrackerOptions.agree")
    #: scans in a row that must agree if the last ``unique`` pose was at another place, because a
    #: building that repeats fits for some metres at the wrong bay
    again: Count = number("TrackerOptions.again")
    #: distance from which a pose is at another place: metres, and metres for each metre driven. So
    #: many metres and seconds without sight, added, change nothing: scans are lost now and then.
    elsewhere: tuple[Metres, Share] = number("TrackerOptions.elsewhere")
    #: metres between two searches of the whole map while the best component is unique: the first
    #: distance, and the greatest. It doubles after each search that leaves it unique. Between
    #: searches only the components are scored. While none is unique, each scan that weighs is
    #: searched, and scans at the first distance tell of the walls.
    search: tuple[Metres, Metres] = number("TrackerOptions.search")
    #: metres from the scan of a search to the scan that scores its places, if the best component
    #: was unique when the search began. Each scan between them does one step of the search.
    later: Metres = number("TrackerOptions.later")
    #: nats per reading by which the misfit may exceed the usual one for the best component to stay
    #: ``unique``, and that of the scan before for the scan to be no surprise
    surprise: tuple[Nats, Nats] = number("TrackerOptions.surprise")
    #: least share of a surprising scan's evidence that counts
    startle: Share = number("TrackerOptions.startle")
    #: odometry may turn out worse than `noise`: weight of one scan in the running estimate of its
    #: variance, and the largest factor on the variance
    learn: tuple[Share, Factor] = number("TrackerOptions.learn")
    #: probability that the robot was carried off: for each second without sight, at most for all
    #: such seconds, and after a sudden error of odometry, which may be the next bay of a building
    #: that repeats
    dark: tuple[Share, Share, Share] = number("TrackerOptions.dark")
    #: number of scans that tell together whether the walls are drawn too thick, or bent, or the
    #: readings have another scale; and metres with unique poses after which walls are not bent
    walls: tuple[Count, Metres] = number("TrackerOptions.walls")
    #: score on bent walls: they stop no reading, and all readings count alike, because scans of
    #: many places are weighed together
    bending: Bending = field(default_factory=lambda: Bending(*number("TrackerOptions.bending")))
    #: temperature, strain and elsewhere of :class:`~imgloc.options.Trust` on bent walls, where
    #: readings count, not things
    readings: tuple[Factor, Factor, LogOdds, LogOdds, LogOdds] = number("TrackerOptions.readings")
    #: metres over which the share of the way is averaged along which scans agree with one place,
    #: and the least share with which a component is ``unique``. On the map of another building a
    #: place fits for some metres now and then.
    explained: tuple[Metres, Share] = number("TrackerOptions.explained")
    #: a scan that agrees with no place alone is explained if the probability of being lost, and the
    #: nats that each reading lacks at the best place, are less than these; walls as drawn also
    #: explain one that lacks more, where a building on no map explains it worse
    fits: tuple[Share, Nats] = number("TrackerOptions.fits")


# Mass below which a component is dropped: so that a place can recover, the odds of being lost are
# at most its inverse.
_NOTHING = 1 - TrackerOptions.mass[1]


class _Search:
    """A search of the map for one scan, done step by step while the robot drives on."""

    def __init__(self, steps: Generator[None, None, Places], view: View) -> None:
        self._steps, self._view = steps, view
        self._way = np.zeros(3)  # pose of the robot now, in its frame at the scan
        self._found: Places | None = None
        self.metres = 0.0  #: driven since the scan

    def move(self, increment: FloatArray) -> None:
        """Add a motion (3,) of the robot, in its earlier frame: m, m, radians."""
        self._way = compose_poses(self._way, increment)
        self.metres += float(way_of(increment)[0])

    def step(self) -> None:
        """Do one step."""
        try:
            if self._found is None:
                next(self._steps)
        except StopIteration as end:
            self._found = end.value

    def places(self, most: int) -> Places:
        """At most so many places where the **robot** may be now; the steps left are done first."""
        while self._found is None:
            self.step()
        found = self._found.best(most)
        return Places(compose_poses(self._view.robot(found.poses), self._way), found.spread)


class Tracker:
    """A mixture of Gaussians over poses of the robot, grid frame; see :class:`Filter`.

    Parameters
    ----------
    features : MapFeatures
        The map.
    options : Options, optional
        Options of the search for each scan.
    how : TrackerOptions, optional
        Settings of the tracker.
    find : callable, optional
        Replaces the search: a function of a scan that returns its :class:`Places`.

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

    unsure = ""

    def __init__(
        self,
        features: MapFeatures,
        options: Options | None = None,
        how: TrackerOptions | None = None,
        find: Search | None = None,
    ) -> None:
        self.how = how or TrackerOptions()
        options = options or Options()
        fused = replace(options.fused, bending=self.how.bending)
        self.options = self._with(options.shared, replace(options, top=1000, fused=fused))
        self._given = self.options.shared.scale
        self.features = features.thinner(self.options.shared.thinner)
        self._find = find
        self._searching: _Search | None = None
        # The given pose and its covariance, carried by odometry alone: (1, 3) and (1, 3, 3).
        self._begun: tuple[FloatArray, FloatArray] | None = None
        self._begin_again()
        self._resets, self._dark = 0, False
        self._wrong = 1.0  # factor on the variance of odometry, as scans show it
        self._unseen = np.nan  # metres and seconds, added, since the first of some blind scans
        self._gone = Way()
        self._way, self._since = 0.0, 0.0  # metres since the last scan, and since one agreed
        self._blinded = 0.0  # metres of that way until the last blind scan
        self._turned = 0.0  # radians at about the same place
        self._unsearched, self._pause = 0.0, self.how.search[0]  # metres
        self._lasers = Lasers(self.options.shared.usual)
        self._drawn, self._told = features, list[Told]()
        self._gain = 0.0  # nats by which scans fit better with walls as others draw them
        self._trusted = 0.0  # metres driven with a unique pose
        self._uncounted = 0.0  # metres whose scans count neither as agreeing nor at all yet

    def _begin_again(self) -> None:
        """Forget what scans said: only a given pose counts, where odometry has carried it."""
        self._poses, self._covariance = NOWHERE.poses, NOWHERE.covariance
        self._mass, self._followed, self._lost = np.empty(0), np.empty(0), 1.0
        if self._begun is not None:
            self._poses, self._covariance = (array.copy() for array in self._begun)
            self._mass, self._followed, self._lost = np.ones(1), np.zeros(1), 0.0
        self._unique: tuple[FloatArray, float] | None = None  # last unique pose (3,), metres ago
        # Scans in a row that agree; weight of the way along which scans agreed, and of all.
        self._agreed, self._explained = 0, np.zeros(2)
        # Chance that a given pose is wrong, until a search shows where the robot is then: what
        # leaves the pose unique if it fits at least as well.
        self._astray = 0.0 if self._begun is None else 1 - self.how.mass[0]

    def _with(self, shared: Shared, options: Options) -> Options:
        """The options with an error that all readings share, and the trust that goes with it."""
        if not shared.bent:
            return replace(options, shared=shared)
        how = self.how.readings
        trust = replace(options.trust, temperature=how[0], strain=how[1], elsewhere=how[2:])
        return replace(options, shared=shared, trust=trust)

    def place(self, pose: FloatArray, deviation: tuple[float, float]) -> None:
        """Start at a pose (3,), grid frame, with standard deviations in metres and radians."""
        spread = np.diag((deviation[0], *deviation))[None] ** 2
        self._begun = np.array(pose, dtype=np.float64).reshape(1, 3), spread
        self._begin_again()
        self._searching, self._uncounted = None, 0.0
        self._agreed = self.how.agree[0] - 1  # one scan has to agree with the given pose
        self._lasers.place()

    def move(
        self, increment: FloatArray, covariance: FloatArray | None = None, *, known: bool = True
    ) -> None:
        """Move the belief by a motion (3,), in the robot's earlier frame: m, m, radians.

        `covariance` (3, 3) is that of the motion, by default that of a robot's odometry. A way that
        is not `known` confirms no place.
        """
        noise = self.how.noise.scaled(self._wrong)
        own = None if covariance is None else self._wrong * covariance
        self._poses, self._covariance = move_gaussians(
            self._poses, self._covariance, increment, noise, own
        )
        gone = self._gone.gone(increment)
        self._lasers.move(gone)
        if self._begun is not None:
            self._begun = move_gaussians(*self._begun, increment, noise, own)
        if self._searching is not None:
            self._searching.move(increment)
        metres, radians = gone.tolist()
        self._unsearched, self._uncounted = self._unsearched + metres, self._uncounted + metres
        # A turn counts as way as far as it shows what was out of view at this place.
        lever = self.how.fresh[0] / self.how.fresh[1]
        self._turned = max(0.0, self._turned - metres / lever)
        shown = min(radians, max(0.0, self._lasers.hidden - self._turned))
        self._turned += radians
        self._way += (metres + lever * shown) * known
        self._since += metres
        if self._unique is not None:
            pose, ago = self._unique
            self._trusted += metres if ago == 0 else 0.0
            self._unique = compose_poses(pose, increment), ago + metres

    def miss(self, seconds: float) -> None:
        """Note a blind scan, `seconds` after the scan before it.

        A robot that sees nothing may be carried off. After more than a blink, each second or metre
        without sight takes back a metre for which components were followed, and scans have to agree
        anew.
        """
        first, (rate, most, _) = self.how.sure[0], self.how.dark
        dark, self._blinded = self._way - self._blinded, self._way
        if np.isnan(self._unseen):  # the first blind scan: the gap before it is an ordinary one
            self._unseen = 0.0
            return
        before, self._unseen = self._unseen, self._unseen + dark + seconds
        blink = self.how.elsewhere[0]
        if self._unseen <= blink:
            return
        self._way = self._blinded = 0.0
        self._followed = np.minimum(self._followed, max(0.0, first - self._unseen))
        self._agreed, self._dark = 0, True
        if before <= blink:
            seconds += before
        self._doubt_place(min(most, self._lost + rate * seconds))

    def _doubt_place(self, lost: float) -> None:
        """Raise the probability of being lost to `lost`."""
        if self._lost < lost:
            self._mass, self._lost = self._mass * (1 - lost) / (1 - self._lost), lost

    def watch(self, scan: LaserScan) -> bool:
        """Correct the best pose by a scan; True if it contradicts the belief: then `see` it."""
        seen = usable(scan, self.options)
        if seen is None or not len(self._poses):
            return False
        laser, view = self._lasers.of(seen), view_of(seen, self.options)
        due = self._dark or (self._agreed > 0 and self._fresh(laser) > self.how.least)
        if due and self._agreed < self.how.agree[0]:
            return True  # scans have to agree, after darkness even if the robot stands still
        near = self._unsurprised(view, laser)
        if near is None or self._lost > 1 - self.how.mass[0]:
            return True
        self._follow_on()
        if len(view.readings) >= self.how.agree[1] and laser.last <= self._strange(laser):
            best = slice(int(np.argmax(self._mass)), int(np.argmax(self._mass)) + 1)
            one = sight(self.features, view, near, self.options)
            if self._mapped(one.gained):  # else a building on no map explains it as well
                self._correct(best, near, self._noise(one), self._fresh(laser))
                self._since = 0.0
        self._remember()
        if self._searching is not None:
            self._searching.step()
        return False

    def _remember(self) -> None:
        """Keep the best pose if it is unique. Then a given pose that is another one was wrong."""
        if self.belief.verdict != UNIQUE:
            return
        pose = self._poses[int(np.argmax(self._mass))].copy()
        self._unique = pose, 0.0
        if self._begun is not None and squares(pose - self._begun[0], self._begun[1])[0] > GATE:
            self._begun = None

    def _needed(self, pose: FloatArray) -> int:
        """Number of scans in a row that have to agree with the best pose (3,)."""
        if self._unique is None:
            return self.how.agree[0]
        (before, ago), (metres, share) = self._unique, self.how.elsewhere
        near = np.hypot(*(pose - before)[:2]) <= metres + share * ago
        return self.how.agree[0] if near else self.how.again

    def _follow_on(self) -> None:
        """Count the way since the last scan as followed, because a scan saw something."""
        self._followed, self._way, self._unseen = self._followed + self._way, 0.0, np.nan
        self._blinded = 0.0

    def _fresh(self, laser: Laser) -> float:
        """Share of a scan's evidence that is new, 0..1, by the way since the last weighed scan."""
        share = float(np.clip((laser.way / self.how.fresh).sum(), self.how.least, 1.0))
        if not self.options.shared.bent or self._begun is not None:
            return share  # what speaks against a given pose counts in full
        return share / self.how.blurred

    def _unsurprised(self, view: View, laser: Laser) -> FloatArray | None:
        """Pose (1, 3) where the best component settles; None if it fits abruptly worse than before.

        The pose is first sought within the component's covariance. If nothing fits there, it is
        sought as far away as odometry may suddenly be off, where wheels slip or a heading lags.
        """
        best = int(np.argmax(self._mass))
        pose, spread = self._poses[best : best + 1], self._covariance[best : best + 1]
        near = settled(self.features, view, pose, spread)
        misfit = misfit_at(self.features, view, near, self.options)
        slipped = False
        surprised = misfit > min(laser.last + self.how.surprise[1], self._strange(laser))
        if surprised and self._lost < 0.5:
            wider = spread + np.diag((DEVIATION[0], *DEVIATION)) ** 2
            other = settled(self.features, view, pose, wider)
            fit = misfit_at(self.features, view, other, self.options)
            if slipped := fit <= min(self._strange(laser), self.how.fits[1]):
                near, misfit, self._covariance[best] = other, fit, wider[0]
                self._doubt_place(self.how.dark[2])
        if misfit > laser.last + self.how.surprise[1]:
            return None
        laser.last, laser.doubted = misfit, slipped or misfit > self._strange(laser)
        return near

    def _strange(self, laser: Laser) -> float:
        """Misfit, nats per reading, above which a scan of this laser is doubted."""
        return laser.usual + self.how.surprise[0]

    def see(self, scan: LaserScan) -> None:
        """Weigh the whole belief by a scan. A blind scan changes nothing."""
        used = usable(scan, self.options)
        if used is None:
            return
        how, known = self.how, len(self._poses)
        laser, view = self._lasers.of(used), view_of(used, self.options)
        new, driven, laser.way = self._fresh(laser), laser.way[0], np.zeros(2)
        self._follow_on()
        contradicted = known > 0 and self._unsurprised(view, laser) is None
        strange = contradicted or self._lasers.doubted or self._lost > 1 - how.mass[0]
        due = strange or self._unsearched >= self._pause
        found = self._search(used, view, due=due, strange=strange, at_once=driven >= how.later)
        # Scans that are searched close to each other tell the same about the walls.
        asked = due and len(found.poses) > 0 and not self._leads and not self._proven
        if asked and self._judge_shared(view, found.poses):
            found = self._search(used, view, due=True, strange=True)
            known = len(self._poses)
        near = settled(self.features, view, self._poses, self._covariance)
        poses = np.concatenate((self._poses, near, found.poses))
        spread = np.concatenate((np.zeros((2 * known, 3, 3)), found.spread))
        if not len(poses):
            self._lost = 1.0
            self._judge_map(False)
            return
        seen = sight(self.features, view, poses, self.options, spread)
        # Odometry that is off moves all components alike, and is no evidence against any of them.
        at, cost = self._follow(seen)
        leak, log = how.leak[0] * new, seen.log_likelihood
        if known:
            leader = float(seen.misfit[at[np.argmax(self._mass)]])
            if leader > laser.last + how.surprise[1]:
                leak, new = how.leak[1], max(new, how.startle)
            laser.doubted = leader > self._strange(laser)
        # What a building on no map explains as well corrects no pose, and agrees with none.
        fit, gained = log[at] - cost, seen.gained - (log.max() - log[at])
        mapped = bool(self._mapped(gained[np.argmax(self._mass)] if known else seen.gained))
        elsewhere = ~self._same(poses[2 * known :, None], poses[: 2 * known]).any(axis=1)
        best = max(fit.max(initial=-np.inf), log[2 * known :][elsewhere].max(initial=-np.inf))
        gain = np.maximum((fit - best) * new, np.log(how.leak[0]))
        lost = self._lost + leak * (1 - self._lost)
        mass = self._mass * np.exp(gain)
        if known:
            mass *= (1 - lost) / self._mass.sum()
            unknown = self.options.trust.mass_elsewhere(float(gained.max()))
            gone = lost * min(np.exp(_MOST), unknown / (1 - unknown)) ** new
            # Somebody may stand in the way once. A second scan has to agree, unless this scan alone
            # is sure of another place.
            odds = max(self._odds(seen, 2 * known), np.exp(_MOST) * lost / (1 - lost))
            lost = min(gone, odds * float(mass.sum()))
        # The first search shows where else a given pose may be; on bent walls it has to fit there.
        if len(found.poses) and (not self.options.shared.bent or self._fits_well(seen, 2 * known)):
            lost, self._astray = max(lost, self._astray), 0.0
        self._mass, self._lost = mass, lost
        self._settle(seen, at, laser, self._mapped(gained))
        self._normalise()
        self._bear(seen, 2 * known, new)
        self._tidy()
        self._agree(view, laser, mapped, asked=asked)
        self._judge_map(self._explains(laser, mapped))
        self._remember()

    def _agree(self, view: View, laser: Laser, mapped: bool, *, asked: bool) -> None:
        """Count the scans that agree with the best component, and learn from this one.

        `mapped` is whether the map explains the scan there better than a building on no map,
        `asked` whether the scan was asked for shared errors already.
        """
        how = self.how
        least = how.mass[self.options.shared.bent > 0]
        agrees = (self._mass[:1] >= least).any()
        enough = len(view.readings) >= how.agree[1]
        self._agreed = self._agreed + enough if agrees else 0
        self._dark &= self._agreed < how.agree[0]
        if agrees and enough and mapped and not laser.doubted:
            self._since = 0.0
        if len(self._mass):
            laser.learn(misfit_at(self.features, view, self._poses[:1], self.options))
            if self._leads and not asked:
                self._judge_shared(view, self._poses[:1])

    def _search(
        self, scan: LaserScan, view: View, *, due: bool, strange: bool, at_once: bool = False
    ) -> Places:
        """Search the map if it is `due`; return where the **robot** may be besides its components.

        A scan that is `strange` needs the places at once, and so does a robot that is not unique,
        due or not: its own place may be in no list yet. A robot that is unique does not: each of
        the next scans does one step of the search, so that none takes much longer than the others.
        The way decides when the places are scored, so times and threads change nothing. Scans that
        are far apart leave the time for a whole search: `at_once`.
        """
        how, begun, self._searching = self.how, self._searching, None
        sure = not strange and self.belief.verdict == UNIQUE
        if not sure or (due and begun is None):
            if due:
                self._pause = min(2 * self._pause, how.search[1]) if sure else how.search[0]
                self._unsearched = 0.0
            begun = _Search(self._steps(scan), view)
            if at_once or not sure:
                return begun.places(2 * MODES)
        if begun is None:
            return NO_PLACES
        if begun.metres < how.later:
            begun.step()
            self._searching = begun
            return NO_PLACES
        found = begun.places(MODES)
        return Places(settled(self.features, view, found.poses), found.spread)

    @property
    def _leads(self) -> bool:
        """True if one component holds all mass but that of being lost: its place is asked.

        Else the places of a search are.
        """
        least, most = self.how.mass[self.options.shared.bent > 0], self._mass.max(initial=0.0)
        return bool(self._lost < 0.5 and most > 0 and most >= least * self._mass.sum())

    @property
    def _proven(self) -> bool:
        """True if walls were good for so long that they are not bent."""
        return self._trusted >= self.how.walls[1]

    def _judge_shared(self, view: View, poses: FloatArray) -> bool:
        """Allow for an error that all readings share if some scans together fit far better so.

        Returns whether it did. `poses` (C, 3) are places where the robot may be. A scan that fits
        at one of them speaks for the errors in use.
        """
        shared, options, told = self.options.shared, self.options, Told(fits=True)
        if shared.bent:  # offsets of bent walls look like a scale
            return False
        if misfit_at(self.features, view, poses, options) > options.fused.strained:
            at = view.sensor(poses)
            if not self._proven:
                self._gain += drawn_gain(self._drawn, view.readings, at, options)
                drawn = drawn_walls(self._drawn, self._gain, shared)
                if drawn != shared:
                    return self._share(replace(drawn, bent=BENT))
            told = told_by(self._drawn, view.readings, at, shared, options)
        self._told.append(told)
        del self._told[: -self.how.walls[0]]
        fit = sum(one.fits for one in self._told)  # one odd scan among them is no error of all
        if len(self._told) < self.how.walls[0] or told.fits or 2 * fit > len(self._told):
            return False
        now = replace(shared, straight=shared.straight or self._proven)
        image, placed = image_gain(self._drawn), self._leads
        found = judged(self._told, now, self._given, image, placed=placed)
        found = replace(found, straight=shared.straight)
        far = abs(np.log(found.scale / self._given)) >= np.log(options.fused.most_scaled)
        return found != shared and not far and self._share(found)

    def _share(self, shared: Shared) -> bool:
        """Allow for an error from now on."""
        before, self.options = self.options.shared, self._with(shared, self.options)
        self.features = self._drawn.thinner(shared.thinner)
        if not self._proven and (shared.thinner, shared.bent) != (before.thinner, before.bent):
            self._begin_again()
        self._find, self._told = None, []  # what replaces the search knows the old walls
        return True

    def _mapped(self, gained: FloatArray | float) -> BoolArray:
        """Return whether scans that gain so many nats on the map are rather of it than of none."""
        constant, per_nat, _ = self.options.trust.elsewhere
        return np.asarray(constant + per_nat * gained < 0)

    def _explains(self, laser: Laser, mapped: bool) -> bool:
        """Return whether the map explains the last scan: at one place or at several.

        `mapped` is as in :meth:`_agree`; on bent walls it is no sign.
        """
        lost, misfit = self.how.fits
        fits = laser.last < misfit or (mapped and not self.options.shared.bent)
        return (self._agreed > 0 or (self._lost < lost and fits)) and not self._lasers.doubted

    def _judge_map(self, agrees: bool) -> None:
        """Average over the way, and nothing before it, whether scans agree with one place."""
        faded = float(np.exp(-self._uncounted / self.how.explained[0]))
        self._explained = faded * self._explained + (1 - faded) * np.array([agrees, 1.0])
        self._uncounted = 0.0

    def _steps(self, scan: LaserScan) -> Generator[None, None, Places]:
        """Search a scan: pause after each step, but not if a function replaces the search."""
        if self._find is not None:
            return self._find(scan)
        return (yield from search_by_steps(self.features, scan, self.options))

    def _odds(self, seen: Sight, first: int) -> float:
        """Odds, by a single scan, of the places from the index `first` on; at most exp(_MOST)."""
        log = seen.log_likelihood
        if first == len(log):
            return 0.0
        # A given pose holds: a scan that fits nowhere well does not speak against it alone.
        given = self._begun is not None and self._unique is None
        if given and not self._fits_well(seen, first):
            return 0.0
        gained = seen.gained - float(log.max() - log[first:].max())
        elsewhere = self.options.trust.mass_elsewhere(gained)
        return min(float(np.exp(_MOST)), (1 - elsewhere) / elsewhere)

    def _fits_well(self, seen: Sight, first: int) -> bool:
        """Return whether a scan fits well at one of its places from the index `first` on."""
        return bool(seen.misfit[first:].min(initial=np.inf) <= self.options.fused.strained)

    def _follow(self, seen: Sight) -> tuple[IntArray, FloatArray]:
        """Index of the pose that each component (C,) is at, and nats that it pays for being there.

        A component may be where it is, where it settles, or at a mode within its gate. Where it
        settles close by, odometry was off all at once, which costs no more than the gate.
        """
        known = len(self._poses)
        spread = self._covariance[:, None] + self._noise(seen)
        square = squares(seen.poses - self._poses[:, None], spread)
        index = np.arange(known)
        near = index[self._same(self._poses, seen.poses[known : 2 * known])]
        square[near, known + near] = np.minimum(square[near, known + near], GATE)
        own = np.zeros(square.shape, np.bool_)
        own[index, index] = own[index, known + index] = own[:, 2 * known :] = True
        fit = np.where(own & (square <= GATE), seen.log_likelihood - square / 2, -np.inf)
        at = np.argmax(fit, axis=1)
        return at, square[index, at] / 2

    def _same(self, a: FloatArray, b: FloatArray) -> BoolArray:
        """Return whether poses (..., 3) are near enough to each other to be one component."""
        return np.asarray((pose_errors(a, b) < self.how.merge).all(axis=-1))

    def _noise(self, seen: Sight) -> FloatArray:
        return np.asarray(seen.covariance + np.diag((self.how.error[0], *self.how.error)) ** 2)

    def _settle(self, seen: Sight, at: IntArray, laser: Laser, mapped: BoolArray) -> None:
        """Correct the components by the poses they are at, if the map explains the scan there.

        A component that stays at its own pose is corrected only if the scan fits there.
        """
        fits = seen.misfit[at] <= self._strange(laser)
        some = np.flatnonzero(mapped & ((at != np.arange(len(at))) | fits))
        if len(some):
            self._correct(some, seen.poses[at[some]], self._noise(seen)[at[some]])

    def _correct(
        self, which: IntArray | slice, poses: FloatArray, noise: FloatArray, share: float = 1.0
    ) -> None:
        """Kalman's update of some components (C,) by poses (C, 3) with covariances (C, 3, 3).

        Only a `share` of the poses' evidence is new, 0..1.
        """
        P = self._covariance[which]
        apart = poses - self._poses[which]
        apart[:, 2] = wrap(apart[:, 2])
        if np.arange(len(self._poses))[which][0] == 0:
            rate, most = self.how.learn
            # Normalised error of the heaviest component: 1 in the mean if `noise` is right.
            square = float(apart[0] @ np.linalg.solve(P[0] + noise[0], apart[0])) / 3
            self._wrong = float(np.clip(self._wrong + rate * (square - self._wrong), 1.0, most))
        gain = P @ np.linalg.inv(P + noise / share)
        corrected = self._poses[which] + (gain @ apart[..., None])[..., 0]
        corrected[:, 2] = wrap(corrected[:, 2])
        self._poses[which] = corrected
        P = P - gain @ P
        self._covariance[which] = (P + P.transpose(0, 2, 1)) / 2

    def _bear(self, seen: Sight, first: int, fresh: float) -> None:
        """Move the lost mass to the poses where the scan fits: those from the index `first` on."""
        new, trust = np.arange(first, len(seen.poses)), self.options.trust
        if not len(new):
            return
        log = seen.log_likelihood[new]
        share = masses(np.maximum((log - log.max()) * fresh, np.log(self.how.leak[0])), 1.0)
        given = self._lost * (1 - trust.mass_elsewhere(seen.gained))
        if given < _NOTHING:
            return
        self._resets += bool(len(self._poses)) and given > 0.5
        new, share = new[:MODES], share[:MODES]
        self._poses = np.concatenate((self._poses, seen.poses[new]))
        self._covariance = np.concatenate((self._covariance, self._noise(seen)[new]))
        self._mass = np.concatenate((self._mass, given * share))
        first_sure, again = self.how.sure
        ahead = first_sure - again if len(self._followed) else 0.0
        self._followed = np.concatenate((self._followed, np.full(len(new), ahead)))
        self._lost -= given * float(share.sum())

    def _normalise(self) -> None:
        if len(self._mass):  # the odds are limited, so that a place can recover
            self._lost = min(self._lost, float(self._mass.sum()) / _NOTHING)
        whole = self._lost + self._mass.sum()
        self._mass, self._lost = self._mass / whole, self._lost / whole

    def _tidy(self) -> None:
        """Join components that have met, drop those without mass, and sort them best first."""
        order = np.argsort(-self._mass, kind="stable")
        distance, angle = self.how.merge
        picked, owner = separated(self._poses[order], MODES, distance=distance, angle=angle)
        kept, joined = order[picked], owner >= 0
        mass, longest = np.zeros((2, len(picked)))
        np.add.at(mass, owner[joined], self._mass[order][joined])
        np.maximum.at(longest, owner[joined], self._followed[order][joined])
        some = mass > _NOTHING
        self._poses, self._covariance = self._poses[kept[some]], self._covariance[kept[some]]
        self._mass, self._followed = mass[some], longest[some]
        self._normalise()

    @property
    def belief(self) -> Belief:
        """The belief now: the components, best first, grid frame."""
        order = np.argsort(-self._mass, kind="stable")
        mass = self._mass[order]
        verdict = AMBIGUOUS
        if self._lost > 0.5 or not len(mass):
            verdict = LOST
        elif not self._lasers.doubted and self._agreed >= self._needed(self._poses[order[0]]):
            held = self._followed[order[0]] >= self.how.sure[0] and self._since <= self.how.fresh[0]
            held &= self._explained[0] >= self.how.explained[1] * self._explained[1]
            verdict = UNIQUE if held else AMBIGUOUS
        neff = float(np.square(mass.sum()) / max(1e-300, np.square(mass).sum()))
        return Belief(
            self._poses[order], mass, self._covariance[order], self._lost, verdict, neff,
            self._resets,
        )  # fmt: skip
