"""The visibility map of GHT-V: how far one sees from each surface point in each direction.

Two ways to compute it. ``march`` casts the rays, exactly; ``polar`` unwraps the image around each
point, so that every ray is a row, and looks for the first wall along it.
"""

import cv2
import numpy as np
import numpy.typing as npt

from imgloc.features.distance import distance_image
from imgloc.features.raycast import Distances, cast_rays
from imgloc.features.raydistance import HIT, SURFACE, watertight
from imgloc.geometry import values_at
from imgloc.model import BoolArray, Float32Array, FloatArray, OrientedPoints
from imgloc.threads import while_wanted

WAYS = ("march", "polar")

_PAIRS = 1 << 21  # rays cast at a time
_OFF = (0.5, 1.0, 1.5)  # cells in front of a surface point where its rays may start
_STEP = 0.5  # cells between the samples along an unwrapped ray
_SAMPLES, _MOST_ROWS = 1 << 21, (1 << 15) - 2  # unwrapped at a time; cv2.remap's limit


def visibility_frames(
    occupied: BoolArray,
    surface: OrientedPoints,
    resolution: float,
    n_psi: int,
    horizon: float,
    *,
    by: str = "march",
    distance: Distances | None = None,
) -> Float32Array:
    """Distance to the nearest wall in each direction from the normal, as GHT-V reads it (Alg. 6).

    Parameters
    ----------
    occupied, resolution : (H, W) bool array, float
        Occupied cells, row 0 lowest; side of a cell, metres. Unknown cells do not stop a ray.
    surface : OrientedPoints
        Surface points of the same map, grid frame.
    n_psi : int
        Number of directions; ``psi_k = 2 pi k / n_psi`` from the normal, counter-clockwise.
    horizon : float
        Reach of the map, metres; one below the sensor's reach leaves some constraints unused.
    by : {"march", "polar"}
        ``polar`` is within a cell of ``march`` but for rays that graze a wall.
    distance : (H, W) float32 or uint8 array, optional
        Of `occupied`, if it is there already: as :func:`~imgloc.features.raycast.cast_rays` has it.

    Returns
    -------
    (n_psi, M) float32 array
        ``vis[k, j]``, C-contiguous: metres from point j to the nearest wall in direction psi_k,
        inf if there is none within the horizon; 0 a quarter turn or more from the normal, and
        for points without one.

    Notes
    -----
    Alg. 6 stores the direction from p_i to p_j with p_j; Alg. 5 needs the opposite one, kept here.

    Examples
    --------
    The wall on the right of a corridor sees the one on its left:

    >>> corridor = np.zeros((3, 12), bool)
    >>> corridor[:, [0, 11]] = True
    >>> wall = OrientedPoints([[1.1, 0.15]], [np.pi], [0.1], [True])
    >>> visibility_frames(corridor, wall, 0.1, 4, 5.0).round(2).tolist()
    [[1.0], [0.0], [0.0], [0.0]]
    """
    normal = np.column_stack((np.cos(surface.alpha), np.sin(surface.alpha)))
    off = _first_clear(occupied, surface.xy, normal, resolution)
    origin = surface.xy + off[:, None] * normal
    psi = np.arange(n_psi) * (2 * np.pi / n_psi)
    front = np.flatnonzero(np.cos(psi) > 1e-9)
    known = np.flatnonzero(np.isfinite(surface.alpha))
    vis = np.zeros((n_psi, len(surface)), np.float32)
    if by == "march":
        walls = distance_image(occupied) if distance is None else distance
        rows = max(1, _PAIRS // n_psi)
    else:
        image, reach = watertight(occupied), min(horizon / resolution, np.hypot(*occupied.shape))
        rows = max(1, min(_SAMPLES // int(reach / _STEP + 1), _MOST_ROWS) // max(1, len(front)))
    for first in while_wanted(range(0, len(known), rows)):
        some = known[first : first + rows]
        rays = surface.alpha[some] + psi[front, None]
        if by == "march":
            seen = cast_rays(walls, origin[some], rays, horizon, resolution)
        else:
            cells = _first_wall(unwrapped(image, origin[some] / resolution, rays, reach))
            seen = resolution * cells.reshape(rays.shape)
        vis[np.ix_(front, some)] = seen
    # From the surface itself: the ray started off[j] in front of it.
    vis[np.ix_(front, known)] += np.outer(np.cos(psi[front]), off[known]).astype(np.float32)
    vis[vis > horizon] = np.inf
    return vis


def unwrapped(
    image: npt.NDArray[np.uint8], origin: FloatArray, rays: FloatArray, reach: float
) -> npt.NDArray[np.uint8]:
    """Polar images around points: a row for each ray, a column for each half cell along it.

    What :func:`cv2.warpPolar` does, for many points (M, 2) and rays (K, M, radians) that begin at
    any angle: that would take thirty times as many samples. (x, y) and `reach` are in cells, cell
    ``[0, 0]`` from 0 to 1. The result is (K * M, N) uint8, 0 beyond the image.

    Examples
    --------
    >>> image = np.array([[0, 100, 200, 0]], np.uint8)
    >>> unwrapped(image, np.array([[0.5, 0.5]]), np.zeros((1, 1)), 2.0).tolist()
    [[0, 50, 100, 150, 200]]
    """
    rho = np.arange(int(reach / _STEP) + 1, dtype=np.float32) * np.float32(_STEP)
    x, y = (
        (start - 0.5).astype(np.float32)[:, None] + way.astype(np.float32)[..., None] * rho
        for start, way in ((origin[:, 0], np.cos(rays)), (origin[:, 1], np.sin(rays)))
    )
    shape = rays.size, len(rho)
    out = cv2.remap(image, x.reshape(shape), y.reshape(shape), cv2.INTER_LINEAR)
    return np.asarray(out, dtype=np.uint8)


def _first_wall(polar: npt.NDArray[np.uint8]) -> Float32Array:
    """Cells along each row (ray) to where it enters the first wall; inf if it meets none."""
    ray, first = np.arange(len(polar)), (polar >= HIT).argmax(axis=1)
    after, before = (polar[ray, np.maximum(first - k, 0)].astype(np.float32) for k in (0, 1))
    # Between the two samples, where the interpolated occupancy passes one half.
    back = np.clip((after - SURFACE) / np.maximum(after - before, 1), 0, 1)
    cells = (first - np.where(first > 0, back, 0)) * np.float32(_STEP)
    return np.where(after >= HIT, cells, np.float32(np.inf))


def _first_clear(
    occupied: BoolArray, xy: FloatArray, normal: FloatArray, resolution: float
) -> FloatArray:
    """Metres in front of each point where the first cell lies that is not occupied."""
    off = np.full(len(xy), _OFF[-1])
    for step in reversed(_OFF):
        at = np.nan_to_num(xy / resolution + step * normal)
        off[~values_at(occupied, at, 1.0)] = step
    return off * resolution
