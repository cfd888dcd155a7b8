"""Common parts of the grid filter and the particle filter: scans, lasers and the belief."""

from abc import ABC, abstractmethod
from typing import Protocol

from imgloc.features.mapfeatures import MapFeatures
from imgloc.filters.belief import Belief, Followed, belief_of
from imgloc.filters.evidence import misfit_near, usable, view_of
from imgloc.model import FloatArray, LaserScan
from imgloc.options import Options
from imgloc.robot.lasers import Laser, Lasers
from imgloc.search.adapt import drawn_thick


class Limits(Protocol):
    """The options that decide a verdict."""

    @property
    def mass(self) -> float:
        """Least mass of the best place for ``unique``, 0..1."""

    @property
    def sure(self) -> float:
        """Metres for which a place must be the best one before it is ``unique``."""

    @property
    def surprise(self) -> float:
        """Nats per reading by which the misfit of a ``unique`` place may exceed the usual one."""

    @property
    def misfit(self) -> float:
        """Largest misfit, nats per reading, at which the filter is not ``lost``."""


class ScannedFilter(ABC):
    """A filter that takes each scan whole; see :class:`~imgloc.filters.belief.Filter`.

    Parameters
    ----------
    features : MapFeatures
        The map.
    options : Options
        Options of the search.
    limits : Limits
        Limits of the verdict.

    Notes
    -----
    On walls that others drew thick, and so off by decimetres, the wrong bay of a corridor fits as
    well as the right one. Nothing is ``unique`` there, unless the options say how the walls are.
    """

    knows_bent = True  #: whether the score of the whole belief allows for bent walls

    def __init__(self, features: MapFeatures, options: Options, limits: Limits) -> None:
        self.options, self._limits = options, limits
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
    def _best(self) -> FloatArray:
        """The best pose (1, 3), or none (0, 3)."""

    @abstractmethod
    def _see(self, scan: LaserScan) -> None:
        """Take a scan that is not blind."""

    def see(self, scan: LaserScan) -> None:
        """Weigh the belief by a scan. A blind scan changes nothing."""
        seen = usable(scan, self.options)
        if seen is not None:
            self._see(seen)

    def miss(self, seconds: float) -> None:  # noqa: B027 which is all that it does
        """Do nothing for a blind scan, because motion alone widens the belief."""

    def watch(self, scan: LaserScan) -> bool:
        """Return whether a scan contradicts the best place."""
        seen = usable(scan, self.options)
        if seen is None or not len(self._best):
            return False
        return self._misfit_at_best(seen) > self._lasers.of(seen).last + self._limits.surprise

    def _misfit_at_best(self, scan: LaserScan) -> float:
        view = view_of(scan, self.options)
        return misfit_near(self.features, view, self._best, self.options)

    def _belief_of(self, poses: FloatArray, mass: FloatArray, neff: float) -> Belief:
        """The places of weighted poses (N, 3), mass (N,), and the verdict."""
        limits, last = self._limits, self._last
        strange = last.last > last.usual + limits.surprise
        return belief_of(
            poses, mass, sure=limits.mass, lost=last.last > limits.misfit,
            doubted=bool(self.unsure) or strange or self._followed.metres < limits.sure,
            neff=neff, resets=self._resets,
        )  # fmt: skip
