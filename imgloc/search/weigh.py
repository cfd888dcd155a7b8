"""Shares and covariances of separated, scored poses, and how well the best one fits."""

import math
from dataclasses import dataclass, replace

import numpy as np

from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.scanpoints import Readings, one_per_place
from imgloc.model import Evidence, FloatArray, Floor, LaserScan
from imgloc.numbers import number
from imgloc.options import Options, Shared
from imgloc.search.adapt import as_seen, price
from imgloc.search.background import unmapped_score
from imgloc.search.covariance import covariances
from imgloc.search.faces import depth_of, on_faces
from imgloc.search.hypotheses import masses
from imgloc.search.modes import Modes, temperature_of
from imgloc.search.priors import ranked, stands
from imgloc.search.refine import FROM_CELLS, refine, residuals
from imgloc.search.rescore import Scores, countable, score_poses, things_at

# The mean of a mode's maxima is itself uncertain: this share of their second moments is added.
_MAXIMA, _MAXIMA_ON_FACES = number("pipeline.maxima"), number("faces.maxima")
_BENDS = number("weigh.bends")  # of what a turn displaces readings, share that displaces the pose
MODES: int = number("pipeline.modes")
"""Least number of poses to look for, so that no verdict depends on the length of the list."""
# Nats for a map that explains e times as many walls of a scan: per logarithm of e.
_PIECES = number("weigh.pieces")
_FLOOR = number("floor.against")  # nats against a pose that is found without a floor


@dataclass(frozen=True, eq=False)
class Weighed:
    """M separated poses in the grid frame, best first, with their shares and covariances."""

    poses: FloatArray  #: (M, 3) metres, metres, radians
    log_likelihood: FloatArray  #: (M,) nats, up to a constant of the scan
    share: FloatArray  #: (M,) mass of each pose if the true pose is one of them
    alone: FloatArray  #: (M,) the same by the scan alone, without the weights of the prior
    covariance: FloatArray  #: (L, 3, 3) covariances of the first L poses, at least those listed
    evidence: Evidence  #: how well the best pose fits; the answer adds the rest
    explained: float = 0.0  #: share of the valid rays that the best pose explains, 0..1
    entropy: float | None = None  #: entropy of the whole posterior, nats; None without one
    complete: bool = True  #: the search came to its end


def nothing(options: Options, complete: bool = True) -> Weighed:
    """The result of a search that found no pose."""
    none = np.empty(0)
    fit = Evidence(best=options.model.best)
    return Weighed(np.empty((0, 3)), none, none, none, np.empty((0, 3, 3)), fit, complete=complete)


def weigh(
    features: MapFeatures,
    found: Modes,
    options: Options,
    scan: LaserScan | None = None,
) -> Weighed:
    """Weigh the modes that the search found: their shares, covariances and evidence.

    The share of explained rays is computed if the `scan` is given. The listed poses are moved onto
    the faces of the walls.
    """
    if len(found.poses) == 0:
        return nothing(options, found.complete)
    known, shared, explained = options, found.shared, 0.0
    options, cell = replace(options, shared=shared), features.grid.resolution
    there, score = features.thinner(shared.thinner), found.scores.things
    temperature = temperature_of(found.scores, len(found.readings), options, cell)
    alone = masses(score, temperature.value)
    order, share = ranked(options.prior, found.poses, alone, cell)
    if not share.any():
        return nothing(options, found.complete)
    alone, score, listed = alone[order], score[order], options.listed(share)
    fit = evidence_with(features, found, known, int(order[0]))
    spread = None if found.spread is None else found.spread[order]
    found = replace(found, poses=found.poses[order], spread=spread)
    poses = found.poses.copy()
    if shared.bent:
        covariance = covariances_there(there, poses[:listed], found.readings, options, found.spread)
    else:
        poses[:listed], covariance = stand_on_faces(there, found, poses[:listed], options)
    if scan is not None:
        lever = float(np.sqrt(np.mean(np.square(found.readings.ranges))))
        covariance = covariance + swept(scan.duration, lever, options)
        explained = explained_rays(features, scan, poses[:1], options, shared)
    return Weighed(poses, score, share, alone, covariance, fit, explained, complete=found.complete)


def covariances_there(
    features: MapFeatures,
    poses: FloatArray,
    readings: Readings,
    options: Options,
    spread: FloatArray | None = None,
) -> FloatArray:
    """Covariances (L, 3, 3) of poses (L, 3), grid frame, at the places that they have.

    `spread` has the second moments of the maxima around them, of L poses at least.
    """
    J, residual = residuals(poses, readings.xy, features.field)
    metres, radians = options.fused.separation
    out = covariances(
        J, residual, 1, readings, sigma=2 * min(options.model.sigmas),
        cell=features.grid.resolution, extent=(metres, metres, radians),
    )  # fmt: skip
    return out if spread is None else out + _MAXIMA * spread[: len(poses)]


