"""Stamps of one source as they come: which are in order, and whether time has begun anew."""

import math
import time
from collections.abc import Callable

FINE, OLD, AHEAD, ANEW = "", "old", "ahead", "anew"
"""What a stamp is; ANEW is fine, too, and all that is known of the time before is void."""
LEAP = 1.0
"""Seconds by which a stamp leaps back, or ahead of the clock: the first such one is an error."""


class Heard:
    """The clock of a robot, learnt from the first of its stamps.

    Examples
    --------
    >>> clock = Heard(lambda: 10.0)
    >>> clock.hear(12.5), clock.hear(99.0), clock()
    (None, None, 12.5)
    """

    def __init__(self, clock: Callable[[], float] = time.time) -> None:
        self._clock, self._ahead = clock, math.nan

    def hear(self, stamp: float) -> None:
        """Take a stamp, seconds: a clock that is ahead of this one is the robot's own."""
        if math.isnan(self._ahead) and math.isfinite(stamp):
            self._ahead = max(0.0, stamp - self._clock())

    def __call__(self) -> float:
        """The time, seconds."""
        return self._clock() + (0.0 if math.isnan(self._ahead) else self._ahead)


class Stamps:
    """Judges each stamp by the one before: a leap counts from the second stamp that makes it.

    Parameters
    ----------
    most : float
        Seconds ahead of the clock from which a stamp never counts.
    shared : bool
        Several lasers have these stamps, so that one may come twice.

    Examples
    --------
    >>> stamps = Stamps()
    >>> [stamps.take(t, 9.0) for t in (8.0, 3.0, 8.1, 8.1, 3.0, 3.1, 77.0, 3.2, 77.2, 77.3)]
    ['', 'old', '', 'old', 'old', 'anew', 'ahead', '', 'ahead', '']
    """

    def __init__(self, most: float = math.inf, *, shared: bool = False) -> None:
        self.most, self._shared = most, shared
        self.start()

    def start(self) -> None:
        """Know no stamp."""
        self.latest = -math.inf
        self._lead = 0.0  # seconds by which a leap that counted is ahead of the clock
        self._back = self._ahead = math.nan  # the stamp before, if it leapt so

    def take(self, stamp: float, now: float = math.nan) -> str:
        """Judge a stamp, seconds; `now` is the time of the clock that it should be of.

        A stamp that is not known is fine.
        """
        back, ahead = self._back, self._ahead
        self._back = self._ahead = math.nan
        if math.isnan(stamp):
            return FINE
        if stamp < self.latest - LEAP:
            self._back = stamp
            if not stamp > back:
                return OLD
            self.latest = stamp
            return ANEW
        if stamp < self.latest or (stamp == self.latest and not self._shared):
            return OLD
        if stamp > now + self._lead + LEAP and stamp > self.latest + LEAP:
            self._ahead = stamp
            if not ahead <= stamp or stamp > now + self.most:
                return AHEAD
            self._lead = stamp - now
        self.latest = stamp
        return FINE
