"""Run times that the appendix calls nearly equal, compared fairly.

Two methods take turns on the same scans. What is counted is the CPU time of the one thread in
which they run, which other programs do not use up. Still a ratio is this machine's.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from imgloc.experiments.paper import PLACES
from imgloc.experiments.paper_trials import place, stack_of, thetas_of

PAIRS = (("cbml-o", "cbml", 1.3), ("ght-v", "ght", 1.1))
"""Method, its rival, and the ratio that still counts as "virtually the same"."""


@dataclass(frozen=True)
class Ratio:
    """CPU time of a method over that of its rival.

    Parameters
    ----------
    world, method, rival : str
    most : float
        The ratio that still counts as the same.
    ms, rival_ms : float
        Medians over the scans of the medians of the repeats.
    value : float
        Median over the scans of the ratios of those medians.
    """

    world: str
    method: str
    rival: str
    most: float
    ms: float
    rival_ms: float
    value: float


def measure_ratios(
    n: int = 5,
    repeats: int = 5,
    seed: int = 0,
    *,
    trials: int | None = None,
    worlds: Sequence[str] = tuple(PLACES),
    advance: Callable[[], None] = lambda: None,
) -> tuple[Ratio, ...]:
    """Compare the methods of :data:`PAIRS` in each world.

    Parameters
    ----------
    n : int
        Scans of each world.
    repeats : int
        How often each stack is computed; who comes first changes from time to time.
    seed : int
        That of the table.
    trials : int, optional
        Those of the table, `n` or more: then the scans are the first of the table's.
    worlds : sequence of str
    advance : callable
        Called ``n * len(worlds) * len(PAIRS)`` times.

    Examples
    --------
    >>> found = measure_ratios(1, 1, worlds=["curved"])
    >>> [(r.method, r.rival, r.value > 0) for r in found]
    [('cbml-o', 'cbml', True), ('ght-v', 'ght', True)]
    """
    out = []
    for world in worlds:
        features, scans = place(world, trials or n, seed)
        for method, rival, most in PAIRS:
            runs = [
                [partial(stack_of, m, features, scan, thetas_of(m)) for m in (method, rival)]
                for scan in scans.scans[:n]
            ]
            for run in runs[0]:  # features are computed before the clock counts
                run()
            times = []
            for pair in runs:
                times.append(take_turns(pair, repeats))
                advance()
            ours, theirs = np.array(times).T
            out.append(
                Ratio(
                    world, method, rival, most, 1e3 * float(np.median(ours)),
                    1e3 * float(np.median(theirs)), float(np.median(ours / theirs)),
                )
            )  # fmt: skip
    return tuple(out)


def take_turns(
    runs: Sequence[Callable[[], object]],
    repeats: int,
    clock: Callable[[], float] = time.thread_time,
) -> tuple[float, ...]:
    """Median seconds of each run; in every other round they come in the opposite order."""
    times: list[list[float]] = [[] for _ in runs]
    for k in range(repeats):
        order = range(len(runs)) if k % 2 == 0 else reversed(range(len(runs)))
        for i in order:
            start = clock()
            runs[i]()
            times[i].append(clock() - start)
    return tuple(float(np.median(t)) for t in times)
