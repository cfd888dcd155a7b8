"""What one scan says of some poses: the only place where filters touch the recipe of one scan."""

from dataclasses import dataclass

import numpy as np

from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.scanpoints import Readings, one_per_place
from imgloc.model import FloatArray, LaserScan
from imgloc.options import Options
from imgloc.pipeline import Modes, find_modes, score_poses, weigh
from imgloc.search.refine import refine

_SETTLE = (0.2, 0.1, 0.05)  # widths of the kernel, metres


@dataclass(frozen=True)
class Sight:
    """Poses by one scan, in the order in which they were asked for."""

    poses: FloatArray  #: (C, 3), grid frame
    log_likelihood: FloatArray  #: (C,) nats, divided by the temperature of the scan
    covariance: FloatArray  #: (C, 3, 3) of the readings' noise around each
    misfit: FloatArray  #: (C,) nats per reading that are lacking to a perfect fit
    gained: float  #: nats, tempered, by which the best one beats a building on no map


def readings_of(scan: LaserScan, options: Options) -> Readings:
    """The readings that a search scores poses by: what the functions below are asked with."""
    return one_per_place(scan, options.fused.place).spread(options.fused.rays)


def sight(features: MapFeatures, seen: Readings, poses: FloatArray, options: Options) -> Sight:
    """Score poses (C, 3), C > 0, of the grid frame as they are."""
    scores = score_poses(features, seen, poses, options)
    order = np.argsort(-scores.log_likelihood, kind="stable")
    found = weigh(features, Modes(poses[order], scores.select(order), seen), options)
    back = np.argsort(order, kind="stable")
    score = found.log_likelihood[back]
    misfit = options.fused.model.best - score / len(seen)
    covariance = np.tile(np.diag([0.5, 0.5, 0.25]) ** 2, (len(poses), 1, 1))
    covariance[order[: len(found.covariance)]] = found.covariance
    log = score / found.temperature.value
    return Sight(poses, log, covariance, misfit, found.gained)


def settled(features: MapFeatures, seen: Readings, poses: FloatArray) -> FloatArray:
    """The poses moved to where the scan fits best around them, by half a metre at most."""
    return refine(poses, seen.xy, features.field, sigmas=_SETTLE)


def search(features: MapFeatures, scan: LaserScan, options: Options) -> FloatArray:
    """All separated poses (M, 3) that one scan allows, grid frame, best first."""
    return find_modes(features, scan, options).poses


def misfit_at(features: MapFeatures, seen: Readings, poses: FloatArray, options: Options) -> float:
    """Least misfit of poses (C, 3), C > 0, as they are, nats per reading."""
    best = float(score_poses(features, seen, poses, options).log_likelihood.max())
    return options.fused.model.best - best / len(seen)


def misfit_near(
    features: MapFeatures, seen: Readings, poses: FloatArray, options: Options
) -> float:
    """Least misfit of poses (C, 3), C > 0, once they have settled, nats per reading."""
    return misfit_at(features, seen, settled(features, seen, poses), options)
