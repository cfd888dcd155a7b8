"""Errors that all readings share: a scale that is off, walls that are drawn too thick.

A drawn or blurred map has walls that are thicker than the real ones. A plan may have another scale
than its file gives. A sensor's ranges may be too long by a share. Each of these errors moves all
readings together. If nothing fits well, the poses are refined once more with such an error free.
The error is kept if the readings fit far better with it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.scanpoints import Readings
from imgloc.model import FloatArray, LaserScan
from imgloc.numbers import number
from imgloc.options import SCALES, FusedOptions, Options, Shared
from imgloc.search.priors import standing
from imgloc.search.refine import FROM_CELLS, endpoints, refine
from imgloc.search.rescore import piece_evidence, pieces, score_readings, things_of_their_own

THINNEST: int = number("adapt.thinner")
"""Cells that walls may lose on each side."""
FROM_SCALES: tuple[float, ...] = number("adapt.scales")
"""Factors on the ranges from which the search for a scale starts."""
THINNER: int = number("adapt.walls")
"""Cells that walls are tried to lose on each side."""
GAIN: float = number("adapt.gain")
"""Nats per scan that thinner walls, or bent ones, have to gain."""
# Least distance of a scale that scans show from the one in use: as a logarithm, and in standard
# errors; nats per scan that it has to gain besides at places of a search.
_SCALED: tuple[float, float, float] = number("adapt.scaled")
BENT: float = number("adapt.bent")
"""Standard deviation of the place of a piece of wall, metres, on a map that is bent."""
# A map that others drew, as one scan tells: metres that its walls are thick at least, and that
# count at most; metres by which each side is too thick, and by which pieces of wall are off; misfit
# of scans at their true places, nats per reading; nats per metre of thickness, and nats that a
# piece counts for at most.
_THICK, _THICKEST, _LOSES, _OFF, _USUAL = number("adapt.drawn")
_DOUBT, _COUNTS = number("adapt.doubt")
# Nats against a place: per unit of the logarithm of a scale that was found, and per metre that
# walls were found to be too thick on each side.
_AGAINST: tuple[float, float] = number("adapt.against")
_PLACES, _READINGS = FusedOptions.closer, number("adapt.readings")  # how many are used


def as_seen(features: MapFeatures, scan: LaserScan, now: Shared) -> tuple[MapFeatures, LaserScan]:
    """The map and a scan of it without an error that all readings share."""
    return features.thinner(now.thinner), scan.scaled(now.scale)


@dataclass(frozen=True, eq=False)
class Told:
    """Evidence of one scan for errors that all readings share: nats of its best pose."""

    #: (T, 2) with walls that are 0 to T - 1 cells thinner, straight and bent
    walls: FloatArray = field(default_factory=lambda: np.zeros((THINNEST + 1, 2)))
    scaled: float = 0.0  #: with straight walls as they are in use, and another scale
    scale: float = 1.0  #: that scale: a factor on the ranges
    fits: bool = False  #: whether the scan fits as it is, and was asked nothing


def told_by(
    features: MapFeatures, readings: Readings, places: FloatArray, now: Shared, options: Options
) -> Told:
    """Find how much one scan speaks for another scale, or walls that are too thick, or bent.

    Summed over scans it parts a map that others drew from the robot's own, even where no scan fits
    at one place: each scan is placed where it fits best, for each error anew.

    Parameters
    ----------
    features : MapFeatures
        The map without any correction.
    readings : Readings
        Readings of the scan, their ranges already multiplied by the scale of `now`.
    places : (C, 3) float array, C > 0
        Poses to start from, grid frame: metres, metres, radians.
    now : Shared
        The error that is allowed for already.
    options : Options
        Possible poses and the score. A piece of the scan may be a thing of its own: moved furniture
        is no bent wall.
    """
    walls, places = np.full((THINNEST + 1, 2), -np.inf), places[:_PLACES]

    def told(thinner: int, places: FloatArray) -> tuple[FloatArray, float]:
        each, scale = _pieces(features, thinner, BENT, readings, places, options, things=True)
        return each.sum(axis=1), scale

    for n in range(THINNEST + 1):
        walls[n] = told(n, places)[0]
        if n >= max(THINNER, now.thinner) and walls[n, 0] <= walls[n - 1, 0]:
            walls[n + 1 :] = walls[n]  # asked no further: no veto of those that others gain by
            break
    (scaled, _), scale = told(now.thinner, _scaled(places))
    return Told(walls, float(scaled), scale)


def _pieces(
    features: MapFeatures, thinner: int, bent: float, readings: Readings, places: FloatArray,
    options: Options, *, things: bool = False,
) -> tuple[FloatArray, float]:  # fmt: skip
    """Evidence of each piece of wall where a scan fits best, straight and bent: (2, P) nats.

    Also the scale of the best pose on straight walls, a factor. The walls are so many cells
    thinner, and bent by so many metres, or a piece is one of `things` of their own. The evidence is
    -inf if a sensor can be at none of the places, (C, 3) or with a scale (C, 4).
    """
    there, straight = features.thinner(thinner), options.fused.model
    poses = refine(places, readings.xy, there.field, sigmas=FROM_CELLS)
    poses = standing(poses, options.prior, there)
    order, parts, _ = pieces(readings.ranges, readings.angles)
    if not len(poses):
        return np.full((2, len(parts)), -np.inf), 1.0
    distance = endpoints(poses, readings.xy, there.field)[2][:, order]
    told = [piece_evidence(distance, parts, model) for model in (straight, straight.bending(bent))]
    if things:
        own = things_of_their_own(parts, len(order), straight)
        told = [np.logaddexp(one, own) for one in told]
    best = [int(one.sum(axis=1).argmax()) for one in told]
    scale = float(poses[best[0], 3]) if poses.shape[1] == 4 else 1.0
    return np.stack([one[k] for one, k in zip(told, best, strict=True)]), scale


def judged(
    told: Sequence[Told], now: Shared, given: float = 1.0, image: float = 0.0, *,
    placed: bool = True, gain: float = GAIN,
) -> Shared:  # fmt: skip
    """The errors that scans speak for together; `given` is the scale without any of them.

    They compete: what gains most is allowed for, if that is more than `gain` nats per scan. The
    `image` speaks for bent walls, too, once: its nats are those of :func:`image_gain`. Scans that
    are not `placed` have to gain more by a scale: at wrong places they fit with any. How thick
    walls are, straight ones show: the offset of a bent wall may stand for its thickness. The scale
    is the median of those of the scans; if it differs from the given one by less than some standard
    errors, it is that one.

    Examples
    --------
    >>> def scan(*walls, scaled=0.0):
    ...     return Told(np.array(walls), scaled, 1.05)
    >>> thick, bent = scan([0.0, -20], [30, 10], scaled=20.0), scan([0.0, 20], [-5, 15])
    >>> for scans in ([thick, thick], [bent], [scan([0.0, 0], [10, 0], scaled=40.0)] * 3):
    ...     found = judged(scans, Shared())
    ...     print(found.thinner, found.bent, round(found.scale, 2))
    1 0.0 1.0
    0 0.15 1.0
    0 0.0 1.05
    """
    straight, bent = np.mean([one.walls for one in told], axis=0).T
    n, now_at = int(np.argmax(straight)), min(now.thinner, len(straight) - 1)
    if straight[n] <= straight[now_at] + gain:
        n = now_at
    scale, more = _scale_of(told, now, given), _SCALED[2]
    cost = gain + price(replace(now, scale=scale), replace(now, scale=given), 0.0)
    scaled = -np.inf if scale == now.scale else float(np.mean([one.scaled for one in told])) - cost
    best = max(straight[n], scaled)
    if not now.straight and bent[n] + image / len(told) > best + gain:
        return replace(now, thinner=now.thinner if n == now_at else n, bent=BENT)
    if scaled > straight[n]:
        return replace(now, scale=scale) if placed or scaled > straight[n] + more else now
    return replace(now, thinner=now.thinner if n == now_at else n)


def _scale_of(told: Sequence[Told], now: Shared, given: float) -> float:
    """The scale that scans show; that of `now` if theirs is not another one."""
    least, errors, _ = _SCALED
    logs = np.log([one.scale * now.scale for one in told])
    middle = float(np.median(logs))
    # The standard error of a median is 1.25 times a mean's.
    error = 1.25 * float(np.std(logs, ddof=1)) / np.sqrt(len(logs)) if len(logs) > 1 else 0.0
    unsure = max(least, errors * error)
    if abs(middle - np.log(given)) <= unsure:
        return given
    return float(np.exp(middle)) if unsure < abs(middle - np.log(now.scale)) else now.scale


def drawn_gain(
    features: MapFeatures, readings: Readings, places: FloatArray, options: Options
) -> float:
    """Nats by which a scan fits better with walls as others draw them than with straight ones.

    Each piece of wall counts for a few nats at most, because somebody who stands before a wall
    looks like a wall that is off. Straight walls may have another scale, at its :func:`price`. The
    parameters are those of :func:`told_by`. The gain is -inf where :func:`drawn_walls` would
    change nothing, or a sensor can be at none of the places.
    """
    asked = drawn_walls(features, np.inf, options.shared)
    if asked == options.shared:
        return float("-inf")
    places, known = places[:_PLACES], options.shared.thinner
    told = [_pieces(features, n, _OFF, readings, places, options)[0] for n in range(THINNER + 1)]
    while len(told) <= THINNEST and told[-1][0].sum() > told[-2][0].sum():
        told.append(_pieces(features, len(told), _OFF, readings, places, options)[0])
    scaled, _ = _pieces(features, known, _OFF, readings, _scaled(places), options)
    bent = told[min(asked.thinner, THINNER)][1]
    cost = _AGAINST[0] * np.abs(np.log(FROM_SCALES)).max()
    kinds = [(one[0], 0.0) for one in told] + [(scaled[0], float(cost))]
    straight, cost = max(kinds, key=lambda kind: kind[0].sum() - kind[1])
    if not np.isfinite(straight.sum() + bent.sum()):
        return float("-inf")
    return float(np.clip(bent - straight, -_COUNTS, _COUNTS).sum() + cost)


def drawn_thick(features: MapFeatures) -> bool:
    """Return whether the walls of an uncorrected map are so thick that no scans have shown them."""
    cell = features.grid.resolution
    return features.peels and features.thickness >= _THICK and features.thickness > 2 * cell


def image_gain(features: MapFeatures) -> float:
    """Nats by which the image of an uncorrected map speaks for walls as others draw them."""
    if not drawn_thick(features):
        return 0.0
    return float(_DOUBT * (min(features.thickness, _THICKEST) - _THICK))


def drawn_walls(features: MapFeatures, gain: float, now: Shared) -> Shared:
    """Take walls that are drawn thick for bent, unless scans fit far better with straight ones.

    One scan is rarely enough to know which walls a map has. The image is: walls that scans have
    shown are a cell or two thick, those that others drew are several decimetres thick, and off by
    as much. The thicker they are, the more must speak for straight walls.

    Parameters
    ----------
    features : MapFeatures
        The map without any correction.
    gain : float
        Sum of the :func:`drawn_gain` of some scans, nats.
    now : Shared
        The error that is allowed for already; the result if the walls are good as they are.
    """
    if now.bent or now.straight or not drawn_thick(features):
        return now
    if gain + image_gain(features) <= 0:
        return now
    cells = now.thinner or min(THINNER, max(1, round(_LOSES / features.grid.resolution)))
    return replace(now, thinner=cells, bent=_OFF, usual=max(now.usual, _USUAL))


def price(found: Shared, known: Shared, resolution: float) -> float:
    """Nats against a place that fits only with an error that was found: with one more places fit.

    What was `known` costs nothing, nor do walls that the image shows to be thick, nor one cell on
    each side, because walls are drawn in cells. `resolution` is that of the map, metres.

    Examples
    --------
    >>> round(price(Shared(1.05, 3), Shared(), 0.05), 1), price(Shared(1.05, 1), Shared(1.05), 0.05)
    (9.9, 0.0)
    """
    per_log, per_metre = _AGAINST
    scaled = abs(np.log(found.scale / known.scale))
    thinner = found.thinner - known.thinner - 1 if found.bent == known.bent else 0
    return float(per_log * scaled + per_metre * resolution * max(0, thinner))


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

    def best(poses: FloatArray, thinner: int) -> tuple[float, Shared]:
        there = features.thinner(thinner)
        poses = refine(poses, readings.xy, there.field, sigmas=FROM_CELLS)
        poses = standing(poses, options.prior, there)
        scale = now.scale * (poses[:, 3] if poses.shape[1] == 4 else np.ones(len(poses)))
        small = np.abs(np.log(scale / options.shared.scale)) <= np.log(fused.most_scaled)
        small &= (scale >= SCALES[0]) & (scale <= SCALES[1])
        if not small.any():
            return float("-inf"), now
        score = score_readings(there, readings, poses[small], options.model)
        k = int(score.argmax())
        return float(score[k]), replace(now, scale=float(scale[small][k]), thinner=thinner)

    places = places[:_PLACES]
    found = best(_scaled(places), now.thinner)
    walls = float("-inf"), now
    for n in range(now.thinner + 1, THINNEST + 1):
        again = best(places, n)
        if again[0] <= walls[0]:
            break
        walls = again
    score, shared = max(found, walls, key=lambda one: one[0])
    before = score_readings(features.thinner(now.thinner), readings, places[:1], options.model)
    gain = (score - before[0]) / len(readings)
    return shared if gain * count > fused.adapted else now


def _scaled(places: FloatArray) -> FloatArray:
    """The places (C, 3) with each scale from which the search for one starts: (S * C, 4).

    A reading that is too long ends behind its wall: refinement pulls it to the wall's far side.
    """
    with_scale = [np.column_stack((places, np.full(len(places), scale))) for scale in FROM_SCALES]
    return np.concatenate(with_scale)
