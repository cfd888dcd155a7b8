"""The card's image operations, compared: S, hits and time of one where another would do.

    python -m tools.paper.operations --out paper          # operations.html and operations.json
    python -m tools.paper.operations --out paper --quick  # 3 scans in each world instead of 40

CBML's correlation by each engine, beside ``auto``, which chooses; CBML-O's vector field of the
map's contours or of its image; GHT-V's visibility map by marching along rays or by unwrapping the
image around a point. All else stays as it is, and all operations see the same scans, in turns.
"""

import argparse
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from imgloc import ConfigError, MapFeatures
from imgloc.features.gradients import SOURCES
from imgloc.features.visibility import WAYS
from imgloc.io.files import write_text_atomic
from imgloc.lab.evaluation import Share, share
from imgloc.lab.performance_index import Index, performance_index
from imgloc.likelihoods.correlate import ENGINES
from imgloc.model import to_json
from tools.paper.page import templates
from tools.paper.table import PLACES, Gain, Outcome, gain, place, try_method
from tools.script import ended, make_folder, parser_of, progress, table_lines

CARD = ("filter2d", "remap", "image", "polar")
"""Those that the project's card names."""
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
    place: str
    method: str
    operation: str
    card: bool  #: the project's card names it
    default: bool  #: and ``imgloc`` takes it if nothing else is asked for
    index: Index
    gain: Gain  #: of S over the default's, scan by scan
    exact: Share  #: the maximum is in the cell of the true pose
    near: Share  #: it is in that cell or one next to it
    prepare_ms: float  #: of what the method needs of the map, which begins with nothing
    ms: float  #: of a scan's stack, median
    worse: str  #: by how much it is worse than the default; empty if by nothing that is measurable


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

    `n` scans (two at least) in each world; `seed` of the poses and the noise; `worlds` and
    `methods` some of :data:`~tools.paper.table.PLACES` and of :data:`OPERATIONS`. No number but the
    times depends on `threads`. `advance` is called for each scan, world and method.

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
            rows += _rows(world, method, trials, {op: ms for op, (_, ms) in ready.items()})
    return tuple(rows)


def _rows(
    world: str, method: str, trials: Mapping[str, list[Outcome]], times: Mapping[str, float]
) -> list[OperationRow]:
    out: list[OperationRow] = []
    for op, some in trials.items():
        row = OperationRow(
            world=world,
            place=PLACES[world],
            method=method,
            operation=op,
            card=op in CARD,
            default=op == OPERATIONS[method][0],
            index=performance_index([t.density for t in some]),
            gain=gain(some, next(iter(trials.values()))),
            exact=share(t.exact for t in some),
            near=share(t.near for t in some),
            prepare_ms=times[op],
            ms=float(np.median([t.ms for t in some])),
            worse="",
        )
        out.append(replace(row, worse=worse(row, out[0]) if out else ""))
    return out


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
    """The rows as a Markdown table; the card's operations are marked."""
    head = "world | method | by | S | gain | in its cell | or next | map, ms | scan, ms | worse"
    cells = (
        (r.world, r.method,
         f"{r.operation}{' (card)' if r.card else ''}{', default' if r.default else ''}",
         f"{r.index.value:.2f}",
         "" if r.default else f"{r.gain.value:+.2f} ± {r.gain.standard_error:.2f}",
         *(f"{100 * share.value:.0f} %" for share in (r.exact, r.near)),
         f"{r.prepare_ms:.1f}", f"{r.ms:.1f}", r.worse)
        for r in rows
    )  # fmt: skip
    return "\n".join(table_lines(head, cells))


def render_operations(rows: Sequence[OperationRow], n: int, seed: int) -> str:
    """The same as an HTML page that needs no other file."""
    page = templates().get_template("operations.html")
    return page.render(rows=list(map(asdict, rows)), n=n, seed=seed)


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse the command line, compare, write the page and print the table."""
    parser = parser_of("tools.paper.operations", __doc__)
    parser.add_argument("--out", type=Path, required=True, help="folder, made if need be")
    parser.add_argument("-n", type=int, help="scans in each world (default: 40)")
    parser.add_argument("--quick", action="store_true", help="3 scans in each world")
    parser.add_argument("--worlds", nargs="+", choices=tuple(PLACES), default=tuple(PLACES))
    parser.add_argument("--seed", type=int, default=0, help="of everything random (default: 0)")
    parser.add_argument("--threads", type=int, default=1, help="(default: 1)")
    parser.add_argument("--force", action="store_true", help="overwrite files in --out")
    given = parser.parse_args(arguments)
    return ended("operations", lambda: run(given))


def run(given: argparse.Namespace) -> int:
    """Do what the command line asks for."""
    n = given.n if given.n is not None else 3 if given.quick else 40
    if given.seed < 0 or given.threads < 1:
        raise ConfigError("expected a seed of 0 or more and 1 thread or more")
    make_folder(given.out, ("operations.html", "operations.json"), force=given.force)
    cv2.setNumThreads(given.threads)
    worlds = tuple(dict.fromkeys(given.worlds))
    with progress("image operations", n * len(worlds) * len(OPERATIONS)) as advance:
        rows = compare(n, given.seed, worlds=worlds, threads=given.threads, advance=advance)
    told = {"n": n, "seed": given.seed, "rows": list(map(asdict, rows))}
    write_text_atomic(given.out / "operations.json", to_json(told) + "\n", force=given.force)
    page = render_operations(rows, n, given.seed)
    write_text_atomic(given.out / "operations.html", page, force=given.force)
    print(markdown(rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
