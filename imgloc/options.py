"""Everything that decides an answer, apart from the map and the scan: plain, frozen values.

>>> Options(method="ght-v").top is None, Options(trust=Trust(mass=0.99)).method
(True, 'fused')
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Annotated

import numpy as np

from imgloc.errors import ConfigError
from imgloc.geometry import cell_of, inside, uniform_thetas, wrap
from imgloc.model import BoolArray, FloatArray, GridInfo, Temperature
from imgloc.numbers import number
from imgloc.ranges import Checked, OneOf, Within

Metres = Annotated[float, Within(0, 1e6, "metres")]
Length = Annotated[float, Within(1e-4, 1e6, "metres")]  #: of something that has one
Radians = Annotated[float, Within(0, 2 * np.pi, "radians")]
Heading = Annotated[float, Within(-1e6, 1e6, "radians")]
Step = Annotated[float, Within(1e-4, 2 * np.pi, "radians")]
Share = Annotated[float, Within(0, 1, "a share")]
Nats = Annotated[float, Within(0, np.inf, "nats")]
Factor = Annotated[float, Within(1e-6, 1e6, "a factor")]
LogOdds = Annotated[float, Within(-1e6, 1e6, "log-odds")]
Count = Annotated[int, Within(1, 1e12, "at least one")]

FUSED = "fused"
#: share of the mass found that the hypotheses listed hold
MOST_OF_IT = number("options.most_of_it")
#: hypotheses that are listed, however much mass they hold
AT_LEAST: int = number("options.at_least")
AT_MOST: int = number("options.at_most")


@dataclass(frozen=True)
class Method:
    """One of the paper's algorithms: the step of its headings in degrees, and what it does."""

    theta_step_deg: float
    summary: str


#: The paper's algorithms by name; change one word to swap them.
METHODS: Mapping[str, Method] = MappingProxyType(
    {
        "cbml": Method(3.0, "correlation with the blurred map, Alg. 1 and 2"),
        "cbml-o": Method(3.0, "correlation of vector fields, Alg. 3"),
        "ght": Method(10.0, "Hough votes of pairs of oriented points, Alg. 4"),
        "ght-v": Method(10.0, "Hough votes that the map lets through, Alg. 5"),
        "beam": Method(3.0, "ray-traced ranges for every pose, eq. 2"),
    }
)
ALL_METHODS = (FUSED, *METHODS)  #: every name that `localize` takes
LOG_METHODS = frozenset({"beam"})  #: stacks whose values are logarithms already
FEW = number("options.few_votes")
"""Readings with which votes are worth half of what they are with very many: of 31, 61, 181 and
721 rays the best exponents were as 0.5, 0.9, 1 and 1.1 (ght-v, ``visibility`` and ``curved``)."""


