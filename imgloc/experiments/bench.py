"""The benchmark: ratios of things timed in turns in one run.

Every case is a function without arguments that does a known amount of work. All cases of a
group take turns, so that a busy moment of the machine is in the times of all of them.
"""

import json
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from imgloc.errors import ConfigError
from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.scanpoints import scan_points
from imgloc.geometry import uniform_thetas
from imgloc.likelihood.cbml import cbml, cbml_o
from imgloc.likelihood.ght import ght, ght_v
from imgloc.likelihood.projections import project
from imgloc.likelihood.slices import cell_offsets
from imgloc.methods import Options
from imgloc.model import Float32Array, FloatArray, LaserScan, OccupancyGrid
from imgloc.pipeline import localize, prepare
from imgloc.search.branch_and_bound import best_poses
from imgloc.search.fused import scan_xy

HEADINGS = 120
PAIR_HEADINGS = 36


@dataclass(frozen=True)
class Timing:
    """How long a case took.

    Parameters
    ----------
    name, unit : str
    work : float
        Units of work of one call: poses times readings, pairs, or 1.
    seconds : tuple of float
        Of each repeat.
    """

    name: str
    unit: str
    work: float
    seconds: tuple[float, ...]

    @property
    def median(self) -> float:
        """Median of the repeats, seconds."""
        return float(np.median(self.seconds))

    @property
    def cost(self) -> float:
        """Nanoseconds per unit of work."""
        return 1e9 * self.median / self.work


Case = tuple[str, str, float, Callable[[], object]]
"""Name, unit, units of work of a call, the call."""


def in_turns(cases: Sequence[Case], repeats: int) -> tuple[Timing, ...]:
    """Time cases, each in turn, after one call of each that does not count.

    Raises
    ------
    ConfigError
        If there is to be no repeat.

    Examples
    --------
    >>> one, = in_turns([("nothing", "call", 1, lambda: None)], 3)
    >>> one.name, len(one.seconds)
    ('nothing', 3)
    """
    if repeats < 1:
        raise ConfigError(f"repeats must be at least 1, got {repeats}")
    for *_, call in cases:
        call()
    seconds: dict[str, list[float]] = {name: [] for name, *_ in cases}
    for _ in range(repeats):
        for name, _, _, call in cases:
            start = time.perf_counter()
            call()
            seconds[name].append(time.perf_counter() - start)
    return tuple(Timing(name, unit, work, tuple(seconds[name])) for name, unit, work, _ in cases)


def stack_cases(features: MapFeatures, scan: LaserScan, threads: int) -> list[Case]:
    """The stacks of CBML and CBML-O by every engine, branch and bound, and plain references."""
    thetas = uniform_thetas(2 * np.pi / HEADINGS)
    cell, xy = features.lattice.resolution, scan_xy(scan)[scan.valid]
    points = scan_points(scan.ranges, scan.angles, scan.valid)
    bmap, vmap, free = features.bmap, features.vmap, features.free
    pooled, projections = features.pooled, project(vmap)
    out = np.empty((HEADINGS, *bmap.shape), np.float32)
    work = out.size * len(xy)
    slow = uniform_thetas(np.pi)  # two headings of what takes long
    few = work * len(slow) / HEADINGS

    def one(engine: str, workers: int) -> Callable[[], object]:
        return lambda: cbml(bmap, xy, thetas, cell, engine=engine, threads=workers, out=out)

    def oriented(engine: str, workers: int) -> Callable[[], object]:
        return lambda: cbml_o(
            vmap, points, thetas, cell, engine=engine, threads=workers, out=out,
            projections=projections,
        )  # fmt: skip

    unit = "pose and reading"
    cases: list[Case] = [
        ("Alg. 1 as printed, NumPy", unit, few, lambda: gathered(bmap, xy, slow, cell)),
        ("cbml filter2d", unit, few, lambda: cbml(bmap, xy, slow, cell, engine="filter2d")),
    ]
    for engine in ("shift", "dft", "auto"):
        cases.append((f"cbml {engine}", unit, work, one(engine, 1)))
        cases.append((f"cbml-o {engine}", unit, work, oriented(engine, 1)))
    if threads > 1:
        cases.append((f"cbml auto, {threads} threads", unit, work, one("auto", threads)))
        cases.append((f"cbml-o auto, {threads} threads", unit, work, oriented("auto", threads)))
    cases.append(
        (
            "cbml auto, free cells, argmax", unit, work,
            lambda: int(cbml(bmap, xy, thetas, cell, where=free, out=out).argmax()),
        )
    )  # fmt: skip
    cases.append(("branch and bound, argmax", unit, work, lambda: best_poses(pooled, xy, thetas)))
    return cases


def vote_cases(features: MapFeatures, scan: LaserScan, threads: int) -> list[Case]:
    """The votes of GHT and GHT-V, and Alg. 4 as one ``np.add.at``."""
    points = scan_points(scan.ranges, scan.angles, scan.valid)
    surface, visibility = features.surface, features.visibility
    shape, cell = features.lattice.shape, features.lattice.resolution
    pairs = int(points.valid.sum()) * int(surface.valid.sum())
    args = points, PAIR_HEADINGS, shape, cell
    cases: list[Case] = [
        ("Alg. 4 by np.add.at", "pair", pairs, lambda: added(features, scan)),
        ("ght", "pair", pairs, lambda: ght(surface, *args)),
        ("ght-v", "pair", pairs, lambda: ght_v(surface, visibility, *args)),
    ]
    if threads > 1:
        many = threads
        cases.append(
            (
                f"ght-v, {many} threads", "pair", pairs,
                lambda: ght_v(surface, visibility, *args, threads=many),
            )
        )  # fmt: skip
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


