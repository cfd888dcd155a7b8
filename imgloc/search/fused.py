"""The default method: proposals from two sources, refined, re-scored, separated.

Endpoint correlation and GHT-V votes fail differently, so that both propose; the score that
decides is a third one, :mod:`imgloc.search.rescore`. Most proposals are dropped after a look
with a few rays.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.scanpoints import scan_xy, thin
from imgloc.geometry import cell_of, inside
from imgloc.model import (
    FloatArray,
    IntArray,
    LaserScan,
)
from imgloc.search.fused_options import FusedOptions
from imgloc.search.hypotheses import modes
from imgloc.search.peaks import first_in_cell
from imgloc.search.priors import Prior
from imgloc.search.proposals import propose_endpoints
from imgloc.search.refine import refine
from imgloc.search.rescore import Evidence, bound, rescore
from imgloc.search.vote_proposals import propose_votes

_LAST = 20  # proposals that get the second look when time is up
_BATCH = 256  # proposals that are scored at a time


@dataclass(frozen=True)
class Modes:
    """What the search found, best first: C separated poses of the grid frame.

    `rays` are the readings that were scored; `complete` says whether the search came to its end.
    """

    poses: FloatArray
    evidence: Evidence
    rays: IntArray
    complete: bool = True


def search_fused(
    features: MapFeatures,
    scan: LaserScan,
    options: FusedOptions,
    *,
    prior: Prior | None = None,
    more: FloatArray | None = None,
    late: Callable[[], bool] = lambda: False,
    threads: int = 1,
) -> Modes:
    """Find all poses that fit a scan.

    Parameters
    ----------
    features : MapFeatures
    scan : LaserScan
        With at least one valid reading.
    options : FusedOptions
    prior : Prior, optional
        Poses outside it are not looked at.
    more : (M, 3) float array, optional
        Proposals of another source, grid frame.
    late : callable
        Whether time is up, asked between the stages: from then on only the best proposals so
        far are followed.
    threads : int
        The result does not depend on it.

    Returns
    -------
    Modes
        May be empty; `rays` are the indices of the readings that were scored.
    """
    few, many = thin(scan.valid, options.few_rays), thin(scan.valid, options.rays)
    xy = scan_xy(scan)
    prior = prior or Prior()
    resolution = features.grid.resolution
    levels = prior.levels(features.pyramid, resolution)
    endpoints, _ = propose_endpoints(
        levels,
        xy[few],
        theta_step=options.theta_step,
        keep=options.keep[: len(levels)],
        skip=options.skip,
        prior=prior,
        threads=threads,
    )
    sources = [endpoints, np.empty((0, 3)) if more is None else more]
    hurry = late()
    if not hurry:
        sources.insert(1, propose_votes(features, scan, options, prior, threads))
        hurry = late()
    if hurry:
        sources[0] = endpoints[: options.second_look]
    poses = refine(np.concatenate(sources), xy[few], features.field, sigmas=(0.2, 0.1))
    poses = _first_look(features, scan, few, _standing(features, poses, prior), options)
    hurry = hurry or late()
    if hurry:
        poses = poses[:_LAST]
    poses = refine(poses, xy[many], features.field, sigmas=(0.1, 0.05))
    poses = _standing(features, poses, prior)
    evidence = _scored(features, scan, many, poses, options)
    distance, angle = options.separation
    found = modes(poses, evidence.log_likelihood, distance=distance, angle=angle)
    return Modes(poses[found], evidence.select(found), many, complete=not hurry)


def _first_look(
    features: MapFeatures,
    scan: LaserScan,
    rays: IntArray,
    poses: FloatArray,
    options: FusedOptions,
) -> FloatArray:
    """The best places with a few rays, and the best poses: those that get the second look.

    Scored in the order of what they can reach at most, until none that is left can be among
    the places: the same ones as if all had been scored. Of poses that have met, the first stands
    for all.
    """
    most = bound(poses, scan.ranges[rays], scan.angles[rays], features.field, options.model)
    order = np.argsort(-most, kind="stable")
    order = order[first_in_cell(poses[order], *options.same)]
    distance, angle = options.twins
    seen, score = np.empty(0, np.int64), np.empty(0)
    best = seen
    start, size = 0, _BATCH
    while start < len(order):
        part = order[start : start + size]
        start, size = start + size, 2 * size
        evidence = _scored(features, scan, rays, poses[part], options)
        seen, score = np.append(seen, part), np.append(score, evidence.log_likelihood)
        by_index = np.argsort(seen)
        seen, score = seen[by_index], score[by_index]
        best = modes(poses[seen], score, distance=distance, angle=angle, most=options.second_look)
        rest = most[order[start : start + 1]]
        if len(best) == options.second_look and (rest < score[best[-1]]).all():
            break
    distance, angle = options.same
    close = modes(poses[seen], score, distance=distance, angle=angle, most=options.closer)
    return poses[seen[np.concatenate((best, np.setdiff1d(close, best)))]]


def _standing(features: MapFeatures, poses: FloatArray, prior: Prior) -> FloatArray:
    """The poses at which a robot can stand and may be, moved there if they are just beside."""
    poses = prior.nearest(poses, features.grid.resolution)
    cells = cell_of(poses[:, :2], features.grid.resolution)
    on_map = inside(cells, features.grid.info)
    poses, cells = poses[on_map], cells[on_map]
    return poses[features.standable[cells[:, 0], cells[:, 1]]]


def _scored(
    features: MapFeatures,
    scan: LaserScan,
    rays: IntArray,
    poses: FloatArray,
    options: FusedOptions,
) -> Evidence:
    """The score of poses with some of the rays."""
    return rescore(
        poses,
        scan.ranges[rays],
        scan.angles[rays],
        features.field,
        features.walls,
        options.model,
    )
