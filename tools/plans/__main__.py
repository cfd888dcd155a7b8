"""Scans of buildings, located on their floor plans and on what `imgloc map plan` makes of them.

    python -m tools.plans                            # 20 scans in each of three buildings
    python -m tools.plans -n 5 --seeds 1 --maps plan,walls
    python -m tools.plans --sheets -n 60             # whole sheets, as other programs make them
    python -m tools.plans --sheets aside,hatched     # of these words
    python -m tools.plans --drawings DIR -n 60       # DXF, SVG and PDF of a folder, without options
    python -m tools.plans --drawings DIR -n 20 --seeds 7001   # other twins and scans
    python -m tools.plans --draw DIR                 # only draw the plans or the sheets

Prints a Markdown table. Right is within 0.5 m and 10 degrees. Buildings are random by their seeds:
walls, doors, windows, stairs; the scans also see furniture that is on no plan, and open doors.
The twin of a drawing has walls off by 3 cm, doors at random, furniture, boxes and people.
"""

import argparse
import os
import re
from collections.abc import Sequence
from pathlib import Path

import cv2

from imgloc.errors import ConfigError
from imgloc.io.files import write_bytes_atomic
from imgloc.io.images import encode_png
from imgloc.plans.vectors import READERS
from tools.plans.drawing import building, draw_plan
from tools.plans.drawings import DRAWINGS_HEAD, measure_drawings, write_dxf
from tools.plans.measure import DRAWN, MAPS, SHEETS_HEAD, measure, measure_sheets, table
from tools.plans.sheets import SHEETS
from tools.script import ended, one_of, parser_of, progress, show, table_lines


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse the command line, measure, print; return the exit code."""
    parser = parser_of("tools.plans", __doc__)
    parser.add_argument("-n", type=int, default=20, help="scans in each building (default: 20)")
    parser.add_argument("--seeds", default="1,2,3", help="of buildings, with commas between")
    parser.add_argument("--maps", default=",".join(MAPS), help="with commas between")
    parser.add_argument(
        "--sheets", nargs="?", const="", metavar="WORDS",
        help="measure whole sheets whose names have one of these words (default: all of them)",
    )  # fmt: skip
    parser.add_argument("--drawings", type=Path, metavar="DIR", help="measure those in a folder")
    parser.add_argument("--draw", type=Path, metavar="DIR", help="draw the plans there instead")
    parser.add_argument("--force", action="store_true", help="overwrite plans that are there")
    given = parser.parse_args(arguments)
    return ended("tools.plans", lambda: run(given))


def run(given: argparse.Namespace) -> int:
    """Measure and print, or draw."""
    maps = given.maps.split(",")
    one_of(maps, MAPS)
    seeds = [int(word) for word in given.seeds.split(",") if word.strip().isdecimal()]
    if not seeds or given.n < 1:
        raise ConfigError("--seeds and -n: expected numbers, and at least one scan")
    if given.drawings is not None:
        paths = sorted(p for p in given.drawings.iterdir() if p.suffix.lower() in READERS)
        with progress("drawings", 2 * len(paths) * given.n) as advance:
            measured = measure_drawings(paths, given.n, advance, seeds[0])
            return show(table_lines(DRAWINGS_HEAD, measured))
    if given.sheets is not None:
        return _sheets(given)
    if given.draw is not None:
        for seed in seeds:
            write_dxf(building(seed), path := given.draw / f"building-{seed}.dxf")
            print(path)
            for how in DRAWN:
                image = draw_plan(
                    building(seed, how.turn), how.resolution, how.style, noise=how.noise
                )
                path = given.draw / f"{how.style}-{seed}-{how.resolution:g}.png"
                write_bytes_atomic(path, encode_png(image), force=given.force)
                print(path)
        return 0
    cv2.setNumThreads(os.cpu_count() or 1)
    with progress("plans", len(seeds) * given.n * len(DRAWN) * len(maps)) as advance:
        return show(table(measure(seeds, given.n, DRAWN, maps, advance)))


def _sheets(given: argparse.Namespace) -> int:
    """Measure or draw whole sheets."""
    words = given.sheets.split(",")
    some = {n: make for n, make in SHEETS.items() if any(word in n for word in words)}
    if given.draw is not None:
        for name, make in some.items():
            path = given.draw / f"{re.sub('[^a-z0-9]+', '-', name)}.png"
            write_bytes_atomic(path, encode_png(make().image), force=given.force)
            print(path)
        return 0
    cv2.setNumThreads(1)
    with progress("sheets", 2 * len(some) * given.n) as advance:
        return show(table_lines(SHEETS_HEAD, measure_sheets(given.n, some, advance)))


if __name__ == "__main__":
    raise SystemExit(main())
