"""The visibility map of GHT-V: how far one sees from each surface point in each direction."""

import numpy as np
import numpy.typing as npt

from imgloc.errors import ConfigError
from imgloc.features.distance import distance_image
from imgloc.features.raycast import cast_rays
from imgloc.geometry import theta_bin
from imgloc.model import BoolArray, Float32Array, FloatArray, OrientedPoints

_PAIRS = 1 << 21  # pairs of points, or rays, worked on at a time
_OFF = (0.5, 1.0, 1.5)  # cells in front of a surface point where its rays may start


def visibility_points(xy: FloatArray, n_psi: int, horizon: float) -> Float32Array:
    """Visibility map from the surface points alone: Alg. 6.

    Parameters
    ----------
    xy : (M, 2) float array
        Surface points in the grid frame, metres.
    n_psi : int
        Number of directions; ``psi_k = 2 pi k / n_psi`` in the grid frame, and a point lies
        in the nearest.
    horizon : float
        Radius rho of the ball, metres; inf for all pairs. Less than the sensor's reach leaves
        some constraints unused, no more.

    Returns
    -------
    (M, n_psi) float32 array
        ``vis[j, k]``, metres from point j to the nearest point in direction psi_k; inf where
        there is none within the horizon.

    Raises
    ------
    ConfigError
        If n_psi or horizon is not positive.

    Notes
    -----
    The listing stores the direction from p_i to p_j with p_j. Alg. 5 and the definition of
    ``vis_j[psi]``, "the distance from p_j to the nearest obstacle in direction psi", need the
    opposite one, which is what is done here. The points do not shut out a ray that passes
    between two of them, so n_psi must be coarse: for a map :func:`visibility_image` is
    the better choice, and faster.

    Examples
    --------
    >>> visibility_points(np.array([[0.0, 0.0], [3.0, 0.0], [5.0, 0.0]]), 2, 4.0).tolist()
    [[3.0, inf], [2.0, 3.0], [inf, 2.0]]
    """
    _check(n_psi, horizon)
    xy = np.asarray(xy, np.float64).reshape(-1, 2)
    vis = np.full((len(xy), n_psi), np.inf, np.float32)
    rows = max(1, _PAIRS // max(1, len(xy)))
    for first in range(0, len(xy), rows):  # Alg. 6, l. 1
        away = xy[None] - xy[first : first + rows, None]
        d = np.hypot(away[..., 0], away[..., 1])  # l. 3
        at, other = np.nonzero((d <= horizon) & (d > 0))  # l. 2
        psi = theta_bin(np.arctan2(away[at, other, 1], away[at, other, 0]), n_psi)  # l. 4
        np.minimum.at(vis, (first + at, psi), d[at, other].astype(np.float32))  # l. 5
    return vis


def visibility_image(
    occupied: BoolArray, surface: OrientedPoints, resolution: float, n_psi: int, horizon: float
) -> Float32Array:
    """Visibility map by casting rays in the image of the map.

    Parameters
    ----------
    occupied : (H, W) bool array
        Row 0 is the lowest y; unknown cells do not stop a ray.
    surface : OrientedPoints
        Of that map, in the grid frame.
    resolution : float
        Side of a cell, metres.
    n_psi : int
        Number of directions; ``psi_k = 2 pi k / n_psi`` in the grid frame.
    horizon : float
        Metres, finite.

    Returns
    -------
    (M, n_psi) float32 array
        ``vis[j, k]``, metres from point j to the nearest wall in direction psi_k; inf where
        there is none within the horizon, 0 in directions behind the surface. Points without
        a normal see nothing: 0.

    Raises
    ------
    ConfigError
        If n_psi or horizon is out of its range.

    Examples
    --------
    The wall on the left of a corridor sees the one on its right:

    >>> corridor = np.zeros((3, 12), bool)
    >>> corridor[:, [0, 11]] = True
    >>> wall = OrientedPoints([[0.1, 0.15]], [0.0], [0.1], [True])
    >>> visibility_image(corridor, wall, 0.1, 2, 5.0).round(2).tolist()
    [[1.0, 0.0]]
    """
    psi = np.arange(n_psi) * (2 * np.pi / max(n_psi, 1))
    angles = np.broadcast_to(psi, (len(surface), n_psi))
    _check(n_psi, horizon, finite=True)
    return _cast(occupied, surface, resolution, angles, horizon, distance_image(occupied))


def visibility_frames(
    occupied: BoolArray,
    surface: OrientedPoints,
    resolution: float,
    n_psi: int,
    horizon: float,
    *,
    distance: Float32Array | None = None,
) -> Float32Array:
    """Visibility map with each point's normal as its direction 0, as GHT-V reads it.

    Parameters
    ----------
    occupied, surface, resolution, n_psi, horizon
        As for :func:`visibility_image`; here ``psi_k = 2 pi k / n_psi`` is measured from the
        normal, counter-clockwise.
    distance : (H, W) float32 array, optional
        :func:`~imgloc.features.raycast.distance_image` of `occupied`, if it is there already.

    Returns
    -------
    (n_psi, M) float32 array
        ``vis[k, j]``, C-contiguous: one row per direction. Rows a quarter turn or more from the
        normal are 0.

    Raises
    ------
    ConfigError
        If n_psi or horizon is out of its range.

    Notes
    -----
    Equal to ``visibility_relative(visibility_image(...), surface.alpha)`` without rounding the
    normals to directions of the grid.

    Examples
    --------
    >>> corridor = np.zeros((3, 12), bool)
    >>> corridor[:, [0, 11]] = True
    >>> wall = OrientedPoints([[1.1, 0.15]], [np.pi], [0.1], [True])
    >>> visibility_frames(corridor, wall, 0.1, 4, 5.0).round(2).tolist()
    [[1.0], [0.0], [0.0], [0.0]]
    """
    _check(n_psi, horizon, finite=True)
    psi = np.arange(n_psi) * (2 * np.pi / n_psi)
    out = np.empty((n_psi, len(surface)), np.float32)
    distance = distance_image(occupied) if distance is None else distance
    rows = max(1, _PAIRS // n_psi)
    for first in range(0, len(surface), rows):
        some = surface.select(np.arange(first, min(first + rows, len(surface))))
        angles = some.alpha[:, None] + psi
        out[:, first : first + rows] = _cast(
            occupied, some, resolution, angles, horizon, distance
        ).T
    return out


def visibility_relative(vis: Float32Array, alpha: FloatArray) -> Float32Array:
    """Turn a visibility map so that direction 0 is each point's normal.

    Parameters
    ----------
    vis : (M, n_psi) float32 array
        Directions ``psi_k = 2 pi k / n_psi`` of the grid frame.
    alpha : (M,) float array
        Normals, radians; where NaN, direction 0 stays where it is.

    Returns
    -------
    (n_psi, M) float32 array
        ``[k, j]`` is the entry of `vis` for point j nearest to direction alpha_j + psi_k.

    Raises
    ------
    ConfigError
        If there is not one normal per point.

    Examples
    --------
    >>> vis = np.array([[1, 2, 3, 4]], np.float32)
    >>> visibility_relative(vis, np.array([np.pi / 2]))[:, 0].tolist()
    [2.0, 3.0, 4.0, 1.0]
    """
    if vis.ndim != 2 or np.shape(alpha) != vis.shape[:1]:
        raise ConfigError(f"one normal per point: vis {vis.shape}, alpha {np.shape(alpha)}")
    n_psi = vis.shape[1]
    turned = theta_bin(np.nan_to_num(alpha), n_psi)[None] + np.arange(n_psi)[:, None]
    return np.ascontiguousarray(vis[np.arange(len(vis)), turned % n_psi])


def _cast(
    occupied: BoolArray,
    surface: OrientedPoints,
    resolution: float,
    angles: npt.NDArray[np.float64],
    horizon: float,
    distance: Float32Array,
) -> Float32Array:
    """Distance (M, n_psi) seen from each point at `angles` (M, n_psi) of the grid frame."""
    occupied = np.asarray(occupied, np.bool_)
    with np.errstate(invalid="ignore"):
        cosine = np.cos(angles - surface.alpha[:, None])
        front = cosine > 1e-9  # NaN is not
    normal = np.column_stack((np.cos(surface.alpha), np.sin(surface.alpha)))
    off = _first_clear(occupied, surface.xy, normal, resolution)
    origin = surface.xy + off[:, None] * normal
    vis = np.zeros(angles.shape, np.float32)
    rows = max(1, _PAIRS // angles.shape[1])
    for first in range(0, len(surface), rows):
        at, psi = np.nonzero(front[first : first + rows])
        at += first
        seen = cast_rays(distance, origin[at], angles[at, psi], horizon, resolution)
        # From the surface itself: the ray started off[j] in front of it.
        seen += (off[at] * cosine[at, psi]).astype(np.float32)
        vis[at, psi] = np.where(seen <= horizon, seen, np.inf)
    return vis


def _first_clear(
    occupied: BoolArray, xy: FloatArray, normal: FloatArray, resolution: float
) -> FloatArray:
    """Metres in front of each point where the first cell lies that is not occupied."""
    padded = np.pad(occupied, 1)
    limit = np.array(occupied.shape) + 1
    off = np.full(len(xy), _OFF[-1])
    for step in reversed(_OFF):
        with np.errstate(invalid="ignore"):
            cells = np.floor(np.nan_to_num(xy / resolution + step * normal)).astype(np.int64)[
                :, ::-1
            ]
        row, col = np.clip(cells + 1, 0, limit).T
        off[~padded[row, col]] = step
    return off * resolution


def _check(n_psi: int, horizon: float, *, finite: bool = False) -> None:
    if n_psi < 1:
        raise ConfigError(f"n_psi must be at least 1, got {n_psi}")
    if not horizon > 0:
        raise ConfigError(f"horizon must be positive, got {horizon}")
    if finite and not np.isfinite(horizon):
        raise ConfigError(f"horizon must be finite, got {horizon}")
