"""Do poses lean toward what the sensor sees? Pairs of scans tell, without a true pose.

A pose that is too far forward by b is so along the middle of its own view. Two scans that see the
same walls with different headings are then too far apart, or too near, by b times the difference of
their directions of view. How far apart they are in truth the scans say themselves, laid over each
other: no map, and no recorded pose, has a part in that. So recorded poses can be asked, too; those
that somebody found in the very map lean with the finder's convention, by half a cell and more.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.spatial import cKDTree

from imgloc import LaserScan, MapFeatures, ScanSet, localize
from imgloc.features.scanpoints import scan_points
from imgloc.geometry import rotation, wrap
from imgloc.model import FloatArray, IntArray, OrientedPoints
from tools.script import table_lines
from tools.trust.precision import NEAR, best_of, middle_of_view

_APART = 6.0  # metres between the sensors of a pair
_TURNED = np.deg2rad(25.0)  # least difference of the headings of a pair: with less, both lean alike
_WIDTHS = (0.3, 0.3, 0.2, 0.2, *[0.1] * 6)  # of the robust kernel, metres
_MEETS, _ALIKE = 0.4, 0.8  # metres between two points of one wall; cosine between their normals
_FEWEST, _HELD = 25, 8.0  # points that meet; their least sum of squares along any direction
_MOVED = (0.4, 0.1)  # metres and radians from the start: farther, the scans met wrongly
_OFF = 0.2  # metres that a pair may disagree; beyond, one of its poses is wrong, not imprecise
_DRAWS = 300  # of the bootstrap


@dataclass(frozen=True)
class Lean:
    """How far poses of scans are too far forward: mean and standard error, metres."""

    name: str
    scans: int  #: `unique` and right
    pairs: int
    found: tuple[float, float]  #: of the poses that were found
    recorded: tuple[float, float]  #: of the poses that came with the scans


def lean(name: str, features: MapFeatures, scans: ScanSet) -> Lean:
    """Measure the lean of the poses of a set of scans on a map, found and recorded."""
    some: list[LaserScan] = []
    found, recorded = [], []
    for scan, pose in scans.with_poses():
        answer = localize(features, scan)
        best, _ = best_of(answer)
        if answer.verdict == "unique" and np.hypot(*(best - pose)[:2]) <= NEAR:
            some.append(scan)
            found.append(best)
            recorded.append(pose)
    there = np.array(recorded).reshape(-1, 3)
    pairs, moved = moved_between(some, there)
    views = np.array([middle_of_view(scan) for scan in some])
    found_lean, recorded_lean = (
        lean_of(poses, views, pairs, moved) for poses in (np.array(found).reshape(-1, 3), there)
    )
    return Lean(name, len(some), len(pairs), found_lean, recorded_lean)


def moved_between(scans: Sequence[LaserScan], poses: FloatArray) -> tuple[IntArray, FloatArray]:
    """Pairs (P, 2) of scans that see the same walls with different headings, and the motion.

    The `poses` (N, 3) tell which scans are near each other, and where to begin. The motion (P, 3),
    metres and radians, is from the first scan of a pair to the second, in the frame of the first.
    """
    points = [scan_points(scan.ranges, scan.angles, scan.valid) for scan in scans]
    points = [p.select(np.flatnonzero(p.valid)) for p in points]
    pairs, moved = [], []
    for i, j in combinations(range(len(scans)), 2):
        step = poses[j] - poses[i]
        if np.hypot(*step[:2]) > _APART or abs(wrap(step[2])) < _TURNED:
            continue
        start = np.append(rotation(-poses[i, 2]) @ step[:2], wrap(step[2]))
        motion = laid_over(points[i], points[j], start)
        if motion is not None:
            pairs.append((i, j))
            moved.append(motion)
    return np.array(pairs, dtype=np.int64).reshape(-1, 2), np.array(moved).reshape(-1, 3)


def laid_over(a: OrientedPoints, b: OrientedPoints, start: FloatArray) -> FloatArray | None:
    """The motion (3,) that lays points `b` over points `a`, near a `start`; None if it is not held.

    The mean of both normals is used at each point, so that neither scan is the model of the other.
    """
    if min(len(a), len(b)) < _FEWEST:
        return None
    motion, tree = start.astype(np.float64).copy(), cKDTree(a.xy)
    there = _units(a.alpha)
    for width in _WIDTHS:
        arm = b.xy @ rotation(motion[2]).T
        normal = _units(b.alpha + motion[2])
        distance, nearest = tree.query(arm + motion[:2])
        meets = (distance < _MEETS) & ((there[nearest] * normal).sum(axis=1) > _ALIKE)
        if np.count_nonzero(meets) < _FEWEST:
            return None
        between = (there[nearest] + normal)[meets]
        between /= np.linalg.norm(between, axis=1, keepdims=True)
        x, y = arm[meets].T
        J = np.column_stack((between, between[:, 1] * x - between[:, 0] * y))
        off = ((arm + motion[:2] - a.xy[nearest])[meets] * between).sum(axis=1)
        weighted = J.T / np.square(1 + np.square(off / width))
        A = weighted @ J
        if np.linalg.eigvalsh(A[:2, :2])[0] < _HELD:  # a corridor: free along its walls
            return None
        motion -= np.linalg.solve(A, weighted @ off)
    far, turned = np.hypot(*(motion - start)[:2]), abs(float(wrap(motion[2] - start[2])))
    return motion if far <= _MOVED[0] and turned <= _MOVED[1] else None


def lean_of(
    poses: FloatArray, views: FloatArray, pairs: IntArray, moved: FloatArray
) -> tuple[float, float]:
    """Lean of poses (N, 3), whose views have their middle at angles (N,): mean, standard error.

    The error, metres, is a bootstrap's over scans, as all pairs of a scan share its pose.
    """
    if not len(pairs):
        return float("nan"), float("nan")
    by, off = [], []
    for (i, j), motion in zip(pairs, moved, strict=True):
        step = rotation(-poses[i, 2]) @ (poses[j] - poses[i])[:2]
        off.append(step - motion[:2])
        ahead = _units(np.array([views[i], motion[2] + views[j]]))
        by.append(ahead[1] - ahead[0])
    u, d = np.array(by), np.array(off)
    kept = np.linalg.norm(d, axis=1) < _OFF
    product, square = ((u * v).sum(axis=1) * kept for v in (d, u))
    rng = np.random.default_rng(0)
    means = []
    for _ in range(_DRAWS):
        drawn = rng.multinomial(len(poses), np.full(len(poses), 1 / len(poses)))
        weight = drawn[pairs].prod(axis=1)
        means.append(weight @ product / max(weight @ square, 1e-9))
    return float(product.sum() / max(square.sum(), 1e-9)), float(np.std(means))


def lean_table(rows: Sequence[Lean]) -> str:
    """The rows as Markdown."""
    head = "scans | `unique` and right | pairs | found poses lean by cm | recorded ones by cm"
    cells = (
        (r.name, r.scans, r.pairs,
         *(f"{100 * mean:+.1f} +- {100 * error:.1f}" if r.pairs else "no pairs"
           for mean, error in (r.found, r.recorded)))
        for r in rows
    )  # fmt: skip
    return "\n".join(table_lines(head, cells))


def _units(angles: FloatArray) -> FloatArray:
    return np.column_stack((np.cos(angles), np.sin(angles)))
