"""The recipe: a map becomes features, a scan becomes a likelihood, peaks become an answer.

>>> import numpy as np
>>> from imgloc.model import LaserScan, OccupancyGrid
>>> walls = np.pad(np.zeros((40, 60), bool), 2, constant_values=True)
>>> walls[2:20, 30:34] = True
>>> features = prepare(OccupancyGrid(walls, ~walls, 0.1))
>>> angles = np.deg2rad(np.arange(-180, 180, 2.0))
>>> from imgloc.features.raycast import cast_rays
>>> ranges = cast_rays(features.walls, [2.0, 3.0], angles + 0.3, 20.0, 0.1)
>>> answer = localize(features, LaserScan(ranges, angles, range_max=20.0))
>>> answer.verdict, round(answer.pose.x, 1), round(answer.pose.y, 1), round(answer.pose.theta, 1)
('unique', 2.0, 3.0, 0.3)
"""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from types import MappingProxyType

import numpy as np

from imgloc.errors import ConfigError
from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.scanpoints import scan_points
from imgloc.geometry import compose, rotate_covariance, uniform_thetas
from imgloc.io.maps import require_usable
from imgloc.likelihood.beam import beam
from imgloc.likelihood.cbml import cbml, cbml_o
from imgloc.likelihood.ght import ght, ght_v
from imgloc.likelihood.posterior import posterior
from imgloc.model import (
    Float32Array,
    FloatArray,
    GridInfo,
    Hypothesis,
    LaserScan,
    Likelihood,
    Localization,
    OccupancyGrid,
)
from imgloc.search.fused import FusedOptions, reach, scan_xy, search_fused, thin
from imgloc.search.hypotheses import as_hypotheses, covariances, entropy, masses
from imgloc.search.moments import peak_moments
from imgloc.search.peaks import find_peaks
from imgloc.search.rescore import rescore
from imgloc.search.verdict import Trust, judge

FUSED = "fused"


@dataclass(frozen=True)
class Options:
    """Everything that decides an answer, apart from the map and the scan.

    Parameters
    ----------
    method : str
        ``fused`` or a name of :data:`METHODS`.
    top : int
        How many hypotheses are listed.
    theta_step : float or None
        Step of the headings of a stack, radians; None takes the method's own.
    engine : str
        Of the correlations, see :mod:`imgloc.likelihood.correlate`.
    threads : int
        No result depends on it.
    memory_budget : int
        Bytes that a likelihood stack may take.
    temperature : float
        The evidence of neighbouring readings is not independent: it is divided by this.
    fused : FusedOptions
    trust : Trust
    """

    method: str = FUSED
    top: int = 5
    theta_step: float | None = None
    engine: str = "auto"
    threads: int = 1
    memory_budget: int = 4 << 30
    temperature: float = 4.0
    fused: FusedOptions = field(default_factory=FusedOptions)
    trust: Trust = field(default_factory=Trust)


@dataclass(frozen=True)
class Method:
    """One of the paper's algorithms: its stack, and the step of its headings in degrees."""

    stack: Callable[[MapFeatures, LaserScan, FloatArray, Options], Float32Array]
    theta_step_deg: float
    summary: str


def prepare(grid: OccupancyGrid, name: str = "map", **parameters: float) -> MapFeatures:
    """Prepare a map: refuse one that is of no use, and wrap it into its features.

    Parameters
    ----------
    grid : OccupancyGrid
    name : str
        What error messages call the map.
    **parameters
        Of :class:`~imgloc.features.mapfeatures.MapFeatures`.

    Raises
    ------
    MapError
        If the map has no walls or no free cells.
    """
    require_usable(grid, name)
    return MapFeatures(grid, **parameters)  # type: ignore[arg-type]


