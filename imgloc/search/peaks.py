"""Peaks of a stack (theta, y, x), with theta circular, and the modes of a posterior."""

from collections.abc import Iterator

import cv2
import numpy as np

from imgloc.geometry import wrap
from imgloc.model import Float32Array, FloatArray, IntArray
from imgloc.search.hypotheses import separated

_FEW = 4096  # peaks that are sorted at a time


def find_peaks(values: Float32Array, n: int, *, radius: int = 1) -> IntArray:
    """Find the `n` greatest local maxima above 0 of a stack (K, H, W).

    The result (M, 3) has their indices ``(theta, row, col)``, the greatest first.

    Parameters
    ----------
    radius : int
        A peak is the largest value in a window of ``2 radius + 1`` cells and headings on each axis.
        Theta wraps around. The first of equal neighbours, in index order, is the peak.

    Examples
    --------
    >>> stack = np.zeros((4, 1, 5), dtype=np.float32)
    >>> stack[0, 0, 1], stack[3, 0, 1], stack[2, 0, 4] = 3, 5, 2
    >>> find_peaks(stack, 9).tolist()
    [[3, 0, 1], [2, 0, 4]]
    """
    cells = _local_maxima(values, radius)
    kept = np.empty((0, 3), np.int64)
    for some in _falling(values.ravel()[cells]):
        for cell in np.stack(np.unravel_index(cells[some], values.shape), axis=1):
            if len(kept) == n:
                return kept
            # A plateau keeps only its first cell.
            gap = np.abs(kept - cell)
            gap[:, 0] = np.minimum(gap[:, 0], len(values) - gap[:, 0])
            if not (gap <= radius).all(axis=1).any():
                kept = np.vstack((kept, cell))
    return kept


def _local_maxima(values: Float32Array, radius: int) -> IntArray:
    """Flat indices, in order, of the positive values that are the largest in their window.

    The headings of a window are held in a ring, so that they are dilated once and stay in the
    cache.
    """
    n, height, width = values.shape
    kernel = np.ones((2 * radius + 1, 2 * radius + 1), dtype=np.uint8)
    reach = min(radius, n - 1)
    ring = np.empty((2 * reach + 1, height, width), dtype=np.float32)
    top = np.empty((height, width), dtype=np.float32)

    found = []
    for k in range(-2 * reach, n):
        cv2.dilate(values[(k + reach) % n], kernel, dst=ring[k % len(ring)])
        if k >= 0:
            image = values[k]
            np.max(ring, axis=0, out=top)
            found.append(np.flatnonzero((image == top) & (image > 0)) + k * top.size)
    return np.concatenate(found)


def _falling(scores: Float32Array) -> Iterator[IntArray]:
    """Indices by falling score, equal ones in their order, a few at a time.

    A stack without information is one plateau: millions of peaks that need not be sorted.
    """
    rest = np.arange(len(scores))
    if len(scores) > _FEW:
        level = np.partition(scores, -_FEW)[-_FEW]
        better, equal = np.flatnonzero(scores > level), np.flatnonzero(scores == level)
        yield better[np.argsort(-scores[better], kind="stable")]
        for start in range(0, len(equal), _FEW):
            yield equal[start : start + _FEW]
        rest = np.flatnonzero(scores < level)
    yield rest[np.argsort(-scores[rest], kind="stable")]


def peaks_of_posterior(
    probability: Float32Array,
    thetas: FloatArray,
    resolution: float,
    *,
    n: int,
    separation: tuple[float, float],
) -> tuple[FloatArray, FloatArray, FloatArray, IntArray]:
    """Find the modes of a posterior: its peaks, each joined with the peaks beside it.

    Parameters
    ----------
    probability : (K, H, W) float32 array
        Sums to 1.
    thetas : (K,) float array
        Uniform headings, radians.
    resolution : float
        Side of a cell, metres.
    n : int
        Number of peaks to look for, at most.
    separation : (float, float)
        Peaks nearer than this, metres and radians, belong to one mode.

    Returns
    -------
    poses : (M, 3), mass : (M,), covariance : (M, 3, 3) float arrays
        Grid frame: metres and radians, the mode of the highest peak first.
    peaks : (M, 3) int array
        Cell ``(theta, row, col)`` of the highest peak of each mode.
    """
    peaks = find_peaks(probability, n, radius=2)
    poses, mass, covariance = peak_moments(probability, peaks, thetas, resolution)
    distance, angle = separation
    best, of = separated(poses, len(poses), distance=distance, angle=angle)
    # The mass and covariance of a mode include the peaks that belong to it.
    owner = best[of]
    offset = poses - poses[owner]
    offset[:, 2] = wrap(offset[:, 2])
    second = covariance + offset[:, :, None] * offset[:, None, :]
    total, joined = np.zeros_like(mass), np.zeros_like(covariance)
    np.add.at(total, owner, mass)
    np.add.at(joined, owner, (mass / total[owner])[:, None, None] * second)
    return poses[best], total[best], joined[best], peaks[best]


def peak_moments(
    probability: Float32Array,
    peaks: IntArray,
    thetas: FloatArray,
    resolution: float,
    *,
    radius: int = 2,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Mean, mass and covariance of the posterior around each peak.

    Parameters
    ----------
    probability : (K, H, W) float32 array
        Sums to 1.
    thetas : (K,) float array
        Uniform headings, radians.
    resolution : float
        Side of a cell, metres.
    peaks : (M, 3) int array
        Cells ``(theta, row, col)``, best first. A cell in the windows of two peaks counts for the
        first one.
    radius : int
        Number of cells and headings that the window reaches to every side.

    Returns
    -------
    poses : (M, 3), mass : (M,), covariance : (M, 3, 3) float arrays
        Grid frame, metres and radians. The pose is the mean over the window, theta on the circle.
        The covariance includes the variance of a uniform draw within a cell, so it is never zero.
    """
    n, height, width = probability.shape
    step = 2 * np.pi / n
    taken, reach = np.zeros(probability.shape, dtype=bool), min(radius, (n - 1) // 2)
    floor = np.diag(np.square([resolution, resolution, step]) / 12)
    poses, mass, covariance = [], [], []
    for k, r, c in peaks.tolist():
        ks = np.arange(k - reach, k + reach + 1)
        rows = np.arange(max(0, r - radius), min(height, r + radius + 1))
        columns = np.arange(max(0, c - radius), min(width, c + radius + 1))
        window = np.ix_(ks % n, rows, columns)
        w = np.where(taken[window], 0, probability[window]).astype(np.float64).ravel()
        taken[window] = True
        total = w.sum()
        w = w / total if total > 0 else np.full(w.size, 1 / w.size)
        dk, y, x = (g.ravel() for g in np.meshgrid(ks - k, rows, columns, indexing="ij"))
        offset = np.column_stack(((x - c) * resolution, (y - r) * resolution, dk * step))
        mean = w @ offset
        centred = offset - mean
        centre = ((c + 0.5) * resolution, (r + 0.5) * resolution, thetas[k])
        poses.append(mean + centre)
        mass.append(total)
        covariance.append((centred * w[:, None]).T @ centred + floor)
    out = np.asarray(poses, dtype=np.float64).reshape(-1, 3)
    out[:, 2] = wrap(out[:, 2])
    return out, np.asarray(mass, dtype=np.float64), np.asarray(covariance).reshape(-1, 3, 3)
