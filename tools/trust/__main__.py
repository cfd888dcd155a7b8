"""Can answers be trusted? Each of six measurements says its part.

    python -m tools.trust reliability -n 100                          # scans in each world
    python -m tools.trust reliability --sets ../data/*/map.yaml       # and recorded ones
    python -m tools.trust robustness --out robustness.json            # 20 scans in five worlds
    python -m tools.trust robustness --quick                          # 3 in two
    python -m tools.trust robustness --sets ../data/*/map.yaml        # recorded scans instead
    python -m tools.trust fit --sets ../data/*/map.yaml               # constants of trust
    python -m tools.trust precision --sets ../data/*/map.yaml         # covariances
    python -m tools.trust scale --sets ../data/*/map.yaml             # calibrate --scans
    python -m tools.trust which maps ../data --same fr079,fr079_half  # names of maps
    python -m tools.trust thousand maps ../data --full

`python -m tools.trust NAME --help` says more.
"""

import argparse
import json
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np

from imgloc.choice import names_of
from imgloc.errors import ConfigError
from imgloc.io.files import refuse_existing, write_bytes_atomic, write_text_atomic
from imgloc.io.folders import find_maps
from imgloc.io.images import encode_png
from imgloc.io.maps import load_map
from imgloc.io.scanset import ScanSet
from imgloc.model import OccupancyGrid, to_json
from imgloc.options import Options, Trust
from imgloc.pipeline import prepare
from imgloc.simulation import Sensor, simulate
from imgloc.worlds import WORLDS, render
from tools.plots import blank
from tools.recorded import scans_beside
from tools.script import ended, parser_of, progress
from tools.trust.fit import (
    Case,
    cases_at_home,
    cases_away,
    conditions_table,
    fit_trust,
    listed,
    trust_of,
)
from tools.trust.naming import ask_all, bound_all, naming_shares, scans_of
from tools.trust.precision import precision, precision_table
from tools.trust.reliability import Judged, draw_reliability, judged, reliability, summary
from tools.trust.robustness import (
    CONDITIONS,
    RobustnessRow,
    recorded_row,
    robustness,
    robustness_table,
)
from tools.trust.scale import scale_rows, scale_table
from tools.trust.thousand import ask_thousand, make_thousand

QUICK = ("visibility", "curved")
POINTS, POINTS_RECORDED = 5.0, 2.0  # that localize may lie behind the oracle
NOISES = (0.01, 0.02, 0.05, 0.1)  # metres
SURE = (0.5, 0.9)
"""Probabilities that a map needs to be named, for which the shares are given."""

RELIABILITY = """Masses, verdicts and covariances of `imgloc localize` against true poses.

Scans of each world are also asked of the next one, where nothing is right. Prints a JSON object;
--picture PNG draws the reliability diagram."""
ROBUSTNESS = """How robust is `imgloc localize`? Success in many conditions, beside the oracle's.

The oracle is the same score, ranked at every pose 0.1 m and 1 degree apart (0.2 m on very large
maps); the best are refined, and join what localize finds. Prints a Markdown table. Right is within
0.5 m and 10 degrees; poses within 0.1 nat of the best are equals, and `ties` are the scans that
have some. Exits with 1 where localize is more than 5 points (2 on recorded scans) behind."""
PRECISION = """Do covariances keep what they claim? Of the answers that are `unique` and right.

Scans of the bundled worlds with noise of 1, 2, 5 and 10 cm, and recorded ones, whose poses are
taken to be good to 3 cm and 0.4 degrees. Prints a Markdown table."""
FIT = """The constants of trust, fitted to scans of worlds and recorded sets in every disturbance.

Prints a JSON object with the constants, on what they were fitted, and the losses: of what was
fitted to, of buildings that were left out, of the constants as they are now. Then, as Markdown,
what the constants as they are now make of each condition, and what the fitted ones would."""
SCALE = """Maps whose cells say another size than they have, before and after `calibrate --scans`.

Of each set some scans are for the calibration, without their poses, and others are localized.
Prints a Markdown table: the scale found, and the shares of scans whose first answer is right."""
WHICH = """How often does `imgloc which` name the right map? Over the maps of some folders.

Scans are those recorded beside a map (scans.npz, with poses), or simulated in it. Each is asked
of all maps, and again with its own map left out, when `none` or `undecided` are the answers to
give. Maps of one building, named with --same, count as one. Prints a JSON object."""

