"""The paper's performance index S, eq. 12: how much a method knows about the true pose.

``S = mean_k log p(x_k | z_k) + log V``, nats. The densities are relative ones here, ``p V``: 1
stands for "no idea". On a lattice of N poses ``p V`` is ``L[k*] N / sum(L)``, where k* is the cell
of the true pose; at most N. A density that has no cells, see :func:`density_at`, may exceed it.

A method that gives the true pose no probability would have S = -inf. Every density is therefore
mixed with a small share of the uniform one, :data:`FLOOR`. It stays a density, and a trial costs at
most ``-log(floor)`` nats. The trials that hit the floor are counted.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imgloc.geometry import wrap
from imgloc.model import BoolArray, Float32Array, FloatArray, Hypothesis, Localization, Pose2D

FLOOR = 1e-3  #: share of the uniform density in every density: a trial counts -6.9 nats or more
_SAMPLES = 24  # along each side of where a Gaussian and a cell meet: 0.4 sigmas or less


@dataclass(frozen=True)
class Index:
    """S of some trials, nats."""

    value: float  #: NaN without trials
    standard_error: float  #: from the scatter of the trials; NaN with fewer than two
    trials: int
    floored: int  #: trials whose density was below the floor
    floor: float


def performance_index(densities: Sequence[float]) -> Index:
    """Average the logarithms of relative densities (n,), ``p(x_k | z_k) V`` of each trial: eq. 12.

    Examples
    --------
    >>> S = performance_index([4.0, 0.0])  # nearly log(4), and log(0.001)
    >>> round(S.value, 2), S.floored
    (-2.76, 1)
    """
    return index_of(with_floor(np.asarray(densities, dtype=np.float64)))


def with_floor(densities: FloatArray) -> FloatArray:
    """Logarithms of relative densities with :data:`FLOOR` mixed in."""
    return np.asarray(np.log((1 - FLOOR) * densities + FLOOR))


def index_of(logs: FloatArray) -> Index:
    """Average logarithms (n,) of :func:`with_floor`."""
    n, unknown = len(logs), float("nan")
    error = float(logs.std(ddof=1) / np.sqrt(n)) if n > 1 else unknown
    floored = int((logs < with_floor(np.array(FLOOR))).sum())
    return Index(float(logs.mean()) if n else unknown, error, n, floored, FLOOR)


def density_in_stack(
    values: Float32Array, cell: tuple[int, int, int], where: BoolArray | None = None, *,
    log: bool = False,
) -> float:  # fmt: skip
    """Relative density ``L[k*] N / sum(L)`` that a stack gives to one of its cells.

    It is 1 if the stack is 0 everywhere, because the stack then has no information. It is 0 for a
    cell outside of the pose space.

    Parameters
    ----------
    values : (K, H, W) float32 array
        Likelihoods up to a factor, or log-likelihoods if `log`. Negative likelihoods count as 0.
    cell : (int, int, int)
        ``(theta, row, col)`` of the true pose.
    where : (H, W) bool array, optional
        The pose space, for example the free cells. By default the whole box.

    Examples
    --------
    >>> stack = np.array([[[1, 3, -2, 4]]], dtype=np.float32)
    >>> density_in_stack(stack, (0, 0, 1))
    1.5
    >>> density_in_stack(stack, (0, 0, 1), np.array([[True, True, True, False]]))
    2.25
    """
    k, row, col = cell
    n_theta, height, width = values.shape
    space = np.ones((height, width), dtype=bool) if where is None else where
    if not (0 <= k < n_theta and 0 <= row < height and 0 <= col < width and space[row, col]):
        return 0.0
    top = max(float(image[space].max()) for image in values) if log else 0.0

    def likelihoods(some: Float32Array) -> FloatArray:
        exact = some.astype(np.float64)
        return np.exp(exact - top) if log else np.maximum(exact, 0.0)

    total = sum(float(likelihoods(image[space]).sum()) for image in values)  # no copy of the stack
    if not total > 0:
        return 1.0
    return float(float(likelihoods(values[cell])) / total * n_theta * np.count_nonzero(space))


def density_at(answer: Localization, pose: Pose2D, volume: float) -> float:
    """Relative density ``p(pose | scan) V`` of an answer made of hypotheses.

    Each hypothesis is a Gaussian, with theta the short way round. The remaining mass is spread
    evenly over the pose space of `volume` m² rad. `pose` and the answer are in the map frame.

    Examples
    --------
    >>> one = Hypothesis(Pose2D(1, 2, 3), 0.0, 0.6, np.diag([0.01, 0.01, 0.01]))
    >>> answer = Localization((one,), "ambiguous", 0.0, 1.0)
    >>> round(density_at(answer, Pose2D(1, 2, 3), 10.0), 2)  # 0.6 * 10 / (2 pi 0.01)^1.5 + 0.4
    381.36
    """
    total = max(0.0, 1.0 - sum(h.mass for h in answer.hypotheses)) / volume
    for h in answer.hypotheses:
        d = np.array([[pose.x - h.pose.x, pose.y - h.pose.y, wrap(pose.theta - h.pose.theta)]])
        total += float(_gaussian(h, d)[0])
    return float(total * volume)


def density_in_cell(
    answer: Localization, pose: Pose2D, cell: float, theta_step: float, poses: int
) -> float:
    """Relative density ``p N`` of a cell by an answer made of hypotheses, to compare with stacks.

    `pose` is the centre of the cell. The sides of the cell lie along the axes of the answer's
    frame: `cell` metres and `theta_step` radians. `poses` is N, the number of cells of the pose
    space.

    Examples
    --------
    >>> one = Hypothesis(Pose2D(1, 2, 3), 0.0, 0.9, np.diag([1e-4, 1e-4, 1e-4]))
    >>> answer = Localization((one,), "unique", 0.0, 1.0)
    >>> round(density_in_cell(answer, Pose2D(1, 2, 3), 0.1, 0.1, 1000), 1)  # 0.9 * 1000 + 0.1
    900.1
    """
    half = np.array([cell, cell, theta_step]) / 2
    share = max(0.0, 1.0 - sum(h.mass for h in answer.hypotheses)) / poses
    for h in answer.hypotheses:
        middle = np.array([h.pose.x - pose.x, h.pose.y - pose.y, wrap(h.pose.theta - pose.theta)])
        # A Gaussian may be much smaller than the cell: sampled where the two meet.
        reach = 5 * np.sqrt(np.diag(h.covariance))
        low, high = np.maximum(-half, middle - reach), np.minimum(half, middle + reach)
        if (low < high).all():
            steps = (np.arange(_SAMPLES)[:, None] + 0.5) / _SAMPLES * (high - low) + low
            at = np.stack(np.meshgrid(*steps.T, indexing="ij"), axis=-1).reshape(-1, 3)
            share += float(_gaussian(h, at - middle).mean() * np.prod(high - low))
    return float(share * poses)


def _gaussian(hypothesis: Hypothesis, d: FloatArray) -> FloatArray:
    """Density (N,) of a hypothesis times its mass, at differences (N, 3) from its pose."""
    exponent = -0.5 * np.einsum("ni,in->n", d, np.linalg.solve(hypothesis.covariance, d.T))
    norm = np.sqrt(np.linalg.det(2 * np.pi * hypothesis.covariance))
    return np.asarray(hypothesis.mass * np.exp(exponent) / norm)


def global_maximum(values: Float32Array, where: BoolArray | None = None) -> tuple[int, int, int]:
    """Cell ``(theta, row, col)`` of the greatest of the values (K, H, W) in the cells of `where`.

    The first of equal values in index order wins.

    Examples
    --------
    >>> global_maximum(np.array([[[1, 9, 3]], [[5, 0, 5]]], np.float32), np.array([[1, 0, 1]]) > 0)
    (1, 0, 0)
    """
    flat = np.arange(values[0].size) if where is None else np.flatnonzero(where)
    best = [int(image.ravel()[flat].argmax()) for image in values]
    k = int(np.argmax([image.ravel()[flat[i]] for image, i in zip(values, best, strict=True)]))
    row, col = np.unravel_index(flat[best[k]], values.shape[1:])
    return k, int(row), int(col)
