"""The benchmark: every method and engine beside plain references, timed in turns in one run.

    python -m tools.bench                        # on a bundled world
    python -m tools.bench --problem ../problem   # on maps A and B, with the floors in C
    python -m tools.bench --parts engines        # how far engine="auto" is from the best one
    python -m tools.bench --parts localize --sets ../data/*/map.yaml   # on recorded scans, too
    python -m tools.bench --parts memory         # of the command on large maps, up to 25 hectares
    python -m tools.bench --parts batch --scans 200 --repeats 1   # batches beside plain loops
    python -m tools.bench --parts rows           # a table and a page of 100,000 rows

Prints Markdown: medians over the repeats with their spread. Compare ratios, not times, between
machines.
"""

import argparse
import os
import platform
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from imgloc import ConfigError, ScanSet, Sensor, load_map, load_scans, prepare, simulate
from imgloc.features.scanpoints import scan_points
from imgloc.likelihoods.correlate import ENGINES
from imgloc.model import OccupancyGrid, to_json
from imgloc.simulation.worlds import WORLDS, render
from tools.bench.fleets import batch_costs, row_costs
from tools.bench.measure import (
    answer_times,
    as_row,
    engine_rows,
    engine_summary,
    in_turns,
    stack_cases,
    vote_cases,
)
from tools.bench.outside import exhaustive_search, floors, growth, memory
from tools.paper.complexity import fit_exponent
from tools.recorded import recorded_sets
from tools.script import at_least_one, ended, parser_of, table_lines

PARTS = ("costs", "engines", "localize", "growth")
"""What is measured by default: stacks and votes beside plain references and C; engines beside
``auto``; answers; answers as the map grows."""
LARGE = ("memory", "batch", "rows")
"""What takes gigabytes or minutes, and is measured if it is asked for: memory of large maps;
batches beside plain loops; a table and a page of many rows."""
ROWS = 100_000
"""Rows of a batch of which there is a table and a page."""
SIDES = (4_000, 10_000)
"""Cells along a side of the large maps, of 5 cm."""
BOUND_SCANS = 10
"""Scans of branch and bound, which is faster or slower as they are more or less clear."""

