"""From a likelihood stack to a probability for every pose: p(x | z) with a uniform prior."""

import cv2
import numpy as np

from imgloc.errors import ConfigError
from imgloc.likelihood.smoothing import smooth
from imgloc.model import BoolArray, Float32Array, Likelihood
from imgloc.options import DEFAULTS, LOG_METHODS, Calibration

__all__ = ["LOG_METHODS", "calibrated", "posterior", "smoothed"]

_NOTHING = -104.0  # nats; the exponential of less is 0 in 32 bits


def calibrated(
    stack: Likelihood,
    free: BoolArray,
    readings: int,
    calibration: Calibration | None = None,
    *,
    headings: BoolArray | None = None,
) -> Float32Array:
    """The probability of each pose, with what the method's evidence is worth.

    Parameters
    ----------
    stack : Likelihood
    free : (H, W) bool array
        The pose space.
    readings : int
        Valid ones of the scan.
    calibration : Calibration, optional
        By default that of :data:`~imgloc.options.DEFAULTS`.
    headings : (K,) bool array, optional
        The headings of the pose space; by default all.

    Returns
    -------
    (K, H, W) float32 array
        As :func:`posterior`.

    Examples
    --------
    >>> from imgloc.model import GridInfo
    >>> votes = np.array([[[1, 2, 0]]], dtype=np.float32)
    >>> stack = Likelihood(votes, np.zeros(1), GridInfo(1, 3, 0.1), "ght")
    >>> free = np.ones((1, 3), dtype=bool)
    >>> print(calibrated(stack, free, 20, Calibration(temperature=0.25)).ravel())
    [0.2 0.8 0. ]
    """
    how = DEFAULTS[stack.method] if calibration is None else calibration
    return posterior(
        smoothed(stack, how),
        stack.method,
        free,
        temperature=how.temperature_at(stack.method, readings),
        headings=headings,
    )


def smoothed(stack: Likelihood, calibration: Calibration) -> Float32Array:
    """The values of a stack, blurred as a calibration says; negative correlations count as 0."""
    log = stack.method in LOG_METHODS
    values = stack.values
    if not (calibration.sigma_xy or calibration.sigma_theta):
        return values
    if not log and values.size and values.min() < 0:
        values = np.maximum(values, 0)
    return smooth(
        values,
        calibration.sigma_xy / stack.grid.resolution,
        calibration.sigma_theta * len(stack.thetas) / (2 * np.pi),
        border=cv2.BORDER_REPLICATE if log else cv2.BORDER_CONSTANT,
    )


def posterior(
    values: Float32Array,
    method: str,
    free: BoolArray,
    *,
    temperature: float = 1.0,
    headings: BoolArray | None = None,
) -> Float32Array:
    """Normalise a stack to probabilities over the poses in free cells.

    Parameters
    ----------
    values : (K, H, W) float32 array
    method : str
        Log-likelihoods (``beam``) are exponentiated; the others are proportional to the
        likelihood, as in the paper, and clamped at 0: CBML-O may be negative.
    free : (H, W) bool array
        The pose space.
    temperature : float
        Logarithms are divided by it: votes are raised to the power ``1 / temperature``.
    headings : (K,) bool array, optional
        The headings of the pose space; by default all.

    Returns
    -------
    (K, H, W) float32 array
        Sums to 1; all 0 if no free pose has a positive likelihood.

    Raises
    ------
    ConfigError
        If `temperature` is not positive and finite.

    Examples
    --------
    >>> stack = np.array([[[1, 3, -2, 9]]], dtype=np.float32)
    >>> posterior(stack, "cbml", np.array([[True, True, True, False]])).ravel().tolist()
    [0.25, 0.75, 0.0, 0.0]
    """
    if not 0 < temperature < np.inf:
        raise ConfigError(f"temperature must be positive and finite, got {temperature}")
    log = method in LOG_METHODS
    out = np.zeros(values.shape, dtype=np.float32)
    if out.size == 0 or not free.any():
        return out
    used = range(len(values)) if headings is None else np.flatnonzero(headings)
    mask = np.asarray(free, dtype=np.uint8)
    tops = {k: cv2.minMaxLoc(values[k], mask)[1] for k in used}
    top, inside, total = max(tops.values(), default=0.0), mask.astype(np.float32), 0.0
    if not log and top <= 0:
        return out
    # Heading by heading: an image stays in the cache, a stack does not.
    for k, best in tops.items():
        into = out[k]
        if log:
            if not best - top > _NOTHING * temperature:
                continue
            np.subtract(values[k], np.float32(top), out=into)
            if temperature != 1:
                into *= np.float32(1 / temperature)
            np.exp(np.minimum(into, 0, out=into), out=into)
        else:
            np.maximum(values[k], 0, out=into)
            if temperature != 1:
                into *= np.float32(1 / top)
                # What is outside the pose space may be greater than the top in it.
                cv2.pow(np.minimum(into, 1, out=into), 1 / temperature, into)
        into *= inside
        total += float(into.sum(dtype=np.float64))
    if total > 0:
        out *= np.float32(1 / total)
    return out
