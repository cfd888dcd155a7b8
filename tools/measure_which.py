"""How often does `imgloc which` name the right map? Over the maps of some folders.

    python tools/measure_which.py maps ../data -n 200 --same fr079,fr079_half

Scans are those recorded beside a map (scans.npz, with poses), or simulated in it. Each is asked
of all maps, and again with its own map left out, when `none` or `undecided` are the answers to
give. Maps of one building, named with --same, count as one.
"""

import argparse
import json
import os
import sys
from pathlib import Path

import cv2

from imgloc.cli.console import progress
from imgloc.cli.which import find_maps, names_of
from imgloc.errors import ConfigError, ImglocError
from imgloc.experiments.recorded import scans_beside
from imgloc.experiments.scansets import Sensor, simulate_set
from imgloc.experiments.shares import share
from imgloc.io.maps import load_map
from imgloc.methods import Options
from imgloc.model import LaserScan
from imgloc.pipeline import prepare
from imgloc.which import Fit, choose, fit

SURE = (0.5, 0.9)
"""Probabilities that a map needs to be named, for which the shares are given."""


def main() -> int:
    """Parse the command line, measure, print a JSON object."""
    style = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=style)
    parser.add_argument("folders", type=Path, nargs="+", help="folders of maps")
    parser.add_argument("-n", type=int, default=200, help="scans, spread over the maps")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--range-max", type=float, default=20.0, help="metres")
    parser.add_argument("--same", action="append", default=[], help="names of one building")
    given = parser.parse_args()
    try:
        print(json.dumps(measure(given), indent=1))
    except ImglocError as error:
        print(f"measure_which: error: {error}", file=sys.stderr)
        return error.exit_code
    return 0


def measure(given: argparse.Namespace) -> dict[str, object]:
    """Ask each scan of all maps, and count."""
    if given.n < 1:
        raise ConfigError(f"n must be at least 1, got {given.n}")
    maps = {
        name: path
        for folder in given.folders
        for path, name in zip(find_maps(folder), names_of(find_maps(folder), folder), strict=True)
    }
    buildings = {name: group for group in given.same for name in group.split(",")}
    each = -(-given.n // len(maps))
    scans = {name: scans_of(path, each, given.seed, given.range_max) for name, path in maps.items()}
    asked = [(name, scan) for name, some in scans.items() for scan in some]
    fits: list[dict[str, Fit]] = [{} for _ in asked]
    cv2.setNumThreads(cores := os.cpu_count() or 1)
    with progress("which", len(maps) * len(asked), lines=False) as advance:
        for name, path in maps.items():
            features = prepare(load_map(path), threads=cores)
            for (_, scan), found in zip(asked, fits, strict=True):
                found[name] = fit(features, scan, Options(top=20, threads=cores))
                advance()
    out: dict[str, object] = {"seed": given.seed, "scans": len(asked), "maps": len(maps)}
    for sure in SURE:
        right, wrong, silent = [], [], []
        for (name, _), found in zip(asked, fits, strict=True):
            home = {m for m in maps if buildings.get(m, m) == buildings.get(name, name)}
            verdict = choose(found, sure=sure).verdict
            away = {m: f for m, f in found.items() if m not in home}
            right.append(verdict in home)
            wrong.append(verdict in maps.keys() - home)
            silent.append(not away or choose(away, sure=sure).verdict not in maps)
        out[f"named with {sure:g} or more"] = {
            "right": vars(share(right)),
            "wrong": vars(share(wrong)),
            "silent without its map": vars(share(silent)),
            "not right": [k for k, yes in enumerate(right) if not yes],
        }
    return out


def scans_of(path: Path, n: int, seed: int, range_max: float) -> list[LaserScan]:
    """Scans taken in a map: recorded ones if there are any, else simulated ones."""
    if path.with_name("scans.npz").exists():
        return list(scans_beside(path, n, seed, range_max).scans)
    return list(simulate_set(load_map(path), n, seed, Sensor(range_max=range_max)).scans)


if __name__ == "__main__":
    sys.exit(main())
