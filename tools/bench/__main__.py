"""The benchmark: every method and engine beside plain references and C, timed in turns in one run.

    python -m tools.bench                        # on a bundled world
    python -m tools.bench --problem ../problem   # on maps A and B
    python -m tools.bench --parts localize,command --sets ../data/*/map.yaml   # on recorded scans
    python -m tools.bench --parts "" --peers DIR --sets ../data/*/map.yaml  # beside other matchers
    python -m tools.bench --parts huge           # a map of 10,000 x 10,000 cells
    python -m tools.bench --parts localize,command --cells 4000   # on a map of so many a side

Prints Markdown: medians over the repeats with their spread. Compare ratios, not times, between
machines.
"""

import argparse
import json
import os
import platform
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from imgloc import (
    ConfigError,
    LaserScan,
    MapFeatures,
    OccupancyGrid,
    Options,
    ScanSet,
    Sensor,
    load_map,
    load_scans,
    localize,
    prepare,
    save_map,
    save_scans,
    simulate,
)
from imgloc.features.scanpoints import scan_points, scan_xy
from imgloc.geometry import uniform_thetas
from imgloc.likelihoods.cbml import cbml, cbml_o, project
from imgloc.likelihoods.correlate import ENGINES
from imgloc.likelihoods.ght import ght, ght_v
from imgloc.likelihoods.slices import cell_offsets
from imgloc.model import Float32Array, FloatArray, to_json
from imgloc.simulation.worlds import WORLDS, render
from tools.bench.arithmetic import Kernels
from tools.bench.peers import beside
from tools.recorded import recorded_sets
from tools.script import at_least_one, ended, one_of, parser_of, table_lines, take_turns

PARTS = ("costs", "localize", "command", "huge")
"""Stacks and votes beside plain references; answers, beside their arithmetic in C; the command from
a warm cache, and its batch with one worker and two; the largest map."""
HUGE = 10_000
"""Cells of the largest map along a side."""

