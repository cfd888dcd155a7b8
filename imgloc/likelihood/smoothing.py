"""A stack blurred in x, y and, circularly, in theta: the uncertainty of eq. 8."""

import cv2
import numpy as np

from imgloc.model import Float32Array

_REACH = 5.0  # standard deviations that a kernel in theta reaches to either side


def smooth(
    values: Float32Array, sigma_px: float, sigma_bins: float, *, border: int = cv2.BORDER_CONSTANT
) -> Float32Array:
    """Blur a stack with a Gaussian in x, y and, circularly, in theta.

    The uncertainty of eq. 8, which a vote for a single cell ignores.

    Parameters
    ----------
    values : (K, H, W) float32 array
    sigma_px, sigma_bins : float
        Standard deviations in cells and in headings; 0 leaves that axis alone.
    border : int
        OpenCV's, of the images: by default nothing comes in from outside. Logarithms, whose 0
        means something else, want ``cv2.BORDER_REPLICATE``.

    Returns
    -------
    (K, H, W) float32 array
        A new one.

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
    """Weights (n,) of the headings ``0, 1, ... n - 1`` steps away, around the circle; sum 1.

    Parameters
    ----------
    n : int
        Headings.
    sigma : float
        In headings.

    Examples
    --------
    >>> circular_kernel(4, 0.0).tolist()
    [1.0, 0.0, 0.0, 0.0]
    >>> print(circular_kernel(4, 1.0).round(2))
    [0.43 0.26 0.06 0.26]
    """
    steps = np.arange(n)
    near = np.minimum(steps, n - steps)
    if sigma < 0.1:  # a neighbour has 2e-22 of it
        return np.asarray(near == 0, dtype=np.float32)
    weights = np.where(near <= max(1.0, _REACH * sigma), np.exp(-0.5 * (near / sigma) ** 2), 0.0)
    return np.asarray(weights / weights.sum(), dtype=np.float32)
