"""From a likelihood stack to a probability for every pose: p(x | z) with a uniform prior."""

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from imgloc.errors import ConfigError
from imgloc.model import BoolArray, Float32Array, Likelihood
from imgloc.options import DEFAULTS, LOG_METHODS, Calibration

_REACH = 5.0  # deviations of a Gaussian to either side: less than a millionth is beyond them
_CHUNK = 1 << 16  # shares at a time, so that they stay in the cache
_NOTHING = -104.0  # nats; the exponential of less is 0 in 32 bits


def calibrated(
    stack: Likelihood,
    free: BoolArray,
    readings: int,
    calibration: Calibration | None = None,
    *,
    headings: BoolArray | None = None,
) -> Float32Array:
    """Turn a stack into the calibrated probability of each pose, (K, H, W) float32, sum 1.

    `free` (H, W) and `headings` (K,) are bool masks of the poses that are possible, by default all
    headings. `readings` is the number of valid readings in the scan. The calibration is by default
    that of the method in :data:`~imgloc.options.DEFAULTS`.

    Examples
    --------
    >>> from imgloc.model import GridInfo
    >>> votes = np.array([[[1, 2, 0]]], dtype=np.float32)
    >>> stack = Likelihood(votes, np.zeros(1), GridInfo(1, 3, 0.1), "ght")
    >>> free = np.ones((1, 3), dtype=bool)
    >>> print(calibrated(stack, free, 20, Calibration(temperature=0.25)).ravel())
    [0.2 0.8 0. ]
    """
    how = DEFAULTS.get(stack.method, Calibration()) if calibration is None else calibration
    values, temperature = smoothed(stack, how), how.temperature_at(stack.method, readings)
    return posterior(values, stack.method, free, temperature=temperature, headings=headings)


def smoothed(stack: Likelihood, calibration: Calibration) -> Float32Array:
    """Blur the values of a stack by the deviations of a calibration; negative values count as 0."""
    log, values = stack.method in LOG_METHODS, stack.values
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
        Values of the stack.
    method : str
        Name of the method. The log-likelihoods of ``beam`` are exponentiated. The values of the
        others are proportional to the likelihood, as in the paper. Negative ones count as 0.
    free : (H, W) bool array
        Cells whose poses are possible.
    headings : (K,) bool array, optional
        Headings that are possible, by default all.
    temperature : float
        Divisor of the logarithms: votes are raised to the power ``1 / temperature``.

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
    power = np.float32(1 / temperature)
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
                into *= power
            np.exp(np.minimum(into, 0, out=into), out=into)
        else:
            np.maximum(values[k], 0, out=into)
            if temperature != 1:
                into *= np.float32(1 / top)
                # A value outside of the pose space may exceed the greatest one within.
                np.minimum(into, 1, out=into)
                # cv2.pow takes twenty times as long.
                with np.errstate(divide="ignore"):
                    np.log(into, out=into)
                into *= power
                np.exp(into, out=into)
        into *= inside
        total += float(into.sum(dtype=np.float64))
    if total > 0:
        out *= np.float32(1 / total)
    return out


def entropy(mass: npt.NDArray[Any]) -> float:
    """Entropy of shares of any shape that sum to 1, nats.

    It is 0 if one share is 1, and ``log(n)`` for n equal shares.

    Examples
    --------
    >>> round(entropy(np.array([0.5, 0.5])), 3)
    0.693
    """
    flat, total = mass.ravel(), 0.0
    for start in range(0, flat.size, _CHUNK):
        some = flat[start : start + _CHUNK]
        logarithm = np.log(np.maximum(some, np.finfo(some.dtype).tiny))
        total += float(np.sum(some * logarithm, dtype=np.float64))
    return abs(total)


def smooth(
    values: Float32Array, sigma_px: float, sigma_bins: float, *, border: int = cv2.BORDER_CONSTANT
) -> Float32Array:
    """Blur a stack with a Gaussian in x, y and, circularly, in theta: the uncertainty of eq. 8.

    The result is a new (K, H, W) float32 stack. The standard deviations are in cells and in
    headings. 0 leaves that axis as it is. `border` is OpenCV's border type. By default values off
    the map are 0; logarithms need ``cv2.BORDER_REPLICATE``.

    Examples
    --------
    >>> stack = np.zeros((8, 1, 1), dtype=np.float32)
    >>> stack[0] = 1
    >>> print(smooth(stack, 0, 1).ravel().round(2))
    [0.4  0.24 0.05 0.   0.   0.   0.05 0.24]
    """
    values = np.asarray(values, dtype=np.float32)
    n = len(values)
    if not values.size:
        return values.copy()
    # scipy.ndimage's filter takes 1.2 to 3 times as long, and a fifth of a second to import.
    weights = circular_kernel(n, sigma_bins)
    out = np.empty_like(values)
    # Heading by heading, in a fixed order: the result does not depend on threads.
    for k, image in enumerate(out):
        np.multiply(values[k], weights[0], out=image)
        for step in np.flatnonzero(weights[1:]) + 1:
            cv2.scaleAdd(values[(k + step) % n], float(weights[step]), image, image)
        if sigma_px > 0:
            cv2.GaussianBlur(image, (0, 0), sigma_px, dst=image, borderType=border)
    return out


def circular_kernel(n: int, sigma: float) -> Float32Array:
    """Weights (n,) of headings 0 to n - 1 steps around the circle, sum 1; `sigma` is in steps.

    Examples
    --------
    >>> circular_kernel(4, 0.0).tolist()
    [1.0, 0.0, 0.0, 0.0]
    >>> print(circular_kernel(4, 1.0).round(2))
    [0.43 0.26 0.06 0.26]
    """
    steps = np.arange(n)
    near = np.minimum(steps, n - steps)
    if sigma < 0.1:  # the weight of a neighbour is 2e-22
        return np.asarray(near == 0, dtype=np.float32)
    weights = np.where(near <= max(1.0, _REACH * sigma), np.exp(-0.5 * (near / sigma) ** 2), 0.0)
    return np.asarray(weights / weights.sum(), dtype=np.float32)
