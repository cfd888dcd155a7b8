"""The score that decides: endpoint evidence under the paper's visibility constraint.

Does a reading end on a surface? Distance to the nearest one answers, which forgives half-cells,
grazing angles and thick walls, as ray-traced ranges do not. And did it get there? If it passes
through a mapped wall it contradicts the map (Sec. V), unless the wall has gone since: a door. ::

    p(rho | x) = o * (h mean_s N(d; 0, sigma_s) + (1 - h) / span)

with d that distance, h the share of readings that come from mapped surfaces, and o = 1, or,
beyond a wall, the chance that it is drawn in a wrong place by as much, or gone. What is left of
eq. 2 is that too short a reading is no surprise and too long a one is. A sharp and a wide sigma
make the score sharp where map and scan agree, and forgiving where the map is old.
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
    """What :func:`rescore` found for C poses and N readings."""

    log_likelihood: FloatArray  #: (C,) Nats
    #: (C, N) Readings that end within two standard deviations, of the wider sigma, of a surface
    on_surface: BoolArray
    #: (C, N) Readings that pass through a mapped wall: more likely than not it is gone
    crossed: BoolArray

    def select(self, index: IntArray) -> "Scores":
        """The scores of the poses at `index`."""
        return Scores(self.log_likelihood[index], self.on_surface[index], self.crossed[index])

    @property
    def explained(self) -> FloatArray:
        """(C,) share of readings that end on a surface and cross no wall."""
        return np.asarray((self.on_surface & ~self.crossed).mean(axis=1))


def rescore(
    poses: FloatArray,
    ranges: FloatArray,
    angles: FloatArray,
    field: DistanceField,
    walls: Float32Array,
    model: EvidenceModel,
) -> Scores:
    """Evaluate the score of the module's head for some poses.

    Parameters
    ----------
    poses : (C, 3) or (C, 4) float array
        Grid frame; with a scale of the readings.
    ranges, angles : (N,) float arrays
        Valid readings only.
    field, walls : DistanceField, (H, W) float32 array
        Signed distance to the surfaces; :func:`~imgloc.features.raycast.distance_image` of the
        occupied cells, in cells.
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
    """Scores of poses (C, 3), or with a scale (C, 4), grid frame, by some readings of a scan."""
    ranges, angles, model = readings.ranges, readings.angles, options.fused.model
    return rescore(poses, ranges, angles, features.field, features.walls, model)


def _endpoint_density(
    poses: FloatArray,
    ranges: FloatArray,
    angles: FloatArray,
    field: DistanceField,
    model: EvidenceModel,
) -> tuple[Float32Array, Float32Array]:
    """Density of each reading by where it ends alone, and its distance from a surface, (C, N)."""
    xy = np.column_stack((ranges * np.cos(angles), ranges * np.sin(angles)))
    distance = endpoints(poses, xy, field)[2]
    return hit_density(distance, model), distance


def hit_density(distance: Float32Array, model: EvidenceModel) -> Float32Array:
    """Density of readings that end so far from a surface, metres, of any shape: 1 / metres."""
    density = np.full(distance.shape, (1 - model.hit) / model.span, dtype=np.float32)
    for sigma in model.sigmas:
        peak = model.hit / (len(model.sigmas) * sigma * np.sqrt(2 * np.pi))
        density += np.float32(peak) * np.exp(distance * distance * np.float32(-0.5 / sigma**2))
    return density


def shortlist(
    poses: FloatArray, readings: Readings, features: MapFeatures, options: FusedOptions
) -> tuple[FloatArray, FloatArray]:
    """The best places with a few rays, and the best poses: those that get the second look.

    And their scores, the best one first. Of poses that have met, that stands for all whose readings
    end best.
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
