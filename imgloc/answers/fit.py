"""The fit of a scan at a pose that is given: its score, and each ray, as an answer has it.

>>> from imgloc.model import OccupancyGrid
>>> from imgloc.pipeline import prepare
>>> wall = np.pad(np.zeros((30, 40), bool), 2, constant_values=True)
>>> features = prepare(OccupancyGrid(wall, ~wall, 0.1))
>>> scan = LaserScan([2.0, 1.5], [0.0, np.pi / 2], range_max=9.0)
>>> fit = fit_at(features, scan, Pose2D(2.2, 1.7), Options())
>>> fit.rays.kind.tolist(), round(fit.misfit, 3), fit.explained
(['agrees', 'agrees'], 0.05, 1.0)
>>> settled = fit_at(features, scan, Pose2D(2.1, 1.6), Options(), settle=True).pose
>>> round(settled.x, 1), round(settled.y, 1)
(2.2, 1.7)
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from imgloc.answers.explain import RayFit, explain_rays
from imgloc.answers.truth import steps_around
from imgloc.equality import ByContent
from imgloc.errors import expect
from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.scanpoints import one_per_place
from imgloc.geometry import in_grid_frame, transform_points, transform_poses
from imgloc.model import FloatArray, LaserScan, Pose2D, plain
from imgloc.numbers import number
from imgloc.options import FusedOptions, Options, Prior, Shared
from imgloc.search.priors import stands
from imgloc.search.refine import FROM_CELLS, refine
from imgloc.search.rescore import score_readings
from imgloc.search.weigh import explained_rays

_CLOSER = number("fit.closer")  # part of these for a second look, around the best of the first


@dataclass(frozen=True, eq=False)
class PoseFit(ByContent):
    """A scan laid on the map at a pose."""

    pose: Pose2D  #: of the sensor, map frame
    log_likelihood: float  #: nats
    best: float  #: log-likelihood of a reading that fits perfectly, nats
    readings: int  #: how many were scored
    explained: float  #: share of the valid rays that end on a surface and pass through no wall
    stands: bool  #: whether a sensor can be there
    rays: RayFit  #: ends in the grid frame
    ends: FloatArray  #: (N, 2) the same in the map frame
    #: (N,) metres from there to the nearest surface; NaN where a ray ends nowhere
    distance: FloatArray

    @property
    def per_reading(self) -> float:
        """Nats per reading; NaN without one."""
        return self.log_likelihood / self.readings if self.readings else float("nan")

    @property
    def misfit(self) -> float:
        """Nats per reading by which a perfect fit is better."""
        return self.best - self.per_reading

    def as_row(self) -> Mapping[str, Any]:
        """Plain values for JSON; a ray that ends nowhere has null."""
        known = np.isfinite(self.ends[:, 0]).tolist()
        ends = [end if ok else None for end, ok in zip(self.ends.tolist(), known, strict=True)]
        names = ("pose", "log_likelihood", "per_reading", "best", "misfit", "explained", "stands")
        row = {name: getattr(self, name) for name in (*names, "readings")}
        rays = {"kind": self.rays.kind, "end": ends, "wall": self.rays.wall.astype(np.float64)}
        rays["distance"] = self.distance
        return dict(plain(row | {"counts": self.rays.counts, "rays": rays}))


def fit_at(
    features: MapFeatures, scan: LaserScan, pose: Pose2D, options: Options, *,
    shared: Shared | None = None, settle: bool = False,
) -> PoseFit:  # fmt: skip
    """Score one pose by the default method, and judge each ray there.

    Parameters
    ----------
    features : MapFeatures
    scan : LaserScan
    pose : Pose2D
        Of the sensor, map frame.
    options : Options
    shared : Shared, optional
        The error that all readings share; by default that of the options.
    settle : bool
        Move the pose first to where the readings meet the walls.
    """
    expect(features, MapFeatures, "features")
    expect(scan, LaserScan, "scan")
    shared = options.shared if shared is None else shared
    options = replace(options, shared=shared)
    scan, grid = scan.scaled(shared.scale), features.grid
    features = features.thinner(shared.thinner)
    at = np.array([[*in_grid_frame(pose, grid)]])
    readings = one_per_place(scan, options.fused.place).spread(options.fused.rays)
    if settle and len(readings):
        for part, widths in ((1, FROM_CELLS), (_CLOSER, FROM_CELLS[-1:])):
            around = refine(at + _starts() / part, readings.xy, features.field, sigmas=widths)
            some = np.concatenate((at, around))
            score = score_readings(features, readings, some, options.model)
            at = some[score.argmax()][None]
        pose = Pose2D(*transform_poses(grid.origin, at)[0])
    total, explained = 0.0, float("nan")
    if len(readings):
        total = float(score_readings(features, readings, at, options.model)[0])
        explained = explained_rays(features, scan, at, options, Shared())
    rays = explain_rays(Pose2D(*at[0]), scan, features, options.model)
    ends, distance = transform_points(grid.origin, rays.end), np.full(len(rays.end), np.nan)
    there = np.isfinite(ends[:, 0])
    distance[there] = np.abs(features.field.lookup(*rays.end[there].T.astype(np.float32))[0])
    return PoseFit(
        *(pose, total, options.model.best, len(readings), explained),
        bool(stands(at, Prior(), features)[0]),
        *(rays, ends, distance),
    )


def _starts() -> FloatArray:
    """Steps (N, 3) to poses around one, metres and radians."""
    far, (along, turn) = FusedOptions.separation, steps_around(FusedOptions.separation)
    steps = np.stack(np.meshgrid(along, along, turn), axis=-1).reshape(-1, 3)
    return np.asarray(steps[np.hypot(steps[:, 0], steps[:, 1]) <= far[0] * (1 + 1e-9)])
