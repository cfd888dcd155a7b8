"""Answers beside those of other matchers, scan by scan in turns, by a line protocol.

A peer is a program in a folder. It is started as ``PEER map.pgm RESOLUTION``. In the image 0 is
occupied, 254 free and 205 unknown; RESOLUTION is the side of a cell, metres. Once the map is
prepared, the peer writes a line, whatever is in it. Then it gets a line for each scan: the points
of its readings in the sensor frame, metres, as ``x y x y ...``. It answers with the line
``x y theta``, the sensor's pose: metres from the lower left corner of the image, radians; or with
an empty line, if it knows none. It ends when its input does.
"""

import os
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from imgloc import ConfigError, LaserScan, OccupancyGrid, Pose2D, ScanSet, localize, prepare
from imgloc.features.scanpoints import evenly, scan_xy
from imgloc.geometry import in_grid_frame
from tools.recorded import RIGHT
from tools.robot.places import apart

Answer = Callable[[LaserScan], tuple[float, Pose2D | None]]
"""Takes a scan; returns the milliseconds of a processor, and the pose in the grid frame."""


def beside(
    grid: OccupancyGrid, told: ScanSet, folder: Path, seconds: float, beams: int
) -> dict[str, dict[str, float]]:
    """Answer the scans, which have true poses, by each program in a folder and by imgloc, in turns.

    Each peer has `seconds` of a processor for a map, and gets at most `beams` readings of a scan,
    0 for all; imgloc always gets all. A row a peer: how many scans it answered, how many of these
    it and imgloc have right, and the median milliseconds of both.

    Raises
    ------
    ConfigError
        If there is no program in the folder; if one ends, or answers with something else.
    """
    there = sorted(folder.iterdir()) if folder.is_dir() else []
    programs = [p for p in there if p.is_file() and os.access(p, os.X_OK)]
    if not programs:
        raise ConfigError(f"{folder}: expected programs that answer scans")
    if told.poses is None:
        raise ConfigError("expected scans with their true poses")
    features, rows = prepare(grid), dict[str, dict[str, float]]()
    localize(features, told.scans[0])

    def ours(scan: LaserScan) -> tuple[float, Pose2D | None]:
        start = time.process_time()
        pose = localize(features, scan).pose
        taken = 1e3 * (time.process_time() - start)
        return taken, None if pose is None else in_grid_frame(pose, grid)

    for program in programs:
        found: list[tuple[float, float, bool, bool]] = []
        with running(program, grid, beams) as theirs:
            for scan, truth in zip(told.scans, told.poses, strict=True):
                true = in_grid_frame(Pose2D(*truth), grid)
                (ms, pose), (own_ms, own) = theirs(scan), ours(scan)
                found.append((ms, own_ms, _right(pose, true), _right(own, true)))
                if sum(one[0] for one in found) > 1e3 * seconds:
                    break
        table = np.array(found, np.float64)
        (ms, own_ms), (right, own) = np.median(table[:, :2], axis=0), table[:, 2:].sum(axis=0)
        rows[program.name] = {
            "scans": len(found), "right": int(right), "own": int(own), "ms": float(ms),
            "own_ms": float(own_ms),
        }  # fmt: skip
    return rows


@contextmanager
def running(program: Path, grid: OccupancyGrid, beams: int) -> Iterator[Answer]:
    """Start a peer on a map; what it yields answers a scan."""
    with tempfile.TemporaryDirectory() as made:
        image = np.where(grid.occupied, 0, np.where(grid.free, 254, 205)).astype(np.uint8)
        path = Path(made) / "map.pgm"
        head = f"P5 {image.shape[1]} {image.shape[0]} 255\n".encode()
        path.write_bytes(head + image[::-1].tobytes())
        words = (program.resolve(), path, f"{grid.resolution:.9g}")
        with subprocess.Popen(  # noqa: S603
            words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1
        ) as peer:

            def line(said: str = "") -> str:
                assert peer.stdin is not None is not peer.stdout
                try:
                    peer.stdin.write(said)
                    text = peer.stdout.readline()
                except OSError:
                    text = ""
                if not text:
                    raise ConfigError(f"{program.name} ended before it answered")
                return text

            def answer(scan: LaserScan) -> tuple[float, Pose2D | None]:
                xy = scan_xy(scan)[scan.valid]
                xy = xy[evenly(len(xy), beams or len(xy))]
                before = _processor(peer.pid)
                words = line(" ".join(f"{v:.4f}" for v in xy.ravel()) + "\n").split()
                taken = 1e3 * (_processor(peer.pid) - before)
                try:
                    return taken, Pose2D(*map(float, words)) if words else None
                except (TypeError, ValueError):
                    raise ConfigError(
                        f"{program.name}: expected x y theta, got {' '.join(words)[:80]!r}"
                    ) from None

            try:
                line()
                yield answer
            finally:
                peer.kill()


def _processor(pid: int) -> float:
    """Seconds of a processor that a process has had, by its clock."""
    return time.clock_gettime(~pid << 3 | 2)  # the clock of a process, as POSIX numbers it on Linux


def _right(pose: Pose2D | None, truth: Pose2D) -> bool:
    return pose is not None and not apart(pose, np.array([*truth]), RIGHT)
