"""Can `imgloc localize` be trusted? Masses, verdicts and covariances against true poses.

    python tools/trust.py -n 100                            # scans in each bundled world
    python tools/trust.py -n 100 --sets ../data/*/map.yaml  # and recorded ones, beside their maps

Scans of each world are also asked of the next one, where nothing is right. Writes a JSON object;
--picture PNG draws the reliability diagram.
"""

import argparse
import os
import sys
from dataclasses import asdict
from pathlib import Path

import cv2
import numpy as np

from imgloc.cli.answers import to_json
from imgloc.cli.console import progress
from imgloc.draw.reliability import draw_reliability
from imgloc.experiments.reliability import (
    Judged,
    count_verdicts,
    judged,
    mean_nees,
    reliability,
)
from imgloc.experiments.scansets import Sensor, sample_set, simulate_set
from imgloc.experiments.shares import share
from imgloc.experiments.worlds import WORLDS, render
from imgloc.io.maps import load_map
from imgloc.io.output import encode_png, write_bytes_atomic
from imgloc.io.scans import load_scans
from imgloc.methods import Options
from imgloc.pipeline import prepare


def main() -> int:
    """Parse the command line, measure, print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("-n", type=int, default=100, help="scans of each world or set")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--sets", type=Path, nargs="*", default=[], help="maps with scans.npz")
    parser.add_argument("--picture", type=Path, help="PNG to write")
    parser.add_argument("--force", action="store_true", help="overwrite --picture")
    given = parser.parse_args()
    cores = os.cpu_count() or 1
    cv2.setNumThreads(cores)
    options, n = Options(threads=cores), given.n
    maps = {name: prepare(render(world(), 0.1)) for name, world in WORLDS.items()}
    scans = {
        name: simulate_set(f.grid, n, given.seed, Sensor(), render(WORLDS[name](), 0.01))
        for name, f in maps.items()
    }
    simulated: dict[str, list[Judged]] = {}
    recorded: dict[str, list[Judged]] = {}
    away: list[Judged] = []
    names = list(maps)
    with progress("trust", n * (2 * len(maps) + len(given.sets)), lines=False) as advance:
        for k, name in enumerate(names):
            simulated[name] = list(judged(maps[name], scans[name], options, advance))
            other = names[(k + 1) % len(names)]
            away += judged(maps[name], scans[other], options, advance)
        for path in given.sets:
            chosen = sample_set(load_scans(path.with_name("scans.npz")), n, given.seed)
            features = prepare(load_map(path))
            recorded[path.parent.name] = list(judged(features, chosen, options, advance))
    all_simulated = [a for some in simulated.values() for a in some]
    all_recorded = [a for some in recorded.values() for a in some]
    rows, ece = reliability(all_simulated)
    sure = np.concatenate([a.right[a.mass >= 0.8] for a in all_simulated])
    out = {
        "n": n, "seed": given.seed,
        "ece": ece, "bins": [asdict(row) for row in rows],
        "right of mass 0.8 and more": asdict(share(sure)),
        "unique but wrong, simulated": asdict(share(a.wrong for a in all_simulated)),
        "unique but wrong, recorded": asdict(share(a.wrong for a in all_recorded)),
        "not unique in another map": asdict(share(a.verdict != "unique" for a in away)),
        "nees": {name: mean_nees(some) for name, some in simulated.items()},
        "nees of all": mean_nees(all_simulated),
        "recorded": {
            name: {"ece": reliability(some)[1], "verdicts": count_verdicts(some)}
            for name, some in recorded.items()
        },
    }  # fmt: skip
    print(to_json(out))
    if given.picture is not None:
        groups = {"simulated": rows} | (
            {"recorded": reliability(all_recorded)[0]} if recorded else {}
        )
        write_bytes_atomic(given.picture, encode_png(draw_reliability(groups)), force=given.force)
    return 0


if __name__ == "__main__":
    sys.exit(main())
