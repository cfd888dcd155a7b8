"""From a scan to separated poses with masses: one search for each way of scoring."""

import time
from dataclasses import dataclass, replace

import numpy as np

from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.pyramid import block_masks
from imgloc.features.scanpoints import scan_xy, thin
from imgloc.geometry import centre_of, wrap
from imgloc.likelihood.calibration import DEFAULTS
from imgloc.likelihood.posterior import calibrated
from imgloc.methods import Options, headings_of, likelihood
from imgloc.model import Float32Array, FloatArray, Hypothesis, IntArray, LaserScan, Likelihood
from imgloc.search.branch_and_bound import Best, best_poses
from imgloc.search.fused import search_fused
from imgloc.search.hypotheses import as_hypotheses, covariances, entropy, masses
from imgloc.search.moments import peak_moments
from imgloc.search.peaks import find_peaks, separated
from imgloc.search.refine import refine
from imgloc.search.rescore import Evidence, rescore
from imgloc.search.trust import crowding

MODES = 20
"""Poses that are looked for, however few are listed: no verdict depends on the list's length."""


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
    complete : bool
        The search came to its end.
    """

    hypotheses: tuple[Hypothesis, ...]
    mass: FloatArray
    elsewhere: float
    explained: float
    entropy: float
    complete: bool = True


NOTHING = Found((), np.empty(0), 1.0, 0.0, 0.0)


def find_fused(features: MapFeatures, scan: LaserScan, options: Options) -> Found:
    """Proposals from two sources, one score, separated modes."""
    deadline = np.inf
    if options.time_budget is not None:
        deadline = time.monotonic() + options.time_budget
    result = search_fused(
        features,
        scan,
        options.fused,
        prior=options.prior,
        more=_exact(features, scan, options)[0] if options.exact else None,
        late=lambda: time.monotonic() > deadline,
        threads=options.threads,
    )
    if len(result.poses) == 0:
        return replace(NOTHING, complete=result.complete)
    score = result.evidence.log_likelihood
    misfit = misfit_of(result.evidence, options)
    crowded = crowding(scan_xy(scan)[result.rays])
    cell = features.grid.resolution
    mass = masses(score, options.trust.temperature_at(misfit, crowded, cell))
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
    explained = float(result.evidence.explained[0])
    return Found(hypotheses, mass, elsewhere, explained, whole, result.complete)


def exact_thetas(options: Options) -> FloatArray:
    """Headings of branch and bound: those of the stack that it does without."""
    return headings_of(replace(options, method="cbml"))


def _exact(features: MapFeatures, scan: LaserScan, options: Options) -> tuple[FloatArray, Best]:
    """Best separated poses (M, 3) of CBML's score, grid frame, by branch and bound."""
    prior, pooled = options.prior, features.pooled
    thetas = exact_thetas(options)
    wanted = np.flatnonzero(prior.headings(thetas, np.pi / len(thetas)))
    if prior.cells is not None:
        where = prior.lattice(features.free, features.factor)
        pooled = replace(pooled, where=block_masks(where, pooled.top))
    distance, angle = options.fused.separation
    best = best_poses(
        pooled,
        scan_xy(scan)[scan.valid],
        thetas[wanted],
        count=max(options.top, MODES),
        distance=distance,
        angle=angle,
        threads=options.threads,
    )
    cells = best.cells.copy()
    cells[:, 0] = wanted[cells[:, 0]]
    xy = centre_of(cells[:, 1:], features.lattice.resolution)
    return np.column_stack((xy, thetas[cells[:, 0]])), Best(cells, best.scores)


def find_exact(features: MapFeatures, scan: LaserScan, options: Options) -> Found:
    """The best poses of CBML's stack without the stack.

    Masses are shares among at least :data:`MODES` of them, each score raised to the calibrated
    power, as if every mode were equally wide.
    """
    poses, best = _exact(features, scan, options)
    if len(poses) == 0:
        return NOTHING
    evidence, rays = settle(features, scan, poses[:1], options)
    elsewhere = options.trust.mass_elsewhere(misfit_of(evidence, options), 1.0)
    score, top = best.scores.astype(np.float64), slice(0, options.top)
    how = options.calibration or DEFAULTS["cbml"]
    share = masses(np.log(score), how.temperature_at("cbml", int(scan.valid.sum())))
    covariance = covariances(
        poses[top],
        scan_xy(scan)[rays],
        features.field,
        sigma=features.lattice.resolution,
        correlated=options.trust.correlated,
        extent=options.fused.separation,
    )
    mass = (1 - elsewhere) * share
    hypotheses = as_hypotheses(poses[top], score[top], mass[top], covariance)
    whole = entropy(np.append(mass, elsewhere))
    return Found(hypotheses, mass, elsewhere, float(evidence.explained[0]), whole)


