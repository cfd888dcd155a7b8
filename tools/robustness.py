"""How robust is `imgloc localize`? Success in each of many conditions, beside the oracle's.

    python tools/robustness.py --out robustness.json        # 20 scans in each of five worlds
    python tools/robustness.py --quick                      # 3 scans in two
    python tools/robustness.py -n 20 --sets ../data/*/map.yaml   # recorded scans instead

The oracle is the same score, ranked at every pose 0.1 m and 1 degree apart (0.2 m on very large
maps); the best are refined, and join what localize finds. Prints a Markdown table. Right is within
0.5 m and 10 degrees; poses within 0.1 nat of the best are equals, and `ties` are the scans that
have some. Exits with 1 where localize is more than 5 points behind the oracle, 2 on recorded scans.
"""

import argparse
import os
import sys
from dataclasses import asdict
from pathlib import Path

import cv2

from imgloc.cli.console import progress
from imgloc.cli.inputs import check_target
from imgloc.errors import ConfigError, ImglocError
from imgloc.experiments.conditions import CONDITIONS
from imgloc.experiments.recorded import scans_beside
from imgloc.experiments.robustness import Row, recorded_row, robustness
from imgloc.io.maps import load_map
from imgloc.io.output import write_text_atomic
from imgloc.output.json import to_json
from imgloc.pipeline import prepare
from imgloc.report.robustness import robustness_table
from imgloc.worlds import WORLDS

QUICK = ("visibility", "curved")
POINTS, POINTS_RECORDED = 5.0, 2.0  # that localize may lie behind the oracle


def main() -> int:
    """Parse the command line, measure, print."""
    style = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=style)
    parser.add_argument("--out", type=Path, help="JSON file to write, too")
    parser.add_argument("-n", type=int, help="scans in each world or set (default: 20)")
    parser.add_argument("--seed", type=int, default=100, help="of poses and noise (default: 100)")
    parser.add_argument("--worlds", help="with commas between (default: all five)")
    parser.add_argument("--conditions", help="with commas between (default: all)")
    parser.add_argument("--sets", type=Path, nargs="+", help="maps with a scans.npz beside them")
    parser.add_argument("--range-max", type=float, default=20.0, help="of recorded scans, metres")
    parser.add_argument("--quick", action="store_true", help="-n 3 --worlds visibility,curved")
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--force", action="store_true", help="overwrite --out")
    given = parser.parse_args()
    if given.n is None:
        given.n = 3 if given.quick else 20
    cv2.setNumThreads(given.threads)
    try:
        if given.out is not None:
            check_target(given.out, ".json", force=given.force)
        about, rows = recorded(given) if given.sets else simulated(given)
        if given.out is not None:
            results = {"n": given.n, "seed": given.seed, **about, "rows": list(map(asdict, rows))}
            write_text_atomic(given.out, to_json(results) + "\n", force=given.force)
    except ImglocError as error:
        print(f"robustness: error: {error}", file=sys.stderr)
        return error.exit_code
    print(robustness_table(rows))
    most = POINTS_RECORDED if given.sets else POINTS
    return 0 if all(row.behind <= most for row in rows) else 1


def simulated(given: argparse.Namespace) -> tuple[dict[str, object], tuple[Row, ...]]:
    """A row for each condition, and what was asked."""
    worlds = QUICK if given.quick else tuple(WORLDS)
    worlds = worlds if given.worlds is None else tuple(given.worlds.split(","))
    conditions = tuple(CONDITIONS if given.conditions is None else given.conditions.split(","))
    if given.threads < 1:
        raise ConfigError(f"--threads: got {given.threads}, expected at least 1")
    with progress("robustness", given.n * len(worlds) * len(conditions), lines=False) as advance:
        asked = {"worlds": worlds, "conditions": conditions, "threads": given.threads}
        rows = robustness(given.n, given.seed, **asked, advance=advance)
    return {"worlds": worlds}, rows


def recorded(given: argparse.Namespace) -> tuple[dict[str, object], tuple[Row, ...]]:
    """A row for each recorded set, and what was asked."""
    sets = [scans_beside(path, given.n, given.seed, given.range_max) for path in given.sets]
    names = [path.parent.name for path in given.sets]
    rows = []
    with progress("robustness", sum(map(len, sets)), lines=False) as advance:
        for name, path, scans in zip(names, given.sets, sets, strict=True):
            features = prepare(load_map(path), name, threads=given.threads)
            rows.append(recorded_row(name, features, scans, threads=given.threads, advance=advance))
    return {"sets": names, "range_max": given.range_max}, tuple(rows)


if __name__ == "__main__":
    sys.exit(main())
