"""The stack of a method by its name."""

from typing import Protocol

from imgloc.errors import ConfigError, expect
from imgloc.features.budget import check_budget, stack_bytes
from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.scanpoints import scan_points, scan_xy
from imgloc.likelihoods.beam import beam, heading_sigma
from imgloc.likelihoods.cbml import cbml, cbml_o
from imgloc.likelihoods.ght import ght, ght_v
from imgloc.model import Float32Array, FloatArray, LaserScan, Likelihood
from imgloc.options import METHODS, Options


class Stack(Protocol):
    """A likelihood of one's own: any function that makes the stack of a scan on a map.

    The values (K, H, W) are 0 or more, not logarithms, at K headings that are spread evenly over
    the circle from 0, and at the cells of ``features.lattice``. The name of the method is one's
    own. :func:`imgloc.localize` takes such a function as `stack`.
    """

    def __call__(self, features: MapFeatures, scan: LaserScan, /) -> Likelihood:
        """The stack of a scan, in the sensor frame, on a map."""


def likelihood(features: MapFeatures, scan: LaserScan, options: Options | str) -> Likelihood:
    """Compute the full stack of one of the paper's methods.

    Parameters
    ----------
    features : MapFeatures
        The map. Its lattice, in the grid frame, has the poses of the stack.
    scan : LaserScan
        The scan, in the sensor frame.
    options : Options or str
        Options of the method, or only its name.

    Returns
    -------
    Likelihood
        Its `values` (K, H, W) are those of the poses at K headings and H x W cells.

    Raises
    ------
    ConfigError
        If the method is unknown, or the stack is larger than the memory budget.

    Examples
    --------
    >>> import numpy as np
    >>> from imgloc.model import OccupancyGrid
    >>> walls = np.pad(np.zeros((8, 9), bool), 1, constant_values=True)
    >>> scan = LaserScan([0.4, 0.5], [0.0, 1.0], range_max=9.0)
    >>> features = MapFeatures(OccupancyGrid(walls, ~walls, 0.1))
    >>> likelihood(features, scan, "cbml").values.shape
    (120, 10, 11)
    """
    if isinstance(options, str):
        options = Options(options)
    expect(features, MapFeatures, "features")
    expect(scan, LaserScan, "scan")
    method, threads, budget = options.method, options.threads, options.memory_budget
    if method not in METHODS:
        raise ConfigError(f"method must be one of {', '.join(METHODS)}, got {method!r}")
    thetas, lattice = options.thetas, features.lattice
    n, shape = len(thetas), lattice.shape
    need = stack_bytes(method, shape, n, threads=threads, n_rays=features.n_rays)
    what = f"{method} on {n} headings x {shape[0]} x {shape[1]} cells"
    check_budget(need, budget, what, "use larger cells, a larger theta step, or the method 'fused'")
    values = stack_of(
        method, features, scan, thetas,
        engine=options.engine, threads=threads, memory_budget=budget,
    )  # fmt: skip
    values.flags.writeable = False  # nobody else has it: no need of a copy
    return Likelihood(values, thetas, lattice, method, scan)


def held_stack(
    stack: "Likelihood | Stack | None", features: MapFeatures, scan: LaserScan, options: Options
) -> Likelihood | None:
    """The stack that is given, or that a function of the user makes.

    A stack of another known method, or of another map or scan, raises a ConfigError.
    """
    if stack is None:
        return None
    made = stack(features, scan) if callable(stack) else stack
    expect(made, Likelihood, "stack")
    if made.method in METHODS and made.method != options.method:
        raise ConfigError(f"stack: got one of {made.method}, expected one of {options.method}")
    of, here = ((*g.shape, g.resolution) for g in (made.grid, features.lattice))
    if of != here:
        raise ConfigError(f"stack: got rows, columns, cell {of}, expected {here}: of another map?")
    if made.scan is not None and made.scan.digest != scan.digest:
        raise ConfigError(f"stack: got one of another scan, {made.scan!r}, expected {scan!r}")
    return made


def stack_of(
    method: str,
    features: MapFeatures,
    scan: LaserScan,
    thetas: FloatArray,
    *,
    engine: str = "auto",
    threads: int = 1,
    memory_budget: int | None = None,
) -> Float32Array:
    """Compute a method's values (K, H, W) on the features' lattice at some headings.

    `thetas` (K,) are headings in radians, uniform over the circle from 0. `engine` computes the
    correlations: "auto", "filter2d", "shift", "dft" or "remap". The result does not depend on
    `threads`. A ConfigError is raised for a method without a stack, and if the ray distances of
    ``beam`` take more bytes than `memory_budget`, by default that of the map.
    """
    f, (shape, cell) = features, (features.lattice.shape, features.lattice.resolution)
    if method == "cbml":
        xy = scan_xy(scan)[scan.valid]
        return cbml(f.bmap, xy, thetas, cell, engine=engine, threads=threads)
    if method == "beam":
        distances = f.ray_distances_within(memory_budget or f.memory_budget)
        return beam(
            distances, scan.ranges, scan.angles, scan.valid, thetas,
            sigma=cell / 2, sigma_theta=heading_sigma(len(thetas)), threads=threads,
        )  # fmt: skip
    points = scan_points(scan.ranges, scan.angles, scan.valid)
    if method == "cbml-o":
        return cbml_o(f.vmap, points, thetas, cell, engine=engine, threads=threads)
    if method == "ght":
        return ght(f.surface, points, len(thetas), shape, cell, threads=threads)
    if method == "ght-v":
        return ght_v(f.surface, f.visibility, points, len(thetas), shape, cell, threads=threads)
    raise ConfigError(f"{method!r} has no stack")
