"""The stack of a method by its name: what of map and scan each algorithm takes."""

from imgloc.errors import ConfigError
from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.scanpoints import scan_points, scan_xy
from imgloc.likelihoods.beam import beam, heading_sigma
from imgloc.likelihoods.cbml import cbml, cbml_o
from imgloc.likelihoods.ght import ght, ght_v
from imgloc.model import Float32Array, FloatArray, LaserScan


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

    `thetas` (K,) are uniform over the circle from 0, radians; `engine` and `threads` as of
    :func:`~imgloc.likelihoods.correlate.correlate`. ConfigError for a method without a stack, or if
    the ray distances of ``beam`` take more bytes than `memory_budget`, by default the map's own.
    """
    f, (shape, cell) = features, (features.lattice.shape, features.lattice.resolution)
    if method == "cbml":
        xy = scan_xy(scan)[scan.valid]
        return cbml(f.bmap, xy, thetas, cell, engine=engine, threads=threads)
    if method == "beam":
        distances = f.ray_distances_within(memory_budget or f.memory_budget)
        return beam(
            distances, scan.ranges, scan.angles, scan.valid, scan.no_return, thetas,
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
