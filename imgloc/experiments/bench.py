"""The benchmark: ratios of things timed in turns in one run.

Every case is a function without arguments that does a known amount of work. All cases of a
group take turns, so that a busy moment of the machine is in the times of all of them.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from imgloc.errors import ConfigError
from imgloc.model import LaserScan, OccupancyGrid
from imgloc.options import Options
from imgloc.pipeline import localize, prepare


@dataclass(frozen=True)
class Timing:
    """How long a case took.

    Parameters
    ----------
    name, unit : str
    work : float
        Units of work of one call: poses times readings, pairs, or 1.
    seconds : tuple of float
        Of each repeat.
    """

    name: str
    unit: str
    work: float
    seconds: tuple[float, ...]

    @property
    def median(self) -> float:
        """Median of the repeats, seconds."""
        return float(np.median(self.seconds))

    @property
    def cost(self) -> float:
        """Nanoseconds per unit of work."""
        return 1e9 * self.median / self.work


Case = tuple[str, str, float, Callable[[], object]]
"""Name, unit, units of work of a call, the call."""


def in_turns(
    cases: Sequence[Case], repeats: int, clock: Callable[[], float] = time.perf_counter
) -> tuple[Timing, ...]:
    """Time cases, each in turn, after one call of each that does not count.

    Parameters
    ----------
    cases : sequence of Case
    repeats : int
    clock : callable
        Says what time it is, seconds. That of the process does not run while others do, but
        runs twice as fast for two threads.

    Raises
    ------
    ConfigError
        If there is to be no repeat.

    Examples
    --------
    >>> one, = in_turns([("nothing", "call", 1, lambda: None)], 3)
    >>> one.name, len(one.seconds)
    ('nothing', 3)
    """
    if repeats < 1:
        raise ConfigError(f"repeats must be at least 1, got {repeats}")
    for *_, call in cases:
        call()
    seconds: dict[str, list[float]] = {name: [] for name, *_ in cases}
    for _ in range(repeats):
        for name, _, _, call in cases:
            start = clock()
            call()
            seconds[name].append(clock() - start)
    return tuple(Timing(name, unit, work, tuple(seconds[name])) for name, unit, work, _ in cases)


def answer_times(
    grid: OccupancyGrid, scans: Sequence[LaserScan], threads: int, repeats: int = 1
) -> dict[str, float]:
    """How long answers take, see :func:`answer_summary`.

    What a scan takes is the median of `repeats` answers to it: the tail is that of the scans, not
    of what else the machine had to do.

    Raises
    ------
    ConfigError
        If there is no scan.
    """
    if not scans:
        raise ConfigError("scans must be at least 1, got 0")
    features, options = prepare(grid, threads=threads), Options(threads=threads)
    cv2.setNumThreads(threads)

    def taken(scan: LaserScan) -> float:
        start = time.perf_counter()
        localize(features, scan, options)
        return 1e3 * (time.perf_counter() - start)

    first = taken(scans[0])
    turns = [[taken(scan) for scan in scans] for _ in range(repeats)]
    cv2.setNumThreads(1)
    return answer_summary([first, *np.median(turns, axis=0).tolist()])


def answer_summary(ms: Sequence[float]) -> dict[str, float]:
    """What answers take, and what the first one took longer: computing the map's features.

    Parameters
    ----------
    ms : sequence of float
        Of the answers to a scan, to the same one again, to others.

    Returns
    -------
    dict
        ``median_ms`` and ``p99_over_median`` of all but the first, ``prepare_s`` in seconds.

    Examples
    --------
    >>> answer_summary([1020.0, 20.0, 20.0, 30.0])
    {'median_ms': 20.0, 'p99_over_median': 1.49, 'prepare_s': 1.0}
    """
    median, high = (float(v) for v in np.percentile(ms[1:], (50, 99)))
    return {
        "median_ms": median, "p99_over_median": high / median, "prepare_s": (ms[0] - ms[1]) / 1e3,
    }  # fmt: skip


def as_row(timing: Timing) -> dict[str, object]:
    """A timing as plain values."""
    spread = (max(timing.seconds) - min(timing.seconds)) / timing.median
    return {
        "case": timing.name, "unit": timing.unit, "ns": timing.cost,
        "ms": 1e3 * timing.median, "spread": spread,
    }  # fmt: skip