@dataclass(frozen=True)
class Calibration(Checked):
    """What makes a probability of one method's stack."""

    #: of the Gaussian that models the uncertainty of eq. 8: metres and radians.
    sigma_xy: Metres = 0.0
    sigma_theta: Radians = 0.0
    #: votes and correlations are raised to the power ``1 / temperature``. Log-likelihoods, which
    #: are sums over the readings, are divided by ``temperature * readings``.
    temperature: Factor = 1.0

    def temperature_at(self, method: str, readings: int) -> float:
        """Temperature for a scan with so many valid readings; more of them do not add more.

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


def _default(method: str) -> Calibration:
    metres, radians, exponent = number(f"Calibration.{method}")
    return Calibration(metres, radians, 1 / exponent)


#: What is used for a map that has no calibration of its own.
DEFAULTS: Mapping[str, Calibration] = MappingProxyType({name: _default(name) for name in METHODS})


@dataclass(frozen=True)
class Prior(Checked):
    """A set of poses; None is all of them.

    Examples
    --------
    >>> prior = Prior(np.array([[True, False]]), (0.0, 0.5))
    >>> prior.admits(np.array([[0.5, 0.5, 6.0], [1.5, 0.5, 0], [0.5, 0.5, 1]]), 1.0).tolist()
    [True, False, False]
    """

    cells: BoolArray | None = None  #: (H, W) those of the map in which the sensor may be
    #: in the grid frame, and how far it may be off, radians
    heading: tuple[Heading, Radians] | None = None
    #: what it was made of, as plain values, for the record
    about: Mapping[str, object] = field(default_factory=dict)

    def __and__(self, other: "Prior") -> "Prior":
        """The poses that both allow; a ConfigError if both state a heading."""
        if self.heading is not None and other.heading is not None:
            raise ConfigError("the heading is given twice: by a pose and on its own")
        given = [c for c in (self.cells, other.cells) if c is not None]
        cells = np.logical_and.reduce(given) if given else None
        heading = self.heading if self.heading is not None else other.heading
        return Prior(cells, heading, {**self.about, **other.about})

    def admits(self, poses: FloatArray, resolution: float) -> BoolArray:
        """Which poses (C, 3), grid frame, are in the set: (C,) bool."""
        ok = self.headings(poses[:, 2])
        if self.cells is not None:
            at = cell_of(poses[:, :2], resolution)
            height, width = self.cells.shape
            on_map = inside(at, GridInfo(height, width, resolution))
            row, col = at[on_map].T
            ok[on_map] &= self.cells[row, col]
            ok &= on_map
        return ok

    def headings(self, thetas: FloatArray, slack: float = 0.0) -> BoolArray:
        """Which headings are in the set, or less than `slack` beside it: bool, as `thetas`."""
        if self.heading is None:
            return np.ones(np.shape(thetas), bool)
        centre, tolerance = self.heading
        return np.asarray(np.abs(wrap(thetas - centre)) <= tolerance + slack + 1e-9)


@dataclass(frozen=True)
class EvidenceModel(Checked):
    """The parameters of the score."""

    #: standard deviations of an endpoint's distance from its surface, metres, equally probable for
    #: every reading
    sigmas: Sequence[Length] = number("EvidenceModel.sigmas")
    #: share of the readings that come from mapped surfaces
    hit: Annotated[float, Within(0, 0.9999, "a share")] = number("EvidenceModel.hit")
    #: metres over which the readings that do not come from the map are spread
    span: Length = number("EvidenceModel.span")
    #: probability that a mapped wall is not there any more
    absent: Annotated[float, Within(1e-6, 1, "a probability")] = number("EvidenceModel.absent")
    #: metres by which a reading may pass a wall at no cost, besides half a cell
    margin: Metres = number("EvidenceModel.margin")
    #: how far beyond that a wall may be drawn in a wrong place, metres: the chance falls like a
    #: Gaussian of this scale, down to `absent`
    displaced: Length = number("EvidenceModel.displaced")

    @property
    def best(self) -> float:
        """Log-density of a reading that ends on a surface exactly, nats."""
        peak = self.hit * np.mean(1 / (np.sqrt(2 * np.pi) * np.asarray(self.sigmas)))
        return float(np.log(peak + (1 - self.hit) / self.span))


@dataclass(frozen=True)
class FusedOptions(Checked):
    """What the search spends where."""

    #: between the headings of the endpoint correlation, radians
    theta_step: Step = number("FusedOptions.theta_step")
    #: nodes kept by each level of the endpoint pyramid, finest first; as many as there are
    keep: tuple[Count, Count, Count, Count] = number("FusedOptions.keep")
    #: all levels of the pyramid but the finest take every `skip`-th of the few rays
    skip: Count = number("FusedOptions.skip")
    vote_cell: Length = number("FusedOptions.vote_cell")  #: cell of the GHT-V votes, metres
    #: with more cells than this, headings and all, the votes of a map get larger ones
    vote_cells: Count = number("FusedOptions.vote_cells")
    #: number of headings of the GHT-V votes
    vote_headings: Count = number("FusedOptions.vote_headings")
    #: how many peaks of the votes become proposals
    vote_peaks: Count = number("FusedOptions.vote_peaks")
    #: side of the squares of which each counts as one reading, metres
    place: Length = number("FusedOptions.place")
    #: such readings of the first look at all proposals, and of the second at
    few_rays: Count = number("FusedOptions.few_rays")
    rays: Count = number("FusedOptions.rays")  #: the best
    #: how many places get the second look, and how many poses, which may be of one place: between
    #: two layers of a wall the score has several maxima
    second_look: Count = number("FusedOptions.second_look")
    closer: Annotated[int, Within(0, 1e12, "poses")] = number("FusedOptions.closer")
    #: proposals nearer than this, metres and radians, are of one place, and one pose
    twins: tuple[Metres, Radians] = number("FusedOptions.twins")
    same: tuple[Length, Step] = number("FusedOptions.same")
    #: misfit of all endpoint proposals, nats per reading, above which votes propose, too
    unfit: Nats = number("FusedOptions.unfit")
    #: misfit, nats per reading, above which readings may share an error, see
    #: :mod:`imgloc.search.adapt`; nats that they must gain; how far a scale may be from the
    #: one that is known, a factor: with more of it any building fits
    strained: Nats = number("FusedOptions.strained")
    adapted: Nats = number("FusedOptions.adapted")
    most_scaled: Annotated[float, Within(1, 10, "a factor")] = number("FusedOptions.most_scaled")
    #: two poses nearer than this, metres and radians, are one hypothesis
    separation: tuple[Metres, Radians] = number("FusedOptions.separation")
    model: EvidenceModel = field(default_factory=EvidenceModel)  #: the score


@dataclass(frozen=True)
class Shared(Checked):
    """An error that all readings of a sensor on a map share, see :mod:`imgloc.search.adapt`."""

    scale: Annotated[float, Within(0.5, 2, "a factor")] = (
        1.0  #: what their lengths are multiplied by
    )
    thinner: Annotated[int, Within(0, 100, "cells")] = 0  #: cells that walls lose on each side


@dataclass(frozen=True)
class Trust(Checked):
    """What turns evidence into probabilities and a verdict."""

    #: with valid readings in fewer directions than this a scan is ``invalid``
    readings: Annotated[int, Within(0, 1e6, "directions")] = number("Trust.readings")
    #: what the evidence of 100 readings is divided by where map and scan agree perfectly: errors of
    #: neighbours are not independent. It grows with the root of their number.
    temperature: Factor = number("Trust.temperature")
    #: growth of that temperature per nat of misfit
    strain: Annotated[float, Within(0, 1e6, "per nat")] = number("Trust.strain")
    #: cell of a map, metres, above which the temperature grows in proportion: all readings on a
    #: wall share the error of its place, up to half a cell
    fine: Length = number("Trust.fine")
    #: log-odds that the true pose is none of the hypotheses: constant, per nat of evidence by which
    #: the best fits better than a building on no map would, per share of the mass that it does not
    #: hold. A logistic regression, see ``python -m tools.trust fit``
    elsewhere: tuple[LogOdds, LogOdds, LogOdds] = number("Trust.elsewhere")
    most: Nats = number("Trust.most")  #: nats of such evidence; more says no more
    mass: Share = number("Trust.mass")  #: mass that the best pose needs to be ``unique``
    #: how many neighbouring readings share one error, for the covariances
    correlated: Factor = number("Trust.correlated")

    def temperature_at(self, misfit: float, readings: int = 100, cell: float = 0.0) -> Temperature:
        """Temperature for a misfit in nats per reading, readings, and the cell of a map in metres.

        Examples
        --------
        >>> trust = Trust(temperature=2.0, strain=10.0)
        >>> [trust.temperature_at(0.5, n).value for n in (25, 100, 400)]
        [3.5, 7.0, 14.0]
        >>> trust.temperature_at(0.5, cell=0.2).value
        14.0
        """
        strain = self.strain * max(0.0, misfit)
        number = float(np.sqrt(max(1, readings) / 100))
        return Temperature(self.temperature, strain, number, max(1.0, cell / self.fine))

    def mass_elsewhere(self, evidence: float, best: float) -> float:
        """Probability that the true pose is none of the hypotheses.

        `evidence` is by how many nats, divided by the temperature, the best pose fits better than
        a building on no map would; `best` is its mass among the hypotheses, 0..1.

        Examples
        --------
        >>> Trust().mass_elsewhere(20.0, 1.0) < 0.01, Trust().mass_elsewhere(-5.0, 0.2) > 0.5
        (True, True)
        """
        constant, per_nat, per_share = self.elsewhere
        said = float(np.clip(evidence, -self.most, self.most))
        odds = constant + per_nat * said + per_share * (1 - best)
        return float(1 / (1 + np.exp(-odds)))


@dataclass(frozen=True)
class Options(Checked):
    """Everything that decides an answer, apart from the map and the scan.

    Parameters
    ----------
    method : str
        ``fused`` or a name of :data:`METHODS`.
    top : int, optional
        How many hypotheses are listed; None takes as many as hold :data:`MOST_OF_IT` of the mass,
        from :data:`AT_LEAST` to :data:`AT_MOST`.
    theta_step : float or None
        Step of the headings of a stack, radians, and of branch and bound, whose own are those
        of ``cbml``; None takes the method's own.
    engine : str
        Of the correlations, see :mod:`imgloc.likelihoods.correlate`.
    threads : int
        No result depends on it.
    memory_budget : int, optional
        Bytes that an answer may take besides the map's features; None is half of the RAM that
        is available.
    time_budget : float, optional
        Seconds for the search of ``fused``; what is found by then is the answer, marked as not
        complete. Such an answer depends on the machine.
    exact : bool
        Branch and bound: with ``cbml`` find its best poses without its stack, with ``fused``
        have them as further proposals.
    prior : Prior
        The poses that may be.
    shared : Shared
        Of ``fused``: what is known of the map's scale and walls, see `imgloc calibrate --scans`.
    fused : FusedOptions
    trust : Trust
    calibration : Calibration, optional
        What makes a probability of a stack; None takes the method's default. ``fused`` has none.
    """

    method: Annotated[str, OneOf(*ALL_METHODS)] = FUSED
    top: Count | None = None
    theta_step: Step | None = None
    engine: Annotated[str, OneOf("auto", "filter2d", "shift", "dft", "remap")] = "auto"
    threads: Count = 1
    memory_budget: Annotated[int, Within(0, 1e18, "bytes")] | None = None
    time_budget: Annotated[float, Within(0, 1e9, "seconds")] | None = None
    exact: bool = False
    prior: Prior = field(default_factory=Prior)
    shared: Shared = field(default_factory=Shared)
    fused: FusedOptions = field(default_factory=FusedOptions)
    trust: Trust = field(default_factory=Trust)
    calibration: Calibration | None = None

    def listed(self, share: FloatArray) -> int:
        """How many hypotheses of these shares (M,), in their order, are listed.

        Examples
        --------
        >>> some = np.full(12, 1 / 12)
        >>> Options().listed(some), Options(top=2).listed(some), Options(top=99).listed(some)
        (12, 2, 12)
        >>> Options().listed(np.array([0.9, 0.08, *np.full(20, 0.001)]))
        5
        """
        if self.top is not None:
            return min(self.top, len(share))
        held = np.cumsum(share)
        enough = int(np.searchsorted(held, MOST_OF_IT * held[-1:].sum())) + 1
        return min(max(AT_LEAST, enough), AT_MOST, len(share))

    def stepped(self, theta_step: float | None) -> "Options":
        """The options with a step for the headings of their method, radians; with None as they are.

        Of ``fused`` it is that of the endpoint correlation.
        """
        if theta_step is None:
            return self
        if self.method == FUSED:
            return replace(self, fused=replace(self.fused, theta_step=theta_step))
        return replace(self, theta_step=theta_step)

    @property
    def step(self) -> float:
        """Step of the headings of the method's stack; of ``fused``, of branch and bound."""
        if self.theta_step is not None:
            return self.theta_step
        method = METHODS["cbml" if self.method == FUSED else self.method]
        return float(np.deg2rad(method.theta_step_deg))

    @property
    def thetas(self) -> FloatArray:
        """Headings that are `step` or less apart, radians."""
        return uniform_thetas(self.step)


@dataclass(frozen=True)
class Tolerance(Checked):
    """A hypothesis is right if it is nearer than this to the true pose: metres and radians."""

    position: Metres
    heading: Radians


TOLERANCES = tuple(Tolerance(*number(f"tolerances.{name}")) for name in ("usual", "cartographer"))
"""Those that are always reported; the second is that of Cartographer's comparison."""
