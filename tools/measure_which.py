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
from imgloc.errors import ImglocError
from imgloc.experiments.naming import ask_all, naming_shares, scans_of
from imgloc.which import find_maps, names_of

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
    maps = {
        name: path
        for folder in given.folders
        for path, name in zip(find_maps(folder), names_of(find_maps(folder), folder), strict=True)
    }
    buildings = {name: group for group in given.same for name in group.split(",")}
    asked = scans_of(maps, given.n, given.seed, given.range_max)
    cv2.setNumThreads(cores := os.cpu_count() or 1)
    with progress("which", len(maps) * len(asked), lines=False) as advance:
        fits = ask_all(maps, asked, threads=cores, advance=advance)
    out: dict[str, object] = {"seed": given.seed, "scans": len(asked), "maps": len(maps)}
    for sure in SURE:
        shares = naming_shares(asked, fits, sure=sure, buildings=buildings)
        out[f"named with {sure:g} or more"] = shares
    return out


if __name__ == "__main__":
    sys.exit(main())
