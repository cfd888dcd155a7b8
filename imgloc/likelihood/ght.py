"""GHT and GHT-V: every pair of a map point and a scan point votes for a pose (Secs. IV, V).

Each scan point is put into the frame of its own surface once, ``q_i = R(-alpha_i) p_i``. The
pose of a pair is then ``t = p_j - R(alpha_j) q_i``: no trigonometry for each pair. And the
direction from p_j to t, seen from the normal of p_j, is that of ``-q_i`` whatever j is, so
that the visibility test of Alg. 5 compares one row of `visibility` with ``|p_i|``.
The arithmetic is in :mod:`imgloc.likelihood.votes`, the two options of Sec. VII are there and
in :mod:`imgloc.likelihood.uncertainty`.
"""

import numpy as np

from imgloc.errors import ConfigError
from imgloc.likelihood.slices import check_arguments, output_stack
from imgloc.likelihood.uncertainty import Uncertainty, vote_spread
from imgloc.likelihood.votes import vote
from imgloc.model import Float32Array, OrientedPoints


def ght(
    surface: OrientedPoints,
    points: OrientedPoints,
    n_theta: int,
    shape: tuple[int, int],
    resolution: float,
    *,
    once: bool = False,
    uncertainty: Uncertainty | None = None,
    threads: int = 1,
    out: Float32Array | None = None,
) -> Float32Array:
    """Count, for every pose, the pairs of points that it brings together: GHT, Alg. 4.

    Parameters
    ----------
    surface : OrientedPoints
        Surface points of the map, grid frame, metres. Neighbours along a wall should be
        neighbours in the list: their votes then are neighbours in memory.
    points : OrientedPoints
        Scan points, sensor frame, metres. In both sets, points without a valid normal or with
        coordinates that are not finite cast no vote.
    n_theta : int
        Number K of headings, ``theta_k = 2 pi k / K``.
    shape : (int, int)
        Rows and columns of the lattice of votes; its lower-left corner is that of the grid.
    resolution : float
        Side of a cell of that lattice, metres. It need not be that of the map.
    once : bool
        At most one vote of each scan point in a cell, Sec. VII. A wall casts many votes in
        the cells along it; this counts the scan points that a pose explains.
    uncertainty : Uncertainty, optional
        Spread each vote over the poses that eq. 8 allows for, given the errors of its terms.
        With `once` too, a scan point adds no more than 1 to a cell, before the blur.
    threads : int
        Number of threads. Each beyond the first needs a stack of its own; the result does not
        depend on their number.
    out : (K, H, W) float32 array, optional
        Stack to overwrite and return, instead of a new one.

    Returns
    -------
    (K, H, W) float32 array
        Votes ``L[theta, y, x]``; a vote off the lattice is lost. Whole numbers, unless there
        is an `uncertainty`.

    Raises
    ------
    ConfigError
        If `n_theta`, `shape`, `resolution` or `threads` is out of its range.
    ValueError
        If `out` has a wrong shape or type.

    Examples
    --------
    A wall point that faces left, seen two metres ahead:

    >>> wall = OrientedPoints([[2.5, 0.5]], [np.pi], [0.1], [True])
    >>> scan = OrientedPoints([[2.0, 0.0]], [np.pi], [0.1], [True])
    >>> np.argwhere(ght(wall, scan, 4, (1, 3), 1.0)).tolist()
    [[0, 0, 0]]
    """
    return _vote(surface, None, points, n_theta, shape, resolution, once, uncertainty, threads, out)


def ght_v(
    surface: OrientedPoints,
    visibility: Float32Array,
    points: OrientedPoints,
    n_theta: int,
    shape: tuple[int, int],
    resolution: float,
    *,
    once: bool = False,
    uncertainty: Uncertainty | None = None,
    threads: int = 1,
    out: Float32Array | None = None,
) -> Float32Array:
    """Count the pairs whose pose is visible from the map point: GHT-V, Alg. 5.

    Parameters
    ----------
    visibility : (n_psi, M) float32 array
        ``visibility[b, j]`` is the distance in metres from surface point j to the nearest
        obstacle in the direction ``2 pi b / n_psi`` counted **from its normal**; infinite when
        there is none. The pair (i, j) votes iff ``visibility[b, j] > |p_i|``.
    surface, points, n_theta, shape, resolution, once, uncertainty, threads, out
        As in :func:`ght`.

    Returns
    -------
    (K, H, W) float32 array
        Votes ``L[theta, y, x]``.

    Raises
    ------
    ConfigError
        If `n_theta`, `shape`, `resolution` or `threads` is out of its range.
    ValueError
        If `visibility` does not have a column for each surface point, or `out` does not fit.

    Examples
    --------
    The same wall behind a pane one metre in front of it: the pose two metres off is not seen.

    >>> wall = OrientedPoints([[2.5, 0.5]], [np.pi], [0.1], [True])
    >>> scan = OrientedPoints([[2.0, 0.0]], [np.pi], [0.1], [True])
    >>> pane = np.full((8, 1), 1.0, dtype=np.float32)
    >>> float(ght_v(wall, pane, scan, 4, (1, 3), 1.0).sum())
    0.0
    """
    visibility = np.asarray(visibility, dtype=np.float32)
    if visibility.ndim != 2 or not visibility.shape[0] or visibility.shape[1] != len(surface):
        raise ValueError(
            f"visibility must be (n_psi, {len(surface)}), a column for each surface point, "
            f"got {visibility.shape}"
        )
    return _vote(
        surface, visibility, points, n_theta, shape, resolution, once, uncertainty, threads, out
    )


def _vote(
    surface: OrientedPoints,
    visibility: Float32Array | None,
    points: OrientedPoints,
    n_theta: int,
    shape: tuple[int, int],
    resolution: float,
    once: bool,
    uncertainty: Uncertainty | None,
    threads: int,
    out: Float32Array | None,
) -> Float32Array:
    """Alg. 5, and Alg. 4 without visibility."""
    check_arguments(resolution, threads)
    height, width = shape
    if n_theta < 1 or height < 1 or width < 1:
        raise ConfigError(f"the lattice of votes must not be empty, got {(n_theta, *shape)}")
    out = output_stack(out, (n_theta, height, width))
    out.fill(0)
    if uncertainty is None:
        vote(surface, visibility, points, resolution, out, once=once, threads=threads)
    else:
        vote_spread(
            surface, visibility, points, resolution, uncertainty, out, once=once, threads=threads
        )
    return out
