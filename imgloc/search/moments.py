"""Peaks of a probability stack as poses with masses and covariances."""

import numpy as np

from imgloc.geometry import wrap
from imgloc.model import Float32Array, FloatArray, IntArray


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
    peaks : (M, 3) int array
        ``(theta, row, col)``, best first. A cell that lies in the window of two peaks counts
        for the first.
    thetas : (K,) float array
        Uniform headings.
    resolution : float
        Side of a cell, metres.
    radius : int
        The window reaches so many cells and headings to every side.

    Returns
    -------
    poses : (M, 3), mass : (M,), covariance : (M, 3, 3) float arrays
        Grid frame. Means over the window, yaw on the circle; the covariance holds the
        variance of a uniform draw within a cell, so that it is never zero.
    """
    n, height, width = probability.shape
    step = 2 * np.pi / n
    taken = np.zeros(probability.shape, dtype=bool)
    floor = np.diag(np.square([resolution, resolution, step]) / 12)
    poses, mass, covariance = [], [], []
    reach = min(radius, (n - 1) // 2)
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
