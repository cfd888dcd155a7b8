"""What the grid filter and the particle filter share: how a scan is taken, and what is believed."""

from abc import ABC, abstractmethod
from typing import Protocol

from imgloc.features.mapfeatures import MapFeatures
from imgloc.filters.belief import Belief, Followed, Habit, Habits, belief_of
from imgloc.filters.evidence import misfit_near, usable, view_of
from imgloc.model import FloatArray, LaserScan
from imgloc.options import Options


class Limits(Protocol):
    """The options that decide a verdict."""

    @property
    def mass(self) -> float:
        """Mass of the best place, to be ``unique``."""

    @property
    def sure(self) -> float:
        """Metres that it has to be the best one for before it is."""

    @property
    def surprise(self) -> float:
        """Nats per reading that it may lack more than usual."""

    @property
    def misfit(self) -> float:
        """Nats per reading that it may lack and not be lost."""


class ScannedFilter(ABC):
    """A filter that takes each scan whole; see :class:`~imgloc.filters.belief.Filter`.

    Parameters
    ----------
    features : MapFeatures
    options : Options
    limits : Limits
    """

    def __init__(self, features: MapFeatures, options: Options, limits: Limits) -> None:
        self.options, self._limits = options, limits
        self.features = features.thinner(options.shared.thinner)
        self._habits, self._last, self._followed = Habits(), Habit(), Followed()
        self._resets = 0

    @property
    @abstractmethod
    def _best(self) -> FloatArray:
        """The best pose (1, 3), or none (0, 3)."""

    @abstractmethod
    def _see(self, scan: LaserScan) -> None:
        """Take a scan that says something."""

    def see(self, scan: LaserScan) -> None:
        """Take a scan; one with too few readings says nothing."""
        seen = usable(scan, self.options)
        if seen is not None:
            self._see(seen)

    def miss(self, seconds: float) -> None:  # noqa: B027 which is all that it does
        """Nothing: what motion adds to the spread is all that is lost."""

    def watch(self, scan: LaserScan) -> bool:
        """Whether a scan contradicts the best place."""
        seen = usable(scan, self.options)
        if seen is None or not len(self._best):
            return False
        return self._misfit_at_best(seen) > self._habits.of(seen).last + self._limits.surprise

    def _misfit_at_best(self, scan: LaserScan) -> float:
        view = view_of(scan, self.options)
        return misfit_near(self.features, view, self._best, self.options)

    def _belief_of(self, poses: FloatArray, mass: FloatArray, neff: float) -> Belief:
        """The places of weighted poses (N, 3), mass (N,), and the verdict."""
        limits, last = self._limits, self._last
        strange = last.last > last.usual + limits.surprise
        return belief_of(
            poses, mass, sure=limits.mass, lost=last.last > limits.misfit,
            doubted=strange or self._followed.metres < limits.sure,
            neff=neff, resets=self._resets,
        )  # fmt: skip
