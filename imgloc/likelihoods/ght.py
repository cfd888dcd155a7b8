"""GHT and GHT-V: every pair of a map point and a scan point votes for a pose (Secs. IV, V).

Each scan point is put into the frame of its own surface once, ``q_i = R(-alpha_i) p_i``. The pose
of a pair is then ``t = p_j - R(alpha_j) q_i``, without trigonometry. Seen from the normal of p_j,
the direction from p_j to t is that of ``-q_i`` for every j. The visibility test of Alg. 5 therefore
compares one row of `visibility` with ``|p_i|``. Pairs are computed in blocks that fit the cache,
without a matrix product, so that a vote does not depend on the block of its pair.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from imgloc.errors import ConfigError
from imgloc.geometry import theta_bin
from imgloc.likelihoods.slices import check_arguments, output_stack
from imgloc.model import Float32Array, FloatArray, IntArray, OrientedPoints
from imgloc.threads import over_slices

# Pairs of a block: 512 KB of float64 for each of its two buffers. Smaller blocks cost more calls,
# larger ones more cache misses.
BLOCK_PAIRS = 1 << 16
BLOCK_COLUMNS = 1 << 13
# Points this many cells off cast no vote; the bound keeps the conversion to integers defined.
OFF_CELLS = 2.0**29


def ght(
    surface: OrientedPoints,
    points: OrientedPoints,
    n_theta: int,
    shape: tuple[int, int],
    resolution: float,
    *,
    once: bool = False,
    threads: int = 1,
    out: Float32Array | None = None,
) -> Float32Array:
    """Count the pairs of points that each pose brings together: GHT, Alg. 4.

    All pairs vote. Parameters, result and errors are those of :func:`ght_v`.

    Examples
    --------
    A wall point that faces left, seen two metres ahead:

    >>> wall = OrientedPoints([[2.5, 0.5]], [np.pi], [0.1], [True])
    >>> scan = OrientedPoints([[2.0, 0.0]], [np.pi], [0.1], [True])
    >>> np.argwhere(ght(wall, scan, 4, (1, 3), 1.0)).tolist()
    [[0, 0, 0]]
    """
    return ght_v(
        surface, None, points, n_theta, shape, resolution, once=once, threads=threads, out=out
    )


def ght_v(
    surface: OrientedPoints,
    visibility: Float32Array | None,
    points: OrientedPoints,
    n_theta: int,
    shape: tuple[int, int],
    resolution: float,
    *,
    once: bool = False,
    threads: int = 1,
    out: Float32Array | None = None,
) -> Float32Array:
    """Count the pairs whose pose is visible from the map point: GHT-V, Alg. 5.

    Parameters
    ----------
    visibility : (n_psi, M) float32 array or None
        How far one sees from each map point, metres, from
        :func:`~imgloc.features.visibility.visibility_frames`. The pair (i, j) votes if and only if
        ``visibility[b, j] > |p_i|``, with b the direction of the pose. With None all pairs vote.
    surface : OrientedPoints
        Surface points of the map, grid frame, metres. Votes are fastest if the points are in order
        along the walls.
    points : OrientedPoints
        Scan points, sensor frame, metres. In both sets, points that are not finite or lack a valid
        normal cast no vote.
    n_theta : int
        Number K of headings, ``theta_k = 2 pi k / K``.
    shape : (int, int)
        Rows and columns of the lattice of votes. Its lower-left corner is that of the grid.
    resolution : float
        Side of a cell of that lattice, metres.
    once : bool
        Whether each scan point has at most one vote in a cell (Sec. VII). The votes then count the
        scan points that a pose explains. Otherwise a wall casts many votes in the cells along it.
    threads : int
        Number of threads, each with a stack of its own. The result does not depend on it.
    out : (K, H, W) float32 array, optional
        Stack to overwrite and return, instead of a new one.

    Returns
    -------
    (K, H, W) float32 array
        Votes ``L[theta, y, x]``, whole numbers. Votes off the lattice do not count.

    Raises
    ------
    ConfigError, ValueError
        If a number is out of its range; if an array does not fit.

    Examples
    --------
    The same wall behind a pane one metre in front of it: the pose two metres off is not seen.

    >>> wall = OrientedPoints([[2.5, 0.5]], [np.pi], [0.1], [True])
    >>> scan = OrientedPoints([[2.0, 0.0]], [np.pi], [0.1], [True])
    >>> pane = np.full((8, 1), 1.0, dtype=np.float32)
    >>> float(ght_v(wall, pane, scan, 4, (1, 3), 1.0).sum())
    0.0
    """
    check_arguments(resolution, threads)
    lattice = (n_theta, *shape)
    if min(lattice) < 1:
        raise ConfigError(f"the lattice of votes must not be empty, got {lattice}")
    if visibility is not None:
        visibility = np.asarray(visibility, dtype=np.float32)
        if visibility.ndim != 2 or not len(visibility) or visibility.shape[1] != len(surface):
            raise ValueError(
                f"visibility must be (n_psi, {len(surface)}), a column for each surface point, "
                f"got {visibility.shape}"
            )
    votes = output_stack(out, lattice)
    votes.fill(0)
    pairs = pair_up(surface, visibility, points, n_theta, resolution)
    blocks = blocks_of(len(pairs.w), len(pairs.x), once)
    size = max(((i.stop - i.start) * (j.stop - j.start) for i, j in blocks), default=0)
    # A stack costs about as much as half a vote for each of its cells.
    threads = min(threads, 1 + 2 * len(pairs.w) * len(pairs.x) // votes.size)
    spare, first = list[Float32Array](), iter([votes])

    def work(share: Iterable[tuple[slice, slice]]) -> None:
        stack = next(first, None)
        if stack is None:
            stack = np.zeros_like(votes)
            spare.append(stack)
        voter = Voter(pairs, stack, size, once)
        for i, j in share:
            voter.cast(i, j)

    over_slices(work, blocks, threads)
    for stack in spare:  # whole numbers: their order does not matter
        np.add(votes, stack, out=votes)
    return votes


@dataclass(frozen=True, eq=False)
class Pairs:
    """Arrays that the pairs share, in cells and bins: columns for map points, rows for scans'."""

    x: FloatArray  # (M,) p_j, columns of the lattice
    y: FloatArray
    c: FloatArray  # (M,) of alpha_j
    s: FloatArray
    u: FloatArray  # (M,) alpha_j in bins, plus a half to round and K to stay positive
    qx: FloatArray  # (N, 1) q_i
    qy: FloatArray
    w: FloatArray  # (N, 1) alpha_i in bins
    psi: IntArray  # (N,) row of `visibility`
    rho: Float32Array  # (N, 1) metres
    visibility: Float32Array | None  # (n_psi, M)


