"""Ray casting ``r_m(x, y, psi)`` by sphere tracing on a distance image.

The distance image says how far a ray may jump without missing a wall; next to a wall the
ray walks from cell border to cell border instead. Far from walls that is fast, and at the
wall it is exact: a reading ends where the ray enters the square of an occupied cell.
"""

import numpy as np
import numpy.typing as npt

from imgloc.errors import ConfigError
from imgloc.features.transform import distance_transform
from imgloc.model import BoolArray, Float32Array

# A ray that stops on a cell border belongs to the cell behind it: it is pushed this far over
# the border, in cells. float32 resolves it on images of up to 65,536 cells a side.
_NUDGE = np.float32(1 / 128)
_DIAGONAL = np.float32(np.sqrt(2))


def distance_image(occupied: BoolArray) -> Float32Array:
    """Distance from the centre of every cell to the nearest centre of an occupied cell.

    Parameters
    ----------
    occupied : (H, W) bool array
        Row 0 is the lowest y.

    Returns
    -------
    (H, W) float32 array
        Cells, exact up to 512 and never more; 0 on occupied cells, 512 everywhere if none is
        occupied.

    Examples
    --------
    >>> distance_image(np.array([[True, False, False]])).tolist()
    [[0.0, 1.0, 2.0]]
    """
    free = np.logical_not(occupied).astype(np.uint8)
    return distance_transform(free)


def cast_rays(
    distance: Float32Array,
    origins: npt.ArrayLike,
    angles: npt.ArrayLike,
    max_range: npt.ArrayLike,
    resolution: float,
) -> Float32Array:
    """Distance along each ray to the first occupied cell: ``r_m(x, y, psi)`` of eq. 2.

    Parameters
    ----------
    distance : (H, W) float32 array
        The :func:`distance_image` of the map, in cells.
    origins : (..., 2) array
        Where the rays start, x and y in metres in the grid frame.
    angles : (...) array
        Where they go, radians in the grid frame. `origins` and `angles` broadcast: poses
        ``(N, 1, 2)`` and angles ``(N, B)`` make N scans of B rays.
    max_range : float or (...) array
        Metres; what lies farther is not seen. An array gives each ray its own reach, which
        costs less than a long reach for all.
    resolution : float
        Side of a cell, metres.

    Returns
    -------
    (...) float32 array
        Metres to the border of the first occupied cell, within 1/128 of a cell; 0 for a ray
        that starts in an occupied cell; inf for a ray that meets none within `max_range`,
        starts off the map, or leaves it: there is nothing off the map.

    Raises
    ------
    ConfigError
        If a `max_range` or `resolution` is not a positive finite number.
    ValueError
        If an origin or an angle is not finite.

    Examples
    --------
    >>> wall = np.zeros((3, 8), dtype=bool)
    >>> wall[:, 6] = True
    >>> cast_rays(distance_image(wall), [0.15, 0.15], [0.0, np.pi], 5.0, 0.1).round(2).tolist()
    [0.44999998807907104, inf]
    """
    lengths = np.asarray(max_range, dtype=np.float64)
    bad = lengths[~(np.isfinite(lengths) & (lengths > 0))]
    if bad.size or not (np.isfinite(resolution) and resolution > 0):
        raise ConfigError(
            f"max_range {bad[0] if bad.size else max_range} and resolution {resolution} "
            "must be positive and finite"
        )
    start = np.asarray(origins, dtype=np.float64)
    x, y, psi = np.broadcast_arrays(start[..., 0], start[..., 1], np.asarray(angles, np.float64))
    if not (np.isfinite(x).all() and np.isfinite(y).all() and np.isfinite(psi).all()):
        raise ValueError("origins and angles must be finite")
    height, width = distance.shape
    out = np.full(psi.size, np.inf, dtype=np.float32)
    ray = np.arange(psi.size)
    x0, y0 = ((v / resolution).ravel().astype(np.float32) for v in (x, y))
    dx, dy = np.cos(psi).ravel().astype(np.float32), np.sin(psi).ravel().astype(np.float32)
    t = np.zeros(psi.size, dtype=np.float32)
    reach = np.broadcast_to(lengths / resolution, psi.shape).ravel().astype(np.float32)
    while ray.size:
        px, py = x0 + t * dx, y0 + t * dy
        live = (px >= 0) & (px < width) & (py >= 0) & (py < height) & (t <= reach)
        if not live.all():
            ray, x0, y0, dx, dy, t, reach, px, py = (
                v[live] for v in (ray, x0, y0, dx, dy, t, reach, px, py)
            )
        column, row = px.astype(np.int32), py.astype(np.int32)
        d = distance[row, column]
        hit = d == 0
        if hit.any():
            out[ray[hit]] = np.maximum(t[hit] - _NUDGE, 0)
            walk = ~hit
            ray, x0, y0, dx, dy, t, reach, px, py, column, row, d = (
                v[walk] for v in (ray, x0, y0, dx, dy, t, reach, px, py, column, row, d)
            )
        # The point and the wall may each be half a diagonal away from their cell's centre.
        near = np.minimum(_to_border(px - column, dx), _to_border(py - row, dy))
        t += np.maximum(d - _DIAGONAL, near) + _NUDGE
    return (out * np.float32(resolution)).reshape(psi.shape)


def _to_border(offset: Float32Array, direction: Float32Array) -> Float32Array:
    """Length of ray from `offset` (0..1) inside a cell to its border along one axis."""
    with np.errstate(divide="ignore", invalid="ignore"):
        length = ((direction > 0) - offset) / direction
    return np.asarray(np.where(direction == 0, np.inf, np.maximum(length, 0)), dtype=np.float32)
