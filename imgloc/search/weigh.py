"""What are separated, scored poses worth? Shares, covariances, and how well the best one fits."""

from dataclasses import dataclass, replace

import numpy as np

from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.scanpoints import Readings, one_per_place
from imgloc.model import Evidence, FloatArray, LaserScan
from imgloc.numbers import number
from imgloc.options import Options, Shared
from imgloc.search.background import unmapped_score
from imgloc.search.hypotheses import covariances, masses
from imgloc.search.modes import Modes, misfit_of
from imgloc.search.priors import share_of_poses
from imgloc.search.refine import refine
from imgloc.search.rescore import Scores, score_poses

_MAXIMA = number("pipeline.maxima")  # share of the spread of maxima by which their mean may be off
_FROM_CELLS = number("refine.from_cells")


@dataclass(frozen=True)
class Weighed:
    """M separated poses of the grid frame, best first, and what they are worth."""

    poses: FloatArray  #: (M, 3)
    log_likelihood: FloatArray  #: (M,)
    share: FloatArray  #: (M,) mass of each if the true pose is one of them
    covariance: FloatArray  #: (L, 3, 3) of as many as are listed, at least
    evidence: Evidence  #: how well the best one fits; the answer adds the rest
    explained: float = 0.0  #: share of the valid rays that the best pose explains
    #: share of the best, as far as it tells whether the true pose is another one: 0 for a stack,
    #: whose votes spread where walls are few
    lead: float = 0.0
    entropy: float | None = None  #: of a whole posterior, nats
    complete: bool = True  #: the search came to its end


def nothing(options: Options, complete: bool = True) -> Weighed:
    """No pose at all."""
    none = np.empty(0)
    fit = Evidence(best=options.fused.model.best)
    return Weighed(np.empty((0, 3)), none, none, np.empty((0, 3, 3)), fit, complete=complete)


def weigh(
    features: MapFeatures, found: Modes, options: Options, scan: LaserScan | None = None
) -> Weighed:
    """Weigh what the search found: shares and covariances; of a `scan` also the explained rays."""
    if len(found.poses) == 0:
        return nothing(options, found.complete)
    shared, explained = found.shared, 0.0
    if scan is not None:
        explained = explained_rays(features, scan, found.poses[:1], options, shared)
    there = features.thinner(shared.thinner)
    fit = evidence_of(there, found.readings, found.scores, options)
    fit = replace(fit, scale=shared.scale, thinner=shared.thinner * there.grid.resolution)
    score = found.scores.log_likelihood
    share = masses(score, fit.temperature.value)
    listed = found.poses[: options.listed(share)]
    sigma = 2 * min(options.fused.model.sigmas)
    covariance = covariances_of(there, listed, found.readings.xy, options, sigma)
    if found.spread is not None:
        covariance = covariance + _MAXIMA * found.spread[: len(listed)]
    lead, whole = float(share[0]), found.complete
    return Weighed(found.poses, score, share, covariance, fit, explained, lead, complete=whole)


def evidence_of(
    features: MapFeatures, readings: Readings, scores: Scores, options: Options
) -> Evidence:
    """How well the best of some poses fits, and what that is worth."""
    n, model = len(readings), options.fused.model
    misfit = misfit_of(scores, n, options)
    temperature = options.trust.temperature_at(misfit, n, features.grid.resolution)
    share = share_of_poses(options.prior, features)
    unmapped = unmapped_score(readings.xy, model, share, temperature.value / n)
    gained = (model.best - misfit - unmapped) * n / temperature.value
    return Evidence(n, model.best, misfit, unmapped, gained, temperature=temperature)


def covariances_of(
    features: MapFeatures, poses: FloatArray, xy: FloatArray, options: Options, sigma: float
) -> FloatArray:
    """Covariances (L, 3, 3) of the poses that are listed; `sigma` is the kernel's width, metres."""
    field, trust, extent = features.field, options.trust, options.fused.separation
    return covariances(poses, xy, field, sigma=sigma, correlated=trust.correlated, extent=extent)


def explained_rays(
    features: MapFeatures, scan: LaserScan, pose: FloatArray, options: Options, shared: Shared
) -> float:
    """Share of the valid rays, 0..1, that end on a surface of the map and pass through no wall.

    From a `pose` (1, 3), grid frame. The score asks squares, of which each counts once; this is of
    the rays as they were recorded: half of them on the robot itself are half.
    """
    scan, there = scan.scaled(shared.scale), features.thinner(shared.thinner)
    rays = Readings(scan.ranges[scan.valid], scan.angles[scan.valid])
    return float(score_poses(there, rays, pose, options).explained[0])


def settle(
    features: MapFeatures, scan: LaserScan, poses: FloatArray, options: Options
) -> tuple[FloatArray, Readings, Scores]:
    """Poses after they have settled, and their scores: trust is about the place, not the cell."""
    readings = one_per_place(scan, options.fused.place).spread(options.fused.rays)
    poses = refine(poses, readings.xy, features.field, sigmas=_FROM_CELLS)
    return poses, readings, score_poses(features, readings, poses, options)
