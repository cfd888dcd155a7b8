"""Can answers be trusted? Each of these measurements says its part.

    python -m tools.trust reliability -n 100                          # scans in each world
    python -m tools.trust reliability --sets ../data/*/map.yaml       # and recorded ones
    python -m tools.trust completeness --sets ../data/*/map.yaml      # beside a wider search
    python -m tools.trust fit --sets ../data/*/map.yaml               # constants of trust
    python -m tools.trust precision --sets ../data/*/map.yaml         # covariances
    python -m tools.trust precision --maps ../data/map_*/map.yaml     # and of simulated scans
    python -m tools.trust foreign --sets ../data/*/map.yaml           # scans that are on no map
    python -m tools.trust things --sets ../data/*/map.yaml            # one thing that has changed
    python -m tools.trust which maps ../data --same fr079,fr079_half  # names of maps
    python -m tools.trust thousand maps ../data --full

`python -m tools.trust NAME --help` says more.
"""

import argparse
import json
import math
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from datetime import date
from inspect import getdoc
from itertools import chain
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np

from imgloc import MapFeatures, Options, ScanSet, Sensor, Trust, load_map, prepare, simulate
from imgloc.cli.inputs import maps_in
from imgloc.io.files import refuse_existing, write_bytes_atomic, write_text_atomic
from imgloc.io.folders import find_maps
from imgloc.io.images import encode_png
from imgloc.model import to_json
from imgloc.numbers import FILE
from imgloc.simulation.worlds import WORLDS
from tools.recorded import in_world, recorded_sets
from tools.script import at_least_one, ended, parser_of, progress
from tools.trust.completeness import completeness_table, of_place
from tools.trust.fit import (
    Case,
    cases_at_home,
    cases_away,
    cases_on_floors,
    conditions_table,
    fit_trust,
    listed,
    numbers_of,
    trust_of,
)
from tools.trust.foreign import (
    UNDISTURBED,
    answers,
    at_home,
    floors_of,
    foreign_table,
    name_floors,
    naming_table,
    on_other_floors,
    rooms_and_others,
)
from tools.trust.levels import (
    answers_at_home,
    answers_away,
    draw_stanford,
    fit_spreads,
    held_table,
    numbers_of_levels,
    risk_table,
    stanford_table,
)
from tools.trust.naming import ask_all, bound_all, naming_shares, scans_of
from tools.trust.precision import TRUTH, Precision, knowing, precision, precision_table
from tools.trust.reliability import Judged, draw_reliability, judged, reliability, summary
from tools.trust.things import things
from tools.trust.thousand import ask_thousand, make_thousand

