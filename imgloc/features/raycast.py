"""Ray casting ``r_m(x, y, psi)`` by sphere tracing on a distance image.

The distance image says how far a ray may jump without missing a wall; next to one it walks from
cell border to cell border: exact, a reading ends where it enters the square of an occupied cell.
"""

import numpy as np
import numpy.typing as npt

from imgloc.errors import ConfigError
from imgloc.model import Float32Array

# A ray that stops on a cell border belongs to the cell behind it: it is pushed this far over
# the border, in cells. float32 resolves it on images of up to 65,536 cells a side.
_NUDGE = np.float32(1 / 128)
_DIAGONAL = np.float32(np.sqrt(2))
_STALE = 0.5  # share of ended rays among those that are carried on


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
        The :func:`~imgloc.features.distance.distance_image` of the map, in cells.
    origins : (..., 2) array
        Where the rays start, x and y in metres in the grid frame.
    angles : (...) array
        Where they go, radians in the grid frame. `origins` and `angles` broadcast: poses
        ``(N, 1, 2)`` and angles ``(N, B)`` make N scans of B rays.
    max_range, resolution : float or (...) array, float
        Metres: what lies farther is not seen (short reaches cost less); side of a cell.

    Returns
    -------
    (...) float32 array
        Metres to the border of the first occupied cell, within 1/128 of a cell; 0 from within one;
        inf for a ray that meets none within `max_range`, starts off the map, or leaves it.

    Raises
    ------
    ConfigError, ValueError
        If a `max_range` or `resolution` is not positive and finite; if a ray is not finite.

    Examples
    --------
    >>> from imgloc.features.distance import distance_image
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
    reach = np.broadcast_to(lengths / resolution, psi.shape)
    rays = (x / resolution, y / resolution, np.cos(psi), np.sin(psi), reach)
    cells = _march(distance, *(v.ravel().astype(np.float32) for v in rays))
    return (cells * np.float32(resolution)).reshape(psi.shape)


def _march(
    distance: Float32Array,
    x0: Float32Array,
    y0: Float32Array,
    dx: Float32Array,
    dy: Float32Array,
    reach: Float32Array,
) -> Float32Array:
    """:func:`cast_rays` in cells, all arrays flat: length of each ray, inf if it meets nothing.

    What a ray does depends on that ray alone. One that has ended stands still, or goes on where
    nothing counts any more, until so many have ended that it pays to drop them.
    """
    height, width = distance.shape
    image = distance.reshape(-1)
    out = np.full(x0.size, np.inf, dtype=np.float32)
    ray = np.flatnonzero((x0 >= 0) & (x0 < width) & (y0 >= 0) & (y0 < height))
    x0, y0, dx, dy, reach = (v[ray] for v in (x0, y0, dx, dy, reach))
    ux, ix, exit_x = _axis(x0, dx, width)
    uy, iy, exit_y = _axis(y0, dy, height)
    # Off the map there is nothing; a ray looks at its first cell wherever that is.
    reach = np.minimum(reach, np.maximum(np.minimum(exit_x, exit_y) - _NUDGE / 2, 0))
    t = np.zeros(ray.size, dtype=np.float32)
    floats = np.empty((5, ray.size), dtype=np.float32)
    integers = np.empty((2, ray.size), dtype=np.intp)
    bools = np.empty((2, ray.size), dtype=np.bool_)
    while ray.size:
        px, py, near, other, step = (v[: ray.size] for v in floats)
        row, column = (v[: ray.size] for v in integers)
        ended, free = (v[: ray.size] for v in bools)
        for p, d, start, cell, index in ((px, dx, x0, near, column), (py, dy, y0, other, row)):
            np.multiply(t, d, out=p)
            np.add(p, start, out=p)
            np.floor(p, out=cell)
            np.copyto(index, cell, casting="unsafe")
        np.multiply(row, width, out=row)
        np.add(row, column, out=row)
        image.take(row, out=step, mode="clip")  # beyond its reach a ray may be anywhere
        np.greater(step, 0, out=free)
        # Length of ray to the next border of cells along each axis.
        for cell, u, p, i in ((near, ux, px, ix), (other, uy, py, iy)):
            np.add(cell, u, out=cell)
            np.subtract(cell, p, out=cell)
            np.multiply(cell, i, out=cell)
        np.minimum(near, other, out=near)
        # The point and the wall may each be half a diagonal away from their cell's centre.
        np.subtract(step, _DIAGONAL, out=step)
        np.maximum(step, near, out=step)
        np.add(step, _NUDGE, out=step)
        np.multiply(step, free, out=step)
        np.add(t, step, out=t)
        np.less_equal(t, reach, out=ended)
        np.logical_and(ended, free, out=ended)
        np.logical_not(ended, out=ended)
        if np.count_nonzero(ended) > _STALE * ray.size:
            done = np.flatnonzero(ended)
            done = done[~free[done] & (t[done] <= reach[done])]
            out[ray[done]] = np.maximum(t[done] - _NUDGE, 0)
            live = np.flatnonzero(~ended)
            ray = ray[live]
            x0, y0, dx, dy, ux, uy, ix, iy, t, reach = (
                v[live] for v in (x0, y0, dx, dy, ux, uy, ix, iy, t, reach)
            )
    return out


def _axis(
    start: Float32Array, direction: Float32Array, size: int
) -> tuple[Float32Array, Float32Array, Float32Array]:
    """The border that rays make for in a cell (0 or 1), length per cell, length to the map's."""
    ahead = (direction >= 0).astype(np.float32)
    # A ray across the axis never gets to either.
    inverse = np.reciprocal(direction, out=np.full_like(direction, 1e30), where=direction != 0)
    border = (ahead * np.float32(size) - start) * inverse
    return ahead, inverse, np.asarray(border, dtype=np.float32)
