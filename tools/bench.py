"""The benchmark: every method and engine beside plain references, timed in turns in one run.

    python tools/bench.py                        # on a bundled world
    python tools/bench.py --problem ../problem   # on maps A and B, with the floors in C

Costs are medians over the repeats with their spread; compare ratios, not times, between machines.
"""

import argparse
import os
import platform
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from imgloc.cli.answers import to_json
from imgloc.cli.tables import as_plain
from imgloc.experiments.bench import (
    answer_times,
    as_row,
    in_turns,
    stack_cases,
    vote_cases,
)
from imgloc.experiments.bench_outside import floors, growth
from imgloc.experiments.complexity import fit_exponent
from imgloc.experiments.scansets import Sensor, simulate_set
from imgloc.experiments.worlds import WORLDS, render
from imgloc.io.maps import load_map
from imgloc.io.scans import load_scans
from imgloc.pipeline import prepare


def main() -> int:
    """Parse the command line, measure, print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--problem", type=Path, help="folder with mapA, mapB and scans_10m.npz")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--scans", type=int, default=50, help="answers of localize")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    cv2.setNumThreads(1)  # what has threads says so
    if given.problem is None:
        grid = render(WORLDS["large"](), 0.1)
        maps = {"large": (grid, simulate_set(grid, given.scans, 0, Sensor(range_max=10.0)))}
    else:
        scans = load_scans(given.problem / "scans_10m.npz")
        maps = {k: (load_map(given.problem / f"map{k}.yaml"), scans) for k in ("A", "B")}
    first, (grid, scans) = next(iter(maps.items()))
    features, scan = prepare(grid), scans.scans[0]
    timings = (
        *in_turns(stack_cases(features, scan, given.threads), given.repeats),
        *in_turns(vote_cases(features, scan, given.threads), given.repeats),
    )
    answers = {
        name: answer_times(on, s.scans[: given.scans], given.threads)
        for name, (on, s) in maps.items()
    }
    grown = growth("large", (1, 2, 4), given.repeats)
    areas = [row["area"] for row in grown]
    results: dict[str, Any] = {
        "machine": {
            "processor": platform.processor() or platform.machine(), "cores": os.cpu_count(),
            "python": platform.python_version(), "numpy": np.__version__, "opencv": cv2.__version__,
        },
        "map": first, "surface_points": len(features.surface), "readings": int(scan.valid.sum()),
        "costs": [as_row(t) for t in timings],
        "floors": {} if given.problem is None else floors(given.problem),
        "localize": answers,
        "growth": grown,
        "exponents": {
            key: fit_exponent(areas, [row[key] for row in grown]) for key in ("ms", "rss_mib")
        },
    }  # fmt: skip
    print(to_json(results) if given.json else text(results))
    return 0


def text(results: dict[str, Any]) -> str:
    """Tables for people."""
    columns = ("case", "ns per", "ms", "spread")
    rows = [
        (r["case"], f"{r['ns']:.4f} {r['unit']}", f"{r['ms']:.2f}", f"{100 * r['spread']:.0f} %")
        for r in results["costs"]
    ]
    lines = [f"{results['machine']}", as_plain(columns, rows)]
    for key in ("floors", "localize", "growth", "exponents"):
        lines.append(f"{key}: {to_json({key: results[key]})}")
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
