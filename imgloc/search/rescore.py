"""The score that decides: endpoint evidence under the paper's visibility constraint.

A reading should end on a surface. The distance to the nearest surface measures that, and forgives
half-cells, grazing angles and thick walls, as ray-traced ranges do not. A reading that passes
through a mapped wall contradicts the map (Sec. V), unless the wall has gone, as an open door. ::

    p(rho | x) = o * (h mean_s N(d; 0, sigma_s) + (1 - h) / span)

where d is that distance and h the share of readings that come from mapped surfaces. The factor o is
1 before a wall. Beyond it o is the chance that the wall has gone, or is drawn that far from its
true place. As in eq. 2, too short a reading is no surprise, and too long a reading is one. A sharp
and a wide sigma make the score sharp where map and scan agree, and forgiving where the map is old.
"""

from dataclasses import dataclass

import numpy as np

from imgloc.features.distance import DistanceField
from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.raycast import cast_rays
from imgloc.features.scanpoints import Readings
from imgloc.model import BoolArray, Float32Array, FloatArray, IntArray
from imgloc.options import EvidenceModel, FusedOptions, Options
from imgloc.search.hypotheses import first_in_cell, modes
from imgloc.search.refine import endpoints


@dataclass(frozen=True)
class Scores:
    """Scores of C poses by N readings, from :func:`rescore`."""

    log_likelihood: FloatArray  #: (C,) nats
    #: (C, N) whether a reading ends nearer to a surface than twice the wider sigma
    on_surface: BoolArray
    #: (C, N) whether a reading passes through a mapped wall, which more likely than not is gone
    crossed: BoolArray

    def select(self, index: IntArray) -> "Scores":
        """The scores of the poses at `index`."""
        return Scores(self.log_likelihood[index], self.on_surface[index], self.crossed[index])

    @property
    def explained(self) -> FloatArray:
        """Share of the readings, 0..1, that end on a surface and cross no wall, (C,)."""
        return np.asarray((self.on_surface & ~self.crossed).mean(axis=1))


def rescore(
    poses: FloatArray,
    ranges: FloatArray,
    angles: FloatArray,
    field: DistanceField,
    walls: Float32Array,
    model: EvidenceModel,
) -> Scores:
    """Score poses by endpoint evidence, with a penalty for readings that pass through a wall.

    Parameters
    ----------
    poses : (C, 3) or (C, 4) float array
        Grid frame: metres, metres, radians. A fourth column is a scale of the readings, a factor.
    ranges, angles : (N,) float arrays
        Valid readings only: metres, and radians in the sensor frame.
    field : DistanceField
        Signed distance to the surfaces, metres.
    walls : (H, W) float32 array
        Distance to the occupied cells, in cells, from
        :func:`~imgloc.features.raycast.distance_image`.
    """
    density, distance = _endpoint_density(poses, ranges, angles, field, model)
    margin = model.margin + field.resolution / 2
    if poses.shape[1] == 4:
        ranges = ranges * poses[:, 3:]
    reach = np.maximum(ranges - margin, 1e-3)
    psi = poses[:, 2:3] + angles
    seen = cast_rays(walls, poses[:, None, :2], psi, reach, field.resolution)
    beyond = np.maximum(ranges - seen - margin, 0).astype(np.float32)  # 0 where nothing is met
    shifted = np.exp(-np.square(beyond / np.float32(model.displaced)))
    density *= np.float32(model.absent) + np.float32(1 - model.absent) * shifted
    log_likelihood = np.log(density).sum(axis=1, dtype=np.float64)
    on_surface = np.abs(distance) < 2 * max(model.sigmas)
    return Scores(log_likelihood, on_surface, shifted < model.absent)


def score_poses(
    features: MapFeatures, readings: Readings, poses: FloatArray, options: Options
) -> Scores:
    """Score poses in the grid frame, (C, 3) or with a scale (C, 4), by readings of a scan."""
    ranges, angles, model = readings.ranges, readings.angles, options.fused.model
    return rescore(poses, ranges, angles, features.field, features.walls, model)


def _endpoint_density(
    poses: FloatArray,
    ranges: FloatArray,
    angles: FloatArray,
    field: DistanceField,
    model: EvidenceModel,
) -> tuple[Float32Array, Float32Array]:
    """Density of each reading by its endpoint alone, 1 / metres, and distance in metres: (C, N)."""
    xy = np.column_stack((ranges * np.cos(angles), ranges * np.sin(angles)))
    distance = endpoints(poses, xy, field)[2]
    return hit_density(distance, model), distance


def hit_density(distance: Float32Array, model: EvidenceModel) -> Float32Array:
    """Density of readings by the distance of their endpoints from a surface.

    `distance` is in metres and has any shape. The densities have the same shape and 1 / metres.
    """
    density = np.full(distance.shape, (1 - model.hit) / model.span, dtype=np.float32)
    for sigma in model.sigmas:
        peak = model.hit / (len(model.sigmas) * sigma * np.sqrt(2 * np.pi))
        density += np.float32(peak) * np.exp(distance * distance * np.float32(-0.5 / sigma**2))
    return density


def shortlist(
    poses: FloatArray, readings: Readings, features: MapFeatures, options: FusedOptions
) -> tuple[FloatArray, FloatArray]:
    """Choose the poses that get the second look, by a score with few readings.

    `poses` (C, 3) are in the grid frame. The result has the best places, and the best poses even if
    they share a place: (L, 3), the best places first, and their scores (L,) in nats. If refinement
    has brought poses together, the one whose readings end nearest to walls stands for all.
    """
    ranges, angles, field, model = readings.ranges, readings.angles, features.field, options.model
    density = _endpoint_density(poses, ranges, angles, field, model)[0]
    ends = np.log(density).sum(axis=1, dtype=np.float64)
    order = np.argsort(-ends, kind="stable")
    poses = poses[np.sort(order[first_in_cell(poses[order], *options.same)])]
    score = rescore(poses, ranges, angles, field, features.walls, model).log_likelihood
    best, close = (
        modes(poses, score, distance=distance, angle=angle, most=most)
        for (distance, angle), most in (
            (options.twins, options.second_look), (options.same, options.closer)
        )
    )  # fmt: skip
    both = np.concatenate((best, np.setdiff1d(close, best)))
    return poses[both], score[both]
