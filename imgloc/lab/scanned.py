"""Common parts of the grid filter and the particle filter: scans, lasers and the belief."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace

import numpy as np

from imgloc.features.mapfeatures import MapFeatures
from imgloc.filters.belief import Belief, Followed, belief_of
from imgloc.filters.evidence import misfit_near, usable, view_of
from imgloc.filters.motion import MotionNoise, way_of
from imgloc.filters.tracker import TrackerOptions
from imgloc.model import FloatArray, LaserScan
from imgloc.numbers import number
from imgloc.options import Length, Nats, Options, Share, Step, Trust
from imgloc.ranges import Checked
from imgloc.robot.lasers import Laser, Lasers
from imgloc.search.adapt import drawn_thick

# Metres for which a place must be the best one before it is ``unique``; masses of the tracker.
(SURE, _), MASS = TrackerOptions.sure, TrackerOptions.mass
MORE, SUDDENLY = TrackerOptions.surprise
"""Nats per reading more than usual, and more than in the scan before, that are a surprise."""


@dataclass(frozen=True)
class ScannedOptions(Checked):
    """Settings that both filters have."""

    noise: MotionNoise = field(default_factory=MotionNoise)
    #: metres and radians of motion after which all of a scan's evidence is new
    fresh: tuple[Length, Step] = number("ScannedOptions.fresh")
    #: share of a scan's evidence that counts without any motion
    least_new: Share = number("ScannedOptions.least_new")
    #: nats per reading by which the misfit of a ``unique`` place may exceed the usual one
    surprise: Nats = MORE


class ScannedFilter(ABC):
    """A filter that takes each scan whole; see :class:`~imgloc.filters.belief.Filter`.

    Parameters
    ----------
    features : MapFeatures
        The map.
    options : Options
        Options of the search.
    how : ScannedOptions
        Settings of the filter.

    Notes
    -----
    On walls that others drew thick, and so off by decimetres, the wrong bay of a corridor fits as
    well as the right one. Nothing is ``unique`` there, unless the options state how the walls are.
    """

    knows_bent = True  #: whether the score of the whole belief allows for bent walls

    def __init__(self, features: MapFeatures, options: Options, how: ScannedOptions) -> None:
        self.options, self._how = options, how
        self.features = features.thinner(options.shared.thinner)
        self._lasers, self._last, self._followed = Lasers(), Laser(), Followed()
        self._resets = 0
        self.unsure, shared = "", options.shared
        if shared.bent and not self.knows_bent:
            self.unsure = "this filter does not know bent walls"
        elif not (shared.bent or shared.straight) and drawn_thick(features):
            self.unsure = f"the walls of this map are drawn {features.thickness:.1f} m thick"

    @property
    @abstractmethod
    def belief(self) -> Belief:
        """The belief now."""

    @property
    @abstractmethod
    def _best(self) -> FloatArray:
        """The best pose (1, 3), or none (0, 3)."""

    @abstractmethod
    def _move(self, increment: FloatArray) -> None:
        """Move the belief by a motion (3,) that is not 0."""

    @abstractmethod
    def _see(self, scan: LaserScan, new: float) -> None:
        """Take a scan that is not blind; the share `new` of its evidence counts."""

    @property
    def _few(self) -> Options:
        """The options with which many poses are scored by few readings."""
        fused = replace(self.options.fused, rays=self.options.fused.few_rays)
        return replace(self.options, fused=fused, top=1)

    def move(
        self, increment: FloatArray,
        covariance: FloatArray | None = None, *, known: bool = True,  # noqa: ARG002
    ) -> None:  # fmt: skip
        """Move the belief by a motion (3,), in the robot's earlier frame: m, m, radians."""
        if np.any(increment):
            self._followed.move(increment)
            self._lasers.move(way_of(increment))
            self._move(increment)

    def see(self, scan: LaserScan) -> None:
        """Weigh the belief by a scan. A blind scan changes nothing."""
        seen = usable(scan, self.options)
        if seen is None:
            return
        laser, how = self._lasers.of(seen), self._how
        self._see(seen, float(np.clip((laser.way / how.fresh).sum(), how.least_new, 1.0)))
        laser.way, self._last = np.zeros(2), laser
        laser.learn(self._misfit_at_best(seen))
        self._followed.best(self.belief.poses[0])

    def miss(self, seconds: float) -> None:  # noqa: B027 which is all that it does
        """Do nothing for a blind scan, because motion alone widens the belief."""

    def watch(self, scan: LaserScan) -> bool:
        """Return whether a scan contradicts the best place."""
        seen = usable(scan, self.options)
        if seen is None or not len(self._best):
            return False
        return self._misfit_at_best(seen) > self._lasers.of(seen).last + self._how.surprise

    def _misfit_at_best(self, scan: LaserScan) -> float:
        view = view_of(scan, self.options)
        return misfit_near(self.features, view, self._best, self.options)

    def _belief_of(self, poses: FloatArray, mass: FloatArray, neff: float) -> Belief:
        """The places of weighted poses (N, 3), mass (N,), and the verdict."""
        how, last = self._how, self._last
        strange = last.last > last.usual + how.surprise
        return belief_of(
            poses, mass, sure=Trust.mass,
            doubted=bool(self.unsure) or strange or self._followed.metres < SURE,
            neff=neff, resets=self._resets,
        )  # fmt: skip