def _usable(points: OrientedPoints, resolution: float) -> npt.NDArray[np.bool_]:
    """(N,) bool: points that may vote. A NaN fails the test of distance."""
    near = np.all(np.abs(points.xy) < OFF_CELLS * resolution, axis=1)
    return np.asarray(points.valid & near & np.isfinite(points.alpha))


def _bins(alpha: FloatArray, n: int, offset: float) -> FloatArray:
    """Angles in units of 2 pi / n plus an offset, wrapped to [0, n)."""
    bins = (alpha * (n / (2 * np.pi)) + offset) % n
    return np.where(bins < n, bins, 0.0)  # -1e-20 % n is n


def pair_up(
    surface: OrientedPoints,
    visibility: Float32Array | None,
    points: OrientedPoints,
    n_theta: int,
    resolution: float,
) -> Pairs:
    """Drop the points that cannot vote, and compute the values that belong to single points."""
    kept = _usable(surface, resolution)
    if not kept.all():
        surface = surface.select(kept)
        visibility = None if visibility is None else visibility[:, kept]
    points = points.select(_usable(points, resolution))
    c, s = np.cos(points.alpha), np.sin(points.alpha)
    x, y = points.xy.T
    qx, qy = c * x + s * y, c * y - s * x  # R(-alpha_i) p_i
    n_psi = 1 if visibility is None else len(visibility)
    distance = np.hypot(x, y)
    rho = distance.astype(np.float32)
    # Rounded down, vis > rho in float32 says the same as in float64.
    rho = np.where(rho > distance, np.nextafter(rho, np.float32(0)), rho)
    return Pairs(
        x=surface.xy[:, 0] / resolution,
        y=surface.xy[:, 1] / resolution,
        c=np.cos(surface.alpha),
        s=np.sin(surface.alpha),
        # The sum may round up to the next turn.
        u=np.minimum(_bins(surface.alpha, n_theta, 0.5) + n_theta, np.nextafter(2 * n_theta, 0)),
        qx=qx[:, None] / resolution,
        qy=qy[:, None] / resolution,
        w=_bins(points.alpha, n_theta, 0.0)[:, None],
        psi=theta_bin(np.arctan2(-qy, -qx), n_psi),
        rho=rho[:, None],
        visibility=visibility,
    )


