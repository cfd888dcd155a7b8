"""The score of the default method for every pose: what no search can beat.

The endpoint part of the score is an image: its logarithm at an endpoint depends on where that is
and on nothing else. Correlated with the scan it bounds the score of every pose from above, as
the visibility constraint only takes away. The best of all poses, many more than a search looks
at, are then refined and scored in full.
"""

from dataclasses import replace

import numpy as np

from imgloc.features.distance import signed_distance
from imgloc.features.lattice import blocks
from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.pyramid import Level
from imgloc.model import LaserScan
from imgloc.search.fused import FusedOptions, Modes, scan_xy, search_fused, thin
from imgloc.search.proposals import propose_all
from imgloc.search.rescore import EvidenceModel

KEEP = 20_000
"""Poses that are refined; a search looks at some three thousand."""
SECOND_LOOK = 500
"""Poses that are scored with all rays."""


def exhaustive(
    features: MapFeatures,
    scan: LaserScan,
    options: FusedOptions | None = None,
    *,
    keep: int = KEEP,
    threads: int = 1,
) -> Modes:
    """Score every pose of the lattice, and follow the best.

    Parameters
    ----------
    features : MapFeatures
        Whose `cell` is the step of the lattice.
    scan : LaserScan
        With at least one valid reading.
    options : FusedOptions, optional
        Of the search that is compared: its rays, its step of headings and its model.
    keep : int
        How many poses are refined.
    threads : int
        The result does not depend on it.

    Returns
    -------
    Modes
        As of :func:`~imgloc.search.fused.search_fused`, which contributes its own proposals: its
        best score is never above this one's.
    """
    options = options or FusedOptions()
    points = scan_xy(scan)[thin(scan.valid, options.few_rays)]
    poses = propose_all(
        score_level(features, options.model),
        points,
        theta_step=options.theta_step,
        keep=keep,
        threads=threads,
    )
    wider = replace(options, second_look=SECOND_LOOK)
    return search_fused(features, scan, wider, more=poses, threads=threads)


def score_level(features: MapFeatures, model: EvidenceModel) -> Level:
    """The endpoint part of the score as an image of the lattice, 0 where nothing is near.

    Logarithms above that of the background, in 255 steps, averaged over the cells of the map in
    each cell of the lattice.
    """
    distance = signed_distance(features.grid.occupied, features.grid.resolution)
    density = np.full(distance.shape, (1 - model.hit) / model.span)
    for sigma in model.sigmas:
        peak = model.hit / (len(model.sigmas) * sigma * np.sqrt(2 * np.pi))
        density += peak * np.exp(-0.5 * (distance / sigma) ** 2)
    gain = np.log(density / ((1 - model.hit) / model.span))
    image = blocks(gain, features.factor).mean(axis=(1, 3))
    scaled = np.rint(255 * image / max(float(image.max()), 1e-9)).astype(np.uint8)
    return Level(scaled, features.free, features.lattice.resolution)
