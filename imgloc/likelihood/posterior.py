"""From a likelihood stack to a probability for every pose: p(x | z) with a uniform prior."""

import cv2
import numpy as np

from imgloc.errors import ConfigError
from imgloc.model import BoolArray, Float32Array

#: Stacks whose values are logarithms already.
LOG_METHODS = frozenset({"beam"})

_NOTHING = -104.0  # nats; the exponential of less is 0 in 32 bits


def posterior(
    values: Float32Array, method: str, free: BoolArray, *, temperature: float = 1.0
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
        Log-likelihoods are divided by it: 1 takes their readings for independent,
        :func:`imgloc.likelihood.beam.temperature` says what they are worth. Votes, which are
        no logarithms, are left as they are.

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
    mask = np.asarray(free, dtype=np.uint8)
    tops = [cv2.minMaxLoc(image, mask)[1] if log else 0.0 for image in values]
    top, inside, total = max(tops), mask.astype(np.float32), 0.0
    # Heading by heading: an image stays in the cache, a stack does not.
    for image, best, into in zip(values, tops, out, strict=True):
        if log and not best - top > _NOTHING * temperature:
            continue
        if log:
            np.subtract(image, np.float32(top), out=into)
            if temperature != 1:
                into *= np.float32(1 / temperature)
            np.exp(np.minimum(into, 0, out=into), out=into)
        else:
            np.maximum(image, 0, out=into)
        into *= inside
        total += float(into.sum(dtype=np.float64))
    if total > 0:
        out *= np.float32(1 / total)
    return out
