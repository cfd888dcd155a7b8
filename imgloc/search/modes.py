"""What the search found: separated modes, each in the mean of its maxima."""

from dataclasses import dataclass, field

import numpy as np

from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.scanpoints import Readings
from imgloc.geometry import wrap
from imgloc.model import FloatArray
from imgloc.options import Options, Shared
from imgloc.search.hypotheses import centres, modes
from imgloc.search.priors import stands
from imgloc.search.rescore import Scores


@dataclass(frozen=True)
class Modes:
    """What the search found, best first: C separated modes of the grid frame; there may be none."""

    poses: FloatArray  #: (C, 3) the mean of the maxima of each, if a sensor can be there
    scores: Scores  #: of the best of them
    readings: Readings  #: those that were scored
    complete: bool = True  #: the search came to its end
    #: (L, 3) those that got the second look, before they had it
    looked: FloatArray = field(default_factory=lambda: np.empty((0, 3)))
    #: (C, 3, 3) second moments of the maxima around those poses, if they are known
    spread: FloatArray | None = None
    shared: Shared = field(default_factory=Shared)  #: the error that was allowed for

    @property
    def mean_score(self) -> float:
        """Nats per reading of the best pose; -inf without one."""
        best = self.scores.log_likelihood[:1].sum()
        return float(best) / len(self.readings) if len(self.poses) else float("-inf")


def separate(
    features: MapFeatures, poses: FloatArray, scores: Scores, n: int, options: Options
) -> tuple[FloatArray, Scores, FloatArray]:
    """Modes of refined poses (M, 3) that were scored by `n` readings, best first.

    Their poses (C, 3), each in the mean of its maxima if a sensor can be there, the scores of the
    best of these, and their second moments (C, 3, 3) around the mean.
    """
    fused, score = options.fused, scores.log_likelihood
    distance, angle = fused.separation
    best = modes(poses, score, distance=distance, angle=angle)
    misfit = misfit_of(scores, n, options)
    tempered = score / options.trust.temperature_at(misfit, n, features.grid.resolution).value
    mean, spread = centres(poses, tempered, best, within=fused.separation, same=fused.same)
    off = np.where(stands(mean, options.prior, features)[:, None], 0, poses[best] - mean)
    off[:, 2] = wrap(off[:, 2])
    mean, spread = mean + off, spread + off[:, :, None] * off[:, None]
    apart = modes(mean, score[best], distance=distance, angle=angle)  # some have met
    return mean[apart], scores.select(best[apart]), spread[apart]


def misfit_of(scores: Scores, n: int, options: Options) -> float:
    """Nats per reading, of `n`, that the best of some scores lacks."""
    return options.fused.model.best - float(scores.log_likelihood.max(initial=-np.inf)) / n
