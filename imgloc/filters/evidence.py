"""Evidence of one scan for some poses. Only here do filters use the recipe of one scan.

Poses are the robot's. Each scan has the place of its sensor on the robot, `T_base_laser`, so scans
of several lasers are scored each from where its own rays start. If a scan has none, robot and
sensor are one.

:func:`usable` multiplies the ranges by the scale in `Options.shared`, once. Walls that are drawn
too thick are allowed for by the features that a filter takes.
"""

import math
from collections.abc import Generator
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.scanpoints import Readings, one_per_place
from imgloc.filters.motion import compose_poses, invert_poses
from imgloc.geometry import wrap
from imgloc.model import FloatArray, IntArray, LaserScan
from imgloc.numbers import number
from imgloc.options import RADIUS, TOLERANCE, FusedOptions, Options
from imgloc.pipeline import find_modes, find_modes_by_steps
from imgloc.search.hypotheses import masses
from imgloc.search.modes import Modes
from imgloc.search.protection import SHARES
from imgloc.search.refine import FROM_CELLS, WIDTHS, endpoints, refine
from imgloc.search.rescore import score_poses, score_readings
from imgloc.search.weigh import covariances_there, evidence_of

_FEW = FusedOptions.few_rays  # readings of the first look around a pose
# Step between the poses of the first look, metres and radians.
_STEP: tuple[float, float] = number("evidence.step")
_MOST = min(FusedOptions.keep)  # poses of all first looks together, to limit the time
_CLOSER = number("evidence.closer")  # poses of a first look that are refined
DEVIATION: tuple[float, float] = FusedOptions.separation
"""Standard deviations of a pose of which none is known: metres and radians."""
# Metres. If all readings are nearer, a cover or the robot itself blocks the sensor.
_BODY = number("evidence.body")


def chi_square(level: float) -> float:
    """Square of the distance within which a Gaussian of three dimensions lies with a probability.

    Wilson and Hilferty (1931) have it to one part in 400; `level` is 0..1.

    Examples
    --------
    >>> round(chi_square(0.99), 2)
    11.37
    """
    return 3.0 * float(1 - 2 / 27 + NormalDist().inv_cdf(level) * math.sqrt(2 / 27)) ** 3


_, _LEVEL, _ = SHARES
GATE = chi_square(_LEVEL)
"""Squared Mahalanobis distance up to which a pose may belong to a Gaussian: 99 % of it."""


@dataclass(frozen=True)
class View:
    """A scan made ready to score poses (C, 3) of the robot, C > 0, grid frame."""

    readings: Readings  #: readings that score the poses
    mount: FloatArray  #: (3,) pose of the sensor on the robot: metres, metres, radians

    def sensor(self, poses: FloatArray) -> FloatArray:
        """Poses (C, 3) of the sensor if the robot is at `poses` (C, 3)."""
        return compose_poses(poses, self.mount)

    def robot(self, poses: FloatArray) -> FloatArray:
        """Poses (C, 3) of the robot if its sensor is at `poses` (C, 3)."""
        return compose_poses(poses, invert_poses(self.mount))


def usable(scan: LaserScan, options: Options) -> LaserScan | None:
    """The scan with its ranges multiplied by the scale in use; None if the scan is blind.

    A scan is blind if it has readings in too few directions, or of too few places beyond the
    robot's body.
    """
    few = max(1, options.trust.readings)
    if scan.directions < few:
        return None
    if np.count_nonzero(one_per_place(scan, options.fused.place).ranges > _BODY) < few:
        return None
    return scan if options.shared.scale == 1 else scan.scaled(options.shared.scale)


def view_of(scan: LaserScan, options: Options) -> View:
    """Thin the readings of a scan, and look up where its sensor sits on the robot."""
    readings = one_per_place(scan, options.fused.place).spread(options.fused.rays)
    return View(readings, np.array([*scan.mount]))


@dataclass(frozen=True)
class Sight:
    """Scores of C poses by one scan, in the order of the poses."""

    poses: FloatArray  #: (C, 3) grid frame: metres, metres, radians
    log_likelihood: FloatArray  #: (C,) nats, divided by the temperature of the scan
    covariance: FloatArray  #: (C, 3, 3) covariance of each pose from the readings' noise
    misfit: FloatArray  #: (C,) nats per reading that each pose lacks against a perfect fit
    gained: float  #: nats for the best pose against a building on no map: `Evidence.net`


def sight(
    features: MapFeatures,
    view: View,
    poses: FloatArray,
    options: Options,
    spread: FloatArray | None = None,
) -> Sight:
    """Score poses (C, 3) of the robot, grid frame, without moving them.

    `spread` (C, 3, 3) has second moments in m², m rad and rad² that widen the covariances.
    """
    seen, at = view.readings, view.sensor(poses)
    scores = score_poses(features, seen, at, options.model)
    fit = evidence_of(features, seen, scores, options)
    log = scores.things / fit.temperature.value
    misfit = options.model.best - scores.log_likelihood / len(seen)
    order = np.argsort(-log, kind="stable")
    listed = order[: options.listed(masses(log[order], 1.0))]
    covariance = np.tile(np.diag((DEVIATION[0], *DEVIATION)) ** 2, (len(poses), 1, 1))
    wider = None if spread is None else spread[listed]
    covariance[listed] = covariances_there(features, at[listed], seen, options, wider)
    lever = np.tile(np.eye(3), (len(poses), 1, 1))  # if the sensor turns, the robot moves
    lever[:, 0, 2], lever[:, 1, 2] = (at - poses)[:, 1], (poses - at)[:, 0]
    covariance = lever @ covariance @ lever.transpose(0, 2, 1)
    return Sight(poses, log, covariance, misfit, fit.net)


