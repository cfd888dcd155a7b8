"""Parts of every engine: offsets in cells, and the stack to fill."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from imgloc.errors import ConfigError
from imgloc.model import BoolArray, FloatArray, IntArray

#: A stack (K, H, W), or a slice of one: float32, or uint8 where every sum fits a byte.
Stack = npt.NDArray[Any]

# Beyond this a shift misses every map; the bound keeps the cast to integers defined.
MAX_OFFSET = 2.0**30


def cell_offsets(xy: FloatArray, thetas: FloatArray, resolution: float) -> IntArray:
    """Offset in cells of each scan point from a pose, for each heading: (K, N, 2) rows and columns.

    A pose sits at the centre of its cell. The cell that holds ``p ⊕ (x, y, theta)`` (Alg. 1, l. 5)
    is therefore the pose's cell plus ``floor(R_theta p / resolution + 0.5)``, wherever the pose is.
    That turns Alg. 1 into Alg. 2.

    `xy` are finite scan points (N, 2) in the sensor frame, metres, `thetas` headings (K,) in
    radians, and `resolution` is the side of a cell, metres.

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
    """Which offsets (K, N) meet an image of some `shape`, and how many rows and columns they reach.

    `offsets` (K, N, 2) are in cells.
    """
    near = np.all(np.abs(offsets) < shape[-2:], axis=2)  # the others miss from every pose
    reach = np.where(near[..., None], np.abs(offsets), 0).max(axis=(0, 1), initial=0)
    return near, (int(reach[0]), int(reach[1]))


def check_arguments(resolution: float, threads: int) -> None:
    """Raise a ConfigError if the resolution is not positive and finite, or `threads` is below 1."""
    if not (np.isfinite(resolution) and resolution > 0):
        raise ConfigError(f"resolution must be a positive number of metres, got {resolution}")
    if threads < 1:
        raise ConfigError(f"threads must be at least 1, got {threads}")


class Frame(NamedTuple):
    """The part of a stack that is to be computed."""

    out: Stack  #: (K, H, W) the stack; 0 around the view
    view: Stack  #: (K, h, w) the part to compute
    window: tuple[slice, slice]  #: rows and columns of the view
    where: BoolArray | None  #: (h, w) the wanted poses in the view; None for all


def frame_of(marked: BoolArray, headings: int, where: BoolArray | None, out: Stack | None) -> Frame:
    """Cut a stack down to the wanted poses (`where`) that can meet a `marked` cell.

    Maps often have a wide unknown border. A mask or a stack that does not fit the (H, W) of
    `marked` raises a ValueError.

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
    out = output_stack(out, (headings, height, width), (np.float32, np.uint8))
    if where is None:
        return Frame(out, out, (slice(0, height), slice(0, width)), None)
    window = box_of(where | marked)
    view = out[(slice(None), *window)]
    if view.shape != out.shape:
        out.fill(0)
    return Frame(out, view, window, where[window])


def box_of(mask: BoolArray) -> tuple[slice, slice]:
    """Rows and columns of a mask (H, W) from the first to the last one with a True."""
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    if not rows.size:
        return slice(0, 0), slice(0, 0)
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


def output_stack(
    out: Stack | None, shape: tuple[int, int, int], kinds: Sequence[npt.DTypeLike] = (np.float32,)
) -> Stack:
    """Return `out`, or a new uninitialised float32 stack of this shape if it is None.

    Reusing a stack saves the page faults of a new one, which cost as much as an engine for tens of
    megabytes. An `out` that does not fit raises a ValueError.
    """
    if out is None:
        return np.empty(shape, dtype=np.float32)
    if out.shape != shape or out.dtype not in kinds or not out.flags.c_contiguous:
        names = " or ".join(np.dtype(kind).name for kind in kinds)
        raise ValueError(
            f"out must be a C-contiguous {names} array of shape {shape}, "
            f"got {out.dtype} of shape {out.shape}"
        )
    if not out.flags.writeable:
        raise ValueError("out must be writable")
    return out


#: A last step on a slice (H, W) of a stack, in place, while the slice is in the cache.
Finish = Callable[[Stack], object]


def finishing(
    divisor: float, where: BoolArray | None = None, kind: npt.DTypeLike = np.float32
) -> Finish:
    """Make the last step: divide a slice (H, W) by `divisor`, and set it to 0 outside of `where`.

    `kind` is the slice's type. Bytes cannot be divided.

    Examples
    --------
    >>> image = np.array([[4, 6]], np.float32)
    >>> finishing(2.0, np.array([[True, False]]))(image)
    >>> image.tolist()
    [[2.0, 0.0]]
    """
    # A product of bool and float32 would convert the mask anew for each slice.
    mask = None if where is None else where.astype(kind)

    def finish(image: Stack) -> None:
        if divisor != 1:
            np.divide(image, np.float32(divisor), out=image)
        if mask is not None:
            np.multiply(image, mask, out=image)

    return finish


def finite_points(xy: npt.ArrayLike) -> FloatArray:
    """Return the points of (N, 2) that are finite, because a lost reading casts no vote."""
    points = np.asarray(xy, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 2:
        raise ValueError(f"points must have shape (N, 2), got {points.shape}")
    return np.asarray(points[np.isfinite(points).all(axis=1)])
