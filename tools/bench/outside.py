"""What the benchmark measures outside its own process: floors in C, growth, memory."""

import json
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from imgloc import ImglocError, OccupancyGrid, ScanSet, localize, prepare, save_map, save_scans
from imgloc.simulation.scans import Sensor, simulate
from imgloc.simulation.worlds import WORLDS, render
from tools.bench.measure import HEADINGS, PAIR_HEADINGS, tiled

ROOT = Path(__file__).resolve().parents[2]


def floors(problem: Path) -> Mapping[str, float | str]:
    """What hand-written C takes, ns per unit of work, on one thread; or why it is not known.

    Parameters
    ----------
    problem : Path
        Folder with ``floor/cbml.c``, ``floor/ght.c``, ``mapA.pgm`` and ``scans_10m.txt``.
    """
    cells = "0.1", str(PAIR_HEADINGS)
    return {
        "cbml": _in_c(problem, "cbml", _SEARCH, r"([\d.]+) ns per pose"),
        "ght": _in_c(problem, "ght", (*cells, "2", "10"), r"([\d.]+) ns/pair"),
        "ght-v": _in_c(problem, "ght", (*cells, "12", "10"), r"([\d.]+) ns/pair"),
    }


def exhaustive_search(problem: Path, repeats: int) -> float | str:
    """What hand-written C takes for CBML of map A and its argmax, ms; or why it is not known.

    On one thread, 120 headings and a scan; of `repeats` the least. A yardstick from one machine to
    another, and a rough one: Python and vectorised C need not be slower by the same factor.
    """
    return _in_c(problem, "cbml", _SEARCH, r"query median ([\d.]+) ms", repeats)


_SEARCH = "0.1", "0.1", str(HEADINGS), "0", "10", "1"


def _in_c(
    problem: Path, name: str, arguments: Sequence[str], pattern: str, repeats: int = 1
) -> float | str:
    """The least number that a program prints in `repeats` runs on map A, or why there is none."""
    compiler, source = shutil.which("cc"), problem / "floor" / f"{name}.c"
    if compiler is None or not source.exists():
        return "no C compiler" if compiler is None else f"no {source.name}"
    least = float("inf")
    with tempfile.TemporaryDirectory() as folder:
        program = Path(folder) / name
        flags = ["-O3", "-march=native", "-ffast-math", "-w"]
        build = [compiler, *flags, str(source), "-o", str(program), "-lm", "-lpthread"]
        built = subprocess.run(build, check=False, capture_output=True, text=True)  # noqa: S603
        if built.returncode:
            return f"not compiled: {_last_line(built.stderr)}"
        begin = [str(program), str(problem / "mapA.pgm"), str(problem / "scans_10m.txt")]
        for _ in range(repeats):
            done = subprocess.run(  # noqa: S603
                [*begin, *arguments], check=False, capture_output=True, text=True
            )
            found = re.search(pattern, done.stdout)
            if done.returncode and not found:
                return f"ended with {done.returncode}: {_last_line(done.stderr)}"
            if not found:
                return f"not understood: {done.stdout[:80]!r}"
            least = min(least, float(found[1]))
    return least


def _last_line(text: str) -> str:
    return (text.strip().splitlines() or ["it did not say why"])[-1]


def growth(world: str, times: Sequence[int], repeats: int) -> tuple[Mapping[str, float], ...]:
    """Time and memory of `localize` on a world tiled along each side, each in a fresh process.

    Of `repeats` answers the median counts. Says ``area`` in m², ``ms`` of an answer, ``prepare_s``
    and ``rss_mib`` at the peak, NaN where the system does not tell; raises ImglocError if a
    process fails.
    """
    rows = []
    for side in times:
        run = [sys.executable, "-c", _PEAK + _GROW, world, str(side), str(repeats)]
        rows.append(measured(run, f"localize on {world}, {side} x {side} times"))
    return tuple(rows)


def memory(
    grid: OccupancyGrid, scans: ScanSet, sides: Sequence[int]
) -> tuple[Mapping[str, float], ...]:
    """Peak of the command ``imgloc localize``, from file to answer, on maps of some sizes.

    The maps are `grid`, repeated and cut to `sides` cells; the first scan is looked for. Says
    ``side``, ``cell`` in metres, ``rss_mib`` at the peak and ``seconds`` of the whole command,
    which keeps no cache and may take any amount of memory; raises ImglocError if it fails.
    """
    rows: list[Mapping[str, float]] = []
    with tempfile.TemporaryDirectory() as folder:
        scan, yaml = Path(folder) / "scan.npz", Path(folder) / "map.yaml"
        save_scans(scan, ScanSet(scans.scans[:1]))
        for side in sides:
            save_map(yaml, tiled(grid, side), force=True)
            found = command("localize", yaml, scan, "--no-cache", "--memory-budget", "64G")
            rows.append({"side": side, "cell": grid.resolution, **found})
    return tuple(rows)


def command(*words: object) -> Mapping[str, float]:
    """What an imgloc command takes: ``seconds``, ``processor`` seconds, ``rss_mib`` at its peak.

    Of a batch the processor's time is that of its workers, too; raises ImglocError if it fails.
    """
    given = [str(word) for word in words]
    run = [sys.executable, "-c", _PEAK + _COMMAND, *given]
    return measured(run, f"imgloc {' '.join(given)}")


def measured(run: Sequence[str], what: str) -> Mapping[str, float]:
    """What a Python process prints last, as JSON; raises ImglocError if it fails."""
    done = subprocess.run(run, check=False, capture_output=True, text=True, cwd=ROOT)  # noqa: S603
    if done.returncode:
        raise ImglocError(f"{what} ended with {done.returncode}: {_last_line(done.stderr)}")
    found: Mapping[str, float] = json.loads(_last_line(done.stdout))
    return found


# ru_maxrss begins with what the parent had, macOS gives it in bytes, Windows has none.
_PEAK = """
import json, re, sys, time
from pathlib import Path
def peak():
    status = Path("/proc/self/status")
    if status.exists():
        return int(re.search(r"VmHWM:\\s+(\\d+)", status.read_text())[1]) / 1024
    try:
        import resource
    except ImportError:
        return float("nan")
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most / (1024 * 1024 if sys.platform == "darwin" else 1024)
"""
_COMMAND = """
import atexit, os
start = time.perf_counter()
def tell():
    print(json.dumps({"rss_mib": peak(), "seconds": time.perf_counter() - start,
                      "processor": sum(os.times()[:4])}))
atexit.register(tell)
from imgloc.cli.app import main
main()
"""
_GROW = """
from tools.bench.outside import grown
print(json.dumps(grown(sys.argv[1], *map(int, sys.argv[2:])) | {"rss_mib": peak()}))
"""


def grown(world: str, side: int, repeats: int) -> dict[str, float]:
    """What :func:`growth` says of one size, but for the memory, in this process."""
    one = render(WORLDS[world](), 0.1)
    scans = simulate(one, repeats + 1, 0, Sensor(range_max=10.0)).scans
    occupied, free = (np.tile(v, (side, side)) for v in (one.occupied, one.free))
    grid = OccupancyGrid(occupied, free, one.resolution)
    features, seconds = prepare(grid), []
    for scan in scans:
        start = time.perf_counter()
        localize(features, scan)
        seconds.append(time.perf_counter() - start)
    median = float(np.median(seconds[1:]))
    area = grid.occupied.size * grid.resolution**2
    return {"area": area, "ms": 1e3 * median, "prepare_s": seconds[0] - median}
