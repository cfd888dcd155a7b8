"""The score that decides: endpoint evidence under the paper's visibility constraint.

For each reading the model asks two questions of the map. Does it end on a surface? Distance to
the nearest surface answers, which forgives half-cells, grazing angles and thick walls, as
ray-traced ranges do not. And did it get there? A reading that passes through a mapped wall
contradicts the map (Sec. V), unless the wall has gone since: a door. ::

    p(rho | x) = o * (h mean_s N(d; 0, sigma_s) + (1 - h) / span)

with d the distance of the endpoint from the nearest surface, h the share of readings that
come from mapped surfaces, and o = 1, or, for a reading that goes beyond a wall, the chance that
the wall is drawn in a wrong place by as much, or is not there at all any more. What is left of
eq. 2 is that too short a reading is no surprise and too long a one is. The hit has a sharp and
a wide sigma: the score is sharp where map and scan agree, and forgiving where the map is old.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imgloc.features.distance import DistanceField
from imgloc.features.raycast import cast_rays
from imgloc.model import BoolArray, Float32Array, FloatArray, IntArray
from imgloc.search.refine import endpoints


@dataclass(frozen=True)
class EvidenceModel:
    """The parameters of the score.

    Parameters
    ----------
    sigmas : sequence of float
        Standard deviations of an endpoint's distance from its surface, metres, equally
        probable for every reading.
    hit : float
        Share of the readings that come from mapped surfaces.
    span : float
        Metres over which the readings that do not come from the map are spread.
    absent : float
        Probability that a mapped wall is not there any more.
    margin : float
        Metres by which a reading may pass a wall at no cost, besides half a cell.
    displaced : float
        How far beyond that a wall may be drawn in a wrong place, metres: the chance falls
        like a Gaussian of this scale, down to `absent`.
    """

    sigmas: Sequence[float] = (0.05, 0.2)
    hit: float = 0.8
    span: float = 10.0
    absent: float = 0.1
    margin: float = 0.1
    displaced: float = 0.1

    @property
    def best(self) -> float:
        """Log-density of a reading that ends on a surface exactly, nats."""
        peak = self.hit * np.mean(1 / (np.sqrt(2 * np.pi) * np.asarray(self.sigmas)))
        return float(np.log(peak + (1 - self.hit) / self.span))


@dataclass(frozen=True)
class Evidence:
    """What :func:`rescore` found for C poses and N readings.

    Parameters
    ----------
    log_likelihood : (C,) float array
        Nats.
    on_surface : (C, N) bool array
        Readings that end within two standard deviations, of the wider sigma, of a surface.
    crossed : (C, N) bool array
        Readings that pass through a mapped wall: more likely than not it is gone.
    """

    log_likelihood: FloatArray
    on_surface: BoolArray
    crossed: BoolArray

    def select(self, index: IntArray) -> "Evidence":
        """The evidence of the poses at `index`."""
        return Evidence(self.log_likelihood[index], self.on_surface[index], self.crossed[index])

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
) -> Evidence:
    """Evaluate the score of the module's head for some poses.

    Parameters
    ----------
    poses : (C, 3) float array
        Grid frame.
    ranges, angles : (N,) float arrays
        Valid readings only.
    field : DistanceField
        Signed distance to the surfaces.
    walls : (H, W) float32 array
        :func:`~imgloc.features.raycast.distance_image` of the occupied cells, in cells.
    model : EvidenceModel
    """
    density, distance = _endpoint_density(poses, ranges, angles, field, model)
    margin = model.margin + field.resolution / 2
    seen = cast_rays(
        walls,
        poses[:, None, :2],
        poses[:, 2:] + angles,
        np.maximum(ranges - margin, 1e-3),
        field.resolution,
    )
    beyond = np.maximum(ranges - seen - margin, 0).astype(np.float32)  # 0 where nothing is met
    shifted = np.exp(-np.square(beyond / np.float32(model.displaced)))
    density *= np.float32(model.absent) + np.float32(1 - model.absent) * shifted
    log_likelihood = np.log(density).sum(axis=1, dtype=np.float64)
    on_surface = np.abs(distance) < 2 * max(model.sigmas)
    return Evidence(log_likelihood, on_surface, shifted < model.absent)


def bound(
    poses: FloatArray,
    ranges: FloatArray,
    angles: FloatArray,
    field: DistanceField,
    model: EvidenceModel,
) -> FloatArray:
    """What :func:`rescore` cannot exceed, (C,) nats: the visibility constraint only takes away.

    Parameters
    ----------
    poses, ranges, angles, field, model
        As of :func:`rescore`.
    """
    density, _ = _endpoint_density(poses, ranges, angles, field, model)
    return np.asarray(np.log(density).sum(axis=1, dtype=np.float64))


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
    density = np.full(distance.shape, (1 - model.hit) / model.span, dtype=np.float32)
    for sigma in model.sigmas:
        peak = model.hit / (len(model.sigmas) * sigma * np.sqrt(2 * np.pi))
        density += np.float32(peak) * np.exp(distance * distance * np.float32(-0.5 / sigma**2))
    return density, distance
