"""The score that a scan reaches in a building on no map, from the empty room that fits it best.

Every building has rectangular rooms, so a scan of a room fits somewhere in every map. Four straight
walls are fitted to the scan alone. Their score shows how much of the scan is only a room: each
piece is one of these walls, or a thing by itself. What the map explains beyond that is
evidence for the map. A prior does not change this score: it is about this map alone, not about
buildings that are on no map.
"""

import numpy as np
import numpy.typing as npt

from imgloc.features.scanpoints import Readings
from imgloc.model import BoolArray, FloatArray
from imgloc.numbers import number
from imgloc.options import EvidenceModel
from imgloc.search.rescore import by_things, hit_density, pieces, things_of_their_own

# headings of the room that are tried; it looks the same after a quarter turn
_HEADINGS = number("background.headings")
_BIN = min(EvidenceModel.sigmas)  # metres; a wall is looked for in three of them
_BINS = number("background.bins")


def unmapped_score(readings: Readings, model: EvidenceModel) -> float:
    """Mean log-density of readings in a building that is on no map, nats per reading.

    It is the score of the best empty room. Things of their own stand in it, but not where walls are
    bent: there the poses have none, either.

    Parameters
    ----------
    readings : Readings
        The scan, at least one reading.
    model : EvidenceModel
        The density of a reading by its distance from a wall.
    """
    order, parts, goes_on = pieces(readings.ranges, readings.angles)
    told = np.add.reduceat(best_room(readings.xy, model)[order], parts)
    if model.bent:
        return float(told.sum()) / len(order)
    own = things_of_their_own(parts, len(order), model)
    return float(by_things(told[None], own, goes_on)[0]) / len(order)


def best_room(xy: FloatArray, model: EvidenceModel) -> FloatArray:
    """Log-densities (N,) of readings in the empty rectangular room that suits them best, nats.

    Parameters
    ----------
    xy : (N, 2) float array
        Endpoints in the sensor's frame, metres, N > 0. The sensor is in the room; walls that it
        does not see may be missing.
    model : EvidenceModel
        The density of a reading by its distance from a wall. The results compare with those that
        :func:`~imgloc.search.rescore.score_poses` adds.

    Examples
    --------
    >>> u = np.linspace(-1.9, 1.9, 40)
    >>> corner = np.concatenate((np.stack((u, 0 * u + 1.5), 1), np.stack((0 * u - 2, u), 1)))
    >>> model = EvidenceModel()
    >>> bool(model.best - best_room(corner, model).mean() < 0.1)
    True
    >>> scattered = 4 * np.random.default_rng(0).standard_normal((80, 2))
    >>> bool(model.best - best_room(scattered, model).mean() > 1)
    True
    """
    theta = np.arange(_HEADINGS) * (np.pi / 2 / _HEADINGS)
    c, s = np.cos(theta)[:, None], np.sin(theta)[:, None]
    x, y = xy.T
    distance = np.minimum(_walls(c * x + s * y), _walls(c * y - s * x))
    told = np.log(hit_density(distance.astype(np.float32), model)).astype(np.float64)
    return np.asarray(told[told.sum(axis=1).argmax()])


def _walls(u: FloatArray) -> FloatArray:
    """Distance of points, one coordinate (K, N) in metres, to the nearer wall of two.

    One wall is on each side of 0. A wall stands at the peak of the histogram of its side's points.
    """
    bins = np.minimum(np.abs(u) / _BIN, _BINS - 1).astype(np.int64)
    return np.minimum(*(_wall(u, bins, side) for side in (u > 0, u <= 0)))


def _wall(u: FloatArray, bins: npt.NDArray[np.int64], side: BoolArray) -> FloatArray:
    rows = np.broadcast_to(np.arange(len(u))[:, None] * _BINS, u.shape)
    counts = np.bincount((rows + bins)[side], minlength=len(u) * _BINS).reshape(len(u), _BINS)
    three = counts.copy()
    three[:, 1:] += counts[:, :-1]
    three[:, :-1] += counts[:, 1:]
    member = side & (np.abs(bins - three.argmax(axis=1)[:, None]) <= 1)
    count = member.sum(axis=1)
    place = np.where(member, u, 0).sum(axis=1) / np.maximum(count, 1)
    place[count == 0] = np.inf  # no points on this side: no wall, rather than one at the sensor
    return np.asarray(np.abs(u - place[:, None]))
