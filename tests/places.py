"""What the tests of the pipeline share: the bundled worlds, a scan in each, answers."""

import json
import math
from functools import cache

import numpy as np

from imgloc import LaserScan, OccupancyGrid, Options, Pose2D, ScanSet, localize, prepare
from imgloc.filters.motion import noisy_odometry
from imgloc.geometry import wrap
from imgloc.simulation.scans import simulate_ranges
from imgloc.simulation.worlds import WORLDS, render

ANGLES = np.deg2rad(np.arange(-180, 180, 3.0))

# A pose of each world at which no other place looks alike all around.
POSES = {
    "double_wall": (18.3, 3.1, -0.05),
    "visibility": (17.05, 8.05, 5.3),
    "large": (45.3, 20.2, 3.6),
    "curved": (2.9, 4.8, 0.3),
    "corridor": (29.5, 4.4, -0.05),
}


@cache
def grid_of(name):
    return render(WORLDS[name](), 0.2 if name == "large" else 0.1)


@cache
def features_of(name):
    # Coarser than the default: the stacks need not be fine here.
    return prepare(grid_of(name), name, cell=0.2, n_rays=120)


@cache
def scan_of(name, seed=0):
    fine = render(WORLDS[name](), 0.02)
    ranges = simulate_ranges(fine, [POSES[name]], ANGLES, seed=seed, range_max=30.0)[0]
    return LaserScan(ranges, ANGLES, range_max=30.0)


def drive(poses):
    """A drive through the world visibility, with odometry."""
    fine = render(WORLDS["visibility"](), 0.05)
    ranges = simulate_ranges(fine, poses, ANGLES, seed=2, range_max=30.0)
    odom, stamps = noisy_odometry(poses, np.random.default_rng(0)), 100.0 + np.arange(len(poses))
    scans = (LaserScan(r, ANGLES, 0.0, 30.0, t) for r, t in zip(ranges, stamps, strict=True))
    return ScanSet(tuple(scans), poses, stamps, odom)


def lines_of(scans):
    """A drive as lines of JSON, as a program sends them that knows where the robot is."""
    rows = zip(scans.scans, scans.stamps, scans.odom, scans.poses, strict=True)
    return [
        json.dumps({"ranges": scan.ranges.round(4).tolist(), "angles": ANGLES.tolist(),
                    "range_max": 30.0, "stamp": stamp, "odom": odom.tolist(),
                    "pose": pose.tolist()}) + "\n"
        for scan, stamp, odom, pose in rows
    ]  # fmt: skip


@cache
def answer_of(name, method, threads=1):
    return localize(features_of(name), scan_of(name), Options(method=method, threads=threads))


def error(pose, truth):
    x, y, theta = truth
    return math.hypot(pose.x - x, pose.y - y), abs(float(wrap(pose.theta - theta)))


def facts(answer):
    """Everything in an answer but its timings, as plain values that can be compared."""
    return (
        [(h.pose, h.log_likelihood, h.mass, h.covariance.tolist()) for h in answer.hypotheses],
        answer.verdict,
        answer.entropy,
        answer.explained,
        dict(answer.counts),
        dict(answer.parameters),
    )


def hall(high, wide, *walls, origin=None):
    """A hall at 0.1 m, of so many cells within a wall of two, and more walls in it."""
    occupied = np.pad(np.zeros((high, wide), bool), 2, constant_values=True)
    for cells in walls:
        occupied[cells] = True
    return OccupancyGrid(occupied, ~occupied, 0.1, origin or Pose2D(0, 0, 0))


def room_with_a_post(width=40, height=30):
    """A small map on which every method is fast."""
    return hall(height, width, np.s_[2:12, 20:23])


def room_with_two_posts(origin=None):
    """A small map with nothing that is the same from elsewhere."""
    return hall(36, 46, np.s_[10:14, 12:20], np.s_[25:33, 30:33], origin=origin)
