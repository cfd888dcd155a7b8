"""Motion of a robot from its scans alone: each is laid over an earlier one, the reference.

The reference is an image: each cell knows which of its readings is nearest, and how far that is. A
scan is moved until its readings end on the lines through those of the reference, by the
Gauss-Newton steps that refine a pose on a map. If the prediction is too vague for that, the scan is
first correlated with the image at all places and headings that are likely.

A Kalman filter predicts: the robot goes on with its velocity, which changes at random. Its
prediction is the prior of the match. What no reading shows, such as the motion along a bare
corridor, therefore stays as predicted, and as uncertain as that.
"""

import math
from dataclasses import dataclass

import cv2
import numpy as np

from imgloc.features.scanpoints import evenly, scan_points
from imgloc.filters.evidence import usable, view_of
from imgloc.filters.motion import MotionNoise, compose_poses, invert_poses, way_of
from imgloc.geometry import rotate_covariance, rotation, transform_points, wrap
from imgloc.likelihoods.slices import cell_offsets
from imgloc.model import BoolArray, FloatArray, IntArray, LaserScan, Pose2D
from imgloc.numbers import number
from imgloc.options import Options
from imgloc.search.hypotheses import separated
from imgloc.search.lookups import sums_under
from imgloc.search.refine import block_sums

# Standard deviations of a velocity of which nothing is known, m/s and rad/s, and the seconds after
# which nothing is known of it any more.
_SPEED, _TURN, _FORGOTTEN, _LONGEST = number("scanodometry.speed")
APART: float = _LONGEST
"""Seconds between two scans beyond which they show no motion: half of the steps are wrong."""
# A new reference is taken after such a way, or if no more than this share of a scan agrees with it.
_FAR, _TURNED, _KEPT = number("scanodometry.reference")
_WIDTHS = number("scanodometry.widths")  # of the robust kernel, metres: one for each step
# Nats that a reading loses at most if it does not agree, nats that roughness gains by chance, share
# that a reading loses where the reference saw nothing; least shares of a scan that agree, and that
# the reference could see.
_PRICE, _ROUGH, _UNSEEN, _FIT, _SEEN = number("scanodometry.fit")
# Medians of the ranges beyond which readings are left out; cells along an image, and along a cell
# of its search; readings and deviations that are searched; poses that are compared, and refined.
_REACH, _SIDE, _COARSE, _RAYS, _DEVIATIONS, _PLACES, _ALIKE = number("scanodometry.search")


@dataclass(frozen=True)
class Motion:
    """Motion of the robot since the scan before, by a scan."""

    increment: FloatArray  #: (3,) pose of the robot in its frame at the scan before: m, m, rad
    #: (3, 3) in that frame. The covariances of successive steps add up to that of the way: scans
    #: that are laid over one reference share its error, and standing still adds none.
    covariance: FloatArray
    overlap: float  #: share of the readings that agree with the reference; NaN if nothing was laid
    lost: bool  #: whether the scan does not fit: the increment is only the prediction