def likelihood(features: MapFeatures, scan: LaserScan, options: Options) -> Likelihood:
    """Compute the full stack of one of the paper's methods.

    Returns
    -------
    Likelihood
        On the features' lattice of poses, in the grid frame.

    Raises
    ------
    ConfigError
        If the method is unknown, or the stack is larger than the memory budget.
    """
    check_method(options.method, tuple(METHODS))
    method = METHODS[options.method]
    step = options.theta_step
    thetas = uniform_thetas(np.deg2rad(method.theta_step_deg) if step is None else step)
    lattice = features.lattice
    need = 4 * len(thetas) * lattice.height * lattice.width
    if need > options.memory_budget:
        raise ConfigError(
            f"a stack of {len(thetas)} headings x {lattice.height} x {lattice.width} cells takes "
            f"{need / 2**20:.0f} MiB, the budget is {options.memory_budget / 2**20:.0f} MiB: "
            "use a larger cell, a larger theta step, or the method 'fused'"
        )
    values = method.stack(features, scan, thetas, options)
    return Likelihood(values, thetas, lattice, options.method)


def localize(
    features: MapFeatures, scan: LaserScan, options: Options | None = None
) -> Localization:
    """Find every pose that fits a scan, and say how much to trust each.

    Parameters
    ----------
    features : MapFeatures
        Of :func:`prepare`.
    scan : LaserScan
    options : Options, optional

    Returns
    -------
    Localization
        Poses of the sensor in the map frame. A scan with too few readings is answered with
        the verdict ``invalid``, not with an error.

    Raises
    ------
    ConfigError
        If an option is out of its range.
    """
    options = options or Options()
    if options.top < 1:
        raise ConfigError(f"top must be at least 1, got {options.top}")
    check_method(options.method, ALL_METHODS)
    start = time.perf_counter()
    valid = int(scan.valid.sum())
    found: tuple[Hypothesis, ...] = ()
    shares, explained = np.empty(0), 0.0
    if valid >= options.trust.readings:
        search = _localize_fused if options.method == FUSED else _localize_stack
        found, shares, explained = search(features, scan, options)
    elapsed = 1e3 * (time.perf_counter() - start)
    return Localization(
        hypotheses=tuple(in_map_frame(h, features.grid.info) for h in found),
        verdict=judge(valid, shares, explained, options.trust),
        entropy=entropy(shares),
        explained=explained,
        counts=scan.counts,
        timings_ms={"localize": elapsed},
        parameters=effective(options, features),
    )


def _localize_fused(
    features: MapFeatures, scan: LaserScan, options: Options
) -> tuple[tuple[Hypothesis, ...], FloatArray, float]:
    """Proposals from two sources, one score, separated modes."""
    modes = search_fused(features, scan, options.fused, options.threads)
    score = modes.evidence.log_likelihood
    mass = masses(score, options.temperature)
    top = slice(0, options.top)
    covariance = covariances(
        modes.poses[top],
        scan_xy(scan)[modes.rays],
        features.field,
        sigma=min(options.fused.model.sigmas),
        temperature=options.temperature,
        extent=options.fused.separation,
    )
    explained = float(modes.evidence.explained[0]) if len(mass) else 0.0
    return as_hypotheses(modes.poses[top], score[top], mass[top], covariance), mass, explained


def _localize_stack(
    features: MapFeatures, scan: LaserScan, options: Options
) -> tuple[tuple[Hypothesis, ...], FloatArray, float]:
    """Peaks of the posterior of a full stack."""
    stack = likelihood(features, scan, options)
    probability = posterior(stack.values, stack.method, features.free)
    peaks = find_peaks(probability, options.top, radius=2)
    poses, mass, covariance = peak_moments(probability, peaks, stack.thetas, stack.grid.resolution)
    if len(poses) == 0:
        return (), mass, 0.0
    rays = thin(scan.valid, options.fused.rays)
    evidence = rescore(
        poses[:1],
        scan.ranges[rays],
        scan.angles[rays],
        features.field,
        features.walls,
        reach(scan),
        options.fused.model,
    )
    uniform = 1 / (len(stack.thetas) * np.count_nonzero(features.free))
    with np.errstate(divide="ignore"):
        score = np.log(probability[tuple(peaks.T)].astype(np.float64) / uniform)
    return as_hypotheses(poses, score, mass, covariance), mass, float(evidence.explained[0])


