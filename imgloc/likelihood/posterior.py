"""From a likelihood stack to a probability for every pose: p(x | z) with a uniform prior."""

import numpy as np

from imgloc.model import BoolArray, Float32Array

#: Stacks whose values are logarithms already.
LOG_METHODS = frozenset({"beam"})


def posterior(values: Float32Array, method: str, free: BoolArray) -> Float32Array:
    """Normalise a stack to probabilities over the poses in free cells.

    Parameters
    ----------
    values : (K, H, W) float32 array
    method : str
        Log-likelihoods (``beam``) are exponentiated; the others are proportional to the
        likelihood, as in the paper, and clamped at 0: CBML-O may be negative.
    free : (H, W) bool array
        The pose space.

    Returns
    -------
    (K, H, W) float32 array
        Sums to 1; all 0 if no free pose has a positive likelihood.

    Examples
    --------
    >>> stack = np.array([[[1, 3, -2, 9]]], dtype=np.float32)
    >>> posterior(stack, "cbml", np.array([[True, True, True, False]])).ravel().tolist()
    [0.25, 0.75, 0.0, 0.0]
    """
    if method in LOG_METHODS:
        top = values[:, free].max(initial=-np.inf)
        out = np.exp(np.minimum(values - top, 0)) * free
    else:
        out = np.maximum(values, 0) * free
    total = float(out.sum(dtype=np.float64))
    if total > 0:
        out *= np.float32(1 / total)
    return np.asarray(out, dtype=np.float32)
