"""The benchmark: every method and engine beside plain references, timed in turns in one run.

    python tools/bench.py                        # on a bundled world
    python tools/bench.py --problem ../problem   # on maps A and B, with the floors in C
    python tools/bench.py --parts engines        # how far engine="auto" is from the best one
    python tools/bench.py --parts localize --sets ../data/*/map.yaml   # on recorded scans, too
    python tools/bench.py --parts memory         # of the command on large maps, up to 25 hectares

Prints Markdown: medians over the repeats with their spread. Compare ratios, not times, between
machines.
"""

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from imgloc.errors import ImglocError
from imgloc.experiments.bench_run import LARGE, PARTS, run_bench
from imgloc.output.json import to_json
from imgloc.report.bench import bench_tables


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
    print(to_json(results) if given.json else bench_tables(results))
    return 0


if __name__ == "__main__":
    sys.exit(main())
