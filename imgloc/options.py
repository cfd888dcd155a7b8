"""Everything that decides an answer, apart from the map and the scan: plain, frozen values.

>>> Options(method="ght-v").top is None, Options(trust=Trust(mass=0.99)).method
(True, 'fused')
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, TypedDict

from imgloc.equality import ByContent
from imgloc.errors import ConfigError
from imgloc.numbers import number
from imgloc.pose import Pose2D, check_mount
from imgloc.ranges import Bytes as Bytes
from imgloc.ranges import Checked, Doc, Matches, OneOf, Option, Some, Within, option
from imgloc.ranges import Count as Count
from imgloc.texts import FAR, metres_degrees, pose

if TYPE_CHECKING:
    from imgloc.model import BoolArray, FloatArray, Temperature

    _Cells = BoolArray
    _Weights = FloatArray
else:  # help reads the fields, and has no time for NumPy
    _Cells = _Weights = Any

Metres = Annotated[float, Within(0, 1e6, "metres")]
Length = Annotated[float, Within(1e-4, 1e6, "metres")]  #: of something that has one
Radians = Annotated[float, Within(0, math.tau, "radians")]
Heading = Annotated[float, Within(-1e6, 1e6, "radians")]
Step = Annotated[float, Within(1e-4, math.tau, "radians")]
Share = Annotated[float, Within(0, 1, "a share")]
Nats = Annotated[float, Within(0, math.inf, "nats")]
SCALES = 0.5, 2
"""The least and the greatest factor on all readings that can be stated or found."""
DEEPEST = 0.15
"""Metres that readings may end behind, or before, the border of a wall, to be stated or found."""
Factor = Annotated[float, Within(1e-6, 1e6, "a factor")]
LogOdds = Annotated[float, Within(-1e6, 1e6, "log-odds")]
Place = Annotated[float, Within(-FAR, FAR, "metres")]  #: x or y
Angle = Annotated[float, Within(-6.2832, 6.2832, "radians")]  #: once around either way
Radius = Annotated[float, Within(0.01, 1e6, "metres")]
Turn = Annotated[float, Within(0.001, 3.2, "radians")]
HeadingStep = Annotated[float, Within(math.radians(0.05), math.pi, "radians")]
StepOf = Annotated[
    HeadingStep,
    Option(
        "Step between the headings that are tried, degrees. [default: 1 for fused, the paper's "
        "for the others]",
        "--theta-step-deg",
    ),
]
View = Annotated[float, Within(math.radians(0.01), math.tau, "radians")]
Clearance = Annotated[float, Within(0, 1000, "metres")]
CellSide = Annotated[float, Within(0.001, 10, "metres")]  #: a cell of a map, or of poses

RADIUS, TOLERANCE = number("options.near")
"""How far from a pose that is roughly known a robot may be, unless stated: metres, radians."""

FUSED = "fused"
#: share of the mass found that the hypotheses listed hold
MOST_OF_IT = number("options.most_of_it")
#: hypotheses that are listed, however much mass they hold
AT_LEAST: int = number("options.at_least")
AT_MOST: int = number("options.at_most")
#: share of the lines of a file that may be broken
MAX_BAD = number("options.max_bad")


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
    """Values that make a probability of one method's stack."""

    #: standard deviation, metres, of the Gaussian that blurs positions (eq. 8)
    sigma_xy: Metres = 0.0
    #: standard deviation, radians, of the Gaussian that blurs headings (eq. 8)
    sigma_theta: Radians = 0.0
    #: exponent of the scores: votes and correlations are raised to the power ``1 / temperature``;
    #: log-likelihoods, which are sums over the readings, are divided by ``temperature * readings``
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
    """The factor of a temperature for a number of readings.

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
class Hint(Checked):
    """A pose that is roughly known, by a tag or by radio: a Gaussian, which excludes nothing."""

    x: Place = 0.0
    y: Place = 0.0
    theta: Heading = 0.0
    metres: Radius = RADIUS  #: standard deviation, along each axis
    radians: Turn = TOLERANCE  #: standard deviation of the heading
    weight: Annotated[float, Within(0.001, 1, "a weight")] = 1.0  #: at the pose itself


@dataclass(frozen=True, eq=False)
class Prior(ByContent, Checked):
    """A set of poses, None being all of them, and a weight of each.

    Poses outside of the set are not looked for. A weight multiplies the mass of a pose, but a pose
    is ``unique`` only if the scan alone finds it so. ``&`` joins what is known independently; with
    ``|`` one of several hints is right.

    Examples
    --------
    >>> import numpy as np
    >>> prior = Prior(np.array([[True, False]]), (0.0, 0.5))
    >>> prior.admits(np.array([[0.5, 0.5, 6.0], [1.5, 0.5, 0], [0.5, 0.5, 1]]), 1.0).tolist()
    [True, False, False]
    """

    cells: _Cells | None = None  #: (H, W) those of the map in which the sensor may be
    #: in the grid frame, and how far it may be off, radians
    heading: tuple[Heading, Radians] | None = None
    #: what it was made of, as plain values, for the record
    about: Mapping[str, object] = field(default_factory=dict)
    weights: _Weights | None = None  #: (H, W) of the sensor in each cell, 0..1; at 0 is no pose
    #: of each group one is right, or none; grid frame
    hints: tuple[tuple[Hint, ...], ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, kind in (("cells", "bool"), ("weights", "float32")):
            if getattr(self, name) is not None:
                from imgloc.model import freeze

                freeze(self, kind, name)
        if self.weights is not None and not ((self.weights >= 0) & (self.weights <= 1)).all():
            raise ConfigError("Prior.weights: expected 0 to 1 in each cell")

    def __and__(self, other: "Prior") -> "Prior":
        """The poses that both allow; a ConfigError if both state a heading."""
        import numpy as np

        if self.heading is not None and other.heading is not None:
            raise ConfigError("the heading is given twice: by a pose and on its own")
        given = [c for c in (self.cells, other.cells) if c is not None]
        cells = np.logical_and.reduce(given) if given else None
        grey = [w for w in (self.weights, other.weights) if w is not None]
        weights = np.multiply.reduce(grey) if grey else None
        heading = self.heading if self.heading is not None else other.heading
        hints, about = self.hints + other.hints, {**self.about, **other.about}
        return Prior(cells, heading, about, weights, hints)

    def __or__(self, other: "Prior") -> "Prior":
        """One of the hints of both; a ConfigError if either is more than one group of hints."""
        if any(one != Prior(hints=one.hints[:1], about=one.about) for one in (self, other)):
            raise ConfigError("`|` joins hints: expected poses with `sd`")
        some = sum(self.hints + other.hints, ())
        return Prior(hints=(some,), about={"hints": [vars(one) for one in some]})

    def admits(self, poses: "FloatArray", resolution: float) -> "BoolArray":
        """Which poses (C, 3), grid frame, are in the set: (C,) bool."""
        from imgloc.geometry import values_at

        ok = self.headings(poses[:, 2])
        return ok if self.cells is None else ok & values_at(self.cells, poses[:, :2], resolution)

    def headings(self, thetas: "FloatArray", slack: float = 0.0) -> "BoolArray":
        """Which headings are in the set, or less than `slack` beside it: bool, as `thetas`."""
        import numpy as np

        from imgloc.geometry import wrap

        if self.heading is None:
            return np.ones(np.shape(thetas), bool)
        centre, tolerance = self.heading
        return np.asarray(np.abs(wrap(thetas - centre)) <= tolerance + slack + 1e-9)


@dataclass(frozen=True)
class EvidenceModel(Checked):
    """The parameters of the score."""

    #: standard deviations, metres, of the distance from an endpoint to its surface; each of them is
    #: equally probable for every reading
    sigmas: Sequence[Length] = number("EvidenceModel.sigmas")
    #: share of the readings that end on a surface of the map
    hit: Annotated[float, Within(0, 0.9999, "a share")] = number("EvidenceModel.hit")
    #: metres over which readings that end on no surface of the map are spread evenly
    span: Length = number("EvidenceModel.span")
    #: probability that a wall of the map is gone
    absent: Annotated[float, Within(1e-6, 1, "a probability")] = number("EvidenceModel.absent")
    #: metres beyond half a cell by which a reading may pass through a wall at no cost
    margin: Metres = number("EvidenceModel.margin")
    #: standard deviation, metres, of the place of a wall on the map: the farther a reading passes
    #: through a wall, the less probable it is, down to `absent`
    displaced: Length = number("EvidenceModel.displaced")
    #: standard deviation, metres, of the place of each piece of wall on the map: 0 if the map is
    #: true to shape
    bent: Metres = 0.0
    #: exponent of the number of readings on one piece of a bent wall: n readings count as n^alike
    alike: Share = 1.0

    def bending(self, metres: float, how: "Bending | None" = None) -> "EvidenceModel":
        """The parameters for a map whose pieces of wall stand `metres` off: see :class:`Shared`."""
        how = how or Bending()
        return replace(self, bent=metres, **vars(how)) if metres else self

    @property
    def best(self) -> float:
        """Log-density of a reading that ends on a surface exactly, nats."""
        densities = [1 / (math.sqrt(math.tau) * sigma) for sigma in self.sigmas]
        peak = self.hit * sum(densities) / len(densities)
        return math.log(peak + (1 - self.hit) / self.span)


@dataclass(frozen=True)
class Bending(Checked):
    """Parameters of the score, see :class:`EvidenceModel`, that are others on bent walls."""

    absent: Annotated[float, Within(1e-6, 1, "a probability")] = number("Bending.absent")
    displaced: Length = number("Bending.displaced")
    alike: Share = number("Bending.alike")


# More effort: nodes that each level keeps, places, and how much worse a proposal may be.


@dataclass(frozen=True)
class FusedOptions(Checked):
    """Effort of the search, part by part."""

    #: step between the headings of the endpoint correlation, radians
    theta_step: Step = number("FusedOptions.theta_step")
    #: nodes that each level of the endpoint pyramid keeps, finest level first
    keep: tuple[Count, Count, Count, Count] = number("FusedOptions.keep")
    #: coarse levels of the pyramid use every `skip`-th of the `few_rays`
    skip: Count = number("FusedOptions.skip")
    #: mean endpoint score, 0..1, by which a proposal may be worse than the best one
    worse: Share = number("FusedOptions.worse")
    #: side of a square, metres, whose endpoints count as one reading
    place: Length = number("FusedOptions.place")
    #: readings that score all proposals, in the first look
    few_rays: Count = number("FusedOptions.few_rays")
    #: readings that score the best proposals, in the second look
    rays: Count = number("FusedOptions.rays")
    #: number of places that get the second look
    second_look: Count = number("FusedOptions.second_look")
    #: number of hypotheses that get the second look however far they are behind the best one
    least_look: Annotated[int, Within(0, 1e12, "hypotheses")] = number("FusedOptions.least_look")
    #: nats behind the best pose of the first look from which others get no second one
    behind: Nats = number("FusedOptions.behind")
    #: number of poses that get the second look whatever their place: between the two layers of a
    #: wall the score of one place has several maxima
    closer: Annotated[int, Within(0, 1e12, "poses")] = number("FusedOptions.closer")
    #: distance, metres and radians, below which two proposals are one place
    twins: tuple[Metres, Radians] = number("FusedOptions.twins")
    #: distance, metres and radians, below which two proposals are one pose
    same: tuple[Length, Step] = number("FusedOptions.same")
    #: misfit of the best place of the first look, nats per reading, above which parts of the scan
    #: propose others, unless it leads them by this share of the nats that it lacks
    unfit: Nats = number("FusedOptions.unfit")
    led: Share = number("FusedOptions.led")
    #: misfit, nats per reading, above which an error that all readings share is looked for, see
    #: :mod:`imgloc.search.adapt`
    strained: Nats = number("FusedOptions.strained")
    #: nats that the readings must gain together before a shared error is believed
    adapted: Nats = number("FusedOptions.adapted")
    #: greatest factor between a scale that is found and the known one: with more, any building fits
    most_scaled: Annotated[float, Within(1, 10, "a factor")] = number("FusedOptions.most_scaled")
    #: distance, metres and radians, below which two poses are one hypothesis
    separation: tuple[Metres, Radians] = number("FusedOptions.separation")
    #: parameters of the score, and those that are others on bent walls
    model: EvidenceModel = field(default_factory=EvidenceModel)
    bending: Bending = field(default_factory=Bending)


@dataclass(frozen=True)
class Shared(Checked):
    """An error that all readings of a sensor on a map share, see :mod:`imgloc.search.adapt`."""

    #: factor that multiplies the ranges of all readings
    scale: Annotated[float, Within(*SCALES, "a factor")] = 1.0
    #: cells that each wall loses on each side
    thinner: Annotated[int, Within(0, 100, "cells")] = 0
    #: standard deviation, metres, of the place of each piece of wall: a map drawn by others is bent
    bent: Annotated[float, Within(0, 1, "metres")] = 0.0
    #: metres behind the border of a wall's cells at which readings end; None if that is not known
    depth: Annotated[float, Within(-DEEPEST, DEEPEST, "metres")] | None = None
    #: misfit of scans at their true places on a map that others drew, nats per reading: as much
    #: says nothing against a place
    usual: Annotated[float, Within(0, 10, "nats")] = 0.0
    #: whether somebody says that walls are straight: then neither image nor scans can bend them
    straight: bool = False


def log_share(same: tuple[float, float], space: float) -> float:
    """Logarithm of the share of a hypothesis in a `space` of poses, m² rad.

    Poses that are as near as `same`, metres and radians, are one hypothesis: a Gaussian of these.
    """
    metres, radians = same
    return math.log(2 * math.pi * metres**2 * radians / space)


def _near() -> float:
    return log_share(FusedOptions.same, math.pi * RADIUS**2 * 2 * TOLERANCE)


LOG_VOLUME = _near()
"""Logarithm of the share of a hypothesis in all poses near one that is roughly known."""


@dataclass(frozen=True)
class Trust(Checked):
    """Numbers that turn evidence into probabilities and a verdict."""

    #: fewest directions with a valid reading: a scan with fewer is ``invalid``
    readings: Annotated[int, Within(0, 1e6, "directions")] = number("Trust.readings")
    #: divisor of the evidence of 100 readings where map and scan agree perfectly: neighbours share
    #: errors. It grows with the square root of the number of readings.
    temperature: Factor = number("Trust.temperature")
    #: growth of the temperature per nat of misfit
    strain: Annotated[float, Within(0, 1e6, "per nat")] = number("Trust.strain")
    #: cell of a map, metres, above which the temperature grows in proportion to the cell: all
    #: readings on a wall share the error of its place
    fine: Length = number("Trust.fine")
    #: log-odds that the true pose is none of the hypotheses: a constant, a weight per nat by which
    #: the best pose fits better than a building that is not on the map, less the nats against the
    #: pose, and more of it per logarithm of the number of possible poses where these are few, as of
    #: a place that is known: hardly any fits by chance. See ``python -m tools.trust fit``
    elsewhere: tuple[LogOdds, LogOdds, LogOdds] = number("Trust.elsewhere")
    #: greatest evidence, nats, that counts in the log-odds
    most: Nats = number("Trust.most")
    #: mass that the best pose needs to be ``unique``
    mass: Share = number("Trust.mass")

    def temperature_at(
        self, misfit: float, readings: int = 100, cell: float = 0.0
    ) -> "Temperature":
        """Temperature for a misfit in nats per reading, readings, and the cell of a map in metres.

        Examples
        --------
        >>> trust = Trust(temperature=2.0, strain=10.0)
        >>> [trust.temperature_at(0.5, n).value for n in (25, 100, 400)]
        [3.5, 7.0, 14.0]
        >>> trust.temperature_at(0.5, cell=0.2).value
        14.0
        """
        from imgloc.model import Temperature

        strain = self.strain * max(0.0, misfit)
        number = math.sqrt(max(1, readings) / 100)
        return Temperature(self.temperature, strain, number, max(1.0, cell / self.fine))

    def mass_elsewhere(self, evidence: float, log_volume: float = LOG_VOLUME) -> float:
        """Probability that the true pose is none of the hypotheses.

        `evidence` is by how many nats, divided by the temperature, the best pose fits better than
        a building on no map would, less what contradicts it: :attr:`imgloc.model.Evidence.net`.
        `log_volume` is the logarithm of the share of a hypothesis in all poses that are possible.

        Examples
        --------
        >>> Trust().mass_elsewhere(20.0) < 0.01, Trust().mass_elsewhere(-25.0) > 0.5
        (True, True)
        """
        constant, per_nat, per_log = self.elsewhere
        said = min(max(evidence, -self.most), self.most)
        few = min(0.0, LOG_VOLUME - log_volume)
        odds = constant + per_nat * said + per_log * few * max(0.0, said)
        return 1 / (1 + math.exp(min(-odds, 700.0)))


@dataclass(frozen=True)
class Options(Checked):
    """Everything that decides an answer, apart from the map and the scan."""

    method: Annotated[str, OneOf(*ALL_METHODS)] = option(
        FUSED,
        "Localization method: fused searches and scores what it finds, the others score every "
        "pose by one of the paper's algorithms.",
    )
    top: Count | None = option(
        None,
        "Number of hypotheses to list. [default: as many as have 95 % of the mass, at least 5]",
    )
    theta_step: StepOf | None = None
    engine: Annotated[
        str,
        OneOf("auto", "filter2d", "shift", "dft", "remap"),
        Doc("Implementation of the correlations in cbml and cbml-o."),
    ] = "auto"
    threads: Annotated[Count, Doc("Threads; no result depends on their number.")] = 1
    memory_budget: Annotated[
        Bytes | None,
        Doc(
            "Bytes that an answer may take besides the features of the map. [default: half of the "
            "memory that is available]"
        ),
    ] = None
    time_budget: Annotated[float, Within(0, 1e9, "seconds")] | None = option(
        None,
        "Seconds for the search of each scan. When they are over, imgloc gives the best answer so "
        "far and marks it as not complete. A faster machine comes further. [default: no limit]",
    )
    max_speed: Annotated[float, Within(0, 1e3, "m/s")] = option(
        0.0,
        "Fastest the robot may have moved during a scan, m/s: the covariance allows for it, unless "
        "the scan has been straightened.",
    )
    max_turn: Annotated[float, Within(0, 1e3, "rad/s")] = option(
        0.0,
        "Fastest the robot may have turned during a scan, degrees/s: the covariance allows for it, "
        "unless the scan has been straightened.",
        "--max-turn-deg",
    )
    prior: Annotated[Prior, Doc("Poses that are considered. [default: all]")] = field(
        default_factory=Prior
    )
    shared: Annotated[
        Shared,
        Doc(
            "Known error that all readings of fused share on the map; `imgloc calibrate --scans` "
            "finds it. [default: none]"
        ),
    ] = field(default_factory=Shared)
    fused: Annotated[FusedOptions, Doc("Effort of the search of fused.")] = field(
        default_factory=FusedOptions
    )
    trust: Annotated[Trust, Doc("Numbers that turn evidence into masses and a verdict.")] = field(
        default_factory=Trust
    )
    calibration: Annotated[
        Calibration | None,
        Doc(
            "Calibration that makes probabilities of the scores of one of the paper's algorithms. "
            "[default: the method's]"
        ),
    ] = None

    def left(self, spent: float, **changed: Any) -> "Options":
        """The options with what is left of the time budget after some seconds, and other changes.

        Examples
        --------
        >>> Options(time_budget=2.0).left(0.5).time_budget, Options().left(9.0, top=1).time_budget
        (1.5, None)
        """
        rest = None if self.time_budget is None else max(0.0, self.time_budget - spent)
        return replace(self, time_budget=rest, **changed)

    @property
    def model(self) -> EvidenceModel:
        """The parameters of the score, on walls as bent as in `shared`."""
        return self.fused.model.bending(self.shared.bent, self.fused.bending)

    def listed(self, share: "FloatArray") -> int:
        """Number of hypotheses that are listed, of these shares (M,), in their order.

        Examples
        --------
        >>> import numpy as np
        >>> some = np.full(12, 1 / 12)
        >>> Options().listed(some), Options(top=2).listed(some), Options(top=99).listed(some)
        (12, 2, 12)
        >>> Options().listed(np.array([0.9, 0.08, *np.full(20, 0.001)]))
        5
        """
        import numpy as np

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
        return math.radians(method.theta_step_deg)

    @property
    def thetas(self) -> "FloatArray":
        """Headings that are `step` or less apart, radians."""
        from imgloc.geometry import uniform_thetas

        return uniform_thetas(self.step)


@dataclass(frozen=True)
class Tolerance(Checked):
    """A hypothesis is right if it is nearer than this to the true pose: metres and radians."""

    position: Metres
    heading: Radians


TOLERANCES = Tolerance(0.25, 0.25), Tolerance(0.5, math.radians(10))
"""Those that are always reported; the second is that of Cartographer's comparison.

