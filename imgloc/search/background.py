"""How well would a scan fit a building that nobody has mapped? As well as its best empty room does.

Any building has rectangular rooms, so that a scan of one fits somewhere in every map. Four straight
walls that are fitted to the scan alone say how much of it is no more than a room: what the map
explains beyond that is evidence for the map. And nearly any scan fits any map somewhere by chance.
"""

import numpy as np
import numpy.typing as npt

from imgloc.model import BoolArray, FloatArray
from imgloc.numbers import number
from imgloc.options import EvidenceModel
from imgloc.search.rescore import hit_density

CHANCE: float = number("background.chance")
"""Nats that a reading lacks where a scan is laid on a map by chance."""
CHANCE_TOLD: float = number("background.chance_told")
"""The same where so much is known of the pose that one place is left: of readings laid on a wrong
one they lack more, and a right one is not looked for where it is not."""
_PRIOR: float = number("background.prior")  # share of the evidence of a prior that is believed
# of the room, over the quarter turn after which it is itself again
_HEADINGS = number("background.headings")
_BIN = number("background.bin")  # metres; a wall is looked for in three of them
_BINS = number("background.bins")


def unmapped_score(
    xy: FloatArray, model: EvidenceModel, share: float = 1.0, nats: float = 0.0
) -> float:
    """Mean log-density of readings (N, 2) in a building that is on no map, nats.

    That of :func:`best_room`, but never less than :data:`CHANCE` below a perfect fit.

    Parameters
    ----------
    share : float
        Of the poses of the map that are left by what is known, 0..1. The fewer there are, the less
        likely a room fits at one of them; and the nearer to :data:`CHANCE_TOLD` is what must be
        lacking for the place to be a wrong one.
    nats : float
        Of a reading, that one nat of evidence is worth: the temperature over N.
    """
    chance = CHANCE_TOLD + (CHANCE - CHANCE_TOLD) * share
    fewer = _PRIOR * nats * float(np.log(max(share, 1e-12)))
    return max(best_room(xy, model) + fewer, model.best - chance)


def best_room(xy: FloatArray, model: EvidenceModel) -> float:
    """Mean log-density of readings in the empty rectangular room that suits them best, nats.

    Parameters
    ----------
    xy : (N, 2) float array
        Endpoints in the sensor's frame, metres, N > 0. The sensor is in the room; walls that it
        does not see may be missing.
    model : EvidenceModel
        The density of a reading by its distance from a wall, as in
        :func:`~imgloc.search.rescore.rescore`; comparable with a score of that per reading.

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
    """Distance of points (K, N), one coordinate, to the nearer of two walls, one on each side.

    A wall stands where most points of its side are: at the peak of their histogram.
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
    place[count == 0] = np.inf  # nothing is seen on this side: no wall, not one at the sensor
    return np.asarray(np.abs(u - place[:, None]))
