"""How long does a robot wait? The first answer beside the median, and from line in to line out.

Run it with the folders of logs, each with ``map.yaml`` and ``scans.npz``::

    python -m tools.latency ../data/fr079 ../data/gh25 --scans 60 --every-ms 50

For each it prints a row: seconds until a localizer is ready; milliseconds of its first answer, and
the median of the others; of `imgloc track MAP -`, fed a scan each so many milliseconds, how long
from line in to line out. The first line, before which the map is prepared, is waited for and does
not count. Logs without odometry get that of their poses, with noise. Run it while nothing else
runs.
"""

import json
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import imgloc
from imgloc import Localizer, ScanSet
from imgloc.filters.follow import with_odometry
from imgloc.model import FloatArray
from imgloc.output.rows import scan_row
from tools.script import at_least_one, ended, parser_of, table_lines

HEAD = "log | ready s | first ms | median ms | first / median | p50 ms | p99 ms | p99 / p50"


def answers(map_path: Path, scans: ScanSet) -> tuple[float, FloatArray]:
    """Seconds until a localizer is ready, and those of its answers."""
    begin, took = time.perf_counter(), list[float]()
    with Localizer(lambda: imgloc.load_map(map_path), background=True) as core:
        core.wait()
        ready = time.perf_counter() - begin
        for scan in scans.scans:
            begin = time.perf_counter()
            core.localize(scan)
            took.append(time.perf_counter() - begin)
    return ready, np.array(took)


def lines(map_path: Path, fed: Sequence[bytes], every: float) -> FloatArray:
    """Seconds from each line in but the first to its line out.

    Lines are fed each so many seconds, whatever has been answered by then.
    """
    command = [sys.executable, "-m", "imgloc", "track", str(map_path), "-", "--json"]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL) as run:  # noqa: S603
        assert run.stdin is not None
        assert run.stdout is not None
        given, out, stdout = list[float](), list[float](), run.stdout
        run.stdin.write(fed[0])  # the map is prepared before the first line is read
        run.stdin.flush()
        stdout.readline()

        def read() -> None:
            for _ in fed[1:]:
                stdout.readline()
                out.append(time.perf_counter())

        reader = threading.Thread(target=read)
        reader.start()
        begin = time.perf_counter()
        for k, line in enumerate(fed[1:]):
            time.sleep(max(0.0, begin + k * every - time.perf_counter()))
            given.append(time.perf_counter())
            run.stdin.write(line)
            run.stdin.flush()
        reader.join()
        run.stdin.close()
    return np.asarray(np.array(out) - np.array(given))


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print."""
    parser = parser_of("tools.latency", __doc__)
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--scans", type=int, default=200, help="of each log, at most")
    parser.add_argument("--every-ms", type=int, default=50, help="between two scans")
    asked = parser.parse_args(arguments)

    def measure() -> int:
        at_least_one(scans=asked.scans, every_ms=asked.every_ms)
        made = (row(folder, asked.scans, asked.every_ms / 1e3) for folder in asked.folders)
        for line in table_lines(HEAD, made):
            print(line, flush=True)
        return 0

    return ended("tools.latency", measure)


def row(folder: Path, count: int, every: float) -> list[str]:
    """The figures of one log."""
    map_path = folder / "map.yaml"
    scans = with_odometry(imgloc.load_scans(folder / "scans.npz"))[0]
    scans = scans.take(range(min(count, len(scans))))
    ready, took = answers(map_path, scans)
    first, median = 1e3 * took[0], 1e3 * float(np.median(took[1:]))
    fed = [(json.dumps(scan_row(scans, k)) + "\n").encode() for k in range(len(scans))]
    waited = lines(map_path, fed, every)
    half, most = 1e3 * np.percentile(waited, (50, 99))
    return [
        folder.name, f"{ready:.2f}", f"{first:.0f}", f"{median:.0f}", f"{first / median:.2f}",
        f"{half:.1f}", f"{most:.1f}", f"{most / half:.1f}",
    ]  # fmt: skip


if __name__ == "__main__":
    sys.exit(main())