No answer depends on them.
"""


@dataclass(frozen=True)
class Every(Checked):
    """Way or turn of the robot between two scans of a laser that are looked at."""

    metres: Metres = 0.5
    radians: Annotated[float, Within(0, 1e6, "radians")] = math.pi / 6


@dataclass(frozen=True)
class Limits(Checked):
    """Uncertainty at which a pose is still published: standard deviations."""

    metres: Annotated[float, Within(1e-3, 1e6, "metres")] = 0.5  #: along the longest axis
    radians: Annotated[float, Within(1e-4, 1e6, "radians")] = math.pi / 18


Seed = Annotated[
    int,
    Within(0, 1e18, ""),
    Option("Seed of the random numbers: the same seed gives the same output."),
]
Cell = Annotated[
    CellSide, Option("Side of a cell of the poses that the paper's algorithms score, metres.")
]
RangeMax = Annotated[
    float,
    Within(1e-3, 1e6, "metres"),
    Option(
        "Reach of the sensor, metres: a recorded reading of this length or more counts as no "
        "return. [default: the file's]"
    ),
]
Spacing = Annotated[
    float, Within(0.02, 1000, "metres"), Option("Distance between the places of an atlas, metres.")
]
Headings = Annotated[int, Within(1, 72, ""), Option("Headings at each place of an atlas.")]
Flipped = Annotated[bool, Option("The sensor is mounted upside down: its angles run clockwise.")]
NAMED: float = Trust.mass
"""Probability that a map needs to be named, unless another one is asked for."""
Sure = Annotated[
    float,
    Within(0.5, 1, "a probability"),
    Option("Probability that a map needs to be named as the one a scan is from."),
]


class Reading(TypedDict, total=False):
    """The way in which a map is read: parameters that :func:`imgloc.load_map` documents."""

    resolution: Annotated[
        CellSide | None,
        Option("Side of a pixel of the map image, metres. [default: the map's YAML]"),
    ]
    origin: Annotated[
        Pose2D | Sequence[float] | None,
        Option(
            "Pose of the map image's lower-left corner in the map frame: metres, metres, radians "
            "(or 90deg). [default: the map's YAML, 0,0,0 for a bare image]",
            metavar="X,Y,YAW",
            parse=pose,
        ),
    ]
    mode: Annotated[
        str | None,
        OneOf("trinary", "scale", "raw"),
        Option(
            "How map_server is to read the greys of the map image. [default: the map's YAML, or "
            "trinary]"
        ),
    ]
    semantics: Annotated[
        str | None,
        OneOf("nav2", "ros1"),
        Option(
            "Whose map_server: they treat thresholds and transparent pixels differently. [default: "
            "the map's YAML, or nav2]"
        ),
    ]
    occupied_thresh: Annotated[
        Share | None,
        Option(
            "Occupancy from which a pixel of the map image is a wall. [default: the map's YAML, or "
            "0.65]"
        ),
    ]
    free_thresh: Annotated[
        Share | None,
        Option(
            "Occupancy up to which a pixel of the map image is free. [default: the map's YAML, or "
            "0.196]"
        ),
    ]
    negate: Annotated[
        bool | None,
        Option(
            "White pixels of the map image are walls. [default: the map's YAML, or --no-negate]",
            "--negate/--no-negate",
        ),
    ]
    max_pixels: int


_ONE = r" *(\d{1,18}|\d{0,18}:\d{0,18}(:0{0,18}[1-9]\d{0,17})?) *"
INDICES = (
    "indices from 0, ranges A:B (without B) or A:B:STEP, and commas between, such as 3,7,10:20"
)


@dataclass(frozen=True)
class Chosen(Checked):
    """Which scans of a file are looked at: by default all.

    Examples
    --------
    >>> Chosen("3,7,10:20:4").of(40, "scans.npz"), Chosen(sample=2).of(40, "scans.npz")
    ([3, 7, 10, 14, 18], [18, 20])
    """

    index: Annotated[str, Matches(f"{_ONE}(,{_ONE})*", 1 << 20, INDICES)] | None = option(
        None,
        "Take only these scans of a file, counted from 0: 3 or 3,7,10:20 (without 20) or ::10 "
        "(every tenth). May be repeated. [default: all]",
        "--scans-index",
        metavar="LIST",
        joined=True,
    )
    sample: Count | None = option(
        None,
        "Take only N scans of a file, drawn at random: the same ones each time. [default: all]",
    )
    seed: Annotated[int, Within(0, 1e18, "")] = 1  #: that draws them

    def of(self, count: int, name: str, most: int | None = None) -> list[int]:
        """Indices of the scans, of `count` in the file called `name`; ConfigError if there is none.

        They are in the order asked for, each once; those of a sample rise. Beyond `most` no more
        are looked for: there may be one more.
        """
        found: dict[int, None] = {}
        for word in (":" if self.index is None else self.index).split(","):
            parts = [int(part) if part.strip() else None for part in word.split(":")]
            (first, *_), here = parts, range(count)[slice(*parts)]
            if len(parts) == 1 and first is not None:
                here = range(first, first + 1)
            if self.index is not None and not (here and here[-1] < count):
                expected = f"0 to {count - 1}"
                if len(parts) > 1:
                    expected = f"A:B with A below B and A at most {count - 1}"
                raise ConfigError(
                    f"`index`: got {word.strip()}, expected {expected}: {name} has {count} scans"
                )
            found |= dict.fromkeys(here if most is None else here[: most + 1])
            if most is not None and len(found) > most:
                break
        indices = list(found)
        if self.sample is None or self.sample >= len(indices):
            return indices
        import numpy as np

        rng = np.random.default_rng(self.seed)
        picked = rng.choice(len(indices), self.sample, replace=False)
        return sorted(indices[k] for k in picked.tolist())


@dataclass(frozen=True)
class Known(Checked):
    """Knowledge of the poses of all scans, map frame; None where there is none."""

    near: Annotated[tuple[Place, Place, Angle, Radius, Turn] | None, Some(RADIUS, TOLERANCE)] = (
        option(
            None,
            "Consider only poses within R metres of x, y in the map frame that face YAW up to T, "
            f"radians (or 90deg). [default: anywhere; R = {RADIUS:g}, T = {TOLERANCE:g}]",
            metavar="X,Y,YAW[,R[,T]]",
        )
    )
    heading: Annotated[tuple[Angle, Turn] | None, Some(TOLERANCE)] = option(
        None,
        "Consider only poses that face YAW up to T in the map frame, radians (or 90deg), as a "
        f"compass gives it. [default: any; T = {TOLERANCE:g}]",
        metavar="YAW[,T]",
    )
    clearance: Clearance | None = option(
        None,
        "Consider only poses at least this far from walls and unknown space, metres: the radius "
        "of the robot. [default: 0]",
    )
    sd: tuple[Radius, Turn] | None = option(
        None,
        "Standard deviations of --near, metres and radians (or 10deg): poses nearer to it weigh "
        "more, none is excluded, and none is unique by it. [default: those beyond R and T are]",
        metavar="M,RAD",
    )
    hints: Annotated[tuple[Hint, ...], Doc("Poses of which one is roughly right, map frame.")] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.sd is not None and (self.near or ())[3:] != (RADIUS, TOLERANCE):
            raise ConfigError("`sd`: expected with `near`, of x, y and yaw alone")


Sweeps = Annotated[str, OneOf("no", "forward", "backward")]


@dataclass(frozen=True)
class Logs(Checked):
    """The way in which files of scans are read."""

    topic: str | None = option(
        None,
        "Laser to read from a log that contains several; commas join lasers. [default: /scan, "
        "FLASER, or the only one; inspect takes any]",
        metavar="NAME",
    )
    #: radians
    fov: View | None = option(
        None,
        "Angle from the first to the last ray, degrees, for a file that does not contain it. "
        "[default: the file's]",
        "--fov-deg",
    )
    scale: Factor = option(
        1.0,
        "Metres that 1 stands for in the ranges of a file: 0.001 for millimetres.",
        "--range-scale",
    )
    max_bad: Share = option(
        MAX_BAD,
        "Share of the lines or messages of a file that may be broken: they are left out, and "
        "named. A file with more of them is refused.",
    )
    straighten: Sweeps = option(
        "no",
        "Take the robot's motion out of scans that state time_increment, by the odometry: forward "
        "if the first reading of a scan is its oldest, backward if it is its newest.",
    )
    height: tuple[float, float] | None = option(
        None,
        "Make a scan of each point cloud from its points between the heights MIN and MAX, metres "
        "in the sensor's frame.",
        metavar="MIN,MAX",
    )
    odom: str | None = option(
        None,
        "Odometry of a bag, by topic or frame; scans takes the motion from the scans alone. "
        "[default: that of the robot which carries the laser]",
        "--odom",
        "--odometry",
        metavar="TOPIC|FRAME|scans",
    )
    range_max: RangeMax | None = None


@dataclass(frozen=True)
class Mounting(Checked):
    """The place of the sensor on the robot."""

    sensor: Pose2D | None = option(
        None,
        "Pose of the sensor on the robot: metres, metres, radians (or 90deg). With it, poses of "
        "the robot are given, too. [default: the log's]",
        metavar="X,Y,YAW",
        parse=pose,
    )
    flipped: Flipped = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.sensor is not None:
            check_mount(self.sensor, "`sensor`")


@dataclass(frozen=True)
class Drawn(Checked):
    """Walls of a map as others drew them; None is what was calibrated for the map.

    Examples
    --------
    >>> shared = Drawn(thinner=0.1).on(Shared(scale=1.02), 0.05)
    >>> shared.scale, shared.thinner, shared.bent
    (1.02, 2, 0.0)
    """

    thinner: Annotated[float, Within(0, 1, "metres")] | None = option(
        None,
        "Metres by which the map draws each side of a wall too thick. [default: what imgloc "
        "calibrate found, or 0]",
    )
    bent: Annotated[float, Within(0, 1, "metres")] | None = option(
        None,
        "Standard deviation of the place of each piece of wall, metres: 0.15 suits a map that "
        "others drew, 0 an exact one. [default: what imgloc calibrate found; or 0, and 0.1 for a "
        "scan that fits nowhere on a map with walls of 0.3 m and more]",
    )

    def on(self, known: Shared, resolution: float) -> Shared:
        """The error that is `known`, with these walls; the map's cells are `resolution` metres."""
        thinner, bent = known.thinner, known.bent
        if self.thinner is not None:
            thinner = round(self.thinner / resolution)
            if self.thinner > 0 and not thinner:
                raise ConfigError(
                    f"`thinner`: got {self.thinner:g}, expected 0 or at least half a cell, "
                    f"{resolution / 2:g} m"
                )
        bent = bent if self.bent is None else self.bent
        return replace(known, thinner=thinner, bent=bent, straight=self.bent == 0)


