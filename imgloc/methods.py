"""The paper's algorithms by name, and what decides an answer."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from imgloc.errors import ConfigError
from imgloc.features.budget import check_budget, default_budget, stack_bytes
from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.scanpoints import scan_points, scan_xy
from imgloc.geometry import uniform_thetas
from imgloc.likelihood.beam import beam, heading_sigma
from imgloc.likelihood.calibration import Calibration
from imgloc.likelihood.cbml import cbml, cbml_o
from imgloc.likelihood.ght import ght, ght_v
from imgloc.model import Float32Array, FloatArray, LaserScan, Likelihood
from imgloc.search.fused_options import FusedOptions
from imgloc.search.priors import Prior
from imgloc.search.trust import Trust

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
        Step of the headings of a stack, radians, and of branch and bound, whose own are those
        of ``cbml``; None takes the method's own.
    engine : str
        Of the correlations, see :mod:`imgloc.likelihood.correlate`.
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
    fused : FusedOptions
    trust : Trust
    calibration : Calibration, optional
        What makes a probability of a stack; None takes the method's default. ``fused`` has none.
    """

    method: str = FUSED
    top: int = 5
    theta_step: float | None = None
    engine: str = "auto"
    threads: int = 1
    memory_budget: int | None = None
    time_budget: float | None = None
    exact: bool = False
    prior: Prior = field(default_factory=Prior)
    fused: FusedOptions = field(default_factory=FusedOptions)
    trust: Trust = field(default_factory=Trust)
    calibration: Calibration | None = None


@dataclass(frozen=True)
class Method:
    """One of the paper's algorithms: its stack, and the step of its headings in degrees."""

    stack: Callable[[MapFeatures, LaserScan, FloatArray, Options], Float32Array]
    theta_step_deg: float
    summary: str


def headings_of(options: Options) -> FloatArray:
    """Headings of a method's stack, radians."""
    step = options.theta_step
    if step is None:
        step = float(np.deg2rad(METHODS[options.method].theta_step_deg))
    return uniform_thetas(step)


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
    thetas = headings_of(options)
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
    values = METHODS[options.method].stack(features, scan, thetas, options)
    return Likelihood(values, thetas, lattice, options.method)


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
        f.ray_distances_within(o.memory_budget or f.memory_budget),
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
