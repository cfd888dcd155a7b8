"""What each ray of a scan says about a pose: agrees, or is vetoed, and by what.

The paper lets a pair of a scan point and a map point vote only if their normals agree (Alg. 4)
and the map lets the ray through (Alg. 5, l. 5). The same two vetoes, asked of a pose that has
been found already, tell somebody who looks at it why it is right, or wrong.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from imgloc.features.distance import DistanceField
from imgloc.features.raycast import cast_rays
from imgloc.features.scanpoints import scan_points, scan_xy
from imgloc.geometry import transform_points, wrap
from imgloc.model import (
    BoolArray,
    Float32Array,
    FloatArray,
    IntArray,
    LaserScan,
    OrientedPoints,
    Pose2D,
)
from imgloc.search.rescore import EvidenceModel, rescore

#: What a ray can be, in the order in which they are counted.
KINDS = ("agrees", "orientation", "visibility", "unexplained", "no_return", "invalid")

_TOLERANCE = np.deg2rad(30.0)  # between normals; more if one of them is uncertain
_GRAZING = np.deg2rad(10.0)  # a surface along the ray may turn away by so much
_NEAR = 0.1  # metres: points so little farther than the nearest are asked, too


@dataclass(frozen=True)
class RayFit:
    """What became of N rays at a pose.

    Parameters
    ----------
    kind : (N,) str array
        One of :data:`KINDS` each:

        - ``agrees``: ends on a surface that faces it, met no wall before;
        - ``orientation``: ends on a surface that faces elsewhere;
        - ``visibility``: passes through a mapped wall;
        - ``unexplained``: ends where the map has no surface;
        - ``no_return``, ``invalid``: not a distance, no say.
    end : (N, 2) float array
        Where it ends, grid frame, metres; NaN where it is not a distance.
    wall : (N,) float32 array
        Metres along the ray to the first mapped wall that it passes through, inf without.
    """

    kind: npt.NDArray[np.str_]
    end: FloatArray
    wall: Float32Array

    @property
    def counts(self) -> Mapping[str, int]:
        """How many rays there are of each kind."""
        return {kind: int(np.count_nonzero(self.kind == kind)) for kind in KINDS}


def explain_rays(
    pose: Pose2D,
    scan: LaserScan,
    surface: OrientedPoints,
    field: DistanceField,
    walls: Float32Array,
    model: EvidenceModel,
) -> RayFit:
    """Say what each ray of a scan says about a pose.

    Parameters
    ----------
    pose : Pose2D
        Of the sensor, grid frame.
    scan : LaserScan
    surface : OrientedPoints
        Of the map, grid frame.
    field, walls, model
        As in :func:`~imgloc.search.rescore.rescore`, whose questions about surface and wall
        these are. That of the normals is not part of its score.

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
    ...     fit = explain_rays(
    ...         Pose2D(x, 2.0), scan, f.surface, f.field, f.walls, EvidenceModel()
    ...     )
    ...     fit.kind.tolist()
    ['agrees', 'unexplained', 'no_return']
    ['visibility', 'agrees', 'no_return']
    """
    used = np.flatnonzero(scan.valid)
    kind = np.full(len(scan.ranges), "invalid", dtype="<U11")
    kind[scan.no_return] = "no_return"
    end = np.full((len(kind), 2), np.nan)
    wall = np.full(len(kind), np.inf, dtype=np.float32)
    if len(used) == 0:
        return RayFit(kind, end, wall)
    end[used] = transform_points(pose, scan_xy(scan)[used])
    ranges, angles = scan.ranges[used], scan.angles[used]
    here = np.array([[pose.x, pose.y, pose.theta]])
    evidence = rescore(here, ranges, angles, field, walls, model)
    on_surface, crossed = evidence.on_surface[0], evidence.crossed[0]
    kind[used] = np.where(on_surface, "agrees", "unexplained")
    kind[used[crossed]] = "visibility"
    wall[used[crossed]] = cast_rays(
        walls, here[0, :2], pose.theta + angles[crossed], ranges[crossed], field.resolution
    )
    asked = np.flatnonzero(on_surface & ~crossed)
    points = scan_points(scan.ranges, scan.angles, scan.valid).select(asked)
    faces = faced(
        end[used[asked]],
        wrap(pose.theta + angles[asked]),
        wrap(pose.theta + points.alpha),
        np.where(points.valid, points.sigma_alpha, np.inf),
        surface,
        reach=2 * max(model.sigmas) + 2 * field.resolution,
    )
    kind[used[asked[~faces]]] = "orientation"
    return RayFit(kind, end, wall)


def faced(
    end: FloatArray,
    psi: FloatArray,
    alpha: FloatArray,
    sigma: FloatArray,
    surface: OrientedPoints,
    *,
    reach: float,
) -> BoolArray:
    """Whether a ray ends on a surface that faces it.

    Asked are the surface points about as near as the nearest. One of them must face the sensor
    and have the normal of the scan there, within 30 degrees or two standard deviations. Where
    no normal is known there is nothing to object to.

    Parameters
    ----------
    end : (N, 2) float array
        Where the rays end, metres, grid frame.
    psi : (N,) float array
        Where they go, radians.
    alpha, sigma : (N,) float arrays
        Normals of the scan there and their standard deviations, inf for one not known.
    surface : OrientedPoints
        Grid frame.
    reach : float
        How far to look, metres.

    Returns
    -------
    (N,) bool array

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
    surface = surface.select(np.asarray(surface.valid & np.isfinite(surface.alpha)))
    ray, point = _pairs(end, surface.xy, reach)
    away = np.linalg.norm(end[ray] - surface.xy[point], axis=1)
    nearest = np.full(len(end), np.inf)
    np.minimum.at(nearest, ray, away)
    close = away <= np.minimum(nearest[ray] + _NEAR, reach)
    ray, point = ray[close], point[close]
    normal = surface.alpha[point]
    facing = np.cos(normal - psi[ray]) < np.sin(_GRAZING)
    known = np.isfinite(sigma[ray])
    doubt = 2 * np.hypot(np.where(known, sigma[ray], 0.0), surface.sigma_alpha[point])
    turned = np.abs(wrap(np.where(known, alpha[ray], normal) - normal))
    agrees = facing & (turned <= np.maximum(_TOLERANCE, doubt))
    asked, good = np.zeros(len(end), np.bool_), np.zeros(len(end), np.bool_)
    asked[ray] = True
    good[ray[agrees]] = True
    return good | ~asked


def _pairs(a: FloatArray, b: FloatArray, reach: float) -> tuple[IntArray, IntArray]:
    """Indices of all pairs of a point of `a` and one of `b` with about `reach` or less in x."""
    order = np.argsort(b[:, 0], kind="stable")
    low = np.searchsorted(b[order, 0], a[:, 0] - reach)
    count = np.searchsorted(b[order, 0], a[:, 0] + reach, side="right") - low
    first = np.repeat(low - np.cumsum(count) + count, count)
    return np.repeat(np.arange(len(a)), count), order[first + np.arange(count.sum())]
