"""The card's image operations, compared: S, hits and time of one where another would do.

    python -m tools.paper.operations          # 40 scans in each of three worlds, as Markdown
    python -m tools.paper.operations -n 3

CBML's correlation by each engine, beside ``auto``, which chooses; CBML-O's vector field of the
map's contours or of its image; GHT-V's visibility map by marching along rays or by unwrapping the
image around a point. All else stays as it is, and all operations see the same scans, in turns.
"""

import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from imgloc import ConfigError, MapFeatures
from imgloc.features.gradients import SOURCES
from imgloc.features.visibility import WAYS
from imgloc.lab.evaluation import Share, share
from imgloc.lab.performance_index import Index, performance_index
from imgloc.likelihoods.correlate import ENGINES
from tools.paper.table import PLACES, Gain, Outcome, gain, place, try_method
from tools.script import ended, parser_of, progress, table_lines

OPERATIONS: Mapping[str, tuple[str, ...]] = {
    "cbml": ("auto", *ENGINES),
    "cbml-o": tuple(sorted(SOURCES, key=lambda name: name != MapFeatures.vmap_from)),
    "ght-v": tuple(sorted(WAYS, key=lambda name: name != MapFeatures.visibility_by)),
}
"""What is compared of each method; the default is the first."""
_FEATURE = {
    "cbml": ("", "bmap"), "cbml-o": ("vmap_from", "vmap"), "ght-v": ("visibility_by", "visibility"),
}  # fmt: skip
_NATS, _SLOWER = 0.005, 1.1  # from which on an operation is worse: S, and times the default's time


@dataclass(frozen=True)
class OperationRow:
    """One operation of one method in one world."""

    world: str
    method: str
    operation: str
    index: Index
    gain: Gain  #: of S over the default's, scan by scan
    exact: Share  #: the maximum is in the cell of the true pose
    near: Share  #: it is in that cell or one next to it
    prepare_ms: float  #: of what the method needs of the map, which begins with nothing
    ms: float  #: of a scan's stack, median

    @property
    def default(self) -> bool:
        """Whether ``imgloc`` takes it if nothing else is asked for."""
        return self.operation == OPERATIONS[self.method][0]


def compare(
    n: int = 40,
    seed: int = 0,
    *,
    worlds: Sequence[str] = tuple(PLACES),
    methods: Sequence[str] = tuple(OPERATIONS),
    threads: int = 1,
    advance: Callable[[], None] = lambda: None,
) -> tuple[OperationRow, ...]:
    """Try every operation of :data:`OPERATIONS` on the scans of the paper's table.

    `n` scans (two at least) in each world. `advance` is called for each scan, world and method.

    Examples
    --------
    >>> rows = compare(2, worlds=["curved"], methods=["ght-v"])
    >>> sorted(row.operation for row in rows), [row.default for row in rows]
    (['march', 'polar'], [True, False])
    """
    if n < 2:
        raise ConfigError(f"n must be at least 2, got {n}")
    rows: list[OperationRow] = []
    for world in worlds:
        fresh, scans = place(world, n, seed, threads)
        for method in methods:
            option, needed = _FEATURE[method]
            ready: dict[str, tuple[MapFeatures, float]] = {}
            for op in OPERATIONS[method]:
                if not option and ready:  # what engines need of the map is the same
                    ready[op] = next(iter(ready.values()))
                    continue
                changed: dict[str, Any] = {option: op} if option else {}
                features, start = replace(fresh, **changed), time.perf_counter()
                getattr(features, needed)
                ready[op] = features, 1e3 * (time.perf_counter() - start)
            trials: dict[str, list[Outcome]] = {op: [] for op in ready}
            for scan, pose in scans.with_poses():
                for op, (features, _) in ready.items():
                    engine = "auto" if option else op
                    trials[op].append(try_method(method, features, scan, pose, threads, engine))
                advance()
            first = next(iter(trials.values()))
            rows += (
                OperationRow(
                    world, method, op, performance_index([t.density for t in some]),
                    gain(some, first), share(t.exact for t in some), share(t.near for t in some),
                    ready[op][1], float(np.median([t.ms for t in some])),
                )
                for op, some in trials.items()
            )  # fmt: skip
    return tuple(rows)


def worse(row: OperationRow, base: OperationRow) -> str:
    """By how much a row is worse than the default: in S, in hits, in time.

    S by more than two standard errors of the paired differences, hits by an interval that ends
    below the default's share, times by more than a tenth.
    """
    said = []
    if row.gain.value < -max(_NATS, 2 * row.gain.standard_error):
        said.append(f"S by {-row.gain.value:.2f} ± {row.gain.standard_error:.2f}")
    for name in ("exact", "near"):
        ours, theirs = getattr(row, name), getattr(base, name)
        if ours.high < theirs.value:
            said.append(f"hits ({name}) {ours.hits} for {theirs.hits} of {theirs.trials}")
    for name, what in (("prepare_ms", "map"), ("ms", "scan")):
        ratio = getattr(row, name) / getattr(base, name)
        if ratio > _SLOWER:
            said.append(f"time of a {what} {ratio:.1f} x")
    return ", ".join(said)


def markdown(rows: Sequence[OperationRow]) -> str:
    """The rows as a Markdown table; the default of a method comes before what is compared to it."""
    head = "world | method | by | S | gain | in its cell | or next | map, ms | scan, ms | worse"
    base = {(r.world, r.method): r for r in rows if r.default}
    cells = (
        (r.world, r.method, f"{r.operation}{', default' if r.default else ''}",
         f"{r.index.value:.2f}", f"{r.gain.value:+.2f} ± {r.gain.standard_error:.2f}",
         *(f"{100 * share.value:.0f} %" for share in (r.exact, r.near)),
         f"{r.prepare_ms:.1f}", f"{r.ms:.1f}", worse(r, base[r.world, r.method]))
        for r in rows
    )  # fmt: skip
    return "\n".join(table_lines(head, cells))


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse the command line, compare, print the table."""
    parser = parser_of("tools.paper.operations", __doc__, seed=0)
    parser.add_argument("-n", type=int, default=40, help="scans in each world (default: 40)")
    parser.add_argument("--worlds", nargs="+", choices=tuple(PLACES), default=tuple(PLACES))
    given = parser.parse_args(arguments)

    def run() -> int:
        cv2.setNumThreads(1)
        with progress("operations", given.n * len(given.worlds) * len(OPERATIONS)) as advance:
            print(markdown(compare(given.n, given.seed, worlds=given.worlds, advance=advance)))
        return 0

    return ended("operations", run)


if __name__ == "__main__":
    sys.exit(main())
