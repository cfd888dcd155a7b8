"""The distance of the true pose from the best one at most: a radius for each probability.

The true pose is near one of the modes, each with its mass, or elsewhere. Near a mode, its position
is spread as Student's t, whose tail is longer than a Gaussian's: now and then a pose is worse than
its covariance claims. Its heading is spread as a Gaussian. The scale is the standard deviation that
the scan claims, together with an error that all readings of a map share: its walls are drawn where
they were measured, not where they are. The numbers of these spreads come from recorded poses
(`python -m tools.trust levels`), which have errors of their own, so that radii are rather too
large.

A level is what an aircraft calls a protection level: the radius whose chance of being left is no
more than allowed. Where the mass elsewhere alone is more than that, no radius will do.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imgloc.geometry import pose_errors
from imgloc.model import FloatArray, Protection
from imgloc.numbers import number

SHARES: tuple[float, ...] = (0.95, 0.99, 0.999)
"""Probabilities for which an answer has a level."""
_STEPS = np.geomspace(1e-3, 1e3, 400)  # metres, radians: a level is the next of these, 3.5 % apart
_MINUTE = 1e-6  # mass of a mode that counts as elsewhere: a thousandth of what a level allows
# Standard deviations, beyond which what a Gaussian has left is nothing beside 1.
_FAR = math.sqrt(-2 * math.log(np.finfo(np.float64).eps))
_erfc = np.frompyfunc(math.erfc, 1, 1)


@dataclass(frozen=True)
class Spread:
    """The spread of the true pose around a mode."""

    scale: float  #: factor on the standard deviation
    shared: float  #: standard deviation of the error that all readings share, metres or radians
    #: degrees of freedom of Student's t in the plane; None for a Gaussian along a line
    tail: float | None = None

    def units(self, deviation: FloatArray) -> FloatArray:
        """The scale of the distance, metres or radians, of modes with a standard deviation."""
        return self.scale * np.hypot(deviation, self.shared)

    def beyond(self, distance: FloatArray) -> FloatArray:
        """The chance that the truth is farther than a distance, in :meth:`units`.

        Examples
        --------
        >>> Spread(1, 0, 4.0).beyond(np.array([0.0, 2.0])).tolist()
        [1.0, 0.25]
        >>> Spread(1, 0, None).beyond(np.array([0.0, 1.96])).round(3).tolist()
        [1.0, 0.05]
        """
        if self.tail is None:
            out, some = np.asarray(distance == 0, np.float64), (distance > 0) & (distance < _FAR)
            out[some] = _erfc(distance[some] * math.sqrt(0.5))  # slow: one by one
            return out
        return np.asarray((1 + np.square(distance) / self.tail) ** (-self.tail / 2))


POSITION = Spread(*number("protection.position"))
"""Of positions, metres."""
HEADING = Spread(*number("protection.heading"))
"""Of headings, radians."""


def protection(
    poses: FloatArray,
    mass: FloatArray,
    covariance: FloatArray,
    elsewhere: float,
    shares: Sequence[float] = SHARES,
    *,
    farthest: float = np.inf,
) -> tuple[Protection, ...]:
    """Radius and heading around the best of some poses that hold the true pose.

    Parameters
    ----------
    poses : (M, 3) float array
        Modes, the best one first: metres, metres, radians.
    mass : (M,) float array
        Probability of each.
    covariance : (L, 3, 3) float array
        Of the first L of them; the others are taken for as uncertain as the worst of these.
    elsewhere : float
        Probability that the true pose is at none of them.
    shares : sequence of float
        Probabilities that the levels hold, each below 1.
    farthest : float
        Metres from corner to corner of the map: a larger radius means nothing.

    Returns
    -------
    tuple of Protection
        One for each share: infinite where `elsewhere` leaves less than that, or beyond `farthest`.

    Examples
    --------
    >>> poses, covariance = np.array([[0, 0, 0.0], [8, 0, 0.0]]), np.diag([1e-4, 1e-4, 1e-6])[None]
    >>> sure, unsure = (
    ...     protection(poses, np.array([best, 0.999 - best]), covariance, 0.001, [0.9])[0]
    ...     for best in (0.95, 0.85)
    ... )
    >>> sure.metres < 1, 8 < unsure.metres < 9
    (True, True)
    """
    if len(poses) == 0:
        return tuple(Protection(share, np.inf, np.inf) for share in shares)
    variance = covariance[:, 2, 2], np.linalg.eigvalsh(covariance[:, :2, :2])[:, -1]
    turned, wide = (np.sqrt(np.maximum(v, 0)) for v in variance)
    away, aside = pose_errors(poses, poses[0]).T
    metres = levels(away, wide, mass, elsewhere, shares, POSITION)
    metres = np.where(metres > farthest, np.inf, metres)
    radians = levels(aside, turned, mass, elsewhere, shares, HEADING)
    return tuple(
        Protection(share, float(m), float(t if np.isinf(t) else min(t, np.pi)))
        for share, m, t in zip(shares, metres, radians, strict=True)
    )


def levels(
    away: FloatArray,
    deviation: FloatArray,
    mass: FloatArray,
    elsewhere: float,
    shares: Sequence[float],
    spread: Spread,
) -> FloatArray:
    """Distances (S,) from the first of M modes that hold the truth with some probabilities.

    The modes are `away` (M,) from it, and have a `mass` (M,); the first L a `deviation` (L,).
    """
    unit = np.full(len(away), spread.units(deviation).max())
    unit[: len(deviation)] = spread.units(deviation)
    big = mass > _MINUTE
    left = np.maximum(_STEPS[:, None] - away[big], 0) / unit[big]
    risk = elsewhere + mass[~big].sum() + spread.beyond(left) @ mass[big]
    allowed = 1 - np.asarray(shares)
    at = np.argmax(risk[:, None] <= allowed, axis=0)
    return np.where(risk[at] <= allowed, _STEPS[at], np.inf)
