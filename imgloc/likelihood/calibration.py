"""How much a stack is worth: the smoothing and the temperature that make it a probability.

Votes and correlations count evidence in a unit of their own, and eq. 2 counts readings as if
each knew nothing of the others. What both are worth is measured: by the index S of eq. 12 on
scans whose poses are known, see :mod:`imgloc.calibrate`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from types import MappingProxyType

import numpy as np

from imgloc.errors import ConfigError

LOG_METHODS = frozenset({"beam"})
"""Stacks whose values are logarithms already."""
FEW = 20.0
"""Readings with which votes are worth half of what they are with very many: of 31, 61, 181 and
721 rays the best exponents were as 0.5, 0.9, 1 and 1.1 (ght-v, ``visibility`` and ``curved``)."""


@dataclass(frozen=True)
class Calibration:
    """What makes a probability of one method's stack.

    Parameters
    ----------
    sigma_xy, sigma_theta : float
        Of the Gaussian that models the uncertainty of eq. 8: metres and radians.
    temperature : float
        Votes and correlations are raised to the power ``1 / temperature``. Log-likelihoods,
        which are sums over the readings, are divided by ``temperature * readings``.

    Raises
    ------
    ConfigError
        If a value is out of its range.
    """

    sigma_xy: float = 0.0
    sigma_theta: float = 0.0
    temperature: float = 1.0

    def __post_init__(self) -> None:
        for part in fields(self):
            value = getattr(self, part.name)
            least = "positive" if part.name == "temperature" else "not negative"
            if not (np.isfinite(value) and value >= 0 and (value > 0 or least != "positive")):
                raise ConfigError(f"{part.name} must be finite and {least}, got {value}")

    def temperature_at(self, method: str, readings: int) -> float:
        """Temperature for a scan with so many valid readings; more of them do not add more.

        Parameters
        ----------
        method : str
        readings : int
            Valid ones.

        Examples
        --------
        >>> Calibration(temperature=0.1).temperature_at("beam", 300)
        30.0
        >>> round(Calibration(temperature=0.1).temperature_at("ght", 20), 6)
        0.2
        """
        return self.temperature * scale(method, readings)


def scale(method: str, readings: int) -> float:
    """What the number of readings does to a temperature.

    Logarithms are sums over the readings, whose errors are shared: the pose is beside the centre
    of its cell, the walls of the map are beside the true ones. Votes are compared with one
    another, so that their number cancels, but few readings are a small sample.
    """
    n = float(max(1, readings))
    return n if method in LOG_METHODS else 1 + FEW / n


#: What is used for a map that has no calibration of its own: fitted jointly on bundled worlds (not
#: ``large``), two thirds of the scans disturbed, by ``imgloc calibrate curved visibility corridor
#: double_wall -n 12 --seed 1000 --dry-run``.
DEFAULTS: Mapping[str, Calibration] = MappingProxyType(
    {
        "cbml": Calibration(temperature=1 / 11.3),
        "cbml-o": Calibration(0.1, 0.0, 1 / 12.7),
        "ght": Calibration(0.2, float(np.deg2rad(10.0)), 1 / 10.1),
        "ght-v": Calibration(0.2, float(np.deg2rad(15.0)), 1 / 12.7),
        "beam": Calibration(temperature=1 / 6.35),
    }
)
