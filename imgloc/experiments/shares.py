"""Shares of trials with their confidence intervals."""

from collections.abc import Iterable
from dataclasses import dataclass
from math import nan, sqrt

Z95 = 1.959964
"""Quantile of the normal distribution for intervals of 95 %."""


@dataclass(frozen=True)
class Share:
    """Share of trials in which something happened, with Wilson's interval.

    Parameters
    ----------
    hits, trials : int
    value : float
        hits / trials; NaN without trials.
    low, high : float
        Ends of the interval.
    """

    hits: int
    trials: int
    value: float
    low: float
    high: float


def share(happened: Iterable[bool], z: float = Z95) -> Share:
    """Count and give Wilson's interval, which is sensible at 0 and at 1 too.

    Parameters
    ----------
    happened : iterable of bool
        One for each trial.
    z : float
        Half-width in standard deviations; 95 % by default.

    Examples
    --------
    >>> s = share([True] * 8 + [False] * 2)
    >>> s.hits, round(s.low, 3), round(s.high, 3)
    (8, 0.49, 0.943)
    >>> share([]).low, share([]).high
    (0.0, 1.0)
    """
    outcomes = [bool(h) for h in happened]
    hits, n = sum(outcomes), len(outcomes)
    if n == 0:
        return Share(0, 0, nan, 0.0, 1.0)
    p, square = hits / n, z * z / n
    middle = (p + square / 2) / (1 + square)
    half = z * sqrt(p * (1 - p) / n + square / (4 * n)) / (1 + square)
    return Share(hits, n, p, max(0.0, middle - half), min(1.0, middle + half))
