"""Scans that repeat an older one: a frozen driver, or a place that looks alike along the way.

The map decides which: a driver is frozen if the robot has moved, the scan has not changed, and the
expected scan has. While the robot stands, scans with noise differ in their bits, so a driver that
repeats one is frozen, too. A simulator without noise repeats them: no fault, and no evidence.
"""

from collections import OrderedDict
from hashlib import blake2b

import numpy as np

from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.raycast import cast_rays
from imgloc.features.scanpoints import evenly
from imgloc.filters.belief import PLACE, Belief
from imgloc.filters.motion import compose_poses, invert_poses, stands, way_of
from imgloc.geometry import pose_errors
from imgloc.model import FloatArray, LaserScan
from imgloc.numbers import number

_BUFFERS = 1000  # scans of a laser that are remembered, because a driver may repeat its buffers
# A scan is an old one again if the robot has moved by so many metres or radians, and at least such
# a share of its readings have changed by less than so many metres, though the map expects such a
# share to change.
_FAR, _TURN = PLACE
_NEAR, _SHARE = number("follow.stale")
_CHANGES: float = number("follow.changes")
_FEW = 90  # rays whose expected readings are compared
_SMOOTH: float = number("follow.smooth")  # metres by which a scan without noise leaves a line


class Repeats:
    """The latest scans of one laser, and where the robot was when it took each.

    Examples
    --------
    >>> repeats, scan = Repeats(), LaserScan([1.0, 2.0], [0.0, 1.0])
    >>> repeats.since(scan) is None, repeats.since(scan).tolist()
    (True, [0.0, 0.0, 0.0])
    >>> repeats.move(np.array([1.0, 0.0, 0.0]))
    >>> repeats.since(scan).tolist()
    [1.0, 0.0, 0.0]
    """

    def __init__(self) -> None:
        self._here = np.zeros(3)  # pose of the robot since the first scan, by odometry
        self._seen = OrderedDict[bytes, FloatArray]()
        self._reference: tuple[FloatArray, FloatArray] | None = None  # ranges, and the pose then
        self.place: FloatArray | None = None  #: (3,) believed place of that scan, if there was one
        self._equal = False  # whether the last scan was equal to one taken here
        self.noiseless = False  #: whether scans were equal here, and changed when the robot moved

    def move(self, step: FloatArray) -> None:
        """Add a motion (3,), in the robot's earlier frame: metres, metres, radians."""
        self._here = compose_poses(self._here, step)

    def since(self, scan: LaserScan) -> FloatArray | None:
        """Motion (3,) of the robot since a scan that this one repeats; None if it repeats none.

        No sensor measures the same to the bit twice. A scan with some noise repeats another if the
        robot has moved since.
        """
        content = blake2b(scan.ranges.tobytes(), digest_size=16).digest()
        then = self._seen.get(content)
        equal = None if then is None else self._way(then)
        self.noiseless |= self._equal and equal is None
        self._equal = equal is not None and stands(equal)
        self._seen[content] = self._here if then is None else then
        self._seen.move_to_end(content)
        if len(self._seen) > _BUFFERS:
            self._seen.popitem(last=False)
        if self._equal or self._reference is None:
            self._reference = self._reference or (scan.ranges, self._here)
            return equal
        before, then = self._reference
        step = self._way(then)
        if before.shape == scan.ranges.shape:
            with np.errstate(invalid="ignore"):
                same = np.abs(scan.ranges - before)[scan.valid] < _NEAR
            if len(same) and np.mean(same) >= _SHARE:
                far = (way_of(step) >= (_FAR, _TURN)).any()
                return step if far else equal
        if equal is None:
            self.refer(scan)
        return equal

    def refer(self, scan: LaserScan, metres: float = 0.0) -> None:
        """Compare the next scans with this one, unless scans `metres` drag the belief."""
        if metres >= _FAR / 2:
            return
        self._reference, self.place = (scan.ranges, self._here), None

    def believe(self, belief: Belief) -> None:
        """Take note of where the scan that was referred to just now is believed to be."""
        here = self._reference is not None and self._reference[1] is self._here
        if here and self.place is None and len(belief.poses):
            self.place = belief.poses[0].copy()

    def _way(self, then: FloatArray) -> FloatArray:
        return compose_poses(invert_poses(then), self._here)


def smooth(scan: LaserScan) -> bool:
    """Return whether a scan has no noise: a quarter of its readings lie on lines to the bit.

    The inverse ranges of three rays that end on one line are those of a sine wave.

    Examples
    --------
    >>> angles = np.linspace(-0.5, 0.5, 21)
    >>> walls = 2 / np.cos(angles)
    >>> noise = 0.003 * np.random.default_rng(0).standard_normal(21)
    >>> smooth(LaserScan(walls, angles)), smooth(LaserScan(walls + noise, angles))
    (True, False)
    """
    with np.errstate(divide="ignore"):
        inverse = 1 / np.where(scan.valid, scan.ranges, np.nan)
    apart = (scan.angles[2:] - scan.angles[:-2]) / 2
    off = np.abs((inverse[2:] + inverse[:-2]) / (2 * np.cos(apart)) - inverse[1:-1])
    metres = off * np.square(scan.ranges[1:-1])
    metres = metres[np.isfinite(metres)]
    return len(metres) > 0 and float(np.percentile(metres, 25)) < _SMOOTH


def dragged(belief: Belief, place: FloatArray | None, step: FloatArray) -> float:
    """Metres by which scans have pulled a belief away from where odometry carried its place (3,).

    A frozen scan fits where it was taken. Infinite if no place is near.
    """
    if place is None or not len(belief.poses):
        return 0.0
    apart = pose_errors(belief.poses, compose_poses(place, step))
    return float(apart[(apart < PLACE).all(axis=1), 0].min(initial=np.inf))


def frozen(features: MapFeatures, belief: Belief, scan: LaserScan, step: FloatArray) -> bool:
    """Return whether a scan that has not changed should have, as the robot moved by `step` (3,).

    It should if the map expects other readings at the best place. A short step is prolonged: a map
    shows no change within a cell.
    """
    way = way_of(step)
    place = belief.poses[:1]
    if not len(place):
        return True
    longer = step * max(1.0, float((np.array((_FAR, _TURN)) / np.maximum(way, 1e-9)).min()))
    mount, angles = np.array([*scan.mount]), scan.angles[scan.valid | scan.no_return]
    angles = angles[evenly(len(angles), _FEW)]
    reach, cell = min(scan.range_max, features.grid.diagonal), features.grid.resolution

    def expected(poses: FloatArray) -> FloatArray:
        at = compose_poses(poses, mount)
        rays = at[:, 2:] + angles
        seen = cast_rays(features.walls, at[:, None, :2], rays, reach, cell)
        return np.minimum(seen.astype(np.float64), reach)

    now, then = expected(place), expected(compose_poses(place, invert_poses(longer)))
    changed = np.abs(now - then) > max(_NEAR, 2 * cell)
    return bool(changed.mean() >= _CHANGES) if len(angles) else True
