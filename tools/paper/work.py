"""How much work the algorithms do, counted: what no busy machine can blur.

The counts follow from the offsets, the points and the visibility map, exactly, without a run and
without a counter in anybody's inner loop.
"""

import numpy as np

from imgloc.features.raydistance import canvas_size
from imgloc.likelihoods.ght import pair_up
from imgloc.likelihoods.slices import cell_offsets, finite_points
from imgloc.model import Float32Array, FloatArray, OrientedPoints


def pixels_added(
    xy: FloatArray, thetas: FloatArray, shape: tuple[int, int], resolution: float
) -> int:
    """Count the pixels that CBML and CBML-O add up: how often l. 5 of Alg. 2 meets the map.

    `xy` (N, 2) are finite scan points, sensor frame, metres, `thetas` (K,) headings in radians. As
    in the listing, readings that share a cell count one by one; the engines may add them at once.

    Examples
    --------
    >>> pixels_added(np.array([[1.0, 0.0]]), np.array([0.0, np.pi / 2]), (2, 5), 1.0)
    13
    """
    height, width = shape
    reach = np.abs(cell_offsets(finite_points(xy), thetas, resolution))
    rows, columns = np.maximum(0, height - reach[..., 0]), np.maximum(0, width - reach[..., 1])
    return int((rows * columns).sum())


def votes_cast(
    surface: OrientedPoints, visibility: Float32Array | None, points: OrientedPoints
) -> int:
    """Count the votes of GHT-V, and of GHT without visibility: how often l. 6 of Alg. 5 runs.

    Arguments as of :func:`imgloc.likelihoods.ght.ght_v`; votes off the lattice are counted, too.

    Examples
    --------
    >>> wall = OrientedPoints([[2.0, 0.0], [9.0, 0.0]], [np.pi, np.pi], [0.1, 0.1], [True, True])
    >>> scan = OrientedPoints([[1.0, 0.0]], [np.pi], [0.1], [True])
    >>> seen = np.array([[5.0, 0.5]], dtype=np.float32)
    >>> votes_cast(wall, None, scan), votes_cast(wall, seen, scan)
    (2, 1)
    """
    pairs = pair_up(surface, visibility, points, 1, 1.0)
    if pairs.visibility is None:
        return len(pairs.w) * len(pairs.x)
    return sum(
        int(np.count_nonzero(pairs.visibility[psi] > rho))  # Alg. 5, l. 5
        for psi, rho in zip(pairs.psi.ravel().tolist(), pairs.rho.ravel(), strict=True)
    )


def ray_cells(shape: tuple[int, int], n_psi: int) -> int:
    """Count the pixels of the turned maps, over which `ray_distances` walks.

    A ray tracer walks over every cell between each cell and the wall, in each direction.

    Examples
    --------
    >>> ray_cells((10, 20), 4)  # two turned maps, each with a margin, walked both ways
    1056
    """
    turns, ways = (n_psi // 2, 2) if n_psi % 2 == 0 else (n_psi, 1)
    sizes = (canvas_size(shape, 2 * np.pi * k / n_psi) for k in range(turns))
    return ways * sum(along * across for along, across in sizes)
