"""What every engine shares: offsets in cells, the stack to fill, threads over its slices."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from imgloc.errors import ConfigError
from imgloc.model import BoolArray, Float32Array, FloatArray, IntArray

Unit = TypeVar("Unit")

# Beyond this a shift misses every map; the bound keeps the cast to integers defined.
MAX_OFFSET = 2.0**30


def cell_offsets(xy: FloatArray, thetas: FloatArray, resolution: float) -> IntArray:
    """How many cells away from a pose each scan point falls, for each heading.

    A pose sits at the centre of its cell, so the cell that holds ``p ⊕ (x, y, theta)`` (Alg. 1,
    l. 5) is its own plus ``floor(R_theta p / resolution + 0.5)`` wherever it is, which turns Alg. 1
    into Alg. 2. (K, N, 2) int, rows and columns; the parameters, all finite, are as of
    :func:`~imgloc.likelihoods.correlate.correlate`.

    Examples
    --------
    >>> cell_offsets(np.array([[0.24, 0.0]]), np.array([0.0, np.pi / 2]), 0.1).tolist()
    [[[0, 2]], [[2, 0]]]
    """
    c, s = np.cos(thetas)[:, None] / resolution, np.sin(thetas)[:, None] / resolution
    x, y = np.asarray(xy, dtype=np.float64).T
    d = np.stack((s * x + c * y, c * x - s * y), axis=-1)
    return np.asarray(np.floor(np.clip(d, -MAX_OFFSET, MAX_OFFSET) + 0.5), dtype=np.int64)


def reach_of(offsets: IntArray, shape: tuple[int, ...]) -> tuple[BoolArray, tuple[int, int]]:
    """Which offsets (K, N) meet an image at all, and how many rows and columns those reach."""
    near = np.all(np.abs(offsets) < shape[-2:], axis=2)  # the others miss from every pose
    reach = np.where(near[..., None], np.abs(offsets), 0).max(axis=(0, 1), initial=0)
    return near, (int(reach[0]), int(reach[1]))


def check_arguments(resolution: float, threads: int) -> None:
    """Raise a ConfigError for a resolution or a number of threads that cannot be meant."""
    if not (np.isfinite(resolution) and resolution > 0):
        raise ConfigError(f"resolution must be a positive number of metres, got {resolution}")
    if threads < 1:
        raise ConfigError(f"threads must be at least 1, got {threads}")


class Frame(NamedTuple):
    """What of a stack is to be computed."""

    out: Float32Array  #: (K, H, W) the stack; 0 around the view
    view: Float32Array  #: (K, h, w) the part of it to compute
    window: tuple[slice, slice]  #: rows and columns of the view
    where: BoolArray | None  #: (h, w) the poses in it that are wanted; None for all


def frame_of(
    marked: BoolArray, headings: int, where: BoolArray | None, out: Float32Array | None
) -> Frame:
    """Cut a stack down to what matters: poses that are wanted (`where`), cells that are `marked`.

    Maps often carry a wide unknown border. A mask or a stack that does not fit the (H, W) of
    `marked` is a ValueError.

    Examples
    --------
    >>> where = np.zeros((4, 5), dtype=bool)
    >>> where[1, 1:3] = True
    >>> frame_of(np.zeros((4, 5), dtype=bool), 1, where, None).window
    (slice(1, 2, None), slice(1, 3, None))
    """
    height, width = shape = marked.shape
    if where is not None and (where.shape != shape or where.dtype != np.bool_):
        raise ValueError(f"where must be bool {shape}, got {where.dtype} {where.shape}")
    out = output_stack(out, (headings, height, width))
    if where is None:
        return Frame(out, out, (slice(0, height), slice(0, width)), None)
    window = box_of(where | marked)
    view = out[:, *window]
    if view.shape != out.shape:
        out.fill(0)
    return Frame(out, view, window, where[window])


def box_of(mask: BoolArray) -> tuple[slice, slice]:
    """Rows and columns from the first to the last in which something is set."""
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    if not rows.size:
        return slice(0, 0), slice(0, 0)
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


def output_stack(out: Float32Array | None, shape: tuple[int, int, int]) -> Float32Array:
    """Return `out`, unless it does not fit (a ValueError), or a new uninitialised stack.

    Reusing a stack saves the page faults of a new one: for tens of megabytes as much as an engine.
    """
    if out is None:
        return np.empty(shape, dtype=np.float32)
    if out.shape != shape or out.dtype != np.float32 or not out.flags.c_contiguous:
        raise ValueError(
            f"out must be a C-contiguous float32 array of shape {shape}, "
            f"got {out.dtype} of shape {out.shape}"
        )
    if not out.flags.writeable:
        raise ValueError("out must be writable")
    return out


#: What is left to do with a slice (H, W) of a stack, in place, while it is in the cache.
Finish = Callable[[Float32Array], object]


def finishing(divisor: float, where: BoolArray | None = None) -> Finish:
    """Divide a slice, and clear the poses that are not wanted.

    Examples
    --------
    >>> image = np.array([[4, 6]], np.float32)
    >>> finishing(2.0, np.array([[True, False]]))(image)
    >>> image.tolist()
    [[2.0, 0.0]]
    """
    # A product of bool and float32 would convert the mask anew for each slice.
    mask = None if where is None else where.astype(np.float32)

    def finish(image: Float32Array) -> None:
        if divisor != 1:
            np.divide(image, np.float32(divisor), out=image)
        if mask is not None:
            np.multiply(image, mask, out=image)

    return finish


def over_slices(
    work: Callable[[Sequence[Unit]], object], units: Sequence[Unit], threads: int
) -> None:
    """Call ``work(share)`` for disjoint shares of `units`, one share per thread.

    A share per thread, and not a task per unit, lets `work` allocate its scratch once.

    Examples
    --------
    >>> done = []
    >>> over_slices(done.extend, [0, 1, 2], threads=2)
    >>> sorted(done)
    [0, 1, 2]
    """
    threads = min(threads, len(units))
    if threads <= 1:
        work(units)
        return
    with ThreadPoolExecutor(threads) as pool:
        for future in [pool.submit(work, units[i::threads]) for i in range(threads)]:
            future.result()


def finite_points(xy: npt.ArrayLike) -> FloatArray:
    """Return the points (N, 2) that are finite; a lost reading casts no vote."""
    points = np.asarray(xy, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 2:
        raise ValueError(f"points must have shape (N, 2), got {points.shape}")
    return np.asarray(points[np.isfinite(points).all(axis=1)])
