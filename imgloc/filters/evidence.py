"""What one scan says of some poses: the only place where filters touch the recipe of one scan.

Poses are those of the robot, on which each scan says where its sensor sits: scans of several lasers
are scored one after the other, each from where its own rays start. Of a scan that does not say it,
robot and sensor are one.

What is known of the scale of the readings, `Options.shared`, is applied once, by :func:`usable`; of
the walls, by the features that a filter takes.
"""

from dataclasses import dataclass

import numpy as np

from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.scanpoints import Readings, one_per_place
from imgloc.filters.motion import compose_poses, invert_poses
from imgloc.model import FloatArray, IntArray, LaserScan, Pose2D
from imgloc.numbers import number
from imgloc.options import Options
from imgloc.pipeline import find_modes
from imgloc.search.modes import Modes
from imgloc.search.refine import endpoints, refine
from imgloc.search.rescore import score_poses
from imgloc.search.weigh import weigh

_SETTLE = number("evidence.settle")  # widths of the kernel, metres
_SETTLE_SCALED = number("evidence.settle_scaled")  # the same where the scale is free
_FEW = number("evidence.readings")  # readings of the first look around a pose
_STEP: tuple[float, float] = number("evidence.step")  # between the poses of it, metres and radians
_REACH = number("evidence.reach")  # standard deviations that it goes, and
_FARTHEST = number("evidence.farthest")  # metres and radians, at most
_SCALES = number("evidence.scales")  # at which that of the readings begins
_MOST = number("evidence.most")  # poses of all first looks together: time has an end
_CLOSER = number("evidence.closer")  # of them that are moved to where they fit best
_UNKNOWN = number("evidence.unknown")  # metres, metres, radians: of a pose that was not weighed
# metres: what is nearer on all sides is a cover, or the robot itself
_BODY = number("evidence.body")
# of the kernel that tells which: of the first look, and of the last, metres
_WIDTHS = number("evidence.widths")


@dataclass(frozen=True)
class View:
    """A scan, as poses (C, 3) of the robot, C > 0, grid frame, are asked about it."""

    readings: Readings  #: those that a search scores poses by
    mount: FloatArray  #: (3,) pose of the sensor on the robot

    def sensor(self, poses: FloatArray) -> FloatArray:
        """Where the sensor is if the robot is at the poses."""
        return compose_poses(poses, self.mount)

    def robot(self, poses: FloatArray) -> FloatArray:
        """Where the robot is if its sensor is at the poses."""
        return compose_poses(poses, invert_poses(self.mount))


def usable(scan: LaserScan, options: Options) -> LaserScan | None:
    """The scan at the scale that is known; None if it says nothing of where the robot is.

    It does if it has readings in enough directions, and of enough places beyond the robot's body.
    """
    few = max(1, options.trust.readings)
    if scan.directions < few:
        return None
    if np.count_nonzero(one_per_place(scan, options.fused.place).ranges > _BODY) < few:
        return None
    return scan if options.shared.scale == 1 else scan.scaled(options.shared.scale)


def view_of(scan: LaserScan, options: Options) -> View:
    """The scan, made ready for the functions below."""
    m = scan.T_base_laser or Pose2D(0.0, 0.0)
    readings = one_per_place(scan, options.fused.place).spread(options.fused.rays)
    return View(readings, np.array([m.x, m.y, m.theta]))


@dataclass(frozen=True)
class Sight:
    """Poses by one scan, in the order in which they were asked for."""

    poses: FloatArray  #: (C, 3), grid frame
    log_likelihood: FloatArray  #: (C,) nats, divided by the temperature of the scan
    covariance: FloatArray  #: (C, 3, 3) of the readings' noise around each
    misfit: FloatArray  #: (C,) nats per reading that are lacking to a perfect fit
    gained: float  #: nats, tempered, by which the best one beats a building on no map


def sight(
    features: MapFeatures,
    view: View,
    poses: FloatArray,
    options: Options,
    spread: FloatArray | None = None,
) -> Sight:
    """Score poses as they are; a `spread` (C, 3, 3) as of :class:`Places` widens covariances."""
    seen, at = view.readings, view.sensor(poses)
    scores = score_poses(features, seen, at, options)
    order = np.argsort(-scores.log_likelihood, kind="stable")
    wider = None if spread is None else spread[order]
    found = weigh(features, Modes(at[order], scores.select(order), seen, spread=wider), options)
    back = np.argsort(order, kind="stable")
    score = found.log_likelihood[back]
    misfit = options.fused.model.best - score / len(seen)
    covariance = np.tile(np.diag(_UNKNOWN) ** 2, (len(poses), 1, 1))
    covariance[order[: len(found.covariance)]] = found.covariance
    lever = np.tile(np.eye(3), (len(poses), 1, 1))  # a sensor that turns moves the robot
    lever[:, 0, 2], lever[:, 1, 2] = (at - poses)[:, 1], (poses - at)[:, 0]
    covariance = lever @ covariance @ lever.transpose(0, 2, 1)
    log = score / found.evidence.temperature.value
    return Sight(poses, log, covariance, misfit, found.evidence.gained)


