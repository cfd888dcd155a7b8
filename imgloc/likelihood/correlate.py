"""Correlate a scan, turned to every heading, with an image: the core of CBML and CBML-O.

Three engines compute the same stack. ``filter2d`` draws the scan as a kernel and is the one to
read; ``shift`` adds shifted views, Alg. 2 as printed; ``dft`` multiplies spectra. Which one is
fastest depends on the reach in cells and on the number of readings, so ``auto`` estimates.
"""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from imgloc.likelihood.engines import choose_engine, is_flat
from imgloc.likelihood.flat import flat_stack
from imgloc.likelihood.kernels import filter2d_stack
from imgloc.likelihood.shift import Summable, Tile, merge_repeats, shift_stack, tiles_of
from imgloc.likelihood.slices import (
    Finish,
    cell_offsets,
    check_arguments,
    check_where,
    finishing,
    finite_points,
    output_stack,
    window_of,
)
from imgloc.likelihood.spectral import needs_double, spectral_stack
from imgloc.model import BoolArray, Float32Array, FloatArray, IntArray


def correlate(
    image: npt.NDArray[np.uint8] | Float32Array,
    xy: FloatArray,
    thetas: FloatArray,
    resolution: float,
    *,
    divisor: float = 1.0,
    engine: str = "auto",
    threads: int = 1,
    where: BoolArray | None = None,
    out: Float32Array | None = None,
) -> Float32Array:
    """Sum the image under every point of a scan, for every pose (Alg. 1 and 2).

    ``L[k, r, c] = sum_i image[cell of p_i ⊕ (x, y, theta_k)]`` with (x, y) the centre of cell
    ``[r, c]``. A point that falls off the image adds nothing.

    Parameters
    ----------
    image : (H, W) uint8 or float32 array
        Row 0 is the lowest y. Integers are summed exactly by every engine, so that the result
        does not depend on the engine; floats agree up to rounding.
    xy : (N, 2) float array
        Scan points, sensor frame, metres. Points that are not finite are left out.
    thetas : (K,) float array
        Headings, radians.
    resolution : float
        Side of a cell, metres.
    divisor : float
        What the sums are divided by.
    engine : {"auto", "filter2d", "shift", "dft"}
        How to compute it.
    threads : int
        Number of threads, over headings. The result does not depend on it.
    where : (H, W) bool array, optional
        Poses that are wanted; the others come out 0. Tiles without any are skipped.
    out : (K, H, W) float32 array, optional
        Stack to overwrite and return, instead of a new one.

    Returns
    -------
    (K, H, W) float32 array

    Raises
    ------
    ConfigError
        If `engine`, `threads` or `resolution` is out of its range.
    ValueError
        If an array has a wrong shape or type.

    Examples
    --------
    One wall cell, seen one cell ahead: the pose is one cell behind it.

    >>> image = np.zeros((3, 3), dtype=np.uint8)
    >>> image[1, 1] = 255
    >>> stack = correlate(image, np.array([[1.0, 0.0]]), np.array([0.0, np.pi / 2]), 1.0)
    >>> [tuple(map(int, pose)) for pose in np.argwhere(stack)]
    [(0, 1, 0), (1, 0, 1)]
    """
    if image.ndim != 2 or image.dtype not in (np.uint8, np.float32):
        raise ValueError(
            f"image must be (H, W) uint8 or float32, got {image.dtype} of shape {image.shape}"
        )
    check_arguments(resolution, threads)
    shape = (int(image.shape[0]), int(image.shape[1]))
    check_where(where, shape)
    points, headings = finite_points(xy), np.asarray(thetas, dtype=np.float64)
    out = output_stack(out, (len(headings), *shape))
    window = window_of(where, image != 0)
    view, image = out[:, *window], image[window]
    if view.shape != out.shape:
        out.fill(0)
    if view.size == 0:
        return out
    offsets = cell_offsets(points, headings, resolution)
    weights = np.broadcast_to(np.float32(1), (len(headings), 1, len(points)))
    integers = image.dtype == np.uint8
    wide, limit = _summable(image, len(points))
    wanted = None if where is None else where[window]
    tiles = tiles_of(view.shape[1:], wanted)
    flat = is_flat(offsets, view.shape[1:])
    engine = choose_engine(
        engine,
        offsets,
        view.shape[1:],
        tiles,
        itemsize=wide.itemsize,
        flat=flat,
        doubtful=lambda: integers and needs_double(image, offsets[:: max(1, len(offsets) // 8)]),
    )
    if engine == "shift" and flat:
        # On one thread: several would only wait for each other.
        flat_stack(wide, limit, offsets, view, where=wanted)
        finishing(divisor)(view)
        return out
    finish = finishing(divisor, wanted)
    if engine == "shift":
        _correlate_by_shift(wide, limit, offsets, tiles, threads, view, finish)
        return out
    field = image[None]
    if engine == "dft":
        spectral_stack(
            field, offsets, weights, threads, view, half_turn=1, exact=integers, finish=finish
        )
    else:
        filter2d_stack(field, offsets, weights, threads, view, exact=integers, finish=finish)
    return out


def _correlate_by_shift(
    image: Summable,
    limit: int,
    offsets: IntArray,
    tiles: Sequence[Tile],
    threads: int,
    out: Float32Array,
    finish: Finish,
) -> None:
    """Alg. 2 on one image, each distinct offset of integers once."""
    once = np.zeros(offsets.shape[1], dtype=np.int64)

    def scan(k: int) -> tuple[IntArray, IntArray, IntArray]:
        if image.dtype == np.float32:
            return offsets[k], once, once
        return merge_repeats(offsets[k], once)

    shift_stack([image], scan, limit, tiles, threads, out, finish)


def _summable(image: npt.NDArray[np.uint8] | Float32Array, points: int) -> tuple[Summable, int]:
    """The image in the type of its sums, and how often that holds its largest value.

    A few points of an image of a few levels are summed in bytes.
    """
    if image.dtype == np.float32:
        return np.ascontiguousarray(image, dtype=np.float32), np.iinfo(np.int32).max
    top = max(1, int(image.max()))
    kind = np.uint8 if points * top <= np.iinfo(np.uint8).max else np.uint16
    return image.astype(kind, copy=False), np.iinfo(kind).max // top
