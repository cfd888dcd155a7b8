"""Can this answer be trusted? The verdict on a list of hypotheses."""

from dataclasses import dataclass

from imgloc.model import FloatArray


@dataclass(frozen=True)
class Trust:
    """Thresholds of the verdict.

    Parameters
    ----------
    readings : int
        With fewer valid readings than this a scan is ``invalid``.
    explained : float
        If the best pose explains a smaller share of the readings than this, the scan is not
        from this map: ``no-match``.
    mass : float
        Mass that the best pose needs to be ``unique``.
    """

    readings: int = 10
    explained: float = 0.5
    mass: float = 0.9


def judge(valid: int, mass: FloatArray, explained: float, trust: Trust) -> str:
    """Return one of ``unique``, ``ambiguous``, ``no-match`` and ``invalid``.

    Parameters
    ----------
    valid : int
        Number of valid readings.
    mass : (M,) float array
        Of the hypotheses, best first.
    explained : float
        Share of the readings that the best pose explains.
    trust : Trust

    Examples
    --------
    >>> import numpy as np
    >>> judge(181, np.array([0.6, 0.4]), 0.95, Trust())
    'ambiguous'
    """
    if valid < trust.readings:
        return "invalid"
    if len(mass) == 0 or explained < trust.explained:
        return "no-match"
    return "unique" if mass[0] >= trust.mass else "ambiguous"
