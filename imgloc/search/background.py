"""The score that a scan reaches in a building on no map, from the empty room that fits it best.

Every building has rectangular rooms, so a scan of a room fits somewhere in every map. Four straight
walls are fitted to the scan alone. Their score shows how much of the scan is only a room. What the
map explains beyond that room is evidence for the map. The score has a lower limit, because nearly
any scan fits any map somewhere by chance. A prior does not change this score: it says nothing about
the fit of buildings that are on no map.

Other floors of a building, and buildings like it, have corridors like those of the map. A scan from
there fits better than a room does, but some of it contradicts the map. :func:`contradiction` weighs
what is left unexplained.
"""

import numpy as np
import numpy.typing as npt

from imgloc.model import BoolArray, FloatArray
from imgloc.numbers import number
from imgloc.options import EvidenceModel
from imgloc.search.rescore import hit_density

CHANCE: float = number("background.chance")
"""Nats per reading below a perfect fit that a scan reaches by chance anywhere on a map."""
# headings of the room that are tried; it looks the same after a quarter turn
_HEADINGS = number("background.headings")
_BIN = number("background.bin")  # metres; a wall is looked for in three of them
_BINS = number("background.bins")
# nats against a place: factor on the misfit; of a scan of nothing but a room; of one all of whose
# readings pass through walls, though a run longer than a share of them tells no more
_STRANGE = number("background.strange")
_BARE, _THROUGH = number("background.bare"), number("background.through")
_LONGEST = number("background.longest")
# nats per reading by which a bare room falls short of four walls
_PLAIN = number("background.plain")


def unmapped_score(xy: FloatArray, model: EvidenceModel) -> float:
    """Mean log-density of readings in a building that is on no map, nats per reading.

    It is the score of the best empty room, but never farther than :data:`CHANCE` below a perfect
    fit.

    Parameters
    ----------
    xy : (N, 2) float array
        Endpoints in the sensor's frame, metres, N > 0.
    model : EvidenceModel
        The density of a reading by its distance from a wall.
    """
    return max(best_room(xy, model), model.best - CHANCE)


def contradiction(misfit: float, unmapped: float, through: float) -> float:
    """Evidence against a place that fits better than an empty room, nats after the temperature.

    The place is doubtful if map and scan disagree. It is doubtful if the scan shows nothing but an
    empty room, because every building has such rooms. And it is doubtful if neighbouring readings
    pass through a wall of the map, as through the open door of another floor.

    Parameters
    ----------
    misfit : float
        Nats per reading that the best pose lacks against a perfect fit.
    unmapped : float
        Nats per reading that the score of :func:`unmapped_score` lacks against a perfect fit.
    through : float
        Longest run of neighbouring readings that pass through a wall, as a share of all readings.

    Examples
    --------
    >>> contradiction(0.0, 3.0, 0.0) < 0.1
    True
    >>> contradiction(1.5, 1.0, 0.1) > 5, contradiction(0.1, 0.05, 0.0) > 5
    (True, True)
    """
    bare = 1 / (1 + (max(unmapped, 0.0) / _PLAIN) ** 4)
    return float(_STRANGE * max(misfit, 0.0) + _BARE * bare + _THROUGH * min(through, _LONGEST))


def best_room(xy: FloatArray, model: EvidenceModel) -> float:
    """Mean log-density of readings in the empty rectangular room that suits them best, nats.

    Parameters
    ----------
    xy : (N, 2) float array
        Endpoints in the sensor's frame, metres, N > 0. The sensor is in the room; walls that it
        does not see may be missing.
    model : EvidenceModel
        The density of a reading by its distance from a wall. The result compares with the score
        per reading of :func:`~imgloc.search.rescore.rescore`.

    Examples
    --------
    >>> u = np.linspace(-1.9, 1.9, 40)
    >>> corner = np.concatenate((np.stack((u, 0 * u + 1.5), 1), np.stack((0 * u - 2, u), 1)))
    >>> model = EvidenceModel()
    >>> model.best - best_room(corner, model) < 0.1
    True
    >>> scattered = 4 * np.random.default_rng(0).standard_normal((80, 2))
    >>> model.best - best_room(scattered, model) > 1
    True
    """
    theta = np.arange(_HEADINGS) * (np.pi / 2 / _HEADINGS)
    c, s = np.cos(theta)[:, None], np.sin(theta)[:, None]
    x, y = xy.T
    distance = np.minimum(_walls(c * x + s * y), _walls(c * y - s * x))
    density = hit_density(distance.astype(np.float32), model)
    return float(np.log(density).mean(axis=1, dtype=np.float64).max())


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
