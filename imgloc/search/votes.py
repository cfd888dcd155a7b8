"""Where to look closely: poses proposed by the peaks of coarse GHT-V votes."""

import numpy as np

from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.scanpoints import scan_points, thin
from imgloc.geometry import uniform_thetas
from imgloc.likelihood.ght import ght_v
from imgloc.likelihood.posterior import smooth
from imgloc.model import Float32Array, FloatArray, GridInfo, LaserScan
from imgloc.options import FusedOptions, Prior
from imgloc.search.peaks import find_peaks
from imgloc.search.priors import around


def propose_votes(
    features: MapFeatures,
    scan: LaserScan,
    options: FusedOptions,
    prior: Prior | None = None,
    threads: int = 1,
) -> FloatArray:
    """Peaks (M, 3) of :func:`cast_votes`: grid frame, best first."""
    votes = cast_votes(features, scan, options, prior, threads)
    cell, where = vote_cell(features.grid.info, options), None
    if prior is not None:
        where = around(prior, votes.shape[1:], cell, features.grid.resolution)
    peaks = find_peaks(votes, options.vote_peaks, where=where)
    theta = peaks[:, 0] * (2 * np.pi / options.vote_headings)
    return np.column_stack(((peaks[:, :0:-1] + 0.5) * cell, theta))


def vote_cell(grid: GridInfo, options: FusedOptions) -> float:
    """Cell of the votes on a map, metres: time and memory for them have an end.

    Examples
    --------
    >>> vote_cell(GridInfo(1000, 1000, 0.05), FusedOptions())
    0.25
    >>> round(vote_cell(GridInfo(10_000, 10_000, 0.05), FusedOptions()), 2)
    1.22
    """
    area = grid.height * grid.width * grid.resolution**2
    return float(max(options.vote_cell, np.sqrt(area * options.vote_headings / options.vote_cells)))


def cast_votes(
    features: MapFeatures,
    scan: LaserScan,
    options: FusedOptions,
    prior: Prior | None = None,
    threads: int = 1,
) -> Float32Array:
    """Coarse, smoothed GHT-V votes (K, H, W) at the headings of the prior, Alg. 5."""
    points = scan_points(scan.ranges, scan.angles, scan.valid)
    usable = np.flatnonzero(points.valid)
    points = points.select(usable[thin(np.ones(len(usable), bool), options.few_rays)])
    grid, cell, n = (
        features.grid.info,
        vote_cell(features.grid.info, options),
        options.vote_headings,
    )
    rows, columns = (int(np.ceil(side * grid.resolution / cell)) for side in grid.shape)
    voters, visible = features.voters, features.voters_visibility
    votes = ght_v(voters, visible, points, n, (rows, columns), cell, threads=threads)
    votes = smooth(votes, 1.0, 0.7)
    if prior is not None:
        votes[~prior.headings(uniform_thetas(2 * np.pi / n), np.pi / n)] = 0
    return votes