@dataclass(frozen=True)
class Sensor(Checked):
    """A simulated laser; the defaults are that of Sec. VI, with a reach of 30 m.

    `fov` is in radians, see :func:`imgloc.simulation.scans.ray_angles`; `outliers` and `dropped`
    are explained by :func:`imgloc.simulation.scans.simulate_ranges`; `mount` is the pose of the
    sensor on the robot.
    """

    rays: Annotated[int, Within(1, 100_000, "")] = option(181, "Rays of a simulated scan.")
    fov: View = option(math.pi, "Angle that a simulated scan covers, degrees.", "--fov-deg")
    sigma: Annotated[float, Within(0, 10, "metres")] = option(
        0.02, "Standard deviation of the noise of a simulated reading, metres."
    )
    range_max: Annotated[float, Within(0.01, 10_000, "metres")] = option(
        30.0, "Reach of the simulated sensor, metres: a longer ray has no return."
    )
    outliers: Share = option(
        0.0, "Share of the simulated rays that end at something that is not on the map."
    )
    dropped: Share = option(0.0, "Share of the simulated rays that give no valid reading.")
    clearance: Clearance = option(
        0.3, "Distance of the simulated robot from walls and unknown space, metres."
    )
    mount: Pose2D = option(
        ...,
        "Pose of the simulated sensor on the robot: metres, metres, radians (or 90deg). "
        "[default: 0,0,0]",
        "--sensor",
        metavar="X,Y,YAW",
        parse=pose,
        factory=lambda: Pose2D(0.0, 0.0),
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        check_mount(self.mount, "`sensor`")


FILTERS = ("tracker", "grid", "particle")


@dataclass(frozen=True)
class Followed(Checked):
    """The way in which a robot is followed."""

    filter: Annotated[str, OneOf(*FILTERS)] = option("tracker", "Filter that follows the robot.")
    every: Every = option(
        Every(),
        "Weigh all places by a scan each time the robot has gone M metres or turned DEG degrees; "
        "scans between only correct the best place. [default: 0.5,30]",
        metavar="M,DEG",
        parse=lambda text: Every(*metres_degrees(text)),
    )
    limits: Limits = option(
        Limits(),
        "Greatest standard deviations of a pose that is called unique: M metres and DEG degrees. "
        "[default: 0.5,10]",
        "--max-sd",
        metavar="M,DEG",
        parse=lambda text: Limits(*metres_degrees(text)),
    )
    seed: Seed = 0


@dataclass(frozen=True)
class PlanWalls(Checked):
    """The way in which walls are drawn on a plan, and the cells that they become."""

    cell: Annotated[float | None, Within(0.01, 1, "metres")] = option(
        None, "Side of a cell of the map, metres. [default: 0.05, or a pixel of the plan]"
    )
    thinnest: Annotated[float | None, Within(0.005, 1, "metres")] = option(
        None,
        "Least thickness of a wall on an image, metres: thinner strokes are no walls. [default: "
        "0.07]",
    )
    thickest: Annotated[float | None, Within(0.05, 3, "metres")] = option(
        None,
        "Greatest thickness of a wall that is drawn as two lines, metres: lines farther apart "
        "enclose a room. [default: found]",
    )
    gap: Annotated[float | None, Within(0, 30, "metres")] = option(
        None, "Width of the widest outer door, metres. [default: found]"
    )
    ink: Annotated[float | None, Within(0.01, 0.99, "a share")] = option(
        None,
        "Darkness, against the paper around it, from which a pixel of an image is ink. [default: "
        "found]",
    )
