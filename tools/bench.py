"""The benchmark: every method and engine beside plain references, timed in turns in one run.

    python tools/bench.py                        # on a bundled world
    python tools/bench.py --problem ../problem   # on maps A and B, with the floors in C
    python tools/bench.py --parts engines        # how far engine="auto" is from the best one
    python tools/bench.py --parts localize --sets ../data/*/map.yaml   # on recorded scans, too
    python tools/bench.py --parts memory         # of the command on large maps, up to 25 hectares

Costs are medians over the repeats with their spread; compare ratios, not times, between machines.
"""

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from imgloc.cli.answers import to_json
from imgloc.cli.tables import as_plain
from imgloc.errors import ImglocError
from imgloc.experiments.bench_run import LARGE, PARTS, run_bench
from imgloc.likelihood.correlate import ENGINES


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse the command line, measure, print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--problem", type=Path, help="folder with mapA, mapB and scans_10m.npz")
    parser.add_argument(
        "--sets", type=Path, nargs="*", default=[], help="maps with a scans.npz beside them"
    )
    parser.add_argument("--range-max", type=float, default=20.0, help="metres, of their scans")
    parser.add_argument(
        "--parts", default=",".join(PARTS), help=f"with commas between; {LARGE} is not a default"
    )
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--scans", type=int, default=50, help="answers of localize")
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args(arguments)
    try:
        results = run_bench(
            given.problem,
            sets=given.sets,
            range_max=given.range_max,
            parts=tuple(given.parts.split(",")),
            repeats=given.repeats,
            threads=given.threads,
            scans=given.scans,
        )
    except ImglocError as error:
        print(f"bench: error: {error}", file=sys.stderr)
        return error.exit_code
    print(to_json(results) if given.json else text(results))
    return 0


def text(results: dict[str, Any]) -> str:
    """Tables for people."""
    lines = [f"{results['machine']}"]
    if "costs" in results:
        rows = [
            (
                r["case"],
                f"{r['ns']:.4f} {r['unit']}",
                f"{r['ms']:.2f}",
                f"{100 * r['spread']:.0f} %",
            )
            for r in results["costs"]
        ]
        lines.append(as_plain(("case", "ns per", "ms", "spread"), rows))
    if "engines" in results:
        names = (*ENGINES, "auto")
        rows = [
            (*(str(r[key]) for key in ("size", "reach", "rays")),
             *(f"{r['ms'][name]:.2f}" for name in names), r["best"], f"{r['ratio']:.2f}")
            for r in results["engines"]
        ]  # fmt: skip
        columns = (
            "cells",
            "reach",
            "rays",
            *(f"{name}, ms" for name in names),
            "best",
            "auto/best",
        )
        lines.append(as_plain(columns, rows))
    if "localize" in results:
        rows = [
            (name, f"{r['median_ms']:.0f}", f"{r['p99_over_median']:.2f}", f"{r['prepare_s']:.2f}")
            for name, r in results["localize"].items()
        ]
        lines.append(as_plain(("localize on", "ms", "p99 / median", "prepare, s"), rows))
    if "growth" in results:
        rows = [
            (f"{r['area']:.0f}", f"{r['ms']:.0f}", f"{r['prepare_s']:.2f}", f"{r['rss_mib']:.0f}")
            for r in results["growth"]
        ]
        lines.append(as_plain(("area, m²", "ms", "prepare, s", "peak MiB"), rows))
    if LARGE in results:
        rows = [
            (str(r["side"]), f"{r['seconds']:.1f}", f"{r['rss_mib']:.0f}") for r in results[LARGE]
        ]
        lines.append(as_plain(("cells a side, 5 cm", "localize, s", "peak MiB"), rows))
    for key in ("auto_over_best", "floors", "exponents"):
        if key in results:
            lines.append(to_json({key: results[key]}))
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
