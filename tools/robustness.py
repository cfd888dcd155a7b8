"""How robust is `imgloc localize`? Success in each of many conditions, beside the oracle's.

    python tools/robustness.py --out robustness.json        # 20 scans in each of five worlds
    python tools/robustness.py --quick                      # 3 scans in two
    python tools/robustness.py -n 20 --sets ../data/*/map.yaml   # recorded scans instead

The oracle is the same score for every pose, 0.1 m and 1 degree apart, the best refined. Prints a
Markdown table; right is within 0.5 m and 10 degrees.
"""

import argparse
import os
import sys
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

import cv2

from imgloc.cli.answers import to_json
from imgloc.cli.console import progress
from imgloc.cli.options import cut_scan
from imgloc.errors import ImglocError
from imgloc.experiments.robustness import CONDITIONS, Row, recorded_row, robustness
from imgloc.experiments.scansets import sample_set
from imgloc.experiments.worlds import WORLDS
from imgloc.io.maps import load_map
from imgloc.io.output import refuse_existing, write_text_atomic
from imgloc.io.scans import load_scans
from imgloc.pipeline import prepare

QUICK = ("visibility", "curved")
POINTS = 5.0  # that localize may lie behind the oracle


def main() -> int:
    """Parse the command line, measure, print."""
    style = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=style)
    parser.add_argument("--out", type=Path, help="JSON file to write, too")
    parser.add_argument("-n", type=int, help="scans in each world (default: 20)")
    parser.add_argument("--seed", type=int, default=100, help="of poses and noise (default: 100)")
    parser.add_argument("--worlds", default=",".join(WORLDS), help="with commas between")
    parser.add_argument("--sets", type=Path, nargs="*", help="maps with a scans.npz beside them")
    parser.add_argument("--range-max", type=float, default=20.0, help="of recorded scans, metres")
    parser.add_argument("--quick", action="store_true", help="3 scans in two worlds")
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--force", action="store_true", help="overwrite --out")
    given = parser.parse_args()
    worlds = QUICK if given.quick else tuple(given.worlds.split(","))
    n = given.n or (3 if given.quick else 20)
    cv2.setNumThreads(given.threads)
    try:
        if given.out is not None and not given.force:
            refuse_existing(given.out)
        with progress("robustness", n * len(worlds) * len(CONDITIONS), lines=False) as advance:
            rows = robustness(n, given.seed, worlds=worlds, threads=given.threads, advance=advance)
        if given.out is not None:
            results = {
                "n": n,
                "seed": given.seed,
                "worlds": worlds,
                "rows": list(map(asdict, rows)),
            }
            write_text_atomic(given.out, to_json(results) + "\n", force=given.force)
    except ImglocError as error:
        print(f"robustness: error: {error}", file=sys.stderr)
        return error.exit_code
    print(table(rows))
    return 0 if all(row.behind <= POINTS for row in rows) else 1


def on_set(path: Path, n: int, given: argparse.Namespace, advance: Callable[[], None]) -> Row:
    """The row of the scans recorded beside a map."""
    chosen = sample_set(load_scans(path.with_name("scans.npz")), n, given.seed)
    scans = tuple(cut_scan(scan, given.range_max) for scan in chosen.scans)
    chosen, threads = replace(chosen, scans=scans), given.threads
    features = prepare(load_map(path), threads=threads)
    return recorded_row(path.parent.name, features, chosen, threads=threads, advance=advance)


def table(rows: tuple[Row, ...]) -> str:
    """The rows as Markdown."""
    head = "| condition | localize | oracle | points behind | unique | unique, wrong |"
    lines = [head, "|---|---|---|---|---|---|"]
    for row in rows:
        first, best = (
            f"{100 * s.value:.0f} % [{100 * s.low:.0f}, {100 * s.high:.0f}]"
            for s in (row.localize, row.oracle)
        )
        lines.append(
            f"| {row.condition} | {first} | {best} | {row.behind:.0f} | "
            f"{100 * row.unique.value:.0f} % | {row.wrong.hits} of {row.wrong.trials} |"
        )
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
