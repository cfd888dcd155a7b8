"""Ray casting ``r_m(x, y, psi)`` by sphere tracing on a distance image.

By the distance image a ray jumps as far as it misses no wall; next to one it walks from
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
_FEW = 1 << 13  # rays, times cells that they may still go, that are looked at in one go
_WHOLE = 1 << 24  # float32 holds all whole numbers below
Distances = Float32Array | npt.NDArray[np.uint8]


def cast_rays(
    distance: Distances,
    origins: npt.ArrayLike,
    angles: npt.ArrayLike,
    max_range: npt.ArrayLike,
    resolution: float,
) -> Float32Array:
    """Distance along each ray to the first occupied cell: ``r_m(x, y, psi)`` of eq. 2.

    Parameters
    ----------
    distance : (H, W) float32 or uint8 array
        The :func:`~imgloc.features.distance.distance_image` of the map, in cells; or its
        :func:`~imgloc.features.distance.whole_steps`.
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
    psi = np.asarray(angles, np.float64)
    if not np.isfinite(psi).all():
        raise ValueError("origins and angles must be finite")
    return cast_along(distance, origins, np.cos(psi), np.sin(psi), max_range, resolution)


def cast_along(
    distance: Distances,
    origins: npt.ArrayLike,
    cosines: npt.ArrayLike,
    sines: npt.ArrayLike,
    max_range: npt.ArrayLike,
    resolution: float,
) -> Float32Array:
    """:func:`cast_rays` with the cosines and sines (...) of the angles, which must be finite.

    A scan is turned to many poses by products, which take far less time than cosines.

    Examples
    --------
    >>> from imgloc.features.distance import distance_image
    >>> wall = distance_image(np.array([[False] * 6 + [True]]))
    >>> cast_along(wall, [0.15, 0.05], [1.0, 0.0], [0.0, 1.0], 5.0, 0.1).round(2).tolist()
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
    if not np.isfinite(start).all():
        raise ValueError("origins and angles must be finite")
    start, lengths = start / resolution, lengths / resolution
    each = np.broadcast_arrays(start[..., 0], start[..., 1], cosines, sines, lengths)
    x, y, u, v, reach = (part.astype(np.float32).ravel() for part in each)
    cells = _march(distance, np.stack((x, y)), np.stack((u, v)), reach)
    return (cells * np.float32(resolution)).reshape(each[0].shape)


def _march(
    distance: Distances, start: Float32Array, along: Float32Array, reach: Float32Array
) -> Float32Array:
    """:func:`cast_rays` in cells: length (N,) of each ray, inf if it meets nothing.

    `start` and `along` are (2, N), x and y. What a ray does depends on that ray alone. One that
    has ended stands still, or goes on where nothing counts any more, until so many have ended that
    it pays to drop them.
    """
    height, width = distance.shape
    image, side = distance.reshape(-1), np.array([[width], [height]], np.float32)
    exact = np.float32 if image.size < _WHOLE else np.float64  # of the index of a cell
    out = np.full(reach.size, np.inf, dtype=np.float32)
    # The border that it makes for in a cell, 0 or 1, and its length per cell, along each axis; a
    # ray across an axis never gets to either border.
    ahead = (along >= 0).astype(np.float32)
    inverse = np.reciprocal(along, out=np.full_like(along, 1e30), where=along != 0)
    # Off the map there is nothing; a ray looks at its first cell wherever that is.
    exits = ((ahead * side - start) * inverse).min(axis=0)
    reach = np.minimum(reach, np.maximum(exits - _NUDGE / 2, 0))
    reach[((start < 0) | (start >= side)).any(axis=0)] = -1
    t, ray, every = np.zeros_like(reach), np.arange(reach.size), (start, along, ahead, inverse)
    while ray.size:
        p = t * along
        p += start
        cell = np.floor(p)
        index = np.multiply(cell[1], width, dtype=exact)
        index += cell[0]
        # Beyond its reach a ray may be anywhere.
        step = image.take(index.astype(np.intp), mode="clip").astype(np.float32, copy=False)
        free, moves = step > 0, np.minimum(step, 1)  # 0 in a wall; all others are 1 away at least
        # Length of ray to the next border of cells along each axis.
        cell += ahead
        cell -= p
        cell *= inverse
        # The point and the wall may each be half a diagonal away from their cell's centre.
        step -= _DIAGONAL
        np.maximum(step, np.minimum(cell[0], cell[1]), out=step)
        step += _NUDGE
        step *= moves
        t += step
        goes_on = t <= reach
        goes_on &= free
        if np.count_nonzero(goes_on) < (1 - _STALE) * ray.size:
            done = np.flatnonzero(~free & (t <= reach))
            out[ray[done]] = t[done]
            live = np.flatnonzero(goes_on)
            ray, t, reach = ray[live], t[live], reach[live]
            start, along, ahead, inverse = (
                v.take(live, axis=1) for v in (start, along, ahead, inverse)
            )
            if live.size * (reach - t).max(initial=0) < _FEW:
                break
    # A round takes as long for a few rays as for many. These look where they are, and behind all
    # borders that they may cross, at once.
    steps = np.arange((reach - t).max(initial=0) + 2, dtype=np.float32)
    border = np.floor(start + t * along) + ahead + (2 * ahead - 1) * steps[:, None, None]
    when = np.minimum((border - start) * inverse + _NUDGE, reach + 1)
    when = np.concatenate((t[None], when[:, 0], when[:, 1]))
    cell = np.floor(start + when[:, None] * along)
    index = np.multiply(cell[:, 1], width, dtype=exact) + cell[:, 0]
    met = (image.take(index.astype(np.intp), mode="clip") == 0) & (when <= reach)
    out[ray] = np.where(met, when, np.float32(np.inf)).min(axis=0)
    # However it got there, a ray ends where it enters the cell.
    (start, along, ahead, inverse), hit = every, np.isfinite(out)
    border = np.floor(start + np.where(hit, out, 0) * along) + 1 - ahead
    return np.where(hit, ((border - start) * inverse).max(axis=0, initial=0), out)
