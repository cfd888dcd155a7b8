"""What :mod:`imgloc.experiments.complexity` measures, and what the paper's appendix says of it."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

METHODS = ("cbml", "cbml-o", "ght", "ght-v", "beam")
AXES: Mapping[str, tuple[float, ...]] = MappingProxyType(
    {
        "A": (1, 2, 4, 8),
        "rho_m": (5, 10, 20, 40),
        "rho_theta": (15, 30, 60, 120),
        "n": (90, 180, 360, 720),
    }
)
"""What grows: copies of the world, cells per metre, headings, readings."""
QUANTITIES = ("init_s", "storage", "run_s", "init_work", "work")
TIMES = ("init_s", "run_s")
"""Those that two runs do not share."""
BASE: Mapping[str, float] = MappingProxyType({"A": 1, "rho_m": 10, "rho_theta": 60, "n": 181})
"""The value of each axis while another one grows."""


def _powers(a: float, m: float, theta: float, n: float) -> dict[str, float]:
    return {"A": a, "rho_m": m, "rho_theta": theta, "n": n}


_CORRELATION = {"init_s": _powers(1, 4, 0, 0), "storage": _powers(1, 2, 0, 0)}
PAPER: Mapping[str, Mapping[str, Mapping[str, float]]] = MappingProxyType(
    {
        "cbml": {**_CORRELATION, "run_s": _powers(1, 2, 1, 1)},
        "cbml-o": {**_CORRELATION, "run_s": _powers(1, 2, 1, 1)},
        "ght": {"storage": _powers(1, 1, 0, 0), "run_s": _powers(1, 1, 0, 1)},
        "ght-v": {
            "init_s": _powers(1, 2, 0, 0),
            "storage": _powers(1, 1, 1, 0),
            "run_s": _powers(1, 1, 0, 1),
        },
        "beam": {
            "init_s": _powers(1, 3, 1, 0),
            "storage": _powers(1, 2, 1, 0),
            "run_s": _powers(1, 2, 1, 1),
        },
    }
)
"""Exponents of the appendix: method, quantity, axis. GHT's init time is 0 there."""


@dataclass(frozen=True)
class Sample:
    """One method, measured at one point of one axis.

    Parameters
    ----------
    method, axis : str
        Of :data:`METHODS` and :data:`AXES`.
    value : float
        m^2 for ``A``, cells per metre, headings, readings.
    init_s : float
        Seconds to prepare the map; NaN if not timed. The surface points, which all but ``beam``
        need, are the init of ``ght`` alone.
    run_s : float
        Seconds for a scan; NaN if not timed.
    storage : int
        Bytes of the arrays that a scan is compared with.
    init_work : int
        Image pixels walked over (filter taps, for the blurred maps); rays, for ``ght-v``.
    work : int
        Pixels added, for ``cbml``, ``cbml-o`` and ``beam``; votes, for ``ght`` and ``ght-v``; of
        a scan.
    traced : int
        For ``beam``: cells that a ray tracer would walk over from all free cells.
    """

    method: str
    axis: str
    value: float
    init_s: float
    run_s: float
    storage: int
    init_work: int
    work: int
    traced: int = 0


@dataclass(frozen=True)
class Fit:
    """An exponent: `quantity` of `method` grows with this power of `axis`.

    `paper` is what the appendix says, or None where it says nothing.
    """

    method: str
    axis: str
    quantity: str
    exponent: float
    paper: float | None


@dataclass(frozen=True)
class Complexity:
    """All samples and the exponents fitted to them."""

    world: str
    samples: tuple[Sample, ...]
    fits: tuple[Fit, ...]

    def exponent(self, method: str, axis: str, quantity: str) -> float:
        """Return the exponent of one fit.

        Raises
        ------
        KeyError
            If it was not measured.
        """
        for fit in self.fits:
            if (fit.method, fit.axis, fit.quantity) == (method, axis, quantity):
                return fit.exponent
        raise KeyError((method, axis, quantity))