class ScanOdometry:
    """Follows a robot by its scans. Each laser, known by its name, has a reference of its own.

    Parameters
    ----------
    options : Options, optional
        They decide which scans are blind, and how their readings are thinned.

    Examples
    --------
    >>> angles, robot = np.linspace(-2, 2, 300), ScanOdometry()
    >>> for x in (0.0, 0.1):  # toward the end of a corridor
    ...     walls = 1.5 / np.maximum(np.abs(np.sin(angles)), 1e-9)
    ...     end = (4 - x) / np.maximum(np.cos(angles), 1e-9)
    ...     motion = robot.step(LaserScan(np.minimum(walls, end), angles, range_max=20.0))
    >>> round(float(robot.pose[0]), 3), motion.lost
    (0.1, False)
    """

    def __init__(self, options: Options | None = None) -> None:
        #: (3,) pose of the robot in its frame at the first scan: metres, metres, radians
        self.pose = np.zeros(3)
        self._options = options or Options()
        self._stamp = math.nan
        self._references = dict[str, _Reference]()
        self._usual = np.diag(np.square([_SPEED, _SPEED, _TURN]))
        # Velocity in the robot's frame; covariances of the pose since the first scan, of pose and
        # velocity, and of the velocity.
        self._velocity, self._P, self._C = np.zeros(3), np.zeros((3, 3)), np.zeros((3, 3))
        self._V = self._usual
        metres, radians = MotionNoise().floor
        self._least = np.diag(np.square([metres, metres, radians]))

    def step(self, scan: LaserScan) -> Motion:
        """Take the next scan; those without stamps count as a second apart."""
        seconds, known, before = self._since(scan.stamp), self._P, self.pose
        self._predict(seconds)
        seen, overlap = usable(scan, self._options), math.nan
        lost = anew = False
        if seen is not None:
            name = getattr(scan, "laser", "")
            reference, anew = self._references.get(name), True
            # A reference is of no use if other lasers know better by now where the robot is.
            if reference is not None and np.trace(self._P) >= np.trace(reference.covariance):
                view = view_of(seen, self._options)
                xy = view.readings.xy[view.readings.ranges < reference.reach]
                overlap, lost = self._match(reference, transform_points(Pose2D(*view.mount), xy))
                gone = way_of(compose_poses(invert_poses(reference.pose), self.pose))
                anew = overlap < _KEPT or bool((gone > (_FAR, _TURNED)).any())
                if lost:  # for the first time, somebody may just stand in the way
                    anew, reference.missed = reference.missed, True
            if lost and anew:
                self._P, self._V = self._P + self._usual, self._usual
            if anew:
                self._references[name] = _Reference(seen, self.pose, self._P)
                self._C = np.zeros((3, 3))
        if seen is None or lost:
            self._velocity = self._velocity * math.exp(-seconds / _FORGOTTEN)
        step = compose_poses(invert_poses(before), self.pose)
        grown = self._P - known + (self._usual if lost and not anew else 0)
        return Motion(step, rotate_covariance(_positive(grown), -before[2]), overlap, lost)

    def _since(self, stamp: float) -> float:
        """Seconds since the last scan; after a minute the robot may be anywhere."""
        seconds = stamp - self._stamp
        self._stamp = stamp if math.isnan(seconds) else max(self._stamp, stamp)
        if not self._references:
            return 0.0
        return 1.0 if math.isnan(seconds) else min(max(0.0, seconds), 60.0)

    def _predict(self, seconds: float) -> None:
        """Go on with the velocity."""
        turn = np.eye(3)
        turn[:2, :2] = rotation(self.pose[2])
        kept = math.exp(-2 * seconds / _FORGOTTEN)
        self._V = kept * self._V + (1 - kept) * self._usual
        moved = seconds * turn @ self._V
        both = seconds * self._C @ turn.T
        self._P = self._P + both + both.T + seconds * moved @ turn.T
        self._C = self._C + moved
        self.pose = compose_poses(self.pose, self._velocity * min(seconds, _FORGOTTEN))

    def _match(self, reference: "_Reference", xy: FloatArray) -> tuple[float, bool]:
        """Correct pose and velocity by readings; return their overlap and whether it is too small.

        If it is, nothing changes.
        """
        prior = _positive(self._P - reference.covariance) + self._least
        # No less than what the velocity leaves open, if another laser was seen in between.
        prior = prior + _positive(self._C @ np.linalg.solve(self._V, self._C.T) - prior)
        pose, covariance, fit, seen = reference.lay(xy, self.pose, prior)
        if fit < _FIT or seen < _SEEN:
            return fit * seen, True
        gain = np.linalg.solve(prior, self._C).T  # of the velocity, by the pose
        self._velocity = self._velocity + gain @ (pose - self.pose)
        self._V = self._V - gain @ (prior - covariance) @ gain.T
        self._P, self._C = reference.covariance + covariance, covariance @ gain.T
        reference.missed = False
        self.pose = np.append(pose[:2], wrap(pose[2]))
        return fit * seen, False


