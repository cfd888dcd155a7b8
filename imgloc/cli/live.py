"""Scans that come while `imgloc track` runs: from standard input, a pipe or a file that grows."""

import signal
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from imgloc.cli.console import say
from imgloc.errors import ConfigError

if TYPE_CHECKING:
    from imgloc.filters.follow import Follower, Moment
    from imgloc.io.scanset import ScanSet
    from imgloc.model import FloatArray, LaserScan


class Live:
    """The scans of a source, each followed as soon as it is there, and how long that took."""

    def __init__(self, source: "Iterator[tuple[float, ScanSet]]") -> None:
        self._source = source
        self.seconds: list[float] = []  #: from line in to line out, of each scan
        self.truth: list[tuple[float, float, float]] = []  #: known poses of the robot
        self.skipped = 0  #: scans without odometry

    def follow(
        self, robot: "Follower", prepared: "Callable[[LaserScan], LaserScan]"
    ) -> "Iterator[Moment]":
        """A moment for each scan."""
        from imgloc.filters.follow import robot_poses

        index = -1
        for index, (begin, one) in enumerate(self._source):
            scan = prepared(one.scans[0])
            if one.odom is None:
                self.skipped += 1
                continue
            stamp = float("nan") if one.stamps is None else float(one.stamps[0])
            moment = robot.step(scan, one.odom[0], stamp)
            if (truth := robot_poses(replace(one, scans=(scan,)))) is not None:
                self.truth.append(tuple(truth[0]))
            yield replace(moment, index=index)
            self.seconds.append(time.perf_counter() - begin)
        if self.skipped:
            say(f"{self.skipped} of {index + 1} scans have no odometry and were left out")

    def poses(self, count: int) -> "FloatArray | None":
        """Known poses (N, 3) of the robot, if all of so many moments have one."""
        import numpy as np

        return np.array(self.truth) if len(self.truth) == count else None

    @property
    def latency(self) -> str:
        """From line in to line out, in words; nothing without a scan."""
        if not self.seconds:
            return ""
        import numpy as np

        half, most = 1e3 * np.percentile(self.seconds, (50, 99))
        return f"; from line in to line out p50 {half:.0f} ms, p99 {most:.0f} ms"


def live_of(log: Path, *, follow: bool) -> Live | None:
    """The scans of a source that is still being written; None for a log that is whole.

    Standard input is one if it begins as JSON lines do.
    """
    from imgloc.cli import inputs
    from imgloc.io.stream import begins_as_json, growing, is_pipe, lines_of, piped, scans_of

    name = inputs.name_of(log)
    if follow:
        if str(log) == "-" or is_pipe(log):
            raise ConfigError("--follow: is of a file that grows; a pipe is followed anyway")
        return Live(scans_of(growing(log, _interrupted()), name))
    if is_pipe(log):
        return Live(scans_of(piped(log), name))
    if str(log) == "-" and begins_as_json(sys.stdin.buffer):
        return Live(scans_of(lines_of(sys.stdin.buffer), name))
    return None


def _interrupted() -> "Callable[[], bool]":
    """Make Ctrl-C an end that can be asked for; the second one interrupts as ever."""
    asked = list[int]()

    def ask(number: int, _: object) -> None:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        asked.append(number)

    signal.signal(signal.SIGINT, ask)
    return lambda: bool(asked)
