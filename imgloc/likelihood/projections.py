"""A vector field seen along each of many directions: what makes CBML-O as cheap as CBML."""

import numpy as np
import numpy.typing as npt

from imgloc.errors import ConfigError
from imgloc.model import Float32Array

# Projections are in -VMAP_LEVELS..VMAP_LEVELS: sums of 258 readings fit into int16.
VMAP_LEVELS = 127


def project(vmap: Float32Array, directions: int = 64) -> npt.NDArray[np.int16]:
    """Project a vector field on directions, once per map, for the shift engine of CBML-O.

    Parameters
    ----------
    vmap : (2, H, W) float array
        x and y component, of magnitude 0..1.
    directions : int
        How many directions the circle is divided into; even.

    Returns
    -------
    (directions // 2, H, W) int16 array
        ``127 (vx cos a + vy sin a)`` for a = 2 pi d / directions, rounded. The other half of the
        circle is the negative of this one. ``H * W * directions`` bytes.

    Raises
    ------
    ConfigError
        If `directions` is not an even number of at least 2.
    ValueError
        If `vmap` is not a pair of images of magnitude 0..1.

    Examples
    --------
    >>> vmap = np.array([[[1.0]], [[0.0]]], dtype=np.float32)
    >>> project(vmap, 8).ravel().tolist()
    [127, 90, 0, -90]
    """
    field = checked_field(vmap)
    check_directions(directions)
    out = np.empty((directions // 2, *field.shape[1:]), dtype=np.int16)
    for image, (c, s) in zip(out, unit_vectors(directions), strict=False):
        np.rint(VMAP_LEVELS * (field[0] * c + field[1] * s), out=image, casting="unsafe")
    return out


def check_directions(directions: int) -> None:
    """Refuse a number of directions that is not even and positive.

    Raises
    ------
    ConfigError
        If it is not.
    """
    if directions < 2 or directions % 2:
        raise ConfigError(f"directions must be an even number of at least 2, got {directions}")


def unit_vectors(directions: int) -> Float32Array:
    """Return the cosine and the sine of each direction, (directions, 2) float32."""
    a = np.arange(directions) * (2 * np.pi / directions)
    return np.stack((np.cos(a), np.sin(a)), axis=1).astype(np.float32)


def checked_field(vmap: Float32Array) -> Float32Array:
    """Return `vmap` as float32 after checking its shape and magnitude.

    Raises
    ------
    ValueError
        If it is not a pair of images of magnitude 0..1.
    """
    field = np.asarray(vmap, dtype=np.float32)
    if field.ndim != 3 or field.shape[0] != 2:
        raise ValueError(f"vmap must have shape (2, H, W), got {field.shape}")
    longest = np.sqrt(np.max(field[0] ** 2 + field[1] ** 2, initial=0.0))
    if not longest <= 1 + 1e-5:
        raise ValueError(f"vmap must have vectors of length 0..1, got {longest:g}")
    return field
