"""Move poses to where their endpoints meet the walls, all poses at once."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from imgloc.features.distance import DistanceField
from imgloc.geometry import wrap
from imgloc.model import Float32Array, FloatArray
from imgloc.numbers import number

_MAX_STEP = np.array(number("refine.step"))
_DAMPING = number("refine.damping")
# m²: what holds a scale near 1, square of an error of 0.1 m over one of 10 %
_SCALE = number("refine.scale")
_OFF_EVERY_MAP = 1e6  # metres; what float32 still squares


def refine(
    poses: FloatArray,
    xy: FloatArray,
    field: DistanceField,
    *,
    sigmas: Sequence[float],
    iterations: int = 2,
) -> FloatArray:
    """Gauss-Newton on the signed distance of the endpoints, with a shrinking kernel.

    Parameters
    ----------
    poses : (C, 3) or (C, 4) float array
        Grid frame: metres, metres, radians; and the scale of the readings, if that is free.
    xy : (N, 2) float array
        Scan points, sensor frame, metres.
    field : DistanceField
        Signed, so that a pose settles on the surface itself and not on cell centres.
    sigmas : sequence of float
        Widths of the robust (Geman-McClure) kernel, metres, in the order in which to use
        them; endpoints much farther from a wall than that have no say.
    iterations : int
        Steps for each width; a pose moves at most 0.1 m, 2 degrees and 2 % a step.
    """
    poses = np.array(poses, dtype=np.float64)
    for sigma in sigmas if len(poses) and len(xy) else ():
        for _ in range(iterations):
            (A,), (b,), _ = normal_equations(poses, xy, field, sigma)
            # A corridor leaves one direction free: a little damping keeps the pose where it is.
            A[:, range(3), range(3)] += _DAMPING * len(xy)
            A[:, 3:, 3:] += _SCALE
            b[:, 3:] += _SCALE * (poses[:, 3:] - 1)
            step, most = np.linalg.solve(A, b[..., None])[..., 0], _MAX_STEP[: poses.shape[1]]
            poses -= np.clip(step, -most, most)
    poses[:, 2] = wrap(poses[:, 2])
    return poses


def normal_equations(
    poses: FloatArray, xy: FloatArray, field: DistanceField, sigma: float, blocks: int = 1
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Weighted ``J^T J`` (G, C, 3, 3) and ``J^T e`` (G, C, 3) of the endpoint distances e.

    Of each of `blocks` of neighbouring readings, or of as many as there are readings; with a scale
    they are (G, C, 4, 4) and (G, C, 4). The third result, (C,), is the weighted mean of ``e^2``
    over all, m²: how well the scan fits.
    """
    dx, dy, distance, gx, gy = endpoints(poses, xy, field)
    weight = 1 / np.square(1 + np.square(distance / np.float32(sigma)))
    by = [gx, gy, dx * gy - dy * gx]
    if poses.shape[1] == 4:
        by.append((dx * gx + dy * gy) / poses[:, 3:].astype(np.float32))
    J = np.stack(by, axis=1)
    weighted = J * weight[:, None]
    ends = np.linspace(0, len(xy), min(blocks, len(xy)) + 1).round().astype(int)
    parts = [np.s_[..., a:b] for a, b in pairwise(ends)]
    A = np.stack([weighted[part] @ J[part].transpose(0, 2, 1) for part in parts])
    b = np.stack([weighted[part] @ distance[part][..., None] for part in parts])
    square = (weight * np.square(distance)).sum(axis=1) / weight.sum(axis=1)
    return A.astype(np.float64), b[..., 0].astype(np.float64), square.astype(np.float64)


def endpoints(
    poses: FloatArray, xy: FloatArray, field: DistanceField
) -> tuple[Float32Array, Float32Array, Float32Array, Float32Array, Float32Array]:
    """Turned points ``R_theta p`` (dx, dy) and distance, gx, gy there, each (C, N) float32.

    Poses (C, 4) have a scale: ``s R_theta p``.
    """
    p = np.clip(xy, -_OFF_EVERY_MAP, _OFF_EVERY_MAP).astype(np.float32)
    x, y, theta, *scale = (v[:, None] for v in np.asarray(poses, dtype=np.float64).T)
    size = scale[0] if scale else 1.0
    c, s = (size * np.cos(theta)).astype(np.float32), (size * np.sin(theta)).astype(np.float32)
    dx, dy = c * p[:, 0] - s * p[:, 1], s * p[:, 0] + c * p[:, 1]
    return dx, dy, *field.lookup(x.astype(np.float32) + dx, y.astype(np.float32) + dy)
