"""The lasers of a robot by name, and what a filter remembers of each."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from imgloc.errors import ScanError
from imgloc.model import FloatArray, LaserScan
from imgloc.numbers import number
from imgloc.options import FusedOptions

_HABIT: float = number("belief.habit")  # weight of a new scan in the running mean of the misfit
_MOST = 64  # lasers of a robot


@dataclass
class Laser:
    """Memory of one laser of a robot, because another laser sees other walls."""

    #: metres and radians driven since the last scan that weighed the belief
    way: FloatArray = field(default_factory=lambda: np.full(2, np.inf))
    usual: float = np.nan  #: running mean of the misfit, nats per reading
    last: float = np.nan  #: misfit of the last scan, nats per reading
    doubted: bool = False  #: whether the last misfit was much above the usual one
    view: float = 0.0  #: radians between the outer rays of the last scan

    def expect(self, misfit: float) -> None:
        """Set the usual misfit, nats per reading, if no scan has set it yet."""
        if np.isnan(self.usual):
            self.usual = self.last = misfit

    def learn(self, misfit: float) -> None:
        """Take the misfit of a scan, nats per reading, into the running mean."""
        self.expect(misfit)
        self.last, self.usual = misfit, self.usual + _HABIT * (misfit - self.usual)


class Lasers:
    """A :class:`Laser` for each name, wherever it sits on the robot.

    Examples
    --------
    >>> lasers, scan = Lasers(), LaserScan([1.0], [0.0], laser="/front")
    >>> lasers.of(scan) is lasers.of(scan), len(lasers)
    (True, 1)
    """

    def __init__(self, usual: float = 0.0) -> None:
        self._of: dict[str, Laser] = {}
        self._placed = False
        # Misfit, nats per reading, that counts as usual before the first scan at a given place.
        self._expected = max(FusedOptions.strained, usual)

    def __len__(self) -> int:
        return len(self._of)

    def __iter__(self) -> Iterator[Laser]:
        return iter(self._of.values())

    def of(self, scan: LaserScan) -> Laser:
        """The laser of a scan; a ScanError if a robot seems to have too many."""
        if scan.laser not in self._of:
            if len(self._of) == _MOST:
                raise ScanError(f"laser: more than {_MOST} names, expected one of each laser")
            self._of[scan.laser] = Laser()
            if self._placed:
                self._of[scan.laser].expect(self._expected)
        self._of[scan.laser].view = float(np.ptp(scan.angles))
        return self._of[scan.laser]

    @property
    def hidden(self) -> float:
        """Radians around the robot that no laser sees, if no two see the same."""
        return max(0.0, 2 * np.pi - sum(laser.view for laser in self))

    @property
    def doubted(self) -> bool:
        """True if the last scan of any laser is doubted."""
        return any(laser.doubted for laser in self)

    def move(self, way: FloatArray) -> None:
        """Add metres and radians (2,) to the way of each laser."""
        for laser in self:
            laser.way = laser.way + way

    def place(self) -> None:
        """Expect scans to fit, because a place was given."""
        self._placed = True
        for laser in self:
            laser.expect(self._expected)