def find_stack(features: MapFeatures, scan: LaserScan, options: Options) -> Found:
    """One of the paper's methods: its whole stack, and what is in it."""
    return found_in_stack(features, scan, likelihood(features, scan, options), options)


def probability_of(
    features: MapFeatures, scan: LaserScan, stack: Likelihood, options: Options
) -> Float32Array:
    """The calibrated posterior (K, H, W) of a stack over the poses of the prior."""
    return calibrated(
        stack,
        options.prior.lattice(features.free, features.factor),
        int(scan.valid.sum()),
        options.calibration,
        headings=options.prior.headings(stack.thetas, np.pi / len(stack.thetas)),
    )


def found_in_stack(
    features: MapFeatures, scan: LaserScan, stack: Likelihood, options: Options
) -> Found:
    """Modes of the posterior of a full stack: mass and moments of the peaks of each.

    The highest peak comes first, the paper's global maximum; a lower one that is broader may
    hold more mass.
    """
    probability = probability_of(features, scan, stack, options)
    # More peaks than modes: some are neighbours on the slope of one.
    peaks = find_peaks(probability, 4 * max(options.top, MODES), radius=2)
    poses, mass, covariance = peak_moments(probability, peaks, stack.thetas, stack.grid.resolution)
    if len(poses) == 0:
        return NOTHING
    distance, angle = options.fused.separation
    best, owner = separated(poses, len(poses), distance=distance, angle=angle)
    mass, covariance = _joined(poses, mass, covariance, best[owner])
    poses, mass, covariance, peaks = poses[best], mass[best], covariance[best], peaks[best]
    evidence, _ = settle(features, scan, poses[:1], options)
    # Votes are spread where walls are few, too: that says nothing of the scan.
    elsewhere = options.trust.mass_elsewhere(misfit_of(evidence, options), 1.0)
    uniform = 1 / (len(stack.thetas) * np.count_nonzero(features.free))
    with np.errstate(divide="ignore"):
        score = np.log(probability[tuple(peaks.T)].astype(np.float64) / uniform)
    mass = (1 - elsewhere) * mass
    hypotheses = as_hypotheses(poses, score, mass, covariance)
    return Found(hypotheses, mass, elsewhere, float(evidence.explained[0]), entropy(probability))


def _joined(
    poses: FloatArray, mass: FloatArray, covariance: FloatArray, owner: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Mass (M,) and covariance (M, 3, 3) of each pose with those of which it is the owner."""
    offset = poses - poses[owner]
    offset[:, 2] = wrap(offset[:, 2])
    second = covariance + offset[:, :, None] * offset[:, None, :]
    total, out = np.zeros_like(mass), np.zeros_like(covariance)
    np.add.at(total, owner, mass)
    np.add.at(out, owner, (mass / total[owner])[:, None, None] * second)
    return total, out


def settle(
    features: MapFeatures, scan: LaserScan, poses: FloatArray, options: Options
) -> tuple[Evidence, IntArray]:
    """Evidence at poses after they have settled, and the readings used.

    Trust is about the place, not about the cell.
    """
    rays = thin(scan.valid, options.fused.rays)
    poses = refine(poses, scan_xy(scan)[rays], features.field, sigmas=(0.3, 0.1, 0.05))
    return rescore(
        poses,
        scan.ranges[rays],
        scan.angles[rays],
        features.field,
        features.walls,
        options.fused.model,
    ), rays


def misfit_of(evidence: Evidence, options: Options) -> float:
    """Nats per reading that the best pose falls short of a perfect fit."""
    per_reading = float(evidence.log_likelihood[0]) / evidence.crossed.shape[1]
    return float(options.fused.model.best - per_reading)
