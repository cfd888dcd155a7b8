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
from dataclasses import asdict, dataclass, field, fields, replace
from types import MappingProxyType

import numpy as np

from imgloc.errors import ConfigError
from imgloc.features.budget import check_budget, default_budget, stack_bytes
from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.scanpoints import scan_points
from imgloc.geometry import compose, rotate_covariance, uniform_thetas
from imgloc.io.maps import require_usable
from imgloc.likelihood.beam import beam, heading_sigma, temperature
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
from imgloc.search.fused import FusedOptions, scan_xy, search_fused, thin
from imgloc.search.hypotheses import as_hypotheses, covariances, entropy, masses
from imgloc.search.moments import peak_moments
from imgloc.search.peaks import find_peaks, separated
from imgloc.search.refine import refine
from imgloc.search.rescore import Evidence, rescore
from imgloc.search.trust import Trust, judge

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
    memory_budget : int, optional
        Bytes that a likelihood stack and its posterior may take; None is half of the RAM that
        is available.
    fused : FusedOptions
    trust : Trust
    """

    method: str = FUSED
    top: int = 5
    theta_step: float | None = None
    engine: str = "auto"
    threads: int = 1
    memory_budget: int | None = None
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
    need = stack_bytes(
        options.method,
        lattice.shape,
        len(thetas),
        threads=options.threads,
        n_rays=features.n_rays,
    )
    check_budget(
        need,
        default_budget() if options.memory_budget is None else options.memory_budget,
        f"{options.method} on {len(thetas)} headings x {lattice.height} x {lattice.width} cells",
        "use larger cells, a larger theta step, or the method 'fused'",
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
    found = _NOTHING
    if valid >= max(1, options.trust.readings):
        search = _localize_fused if options.method == FUSED else _localize_stack
        found = search(features, scan, options)
    elapsed = 1e3 * (time.perf_counter() - start)
    top = found.hypotheses[: options.top]
    return Localization(
        hypotheses=tuple(in_map_frame(h, features.grid.info) for h in top),
        verdict=judge(valid, found.mass, found.elsewhere, options.trust),
        entropy=found.entropy,
        explained=found.explained,
        counts=scan.counts,
        timings_ms={"localize": elapsed},
        parameters=effective(options, features),
    )


@dataclass(frozen=True)
class Found:
    """What a search found, in the grid frame, and what it left to other poses.

    Parameters
    ----------
    hypotheses : tuple of Hypothesis
        Best first.
    mass : (M,) float array
        Of all modes, listed or not.
    elsewhere : float
        Probability that the true pose is none of them.
    explained : float
        Share of the readings that the best one explains.
    entropy : float
        Nats: of the masses, ``elsewhere`` being one of them, or of a stack's whole posterior.
    """

    hypotheses: tuple[Hypothesis, ...]
    mass: FloatArray
    elsewhere: float
    explained: float
    entropy: float


_NOTHING = Found((), np.empty(0), 1.0, 0.0, 0.0)


def _localize_fused(features: MapFeatures, scan: LaserScan, options: Options) -> Found:
    """Proposals from two sources, one score, separated modes."""
    result = search_fused(features, scan, options.fused, options.threads)
    if len(result.poses) == 0:
        return _NOTHING
    score = result.evidence.log_likelihood
    misfit = _misfit(result.evidence, options)
    mass = masses(score, options.trust.temperature_at(misfit))
    elsewhere = options.trust.mass_elsewhere(misfit, float(mass[0]))
    mass *= 1 - elsewhere
    top = slice(0, options.top)
    covariance = covariances(
        result.poses[top],
        scan_xy(scan)[result.rays],
        features.field,
        sigma=2 * min(options.fused.model.sigmas),
        correlated=options.trust.correlated,
        extent=options.fused.separation,
    )
    hypotheses = as_hypotheses(result.poses[top], score[top], mass[top], covariance)
    whole = entropy(np.append(mass, elsewhere))
    return Found(hypotheses, mass, elsewhere, float(result.evidence.explained[0]), whole)


def _localize_stack(features: MapFeatures, scan: LaserScan, options: Options) -> Found:
    return found_in_stack(features, scan, likelihood(features, scan, options), options)


def found_in_stack(
    features: MapFeatures, scan: LaserScan, stack: Likelihood, options: Options
) -> Found:
    """Peaks of the posterior of a full stack, with the mass and the moments around each."""
    probability = posterior(
        stack.values,
        stack.method,
        features.free,
        temperature=temperature(int(scan.valid.sum())) if stack.method == "beam" else 1.0,
    )
    # More peaks than asked for: some are neighbours on the slope of one mode.
    peaks = find_peaks(probability, 4 * options.top, radius=2)
    poses, mass, covariance = peak_moments(probability, peaks, stack.thetas, stack.grid.resolution)
    if len(poses) == 0:
        return _NOTHING
    distance, angle = options.fused.separation
    best, _ = separated(poses, len(poses), distance=distance, angle=angle)
    poses, mass, covariance, peaks = poses[best], mass[best], covariance[best], peaks[best]
    # Trust is about the place, not about the cell: let the best pose settle first.
    rays = thin(scan.valid, options.fused.rays)
    settled = refine(poses[:1], scan_xy(scan)[rays], features.field, sigmas=(0.3, 0.1, 0.05))
    evidence = rescore(
        settled,
        scan.ranges[rays],
        scan.angles[rays],
        features.field,
        features.walls,
        options.fused.model,
    )
    # The masses of votes are no calibrated ones: that they are spread says nothing of the scan.
    elsewhere = options.trust.mass_elsewhere(_misfit(evidence, options), 1.0)
    uniform = 1 / (len(stack.thetas) * np.count_nonzero(features.free))
    with np.errstate(divide="ignore"):
        score = np.log(probability[tuple(peaks.T)].astype(np.float64) / uniform)
    mass = (1 - elsewhere) * mass
    hypotheses = as_hypotheses(poses, score, mass, covariance)
    return Found(hypotheses, mass, elsewhere, float(evidence.explained[0]), entropy(probability))


def _misfit(evidence: Evidence, options: Options) -> float:
    """Nats per reading that the best pose falls short of a perfect fit."""
    per_reading = float(evidence.log_likelihood[0]) / evidence.crossed.shape[1]
    return float(options.fused.model.best - per_reading)


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
    elif out["theta_step"] is None:
        out["theta_step"] = float(np.deg2rad(METHODS[options.method].theta_step_deg))
    about_map = {f.name: getattr(features, f.name) for f in fields(features)}
    for name in ("grid", "max_bytes", "threads"):
        del about_map[name]
    return out | {"map": about_map, "seed": None}


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
        sigma=f.lattice.resolution / 2,
        sigma_theta=heading_sigma(len(thetas)),
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
