"""The default method: proposals from two sources, refined, re-scored, separated.

Endpoint correlation and GHT-V votes fail differently, so that both propose; the score that
decides is a third one, :mod:`imgloc.search.rescore`. Most proposals are dropped after a look
with a few rays.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.scanpoints import scan_points
from imgloc.geometry import cell_of, inside, uniform_thetas
from imgloc.likelihood.ght import ght_v
from imgloc.model import (
    BoolArray,
    Float32Array,
    FloatArray,
    GridInfo,
    IntArray,
    LaserScan,
)
from imgloc.search.hypotheses import modes
from imgloc.search.peaks import find_peaks, first_in_cell, smooth
from imgloc.search.priors import Prior
from imgloc.search.proposals import propose_endpoints
from imgloc.search.refine import refine
from imgloc.search.rescore import Evidence, EvidenceModel, bound, rescore

_LAST = 20  # proposals that get the second look when time is up
_BATCH = 256  # proposals that are scored at a time


@dataclass(frozen=True)
class FusedOptions:
    """What the search spends where.

    Parameters
    ----------
    theta_step : float
        Between the headings of the endpoint correlation, radians.
    keep : tuple of int
        Nodes kept by each level of the endpoint pyramid, finest first; as many as there are.
    skip : int
        The coarsest level of the pyramid takes every `skip`-th of the few rays.
    vote_cell : float
        Cell of the GHT-V votes, metres.
    vote_cells : int
        With more cells than this, headings and all, the votes of a map get larger ones.
    vote_headings : int
        Number of headings of the GHT-V votes.
    vote_peaks : int
        How many peaks of the votes become proposals.
    few_rays, rays : int
        Rays of the first look at all proposals, and of the second at the best.
    second_look, closer : int
        How many places get the second look, and how many poses, which may be of one place: between
        two layers of a wall the score has several maxima.
    twins, same : (float, float)
        Proposals nearer than this, metres and radians, are of one place, and one pose.
    separation : (float, float)
        Two poses nearer than this, metres and radians, are one hypothesis.
    model : EvidenceModel
        The score.
    """

    theta_step: float = float(np.deg2rad(1.0))
    keep: tuple[int, ...] = (3000, 8000, 8000, 16000)
    skip: int = 2
    vote_cell: float = 0.25
    vote_cells: int = 4_000_000
    vote_headings: int = 24
    vote_peaks: int = 100
    few_rays: int = 64
    rays: int = 180
    second_look: int = 80
    closer: int = 40
    twins: tuple[float, float] = (0.1, float(np.deg2rad(3.0)))
    same: tuple[float, float] = (0.02, float(np.deg2rad(0.7)))
    separation: tuple[float, float] = (0.5, float(np.deg2rad(15.0)))
    model: EvidenceModel = field(default_factory=EvidenceModel)


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
        where = prior.around(votes.shape[1:], cell, features.grid.resolution)
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
    grid, cell = features.grid.info, vote_cell(features.grid.info, options)
    shape = (
        int(np.ceil(grid.height * grid.resolution / cell)),
        int(np.ceil(grid.width * grid.resolution / cell)),
    )
    votes = ght_v(
        features.voters,
        features.voters_visibility,
        points,
        options.vote_headings,
        shape,
        cell,
        threads=threads,
    )
    votes = smooth(votes, 1.0, 0.7)
    if prior is not None:
        thetas = uniform_thetas(2 * np.pi / options.vote_headings)
        votes[~prior.headings(thetas, np.pi / options.vote_headings)] = 0
    return votes


def thin(valid: BoolArray, n: int) -> IntArray:
    """Indices of at most `n` of the valid readings, evenly spread over them.

    Examples
    --------
    >>> thin(np.array([True, False, True, True, True, True]), 3).tolist()
    [0, 3, 5]
    """
    index = np.flatnonzero(valid)
    pick = np.linspace(0, len(index) - 1, min(n, len(index))).round().astype(np.int64)
    return index[pick]


def scan_xy(scan: LaserScan) -> FloatArray:
    """Endpoints (N, 2) of all readings, sensor frame; what is not valid is at the origin."""
    r = np.where(scan.valid, scan.ranges, 0.0)
    return np.column_stack((r * np.cos(scan.angles), r * np.sin(scan.angles)))


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