THOUSAND = """What does it cost to ask a thousand maps, and are the answers those of a full search?

The maps are cut out of those of some folders, turned and mirrored; scans are simulated in some of
them. Prints a JSON object: seconds of the processor to build the index, to ask one map and all, and
how many times the one the other is."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse the command line, measure, print; return the exit code."""
    parser, raw = parser_of("tools.trust", __doc__), argparse.RawDescriptionHelpFormatter
    tools = parser.add_subparsers(dest="tool", required=True)
    threads = os.cpu_count() or 1

    one = tools.add_parser("reliability", description=RELIABILITY, formatter_class=raw)
    one.set_defaults(run=run_reliability)
    one.add_argument("-n", type=int, default=100, help="scans of each world or set")
    one.add_argument("--seed", type=int, default=7)
    one.add_argument("--sets", type=Path, nargs="*", default=[], help="maps with scans.npz")
    one.add_argument("--range-max", type=float, default=20.0, help="of recorded scans, metres")
    one.add_argument("--picture", type=Path, help="PNG to write")
    one.add_argument("--force", action="store_true", help="overwrite --picture")

    one = tools.add_parser("robustness", description=ROBUSTNESS, formatter_class=raw)
    one.set_defaults(run=run_robustness)
    one.add_argument("--out", type=Path, help="JSON file to write, too")
    one.add_argument("-n", type=int, help="scans in each world or set (default: 20)")
    one.add_argument("--seed", type=int, default=100, help="of poses and noise (default: 100)")
    one.add_argument("--worlds", help="with commas between (default: all five)")
    one.add_argument("--conditions", help="with commas between (default: all)")
    one.add_argument("--sets", type=Path, nargs="+", help="maps with a scans.npz beside them")
    one.add_argument("--range-max", type=float, default=20.0, help="of recorded scans, metres")
    one.add_argument("--quick", action="store_true", help="-n 3 --worlds visibility,curved")
    one.add_argument("--threads", type=int, default=threads)
    one.add_argument("--force", action="store_true", help="overwrite --out")

    one = tools.add_parser("fit", description=FIT, formatter_class=raw)
    one.set_defaults(run=run_fit)
    one.add_argument("-n", type=int, default=30, help="scans of each world or set")
    one.add_argument("--seed", type=int, default=5)
    one.add_argument("--worlds", default=",".join(WORLDS), help="with commas between")
    one.add_argument("--sets", type=Path, nargs="*", default=[], help="maps with scans.npz")
    one.add_argument("--maps", type=Path, nargs="*", default=[], help="more maps, without scans")
    one.add_argument(
        "--hold-temperature", action="store_true", help="fit only the log-odds of being elsewhere"
    )
    one.add_argument("--workers", type=int, default=threads)
    one.add_argument("--same", action="append", default=[], help="names of one building")
    one.add_argument("--range-max", type=float, default=20.0, help="of recorded scans, metres")

    one = tools.add_parser("precision", description=PRECISION, formatter_class=raw)
    one.set_defaults(run=run_precision)
    one.add_argument("-n", type=int, default=30, help="scans of each world or set")
    one.add_argument("--seed", type=int, default=1)
    one.add_argument("--worlds", default=",".join(WORLDS), help="with commas between")
    one.add_argument("--sets", type=Path, nargs="*", default=[], help="maps with scans.npz")
    one.add_argument("--range-max", type=float, default=20.0, help="of recorded scans, metres")

    one = tools.add_parser("scale", description=SCALE, formatter_class=raw)
    one.set_defaults(run=run_scale)
    one.add_argument("-n", type=int, default=30, help="scans of each set, as many again to fit to")
    one.add_argument("--seed", type=int, default=1)
    one.add_argument("--factors", default="0.9,1.1", help="of the maps, with commas between")
    one.add_argument("--sets", type=Path, nargs="+", required=True, help="maps with scans.npz")
    one.add_argument("--range-max", type=float, default=20.0, help="of the scans, metres")

    one = tools.add_parser("which", description=WHICH, formatter_class=raw)
    one.set_defaults(run=run_which)
    one.add_argument("folders", type=Path, nargs="+", help="folders of maps")
    one.add_argument("-n", type=int, default=200, help="scans, spread over the maps")
    one.add_argument("--seed", type=int, default=0)
    one.add_argument("--range-max", type=float, default=20.0, help="metres")
    one.add_argument("--same", action="append", default=[], help="names of one building")

    one = tools.add_parser("thousand", description=THOUSAND, formatter_class=raw)
    one.set_defaults(run=run_thousand)
    one.add_argument("folders", type=Path, nargs="+", help="folders of maps")
    one.add_argument("-n", type=int, default=1000, help="maps that are made of them")
    one.add_argument("--scans", type=int, default=5)
    one.add_argument("--seed", type=int, default=0)
    one.add_argument("--full", action="store_true", help="search all maps to the end, too")

    given = parser.parse_args(arguments)
    return ended(given.tool, lambda: given.run(given))


