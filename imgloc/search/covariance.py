"""The error that a refined pose may have, from how well and how firmly its scan fits.

Least squares gives the mean square of the remaining distances times the inverse of ``J^T J``. The
sensor's noise moves each reading by itself. The map's errors move neighbouring readings together:
the steps of a slanting wall, and what scans have blurred. How many share an error, the distances
show. The error of a whole wall moves more of them. A linearised jackknife therefore leaves out one
block of neighbouring readings after another, and adds the variance of the pose.
"""

import numpy as np

from imgloc.features.scanpoints import Readings
from imgloc.model import FloatArray
from imgloc.numbers import number
from imgloc.search.refine import AnyFloat, block_sums, kernel
from imgloc.search.rescore import pieces

BLOCKS: int = number("covariance.blocks")
"""Blocks of neighbouring readings, each of which the jackknife leaves out once."""
LEAST = number("covariance.least")
"""Smallest residual that counts, as a share of a cell."""
# Standard deviation of a pose because walls do not stand where they are drawn: metres at least, and
# as a share of a cell.
_WALLS, _OF_CELL = number("covariance.walls")


def covariances(
    J: AnyFloat,
    residual: AnyFloat,
    usable: AnyFloat | int,
    readings: Readings,
    *,
    sigma: float,
    cell: float,
    extent: tuple[float, ...],
) -> FloatArray:
    """Covariance (C, 3, 3) of refined poses, grid frame, from the distances of N readings.

    Parameters
    ----------
    J, residual, usable : float arrays
        Those of :func:`~imgloc.search.refine.block_sums`. The first three parameters are the pose.
        What else was refined with it, the scan may not have determined.
    readings : Readings
        The N readings.
    sigma : float
        Width of the robust kernel, metres.
    cell : float
        Side of a cell of the map, metres.
    extent : tuple of float
        Half-widths of a mode in x, y and theta, metres and radians. They limit the covariance along
        a corridor, where the scan does not determine the pose. Then the standard deviation of each
        further parameter before the scan.

    Returns
    -------
    (C, 3, 3) float array
        In m², m rad and rad²; positive definite.
    """
    blocks, b, square = block_sums(J, residual, usable, sigma, BLOCKS)
    A, jackknife = blocks.sum(axis=0), _jackknife(blocks, b, sigma, extent)
    variance = sharing(residual, usable, sigma, readings)
    variance *= np.maximum(square, np.square(LEAST * cell))
    information = A / variance[:, None, None]
    each = range(len(extent))
    information[:, each, each] += 1 / np.square(extent)
    out = (np.linalg.inv(information) + jackknife)[:, :3, :3]
    off = max(_WALLS, _OF_CELL * cell)
    lever = max(float(np.sqrt(np.square(readings.ranges).mean())) if len(readings) else 0.0, off)
    out[:, range(3), range(3)] += np.square([off, off, off / lever])
    deviation = np.sqrt(out[:, range(3), range(3)])
    shrink = np.minimum(1, np.array(extent[:3]) / deviation)
    out *= shrink[:, :, None] * shrink[:, None, :]
    return np.asarray((out + out.transpose(0, 2, 1)) / 2)


def sharing(
    residual: AnyFloat, usable: AnyFloat | int, sigma: float, readings: Readings
) -> FloatArray:
    """Number (C,) of neighbouring readings that share an error, as their residuals (C, N) show it.

    With a correlation r of neighbours on a piece of wall it is (1 + r) / (1 - r), as of an
    autoregression of first order: at least 1, and at most a block, as the jackknife sees longer
    errors. The arguments are those of :func:`covariances`.

    Examples
    --------
    >>> scan = Readings(np.full(48, 2.0), np.arange(48) / 200)
    >>> noise, steps = np.tile([1, -1.0], 24), np.repeat(np.tile([1, -1.0], 8), 3)
    >>> [round(float(sharing(e[None], 1, 9.0, scan)[0]), 1) for e in (noise, steps)]
    [1.0, 2.1]
    """
    order, parts, _ = pieces(readings.ranges, readings.angles)
    # Rows that lie in memory one after another are summed alike, however many there are.
    each = np.take(np.sqrt(usable * kernel(residual, sigma)) * residual, order, axis=1)
    inside = np.ones(len(order), np.bool_)  # of a piece, with the reading before
    inside[parts] = False
    before, after = each[:, :-1] * inside[1:], each[:, 1:] * inside[1:]
    square = (np.square(before) + np.square(after)).sum(axis=1) / 2
    r = (before * after).sum(axis=1) / np.maximum(square, np.finfo(np.float32).tiny)
    most = max(1.0, len(order) / BLOCKS)
    r = np.clip(r.astype(np.float64), 0, (most - 1) / (most + 1))
    return np.asarray((1 + r) / (1 - r))


def _jackknife(A: FloatArray, b: FloatArray, sigma: float, extent: tuple[float, ...]) -> FloatArray:
    """Covariance (C, D, D) of D parameters: each block of equations is left out once."""
    left = A.sum(axis=0) - A
    # A direction that one block alone determines moves no farther than the mode is long.
    each = range(len(extent))
    left[..., each, each] += np.square(sigma) / np.square(extent)
    moved = -np.linalg.solve(left, (b.sum(axis=0) - b)[..., None])[..., 0]
    moved -= moved.mean(axis=0)
    n = len(b)
    return np.asarray((n - 1) / n * np.einsum("gci,gcj->cij", moved, moved))