Row = Mapping[str, Any]


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse the command line, measure, print."""
    parser = parser_of("tools.bench", __doc__)
    parser.add_argument("--problem", type=Path, help="folder with mapA, mapB and scans_10m.npz")
    parser.add_argument(
        "--sets", type=Path, nargs="*", default=[], help="maps with a scans.npz beside them"
    )
    parser.add_argument("--range-max", type=float, default=20.0, help="metres, of their scans")
    parser.add_argument(
        "--parts",
        default=",".join(PARTS),
        help=f"with commas between; {', '.join(LARGE)} are not by default",
    )
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--scans", type=int, default=50, help="answers of localize; of a batch")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args(arguments)

    return ended("bench", lambda: run(given))


def run(given: argparse.Namespace) -> int:
    """Measure, and print what was found."""
    results = run_bench(given)
    print(to_json(results) if given.json else bench_tables(results))
    return 0


def run_bench(given: argparse.Namespace) -> dict[str, Any]:
    """Measure what the command line asks for, as one set of plain values.

    Raises
    ------
    ConfigError
        If a number is less than 1 or there is no such part.
    ScanError
        If a set has no scans with poses.
    """
    problem, repeats, threads = given.problem, given.repeats, given.threads
    at_least_one(repeats=repeats, threads=threads, scans=given.scans)
    parts = given.parts.split(",")
    for part in parts:
        if part not in (*PARTS, *LARGE):
            raise ConfigError(f"a part is one of {', '.join((*PARTS, *LARGE))}, got {part!r}")
    cv2.setNumThreads(1)  # what has threads says so
    out: dict[str, Any] = {
        "machine": {
            "processor": platform.processor() or platform.machine(), "cores": os.cpu_count(),
            "python": platform.python_version(), "numpy": np.__version__, "opencv": cv2.__version__,
        }
    }  # fmt: skip
    maps = _maps(problem, given.scans)
    recorded = recorded_sets(given.sets, given.scans, 0, given.range_max)
    if "costs" in parts:
        name, (grid, told) = next(iter(maps.items()))
        # A scan that sees too little to have normals would give no votes to time.
        seen = [s for s in told.scans if scan_points(s.ranges, s.angles, s.valid).valid.any()]
        features, scan = prepare(grid), seen[0]
        timings = (
            *in_turns(stack_cases(features, seen[:BOUND_SCANS], threads), repeats),
            *in_turns(vote_cases(features, scan, threads), repeats),
        )
        out |= {
            "map": name, "surface_points": len(features.surface),
            "readings": int(scan.valid.sum()), "costs": [as_row(t) for t in timings],
            "floors": {} if problem is None else floors(problem),
        }  # fmt: skip
    if "engines" in parts:
        rows = engine_rows(repeats=repeats)
        out |= {"engines": rows, "auto_over_best": engine_summary(rows)}
    if "localize" in parts:
        answers, searches = dict[str, dict[str, float]](), list[float | str]()
        for name, grid, scans in (*((k, *of) for k, of in maps.items()), *recorded):
            answers[name] = answer_times(grid, scans.scans[: given.scans], threads, repeats)
            if problem is not None:  # in turns with the answers: others use the machine, too
                searches.append(exhaustive_search(problem, repeats))
        out["localize"] = answers
        if searches:
            known = [ms for ms in searches if isinstance(ms, float)]
            out["yardstick"] = {"ms": min(known) if known else searches[0]}
            for row in answers.values() if known else ():
                row["over_c"] = row["median_ms"] / min(known)
    if "growth" in parts:
        grown = growth("large", (1, 2, 4), repeats)
        areas = [row["area"] for row in grown]
        out["growth"] = grown
        out["exponents"] = {
            key: fit_exponent(areas, [row[key] for row in grown]) for key in ("ms", "rss_mib")
        }
    if "memory" in parts:
        out["memory"] = memory(*(maps["B"] if "B" in maps else _world(0.05, 1)), SIDES)
    if "batch" in parts:
        grid, told = next(iter(maps.values()))
        out["batch"], out["batches"] = batch_costs(
            grid, ScanSet(told.scans[: given.scans]), repeats
        )
    if "rows" in parts:
        out["rows"] = row_costs(*_world(0.1, 5), ROWS)
    return out


def _maps(problem: Path | None, count: int) -> dict[str, tuple[OccupancyGrid, ScanSet]]:
    if problem is None:
        return {"large": _world(0.1, count)}
    scans = load_scans(problem / "scans_10m.npz")
    return {k: (load_map(problem / f"map{k}.yaml"), scans) for k in ("A", "B")}


def _world(resolution: float, count: int) -> tuple[OccupancyGrid, ScanSet]:
    grid = render(WORLDS["large"](), resolution)
    return grid, simulate(grid, count, 0, Sensor(range_max=10.0))


def bench_tables(results: Mapping[str, Any]) -> str:
    """A Markdown table of each part that was measured by :func:`run_bench`.

    Examples
    --------
    >>> row = {"side": 4000, "cell": 0.05, "seconds": 5.31, "rss_mib": 565.2}
    >>> print(bench_tables({"machine": {"cores": 2}, "memory": [row]}))
    cores 2
    <BLANKLINE>
    | cells a side | of m | imgloc localize, s | peak MiB |
    |---:|---:|---:|---:|
    | 4000 | 0.05 | 5.3 | 565 |
    """
    parts = [", ".join(f"{key} {value}" for key, value in results["machine"].items())]
    for key, (head, cells) in _TABLES.items():
        if key in results:
            found = results[key]
            rows = (
                [{"name": k, **r} for k, r in found.items()] if isinstance(found, dict) else found
            )
            parts.append("\n".join(table_lines(head, map(cells, rows), "---:")))
    for key, title in _TITLES.items():
        if key in results:
            said = ", ".join(
                f"{name} {v if isinstance(v, str) else format(v, '.4g')}"
                for name, v in results[key].items()
            )
            parts.append(f"{title}: {said or 'not measured'}")
    return "\n\n".join(parts)


_NAMES = (*ENGINES, "auto")
_TABLES: Mapping[str, tuple[str, Callable[[Row], Sequence[object]]]] = {
    "costs": (
        "case | ns per | ms | spread",
        lambda r: (
            r["case"], f"{r['ns']:.4f} {r['unit']}", f"{r['ms']:.2f}", f"{100 * r['spread']:.0f} %"
        ),
    ),
    "engines": (
        f"cells | reach | rays | {', ms | '.join(_NAMES)}, ms | best | auto / best",
        lambda r: (
            r["size"], r["reach"], r["rays"], *(f"{r['ms'][name]:.2f}" for name in _NAMES),
            r["best"], f"{r['ratio']:.2f}",
        ),
    ),
    "localize": (
        "localize on | ms | p99 / median | prepare, s | of a search in C",
        lambda r: (
            r["name"], f"{r['median_ms']:.0f}", f"{r['p99_over_median']:.2f}",
            f"{r['prepare_s']:.2f}", f"{r['over_c']:.2f}" if "over_c" in r else "",
        ),
    ),
    "growth": (
        "area, m² | ms | prepare, s | peak MiB",
        lambda r: (
            f"{r['area']:.0f}", f"{r['ms']:.0f}", f"{r['prepare_s']:.2f}", f"{r['rss_mib']:.0f}"
        ),
    ),
    "memory": (
        "cells a side | of m | imgloc localize, s | peak MiB",
        lambda r: (r["side"], f"{r['cell']:g}", f"{r['seconds']:.1f}", f"{r['rss_mib']:.0f}"),
    ),
    "batch": ("batch | s | processor, s", lambda r: _cost(r)[:3]),
    "rows": ("rows | s | processor, s | peak MiB", lambda r: _cost(r)),
}  # fmt: skip
_TITLES = {
    "auto_over_best": "auto / best",
    "floors": "the same in C, ns",
    "yardstick": "every pose of CBML on map A in hand-written C, one thread",
    "exponents": "exponents of growth in the area",
    "batches": "batches",
}


def _cost(row: Row) -> Sequence[object]:
    costs = [row.get(key) for key in ("seconds", "processor", "rss_mib")]
    return row["name"], *("" if c is None else f"{c:.2f}" for c in costs)


if __name__ == "__main__":
    sys.exit(main())