def floors(problem: Path) -> Mapping[str, float | str]:
    """What hand-written C takes, ns per unit of work, on one thread; or why it is not known.

    Parameters
    ----------
    problem : Path
        Folder with ``floor/cbml.c``, ``floor/ght.c``, ``mapA.pgm`` and ``scans_10m.txt``.
    """
    compiler = shutil.which("cc")
    out: dict[str, float | str] = {}
    for name, arguments, pattern in (
        ("cbml", ("0.1", "0.1", str(HEADINGS), "0", "10", "1"), r"([\d.]+) ns per pose"),
        ("ght", ("0.1", str(PAIR_HEADINGS), "2", "10"), r"([\d.]+) ns/pair"),
        ("ght-v", ("0.1", str(PAIR_HEADINGS), "12", "10"), r"([\d.]+) ns/pair"),
    ):
        source = problem / "floor" / f"{name.removesuffix('-v')}.c"
        if compiler is None or not source.exists():
            out[name] = "no C compiler" if compiler is None else f"no {source.name}"
            continue
        with tempfile.TemporaryDirectory() as folder:
            program = Path(folder) / name
            flags = ["-O3", "-march=native", "-ffast-math", "-w"]
            build = [compiler, *flags, str(source), "-o", str(program), "-lm", "-lpthread"]
            subprocess.run(build, check=True, capture_output=True)  # noqa: S603
            command = [str(program), str(problem / "mapA.pgm"), str(problem / "scans_10m.txt")]
            done = subprocess.run(  # noqa: S603
                [*command, *arguments], check=False, capture_output=True, text=True
            )
        found = re.search(pattern, done.stdout)
        out[name] = float(found[1]) if found else f"not understood: {done.stdout[:80]!r}"
    return out


def answer_times(grid: OccupancyGrid, scans: Sequence[LaserScan], threads: int) -> dict[str, float]:
    """Milliseconds of each answer after the first, and seconds to prepare the map."""
    features, options = prepare(grid, threads=threads), Options(threads=threads)
    cv2.setNumThreads(threads)
    ms = []
    for one in (scans[0], *scans):
        start = time.perf_counter()
        localize(features, one, options)
        ms.append(1e3 * (time.perf_counter() - start))
    cv2.setNumThreads(1)
    median, high = (float(v) for v in np.percentile(ms[1:], (50, 99)))
    return {"median_ms": median, "p99_over_median": high / median, "prepare_s": ms[0] / 1e3}


def as_row(timing: Timing) -> dict[str, object]:
    """A timing as plain values."""
    spread = (max(timing.seconds) - min(timing.seconds)) / timing.median
    return {
        "case": timing.name, "unit": timing.unit, "ns": timing.cost,
        "ms": 1e3 * timing.median, "spread": spread,
    }  # fmt: skip


def growth(world: str, times: Sequence[int], repeats: int) -> tuple[Mapping[str, float], ...]:
    """Time and memory of `localize` on a world tiled 1, 4, 16 ... times, each in a fresh process.

    Parameters
    ----------
    world : str
        Of :data:`imgloc.experiments.worlds.WORLDS`.
    times : sequence of int
        Tiles along each side.
    repeats : int
        Answers, of which the median counts.

    Returns
    -------
    tuple of mappings
        ``area`` in m², ``ms`` of an answer, ``prepare_s``, ``rss_mib`` at the peak.
    """
    rows = []
    for side in times:
        command = [sys.executable, "-c", _GROW, world, str(side), str(repeats)]
        done = subprocess.run(command, check=True, capture_output=True, text=True)  # noqa: S603
        rows.append(json.loads(done.stdout))
    return tuple(rows)


_GROW = """
import json, re, resource, sys, time
from pathlib import Path
import numpy as np
from imgloc.experiments.scansets import Sensor, simulate_set
from imgloc.experiments.worlds import WORLDS, render
from imgloc.model import OccupancyGrid
from imgloc.pipeline import localize, prepare
world, side, repeats = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
one = render(WORLDS[world](), 0.1)
scans = simulate_set(one, repeats + 1, 0, Sensor(range_max=10.0))
grid = OccupancyGrid(np.tile(one.occupied, (side, side)), np.tile(one.free, (side, side)), 0.1)
features = prepare(grid)
start = time.perf_counter()
localize(features, scans.scans[0])
first = time.perf_counter() - start
seconds = []
for scan in scans.scans[1:]:
    start = time.perf_counter()
    localize(features, scan)
    seconds.append(time.perf_counter() - start)
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
status = Path("/proc/self/status")
if status.exists():  # ru_maxrss begins with what the parent had
    peak = int(re.search(r"VmHWM:\\s+(\\d+)", status.read_text())[1]) / 1024
area = grid.occupied.size * 0.01
print(json.dumps({"area": area, "ms": 1e3 * float(np.median(seconds)),
                  "prepare_s": first - float(np.median(seconds)), "rss_mib": peak}))
"""
