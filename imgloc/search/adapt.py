"""Errors that all readings share: a scale that is off, walls that are drawn too thick.

A drawn or blurred map has walls that are thicker than the real ones. A plan may have another scale
than its file gives. A sensor's ranges may be too long by a share. Each of these errors moves all
readings together. If nothing fits well, the poses are refined once more with such an error free.
The error is kept if the readings fit far better with it.
"""

from dataclasses import replace

import numpy as np

from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.scanpoints import Readings
from imgloc.model import FloatArray
from imgloc.numbers import number
from imgloc.options import SCALES, Options, Shared
from imgloc.search.priors import standing
from imgloc.search.refine import endpoints, refine
from imgloc.search.rescore import bent_evidence, hit_density, rescore

_SIGMAS = number("adapt.sigmas")
THINNEST: int = number("adapt.thinner")
"""Cells that walls may lose on each side."""
_SCALES = number("adapt.scales")  # factors from which the search for a scale starts
THINNER: int = number("adapt.walls")
"""Cells that walls are tried to lose on each side."""
_GAIN = number("adapt.gain")  # nats per scan that thinner walls have to gain
BENT: float = number("adapt.bent")
"""Standard deviation of the place of a piece of wall, metres, on a map that is bent."""
_PLACES, _READINGS = number("adapt.places"), number("adapt.readings")  # how many are used


def wall_evidence(
    features: MapFeatures, readings: Readings, places: FloatArray, options: Options
) -> FloatArray:
    """Find how much one scan speaks for walls that are too thick, or bent.

    Summed over scans it tells a map that others drew from the robot's own, even where no scan fits
    at one place: each scan is placed where it fits best, for each kind of walls anew.

    Parameters
    ----------
    features : MapFeatures
        The map without any correction.
    readings : Readings
        Readings of the scan.
    places : (C, 3) float array, C > 0
        Poses to start from, grid frame: metres, metres, radians.
    options : Options
        Possible poses and the score.

    Returns
    -------
    (T, 2) float array
        Nats of the best pose, with walls that are 0 to T - 1 cells thinner, straight and bent.
    """
    out = np.full((THINNER + 1, 2), -np.inf)
    for n in range(THINNER + 1 if features.peels else 1):
        there = features.thinner(n)
        poses = refine(places[:_PLACES], readings.xy, there.field, sigmas=_SIGMAS)
        poses = standing(poses, options.prior, there)
        if len(poses):
            model = options.fused.model.bending(BENT)
            distance = endpoints(poses, readings.xy, there.field)[2]
            out[n, 0] = np.log(hit_density(distance, model)).sum(axis=1, dtype=np.float64).max()
            out[n, 1] = bent_evidence(distance, readings.ranges, readings.angles, model).max()
    return out


def walls_of(evidence: FloatArray, now: Shared) -> Shared:
    """The walls that scans with this :func:`wall_evidence` (N, T, 2) speak for together.

    How thick walls are, straight ones tell: the offset of a bent wall may stand for its thickness.

    Examples
    --------
    >>> thick, bent = [[0.0, -20], [30, 10]], [[0.0, 20], [-5, 15]]
    >>> found = [walls_of(np.array(scans), Shared()) for scans in ([thick, thick], [bent])]
    >>> [(shared.thinner, shared.bent) for shared in found]
    [(1, 0.0), (0, 0.15)]
    """
    straight, bent = np.mean(evidence, axis=0).T
    n, now_at = int(np.argmax(straight)), min(now.thinner, len(straight) - 1)
    if straight[n] - straight[now_at] <= _GAIN:
        n = now_at
    thinner = now.thinner if n == now_at else n
    return replace(now, thinner=thinner, bent=BENT if bent[n] > straight[n] else now.bent)


def adapt(
    features: MapFeatures,
    readings: Readings,
    places: FloatArray,
    now: Shared,
    options: Options,
) -> Shared:
    """Find a shared error with which the readings fit far better than with `now`.

    Parameters
    ----------
    features : MapFeatures
        The map without any correction.
    readings : Readings
        Readings of the scan, their ranges already multiplied by the scale of `now`.
    places : (C, 3) float array, C > 0
        Poses to start from, grid frame: metres, metres, radians. The best fit of `now` comes first.
    now : Shared
        The error that is allowed for already.
    options : Options
        Possible poses, the score, the gain in nats that counts as far better, and how far a scale
        may be from `options.shared.scale`, a factor.

    Returns
    -------
    Shared
        The better error, or `now` if there is none.
    """
    fused = options.fused
    count, readings = len(readings), readings.spread(_READINGS)

    def score_of(poses: FloatArray, there: MapFeatures) -> FloatArray:
        seen = readings.ranges, readings.angles, there.field, there.walls
        return rescore(poses, *seen, options.model).log_likelihood

    def best(poses: FloatArray, thinner: int) -> tuple[float, Shared]:
        there = features.thinner(thinner)
        poses = refine(poses, readings.xy, there.field, sigmas=_SIGMAS)
        poses = standing(poses, options.prior, there)
        scale = now.scale * (poses[:, 3] if poses.shape[1] == 4 else np.ones(len(poses)))
        small = np.abs(np.log(scale / options.shared.scale)) <= np.log(fused.most_scaled)
        small &= (scale >= SCALES[0]) & (scale <= SCALES[1])
        if not small.any():
            return float("-inf"), now
        score = score_of(poses[small], there)
        k = int(score.argmax())
        return float(score[k]), replace(now, scale=float(scale[small][k]), thinner=thinner)

    # A reading that is too long ends behind its wall: refinement pulls it to the wall's far side.
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