Row = Mapping[str, Any]


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse the command line, measure, print."""
    parser = parser_of("tools.bench", __doc__)
    add = parser.add_argument
    add("--problem", type=Path, help="folder with mapA, mapB and scans_10m.npz")
    add("--sets", type=Path, nargs="*", default=[], help="maps with a scans.npz beside them")
    add("--range-max", type=float, default=20.0, help="metres, of their scans")
    first = ",".join(PARTS[:2])
    add("--parts", default=first, help=f"of {', '.join(PARTS)}, commas between (default: {first})")
    add("--cells", type=int, help="along a side of the map, and of the one of `huge`")
    add("--peers", type=Path, help="folder of programs that answer, too: see tools/bench/peers.py")
    add("--peer-seconds", type=float, default=12.0, help="of a processor, for each map")
    add("--beams", type=int, default=180, help="readings that a peer gets of a scan, 0 for all")
    add("--repeats", type=int, default=5)
    add("--threads", type=int, default=os.cpu_count() or 1)
    add("--scans", type=int, default=50, help="answers of localize")
    add("--json", action="store_true")
    given = parser.parse_args(arguments)

    def run() -> int:
        results = run_bench(given)
        print(to_json(results) if given.json else bench_tables(results))
        return 0

    return ended("bench", run)


def run_bench(given: argparse.Namespace) -> dict[str, Any]:
    """Measure what the command line asks for, as one set of plain values."""
    problem, repeats, threads = given.problem, given.repeats, given.threads
    at_least_one(repeats=repeats, threads=threads, scans=given.scans)
    parts = given.parts.split(",") if given.parts else []
    one_of(parts, PARTS)
    cv2.setNumThreads(1)  # what has threads says so
    out: dict[str, Any] = {
        "machine": {
            "processor": platform.processor() or platform.machine(), "cores": os.cpu_count(),
            "python": platform.python_version(), "numpy": np.__version__, "opencv": cv2.__version__,
        }
    }  # fmt: skip
    everything = _maps(problem, given.scans, given.cells)
    everything += recorded_sets(given.sets, given.scans, 0, given.range_max)
    if "costs" in parts:
        name, grid, told = everything[0]
        # A scan that sees too little to have normals would give no votes to time.
        seen = [s for s in told.scans if scan_points(s.ranges, s.angles, s.valid).valid.any()]
        features, scan = prepare(grid), seen[0]
        cases = stack_cases(features, scan, threads), vote_cases(features, scan, threads)
        timings = [row for some in cases for row in in_turns(some, repeats)]
        out |= {
            "map": name, "surface_points": len(features.surface),
            "readings": int(scan.valid.sum()), "costs": timings,
        }  # fmt: skip
    if "localize" in parts:
        out["localize"] = {
            name: answer_times(grid, scans.scans[: given.scans], threads, repeats)
            for name, grid, scans in everything
        }
    if "command" in parts:
        out["command"] = {name: command_times(g, told, repeats) for name, g, told in everything}
    if given.peers is not None:
        how = given.peers, given.peer_seconds, given.beams
        out["peers"] = {
            f"{name}, {peer}": row
            for name, grid, told in everything
            for peer, row in beside(grid, told, *how).items()
        }
    if "huge" in parts:
        cells = given.cells or HUGE
        code = f"from tools.bench.__main__ import huge_map; huge_map({cells}, {given.scans})"
        done = subprocess.run((sys.executable, "-c", code), check=True, capture_output=True)  # noqa: S603
        out["huge"] = {f"{cells} x {cells}": json.loads(done.stdout)}
    return out


def _maps(
    problem: Path | None, count: int, cells: int | None
) -> list[tuple[str, OccupancyGrid, ScanSet]]:
    if cells is not None:
        grid = tiled(render(WORLDS["large"](), 0.05), cells)
        return [(f"{cells} x {cells}", grid, simulate(grid, count, 0, Sensor(range_max=20.0)))]
    if problem is None:
        grid = render(WORLDS["large"](), 0.1)
        return [("large", grid, simulate(grid, count, 0, Sensor(range_max=10.0)))]
    scans = load_scans(problem / "scans_10m.npz")
    return [(k, load_map(problem / f"map{k}.yaml"), scans) for k in ("A", "B")]


def bench_tables(results: Mapping[str, Any]) -> str:
    """A Markdown table of each part that was measured by :func:`run_bench`.

    Examples
    --------
    >>> row = {"median_ms": 20.0, "p99_over_median": 1.49, "prepare_s": 1.0}
    >>> row |= {"first_over_median": 2.0, "arithmetic_ms": 6.0}
    >>> print(bench_tables({"machine": {"cores": 2}, "localize": {"A": row}}))
    cores 2
    <BLANKLINE>
    | localize on | ms | p99 / median | first / median | prepare, s | arithmetic in C, ms |
    |---:|---:|---:|---:|---:|---:|
    | A | 20 | 1.49 | 2.00 | 1.00 | 6.0 |
    """
    parts = [", ".join(f"{key} {value}" for key, value in results["machine"].items())]
    for key, (head, cells) in _TABLES.items():
        if (found := results.get(key)) is not None:
            rows = found
            if isinstance(found, dict):
                rows = [{"name": k, **r} for k, r in found.items()]
            parts.append("\n".join(table_lines(head, map(cells, rows), "---:")))
    return "\n\n".join(parts)


_TABLES: Mapping[str, tuple[str, Callable[[Row], Sequence[object]]]] = {
    "costs": (
        "case | ns per | ms | spread",
        lambda r: (
            r["case"], f"{r['ns']:.4f} {r['unit']}", f"{r['ms']:.2f}", f"{100 * r['spread']:.0f} %"
        ),
    ),
    "localize": (
        "localize on | ms | p99 / median | first / median | prepare, s | arithmetic in C, ms",
        lambda r: (
            r["name"], f"{r['median_ms']:.0f}", f"{r['p99_over_median']:.2f}",
            f"{r['first_over_median']:.2f}", f"{r['prepare_s']:.2f}", f"{r['arithmetic_ms']:.1f}",
        ),
    ),
    "command": (
        "command on | help, s | localize --help, s | localize, s | a scan of another building, s | "
        "a scan of batch, ms | one worker / two, of the processor",
        lambda r: (
            r["name"], f"{r['help']:.2f}", f"{r['localize_help']:.2f}", f"{r['localize']:.2f}",
            f"{r['other']:.2f}", f"{r['item_ms']:.0f}", f"{r['one_over_two']:.2f}",
        ),
    ),
    "peers": (
        "peer on | scans | it has right | imgloc has right | ms | imgloc, ms | times as fast",
        lambda r: (
            r["name"], r["scans"], r["right"], r["own"], f"{r['ms']:.0f}", f"{r['own_ms']:.0f}",
            f"{r['ms'] / r['own_ms']:.1f}",
        ),
    ),
    "huge": (
        "cells | prepare, s | answer, s | memory, GB",
        lambda r: (r["name"], f"{r['prepare']:.1f}", f"{r['answer']:.2f}", f"{r['gb']:.2f}"),
    ),
}  # fmt: skip


Case = tuple[str, str, float, Callable[[], object]]
"""Name, unit, units of work of a call, the call."""


def in_turns(cases: Sequence[Case], repeats: int) -> list[Row]:
    """Time cases, each in turn, after one call of each that does not count; a row of each.

    A row has the median of the repeats, for a unit of work and whole, and their spread, as a share.

    A clock of the process does not run while others do, but runs twice as fast for two threads.

    Examples
    --------
    >>> one, = in_turns([("nothing", "call", 1, lambda: None)], 3)
    >>> one["case"], one["unit"]
    ('nothing', 'call')
    """
    at_least_one(repeats=repeats)
    calls = [call for *_, call in cases]
    for call in calls:
        call()
    rows = list[Row]()
    for (name, unit, work, _), s in zip(cases, take_turns(calls, repeats), strict=True):
        median = float(np.median(s))
        times = {"ns": 1e9 * median / work, "ms": 1e3 * median}
        rows.append({"case": name, "unit": unit, **times, "spread": (max(s) - min(s)) / median})
    return rows


def answer_times(
    grid: OccupancyGrid, scans: Sequence[LaserScan], threads: int, repeats: int = 1
) -> dict[str, float]:
    """How long answers take, see :func:`answer_summary`; ConfigError without a scan.

    Of a scan the least of `repeats` counts: the tail is that of the scans, not of the machine.
    `arithmetic_ms`, of :mod:`tools.bench.arithmetic`, is measured between the answers; NaN without
    a C compiler.
    """
    at_least_one(scans=len(scans))
    kernels = Kernels() if shutil.which("cc") else None
    cv2.setNumThreads(threads)
    # Others use the machine, too; but the processor's time of two threads is twice that of one.
    clock = time.process_time if threads == 1 else time.perf_counter
    start = clock()
    features, options = prepare(grid, threads=threads), Options(threads=threads)
    prepared = clock() - start

    def taken(scan: LaserScan) -> float:
        start = clock()
        localize(features, scan, options)
        return 1e3 * (clock() - start)

    def in_c(scan: LaserScan) -> float:
        if kernels is None:
            return float("nan")
        return sum(step.ms for step in kernels.replay(features, scan).values())

    first = taken(scans[0])
    turns = [[(taken(scan), in_c(scan)) for scan in scans] for _ in range(repeats)]
    cv2.setNumThreads(1)
    ms, arithmetic = np.min(turns, axis=0).T
    of_c = {"arithmetic_ms": float(np.median(arithmetic))}
    return answer_summary([first, *ms.tolist()], prepared) | of_c


def answer_summary(ms: Sequence[float], prepare_s: float) -> dict[str, float]:
    """What answers take, the first of all, and `prepare` before it.

    `ms` are milliseconds: of the first answer to a scan, then of later ones to it and to others.

    Examples
    --------
    >>> answer_summary([40.0, 20.0, 20.0, 30.0], 0.5)
    {'median_ms': 20.0, 'p99_over_median': 1.49, 'first_over_median': 2.0, 'prepare_s': 0.5}
    """
    median, high = (float(v) for v in np.percentile(ms[1:], (50, 99)))
    return {
        "median_ms": median, "p99_over_median": high / median, "first_over_median": ms[0] / median,
        "prepare_s": prepare_s,
    }  # fmt: skip


def command_times(grid: OccupancyGrid, scans: ScanSet, repeats: int) -> dict[str, float]:
    """Seconds of the processor that the command takes from a warm cache: of `repeats` the least.

    `other` is a scan of another building.

    Also milliseconds for each scan of a batch with one worker, start and end left out, and how many
    times the processor's time of two workers goes into that of one: half of what two processors of
    their own would gain.
    """

    def taken(*words: str | Path) -> float:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        done = subprocess.run(  # noqa: S603
            (sys.executable, "-m", "imgloc", *words), check=False, capture_output=True, text=True,
            env=os.environ | {"XDG_CACHE_HOME": str(folder), "OMP_NUM_THREADS": "1"},
        )  # fmt: skip
        if done.returncode:
            raise ConfigError(f"imgloc {words[0]}: {_last_line(done.stderr)}")
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime

    bare = replace(scans, poses=None, odom=None)
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        path, one, other = folder / "map.yaml", folder / "one.npz", folder / "other.npz"
        many, elsewhere = folder / "many", render(WORLDS["curved"](), 0.05)
        save_map(path, grid)
        save_scans(one, replace(bare, scans=scans.scans[:1]))
        save_scans(other, ScanSet(simulate(elsewhere, 1, 0, Sensor(range_max=20.0)).scans))
        many.mkdir()
        for k, scan in enumerate(scans.scans):
            save_scans(many / f"{k:04d}.npz", replace(bare, scans=(scan,)))
        cases: dict[str, tuple[str | Path, ...]] = {
            "help": ("--help",), "localize_help": ("localize", "--help"),
            "localize": ("localize", path, one, "--json"),
            "other": ("localize", path, other, "--json"),
            "one": ("batch", path, many, "--workers", "1", "--out"),
            "two": ("batch", path, many, "--workers", "2", "--out"),
        }  # fmt: skip
        turns = [
            {
                name: taken(*words, *([folder / f"{name} {k}"] if words[0] == "batch" else []))
                for name, words in cases.items()
            }
            for k in range(repeats + 1)
        ]
    out = {name: min(turn[name] for turn in turns[1:]) for name in cases}
    one_worker = out.pop("one")
    item = 1e3 * (one_worker - out["localize"]) / max(1, len(scans.scans) - 1)
    return out | {"item_ms": item, "one_over_two": one_worker / out.pop("two")}


def huge_map(size: int, count: int) -> None:
    """Print what a map of `size` cells a side takes, by itself in this process, as JSON.

    The world ``large`` is repeated, in cells of 5 cm: each scan fits equally well in each copy.
    """
    cv2.setNumThreads(1)
    one = render(WORLDS["large"](), 0.05)
    grid, scans = tiled(one, size), simulate(one, max(3, min(count, 5)), 0, Sensor(range_max=20.0))
    start = time.process_time()
    features = prepare(grid)
    prepared, seconds = time.process_time() - start, []
    for scan in scans.scans:
        start = time.process_time()
        localize(features, scan)
        seconds.append(time.process_time() - start)
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9
    answer = float(np.median(seconds))
    sys.stdout.write(json.dumps({"prepare": prepared, "answer": answer, "gb": most}))


HEADINGS = 120
PAIR_HEADINGS = 36


def stack_cases(features: MapFeatures, scan: LaserScan, threads: int) -> list[Case]:
    """The stacks of CBML and CBML-O by every engine, and plain references."""
    thetas, xy = uniform_thetas(2 * np.pi / HEADINGS), scan_xy(scan)[scan.valid]
    cell = features.lattice.resolution
    points = scan_points(scan.ranges, scan.angles, scan.valid)
    image, vmap = features.bmap, features.vmap
    out = np.empty((HEADINGS, *image.shape), np.float32)
    plain = partial(cbml, image, xy, thetas, cell, out=out)
    oriented = partial(cbml_o, vmap, points, thetas, cell, projections=project(vmap), out=out)
    unit, work = "pose and reading", out.size * len(xy)
    slow = uniform_thetas(np.pi)  # two headings of what takes long
    few = work * len(slow) / HEADINGS
    cases: list[Case] = [("Alg. 1 in NumPy", unit, few, partial(gathered, image, xy, slow, cell))]
    for engine in ENGINES:
        if engine not in ("shift", "dft"):
            call = partial(cbml, image, xy, slow, cell, engine=engine)
            cases.append((f"cbml {engine}", unit, few, call))
    for engine in ("shift", "dft", "auto"):
        cases.append((f"cbml {engine}", unit, work, partial(plain, engine=engine)))
        cases.append((f"cbml-o {engine}", unit, work, partial(oriented, engine=engine)))
    if threads > 1:
        more = f"auto, {threads} threads"
        cases.append((f"cbml {more}", unit, work, partial(plain, threads=threads)))
        cases.append((f"cbml-o {more}", unit, work, partial(oriented, threads=threads)))
    return cases


def vote_cases(features: MapFeatures, scan: LaserScan, threads: int) -> list[Case]:
    """The votes of GHT and GHT-V, and Alg. 4 as one ``np.add.at``."""
    points = scan_points(scan.ranges, scan.angles, scan.valid)
    surface, shape = features.surface, features.lattice.shape
    pairs = int(points.valid.sum()) * int(surface.valid.sum())
    args = points, PAIR_HEADINGS, shape, features.lattice.resolution
    out = np.empty((PAIR_HEADINGS, *shape), dtype=np.float32)
    visible = partial(ght_v, surface, features.visibility, *args, out=out)
    cases: list[Case] = [
        ("Alg. 4 by np.add.at", "pair", pairs, partial(added, features, scan)),
        ("ght", "pair", pairs, partial(ght, surface, *args, out=out)),
        ("ght-v", "pair", pairs, visible),
    ]
    if threads > 1:
        many = partial(visible, threads=threads)
        cases.append((f"ght-v, {threads} threads", "pair", pairs, many))
    return cases


def gathered(bmap: Float32Array, xy: FloatArray, thetas: FloatArray, cell: float) -> FloatArray:
    """Alg. 1 in NumPy: for each heading and reading the map under all poses, added up."""
    height, width = bmap.shape
    out = np.zeros((len(thetas), height, width))
    rows, columns = np.indices((height, width))
    for total, offsets in zip(out, cell_offsets(xy, thetas, cell), strict=True):
        for dr, dc in offsets:
            r, c = rows + dr, columns + dc
            on = (r >= 0) & (r < height) & (c >= 0) & (c < width)
            total[on] += bmap[r[on], c[on]]  # Alg. 1, l. 5-6
    return out


def added(features: MapFeatures, scan: LaserScan) -> FloatArray:
    """Alg. 4 in NumPy: where each pair of points votes, all at once, into one stack."""
    points = scan_points(scan.ranges, scan.angles, scan.valid)
    s = features.surface.select(np.flatnonzero(features.surface.valid))
    p = points.select(np.flatnonzero(points.valid))
    height, width = features.lattice.shape
    out = np.zeros((PAIR_HEADINGS, height, width))
    theta = s.alpha[:, None] - p.alpha  # Alg. 4, l. 4
    c, si = np.cos(theta), np.sin(theta)
    x = s.xy[:, :1] - (c * p.xy[:, 0] - si * p.xy[:, 1])  # Alg. 4, l. 5
    y = s.xy[:, 1:] - (si * p.xy[:, 0] + c * p.xy[:, 1])
    k = np.floor(theta * (PAIR_HEADINGS / (2 * np.pi)) + 0.5).astype(int) % PAIR_HEADINGS
    col, row = (np.floor(v / features.lattice.resolution).astype(int) for v in (x, y))
    on = (col >= 0) & (col < width) & (row >= 0) & (row < height)
    np.add.at(out, (k[on], row[on], col[on]), 1.0)
    return out


def tiled(one: OccupancyGrid, size: int) -> OccupancyGrid:
    """A map, repeated or cut to `size` cells a side."""
    times = [-(-size // n) for n in one.occupied.shape]
    occupied, free = (np.tile(v, times)[:size, :size] for v in (one.occupied, one.free))
    return OccupancyGrid(occupied.copy(), free.copy(), one.resolution)


def _last_line(text: str) -> str:
    return (text.strip().splitlines() or ["it did not say why"])[-1]


if __name__ == "__main__":
    sys.exit(main())
