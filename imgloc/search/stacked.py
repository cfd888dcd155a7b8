"""The poses of the paper's methods: modes of a stack's posterior, and CBML's without its stack."""

from dataclasses import replace

import numpy as np

from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.pyramid import block_masks
from imgloc.features.scanpoints import one_per_place, scan_xy
from imgloc.geometry import centre_of
from imgloc.likelihoods.posterior import calibrated, entropy
from imgloc.model import Evidence, Float32Array, FloatArray, LaserScan, Likelihood, Temperature
from imgloc.options import DEFAULTS, Calibration, Options, Shared
from imgloc.search.branch_and_bound import best_poses
from imgloc.search.hypotheses import masses
from imgloc.search.peaks import peaks_of_posterior
from imgloc.search.priors import on_lattice
from imgloc.search.weigh import (
    MODES,
    Weighed,
    covariances_of,
    evidence_of,
    explained_rays,
    nothing,
    settle,
)


def weigh_exact(features: MapFeatures, scan: LaserScan, options: Options) -> Weighed:
    """Find and weigh the best poses of CBML's stack without computing the stack.

    Each score is raised to the calibrated power. The shares are those among at least :data:`MODES`
    poses, as if all modes were equally wide. Poses are in the grid frame.
    """
    poses, sums = exact_poses(features, scan, options)
    if len(poses) == 0:
        return nothing(options)
    how = options.calibration or DEFAULTS["cbml"]
    temperature = how.temperature_at("cbml", int(scan.valid.sum()))
    xy = one_per_place(scan, options.fused.place).spread(options.fused.rays).xy
    score = np.log(sums) / temperature
    share = masses(score, 1.0)
    listed = poses[: options.listed(share)]
    covariance = covariances_of(features, listed, xy, options, features.lattice.resolution)
    fit, explained = _settled_fit(features, scan, poses[:1], temperature, options)
    return Weighed(poses, score, share, covariance, fit, explained)


def exact_poses(
    features: MapFeatures, scan: LaserScan, options: Options, deadline: float = np.inf
) -> tuple[FloatArray, FloatArray]:
    """Find the best separated poses (M, 3) by CBML's score, grid frame, and their scores (M,).

    The search is exact: it returns the poses that the full stack would give. It stops at the
    `deadline`, seconds by :func:`time.monotonic`, and then returns the poses found so far.
    """
    prior, pooled, thetas = options.prior, features.pooled, options.thetas
    wanted = np.flatnonzero(prior.headings(thetas, np.pi / len(thetas)))
    if prior.cells is not None:
        where = on_lattice(prior, features.free, features.factor)
        pooled = replace(pooled, where=block_masks(where, pooled.top))
    (distance, angle), n = options.fused.separation, max(options.top or MODES, MODES)
    xy, some, threads = scan_xy(scan)[scan.valid], thetas[wanted], options.threads
    best = best_poses(
        pooled, xy, some,
        count=n, distance=distance, angle=angle, threads=threads, deadline=deadline,
    )  # fmt: skip
    xy = centre_of(best.cells[:, 1:], features.lattice.resolution)
    return np.column_stack((xy, thetas[wanted[best.cells[:, 0]]])), best.scores.astype(np.float64)


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
    if len(poses) == 0:
        return nothing(options)
    how = options.calibration or DEFAULTS.get(stack.method, Calibration())
    temperature = how.temperature_at(stack.method, int(scan.valid.sum()))
    uniform = 1 / (len(stack.thetas) * np.count_nonzero(features.free))
    with np.errstate(divide="ignore"):
        score = np.log(probability[tuple(peaks.T)].astype(np.float64) / uniform)
    fit, explained = _settled_fit(features, scan, poses[:1], temperature, options)
    return Weighed(poses, score, share, covariance, fit, explained, entropy=entropy(probability))


def _settled_fit(
    features: MapFeatures, scan: LaserScan, best: FloatArray, temperature: float, options: Options
) -> tuple[Evidence, float]:
    """Evidence of a stack's best pose (1, 3) after refinement, and the share of rays it explains.

    The evidence has the stack's `temperature`.
    """
    pose, readings, scores = settle(features, scan, best, options)
    fit = evidence_of(features, readings, scores, options)
    explained = explained_rays(features, scan, pose, options, Shared())
    return replace(fit, temperature=Temperature(temperature)), explained


def posterior_of(
    features: MapFeatures, scan: LaserScan, stack: Likelihood, options: Options
) -> Float32Array:
    """The calibrated posterior (K, H, W) of a stack over the poses of the prior; it sums to 1."""
    where = on_lattice(options.prior, features.free, features.factor)
    headings = options.prior.headings(stack.thetas, np.pi / len(stack.thetas))
    return calibrated(stack, where, int(scan.valid.sum()), options.calibration, headings=headings)
