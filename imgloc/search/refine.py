"""Move poses to where their endpoints meet the walls, all poses at once."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from imgloc.features.distance import DistanceField
from imgloc.geometry import wrap
from imgloc.model import Float32Array, FloatArray
from imgloc.numbers import number

WIDTHS: tuple[float, ...] = number("refine.widths")
"""Widths of the kernel that takes poses to where they fit: metres."""
_WIDE, _MIDDLE, _FINE = WIDTHS
FIRST_LOOK, SECOND_LOOK = (_WIDE, _MIDDLE), (_MIDDLE, _FINE)
FROM_CELLS: tuple[float, ...] = number("refine.from_cells")
"""The same for a pose from afar, as from the centre of a cell: metres."""
MAX_STEP = np.array(number("refine.step"))
"""Most that a pose and a scale move in one step: metres, metres, radians, share."""
DAMPING: float = number("refine.damping")
"""Weight for each reading that keeps a pose where a corridor leaves it free."""
# m²: weight that holds a scale near 1: the square of 0.1 m over 10 %
_SCALE = number("refine.scale")
_OFF_EVERY_MAP = 1e6  # metres; float32 can still square it
AnyFloat = FloatArray | Float32Array


def refine(
    poses: FloatArray,
    xy: FloatArray,
    field: DistanceField,
    *,
    sigmas: Sequence[float],
    iterations: int = 2,
) -> FloatArray:
    """Move poses to where their endpoints meet the walls, by Gauss-Newton with a shrinking kernel.

    The residual is the signed distance of each endpoint from the nearest surface.

    Parameters
    ----------
    poses : (C, 3) or (C, 4) float array
        Grid frame: metres, metres, radians. A fourth column is a scale of the readings, a factor
        that is refined, too.
    xy : (N, 2) float array
        Scan points, sensor frame, metres.
    field : DistanceField
        Distance to the surfaces, metres. It is signed, so that a pose settles on the surface itself
        and not on cell centres.
    sigmas : sequence of float
        Widths of the robust (Geman-McClure) kernel, metres, in the order of their use. Endpoints
        much farther than that from a wall have no weight.
    iterations : int
        Steps for each width. A step moves a pose by at most 0.1 m, 2 degrees and 2 % of scale.
    """
    poses = np.array(poses, dtype=np.float64)
    for sigma in sigmas if len(poses) and len(xy) else ():
        for _ in range(iterations):
            (A,), (b,), _ = normal_equations(poses, xy, field, sigma)
            # A corridor leaves one direction free: a little damping keeps the pose where it is.
            A[:, range(3), range(3)] += DAMPING * len(xy)
            A[:, 3:, 3:] += _SCALE
            b[:, 3:] += _SCALE * (poses[:, 3:] - 1)
            step, most = np.linalg.solve(A, b[..., None])[..., 0], MAX_STEP[: poses.shape[1]]
            poses -= np.clip(step, -most, most)
    poses[:, 2] = wrap(poses[:, 2])
    return poses


def normal_equations(
    poses: FloatArray, xy: FloatArray, field: DistanceField, sigma: float, blocks: int = 1
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Weighted ``J^T J`` (G, C, 3, 3) and ``J^T e`` (G, C, 3) of the endpoint distances e.

    G is the smaller of `blocks` and the number of readings: each block has neighbouring readings.
    Poses with a scale give (G, C, 4, 4) and (G, C, 4). The third result (C,) is the weighted mean
    of ``e^2`` over all readings, m²: it is small where the scan fits well.
    """
    return block_sums(*residuals(poses, xy, field), 1, sigma, blocks)


def residuals(
    poses: FloatArray, xy: FloatArray, field: DistanceField
) -> tuple[Float32Array, Float32Array]:
    """Derivatives (C, 3, N), or (C, 4, N) with a scale, of the endpoint distances (C, N), metres.

    The arguments are those of :func:`normal_equations`.
    """
    dx, dy, distance, gx, gy = endpoints(poses, xy, field)
    by = [gx, gy, dx * gy - dy * gx]
    if poses.shape[1] == 4:
        by.append((dx * gx + dy * gy) / poses[:, 3:].astype(np.float32))
    return np.stack(by, axis=1), distance


def kernel(residual: AnyFloat, sigma: float) -> AnyFloat:
    """Weight of each residual, metres, by a Geman-McClure kernel of width `sigma`, metres."""
    return 1 / np.square(1 + np.square(residual) / np.float32(sigma * sigma))


def block_sums(
    J: AnyFloat, residual: AnyFloat, usable: AnyFloat | int, sigma: float, blocks: int = 1
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Weighted ``J^T J`` (G, C, D, D) and ``J^T e`` (G, C, D) of residuals e.

    `J` (C, D, N) has the derivatives of each `residual` (C, N), metres. A Geman-McClure kernel of
    width `sigma`, metres, weighs them, times `usable` (C, N). The rest is as in
    :func:`normal_equations`.
    """
    weight = usable * kernel(residual, sigma)
    # The residual as one more derivative: one product of matrices gives all sums.
    D, n = J.shape[1:]
    both: npt.NDArray[Any] = np.concatenate((J, residual[:, None]), axis=1)
    weighted = both[:, :D] * weight[:, None]
    ends = np.linspace(0, n, min(blocks, n) + 1).round().astype(int)
    parts = [np.s_[..., a:b] for a, b in pairwise(ends)]
    sums = np.stack([weighted[part] @ both[part].transpose(0, 2, 1) for part in parts])
    sums = sums.astype(np.float64)
    least = np.finfo(np.float32).tiny  # no reading may be usable
    mean = (weight * np.square(residual)).sum(axis=1) / np.maximum(weight.sum(axis=1), least)
    return sums[..., :D], sums[..., D], mean.astype(np.float64)


def endpoints(
    poses: FloatArray, xy: FloatArray, field: DistanceField
) -> tuple[Float32Array, Float32Array, Float32Array, Float32Array, Float32Array]:
    """Turn the points, and look up distance and gradient at them: (C, N) float32 arrays.

    The results are dx and dy of ``R_theta p``, the distance d, and its gradient gx and gy, all in
    metres and in the grid frame. Poses (C, 4) have a scale s: dx and dy are then ``s R_theta p``.
    """
    p = np.clip(xy, -_OFF_EVERY_MAP, _OFF_EVERY_MAP).astype(np.float32)
    x, y, theta, *scale = (v[:, None] for v in np.asarray(poses, dtype=np.float64).T)
    size = scale[0] if scale else 1.0
    c, s = (size * np.cos(theta)).astype(np.float32), (size * np.sin(theta)).astype(np.float32)
    dx, dy = c * p[:, 0] - s * p[:, 1], s * p[:, 0] + c * p[:, 1]
    return dx, dy, *field.lookup(x.astype(np.float32) + dx, y.astype(np.float32) + dy)
