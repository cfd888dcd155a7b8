"""Whether accidents of the input change what the tracker says.

Run it with the folders of logs, each with ``map.yaml`` and ``scans.npz`` (poses, and odometry if
it was recorded)::

    python -m tools.accidents ../data/gh25 ../data/fr079 --metres 30
    python -m tools.accidents --corridors

A row a log: scans whose verdict differs from that of the log as it is, where the mount of the laser
trembles by 1e-9 to 1e-3 metres and radians; whether poses are the same bytes where a driver writes
each scan into the buffer of the one before; and the RMSE of the unique poses with odometry that
comes 10, 20 and 50 times a second, as a share of that of the log as it is. How late it comes
changes nothing, because a scan waits for it.
With ``--corridors``: the share of scans that are blind in bare corridors of 30 m.
"""

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from imgloc import LaserScan, MapFeatures, OccupancyGrid, Options, Pose2D, ScanSet, prepare
from imgloc.features.distance import distance_image
from imgloc.features.raycast import cast_rays
from imgloc.filters.deviation import deviation_of
from imgloc.filters.follow import BLIND, Moment, Tracking, robot_poses
from imgloc.model import FloatArray
from imgloc.robot.odometry import Odometry
from tools.filters import driven, piece
from tools.script import parser_of, table_lines
from tools.sequences import load_log

TREMBLES, RATES = (1e-9, 1e-6, 1e-3), (10, 20, 50)  # metres and radians, Hz
NOISES, REACHES, LENGTH, STEP = (0.003, 0.005, 0.01), (3.5, 5.0, 8.0), 30.0, 0.1  # metres
_ANGLES = np.deg2rad(np.arange(-135, 135.5, 1.5))
HEAD = "log | scans | other verdicts by mount noise {} | reused buffer | RMSE {}"


def moments_of(
    features: MapFeatures, scans: Sequence[LaserScan], odom: Sequence[FloatArray]
) -> list[Moment]:
    """What the tracker says after each scan."""
    follower = Tracking().follower(features, Options(threads=1))
    return [follower.step(scan, at) for scan, at in zip(scans, odom, strict=True)]


def trembling(scans: Sequence[LaserScan], by: float, seed: int) -> list[LaserScan]:
    """Scans whose mount is read anew with each, `by` metres and radians off."""
    off = by * np.random.default_rng(seed).standard_normal((len(scans), 3))
    mounts = [scan.T_base_laser or Pose2D(0.0, 0.0) for scan in scans]
    at = [Pose2D(m.x + x, m.y + y, m.theta + t) for m, (x, y, t) in zip(mounts, off, strict=True)]
    return [replace(scan, T_base_laser=mount) for scan, mount in zip(scans, at, strict=True)]


def refilled(scans: Sequence[LaserScan]) -> Iterator[LaserScan]:
    """Scans whose ranges a driver writes into one buffer, each when it is asked for."""
    buffers = dict[int, FloatArray]()
    for scan in scans:
        buffer = buffers.setdefault(len(scan.ranges), np.empty(len(scan.ranges)))
        buffer[:] = scan.ranges
        yield replace(scan, ranges=buffer)


def sampled(log: ScanSet, rate: float) -> list[FloatArray]:
    """Odometry at the scans if it is known so many times a second; however late, a scan waits."""
    assert log.stamps is not None
    assert log.odom is not None
    times = np.arange(log.stamps[0], log.stamps[-1] + 2 / rate, 1 / rate)
    x, y, turned = log.odom[:, 0], log.odom[:, 1], np.unwrap(log.odom[:, 2])
    rows = np.column_stack([np.interp(times, log.stamps, each) for each in (x, y, turned)])
    found = (Odometry(times, rows).at(stamp) for stamp in log.stamps)
    return [at if pose is None else pose for pose, at in zip(found, log.odom, strict=True)]


def cells(folder: Path, metres: float, seed: int) -> Iterator[str]:
    """The cells of a log's row."""
    grid, whole, _ = load_log(folder, seed)
    log = piece(whole, range(int(np.searchsorted(driven(whole), metres))))
    features, truth = prepare(grid, folder.name), robot_poses(log)
    assert log.odom is not None
    assert truth is not None
    told = moments_of(features, log.scans, list(log.odom))
    yield from (folder.name, f"{len(told)}")
    for by in TREMBLES:
        other = moments_of(features, trembling(log.scans, by, seed), list(log.odom))
        pairs = zip(told, other, strict=True)
        yield f"{sum(verdict(a) != verdict(b) for a, b in pairs)}"
    again = Tracking().follower(features, Options(threads=1))
    refills = zip(told, refilled(log.scans), log.odom, strict=True)
    yield "same" if all(a.best == again.step(scan, at).best for a, scan, at in refills) else "other"
    first = rmse(told, truth)
    for rate in RATES:
        yield f"{rmse(moments_of(features, log.scans, sampled(log, rate)), truth) / first:.2f}"


def verdict(moment: Moment) -> tuple[str, str]:
    """The verdict, and why a pose is withheld."""
    return moment.belief.verdict, moment.withheld


def rmse(moments: Sequence[Moment], truth: FloatArray) -> float:
    """Root mean square error of the unique poses, metres."""
    return float(np.sqrt(np.mean(np.square(deviation_of(moments, truth).ape))))


def corridor(reach: float, noise: float) -> float:
    """Share of the scans that are blind on a drive from a room through a bare corridor."""
    res, long, n = 0.05, round(LENGTH / 0.05), round(LENGTH / STEP)
    free = np.zeros((160, long + 200), np.bool_)
    free[60:100, 20 : long + 100] = free[30:130, long + 100 : long + 180] = True
    free[30:60, 20:60], free[40:70, long + 120 : long + 128] = True, False
    x = (long + 140) * res - STEP * np.arange(n)
    origins = np.column_stack((x, np.full(n, 4.05)))[:, None]
    seen = cast_rays(distance_image(~free), origins, math.pi + _ANGLES[None], reach, res)
    noisy = seen + np.random.default_rng(0).normal(0, noise, seen.shape)
    ranges, odom = np.where(seen < reach, noisy, np.inf), np.zeros((n, 3))
    odom[:, 0] = STEP * np.arange(n)
    scans = [LaserScan(r, _ANGLES, range_max=reach, stamp=STEP * k) for k, r in enumerate(ranges)]
    told = moments_of(prepare(OccupancyGrid(~free, free, res)), scans, list(odom))
    return float(np.mean([moment.withheld == BLIND for moment in told]))


def main() -> None:
    """Measure, and print the table."""
    parser = parser_of("tools.accidents", __doc__)
    parser.add_argument("folders", nargs="*", type=Path, help="with map.yaml and scans.npz")
    parser.add_argument("--metres", type=float, default=40.0, help="of each log (default 40)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--corridors", action="store_true", help="bare corridors, too")
    given = parser.parse_args()
    by, at = (" | ".join(f"{each:g}" for each in some) for some in (TREMBLES, RATES))
    rows = (cells(folder, given.metres, given.seed) for folder in given.folders)
    for line in table_lines(HEAD.format(by, at), rows):
        print(line, flush=True)
    if given.corridors:
        pairs = itertools.product(REACHES, NOISES)
        blind = ((f"{r:g}", f"{n:g}", f"{corridor(r, n):.3f}") for r, n in pairs)
        for line in table_lines("reach, m | noise, m | share of scans blind", blind):
            print(line, flush=True)


if __name__ == "__main__":
    main()
