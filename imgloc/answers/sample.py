"""Poses drawn from p(x | z): where a particle filter that has lost the robot may start again."""

from dataclasses import replace

import numpy as np

from imgloc.errors import ConfigError, expect
from imgloc.features.mapfeatures import MapFeatures
from imgloc.geometry import centre_of, transform_poses, wrap
from imgloc.likelihoods.stacks import likelihood
from imgloc.model import BoolArray, Float32Array, FloatArray, GridInfo, LaserScan, Localization
from imgloc.options import FUSED, Options
from imgloc.pipeline import localize
from imgloc.search.stacked import posterior_of

_ALL = 200  # more hypotheses than are found


def sample_poses(
    features: MapFeatures, scan: LaserScan, count: int, rng: np.random.Generator,
    options: Options | None = None,
) -> FloatArray:  # fmt: skip
    """Draw poses (count, 3) of the sensor, map frame, from the calibrated posterior of a scan.

    Parameters
    ----------
    scan : LaserScan
        With too few readings, or readings without information, poses are drawn from everywhere.
    options : Options, optional
        ``fused`` draws around all that it finds, listed or not, the others from their stack.

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
    expect(features, MapFeatures, "features")
    expect(scan, LaserScan, "scan")
    options = options or Options()
    lattice = features.lattice
    if scan.directions < options.trust.readings or options.method == FUSED:
        answer = localize(features, scan, replace(options, top=_ALL))
        return draw_near(answer, features.free, lattice, count, rng)
    stack = likelihood(features, scan, options)
    probability = posterior_of(features, scan, stack, options)
    if probability.any():
        poses = draw_poses(probability, stack.thetas, lattice, count, rng)
        return transform_poses(features.grid.origin, poses)
    nothing = Localization((), "no-match", 0.0, 0.0)  # a stack without evidence: anywhere
    return draw_near(nothing, features.free, lattice, count, rng)


def draw_poses(
    probability: Float32Array, thetas: FloatArray, grid: GridInfo, n: int, rng: np.random.Generator
) -> FloatArray:
    """Draw poses from p(x | z): cells by their probability, and uniformly inside a cell.

    Parameters
    ----------
    probability : (K, H, W) float32 array
        Not all 0, or a ConfigError; need not sum to 1.
    thetas : (K,) float array
        Equally spaced over the circle: the middles of the cells.
    grid : GridInfo
        Lattice of the cells.
    n : int
        How many poses; ConfigError if negative.
    rng : numpy.random.Generator
        The same seed gives the same poses.

    Returns
    -------
    (n, 3) float array
        x, y, theta in the grid frame; :func:`imgloc.geometry.transform_poses` leads to the map's.

    Examples
    --------
    >>> p = np.zeros((4, 2, 2), dtype=np.float32)
    >>> p[1, 0, 1] = 1
    >>> poses = draw_poses(p, np.deg2rad([0, 90, 180, 270]), GridInfo(2, 2, 0.5), 3,
    ...                    np.random.default_rng(0))
    >>> bool(np.all((poses[:, 0] >= 0.5) & (poses[:, 0] <= 1.0))), poses.shape
    (True, (3, 3))
    """
    if n < 0:
        raise ConfigError(f"the number of poses to draw must not be negative, got {n}")
    # By heading first: a sum over a whole stack at a time would need a copy of it in float64.
    by_heading = np.cumsum(probability.reshape(len(probability), -1).sum(axis=1, dtype=np.float64))
    if not (len(by_heading) and by_heading[-1] > 0):
        raise ConfigError("no pose has a positive probability to be drawn with")
    shares = rng.random((n, 2))
    heading = np.searchsorted(by_heading, shares[:, 0] * by_heading[-1], side="right")
    heading = np.minimum(heading, np.flatnonzero(np.diff(by_heading, prepend=0))[-1])
    cell = np.empty(n, dtype=np.int64)
    for k in np.unique(heading):
        mine = heading == k
        sums = np.cumsum(probability[k].ravel(), dtype=np.float64)
        found = np.searchsorted(sums, shares[mine, 1] * sums[-1], side="right")
        cell[mine] = np.minimum(found, np.flatnonzero(probability[k].ravel())[-1])
    within = rng.uniform(-0.5, 0.5, (n, 3))
    cells = np.stack(np.unravel_index(cell, grid.shape), axis=1)
    xy = centre_of(cells, grid.resolution) + grid.resolution * within[:, :2]
    theta = wrap(thetas[heading] + 2 * np.pi / len(thetas) * within[:, 2])
    return np.column_stack((xy, theta))


def draw_near(
    answer: Localization, free: BoolArray, grid: GridInfo, n: int, rng: np.random.Generator
) -> FloatArray:
    """Draw poses from an answer: a Gaussian for each hypothesis, any free pose for what is left.

    Returns (n, 3) x, y, theta in the map frame, the frame of the answer. `free` (H, W) is the pose
    space, `grid` its lattice; the same seed of `rng` gives the same poses. ConfigError if `n` is
    negative or nothing is free.

    Examples
    --------
    >>> lost = Localization((), "no-match", 0.0, 0.0)
    >>> rng = np.random.default_rng(0)
    >>> draw_near(lost, np.ones((2, 2), bool), GridInfo(2, 2, 0.5), 4, rng).shape
    (4, 3)
    """
    masses = np.array([h.mass for h in answer.hypotheses])
    anywhere = np.asarray(free, dtype=np.float32)[None]
    out = transform_poses(grid.origin, draw_poses(anywhere, np.zeros(1), grid, n, rng))
    which = np.searchsorted(np.cumsum(masses), rng.random(n), side="right")
    normal = rng.standard_normal((n, 3))
    for k, hypothesis in enumerate(answer.hypotheses):
        mine, pose = which == k, hypothesis.pose
        spread = normal[mine] @ np.linalg.cholesky(hypothesis.covariance).T
        out[mine] = spread + (pose.x, pose.y, pose.theta)
    out[:, 2] = wrap(out[:, 2])
    return out
