"""The table of Sec. VI: five methods in three worlds, beside the paper's own numbers.

The beam model is the oracle: what could be known. The trials themselves are those of
:mod:`imgloc.experiments.paper_trials`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from imgloc.errors import ConfigError
from imgloc.evaluate import Z95, Share, share
from imgloc.experiments.paper_trials import (
    OPTIONS,
    STEPS_DEG,
    Outcome,
    place,
    thetas_of,
    truth_of,
    try_method,
)
from imgloc.index import FLOOR, Index, performance_index

PLACES: Mapping[str, str] = MappingProxyType(
    {"visibility": "Fig. 2", "large": "Fig. 5", "curved": "curved env."}
)
"""The worlds of the table, and what the paper calls the one that each stands for."""
PAPER_S: Mapping[str, Mapping[str, float]] = MappingProxyType(
    {
        "cbml": {"visibility": -0.47, "large": -0.27, "curved": -0.35},
        "cbml-o": {"visibility": 0.71, "large": 0.65, "curved": 0.96},
        "ght": {"visibility": 2.85, "large": 2.10, "curved": 2.20},
        "ght-v": {"visibility": 3.71, "large": 2.93, "curved": 2.91},
    }
)
"""The paper's S, eq. 12, nats."""
_PLAIN = "ght-v"


@dataclass(frozen=True)
class Gain:
    """Mean of S's differences to plain GHT-V, scan by scan, with its standard error, nats."""

    value: float
    standard_error: float


@dataclass(frozen=True)
class Row:
    """One method in one world.

    Parameters
    ----------
    world, method : str
    step_deg : float
        Between headings.
    index : Index
        S over the poses in free cells.
    bare : Index or None
        For ``beam``: S if its readings are taken for independent, as eq. 2 has them.
    gain : Gain or None
        For an option of GHT-V, if plain GHT-V is in the table too.
    log_poses : float
        The greatest S that there can be: everything in the right cell.
    exact, wide, near : Share
        The global maximum is the cell of the true pose; it would be if headings were 30 degrees
        apart; it is that cell or one next to it.
    paper : float or None
        The paper's S in the world that this one stands for.
    ms : (n,) tuple of float
        Times of the likelihood stacks, one for each trial; they differ from run to run. The map
        is prepared within the first.
    """

    world: str
    method: str
    step_deg: float
    index: Index
    bare: Index | None
    gain: Gain | None
    log_poses: float
    exact: Share
    wide: Share
    near: Share
    paper: float | None
    ms: tuple[float, ...]

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of S."""
        half = Z95 * self.index.standard_error
        return self.index.value - half, self.index.value + half

    @property
    def median_ms(self) -> float:
        """Median of the times."""
        return float(np.median(self.ms))


def table(
    n: int = 100,
    seed: int = 0,
    *,
    worlds: Sequence[str] = tuple(PLACES),
    methods: Sequence[str] = tuple(STEPS_DEG),
    threads: int = 1,
    advance: Callable[[], None] = lambda: None,
) -> tuple[Row, ...]:
    """Measure the table.

    All methods locate the same scans, in turns, so that a busy moment of the machine is in the
    times of all of them.

    Parameters
    ----------
    n : int
        Trials in each world.
    seed : int
        Of the poses and the noise.
    worlds, methods : sequence of str
        Some of :data:`PLACES` and of
        :data:`~imgloc.experiments.paper_trials.STEPS_DEG`.
    threads : int
        No number but the times depends on it.
    advance : callable
        Called ``n * len(worlds) * len(methods)`` times.

    Raises
    ------
    ConfigError
        If there are no trials, or no such world or method.

    Examples
    --------
    >>> [(r.method, r.index.trials) for r in table(2, worlds=["curved"], methods=["ght"])]
    [('ght', 2)]
    """
    if n < 1:
        raise ConfigError(f"n must be at least 1, got {n}")
    for name, known in [(w, PLACES) for w in worlds] + [(m, STEPS_DEG) for m in methods]:
        if name not in known:
            raise ConfigError(f"expected one of {', '.join(known)}, got {name!r}")
    rows: list[Row] = []
    for world in worlds:
        features, scans = place(world, n, seed, threads)
        trials: dict[str, list[Outcome]] = {method: [] for method in methods}
        for k, scan in enumerate(scans.scans):
            for method in methods:
                trials[method].append(
                    try_method(method, features, scan, truth_of(scans, k), threads)
                )
                advance()
        free = int(np.count_nonzero(features.free))
        rows += [_row(world, method, free, trials) for method in methods]
    return tuple(rows)


def _row(world: str, method: str, free: int, all_trials: Mapping[str, Sequence[Outcome]]) -> Row:
    trials = all_trials[method]
    bare = [t.bare for t in trials if t.bare is not None]
    paired = method in OPTIONS and _PLAIN in all_trials
    return Row(
        world=world,
        method=method,
        step_deg=STEPS_DEG[method],
        index=performance_index([t.density for t in trials]),
        bare=performance_index(bare) if bare else None,
        gain=gain(trials, all_trials[_PLAIN]) if paired else None,
        log_poses=float(np.log(len(thetas_of(method)) * free)),
        exact=share(t.exact for t in trials),
        wide=share(t.wide for t in trials),
        near=share(t.near for t in trials),
        paper=PAPER_S.get(method, {}).get(world),
        ms=tuple(t.ms for t in trials),
    )


def gain(trials: Sequence[Outcome], plain: Sequence[Outcome]) -> Gain:
    """Compare a method with another one on the same scans, which cancels what they share.

    Examples
    --------
    >>> a, b = ([Outcome(d, None, True, True, True, 1.0)] * 4 for d in (2.0, 1.0))
    >>> round(gain(a, b).value, 2), gain(a, b).standard_error
    (0.69, 0.0)
    """
    ours, theirs = (np.array([t.density for t in some]) for some in (trials, plain))
    by_scan = np.log((1 - FLOOR) * ours + FLOOR) - np.log((1 - FLOOR) * theirs + FLOOR)
    scatter = float(by_scan.std(ddof=1)) if len(by_scan) > 1 else float("nan")
    return Gain(float(by_scan.mean()), scatter / len(by_scan) ** 0.5)
