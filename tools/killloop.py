"""Is anything lost when a batch is killed? It is, again and again, and goes on with --resume.

    python -m tools.killloop -n 20 --seed 0

A folder of scans is located once without interruption. Then the same is begun and killed (SIGKILL)
at `n` random moments, each time to go on, and at last let run to its end. The rows must be equal
but for their timings: none twice, none missing. Prints a JSON object; the exit code is 1 if not.
"""

import argparse
import json
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from imgloc.io.maps import bundled_maps, load_map
from imgloc.io.results import RESULTS, read_rows
from imgloc.io.scans import save_scans
from imgloc.io.scanset import ScanSet
from imgloc.simulation import Sensor, simulate
from tools.progress import progress


@dataclass
class Killed:
    """What became of the rows."""

    items: int
    kills: int  #: of runs that were still busy
    after: list[int]  #: rows there were after each
    equal: bool  #: whether the rows are those of a run without interruption
    seconds: float  #: that this run took


def kill_loop(
    maps: Path, scans: Path, out: Path, n: int, seed: int, *words: str,
    advance: Callable[[], object] = lambda: None,
) -> Killed:  # fmt: skip
    """Kill ``imgloc batch MAPS SCANS`` with more `words` at `n` moments; results are in `out`."""
    rng = random.Random(seed)  # noqa: S311  (no secret)
    batch = [sys.executable, "-m", "imgloc", "batch", str(maps), str(scans), *words, "--out"]
    whole, torn = out / "whole", out / "torn"
    start = time.monotonic()
    _run([*batch, str(whole)])
    seconds = time.monotonic() - start
    after, kills = [], 0
    for _ in range(n):
        with subprocess.Popen(  # noqa: S603  (our own interpreter)
            [*batch, str(torn), "--resume"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        ) as run:
            try:
                run.wait(rng.uniform(0.0, seconds))
            except subprocess.TimeoutExpired:
                kills += 1
                run.send_signal(signal.SIGKILL)
        after.append(len(list(read_rows(torn))) if (torn / RESULTS).exists() else 0)
        advance()
    _run([*batch, str(torn), "--resume"])
    expected, found = _timeless(whole), _timeless(torn)
    lines = len((torn / RESULTS).read_bytes().splitlines())
    equal = expected == found and lines == len(expected)
    return Killed(len(expected), kills, after, equal, round(seconds, 1))


def _run(words: Sequence[str]) -> None:
    subprocess.run(words, check=True, capture_output=True)  # noqa: S603  (our own interpreter)


def _timeless(folder: Path) -> list[str]:
    """Rows in order, without what two runs do not share."""
    return sorted(json.dumps({**row, "cost": None}) for row in read_rows(folder))


def make_site(folder: Path, items: int, seed: int) -> None:
    """Files of one scan each, simulated in a bundled world."""
    folder.mkdir()
    scans = simulate(load_map(bundled_maps() / "curved.yaml"), items, seed, Sensor(range_max=20.0))
    for k, scan in enumerate(scans.scans):
        poses = None if scans.poses is None else scans.poses[k : k + 1]
        save_scans(folder / f"{k:03d}.npz", ScanSet((scan,), poses=poses))


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse the command line, measure, print; return the exit code."""
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser("tools.killloop", description=__doc__, formatter_class=raw)
    parser.add_argument("-n", type=int, default=20, help="how often it is killed")
    parser.add_argument("--items", type=int, default=40)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args(arguments)
    with TemporaryDirectory(prefix="imgloc-") as folder, progress("killed", given.n) as advance:
        site = Path(folder)
        make_site(site / "scans", given.items, given.seed)
        words = ("--workers", str(given.workers), "--pictures", "doubtful")
        maps = bundled_maps() / "curved.yaml"
        found = kill_loop(maps, site / "scans", site, given.n, given.seed, *words, advance=advance)
    print(json.dumps(asdict(found)))
    return 0 if found.equal else 1


if __name__ == "__main__":
    raise SystemExit(main())
