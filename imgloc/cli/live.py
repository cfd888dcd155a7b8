"""Scans that come while `imgloc track` runs: from standard input, a pipe or a file that grows."""

import signal
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from imgloc.errors import ConfigError
from imgloc.options import Logs

if TYPE_CHECKING:
    from imgloc.filters.follow import Reading
    from imgloc.io.scanset import ScanSet
    from imgloc.model import FloatArray, LaserScan


class Live:
    """The scans of a source, as :func:`imgloc.follow` takes them, and how long each took."""

    def __init__(
        self, source: "Iterator[tuple[float, ScanSet]]",
        prepared: "Callable[[LaserScan], LaserScan]", *, by_scans: bool = False,
    ) -> None:  # fmt: skip
        self._source, self._prepared, self._begin = source, prepared, 0.0
        self._by_scans = by_scans  # whether the scans alone are to tell the motion
        self._seconds: list[float] = []  # from line in to line out, of each scan
        self._scan: LaserScan | None = None
        self._truth: list[tuple[float, float, float]] = []  # known poses of the robot

    def __iter__(self) -> "Iterator[Reading]":
        from imgloc.filters.follow import robot_poses

        for begin, one in self._source:
            self._begin = begin
            scan, odom = self._prepared(one.scans[0]), None
            if one.odom is not None and not self._by_scans:
                odom = one.odom[0]
                if (truth := robot_poses(replace(one, scans=(scan,)))) is not None:
                    self._truth.append(tuple(truth[0]))
            self._scan = scan
            yield scan, odom

    def last(self, _: int) -> "LaserScan":
        """The scan that came last."""
        assert self._scan is not None
        return self._scan

    def answered(self) -> None:
        """Take note that the line of the last scan is out."""
        self._seconds.append(time.perf_counter() - self._begin)

    def poses(self) -> "FloatArray | None":
        """Known poses (N, 3) of the robot, if all of the scans have one."""
        import numpy as np

        return np.array(self._truth) if len(self._truth) == len(self._seconds) else None

    @property
    def latency(self) -> str:
        """From line in to line out, in words; nothing without a scan."""
        if not self._seconds:
            return ""
        import numpy as np

        half, most = 1e3 * np.percentile(self._seconds, (50, 99))
        return f"from line in to line out p50 {half:.0f} ms, p99 {most:.0f} ms"


def live_of(
    log: Path, logs: Logs, prepared: "Callable[[LaserScan], LaserScan]", *, follow: bool
) -> Live | None:
    """The scans of a source that is still being written; None for a log that is whole.

    Standard input is one if it begins as JSON lines do, or is a pipe and begins as a CARMEN log.
    """
    from imgloc.cli import inputs
    from imgloc.io import stream
    from imgloc.robot.recording import SCANS

    if follow:
        if str(log) == "-" or stream.is_pipe(log):
            raise ConfigError("--follow: is of a file that grows; a pipe is followed anyway")
        lines = _growing(log)
    elif stream.is_pipe(log):
        lines = stream.piped(log)
    elif str(log) == "-" and stream.comes_in_lines(sys.stdin.buffer):
        lines = stream.lines_of(sys.stdin.buffer)
    else:
        return None

    name = inputs.name_of(log)
    read = stream.scans_of(lines, name, topic=logs.topic, fov=logs.fov, max_bad=logs.max_bad)
    return Live(read, prepared, by_scans=logs.odom == SCANS)


def _growing(log: Path) -> Iterator[bytes]:
    """The lines of a file that grows, until Ctrl-C: from the first one that is asked for."""
    from imgloc.io.stream import growing

    yield from growing(log, _interrupted())


def _interrupted() -> "Callable[[], bool]":
    """Make Ctrl-C an end that can be asked for; the second one interrupts as ever."""
    asked = list[int]()

    def ask(number: int, _: object) -> None:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        asked.append(number)

    signal.signal(signal.SIGINT, ask)
    return lambda: bool(asked)
