"""AMCL along recorded logs: the filter of Nav2 in the wheel ``amcl`` (GPL-3), which tools only use.

The parameters are Nav2's defaults, but the wheel casts rays: it has no likelihood field. It has no
call that spreads particles over the map, so "anywhere" is a Gaussian as wide as the free space. Its
pose is the mean of all particles, not of the best cluster.
"""

import ctypes
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np

from imgloc.filters.follow import robot_poses
from imgloc.filters.motion import compose_poses, increments, invert_poses, way_of
from imgloc.geometry import wrap
from imgloc.io.scanset import ScanSet
from imgloc.model import FloatArray, LaserScan, OccupancyGrid, Pose2D
from tools.filters import Run, driven

NAV2, SURE = 0.2, 0.005  #: noise of the motion, all five parameters: Nav2's, and for good odometry
MOVED = (0.25, 0.2)  #: metres and radians after which Nav2 takes the next scan
SPREAD = (0.5, 0.5, 0.26)  #: standard deviations of a start, Nav2's: metres, metres, radians
REACH = 30.0  #: metres of a ray at most, as casting longer ones only takes time
PARTICLES = {"start": (500, 2000), "anywhere": (500, 10000)}


def missing() -> str | None:
    """Why AMCL cannot be run here; None if it can."""
    return None if find_spec("amcl") else "amcl is not installed: pip install 'imgloc[amcl]'"


class Amcl:
    """A filter on a map, at a pose of the map frame or anywhere."""

    def __init__(
        self, grid: OccupancyGrid, start: Pose2D | None, alpha: float, seed: int = 0
    ) -> None:
        amcl: Any = import_module("amcl")

        self._lib = amcl
        self._origin = np.array([grid.origin.x, grid.origin.y, grid.origin.theta])
        least, most = PARTICLES["anywhere" if start is None else "start"]
        self._filter = amcl.AMCL(
            least, most, 0.0, 0.0, amcl.MotionParameters(*[alpha] * 5),
            amcl.LaserParameters(0.5, 0.05, 0.05, 0.5, 0.2, 0.1, 0.0, 60), "differential",
        )  # fmt: skip
        rows, columns = grid.occupied.shape
        cell = grid.resolution
        # It takes the middle of its first cell for the origin.
        there = amcl.OccupancyGrid(columns, rows, cell, cell / 2, cell / 2)
        there.data = np.where(grid.occupied, 100, np.where(grid.free, 0, -1)).ravel().tolist()
        self._filter.set_map(there)
        free = np.argwhere(grid.free)[:, ::-1] * cell
        if start is None:
            mean, spread = np.array([*free.mean(axis=0), 0.0]), np.array([*free.std(axis=0), 3.0])
        else:
            mean = compose_poses(
                invert_poses(self._origin), np.array([start.x, start.y, start.theta])
            )
            spread = np.array(SPREAD)
        self._filter.set_initial_pose(
            amcl.Vector3D(*mean.tolist()), amcl.create_diagonal_covariance(*(spread**2).tolist())
        )
        ctypes.CDLL(None).srand48(ctypes.c_long(seed))  # else two runs are not the same

    def mount(self, pose: Pose2D) -> None:
        """Where the laser sits on the robot."""
        self._filter.set_laser_pose(self._lib.Vector3D(pose.x, pose.y, pose.theta))

    def update(self, scan: LaserScan, odom: FloatArray) -> FloatArray:
        """Take a scan, at a pose of the odometry; the mean pose (3,), map frame."""
        reach = min(scan.range_max, REACH)
        far = scan.ranges >= reach  # no return, which is a reading
        some = scan.valid | far
        ranges = np.minimum(np.where(far, reach, scan.ranges), reach)
        pairs = np.column_stack((ranges, scan.angles))[some]
        taken = self._lib.create_laser_scan_from_list(pairs.tolist(), reach)
        self._filter.update(taken, self._lib.Vector3D(*odom.tolist()))
        mean = self._filter.get_pose_mean()
        return compose_poses(self._origin, np.array([mean.x, mean.y, wrap(mean.theta)]))


def run_amcl(grid: OccupancyGrid, scans: ScanSet, start: Pose2D | None, alpha: float) -> Run:
    """Run AMCL along a log with poses and odometry; between its updates odometry carries it."""
    truth, odom = robot_poses(scans), scans.odom
    if truth is None or odom is None:
        raise ValueError("expected true poses and odometry")
    robot, best, since, error = Amcl(grid, start, alpha), np.zeros(3), odom[0], []
    for k, scan in enumerate(scans.scans):
        moved = way_of(increments(np.stack((since, odom[k])))[0])
        if k == 0 or (moved >= MOVED).any():
            robot.mount(scan.T_base_laser or Pose2D(0.0, 0.0))
            best, since = robot.update(scan, odom[k]), odom[k]
        here = compose_poses(best, increments(np.stack((since, odom[k])))[0])
        apart = here - truth[k]
        error.append((float(np.hypot(*apart[:2])), abs(float(wrap(apart[2])))))
    n = len(error)
    none = np.full(n, np.nan)
    stamps = np.arange(n, dtype=np.float64) if scans.stamps is None else scans.stamps
    return Run(
        stamps - stamps[0], driven(scans), np.array(error), np.zeros(n), np.zeros(n), 0.0,
        np.column_stack((none, none)), none,
    )  # fmt: skip
