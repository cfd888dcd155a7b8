"""Trials of the paper's table: a world, scans in it, the stack of a scan and what it gives.

For the table a stack is needed only for what it gives to the true pose and for where its
maximum is; no peaks are looked for.
"""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from imgloc.evaluate import PAPER_STEPS_DEG, method_options
from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.scanpoints import scan_points
from imgloc.geometry import cell_of, theta_bin, uniform_thetas
from imgloc.index import density_in_stack, global_maximum
from imgloc.io.scanset import ScanSet
from imgloc.likelihood.beam import temperature
from imgloc.likelihood.ght import ght_v
from imgloc.likelihood.uncertainty import Uncertainty
from imgloc.model import Float32Array, FloatArray, LaserScan, Pose2D
from imgloc.pipeline import METHODS
from imgloc.simulate import Sensor, simulate_set
from imgloc.worlds import WORLDS, render

CELL = 0.1
"""Side of a cell of the pose space, metres: the paper's."""
MAP_CELL = 0.05
"""Side of a cell of the maps, metres. The paper's maps are lines; at 10 cm the staircase of a
slanted or curved wall displaces its surface by as much as the cell of a pose."""
OPTIONS = ("ght-v once", "ght-v eq. 8")
"""Sec. VII's suggestions, each an option of GHT-V: one vote per scan point and cell; eq. 8."""
STEPS_DEG: Mapping[str, float] = MappingProxyType(
    PAPER_STEPS_DEG | dict.fromkeys(OPTIONS, PAPER_STEPS_DEG["ght-v"])
)
"""Methods of the table, and the steps of their headings in degrees: the paper's."""
WIDE_DEG = 30.0
"""The widest of those steps: cells in which all methods can be compared."""


@dataclass(frozen=True)
class Outcome:
    """What the stack of one scan gives.

    Parameters
    ----------
    density : float
        Relative density at the true pose, see :mod:`imgloc.index`.
    bare : float or None
        For ``beam``: the same if its readings are taken for independent.
    exact, near : bool
        The maximum is the cell of the true pose; that or one next to it (of the 27).
    wide : bool
        The maximum and the true pose share a cell, or would if headings were
        :data:`WIDE_DEG` apart.
    ms : float
        Time of the stack.
    """

    density: float
    bare: float | None
    exact: bool
    near: bool
    wide: bool
    ms: float


def place(world: str, n: int, seed: int, threads: int = 1) -> tuple[MapFeatures, ScanSet]:
    """The map of a world and scans in it, as ``imgloc evaluate`` makes them."""
    grid = render(WORLDS[world](), MAP_CELL)
    scans = simulate_set(grid, n, seed, Sensor(), render(WORLDS[world](), 0.01))
    return MapFeatures(grid, cell=CELL, threads=threads), scans


def thetas_of(method: str) -> FloatArray:
    """Headings of a method of :data:`STEPS_DEG`, radians."""
    return uniform_thetas(np.deg2rad(STEPS_DEG[method]))


def stack_of(
    method: str, features: MapFeatures, scan: LaserScan, thetas: FloatArray, threads: int = 1
) -> Float32Array:
    """Likelihood stack (K, H, W) of a method of :data:`STEPS_DEG`."""
    if method not in OPTIONS:
        options = method_options(method, threads=threads)
        return METHODS[method].stack(features, scan, thetas, options)
    points = scan_points(scan.ranges, scan.angles, scan.valid)
    return ght_v(
        features.surface,
        features.visibility,
        points,
        len(thetas),
        features.lattice.shape,
        CELL,
        threads=threads,
        once=method == "ght-v once",
        uncertainty=Uncertainty() if method == "ght-v eq. 8" else None,
    )


def try_method(
    method: str, features: MapFeatures, scan: LaserScan, truth: Pose2D, threads: int = 1
) -> Outcome:
    """Compute a method's stack and look where the true pose (grid frame) stands in it.

    The log-likelihoods of ``beam`` are divided by
    :func:`imgloc.likelihood.beam.temperature`, as in an answer of ``imgloc localize``.
    """
    thetas = thetas_of(method)
    row, col = cell_of(np.array((truth.x, truth.y)), CELL).tolist()
    at = int(theta_bin(truth.theta, len(thetas))), row, col
    start = time.perf_counter()
    stack = stack_of(method, features, scan, thetas, threads)
    ms = 1e3 * (time.perf_counter() - start)
    bare, log = None, method == "beam"
    if log:
        bare = density_in_stack(stack, at, features.free, log=True)
        stack *= np.float32(1 / temperature(int(scan.valid.sum())))
    found = global_maximum(stack, features.free)
    off = np.abs(np.subtract(found, at))
    off[0] = min(off[0], len(thetas) - off[0])  # around the circle
    wide = theta_bin(np.array((thetas[found[0]], truth.theta)), round(360 / WIDE_DEG))
    return Outcome(
        density=density_in_stack(stack, at, features.free, log=log),
        bare=bare,
        exact=not off.any(),
        near=bool(off.max() <= 1),
        wide=bool(not off[1:].any() and (off[0] == 0 or wide[0] == wide[1])),
        ms=ms,
    )


def truth_of(scans: ScanSet, k: int) -> Pose2D:
    """True pose of a scan of :func:`place`; the map frame of a world is its grid frame."""
    poses = np.empty((0, 3)) if scans.poses is None else scans.poses
    return Pose2D(*poses[k])