def run_reliability(given: argparse.Namespace) -> int:
    """Measure, print and draw."""
    if given.picture is not None:
        if not given.force:
            refuse_existing(given.picture)
        blank(1, 1)  # if it cannot be drawn, say so now
    n, cores = given.n, os.cpu_count() or 1
    if n < 1:
        raise ConfigError(f"n must be at least 1, got {n}")
    sets = {path: scans_beside(path, n, given.seed, given.range_max) for path in given.sets}
    cv2.setNumThreads(cores)
    options = Options(threads=cores)
    maps = {name: prepare(render(world(), 0.1)) for name, world in WORLDS.items()}
    scans = {
        name: simulate(f.grid, n, given.seed, Sensor(), render(WORLDS[name](), 0.01))
        for name, f in maps.items()
    }
    simulated: dict[str, list[Judged]] = {}
    recorded: dict[str, list[Judged]] = {}
    away: list[Judged] = []
    names = list(maps)
    total = 2 * n * len(maps) + sum(map(len, sets.values()))
    with progress("trust", total) as advance:
        for k, name in enumerate(names):
            simulated[name] = list(judged(maps[name], scans[name], options, advance))
            other = names[(k + 1) % len(names)]
            away += judged(maps[name], scans[other], options, advance)
        for path, chosen in sets.items():
            features = prepare(load_map(path), path.parent.name)
            recorded[path.parent.name] = list(judged(features, chosen, options, advance))
    rows, numbers = summary(simulated, recorded, away)
    print(to_json({"n": n, "seed": given.seed, "range_max": given.range_max} | numbers))
    if given.picture is not None:
        told = [a for some in recorded.values() for a in some]
        groups = {"simulated": rows} | ({"recorded": reliability(told)[0]} if told else {})
        write_bytes_atomic(given.picture, encode_png(draw_reliability(groups)), force=given.force)
    return 0


def run_robustness(given: argparse.Namespace) -> int:
    """Measure, print the table; 1 where localize is too far behind the oracle."""
    if given.n is None:
        given.n = 3 if given.quick else 20
    if given.threads < 1:
        raise ConfigError(f"--threads: got {given.threads}, expected at least 1")
    cv2.setNumThreads(given.threads)
    if given.out is not None and not given.force:
        refuse_existing(given.out)
    about, rows = _recorded(given) if given.sets else _simulated(given)
    if given.out is not None:
        results = {"n": given.n, "seed": given.seed, **about, "rows": list(map(asdict, rows))}
        write_text_atomic(given.out, to_json(results) + "\n", force=given.force)
    print(robustness_table(rows))
    most = POINTS_RECORDED if given.sets else POINTS
    return 0 if all(row.behind <= most for row in rows) else 1


def _simulated(given: argparse.Namespace) -> tuple[dict[str, object], tuple[RobustnessRow, ...]]:
    """A row for each condition, and what was asked."""
    worlds = QUICK if given.quick else tuple(WORLDS)
    worlds = worlds if given.worlds is None else tuple(given.worlds.split(","))
    conditions = tuple(CONDITIONS if given.conditions is None else given.conditions.split(","))
    with progress("robustness", given.n * len(worlds) * len(conditions)) as advance:
        rows = robustness(
            given.n, given.seed, worlds=worlds, conditions=conditions, threads=given.threads,
            advance=advance,
        )  # fmt: skip
    return {"worlds": worlds}, rows


def _recorded(given: argparse.Namespace) -> tuple[dict[str, object], tuple[RobustnessRow, ...]]:
    """A row for each recorded set, and what was asked."""
    sets = [scans_beside(path, given.n, given.seed, given.range_max) for path in given.sets]
    names = [path.parent.name for path in given.sets]
    rows = []
    with progress("robustness", sum(map(len, sets))) as advance:
        for name, path, scans in zip(names, given.sets, sets, strict=True):
            features = prepare(load_map(path), name, threads=given.threads)
            rows.append(recorded_row(name, features, scans, threads=given.threads, advance=advance))
    return {"sets": names, "range_max": given.range_max}, tuple(rows)