NOISES = (0.01, 0.02, 0.05, 0.1)  # metres
EXACT = (1e-6, 1e-6, 1e-6)  # metres, metres, radians: a pose that scans were simulated at
SURE = (0.5, 0.9)
"""Probabilities that a map needs to be named, for which the shares are given."""
ALL = ",".join(WORLDS)


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse the command line, measure, print; return the exit code."""
    parser = parser_of("tools.trust", __doc__)
    tools = parser.add_subparsers(dest="tool", required=True)
    for run, n, seed, what, *own in TOOLS:
        # A tool is called as its function is, and described as that is.
        name, raw = run.__name__.removeprefix("run_"), argparse.RawDescriptionHelpFormatter
        one = tools.add_parser(name, description=getdoc(run), formatter_class=raw)
        one.set_defaults(run=run)
        one.add_argument("-n", type=int, default=n, help=what)
        one.add_argument("--seed", type=int, default=seed, help="(default: %(default)s)")
        for option in own:
            flag, more = (option, {}) if isinstance(option, str) else option
            one.add_argument(flag, **OPTIONS[flag] | more)
    given = parser.parse_args(arguments)
    return ended(given.tool, lambda: given.run(given))


def to_draw(given: argparse.Namespace) -> None:
    """Refuse a --picture that is there, before the work."""
    if given.picture is not None and not given.force:
        refuse_existing(given.picture)


def buildings_of(given: argparse.Namespace) -> dict[str, str]:
    """The building of each name that --same has."""
    return {name: group for group in given.same for name in group.split(",")}


Work = tuple[Callable[..., Iterator[Any]], tuple[Any, ...]]


def all_of(title: str, jobs: Sequence[Work], workers: int) -> list[Any]:
    """What some functions give with their arguments, in processes."""
    found: list[Any] = []
    pool = ProcessPoolExecutor(workers, mp_context=get_context("spawn"))
    with progress(title, len(jobs)) as advance, pool as some:
        for part in some.map(listed, *zip(*jobs, strict=True)):
            found += part
            advance()
    return found


def write_numbers(made: Callable[[str, str, str], str], by: str) -> None:
    """Put what was fitted into the file of numbers, made of its text, the command and the date."""
    text = made(FILE.read_text("utf-8"), by, date.today().isoformat())
    write_text_atomic(FILE, text, force=True)


def run_reliability(given: argparse.Namespace) -> int:
    """Masses, verdicts and covariances of `imgloc localize` against true poses.

    Scans of each world are also asked of the next one, where nothing is right. Prints a JSON
    object; --picture PNG draws the reliability diagram.
    """
    to_draw(given)
    n, cores = given.n, os.cpu_count() or 1
    at_least_one(n=n)
    sets = recorded_sets(given.sets, n, given.seed, given.range_max)
    cv2.setNumThreads(cores)
    options = Options(threads=cores)
    worlds = {name: in_world(name, n, given.seed) for name in WORLDS}
    maps = {name: prepare(grid) for name, (grid, _) in worlds.items()}
    simulated: dict[str, list[Judged]] = {}
    recorded: dict[str, list[Judged]] = {}
    away: list[Judged] = []
    total = 2 * n * len(worlds) + sum(len(scans) for _, _, scans in sets)
    with progress("trust", total) as advance:
        for name, other in zip(worlds, [*worlds][1:] + [*worlds][:1], strict=True):
            simulated[name] = list(judged(maps[name], worlds[name][1], options, advance))
            away += judged(maps[name], worlds[other][1], options, advance)
        for name, grid, scans in sets:
            recorded[name] = list(judged(prepare(grid, name), scans, options, advance))
    rows, numbers = summary(simulated, recorded, away)
    print(to_json({"n": n, "seed": given.seed, "range_max": given.range_max} | numbers))
    if given.picture is not None:
        told = [a for some in recorded.values() for a in some]
        groups = {"simulated": rows} | ({"recorded": reliability(told)[0]} if told else {})
        write_bytes_atomic(given.picture, encode_png(draw_reliability(groups)), force=given.force)
    return 0


def run_completeness(given: argparse.Namespace) -> int:
    """Does the search list what scores? Its modes beside those of a far wider search.

    The scans of the worlds and sets are disturbed, one in this way and the next in another. A scan
    misses what the wider search finds and no mode is near. Prints a Markdown table.
    """
    at_least_one(n=given.n)
    sets = recorded_sets(given.sets, given.n, given.seed, given.range_max)
    worlds = filter(None, given.worlds.split(","))
    places = [in_world(name, given.n, given.seed) for name in worlds]
    places += [(grid, scans) for _, grid, scans in sets]
    jobs: list[Work] = [
        (of_place, (grid, scans, given.seed, k)) for k, (grid, scans) in enumerate(places)
    ]
    print(completeness_table(all_of("completeness", jobs, given.workers)))
    return 0


def run_fit(given: argparse.Namespace) -> int:
    """The constants of trust, fitted to scans of worlds and recorded sets in every disturbance.

    Prints a JSON object with the constants, on what they were fitted, and the losses: of what was
    fitted to, of buildings that were left out, of the constants as they are now. Then, as Markdown,
    what the constants as they are now make of each condition, and what the fitted ones would.
    With --write they are put into the numbers of imgloc, with this command, its data and the date.
    """
    n, seed, held = given.n, given.seed, given.hold_temperature
    at_least_one(n=n)
    sets = recorded_sets(given.sets, n, seed, given.range_max)
    homes = {name: in_world(name, n, seed) for name in filter(None, given.worlds.split(","))}
    homes |= {name: (grid, scans) for name, grid, scans in sets}
    one = buildings_of(given)
    maps = {name: grid for name, grid, _ in sets}
    maps |= {path.parent.name: load_map(path) for path in given.maps}
    jobs: list[Work] = []
    for name, (grid, scans) in homes.items():
        jobs.append((cases_at_home, (one.get(name, name), grid, scans, seed)))
    for name, grid in maps.items():
        away = [s for home, _, s in sets if one.get(home, home) != one.get(name, name)]
        foreign = [scan for s in away for scan in s.scans[: max(1, n // 4)]]
        jobs.append((cases_away, (one.get(name, name), grid, foreign, max(1, n // 6), seed)))
    jobs += [(cases_on_floors, (seed * 1000 + k, n)) for k in range(given.buildings)]
    cases: list[Case] = all_of("fit", jobs, given.workers)
    now = Trust()
    fit = fit_trust(cases, (now.temperature, now.strain) if held else None)
    print(to_json({"n": n, "seed": seed, "range_max": given.range_max} | asdict(fit)))
    print(conditions_table(cases, now), conditions_table(cases, trust_of(fit)), sep="\n\n")
    if given.write:
        by = f"python -m tools.trust fit -n {n} --seed {seed}" + " --hold-temperature" * held
        write_numbers(lambda *about: numbers_of(fit, *about, held=held), by)
    return 0


def run_precision(given: argparse.Namespace) -> int:
    """Do covariances keep what they claim? Of the answers that are `unique` and right.

    Scans with noise of 1, 2, 5 and 10 cm are simulated: of a full circle in the bundled worlds, of
    180 degrees on the --maps. Recorded poses are taken to be good to 3 cm and 0.4 degrees. Prints a
    Markdown table. Along the view, a positive mean error is a pose too far forward.
    """
    at_least_one(n=given.n)
    worlds = list(filter(None, given.worlds.split(",")))
    most = given.n * (2 if given.known else 1)
    sets = recorded_sets(given.sets, most, given.seed, given.range_max)
    rows: list[Precision] = []

    def measure(
        name: str, features: MapFeatures, told: ScanSet, fit: ScanSet, sigma: float = math.nan
    ) -> None:
        """Measure once as it is and, if so asked, once with the depth that other scans fit."""
        truth = TRUTH if math.isnan(sigma) else EXACT
        rows.append(precision(name, features, told, truth, sigma=sigma))
        if given.known:
            what, options = knowing(features, fit)
            rows.append(precision(f"{name}, {what}", features, told, truth, options, sigma))

    maps = {path.parent.name: prepare(load_map(path)) for path in given.maps}
    total = len(NOISES) * (len(worlds) + len(maps)) + len(sets)
    with progress("precision", total) as advance:
        for name in worlds:
            for sigma in NOISES:
                sensor = Sensor(sigma=sigma, fov=2 * np.pi, rays=361)
                grid, told = in_world(name, given.n, given.seed, sensor, 0.05)
                fit = in_world(name, given.n, given.seed + 1, sensor, 0.05)[1]
                measure(f"{name}, noise of {100 * sigma:g} cm", prepare(grid), told, fit, sigma)
                advance()
        for name, features in maps.items():
            for sigma in NOISES:
                told, fit = (
                    simulate(features.grid, given.n, seed, Sensor(sigma=sigma))
                    for seed in (given.seed, given.seed + 1)
                )
                measure(f"{name}, noise of {100 * sigma:g} cm", features, told, fit, sigma)
                advance()
        for name, grid, scans in sets:
            # Every other scan is for the fit.
            told, fit = (scans.take(range(k, len(scans), 2 if given.known else 1)) for k in (0, 1))
            measure(name, prepare(grid, name), told, fit)
            advance()
    print(precision_table(rows))
    return 0


def run_levels(given: argparse.Namespace) -> int:
    """Protection levels against true poses: the share that they hold, and whom they mislead.

    Prints the spreads that fit the recorded poses, and Markdown tables. First, for each building,
    the share of errors within the levels of 95, 99 and 99.9 %: with spreads fitted to the other
    buildings, and as answers have them. Then Stanford's counts for each condition: the share that
    is available at an alarm limit, answers that mislead, answers that mislead hazardously; once by
    the level of 95 %, once by that of 99.9 %. Last, the share of answers with at least some mass,
    and how many of these are wrong.
    """
    to_draw(given)
    n, seed, few = given.n, given.seed, given.few
    at_least_one(n=n, few=few)
    sets = recorded_sets(given.sets, n, seed, given.range_max)
    one = buildings_of(given)
    jobs: list[Work] = []
    for name, grid, scans in sets:
        called = one.get(name, name)
        foreign = [scan for home, _, s in sets if one.get(home, home) != called
                   for scan in s.scans[: max(1, few // 4)]]  # fmt: skip
        jobs.append((answers_at_home, (called, grid, scans, few, seed)))
        jobs.append((answers_away, (called, grid, foreign, max(1, few // 2), seed)))
    answered = all_of("levels", jobs, given.workers)
    home = [a for a in answered if a.condition == UNDISTURBED]
    fit = fit_spreads(home)
    print(to_json(asdict(fit)))
    tables = held_table(home, fit), *(stanford_table(answered, at) for at in (0, 2))
    print(*tables, risk_table(answered), sep="\n\n")
    if given.picture is not None:
        pixels = draw_stanford(answered)
        write_bytes_atomic(given.picture, encode_png(pixels), force=given.force)
    if given.write:
        by = f"python -m tools.trust levels -n {n} --seed {seed}"
        write_numbers(lambda *about: numbers_of_levels(fit, *about), by)
    return 0


def run_foreign(given: argparse.Namespace) -> int:
    """How often `imgloc localize` is sure, and `imgloc which` names a map, where neither may be.

    Scans of rooms on no map, of other buildings, of other floors of the same building, on mirrored
    plans, and on halves of their own map, with and without a prior; undisturbed scans, too. Prints
    two Markdown tables.
    """
    n, seed = given.n, given.seed
    at_least_one(n=n)
    cv2.setNumThreads(1)
    sets = recorded_sets(given.sets, n, seed, given.range_max)
    buildings = [floors_of(seed * 1000 + k, n) for k in range(given.buildings)]
    grids = {name: grid for name, grid, _ in sets}
    grids |= {path.parent.name: load_map(path) for path in given.maps}
    foreign = {name: scans.scans for name, _, scans in sets}
    same = buildings_of(given)
    rooms = rooms_and_others(grids, foreign, n, seed, same)
    floors = chain.from_iterable(map(on_other_floors, buildings))
    with progress("foreign", 0) as advance:
        found = list(answers(chain(at_home(sets), rooms, floors), advance))
        named = [pair for some in buildings for pair in name_floors(some, advance)]
    tables = [foreign_table(found)] + [naming_table(named)] * bool(named)
    print(*tables, sep="\n\n")
    return 0


def run_things(given: argparse.Namespace) -> int:
    """What does one changed thing cost? Walls that are gone, glass, a cart, crowds, racks.

    Beside the scans with one thing that differs stand undisturbed ones, and those of other floors,
    other buildings, rooms on no map and halves of maps. Nothing is known of their poses, but of
    some also the place, as of plain rooms that are on their map. Prints a Markdown table.
    """
    n, seed = given.n, given.seed
    at_least_one(n=n)
    cv2.setNumThreads(1)
    places = recorded_sets(given.sets, n, seed, given.range_max)
    others = {name: scans.scans for name, _, scans in places}
    places += [(name, *in_world(name, n, seed)) for name in filter(None, given.worlds.split(","))]
    asked = things(places, others, n, seed, buildings=given.buildings, same=buildings_of(given))
    with progress("things", 0) as advance:
        print(foreign_table(list(answers(asked, advance))))
    return 0


def run_which(given: argparse.Namespace) -> int:
    """How often does `imgloc which` name the right map? Over the maps of some folders.

    Scans are those recorded beside a map (scans.npz, with poses), or simulated in it. Each is asked
    of all maps, and again with its own map left out, when `none` or `undecided` are the answers to
    give. Maps of one building, named with --same, count as one. Prints a JSON object.
    """
    maps = {name: path for folder in given.folders for name, path in maps_in(folder, {}).items()}
    buildings = buildings_of(given)
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
    """What it costs to ask a thousand maps, and whether the answers are those of a full search.

    The maps are cut out of those of some folders, turned and mirrored; scans are simulated in some
    of them. Prints a JSON object: seconds of the processor to build the index, to ask one map and
    all, and how many times the one the other is.
    """
    sources = [path for folder in given.folders for path in find_maps(folder)]
    with TemporaryDirectory(prefix="imgloc-") as made, progress("thousand", given.scans) as advance:
        scans = make_thousand(sources, Path(made), given.n, given.scans, given.seed)
        found = ask_thousand(Path(made), scans, full=given.full, advance=advance)
    print(json.dumps(asdict(found) | {"times": found.times}, indent=1))
    return 0


_CORES = os.cpu_count() or 1
#: What tools share, and what the help says of it unless the tool says something else.
OPTIONS: Mapping[str, dict[str, Any]] = {
    "folders": {"type": Path, "nargs": "+", "help": "folders of maps"},
    "--sets": {"type": Path, "nargs": "+", "default": [],
               "help": "maps with a scans.npz beside them"},
    "--range-max": {"type": float, "default": 20.0, "help": "of recorded scans, metres"},
    "--worlds": {"default": ALL, "help": "with commas between"},
    "--maps": {"type": Path, "nargs": "*", "default": [], "help": "more maps, without scans"},
    "--same": {"action": "append", "default": [], "help": "names of one building"},
    "--workers": {"type": int, "default": _CORES},
    "--picture": {"type": Path, "help": "PNG to write"},
    "--force": {"action": "store_true", "help": "overwrite what is written"},
    "--write": {"action": "store_true", "help": "put what is fitted into numbers.json"},
    "--hold-temperature": {
        "action": "store_true", "help": "fit only the log-odds of being elsewhere",
    },
    "--known": {
        "action": "store_true",
        "help": "measure again with the depth of the faces, fitted to as many other scans",
    },
    "--few": {"type": int, "default": 20, "help": "scans of each set, disturbed"},
    "--buildings": {"type": int, "default": 5, "help": "drawn, each with four floors"},
    "--scans": {"type": int, "default": 5},
    "--full": {"action": "store_true", "help": "search all maps to the end, too"},
}  # fmt: skip
#: Function, default of -n, of --seed, what -n counts, and the options of each tool.
TOOLS: Sequence[tuple[Any, ...]] = (
    (run_reliability, 100, 7, "scans of each world or set", "--sets", "--range-max", "--picture",
     "--force"),
    (run_completeness, 40, 7, "scans of each world or set", "--sets", "--range-max", "--worlds",
     "--workers"),
    (run_fit, 30, 5, "scans of each world or set", "--sets", "--range-max", "--worlds", "--maps",
     "--buildings", "--hold-temperature", "--write", "--workers", "--same"),
    (run_precision, 30, 1, "scans of each world, set or map", "--sets", "--range-max", "--worlds",
     ("--maps", {"help": "maps on which scans are simulated"}), "--known"),
    (run_levels, 100, 1, "scans of each set, as they are", ("--sets", {"required": True}),
     "--range-max", "--few", "--write", "--picture", "--force", "--workers", "--same"),
    (run_foreign, 20, 1, "scans of each set and building, and on no map, for each map", "--sets",
     "--range-max", "--maps", "--buildings", "--same"),
    (run_things, 10, 1, "scans of each set, world, floor and room; twice as many of racks",
     "--sets", "--range-max", ("--worlds", {"default": "corridor,visibility"}),
     ("--buildings", {"default": 2}), "--same"),
    (run_which, 200, 0, "scans, spread over the maps", "folders", "--range-max", "--same"),
    (run_thousand, 1000, 0, "maps that are made of them", "folders", "--scans", "--full"),
)  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
