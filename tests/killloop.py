"""Is anything lost when a batch is killed? It is, again and again, and goes on with --resume."""

import json
import random
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from imgloc.runs.results import RESULTS, read_rows


@dataclass
class Killed:
    """What became of the rows."""

    items: int
    after: list[int]  #: rows there were after each time that it was killed
    ended: int  #: how often it came to the end
    equal: bool  #: whether the rows were each time those of a run without interruption
    seconds: float  #: that this run took


def kill_loop(maps: Path, scans: Path, out: Path, n: int, seed: int, *words: str) -> Killed:
    """Kill ``imgloc batch MAPS SCANS`` with more `words` at `n` moments; results are in `out`."""
    rng = random.Random(seed)
    batch = [sys.executable, "-m", "imgloc", "batch", str(maps), str(scans), *words, "--out"]
    whole, torn = out / "whole", [out / "torn-0"]
    start = time.monotonic()
    _batch([*batch, str(whole)])
    seconds = time.monotonic() - start
    after: list[int] = []
    while len(after) < n:
        with subprocess.Popen(
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
    _batch([*batch, str(torn[-1]), "--resume"])
    expected = timeless(whole)
    equal = all(
        timeless(folder) == expected
        and len((folder / RESULTS).read_bytes().splitlines()) == len(expected)
        for folder in torn
    )
    return Killed(len(expected), after, len(torn), equal, round(seconds, 1))


def _batch(words: Sequence[str]) -> None:
    subprocess.run(words, check=True, capture_output=True)


def timeless(folder: Path) -> list[str]:
    """Rows in order, without what two runs do not share."""
    return sorted(json.dumps({**row, "cost": None}) for row in read_rows(folder))
