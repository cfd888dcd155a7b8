"""What are separated, scored poses worth? Shares, covariances, and how well the best one fits."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.scanpoints import Readings, one_per_place
from imgloc.model import FloatArray, Hypothesis, LaserScan, Temperature
from imgloc.numbers import number
from imgloc.options import Options, Shared
from imgloc.search.background import unmapped_score
from imgloc.search.hypotheses import covariances, masses
from imgloc.search.modes import Modes, _misfit
from imgloc.search.priors import share_of_poses
from imgloc.search.refine import refine
from imgloc.search.rescore import Scores, score_poses

_MAXIMA = number("pipeline.maxima")  # share of the spread of maxima by which their mean may be off
_FROM_CELLS = number("refine.from_cells")


@dataclass(frozen=True)
class Found:
    """M separated poses of the grid frame, best first, and what they are worth."""

    poses: FloatArray  #: (M, 3)
    log_likelihood: FloatArray  #: (M,)
    share: FloatArray  #: (M,) Mass of each if the true pose is one of them
    covariance: FloatArray  #: (L, 3, 3) Of as many as are listed, at least
    misfit: float = float("nan")  #: nats per reading that the best pose lacks
    unmapped: float = float("nan")  #: nats per reading in a building that is on no map
    gained: float = float("nan")  #: nats, tempered, by which the best pose beats that
    explained: float = 0.0  #: share of the valid rays that the best pose explains
    temperature: Temperature = field(default_factory=Temperature)  #: what made shares of nats
    readings: int = 0  #: how many decided about the misfit
    shared: Shared = field(default_factory=Shared)  #: error that was allowed for
    #: share of the best, as far as it says something about the true pose being none of them: votes
    #: are spread where walls are few, too, so that those of a stack say nothing
    lead: float = 0.0
    entropy: float | None = None  #: of a whole posterior, nats
    complete: bool = True  #: the search came to its end


NOTHING = Found(np.empty((0, 3)), np.empty(0), np.empty(0), np.empty((0, 3, 3)))


def weigh(
    features: MapFeatures, found: Modes, options: Options, scan: LaserScan | None = None
) -> Found:
    """What separated, scored poses are worth: shares and covariances; and of a `scan` its rays."""
    if len(found.poses) == 0:
        return replace(NOTHING, complete=found.complete)
    explained = 0.0
    if scan is not None:
        explained = explained_rays(features, scan, found.poses[:1], options, found.shared)
    features = features.thinner(found.shared.thinner)
    xy, score = found.readings.xy, found.scores.log_likelihood
    fit, temperature = _fit(features, found.readings, found.scores, options)
    share = masses(score, temperature.value)
    listed = found.poses[: options.listed(share)]
    covariance = _covariances(features, listed, xy, options, 2 * min(options.fused.model.sigmas))
    if found.spread is not None:
        covariance = covariance + _MAXIMA * found.spread[: len(listed)]
    return Found(
        *(found.poses, score, share, covariance),
        explained=explained,
        temperature=temperature,
        lead=float(share[0]),
        complete=found.complete,
        shared=found.shared,
        **fit,
    )


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


def _settled_fit(
    features: MapFeatures, scan: LaserScan, best: FloatArray, options: Options
) -> dict[str, Any]:
    """What :func:`_fit` says of a stack's best pose (1, 3)."""
    pose, readings, scores = settle(features, scan, best, options)
    explained = explained_rays(features, scan, pose, options, Shared())
    return _fit(features, readings, scores, options)[0] | {"explained": explained}


def _fit(
    features: MapFeatures, readings: Readings, scores: Scores, options: Options
) -> tuple[dict[str, Any], Temperature]:
    """How well the best pose fits, as :class:`Found` has it, and the temperature of its score."""
    n, model = len(readings), options.fused.model
    misfit = _misfit(scores, n, options)
    temperature = options.trust.temperature_at(misfit, n, features.grid.resolution)
    share = share_of_poses(options.prior, features)
    unmapped = unmapped_score(readings.xy, model, share, temperature.value / n)
    said = {
        "misfit": misfit,
        "unmapped": unmapped,
        "gained": (model.best - misfit - unmapped) * n / temperature.value,
        "readings": n,
    }
    return said, temperature


def _covariances(
    features: MapFeatures, poses: FloatArray, xy: FloatArray, options: Options, sigma: float
) -> FloatArray:
    """Covariances of the poses that are listed."""
    field, trust, extent = features.field, options.trust, options.fused.separation
    return covariances(poses, xy, field, sigma=sigma, correlated=trust.correlated, extent=extent)


def _log_volumes(hypotheses: tuple[Hypothesis, ...], features: MapFeatures) -> FloatArray:
    """Logarithm of the volume of each mode as a share of that of all poses."""
    space = np.count_nonzero(features.free) * features.lattice.resolution**2 * 2 * np.pi
    # An integral of a density that is no narrower than the score is sharp: the search's own
    # rounding and a mode that is its own best pose cost as much in every map.
    volumes = [0.5 * np.linalg.slogdet(2 * np.pi * h.covariance)[1] for h in hypotheses]
    return np.asarray(np.array(volumes) - np.log(space))