def run_fit(given: argparse.Namespace) -> int:
    """Lay scans on maps, at home and away, and fit."""
    n, seed = given.n, given.seed
    if n < 1:
        raise ConfigError(f"n must be at least 1, got {n}")
    homes: dict[str, tuple[OccupancyGrid, ScanSet]] = {}
    for name in filter(None, given.worlds.split(",")):
        grid, fine = render(WORLDS[name](), 0.1), render(WORLDS[name](), 0.01)
        homes[name] = grid, simulate(grid, n, seed, Sensor(), fine)
    for path in given.sets:
        scans = scans_beside(path, n, seed, given.range_max)
        homes[path.parent.name] = load_map(path), scans
    others = {path.parent.name: load_map(path) for path in given.maps}
    one = {name: group for group in given.same for name in group.split(",")}
    recorded = [path.parent.name for path in given.sets]
    maps = {name: homes[name][0] for name in recorded} | others
    jobs: list[tuple[Callable[..., Iterator[Case]], tuple[Any, ...]]] = []
    for name, (grid, scans) in homes.items():
        jobs.append((cases_at_home, (one.get(name, name), grid, scans, seed)))
    for name, grid in maps.items():
        away = [r for r in recorded if one.get(r, r) != one.get(name, name)]
        foreign = [s for r in away for s in homes[r][1].scans[: max(1, n // 4)]]
        jobs.append((cases_away, (one.get(name, name), grid, foreign, max(1, n // 6), seed)))
    cases: list[Case] = []
    pool = ProcessPoolExecutor(given.workers, mp_context=get_context("spawn"))
    with progress("fit", len(jobs)) as advance, pool as workers:
        for some in workers.map(listed, *zip(*jobs, strict=True)):
            cases += some
            advance()
    held = None
    if given.hold_temperature:
        held = Trust().temperature, Trust().strain
    fit = fit_trust(cases, held)
    print(to_json({"n": n, "seed": seed, "range_max": given.range_max} | asdict(fit)))
    print(conditions_table(cases, Trust()), conditions_table(cases, trust_of(fit)), sep="\n\n")
    return 0


def run_precision(given: argparse.Namespace) -> int:
    """Measure covariances, print the table."""
    if given.n < 1:
        raise ConfigError(f"n must be at least 1, got {given.n}")
    worlds = list(filter(None, given.worlds.split(",")))
    sets = {p: scans_beside(p, given.n, given.seed, given.range_max) for p in given.sets}
    rows = []
    with progress("precision", len(NOISES) * len(worlds) + len(sets)) as advance:
        for name in worlds:
            grid, fine = render(WORLDS[name](), 0.05), render(WORLDS[name](), 0.01)
            features = prepare(grid)
            for sigma in NOISES:
                sensor = Sensor(sigma=sigma, fov=2 * np.pi, rays=361)
                scans = simulate(grid, given.n, given.seed, sensor, fine)
                said = f"{name}, noise of {100 * sigma:g} cm"
                rows.append(precision(said, features, scans, truth=(1e-6, 1e-6, 1e-6)))
                advance()
        for path, scans in sets.items():
            name = path.parent.name
            rows.append(precision(name, prepare(load_map(path), name), scans))
            advance()
    print(precision_table(rows))
    return 0


def run_scale(given: argparse.Namespace) -> int:
    """Calibrate maps of a wrong scale, print the table."""
    factors = [float(text) for text in given.factors.split(",")]
    rows = []
    with progress("scale", len(factors) * len(given.sets)) as advance:
        for path in given.sets:
            scans = scans_beside(path, 2 * given.n, given.seed, given.range_max)
            known, asked = (scans.take(range(k, len(scans), 2)) for k in (0, 1))
            rows += scale_rows(path.parent.name, load_map(path), known, asked, factors, advance)
    print(scale_table(rows))
    return 0


def run_which(given: argparse.Namespace) -> int:
    """Ask each scan of all maps, and count."""
    maps = {
        name: path
        for folder in given.folders
        for path, name in zip(find_maps(folder), names_of(find_maps(folder), folder), strict=True)
    }
    buildings = {name: group for group in given.same for name in group.split(",")}
    asked = scans_of(maps, given.n, given.seed, given.range_max)
    cv2.setNumThreads(cores := os.cpu_count() or 1)
    with progress("which", len(maps) * len(asked)) as advance:
        fits = ask_all(maps, asked, threads=cores, advance=advance)
    bounds = bound_all(maps, asked, threads=cores)
    out: dict[str, object] = {"seed": given.seed, "scans": len(asked), "maps": len(maps)}
    for sure in SURE:
        shares = naming_shares(asked, fits, bounds, sure=sure, buildings=buildings)
        out[f"named with {sure:g} or more"] = shares
    print(json.dumps(out, indent=1))
    return 0


def run_thousand(given: argparse.Namespace) -> int:
    """Make maps, ask them, and count."""
    sources = [path for folder in given.folders for path in find_maps(folder)]
    with TemporaryDirectory(prefix="imgloc-") as made, progress("thousand", given.scans) as advance:
        scans = make_thousand(sources, Path(made), given.n, given.scans, given.seed)
        found = ask_thousand(Path(made), scans, full=given.full, advance=advance)
    print(json.dumps(asdict(found) | {"times": found.times}, indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
