"""Can this answer be trusted? Temperature, the chance of being elsewhere, and the verdict.

A scan from the best pose should score about as well as its readings can: close to
:attr:`~imgloc.search.rescore.EvidenceModel.best` nats each. What is missing, the **misfit**,
says how far map and scan disagree. Where they do, differences of evidence mean less than they
claim (the errors are not independent), and the true pose may be none of those found.
"""

from dataclasses import dataclass

import numpy as np

from imgloc.model import FloatArray

#: With more probability elsewhere than this there is no match.
DOUBT = 0.5

_PATCH = 0.2  # metres


@dataclass(frozen=True)
class Trust:
    """What turns evidence into probabilities and a verdict.

    Parameters
    ----------
    readings : int
        With valid readings in fewer directions than this a scan is ``invalid``.
    temperature : float
        What evidence is divided by where map and scan agree perfectly: neighbouring readings
        are not independent.
    strain : float
        Growth of the temperature per nat of misfit.
    crowded : float
        Growth of the temperature per reading on the same patch of wall, of :func:`crowding`, from
        where this makes more than 1 of it: they share the errors of the map, so that a scan of a
        corner with hundreds of readings says no more than one with a few.
    fine : float
        Cell of a map, metres, above which the temperature grows in proportion: all readings on a
        wall share the error of its place, up to half a cell.
    elsewhere : (float, float, float)
        Log-odds that the true pose is none of the hypotheses: constant, per nat of misfit, per
        share of the mass that the best hypothesis does not hold. A logistic regression on
        simulated scans in the bundled worlds, a third of them disturbed, against scans from
        other worlds; the constant is lowered by 2, as most scans are of their map.
    mass : float
        Mass that the best pose needs to be ``unique``.
    correlated : float
        How many neighbouring readings share one error, for the covariances.
    """

    readings: int = 10
    temperature: float = 1.5
    strain: float = 15.0
    crowded: float = 0.36
    fine: float = 0.1
    elsewhere: tuple[float, float, float] = (-5.1, 1.8, 3.9)
    mass: float = 0.9
    correlated: float = 2.9

    def temperature_at(self, misfit: float, crowding: float = 1.0, cell: float = 0.0) -> float:
        """Temperature for a misfit in nats per reading, readings per patch, and a map's cell.

        Examples
        --------
        >>> Trust(temperature=2.0, strain=10.0, crowded=0.5).temperature_at(0.5)
        7.0
        >>> Trust(temperature=2.0, strain=10.0, crowded=0.5).temperature_at(0.5, 6.0)
        21.0
        >>> Trust(temperature=2.0, strain=10.0).temperature_at(0.5, cell=0.2)
        14.0
        """
        shared = max(1.0, self.crowded * crowding) * max(1.0, cell / self.fine)
        return (self.temperature + self.strain * max(0.0, misfit)) * shared

    def mass_elsewhere(self, misfit: float, best: float) -> float:
        """Probability that the true pose is none of the hypotheses.

        A scan of another place fits badly, and it fits several poses equally badly.

        Parameters
        ----------
        misfit : float
            Of the best pose, nats per reading.
        best : float
            Mass of the best pose among the hypotheses, 0..1.

        Examples
        --------
        >>> Trust().mass_elsewhere(0.1, 1.0) < 0.01, Trust().mass_elsewhere(2.0, 0.2) > 0.5
        (True, True)
        """
        constant, per_nat, per_share = self.elsewhere
        odds = constant + per_nat * max(0.0, misfit) + per_share * (1 - best)
        return float(1 / (1 + np.exp(-odds)))


def crowding(xy: FloatArray) -> float:
    """Readings for each patch of 0.2 m that they fall on, from their endpoints (N, 2), metres.

    Examples
    --------
    >>> crowding(np.array([[1.01, 0.05], [1.03, 0.07], [1.05, 0.09], [5.0, 0.1]]))
    2.0
    """
    patches = np.unique(np.floor(xy / _PATCH), axis=0)
    return len(xy) / max(1, len(patches))


def judge(directions: int, mass: FloatArray, elsewhere: float, trust: Trust) -> str:
    """Return one of ``unique``, ``ambiguous``, ``no-match`` and ``invalid``.

    Parameters
    ----------
    directions : int
        Of the valid readings, see :attr:`~imgloc.model.LaserScan.directions`.
    mass : (M,) float array
        Of the hypotheses, best first.
    elsewhere : float
        Of :meth:`Trust.mass_elsewhere`.
    trust : Trust

    Examples
    --------
    >>> judge(181, np.array([0.6, 0.4]), 0.0, Trust())
    'ambiguous'
    """
    if directions < trust.readings:
        return "invalid"
    if len(mass) == 0 or elsewhere > DOUBT:
        return "no-match"
    return "unique" if mass[0] >= trust.mass else "ambiguous"