class _Reference:
    """A scan as an image, in a frame parallel to that of the robot's poses."""

    def __init__(self, scan: LaserScan, pose: FloatArray, covariance: FloatArray) -> None:
        self.pose, self.covariance, self.missed = pose, covariance, False
        self.reach = _REACH * float(np.median(scan.ranges[scan.valid]))
        order = np.argsort(wrap(scan.angles), kind="stable")
        near = scan.valid & (scan.ranges < self.reach)
        points = scan_points(scan.ranges[order], scan.angles[order], near[order])
        at = compose_poses(pose, np.array([*scan.mount]))
        self._origin = at[:2]
        self._xy = transform_points(Pose2D(*at), points.xy)
        normal = np.column_stack((np.cos(points.alpha + at[2]), np.sin(points.alpha + at[2])))
        self._normal = np.where(points.valid[:, None], normal, 0.0)
        self._cell = 2.5 * self.reach / _SIDE  # with a margin for the motion
        cells = self._cells(self._xy)
        image = np.full((_SIDE, _SIDE), 255, np.uint8)
        image[cells[:, 1], cells[:, 0]] = 0
        distance, label = cv2.distanceTransformWithLabels(
            image, cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
        )
        nearest = np.zeros(label.max() + 1, np.int64)
        nearest[label[cells[:, 1], cells[:, 0]]] = np.arange(len(cells))
        self._nearest = nearest[label]
        seen = np.vstack(([[_SIDE // 2, _SIDE // 2]], cells)).astype(np.int32)
        self._free = cv2.fillPoly(np.zeros_like(image), [seen], 1) > 0
        # 1 at a reading, 0 in free space.
        fit = np.exp(-0.5 * np.square(distance / _COARSE))
        fit = np.where(self._free, fit, np.maximum(fit, 1 - _UNSEEN))
        small = (round(_SIDE / _COARSE),) * 2
        fit = cv2.resize(fit, small, interpolation=cv2.INTER_AREA)
        self._image = np.rint(255 * fit).astype(np.uint8)

    def lay(
        self, xy: FloatArray, mean: FloatArray, prior: FloatArray
    ) -> tuple[FloatArray, FloatArray, float, float]:
        """Lay readings (N, 2) of the robot's frame over the reference.

        `mean` (3,) and `prior` (3, 3) are of the prediction. Returns pose and covariance, the share
        that agrees of those readings that the reference could see, and the share of these.
        """
        if not len(xy):
            return mean, prior, 0.0, 0.0
        information: FloatArray = np.asarray(np.linalg.inv(prior), np.float64)
        starts, vague = mean[None], np.diag(prior).max() > (_WIDTHS[0] / 2) ** 2
        for searched in (vague, True):
            if searched:
                starts = np.concatenate((mean[None], self._search(xy, mean, information)))
            poses = self._refine(starts, mean, information, xy)
            nats, fit, seen = self._misfit(poses, xy)
            if searched or fit[0] * seen[0] >= _KEPT:
                break
        nats = nats + _quadratic(poses - mean, information)
        nats[1:] += _ROUGH  # or any roughness of a corridor would be a reason to jump
        best = int(np.argmin(nats))
        # Places that fit about as well make the best one uncertain.
        share = np.exp(nats[best] - nats)
        apart = poses - poses[best]
        spread = (apart * (share / share.sum())[:, None]).T @ apart
        covariance = np.linalg.inv(information + self._curvature(poses[best], xy)) + spread
        return poses[best], covariance, float(fit[best]), float(seen[best])

    def _cells(self, xy: FloatArray) -> IntArray:
        """Columns and rows (..., 2) of points, those beyond the image at its border."""
        cells = np.floor((xy - self._origin) / self._cell).astype(np.int64) + _SIDE // 2
        return np.asarray(cells.clip(0, _SIDE - 1))

    def _residuals(
        self, poses: FloatArray, xy: FloatArray
    ) -> tuple[FloatArray, FloatArray, BoolArray, BoolArray]:
        """Distances (C, N) from the lines through the nearest readings, at poses (C, 3).

        First their derivatives (C, 3, N); last, whether they are near enough to count, and whether
        the reference could see the place. Where no line is known the distance is from the point.
        """
        c, s = np.cos(poses[:, 2:]), np.sin(poses[:, 2:])
        turned = np.stack((c * xy[:, 0] - s * xy[:, 1], s * xy[:, 0] + c * xy[:, 1]), axis=-1)
        at = poses[:, None, :2] + turned
        column, row = np.moveaxis(self._cells(at), -1, 0)
        nearest = self._nearest[row, column]
        off, normal = at - self._xy[nearest], self._normal[nearest]
        away = np.hypot(off[..., 0], off[..., 1])
        line = np.any(normal != 0, axis=-1, keepdims=True)
        (nx, ny), (ox, oy), (dx, dy) = (
            np.moveaxis(v, -1, 0)
            for v in (np.where(line, normal, off / np.maximum(away, 1e-9)[..., None]), off, turned)
        )
        counts = away < _WIDTHS[0]
        J = np.stack((nx, ny, dx * ny - dy * nx), axis=1)
        return J, nx * ox + ny * oy, counts, counts | self._free[row, column]

    def _refine(
        self, poses: FloatArray, mean: FloatArray, information: FloatArray, xy: FloatArray
    ) -> FloatArray:
        """Move poses (C, 3) to where the readings end on the lines, by a shrinking kernel."""
        for width in _WIDTHS:
            J, residual, counts, _ = self._residuals(poses, xy)
            (A,), (b,), _ = block_sums(J, residual, 1.0 * counts, width)
            nats = 2 * _PRICE / width**2
            A, b = nats * A + information, nats * b + (poses - mean) @ information
            poses = poses - np.clip(np.linalg.solve(A, b[..., None])[..., 0], -width, width)
        return poses

    def _misfit(
        self, poses: FloatArray, xy: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Nats that poses (C, 3) lose, the share that agrees of the readings seen, and of these."""
        _, residual, counts, seen = self._residuals(poses, xy)
        square = np.square(residual / _WIDTHS[-1])
        loss = (np.where(counts, square / (1 + square), 1.0) * seen).sum(axis=1)
        known = seen.sum(axis=1)
        nats = _PRICE * (loss + _UNSEEN * (len(xy) - known))
        # A reference that saw hardly any of it agrees with nothing.
        nats = np.where(known < _SEEN * len(xy), _PRICE * len(xy), nats)
        return nats, 1 - loss / np.maximum(known, 1), known / len(xy)

    def _curvature(self, pose: FloatArray, xy: FloatArray) -> FloatArray:
        """Second derivatives (3, 3) of the nats around a pose (3,), from poses a width away.

        Those of the Gauss-Newton steps would take the roughness of a wall for a feature.
        """
        h = _WIDTHS[-1] / np.array([1.0, 1.0, np.median(np.hypot(*xy.T))])
        a, b = np.triu_indices(3)
        steps = h * (np.eye(3)[a] + np.eye(3)[b] * (a != b)[:, None])
        nats = self._misfit(pose + np.concatenate((0 * steps[:1], steps, -steps)), xy)[0]
        second = nats[1:7] + nats[7:] - 2 * nats[0]
        own = second[a == b]
        out = np.empty((3, 3))
        out[a, b] = out[b, a] = np.where(a == b, second, (second - own[a] - own[b]) / 2)
        return _positive(out - _ROUGH * np.eye(3)) / np.outer(h, h)

    def _search(self, xy: FloatArray, mean: FloatArray, information: FloatArray) -> FloatArray:
        """Poses (C, 3) near a prediction where readings meet the image best."""
        count, xy, side = len(xy), xy[evenly(len(xy), _RAYS)], len(self._image)
        cell = self._cell * _SIDE / side
        h = np.array([cell, cell, cell / np.median(np.hypot(*xy.T))])
        most = side // 10, side // 10, math.pi // h[2]
        deviations = np.sqrt(np.diag(np.linalg.inv(information)))
        n = np.minimum(np.ceil(_DEVIATIONS * deviations / h), most).astype(int)
        k, r, c = np.indices(2 * n[::-1] + 1).reshape(3, -1)
        at = np.floor((mean[:2] - self._origin) / cell).astype(int) + side // 2
        # The search starts at the centre of the cell of the mean.
        start = np.append((at - side // 2 + 0.5) * cell + self._origin, mean[2])
        away = start - mean + h * (np.stack((c, r, k), axis=1) - n)
        wide = np.pad(self._image, side, constant_values=round(255 * (1 - _UNSEEN)))
        offsets = cell_offsets(xy, mean[2] + h[2] * np.arange(-n[2], n[2] + 1), cell)
        index = (offsets + at[::-1] + side).clip(side // 2, len(wide) - 1 - side // 2)
        stride = np.array([len(wide), 1])
        base = (r - n[1]) * len(wide) + c - n[0]
        sums = sums_under([wide.ravel()], index @ stride, k, base)[:, 0]
        nats = -_PRICE * count / (255.0 * len(xy)) * sums + _quadratic(away, information)
        best = np.argsort(nats, kind="stable")[:_PLACES]
        picked, _ = separated(mean + away[best], _ALIKE, distance=2 * cell, angle=3 * h[2])
        return np.asarray(mean + away[best[picked]])


def _quadratic(away: FloatArray, information: FloatArray) -> FloatArray:
    """Half the square of a Mahalanobis distance, (C,), of (C, 3)."""
    return np.asarray(0.5 * ((away @ information) * away).sum(axis=1))


def _positive(matrix: FloatArray) -> FloatArray:
    """The nearest matrix without negative eigenvalues."""
    values, vectors = np.linalg.eigh((matrix + matrix.T) / 2)
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)
