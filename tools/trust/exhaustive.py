"""A far wider search for the score of the default method: what the search misses shows.

The endpoint part of the score is an image: its logarithm at an endpoint depends on where that is
and on nothing else. Correlated with the scan it ranks all poses of a lattice, roughly: it is
averaged over cells, and walls in between are left out. The 20 000 best, many more than a
search looks at, are refined and scored in full. They join what the search itself finds, so that
the best of both is never below the search; nothing proves that no other pose is above.
"""

from dataclasses import fields, replace

import numpy as np
from skimage.measure import block_reduce

from imgloc import FusedOptions, LaserScan, MapFeatures, Options
from imgloc.features.distance import signed_distance
from imgloc.features.pyramid import Level, any_of_blocks
from imgloc.features.scanpoints import one_per_place
from imgloc.geometry import uniform_thetas
from imgloc.model import FloatArray
from imgloc.options import EvidenceModel
from imgloc.pipeline import find_modes
from imgloc.search.hypotheses import modes
from imgloc.search.modes import Modes
from imgloc.search.proposals import _exhaustive, _poses
from imgloc.search.rescore import Scores, hit_density

KEEP = 20_000
"""Poses that are refined; a search looks at some three thousand."""
SECOND_LOOK = 500
"""Poses that are scored with all rays."""
MOST = 500_000_000
"""With more poses than this the lattice of a map gets cells twice as large, and again: the
refinement reaches 0.2 m."""


def exhaustive(
    features: MapFeatures,
    scan: LaserScan,
    options: FusedOptions | None = None,
    *,
    keep: int = KEEP,
    most: int = MOST,
    threads: int = 1,
) -> Modes:
    """Rank every pose of a lattice, and follow the best beside the search's own.

    Parameters
    ----------
    features : MapFeatures
        Whose `cell` is the step of the lattice, if that has no more than `most` poses.
    scan : LaserScan
        With at least one valid reading.
    options : FusedOptions, optional
        Of the search that is compared: its rays, its step of headings and its model.
    keep, most : int
        How many poses are refined, and ranked.
    threads : int
        The result does not depend on it.

    Returns
    -------
    Modes
        As of :func:`~imgloc.pipeline.find_modes`; its best score is never below that
        function's own.
    """
    options = options or FusedOptions()
    points = one_per_place(scan, options.place).spread(options.rays).xy
    factor = features.factor
    headings = len(uniform_thetas(options.theta_step))
    while headings * features.grid.occupied.size > most * factor**2:
        factor *= 2
    level = score_level(features, options.model, factor)
    poses = propose_all(level, points, options.theta_step, keep, threads)
    wider = replace(options, second_look=SECOND_LOOK)
    return joined(
        find_modes(features, scan, Options(fused=options, threads=threads)),
        find_modes(features, scan, Options(fused=wider, threads=threads), more=poses),
        options,
    )


def propose_all(
    level: Level, xy: FloatArray, theta_step: float, keep: int, threads: int = 1
) -> FloatArray:
    """The best `keep` poses of one level at every heading: (M, 3), grid frame, best first.

    `xy` are scan points (N, 2) in the sensor frame, metres. `theta_step` is the largest step
    between headings, radians. The result does not depend on `threads`.
    """
    thetas = uniform_thetas(theta_step)
    return _poses(_exhaustive(level, xy, thetas, keep, threads), thetas, level)


def joined(a: Modes, b: Modes, options: FusedOptions) -> Modes:
    """The separated poses of two searches that scored the same readings, best first."""
    poses = np.concatenate((a.poses, b.poses))
    scores = Scores(
        *(np.concatenate([getattr(m.scores, f.name) for m in (a, b)]) for f in fields(Scores))
    )
    distance, angle = options.separation
    best = modes(poses, scores.things, distance=distance, angle=angle)
    return Modes(poses[best], scores.select(best), a.readings, a.complete and b.complete)


def score_level(features: MapFeatures, model: EvidenceModel, factor: int) -> Level:
    """The endpoint part of the score as an image of a lattice, 0 where nothing is near.

    Logarithms above that of the background, in 255 steps, averaged over the `factor` by `factor`
    cells of the map in each cell of the lattice.
    """
    distance = signed_distance(features.grid.occupied, features.grid.resolution)
    gain = np.log(hit_density(distance, model) / ((1 - model.hit) / model.span))
    image = block_reduce(gain, factor, np.mean)
    scaled = np.rint(255 * image / max(float(image.max()), 1e-9)).astype(np.uint8)
    free = any_of_blocks(features.grid.free, factor)
    return Level(scaled, free, factor * features.grid.resolution)
