"""Stamps of one source as they come: which are in order, and whether time has begun anew."""

import math
import time
from collections.abc import Callable

FINE, OLD, AHEAD, ANEW = "", "old", "ahead", "anew"
"""What a stamp is; ANEW is fine, too, and all that is known of the time before is void."""
LEAP = 1.0
"""Seconds by which a stamp leaps back, or ahead of the clock, and for which others must follow it
there before it is no error."""


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
    """Judges each stamp by those before: a leap counts once stamps have stayed there for `LEAP`.

    If every other stamp leaps, and a good one between two is lost, the leap is still an error.

    Parameters
    ----------
    most : float
        Seconds ahead of the clock from which a stamp never counts.
    shared : bool
        Several lasers have these stamps, so that one may come twice.

    Examples
    --------
    >>> stamps = Stamps()
    >>> [stamps.take(t, 9.0) for t in (8.0, 3.0, 8.1, 8.1, 3.0, 3.5, 4.0, 77.0, 4.2, 77.2, 78.2)]
    ['', 'old', '', 'old', 'old', 'old', 'anew', 'ahead', '', 'ahead', '']
    """

    def __init__(self, most: float = math.inf, *, shared: bool = False) -> None:
        self.most, self._shared = most, shared
        self.start()

    def start(self) -> None:
        """Know no stamp."""
        self.latest = -math.inf
        self._leapt = FINE, math.nan, math.nan  # where to, from which stamp on, and the last one

    def take(self, stamp: float, now: float = math.nan) -> str:
        """Judge a stamp, seconds; `now` is the time of the clock that it should be of.

        A stamp that is not known is fine.
        """
        (to, first, last), self._leapt = self._leapt, (FINE, math.nan, math.nan)
        if math.isnan(stamp):
            return FINE
        if stamp < self.latest - LEAP:
            judged = OLD
        elif stamp < self.latest or (stamp == self.latest and not self._shared):
            return OLD
        else:
            judged = AHEAD if stamp > now + LEAP and stamp > self.latest + LEAP else FINE
        if judged != FINE:
            begun = first if judged == to and stamp >= last else stamp
            self._leapt = judged, begun, stamp
            if stamp < begun + LEAP or (judged == AHEAD and stamp > now + self.most):
                return judged
        self.latest = stamp
        return ANEW if judged == OLD else FINE