def in_map_frame(hypothesis: Hypothesis, grid: GridInfo) -> Hypothesis:
    """Take a hypothesis from the grid frame to the map frame: origin and its yaw."""
    return replace(
        hypothesis,
        pose=compose(grid.origin, hypothesis.pose),
        covariance=rotate_covariance(hypothesis.covariance, grid.origin.theta),
    )


def effective(options: Options, features: MapFeatures) -> dict[str, object]:
    """The parameters that decided an answer, as plain values. Threads do not."""
    out = asdict(options)
    del out["threads"], out["memory_budget"]
    if options.method == FUSED:
        del out["theta_step"], out["engine"]
    else:
        del out["fused"], out["temperature"]
        if out["theta_step"] is None:
            out["theta_step"] = float(np.deg2rad(METHODS[options.method].theta_step_deg))
    out |= {"cell": features.lattice.resolution, "sigma": features.sigma, "seed": None}
    return out


def check_method(name: str, known: Sequence[str]) -> None:
    """Refuse a method that does not exist.

    Raises
    ------
    ConfigError
        Naming the methods that do.
    """
    if name not in known:
        raise ConfigError(f"method must be one of {', '.join(known)}, got {name!r}")


def _cbml(f: MapFeatures, scan: LaserScan, thetas: FloatArray, o: Options) -> Float32Array:
    xy = scan_xy(scan)[scan.valid]
    return cbml(f.bmap, xy, thetas, f.lattice.resolution, engine=o.engine, threads=o.threads)


def _cbml_o(f: MapFeatures, scan: LaserScan, thetas: FloatArray, o: Options) -> Float32Array:
    points = scan_points(scan.ranges, scan.angles, scan.valid)
    return cbml_o(f.vmap, points, thetas, f.lattice.resolution, engine=o.engine, threads=o.threads)


def _ght(f: MapFeatures, scan: LaserScan, thetas: FloatArray, o: Options) -> Float32Array:
    points = scan_points(scan.ranges, scan.angles, scan.valid)
    shape, cell = f.lattice.shape, f.lattice.resolution
    return ght(f.surface, points, len(thetas), shape, cell, threads=o.threads)


def _ght_v(f: MapFeatures, scan: LaserScan, thetas: FloatArray, o: Options) -> Float32Array:
    points = scan_points(scan.ranges, scan.angles, scan.valid)
    shape, cell = f.lattice.shape, f.lattice.resolution
    return ght_v(f.surface, f.visibility, points, len(thetas), shape, cell, threads=o.threads)


def _beam(f: MapFeatures, scan: LaserScan, thetas: FloatArray, o: Options) -> Float32Array:
    return beam(
        f.ray_distances,
        scan.ranges,
        scan.angles,
        scan.valid,
        scan.no_return,
        thetas,
        sigma=f.lattice.resolution,
        sigma_theta=(2 * np.pi / len(thetas)) / np.sqrt(12),
        span=reach(scan),
        range_max=reach(scan),
        threads=o.threads,
    )


#: The paper's algorithms by name; change one word to swap them.
METHODS: Mapping[str, Method] = MappingProxyType(
    {
        "cbml": Method(_cbml, 3.0, "correlation with the blurred map, Alg. 1 and 2"),
        "cbml-o": Method(_cbml_o, 3.0, "correlation of vector fields, Alg. 3"),
        "ght": Method(_ght, 10.0, "Hough votes of pairs of oriented points, Alg. 4"),
        "ght-v": Method(_ght_v, 10.0, "Hough votes that the map lets through, Alg. 5"),
        "beam": Method(_beam, 3.0, "ray-traced ranges for every pose, eq. 2"),
    }
)
#: Every name that `localize` takes.
ALL_METHODS = (FUSED, *METHODS)
