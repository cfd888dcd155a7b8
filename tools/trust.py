"""Can `imgloc localize` be trusted? Masses, verdicts and covariances against true poses.

    python tools/trust.py -n 100                            # scans in each bundled world
    python tools/trust.py -n 100 --sets ../data/*/map.yaml  # and recorded ones, beside their maps

Scans of each world are also asked of the next one, where nothing is right. Writes a JSON object;
--picture PNG draws the reliability diagram.
"""

import argparse
import os
import sys
from pathlib import Path

import cv2

from imgloc.cli.console import progress
from imgloc.cli.inputs import check_target
from imgloc.draw.reliability import draw_reliability
from imgloc.errors import ConfigError, ImglocError
from imgloc.experiments.recorded import scans_beside
from imgloc.experiments.reliability import Judged, judged, reliability, summary
from imgloc.io.maps import load_map
from imgloc.io.output import encode_png, write_bytes_atomic
from imgloc.methods import Options
from imgloc.output.json import to_json
from imgloc.pipeline import prepare
from imgloc.simulate import Sensor, simulate_set
from imgloc.worlds import WORLDS, render


def main() -> int:
    """Parse the command line, measure, print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("-n", type=int, default=100, help="scans of each world or set")
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--sets", type=Path, nargs="*", default=[], help="maps with scans.npz")
    parser.add_argument("--range-max", type=float, default=20.0, help="of recorded scans, metres")
    parser.add_argument("--picture", type=Path, help="PNG to write")
    parser.add_argument("--force", action="store_true", help="overwrite --picture")
    given = parser.parse_args()
    try:
        if given.picture is not None:
            check_target(given.picture, ".png", force=given.force)
        measure(given)
    except ImglocError as error:
        print(f"trust: error: {error}", file=sys.stderr)
        return error.exit_code
    return 0


def measure(given: argparse.Namespace) -> None:
    """Measure, print and draw."""
    n, sets = given.n, {}
    if n < 1:
        raise ConfigError(f"n must be at least 1, got {n}")
    for path in given.sets:
        sets[path] = scans_beside(path, n, given.seed, given.range_max)
    cores = os.cpu_count() or 1
    cv2.setNumThreads(cores)
    options = Options(threads=cores)
    maps = {name: prepare(render(world(), 0.1)) for name, world in WORLDS.items()}
    scans = {
        name: simulate_set(f.grid, n, given.seed, Sensor(), render(WORLDS[name](), 0.01))
        for name, f in maps.items()
    }
    simulated: dict[str, list[Judged]] = {}
    recorded: dict[str, list[Judged]] = {}
    away: list[Judged] = []
    names = list(maps)
    total = 2 * n * len(maps) + sum(map(len, sets.values()))
    with progress("trust", total, lines=False) as advance:
        for k, name in enumerate(names):
            simulated[name] = list(judged(maps[name], scans[name], options, advance))
            other = names[(k + 1) % len(names)]
            away += judged(maps[name], scans[other], options, advance)
        for path, chosen in sets.items():
            features = prepare(load_map(path), path.parent.name)
            recorded[path.parent.name] = list(judged(features, chosen, options, advance))
    rows, numbers = summary(simulated, recorded, away)
    about = {"n": n, "seed": given.seed, "range_max": given.range_max}
    print(to_json(about | numbers))
    if given.picture is not None:
        told = [a for some in recorded.values() for a in some]
        groups = {"simulated": rows} | ({"recorded": reliability(told)[0]} if told else {})
        write_bytes_atomic(given.picture, encode_png(draw_reliability(groups)), force=given.force)


if __name__ == "__main__":
    sys.exit(main())
