"""Pictures' worth of likelihoods: the maximum over theta, as in Fig. 1, within the memory."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from skimage.measure import block_reduce

from imgloc.errors import ConfigError
from imgloc.features.budget import MIB, check_budget, default_budget
from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.pyramid import coarse_info
from imgloc.features.scanpoints import scan_xy, thin
from imgloc.geometry import uniform_thetas
from imgloc.likelihood.calibration import LOG_METHODS
from imgloc.likelihood.correlate import correlate
from imgloc.methods import FUSED, Options, likelihood
from imgloc.model import Float32Array, GridInfo, LaserScan, Likelihood
from imgloc.search.vote_proposals import cast_votes, vote_cell

_SIDE = 1400  # cells that the picture of a likelihood has at most along a side
_WORK = 10**10  # readings x headings x cells of the correlation that is drawn, at most
_CHUNK = 1 << 24  # cells of its stack at a time


@dataclass(frozen=True)
class Layer:
    """The maximum over theta of a likelihood, as a stack of one; or why there is none."""

    name: str
    about: str
    likelihood: Likelihood | None


def layers_of(features: MapFeatures, scan: LaserScan, options: Options) -> Iterator[Layer]:
    """Yield the likelihoods of what proposed, or the stack itself of another method.

    Parameters
    ----------
    features : MapFeatures
    scan : LaserScan
        With at least one valid reading.
    options : Options
        What a picture may take of memory is said there, too.
    """
    if options.method != FUSED:
        try:
            stack = likelihood(features, scan, options)
        except ConfigError as error:  # branch and bound does without the stack
            yield Layer(options.method, f"Left out: {error}.", None)
            return
        about = f"{len(stack.thetas)} headings, cells of {stack.grid.resolution:.2g} m"
        yield _layer(options.method, about, stack.values.max(axis=0), stack.grid, options.method)
        return
    yield _endpoints(features, scan, options)
    votes = cast_votes(features, scan, options.fused, options.prior, options.threads)
    cell = vote_cell(features.grid.info, options.fused)
    about = (
        f"{len(votes)} headings, cells of {cell:.2g} m, at most {options.fused.few_rays} readings"
    )
    lattice = GridInfo(votes.shape[1], votes.shape[2], cell, features.grid.origin)
    best = votes.max(axis=0)
    allowed = options.prior.around(best.shape, cell, features.grid.resolution)
    if allowed is not None:
        best *= allowed
    yield _layer("ght-v", about, best, lattice, "ght-v")


def _endpoints(features: MapFeatures, scan: LaserScan, options: Options) -> Layer:
    """Endpoint correlation on the finest level of the pyramid that is worth the time."""
    prior, fused = options.prior, options.fused
    few = thin(scan.valid, fused.few_rays)
    thetas = uniform_thetas(2 * fused.theta_step)
    thetas = thetas[prior.headings(thetas, fused.theta_step)]
    levels = prior.levels(features.pyramid, features.grid.resolution)
    work = [len(few) * len(thetas) * level.image.size for level in levels]
    level = levels[next((k for k, w in enumerate(work) if w <= _WORK), len(levels) - 1)]
    at_once = max(1, _CHUNK // level.image.size)
    best = np.zeros(level.image.shape, dtype=np.float32)
    name = "cbml"
    try:
        check_budget(
            12 * level.image.size * min(at_once, max(1, len(thetas))) + 64 * MIB,
            default_budget() if options.memory_budget is None else options.memory_budget,
            "the picture of the endpoint correlation",
            "use larger cells",
        )
    except ConfigError as error:
        return Layer(name, f"Left out: {error}.", None)
    for start in range(0, len(thetas), at_once):
        stack = correlate(
            level.image,
            scan_xy(scan)[few],
            thetas[start : start + at_once],
            level.resolution,
            engine="shift",
            threads=options.threads,
            where=level.free,
        )
        np.maximum(best, stack.max(axis=0), out=best)
    about = f"{len(thetas)} headings, cells of {level.resolution:.2g} m, {len(few)} readings"
    height, width = level.free.shape
    info = GridInfo(height, width, level.resolution, features.grid.origin)
    return _layer(name, about, best, info, name)


def _layer(name: str, about: str, best: Float32Array, info: GridInfo, method: str) -> Layer:
    """A picture's worth of a maximum over theta: blocks of cells keep their maximum."""
    factor = -(-max(best.shape) // _SIDE)
    if method in LOG_METHODS:  # blocks that stick out are filled with zeros
        best = np.exp(best - max(float(best.max()), -1e30))
    if factor > 1:
        best = np.asarray(block_reduce(best, factor, np.max))
        info = coarse_info(info, factor)
    return Layer(name, about, Likelihood(best[None], np.zeros(1), info, method))
