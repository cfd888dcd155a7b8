"""Errors that all readings share: a scale that is off, walls that are drawn too thick.

A map that is drawn, or that was blurred as it was made, has walls that are thicker than the real
ones; a plan is of another scale than it says; a sensor's ranges are too long by a share. Each of
these moves all readings together. Where nothing fits well, poses are refined once more with such
an error free, and the readings say by how much better they fit.
"""

import numpy as np

from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.scanpoints import Readings
from imgloc.model import FloatArray
from imgloc.numbers import number
from imgloc.options import Options, Shared
from imgloc.search.priors import standing
from imgloc.search.refine import refine
from imgloc.search.rescore import rescore

_SIGMAS = number("adapt.sigmas")
THINNEST: int = number("adapt.thinner")
"""Cells that walls may lose on each side."""
_SCALES = number("adapt.scales")  # at which the scale begins
_PLACES, _READINGS = number("adapt.places"), number("adapt.readings")  # that are asked


def adapt(
    features: MapFeatures,
    readings: Readings,
    places: FloatArray,
    now: Shared,
    options: Options,
) -> Shared:
    """The error with which the readings fit far better than with that of `now`; or `now`.

    Parameters
    ----------
    features : MapFeatures
        Of the map as it is.
    readings : Readings
        Of the scan, its lengths multiplied by the scale of `now`.
    places : (C, 3) float array, C > 0
        Where they may have been seen from, the best fit of `now` first; grid frame.
    now : Shared
        The error that is allowed for already.
    options : Options
        The poses that may be; the score, what is far better, and how far a scale may be from the
        one that is known.
    """
    fused = options.fused
    count, readings = len(readings), readings.spread(_READINGS)

    def score_of(poses: FloatArray, there: MapFeatures) -> FloatArray:
        seen = readings.ranges, readings.angles, there.field, there.walls
        return rescore(poses, *seen, fused.model).log_likelihood

    def best(poses: FloatArray, thinner: int) -> tuple[float, Shared]:
        there = features.thinner(thinner)
        poses = refine(poses, readings.xy, there.field, sigmas=_SIGMAS)
        poses = standing(poses, options.prior, there)
        scale = now.scale * (poses[:, 3] if poses.shape[1] == 4 else np.ones(len(poses)))
        small = np.abs(np.log(scale / options.shared.scale)) <= np.log(fused.most_scaled)
        if not small.any():
            return float("-inf"), now
        score = score_of(poses[small], there)
        k = int(score.argmax())
        return float(score[k]), Shared(float(scale[small][k]), thinner)

    # A reading that is too long ends behind its wall, and would be drawn to the other side of it.
    places = places[:_PLACES]
    scaled = [np.column_stack((places, np.full(len(places), scale))) for scale in _SCALES]
    found = best(np.concatenate(scaled), now.thinner)
    walls = float("-inf"), now
    for n in range(now.thinner + 1, THINNEST + 1):
        if not features.peels:
            break
        again = best(places, n)
        if again[0] <= walls[0]:
            break
        walls = again
    score, shared = max(found, walls, key=lambda one: one[0])
    before = score_of(places[:1], features.thinner(now.thinner))
    gain = (score - before[0]) / len(readings)
    return shared if gain * count > fused.adapted else now
