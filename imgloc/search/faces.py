"""Where in the cells of a wall its face is: poses that do not lean toward what the sensor sees.

The distance to the nearest border of a wall is the same on both its sides: readings that noise
takes into a thin wall cost nothing, and those that end before it draw the pose forward. Here each
reading belongs to the side that its ray meets first, and its distance from there has a sign.

A drawn or simulated wall has its face at that border. A wall that was mapped by scans is a band
that their noise has blurred: the face is within it. A reading that meets it head-on then ends by
one more or less constant *depth* behind the border, a slanting one by the cosine of that. The depth
is refined with the pose, because walls on both sides of a sensor part the two. Where they do
not, the depth is as uncertain as before, and so is the pose along the view.
"""

from dataclasses import dataclass

import numpy as np

from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.raycast import cast_rays
from imgloc.features.scanpoints import Readings
from imgloc.geometry import wrap
from imgloc.model import FloatArray
from imgloc.numbers import number
from imgloc.options import DEEPEST, Shared
from imgloc.search.covariance import LEAST, sharing
from imgloc.search.refine import DAMPING, MAX_STEP, block_sums

# Mean and standard deviation of the depth on a map of which nothing is known, and the standard
# deviation of a depth that was fitted.
_DEPTH, _KNOWN = number("faces.depth"), number("faces.known")
_GRAZING = number("faces.grazing")  # cosine below which a reading says nothing of a face
_WIDTHS = number("faces.widths")  # of the robust kernel, metres
_SMOOTH = number("faces.smooth")  # slope of the field below which its direction is of no wall


def depth_of(shared: Shared, features: MapFeatures) -> tuple[float, float]:
    """Mean and standard deviation, metres, of how deep in the walls of a map their faces are.

    Walls with straight borders were drawn: their faces are the borders, unless they are thicker
    than the real ones.
    """
    mean = 0.0 if features.straight else _DEPTH[0]
    return (mean, _DEPTH[1]) if shared.depth is None else (shared.depth, _KNOWN)


def any_depth() -> tuple[float, float]:
    """Mean and standard deviation, metres, of a depth that a scan is to determine on its own."""
    return _DEPTH[0], DEEPEST


@dataclass(frozen=True, eq=False)
class Faces:
    """The faces that N readings meet from C poses: straight lines, (C, N) each."""

    before: FloatArray  #: metres that a reading ends before the border of its wall
    J: FloatArray  #: (C, 3, N) derivatives of `before` by x, y and theta
    facing: FloatArray  #: cosine between the ray and the wall's normal, 0..1
    middle: FloatArray  #: metres from the border of the wall to its middle
    usable: FloatArray  #: 1 where a reading meets a face that is known and not grazed, else 0

    def residuals(self, moved: FloatArray, depth: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Derivatives (C, 4, N) and distances (C, N), metres, from faces `depth` (C,) in the walls.

        The poses have `moved` (C, 3) since, metres and radians. The last derivative is by the
        depth. No face is behind the middle of its wall, which thin walls thus approach.
        """
        share = np.tanh(depth[:, None] * self.facing / self.middle)
        by_depth = (1 - share * share) * self.facing
        J = np.concatenate((self.J, by_depth[:, None]), axis=1)
        now = self.before + (moved[:, None] @ self.J)[:, 0]
        return J, now + self.middle * share


def faces_met(poses: FloatArray, readings: Readings, features: MapFeatures) -> Faces:
    """Find the face that each reading meets, from poses (C, 3) in the grid frame."""
    field, cell = features.field, features.grid.resolution
    x, y, theta = (v[:, None] for v in poses.T)
    rho, psi = readings.ranges, theta + readings.angles
    ux, uy = np.cos(psi), np.sin(psi)
    hit = cast_rays(features.walls, poses[:, None, :2], psi, rho + 4 * max(_WIDTHS), cell)
    met = np.isfinite(hit)
    hit = np.where(met, hit, rho)
    # The normal is that of the field one cell before the wall: it is smooth on this side, and in a
    # wall of one cell it has no slope at all.
    held = np.maximum(hit - cell, 0)
    distance, gx, gy = field.lookup(x + held * ux, y + held * uy)
    slope = np.hypot(gx, gy)
    smooth = slope > _SMOOTH
    nx, ny = (np.where(smooth, g / np.maximum(slope, _SMOOTH), 0.0) for g in (gx, gy))
    facing = -(nx * ux + ny * uy)
    before = (hit - rho) * facing + field.recess
    # How thick the wall is, from its border inward. Fine maps take no more than 20 steps.
    step = max(cell / 2, DEEPEST / 10)
    inward = (np.arange(np.ceil(2 * DEEPEST / step)) + 0.5)[:, None, None] * step + distance
    wall = field.lookup(x + held * ux - inward * nx, y + held * uy - inward * ny)[0] < 0
    thick = np.logical_and.accumulate(wall, axis=0).sum(axis=0) * step
    J = np.stack((nx, ny, rho * (ux * ny - uy * nx)), axis=1)
    usable = met & smooth & (facing > _GRAZING)
    return Faces(
        before, J, np.clip(facing, 0, 1), np.maximum(thick, step) / 2, usable.astype(np.float64)
    )


@dataclass(frozen=True, eq=False)
class Settled:
    """C poses that stand on the faces of the walls, and the equations of N readings there."""

    poses: FloatArray  #: (C, 3) grid frame: metres, metres, radians
    depth: FloatArray  #: (C,) metres
    J: FloatArray  #: (C, 4, N) derivatives of the residuals by the pose and the depth
    residual: FloatArray  #: (C, N) metres
    usable: FloatArray  #: (C, N) 1 where a reading counts, else 0


def on_faces(
    poses: FloatArray, readings: Readings, features: MapFeatures, depth: tuple[float, float]
) -> Settled:
    """Move poses (C, 3), grid frame, to where the readings end on the faces of the walls.

    The depth of the faces is found with each pose. `depth` has its mean and standard deviation
    before, metres, from :func:`depth_of`.
    """
    mean, deviation = depth
    deep = np.full(len(poses), mean)
    met, moved = faces_met(poses, readings, features), np.zeros_like(poses)
    least = LEAST * features.grid.resolution
    for width in _WIDTHS:
        J, residual = met.residuals(moved, deep)
        (A,), (b,), square = block_sums(J, residual, met.usable, width)
        A[:, range(3), range(3)] += DAMPING * len(readings)
        strength = sharing(residual, met.usable, width, readings) * np.maximum(square, least**2)
        strength /= deviation**2
        A[:, 3, 3] += strength
        b[:, 3] += strength * (deep - mean)
        step = np.linalg.solve(A, b[..., None])[..., 0]
        moved -= np.clip(step[:, :3], -MAX_STEP[:3], MAX_STEP[:3])
        deep = np.clip(deep - step[:, 3], -DEEPEST, DEEPEST)
    poses = poses + moved
    poses[:, 2] = wrap(poses[:, 2])
    return Settled(poses, deep, *met.residuals(moved, deep), met.usable)
