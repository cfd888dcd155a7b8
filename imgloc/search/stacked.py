"""The poses of the paper's methods: modes of a stack's posterior."""

from dataclasses import replace

import numpy as np

from imgloc.features.mapfeatures import MapFeatures
from imgloc.likelihoods.posterior import calibrated, entropy
from imgloc.model import Float32Array, LaserScan, Likelihood, Temperature
from imgloc.options import DEFAULTS, Calibration, Options, Shared
from imgloc.search.peaks import peaks_of_posterior
from imgloc.search.priors import on_lattice, ranked
from imgloc.search.weigh import MODES, Weighed, evidence_of, explained_rays, nothing, settle


def weigh_stack(
    features: MapFeatures, scan: LaserScan, stack: Likelihood, options: Options
) -> Weighed:
    """Find and weigh the modes of the posterior of a full stack.

    The mode of the highest peak, the paper's global maximum, comes first. A lower and broader mode
    may hold more mass. Poses are in the grid frame.
    """
    probability = posterior_of(features, scan, stack, options)
    n = 4 * max(options.top or MODES, MODES)  # some are neighbours on the slope of one mode
    cell, apart = stack.grid.resolution, options.fused.separation
    poses, share, covariance, peaks = peaks_of_posterior(
        probability, stack.thetas, cell, n=n, separation=apart
    )
    order, weighed = ranked(options.prior, poses, share, features.grid.resolution)
    if not weighed.any():
        return nothing(options)
    poses, covariance, peaks = poses[order], covariance[order], peaks[order]
    how = options.calibration or DEFAULTS.get(stack.method, Calibration())
    temperature = how.temperature_at(stack.method, int(scan.valid.sum()))
    uniform = 1 / (len(stack.thetas) * np.count_nonzero(features.free))
    with np.errstate(divide="ignore"):
        score = np.log(probability[tuple(peaks.T)].astype(np.float64) / uniform)
    pose, readings, settled = settle(features, scan, poses[:1], options)
    fit = evidence_of(features, readings, settled, options)
    fit = replace(fit, temperature=Temperature(temperature))
    explained = explained_rays(features, scan, pose, options, Shared())
    spread = entropy(probability)
    return Weighed(poses, score, weighed, share[order], covariance, fit, explained, entropy=spread)


def posterior_of(
    features: MapFeatures, scan: LaserScan, stack: Likelihood, options: Options
) -> Float32Array:
    """The calibrated posterior (K, H, W) of a stack over the poses of the prior; it sums to 1."""
    where = on_lattice(options.prior, features.free, features.factor)
    headings = options.prior.headings(stack.thetas, np.pi / len(stack.thetas))
    return calibrated(stack, where, int(scan.valid.sum()), options.calibration, headings=headings)