def swept(duration: float, lever: float, options: Options) -> FloatArray:
    """Covariance (3, 3) of a pose because the robot moved during a scan, `duration` seconds.

    The pose is that of the first reading; the middle of the scan is half of the way farther on.
    A turn also bends what is seen, the more the longer the readings are: `lever`, metres.

    Examples
    --------
    >>> swept(0.1, 0.0, Options(max_speed=1.0, max_turn=2.0)).diagonal().round(6).tolist()
    [0.0025, 0.0025, 0.01]
    """
    way, turn = duration / 2 * options.max_speed, duration / 2 * options.max_turn
    across = way**2 + (_BENDS * lever * turn) ** 2
    return np.diag([across, across, turn**2])


def stand_on_faces(
    features: MapFeatures, found: Modes, poses: FloatArray, options: Options
) -> tuple[FloatArray, FloatArray]:
    """Move the first poses (L, 3) of the modes onto the faces of the walls, with covariances.

    A pose stays where it was if a sensor cannot be at the new place. The covariances are (L, 3, 3).
    """
    (metres, radians), prior = options.fused.separation, depth_of(found.shared, features)
    there = on_faces(poses, found.readings, features, prior)
    covariance = covariances(
        there.J, there.residual, there.usable, found.readings,
        sigma=2 * min(options.fused.model.sigmas), cell=features.grid.resolution,
        extent=(metres, metres, radians, prior[1]),
    )  # fmt: skip
    if found.spread is not None:
        covariance = covariance + _MAXIMA_ON_FACES * found.spread[: len(poses)]
    stands_there = stands(there.poses, options.prior, features)[:, None]
    return np.where(stands_there, there.poses, poses), covariance


def evidence_with(features: MapFeatures, found: Modes, options: Options, at: int = 0) -> Evidence:
    """The fit of the mode `at`, with the error that the search has found beyond a known one."""
    shared, cell = found.shared, features.grid.resolution
    there, known = features.thinner(shared.thinner), replace(options, shared=shared)
    fit = evidence_of(there, found.readings, found.scores, known, found.floor, at)
    return replace(
        fit, scale=shared.scale, thinner=shared.thinner * cell, bent=shared.bent,
        against=fit.against + price(shared, options.shared, cell),
    )  # fmt: skip


def evidence_of(
    features: MapFeatures,
    readings: Readings,
    scores: Scores,
    options: Options,
    floor: Floor | None = None,
    at: int | None = None,
) -> Evidence:
    """The fit of the best of some poses, or of that `at` an index, by some readings.

    A `floor` was left out of these.
    """
    n, model = len(readings), options.model
    temperature = temperature_of(scores, n, options, features.grid.resolution)
    unmapped = unmapped_score(readings, model)
    best = int(np.argmax(scores.things)) if at is None else at
    # Rays that met nothing would cost as much in a building on no map.
    gained = (float(scores.things[best] - scores.silence[best]) - unmapped * n) / temperature.value
    mapped, through = int(scores.mapped[best]), int(scores.through[best])
    # Half a wall: a map that explains none of a scan is none of its place, if any can be counted.
    against = _PIECES * math.log((1 + through) / (mapped + (0.5 if countable(readings) else 1)))
    against += _FLOOR * (floor is not None)  # what may be left out fits more places
    return Evidence(
        n, model.best, model.best - float(scores.log_likelihood[best]) / n, unmapped, gained,
        against, temperature=temperature, mapped=mapped, through=through, floor=floor,
        things=things_at(readings, scores, best),
    )  # fmt: skip


def explained_rays(
    features: MapFeatures, scan: LaserScan, pose: FloatArray, options: Options, shared: Shared
) -> float:
    """Share of the valid rays, 0..1, that end on a surface of the map and pass through no wall.

    The `pose` (1, 3) is in the grid frame. The score uses one reading for each square of the plane.
    This share counts all recorded rays: if half of them hit the robot itself, it is at most 0.5.
    """
    there, scan = as_seen(features, scan, shared)
    rays = Readings(scan.ranges[scan.valid], scan.angles[scan.valid])
    seen = score_poses(there, rays, pose, options.model)
    return float((seen.on_surface & ~seen.crossed).mean())


def settle(
    features: MapFeatures, scan: LaserScan, poses: FloatArray, options: Options
) -> tuple[FloatArray, Readings, Scores]:
    """Refine poses (M, 3), grid frame, and score them: poses, the readings used, and scores.

    A stack's pose is the centre of a cell. Trust is judged at the place where it settles.
    """
    readings = one_per_place(scan, options.fused.place).spread(options.fused.rays)
    poses = refine(poses, readings.xy, features.field, sigmas=FROM_CELLS)
    return poses, readings, score_poses(features, readings, poses, options.model)
