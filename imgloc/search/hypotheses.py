"""From scored poses to hypotheses: separated modes with masses and covariances."""

import numpy as np

from imgloc.features.distance import DistanceField
from imgloc.model import FloatArray, Hypothesis, IntArray, Pose2D
from imgloc.search.peaks import separated
from imgloc.search.refine import normal_equations


def masses(log_likelihood: FloatArray, temperature: float) -> FloatArray:
    """Softmax of ``log_likelihood / temperature``: (M,) shares that sum to 1.

    Examples
    --------
    >>> masses(np.array([0.0, 0.0, -np.inf]), 1.0).tolist()
    [0.5, 0.5, 0.0]
    """
    if len(log_likelihood) == 0:
        return np.empty(0)
    weight = np.exp((log_likelihood - log_likelihood.max()) / temperature)
    return np.asarray(weight / weight.sum())


def entropy(mass: FloatArray) -> float:
    """Of shares that sum to 1, nats.

    Examples
    --------
    >>> round(entropy(np.array([0.5, 0.5])), 3)
    0.693
    """
    positive = mass[mass > 0]
    return float(abs(np.sum(positive * np.log(positive))))


def modes(poses: FloatArray, score: FloatArray, *, distance: float, angle: float) -> IntArray:
    """Indices of the best pose of each mode, best first, ties in index order.

    Poses that a refinement has brought together are one mode, whose score is that of its best
    pose: how many proposals led there says nothing about it.
    """
    order = np.argsort(-score, kind="stable")
    picked, _ = separated(poses[order], len(order), distance=distance, angle=angle)
    return np.asarray(order[picked])


def covariances(
    poses: FloatArray,
    xy: FloatArray,
    field: DistanceField,
    *,
    sigma: float,
    temperature: float,
    extent: tuple[float, float],
) -> FloatArray:
    """Covariance (C, 3, 3) of each pose from the curvature of its score (Laplace).

    Parameters
    ----------
    poses : (C, 3) float array
        Refined, grid frame.
    xy : (N, 2) float array
        Scan points, sensor frame, metres.
    field : DistanceField
    sigma : float
        Standard deviation of an endpoint's distance from its surface, metres.
    temperature : float
        As in :func:`masses`: neighbouring readings are not independent.
    extent : (float, float)
        Half-widths of a mode, metres and radians. A corridor leaves its own direction
        undetermined; the mode is no longer than this all the same.
    """
    A, _ = normal_equations(poses, xy, field, 2 * sigma)
    information = A / (temperature * sigma**2)
    information[:, range(3), range(3)] += 1 / np.square([extent[0], extent[0], extent[1]])
    out = np.linalg.inv(information)
    # No finer than a fifth of a cell: the map itself is rounded to cells.
    floor = np.square([field.resolution / 5, field.resolution / 5, np.deg2rad(0.1)])
    out[:, range(3), range(3)] += floor
    return np.asarray((out + out.transpose(0, 2, 1)) / 2)


def as_hypotheses(
    poses: FloatArray, log_likelihood: FloatArray, mass: FloatArray, covariance: FloatArray
) -> tuple[Hypothesis, ...]:
    """Pack arrays of equal length into hypotheses."""
    return tuple(
        Hypothesis(Pose2D(*pose), float(score), float(share), matrix)
        for pose, score, share, matrix in zip(poses, log_likelihood, mass, covariance, strict=True)
    )
