"""Poses drawn from p(x | z): where a particle filter that has lost the robot may start again."""

import numpy as np

from imgloc.features.mapfeatures import MapFeatures
from imgloc.geometry import transform_poses
from imgloc.likelihoods.draws import draw_near, draw_poses
from imgloc.model import FloatArray, LaserScan, Localization
from imgloc.options import FUSED, Options
from imgloc.pipeline import likelihood, localize, posterior_of


def sample_poses(
    features: MapFeatures,
    scan: LaserScan,
    count: int,
    rng: np.random.Generator,
    options: Options | None = None,
) -> FloatArray:
    """Draw poses (count, 3) of the sensor, map frame, from the calibrated posterior of a scan.

    Parameters
    ----------
    scan : LaserScan
        With too few readings, or readings that say nothing, poses are drawn from everywhere.
    options : Options, optional
        ``fused`` draws around as many hypotheses as it may list, the others from their stack.

    Examples
    --------
    >>> from imgloc.model import OccupancyGrid
    >>> from imgloc.pipeline import prepare
    >>> wall = np.pad(np.zeros((30, 40), bool), 2, constant_values=True)
    >>> features = prepare(OccupancyGrid(wall, ~wall, 0.1))
    >>> blind = LaserScan(np.full(20, np.inf), np.linspace(0, 3, 20), range_max=9.0)
    >>> sample_poses(features, blind, 5, np.random.default_rng(0)).shape
    (5, 3)
    """
    options = options or Options()
    lattice = features.lattice
    if scan.directions < options.trust.readings or options.method == FUSED:
        answer = localize(features, scan, options)
        return draw_near(answer, features.free, lattice, count, rng)
    stack = likelihood(features, scan, options)
    probability = posterior_of(features, scan, stack, options)
    if probability.any():
        poses = draw_poses(probability, stack.thetas, lattice, count, rng)
        return transform_poses(features.grid.origin, poses)
    nothing = Localization((), "no-match", 0.0, 0.0)  # a stack without evidence: anywhere
    return draw_near(nothing, features.free, lattice, count, rng)
