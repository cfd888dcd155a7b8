"""The result of the search: separated modes, each at the mean of its maxima."""

from dataclasses import dataclass, field
from typing import cast

import numpy as np

from imgloc.features.floor import on_floor
from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.scanpoints import Readings
from imgloc.geometry import pose_errors, wrap
from imgloc.model import FloatArray, Floor, Temperature
from imgloc.options import Options, Shared
from imgloc.search.hypotheses import centres, modes
from imgloc.search.priors import stands
from imgloc.search.rescore import APART, Scores, score_poses


@dataclass(frozen=True, eq=False)
class Modes:
    """C separated modes in the grid frame, best first. There may be none."""

    #: (C, 3) mean of the maxima of each mode, or its best maximum if the mean is in a wall
    poses: FloatArray
    scores: Scores  #: scores of the best maximum of each mode
    readings: Readings  #: readings that were scored
    complete: bool = True  #: the search came to its end
    #: (L, 3) poses that were chosen for the second look, before it moved them
    looked: FloatArray = field(default_factory=lambda: np.empty((0, 3)))
    leads: bool = False  #: the best of them led the others so far that no search changes that
    #: (C, 3, 3) second moments of the maxima around `poses`; None if there are none to give
    spread: FloatArray | None = None
    shared: Shared = field(default_factory=Shared)  #: the error that was allowed for
    floor: Floor | None = None  #: whose readings were left out

    @property
    def places(self) -> FloatArray:
        """Start poses (P, 3) for fitting a shared error: the best, and those of the second look."""
        return np.concatenate((self.poses[:1], self.looked))

    def starts(self, metres: float, radians: float) -> FloatArray:
        """Those of the places (P, 3) that may win with a shared error: all, or the one that leads.

        Poses that are nearer to it are the same place.
        """
        near = (pose_errors(self.places, self.places[0]) <= (metres, radians)).all(axis=1)
        return self.places[near | (not self.leads)]

    @property
    def mean_score(self) -> float:
        """Nats per reading of the best pose; -inf without one."""
        best = self.scores.log_likelihood[:1].sum()
        return float(best) / len(self.readings) if len(self.poses) else float("-inf")


def separate(
    features: MapFeatures, poses: FloatArray, scores: Scores, n: int, options: Options
) -> tuple[FloatArray, Scores, FloatArray]:
    """Group refined poses (M, 3), grid frame, that were scored by `n` readings, into modes.

    Returns the poses of the modes (C, 3), best first, the scores of the best maximum of each, and
    the second moments (C, 3, 3) of the maxima around these poses. A mode's pose is the mean of its
    maxima if a sensor can be there.
    """
    fused, score = options.fused, scores.things
    distance, angle = fused.separation
    best = modes(poses, score, distance=distance, angle=angle)
    tempered = score / temperature_of(scores, n, options, features.grid.resolution).value
    mean, spread = centres(poses, tempered, best, within=fused.separation, same=fused.same)
    off = np.where(stands(mean, options.prior, features)[:, None], 0, poses[best] - mean)
    off[:, 2] = wrap(off[:, 2])
    mean, spread = mean + off, spread + off[:, :, None] * off[:, None]
    apart = modes(mean, score[best], distance=distance, angle=angle)  # some have met
    return mean[apart], scores.select(best[apart]), spread[apart]


def temperature_of(scores: Scores, n: int, options: Options, cell: float) -> Temperature:
    """Temperature of scores by `n` readings on a map with cells of so many metres.

    It depends on how far the best place disagrees with the scan, by things.
    """
    lacks = options.model.best - float(scores.things.max(initial=-np.inf)) / n
    return options.trust.temperature_at(lacks, n, cell)


def lead(poses: FloatArray, score: FloatArray, options: Options) -> float:
    """Nats by which the first of poses (L, 3), the best one, leads all that are other hypotheses.

    `score` (L,) has their nats. Nothing leads by nothing, and a single place by infinitely many.
    """
    if not len(poses):
        return 0.0
    other = (pose_errors(poses, poses[0]) > options.fused.separation).any(axis=1)
    return float(score[0] - score[other].max(initial=-np.inf))


def rivals(without: Modes, whole: Modes, features: MapFeatures, options: Options) -> bool:
    """Return whether the best place `without` a floor is as good as one for the `whole` scan.

    The side of a cart looks like a floor, too, and what is left fits more places: all readings
    decide. One on the floor is a thing's, but lacks no more than one that fits.
    """
    there, seen = features.thinner(without.shared.thinner), whole.readings
    things = score_poses(there, seen, without.poses[:1], options.model).things[0]
    on = np.count_nonzero(on_floor(seen.ranges, seen.angles, cast(Floor, without.floor)))
    return bool(things + on * (APART - options.fused.strained) >= whole.scores.things[0])
