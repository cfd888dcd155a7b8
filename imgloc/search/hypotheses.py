"""From scored poses to hypotheses: separated modes with masses."""

import numpy as np

from imgloc.errors import ConfigError
from imgloc.geometry import wrap
from imgloc.model import FloatArray, Hypothesis, IntArray, Pose2D

_TOGETHER = 64  # poses that are compared with all others at a time


def masses(log_likelihood: FloatArray, temperature: float) -> FloatArray:
    """Softmax of ``log_likelihood / temperature``, (M,) nats: shares (M,) that sum to 1.

    A temperature that is not positive and finite raises a ConfigError.

    Examples
    --------
    >>> masses(np.array([0.0, 0.0, -np.inf]), 1.0).tolist()
    [0.5, 0.5, 0.0]
    """
    if not (np.isfinite(temperature) and temperature > 0):
        raise ConfigError(f"temperature must be positive and finite, got {temperature}")
    # scipy.special.softmax checks nothing, and takes a fifth of a second to import.
    weight = np.exp((log_likelihood - log_likelihood.max(initial=-np.inf)) / temperature)
    return np.asarray(weight / weight.sum())


def first_in_cell(poses: FloatArray, distance: float, angle: float) -> IntArray:
    """Indices of the poses (M, 3) that come first in their cell of pose space, in rising order.

    A cell has sides of `distance` metres and about `angle` radians, so that whole cells fill the
    circle.

    Examples
    --------
    >>> poses = np.array([[0.01, 0, 3.1], [0.02, 0, 3.1], [0.01, 0, 3.1 - 2 * np.pi]])
    >>> first_in_cell(poses, 0.1, 0.2).tolist()
    [0]
    """
    turn = max(1, round(2 * np.pi / angle))
    x, y = np.floor(poses[:, :2] / distance).T
    heading = np.floor(poses[:, 2] * (turn / (2 * np.pi))) % turn
    order = np.lexsort((x, y, heading))  # stable: the first of a cell comes first
    cells = np.stack((x, y, heading))[:, order]
    new = np.any(np.diff(cells, axis=1, prepend=np.nan) != 0, axis=0)
    return np.sort(order[new])


def separated(
    poses: FloatArray, n: int, *, distance: float, angle: float
) -> tuple[IntArray, IntArray]:
    """Pick poses in the given order, and leave out the neighbours of each pick.

    Parameters
    ----------
    poses : (M, 3) float array
        Metres, metres, radians; the best pose first.
    n : int
        Number of poses to pick, at most.
    distance, angle : float
        Two poses are neighbours if they are closer than both, metres and radians.

    Returns
    -------
    picked, owner : (K,) and (M,) int arrays
        Indices of the picked poses. For each pose the position in `picked` of its neighbour, or
        of itself; -1 if it has none.

    Examples
    --------
    >>> poses = np.array([[0, 0, 3.1], [0.1, 0, -3.1], [5, 0, 0.0]])
    >>> [a.tolist() for a in separated(poses, 9, distance=0.5, angle=0.2)]
    [[0, 2], [0, 0, 1]]
    """
    owner = np.full(len(poses), -1, dtype=np.int64)
    x, y, theta = np.ascontiguousarray(poses.T)
    theta = wrap(theta)
    picked: list[int] = []
    for start in range(0, len(poses), _TOGETHER):
        rest, rows = slice(start, None), slice(start, start + _TOGETHER)
        dx, dy, turn = (v[rest] - v[rows, None] for v in (x, y, theta))
        turn = np.abs(turn)
        near = np.square(dx) + np.square(dy) < distance * distance
        near &= np.minimum(turn, 2 * np.pi - turn) < angle
        for i in np.flatnonzero(owner[rows] < 0) + start:
            if len(picked) == n:
                return np.asarray(picked, dtype=np.int64), owner
            if owner[i] < 0:
                owner[rest][near[i - start] & (owner[rest] < 0)] = len(picked)
                picked.append(int(i))
    return np.asarray(picked, dtype=np.int64), owner


def modes(
    poses: FloatArray, score: FloatArray, *, distance: float, angle: float, most: int | None = None
) -> IntArray:
    """Indices of the best pose of each mode, at most `most`; best first, ties in index order.

    Poses that refinement has brought together are one mode. Its score is the score of its best
    pose, because the number of proposals that led to a mode is no evidence for it.
    """
    order = np.argsort(-score, kind="stable")
    n = len(order) if most is None else most
    some = 2 * n  # nearly always enough: who is picked depends on those before alone
    while True:
        picked, _ = separated(poses[order[:some]], n, distance=distance, angle=angle)
        if len(picked) == n or some >= len(order):
            return np.asarray(order[picked])
        some *= 2


def centres(
    poses: FloatArray,
    score: FloatArray,
    best: IntArray,
    *,
    within: tuple[float, float],
    same: tuple[float, float],
) -> tuple[FloatArray, FloatArray]:
    """Mean (C, 3) and covariance (C, 3, 3) of the maxima of each mode, weighted by their scores.

    Between two layers of a wall, or where a wall is drawn twice, the score has several maxima close
    together. Which one is the highest is chance. Their mean is nearer to the true pose than the
    highest one, by a third. The curvature of the score at one maximum does not show the others, so
    their spread is given, too.

    Parameters
    ----------
    poses : (M, 3) float array
        All refined poses, grid frame: metres, metres, radians.
    score : (M,) float array
        Their log-likelihoods in nats, divided by the temperature.
    best : (C,) int array
        Index of the best pose of each mode, from :func:`modes`.
    within : (float, float)
        Poses nearer than this, metres and radians, belong to one mode.
    same : (float, float)
        Poses nearer than this, metres and radians, are one maximum.

    Examples
    --------
    >>> poses = np.array([[0, 0, 0], [0.1, 0, 0], [5, 0, 0.0]])
    >>> about = {"within": (0.5, 0.2), "same": (0.02, 0.01)}
    >>> mean, covariance = centres(poses, np.zeros(3), np.array([0, 2]), **about)
    >>> mean[:, 0].round(3).tolist(), covariance[:, 0, 0].round(4).tolist()
    ([0.05, 5.0], [0.0025, 0.0])
    """
    order = np.argsort(-score, kind="stable")
    order = order[first_in_cell(poses[order], *same)]
    away = poses[order] - poses[best][:, None]
    away[..., 2] = wrap(away[..., 2])
    near = np.hypot(away[..., 0], away[..., 1]) < within[0]
    near &= np.abs(away[..., 2]) < within[1]
    below = score[order] - score[best][:, None]
    near &= below <= 0  # a pose that scores more belongs to a better mode beside this one
    weight = near * np.exp(np.minimum(below, 0))
    weight = weight / np.maximum(weight.sum(axis=1, keepdims=True), 1e-300)
    mean = np.einsum("cm,cmi->ci", weight, away)
    away -= mean[:, None]
    covariance = np.einsum("cm,cmi,cmj->cij", weight, away, away)
    mean += poses[best]
    mean[:, 2] = wrap(mean[:, 2])
    return mean, covariance


def as_hypotheses(
    poses: FloatArray, log_likelihood: FloatArray, mass: FloatArray, covariance: FloatArray
) -> tuple[Hypothesis, ...]:
    """Pack arrays of equal length into hypotheses."""
    return tuple(
        Hypothesis(Pose2D(*pose), float(score), float(share), matrix)
        for pose, score, share, matrix in zip(poses, log_likelihood, mass, covariance, strict=True)
    )
