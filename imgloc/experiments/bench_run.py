"""A run of the benchmark: what is measured on which maps, as one set of plain values."""

import os
import platform
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from imgloc.errors import ConfigError
from imgloc.experiments.bench import answer_times, as_row, in_turns
from imgloc.experiments.bench_cases import stack_cases, vote_cases
from imgloc.experiments.bench_engines import engine_rows, engine_summary
from imgloc.experiments.bench_outside import floors, growth, memory
from imgloc.experiments.complexity import fit_exponent
from imgloc.experiments.recorded import scans_beside
from imgloc.io.maps import load_map
from imgloc.io.scans import load_scans
from imgloc.io.scanset import ScanSet
from imgloc.model import OccupancyGrid
from imgloc.pipeline import prepare
from imgloc.simulate import Sensor, simulate_set
from imgloc.worlds import WORLDS, render

PARTS = ("costs", "engines", "localize", "growth")
"""What is measured by default."""

LARGE = "memory"
"""What takes gigabytes, and is measured if it is asked for."""

SIDES = (4_000, 10_000)
"""Cells along a side of the large maps, of 5 cm."""

BOUND_SCANS = 10
"""Scans of branch and bound, which is faster or slower as they are more or less clear."""


def run_bench(
    problem: Path | None,
    *,
    sets: Sequence[Path] = (),
    parts: tuple[str, ...] = PARTS,
    repeats: int,
    threads: int,
    scans: int,
    range_max: float = 20.0,
) -> dict[str, Any]:
    """Measure.

    Parameters
    ----------
    problem : Path, optional
        Folder with mapA, mapB, ``scans_10m.npz`` and the floors in C; by default the bundled
        world ``large`` is the only map.
    sets : sequence of Path
        Maps with recorded scans beside them, for the answers.
    parts : tuple of str
        Of :data:`PARTS`: stacks and votes beside plain references and C; engines beside
        ``auto``; answers; answers as the map grows. And :data:`LARGE`: memory of large maps.
    repeats, threads : int
    scans : int
        Answers of `localize` on each map.
    range_max : float
        Of recorded scans, metres.

    Raises
    ------
    ConfigError
        If a number is less than 1 or there is no such part.
    ScanError
        If a set has no scans with poses.
    """
    for name, number in (("repeats", repeats), ("threads", threads), ("scans", scans)):
        if number < 1:
            raise ConfigError(f"{name} must be at least 1, got {number}")
    for part in parts:
        if part not in (*PARTS, LARGE):
            raise ConfigError(f"a part is one of {', '.join((*PARTS, LARGE))}, got {part!r}")
    cv2.setNumThreads(1)  # what has threads says so
    out: dict[str, Any] = {
        "machine": {
            "processor": platform.processor() or platform.machine(), "cores": os.cpu_count(),
            "python": platform.python_version(), "numpy": np.__version__, "opencv": cv2.__version__,
        }
    }  # fmt: skip
    maps = _maps(problem, scans)
    recorded = {
        path.parent.name: (load_map(path), scans_beside(path, scans, 0, range_max)) for path in sets
    }
    if "costs" in parts:
        out |= _costs(*next(iter(maps.items())), repeats, threads)
        out["floors"] = {} if problem is None else floors(problem)
    if "engines" in parts:
        rows = engine_rows(repeats=repeats)
        out |= {"engines": rows, "auto_over_best": engine_summary(rows)}
    if "localize" in parts:
        out["localize"] = {
            name: answer_times(grid, s.scans[:scans], threads, repeats)
            for name, (grid, s) in (maps | recorded).items()
        }
    if "growth" in parts:
        grown = growth("large", (1, 2, 4), repeats)
        areas = [row["area"] for row in grown]
        out["growth"] = grown
        out["exponents"] = {
            key: fit_exponent(areas, [row[key] for row in grown]) for key in ("ms", "rss_mib")
        }
    if LARGE in parts:
        out["memory"] = memory(*(maps["B"] if "B" in maps else _world(0.05, 1)), SIDES)
    return out


def _maps(problem: Path | None, count: int) -> dict[str, tuple[OccupancyGrid, ScanSet]]:
    if problem is None:
        return {"large": _world(0.1, count)}
    scans = load_scans(problem / "scans_10m.npz")
    return {k: (load_map(problem / f"map{k}.yaml"), scans) for k in ("A", "B")}


def _world(resolution: float, count: int) -> tuple[OccupancyGrid, ScanSet]:
    grid = render(WORLDS["large"](), resolution)
    return grid, simulate_set(grid, count, 0, Sensor(range_max=10.0))


def _costs(
    name: str, on: tuple[OccupancyGrid, ScanSet], repeats: int, threads: int
) -> dict[str, Any]:
    features, scan = prepare(on[0]), on[1].scans[0]
    timings = (
        *in_turns(stack_cases(features, on[1].scans[:BOUND_SCANS], threads), repeats),
        *in_turns(vote_cases(features, scan, threads), repeats),
    )
    return {
        "map": name, "surface_points": len(features.surface), "readings": int(scan.valid.sum()),
        "costs": [as_row(t) for t in timings],
    }  # fmt: skip
