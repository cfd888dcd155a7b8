"""Why an answer is what it is: the fit of each ray, and the likelihoods that proposed.

In the paper a scan point and a map point vote only if their normals agree (Alg. 4) and the map
lets the ray through (Alg. 5, l. 5). The same two vetoes, asked of a pose that has been found
already, are why it is right, or wrong. The numbers behind the verdict are the answer's evidence.

>>> from imgloc.model import LaserScan, OccupancyGrid
>>> from imgloc.pipeline import localize, prepare
>>> wall = np.pad(np.zeros((30, 40), bool), 2, constant_values=True)
>>> features = prepare(OccupancyGrid(wall, ~wall, 0.1))
>>> blind = LaserScan(np.full(20, np.inf), np.linspace(0, 3, 20), range_max=9.0)
>>> why = explain(features, blind, localize(features, blind))
>>> [(check.name, check.value, check.holds) for check in why.answer.evidence.checks]
[('readings', 0.0, False)]
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from skimage.measure import block_reduce

from imgloc.equality import ByContent
from imgloc.errors import ConfigError, expect
from imgloc.features.budget import MIB, check_budget
from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.pyramid import coarse_info
from imgloc.features.raycast import cast_rays
from imgloc.features.scanpoints import GRAZING, SURE, Readings, one_per_place, scan_points, scan_xy
from imgloc.geometry import in_grid_frame, poses_of, transform_points, uniform_thetas, wrap
from imgloc.likelihoods.correlate import correlate
from imgloc.likelihoods.stacks import likelihood
from imgloc.model import (
    BoolArray,
    Float32Array,
    FloatArray,
    GridInfo,
    Hypothesis,
    LaserScan,
    Likelihood,
    Localization,
    OccupancyGrid,
    OrientedPoints,
    Pose2D,
)
from imgloc.options import FUSED, EvidenceModel, Options, Shared
from imgloc.search.adapt import as_seen
from imgloc.search.priors import pyramid_levels
from imgloc.search.rescore import score_poses
from imgloc.search.weigh import settle

#: What a ray can be, in the order in which they are counted.
KINDS = ("agrees", "orientation", "visibility", "unexplained", "no_return", "invalid")

_SIDE = 1400  # cells that the picture of a likelihood has at most along a side
_WORK = 10**10  # readings x headings x cells of the correlation that is drawn, at most
_CHUNK = 1 << 24  # cells of its stack at a time


@dataclass(frozen=True, eq=False)
class RayFit(ByContent):
    """The fate of N rays at a pose.

    A ray that ``agrees`` ends on a surface that faces it, and met no wall before; the surface
    faces elsewhere (``orientation``), the ray passes through a mapped wall (``visibility``), or
    ends where the map has no surface (``unexplained``). ``no_return`` and ``invalid`` are not
    distances: these count for nothing, and those count where several lie side by side.
    """

    kind: npt.NDArray[np.str_]  #: (N,) one of :data:`KINDS` each
    end: FloatArray  #: (N, 2) where it ends, grid frame, metres; NaN where it is not a distance
    #: (N,) metres along the ray to the first mapped wall that it passes through, inf without
    wall: Float32Array

    @property
    def counts(self) -> Mapping[str, int]:
        """Number of rays of each kind."""
        return {kind: int(np.count_nonzero(self.kind == kind)) for kind in KINDS}


@dataclass(frozen=True, eq=False)
class Layer(ByContent):
    """The maximum over theta of a likelihood, as a stack of one; or why there is none."""

    name: str
    about: str
    likelihood: Likelihood | None


@dataclass(frozen=True, eq=False)
class HypothesisFit(ByContent):
    """One hypothesis and the scan laid on the map there."""

    pose: Pose2D  #: map frame
    hypothesis: Hypothesis  #: the same in the grid frame
    rays: RayFit
    #: score of the readings at the pose, nats each; of a stack's pose, after it has settled
    per_reading: float
    before: float  #: its mass if the true pose is one of those found


@dataclass(frozen=True, eq=False)
class Explanation(ByContent):
    """One answer, with what its :class:`~imgloc.model.Evidence` leaves out."""

    grid: OccupancyGrid
    scan: LaserScan  #: as it was laid on the map: its lengths multiplied by the evidence's scale
    answer: Localization
    options: Options
    fits: tuple[HypothesisFit, ...]  #: the hypotheses, best first
    layer: Layer | None  #: what proposed; None for a scan with too few readings

    def __repr__(self) -> str:
        rays = len(self.scan.ranges)
        return f"<Explanation of {rays} rays at {len(self.fits)} poses: {self.answer!r}>"

    def _repr_html_(self) -> str:
        """A row for each pose and what its rays do there, for notebooks."""
        head = "<tr><th>mass<th>x / m<th>y / m<th>theta / deg<th>nats a reading"
        rows = "".join(
            f"<tr><td>{fit.hypothesis.mass:.1%}<td>{fit.pose.x:.3f}<td>{fit.pose.y:.3f}"
            f"<td>{math.degrees(fit.pose.theta):.2f}<td>{fit.per_reading:.2f}"
            for fit in self.fits
        )
        return f"<p><b>{self.answer.verdict}</b></p><table>{head}{rows}</table>"


def explain(
    features: MapFeatures, scan: LaserScan, answer: Localization, options: Options | None = None
) -> Explanation:
    """Say why a scan was answered as it was.

    Parameters
    ----------
    features : MapFeatures
    scan : LaserScan
    answer : Localization
        What :func:`imgloc.pipeline.localize` returned for these features, scan and options.
    options : Options, optional

    Raises
    ------
    ConfigError
        If the answer is that of another scan.
    """
    expect(features, MapFeatures, "features")
    expect(scan, LaserScan, "scan")
    expect(answer, Localization, "answer")
    if answer.scan not in ("", scan.digest):
        raise ConfigError(f"answer: got that of another scan than {scan!r}, expected its own")
    options, said = options or Options(), answer.evidence
    # With the error that the answer has allowed for.
    grid, cell = features.grid, features.grid.resolution
    features, scan = as_seen(features, scan, Shared(said.scale, round(said.thinner / cell)))
    options = replace(options, shared=replace(options.shared, bent=said.bent))
    local = [in_grid_frame(h, grid.info) for h in answer.hypotheses]
    score = np.array([h.log_likelihood for h in local])
    if local and options.method != FUSED:  # of votes, say: what its readings say there
        score = settle(features, scan, poses_of(local), options)[2].log_likelihood
    fits = tuple(
        HypothesisFit(
            given.pose,
            h,
            explain_rays(h.pose, scan, features, options.model),
            float(total) / answer.evidence.readings,
            min(1.0, h.mass / max(1 - answer.elsewhere, 1e-12)),
        )
        for given, h, total in zip(answer.hypotheses, local, score, strict=True)
    )
    layer = None if answer.verdict == "invalid" else layer_of(features, scan, options)
    return Explanation(grid, scan, answer, options, fits, layer)


def explain_rays(
    pose: Pose2D, scan: LaserScan, features: MapFeatures, model: EvidenceModel
) -> RayFit:
    """Judge each ray of a scan at a pose of the sensor, grid frame.

    The questions about surface and wall are those of
    :func:`~imgloc.search.rescore.score_poses`, with the same `model`. That of the normals is not
    part of its score.

    Examples
    --------
    One wall, seen from its front, and then as if from behind it:

    >>> from imgloc.features.mapfeatures import MapFeatures
    >>> from imgloc.model import OccupancyGrid
    >>> wall = np.zeros((40, 40), bool)
    >>> wall[:, 20:30] = True
    >>> f = MapFeatures(OccupancyGrid(wall, ~wall, 0.1))
    >>> scan = LaserScan([1.0, 0.4, np.inf], [0.0, 0.0, 0.5], range_max=9.0)
    >>> for x in (1.0, 1.6):
    ...     explain_rays(Pose2D(x, 2.0), scan, f, EvidenceModel()).kind.tolist()
    ['agrees', 'unexplained', 'no_return']
    ['visibility', 'agrees', 'no_return']
    """
    used = np.flatnonzero(scan.valid)
    kind = np.full(len(scan.ranges), "invalid", dtype="<U11")
    kind[scan.no_return] = "no_return"
    end, wall = np.full((len(kind), 2), np.nan), np.full(len(kind), np.inf, dtype=np.float32)
    if len(used) == 0:
        return RayFit(kind, end, wall)
    end[used] = transform_points(pose, scan_xy(scan)[used])
    ranges, angles = scan.ranges[used], scan.angles[used]
    here = np.array([[pose.x, pose.y, pose.theta]])
    evidence = score_poses(features, Readings(ranges, angles), here, model)
    on_surface, crossed = evidence.on_surface[0], evidence.crossed[0]
    kind[used] = np.where(on_surface, "agrees", "unexplained")
    kind[used[crossed]] = "visibility"
    wall[used[crossed]] = cast_rays(
        features.walls,
        here[0, :2],
        pose.theta + angles[crossed],
        ranges[crossed],
        features.field.resolution,
    )
    asked = np.flatnonzero(on_surface & ~crossed)
    points = scan_points(scan.ranges, scan.angles, scan.valid).select(asked)
    faces = faced(
        end[used[asked]],
        wrap(pose.theta + angles[asked]),
        wrap(pose.theta + points.alpha),
        np.where(points.valid, points.sigma_alpha, np.inf),
        features.surface,
        reach=2 * max(model.sigmas) + 2 * features.field.resolution,
    )
    kind[used[asked[~faces]]] = "orientation"
    return RayFit(kind, end, wall)


def faced(
    end: FloatArray, psi: FloatArray, alpha: FloatArray, sigma: FloatArray, surface: OrientedPoints,
    *, reach: float,
) -> BoolArray:  # fmt: skip
    """Return whether a ray ends on a surface that faces it: (N,) bool.

    Asked are the surface points about as near as the nearest. One of them must face the sensor
    and have the normal of the scan there, within 30 degrees or two standard deviations. Where
    no normal is known there is nothing to object to.

    Parameters
    ----------
    end, psi : (N, 2) and (N,) float arrays
        Where the rays end, metres, grid frame, and where they go, radians.
    alpha, sigma : (N,) float arrays
        Normals of the scan there and their standard deviations, inf for one not known.
    surface : OrientedPoints
        Grid frame.
    reach : float
        How far to look, metres.

    Examples
    --------
    >>> wall = OrientedPoints([[1.0, 0.0]], [np.pi], [0.1], [True])
    >>> ends, known = np.array([[1.0, 0.0], [1.1, 0.0], [2.0, 0.0]]), np.full(3, 0.1)
    >>> normals = np.array([3.0, 1.6, 1.6])
    >>> faced(ends, np.zeros(3), normals, known, wall, reach=0.5).tolist()
    [True, False, True]
    >>> faced(ends, np.full(3, np.pi), normals, np.full(3, np.inf), wall, reach=0.5).tolist()
    [False, False, True]
    """
    from scipy.spatial import cKDTree  # 0.3 s that no answer without reasons should wait for

    surface = surface.select(np.asarray(surface.valid & np.isfinite(surface.alpha)))
    pairs = cKDTree(end).sparse_distance_matrix(cKDTree(surface.xy), reach, output_type="ndarray")
    ray, point, away = pairs["i"], pairs["j"], pairs["v"]
    nearest = np.full(len(end), np.inf)
    np.minimum.at(nearest, ray, away)
    close = away <= nearest[ray] + EvidenceModel.displaced  # points so near to it are asked, too
    ray, point = ray[close], point[close]
    normal = surface.alpha[point]
    # A surface along the ray may turn away by so much that none is followed any more.
    facing = np.cos(normal - psi[ray]) < np.sin(GRAZING)
    known = np.isfinite(sigma[ray])
    doubt = 2 * np.hypot(np.where(known, sigma[ray], 0.0), surface.sigma_alpha[point])
    turned = np.abs(wrap(np.where(known, alpha[ray], normal) - normal))
    agrees = facing & (turned <= np.maximum(SURE, doubt))
    out = np.ones(len(end), np.bool_)
    out[ray] = False
    out[ray[agrees]] = True
    return out


def layer_of(features: MapFeatures, scan: LaserScan, options: Options) -> Layer:
    """The likelihood of what proposes, or the stack itself of another method.

    The scan has at least one valid reading. The options have the memory that a picture may take.
    """
    method = options.method
    if method == FUSED:
        return _endpoints(features, scan, options)
    try:
        stack = likelihood(features, scan, options)
    except ConfigError as error:
        return Layer(method, f"Left out: {error}.", None)
    about = f"{len(stack.thetas)} headings, cells of {stack.grid.resolution:.2g} m"
    return _layer(method, about, stack.values.max(axis=0), stack.grid.resolution, features)


def _endpoints(features: MapFeatures, scan: LaserScan, options: Options) -> Layer:
    """Endpoint correlation on the finest level of the pyramid that is worth the time."""
    prior, fused = options.prior, options.fused
    few, threads = one_per_place(scan, fused.place).spread(fused.few_rays), options.threads
    thetas = uniform_thetas(2 * fused.theta_step)
    thetas = thetas[prior.headings(thetas, fused.theta_step)]
    levels = pyramid_levels(prior, features.pyramid, features.grid.resolution)
    work = [len(few) * len(thetas) * level.image.size for level in levels]
    level = levels[next((k for k, w in enumerate(work) if w <= _WORK), len(levels) - 1)]
    xy, cell, at_once = few.xy, level.resolution, max(1, _CHUNK // level.image.size)
    best = np.zeros(level.image.shape, dtype=np.float32)
    need = 12 * level.image.size * min(at_once, max(1, len(thetas))) + 64 * MIB
    what = "the picture of the endpoint correlation"
    try:
        check_budget(need, options.memory_budget, what, "use larger cells")
    except ConfigError as error:
        return Layer("cbml", f"Left out: {error}.", None)
    for start in range(0, len(thetas), at_once):
        some = thetas[start : start + at_once]
        stack = correlate(
            level.image, xy, some, cell, engine="shift", threads=threads, where=level.free
        )
        np.maximum(best, stack.max(axis=0), out=best)
    about = f"{len(thetas)} headings, cells of {cell:.2g} m, {len(few)} readings"
    return _layer("cbml", about, best, cell, features)


def _layer(
    method: str, about: str, best: Float32Array, cell: float, features: MapFeatures
) -> Layer:
    """A picture's worth of a maximum over theta: blocks of cells keep their maximum."""
    info = GridInfo(best.shape[0], best.shape[1], cell, features.grid.origin)
    factor = -(-max(best.shape) // _SIDE)
    if factor > 1:  # blocks that stick out are filled
        best = np.asarray(block_reduce(best, factor, np.max, cval=float(best.min())))
        info = coarse_info(info, factor)
    return Layer(method, about, Likelihood(best[None], np.zeros(1), info, method))