def settled(
    features: MapFeatures, view: View, poses: FloatArray, covariance: FloatArray | None = None
) -> FloatArray:
    """Move poses (C, 3) of the robot, grid frame, to where the scan fits best around them.

    Without a `covariance` a pose moves by at most half a metre and some degrees. With the
    covariance (C, 3, 3) of each, a first look tries poses all over its Gaussian: far readings end
    near their walls only if the heading is nearly right. It goes no farther than a robot may be
    from a pose that is roughly known. `poses` come best first.
    """
    if covariance is None or not len(poses):
        return view.robot(_refined(features, view, view.sensor(poses)))
    some, count = list[FloatArray](), 0
    for pose, spread in zip(poses, covariance, strict=True):
        some.append(_around(pose, spread) if count < _MOST else pose[None])
        count += len(some[-1])
    owner = np.repeat(np.arange(len(poses)), [len(one) for one in some])
    at = view.sensor(np.concatenate(some))
    met = _met(features, at, view.readings.spread(_FEW).xy, FROM_CELLS[0])
    best = _best_of(owner, met, _CLOSER)
    found, owner = view.robot(_refined(features, view, at[best])), owner[best]
    square = squares(found - poses[owner], covariance[owner])
    met = _met(features, view.sensor(found), view.readings.xy, FROM_CELLS[1])
    return found[_best_of(owner, met - len(view.readings) * (square > GATE), 1)]


def squares(apart: FloatArray, covariance: FloatArray) -> FloatArray:
    """Squared Mahalanobis lengths (...) of differences (..., 3) of poses: m, m, radians."""
    apart = np.concatenate((apart[..., :2], wrap(apart[..., 2:])), axis=-1)
    inverse = np.linalg.inv(covariance + np.finfo(np.float64).eps * np.eye(3))  # which may be 0
    return np.asarray(np.einsum("...i,...ij,...j->...", apart, inverse, apart))


def _around(pose: FloatArray, covariance: FloatArray) -> FloatArray:
    """Poses (K, 3) all over a Gaussian, its mean among them; x and y follow theta's correlation."""
    turned = _steps(float(np.sqrt(covariance[2, 2])), 1)
    lever = covariance[:2, 2] / max(1e-12, covariance[2, 2])
    values, axes = np.linalg.eigh(covariance[:2, :2] - np.outer(lever, covariance[:2, 2]))
    along, across = (_steps(float(np.sqrt(max(0.0, v))), 0) for v in values)
    grid = np.stack(np.meshgrid(turned, along, across, indexing="ij"), axis=-1).reshape(-1, 3)
    xy = grid[:, :1] * lever + grid[:, 1:] @ axes.T
    return np.asarray(pose + np.column_stack((xy, grid[:, 0])))


def _steps(deviation: float, kind: int) -> FloatArray:
    """Offsets on both sides of 0 and 0 itself, in metres (kind 0) or radians (kind 1)."""
    n = int(min(GATE**0.5 * deviation, (RADIUS, TOLERANCE)[kind]) / _STEP[kind] + 0.5)
    return _STEP[kind] * np.arange(-n, n + 1.0)


def _refined(features: MapFeatures, view: View, at: FloatArray) -> FloatArray:
    return refine(at, view.readings.xy, features.field, sigmas=WIDTHS)


def _met(features: MapFeatures, at: FloatArray, xy: FloatArray, width: float) -> FloatArray:
    """Soft count (C,) of the points (N, 2) that sensor poses (C, 3) put on walls."""
    met = 1 / (1 + np.square(endpoints(at, xy, features.field)[2] / np.float32(width)))
    return np.asarray(met.sum(axis=1, dtype=np.float64))


def _best_of(owner: IntArray, score: FloatArray, n: int) -> IntArray:
    """Indices of the `n` greatest scores of each owner, owner after owner."""
    order = np.lexsort((-score, owner))
    first = np.searchsorted(owner[order], owner[order])
    return order[np.arange(len(order)) - first < n]


@dataclass(frozen=True)
class Places:
    """Poses where the **sensor** may be by one scan: separated, grid frame, best first."""

    poses: FloatArray  #: (M, 3) metres, metres, radians
    #: (M, 3, 3) second moments of the maxima around each pose; one scan cannot tell them apart
    spread: FloatArray

    def best(self, n: int) -> "Places":
        """The `n` best places, or all if there are fewer."""
        return Places(self.poses[:n], self.spread[:n])


NO_PLACES = Places(np.empty((0, 3)), np.empty((0, 3, 3)))


def search(features: MapFeatures, scan: LaserScan, options: Options) -> Places:
    """Search the map for all places that fit a scan."""
    return _places(find_modes(features, scan, options))


def search_by_steps(
    features: MapFeatures, scan: LaserScan, options: Options
) -> Generator[None, None, Places]:
    """Search as :func:`search` does, and pause after each step; return the places.

    With a time budget there is one step, because the budget counts the pauses, too.
    """
    if options.time_budget is not None:
        return search(features, scan, options)
    return _places((yield from find_modes_by_steps(features, scan, options)))


def _places(found: Modes) -> Places:
    alone = np.zeros((len(found.poses), 3, 3))
    return Places(found.poses, alone if found.spread is None else found.spread)


def misfit_at(features: MapFeatures, view: View, poses: FloatArray, options: Options) -> float:
    """Least misfit of poses (C, 3) of the robot without moving them, nats per reading."""
    score = score_readings(features, view.readings, view.sensor(poses), options.model)
    return options.model.best - float(score.max()) / len(view.readings)


def misfit_near(features: MapFeatures, view: View, poses: FloatArray, options: Options) -> float:
    """Least misfit of poses (C, 3) of the robot after refinement, nats per reading."""
    return misfit_at(features, view, settled(features, view, poses), options)
