"""Is anything lost when a batch is killed? It is, again and again, and goes on with --resume.

    python -m tools.killloop -n 20 --seed 0

A folder of scans is located once without interruption. Then the same is begun and killed (SIGKILL)
at `n` random moments, each time to go on; a run that ends before its moment is followed by one from
the beginning, and the last one is let run to its end. The rows must be equal but for their timings:
none twice, none missing. Prints a JSON object; the exit code is 1 if not.
"""

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
from imgloc.runs.results import RESULTS, read_rows
from imgloc.simulation.scans import Sensor, simulate
from tools.recorded import save_each
from tools.script import parser_of, progress


@dataclass
class Killed:
    """What became of the rows."""

    items: int
    after: list[int]  #: rows there were after each time that it was killed
    ended: int  #: how often it came to the end
    equal: bool  #: whether the rows were each time those of a run without interruption
    seconds: float  #: that this run took


def kill_loop(
    maps: Path, scans: Path, out: Path, n: int, seed: int, *words: str,
    advance: Callable[[], object] = lambda: None,
) -> Killed:  # fmt: skip
    """Kill ``imgloc batch MAPS SCANS`` with more `words` at `n` moments; results are in `out`."""
    rng = random.Random(seed)  # noqa: S311  (no secret)
    batch = [sys.executable, "-m", "imgloc", "batch", str(maps), str(scans), *words, "--out"]
    whole, torn = out / "whole", [out / "torn-0"]
    start = time.monotonic()
    _run([*batch, str(whole)])
    seconds = time.monotonic() - start
    after: list[int] = []
    while len(after) < n:
        with subprocess.Popen(  # noqa: S603  (our own interpreter)
            [*batch, str(torn[-1]), "--resume"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        ) as run:
            try:
                run.wait(rng.uniform(0.0, seconds))
                torn.append(out / f"torn-{len(torn)}")
                continue
            except subprocess.TimeoutExpired:
                run.send_signal(signal.SIGKILL)
        there = (torn[-1] / RESULTS).exists()
        after.append(len(list(read_rows(torn[-1]))) if there else 0)
        advance()
    _run([*batch, str(torn[-1]), "--resume"])
    expected = _timeless(whole)
    equal = all(
        _timeless(folder) == expected
        and len((folder / RESULTS).read_bytes().splitlines()) == len(expected)
        for folder in torn
    )
    return Killed(len(expected), after, len(torn), equal, round(seconds, 1))


def _run(words: Sequence[str]) -> None:
    subprocess.run(words, check=True, capture_output=True)  # noqa: S603  (our own interpreter)


def _timeless(folder: Path) -> list[str]:
    """Rows in order, without what two runs do not share."""
    return sorted(json.dumps({**row, "cost": None}) for row in read_rows(folder))


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse the command line, measure, print; return the exit code."""
    parser = parser_of("tools.killloop", __doc__)
    parser.add_argument("-n", type=int, default=20, help="how often it is killed")
    parser.add_argument("--items", type=int, default=40)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args(arguments)
    with TemporaryDirectory(prefix="imgloc-") as folder, progress("killed", given.n) as advance:
        site, maps = Path(folder), bundled_maps() / "curved.yaml"
        sensor = Sensor(range_max=20.0)
        save_each(site / "scans", simulate(load_map(maps), given.items, given.seed, sensor))
        words = ("--workers", str(given.workers), "--pictures", "doubtful")
        found = kill_loop(maps, site / "scans", site, given.n, given.seed, *words, advance=advance)
    print(json.dumps(asdict(found)))
    return 0 if found.equal else 1


if __name__ == "__main__":
    raise SystemExit(main())