def settled(
    features: MapFeatures, view: View, poses: FloatArray, covariance: FloatArray | None = None
) -> FloatArray:
    """The poses (C, 3), best first, moved to where the scan fits best around them.

    By half a metre and some degrees at most; with the covariance (C, 3, 3) of each, as far as that
    allows: of readings that are far away, few are near their walls unless the heading is right.
    """
    if covariance is None or not len(poses):
        return view.robot(_refined(features, view, view.sensor(poses)))
    some, count = list[FloatArray](), 0
    for pose, spread in zip(poses, covariance, strict=True):
        some.append(_around(pose, spread) if count < _MOST else pose[None])
        count += len(some[-1])
    owner = np.repeat(np.arange(len(poses)), [len(one) for one in some])
    at = view.sensor(np.concatenate(some))
    best = _best_of(owner, _met(features, at, view.readings.spread(_FEW).xy, _WIDTHS[0]), _CLOSER)
    at, owner = _refined(features, view, at[best]), owner[best]
    return view.robot(at[_best_of(owner, _met(features, at, view.readings.xy, _WIDTHS[1]), 1)])


def _around(pose: FloatArray, covariance: FloatArray) -> FloatArray:
    """Poses (K, 3) all over a Gaussian, itself among them: a heading moves the place along."""
    turned = _steps(float(np.sqrt(covariance[2, 2])), 1)
    lever = covariance[:2, 2] / max(1e-12, covariance[2, 2])
    values, axes = np.linalg.eigh(covariance[:2, :2] - np.outer(lever, covariance[:2, 2]))
    along, across = (_steps(float(np.sqrt(max(0.0, v))), 0) for v in values)
    grid = np.stack(np.meshgrid(turned, along, across, indexing="ij"), axis=-1).reshape(-1, 3)
    xy = grid[:, :1] * lever + grid[:, 1:] @ axes.T
    return np.asarray(pose + np.column_stack((xy, grid[:, 0])))


def _steps(deviation: float, kind: int) -> FloatArray:
    """Offsets in metres (0) or radians (1) on both sides of none."""
    n = int(min(_REACH * deviation, _FARTHEST[kind]) / _STEP[kind] + 0.5)
    return _STEP[kind] * np.arange(-n, n + 1.0)


def _refined(features: MapFeatures, view: View, at: FloatArray) -> FloatArray:
    return refine(at, view.readings.xy, features.field, sigmas=_SETTLE)


def _met(features: MapFeatures, at: FloatArray, xy: FloatArray, width: float) -> FloatArray:
    """How many of the points (N, 2) poses (C, 3) of the sensor put on walls, softly: (C,)."""
    distance = endpoints(at, xy, features.field)[2]
    met = 1 / (1 + np.square(distance / np.float32(width)))
    return np.asarray(met.sum(axis=1, dtype=np.float64))


def _best_of(owner: IntArray, score: FloatArray, n: int) -> IntArray:
    """Indices of the `n` greatest scores of each owner, owner after owner."""
    order = np.lexsort((-score, owner))
    first = np.searchsorted(owner[order], owner[order])
    return order[np.arange(len(order)) - first < n]


@dataclass(frozen=True)
class Places:
    """Where the **sensor** may be by one scan: separated poses, grid frame, best first."""

    poses: FloatArray  #: (M, 3)
    #: (M, 3, 3) second moments of the maxima around each: which of them it is, one scan cannot tell
    spread: FloatArray

    def best(self, n: int) -> "Places":
        """The `n` best of them, if there are so many."""
        return Places(self.poses[:n], self.spread[:n])


NO_PLACES = Places(np.empty((0, 3)), np.empty((0, 3, 3)))


def search(features: MapFeatures, scan: LaserScan, options: Options) -> Places:
    """All places that one scan allows."""
    found = find_modes(features, scan, options)
    alone = np.zeros((len(found.poses), 3, 3))
    return Places(found.poses, alone if found.spread is None else found.spread)


def misfit_at(features: MapFeatures, view: View, poses: FloatArray, options: Options) -> float:
    """Least misfit of poses as they are, nats per reading."""
    scores = score_poses(features, view.readings, view.sensor(poses), options)
    return options.fused.model.best - float(scores.log_likelihood.max()) / len(view.readings)


def misfit_near(
    features: MapFeatures,
    view: View,
    poses: FloatArray,
    options: Options,
    covariance: FloatArray | None = None,
) -> float:
    """Least misfit of poses once they have settled, nats per reading."""
    return misfit_at(features, view, settled(features, view, poses, covariance), options)


def stretched(
    features: MapFeatures, view: View, pose: FloatArray, options: Options
) -> tuple[float, float]:
    """By what to multiply the readings to fit best at a pose (3,), and what that gains, nats."""
    same = np.tile(view.sensor(pose), (len(_SCALES), 1))
    poses = np.column_stack((same, _SCALES))
    poses = refine(poses, view.readings.xy, features.field, sigmas=_SETTLE_SCALED)
    poses = np.concatenate((np.append(same[0], 1.0)[None], poses))
    score = score_poses(features, view.readings, poses, options).log_likelihood
    best = 1 + int(np.argmax(score[1:]))
    return float(poses[best, 3]), float(score[best] - score[0])