def blocks_of(n: int, m: int, once: bool = False) -> list[tuple[slice, slice]]:
    """Cut the pairs of n scan points and m map points into blocks that fit the cache.

    With `once` all pairs of a scan point are in one block, whatever its size.

    Examples
    --------
    >>> blocks_of(9, 8192)
    [(slice(0, 8, None), slice(0, 8192, None)), (slice(8, 9, None), slice(0, 8192, None))]
    >>> blocks_of(2, 8200)
    [(slice(0, 2, None), slice(0, 4100, None)), (slice(0, 2, None), slice(4100, 8200, None))]
    """
    # Blocks are of equal width, because a narrow one costs as many calls as a wide one.
    columns = m if once else -(-m // max(1, -(-m // BLOCK_COLUMNS)))
    rows = max(1, BLOCK_PAIRS // max(1, columns))
    return [
        (slice(i, min(i + rows, n)), slice(j, min(j + columns, m)))
        for i in range(0, n, rows)
        for j in range(0, m, max(1, columns))
    ]


class Voter:
    """The buffers of one thread, for blocks of `size` pairs, and the votes of a block."""

    def __init__(self, pairs: Pairs, stack: Float32Array, size: int, once: bool) -> None:
        self.pairs, self.stack, self.once = pairs, stack.reshape(-1), once
        self.n_theta, self.height, self.width = stack.shape
        self.integer = np.int32 if stack.size < 2**31 else np.int64
        self.unsigned = np.dtype(f"u{np.dtype(self.integer).itemsize}")
        self.floats = np.empty((2, size))
        self.integers = np.empty((3, size), dtype=self.integer)
        self.bools = np.empty((2, size), dtype=np.bool_)

    def cast(self, i: slice, j: slice) -> None:
        """Cast the votes of the scan points `i` with the map points `j`."""
        g = self.pairs
        block = (i.stop - i.start, j.stop - j.start)
        size = block[0] * block[1]
        value, spare = self.floats[:, :size].reshape(2, *block)
        row, column, flat = self.integers[:, :size].reshape(3, *block)
        keep, test = self.bools[:, :size].reshape(2, *block)
        c, s, qx, qy = g.c[j], g.s[j], g.qx[i], g.qy[i]

        if g.visibility is None:
            keep.fill(True)
        else:
            for seen, psi, rho in zip(keep, g.psi[i].tolist(), g.rho[i], strict=True):
                np.greater(g.visibility[psi, j], rho, out=seen)  # Alg. 5, l. 5

        def cells(value: FloatArray, size: int, out: IntArray) -> None:
            """Cells of coordinates along one axis; coordinates off the lattice are misses."""
            for ufunc, bound in ((np.greater_equal, 0), (np.less, size)):
                ufunc(value, bound, out=test)
                np.logical_and(keep, test, out=keep)
            np.copyto(out, value, casting="unsafe")  # truncation is floor where it matters

        # Alg. 5, l. 4: t = p_j - R(alpha_j) q_i
        np.multiply(c, qx, out=value)
        np.multiply(s, qy, out=spare)
        np.subtract(value, spare, out=value)
        np.subtract(g.x[j], value, out=value)
        cells(value, self.width, column)
        np.multiply(s, qx, out=value)
        np.multiply(c, qy, out=spare)
        np.add(value, spare, out=value)
        np.subtract(g.y[j], value, out=value)
        cells(value, self.height, row)

        # Alg. 5, l. 3: theta = alpha_j - alpha_i, in bins 0 .. 2 K - 1, wrapped by taking the
        # smaller of k and k - K as unsigned numbers. Then the place in the stack.
        np.subtract(g.u[j], g.w[i], out=value)
        np.copyto(flat, value, casting="unsafe")
        np.multiply(row, self.width, out=row)
        np.add(column, row, out=column)
        np.subtract(flat, self.n_theta, out=row)
        k = flat.view(self.unsigned)
        np.minimum(k, row.view(self.unsigned), out=k)
        np.multiply(flat, self.height * self.width, out=flat)
        np.add(flat, column, out=flat)
        chosen = flat.reshape(-1).take(np.flatnonzero(keep))
        if not self.once:
            # Alg. 5, l. 6. Since NumPy 1.25 as fast as bincount, which needs a stack of its own.
            np.add.at(self.stack, chosen, np.float32(1))
            return
        # One scan point at a time: += adds once at a repeated index (Sec. VII), however many map
        # points vote there.
        for part in np.split(chosen, np.cumsum(np.count_nonzero(keep, axis=1))[:-1]):
            self.stack[part] += 1
