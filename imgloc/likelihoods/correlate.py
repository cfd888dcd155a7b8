"""Correlate a scan, turned to every heading, with an image: the core of CBML and CBML-O.

``filter2d`` draws the scan as a kernel and is the engine to read. ``shift`` adds shifted views,
Alg. 2 as printed. ``dft`` multiplies spectra. These three compute the same. Which one is fastest
depends on the reach in cells and on the number of readings, so ``auto`` estimates their costs.
``remap`` turns the image under the upright scan, and interpolates.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from imgloc.errors import ConfigError
from imgloc.likelihoods.kernels import filter2d_stack, remap_stack
from imgloc.likelihoods.shift import (
    Summable,
    Tile,
    flat_stack,
    merge_repeats,
    shift_stack,
    tiles_of,
)
from imgloc.likelihoods.slices import (
    Stack,
    cell_offsets,
    check_arguments,
    finishing,
    finite_points,
    frame_of,
)
from imgloc.likelihoods.spectral import needs_double, spectral_stack
from imgloc.model import BoolArray, Float32Array, FloatArray, IntArray

#: Engines that take weights for the values of an image, or for the vectors of a field.
WEIGHTED = {"filter2d": filter2d_stack, "dft": spectral_stack}
EXACT = ("filter2d", "shift", "dft")
ENGINES = (*EXACT, "remap")

# Cells of an image, with padding, up to which flat_stack is the faster way to shift.
FLAT_CELLS = 1 << 17
# Measured on one core of a server CPU. Only their ratios matter, and only to `auto`.
SHIFT_SECONDS_PER_BYTE = 2.9e-11
SHIFT_SECONDS_PER_CALL = 3.5e-6
FLAT_SECONDS_PER_CALL = 6e-7
DFT_SECONDS_PER_STEP = 1.4e-10
DFT_SECONDS_PER_HEADING = 4.5e-5
DFT_CACHE = 4.5e6  # bytes of a plane that fits the cache
DFT_BEYOND_CACHE = 1.3  # factor on the cost of a larger plane


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
    out: Stack | None = None,
) -> Stack:
    """Sum the image under every point of a scan, for every pose (Alg. 1 and 2).

    ``L[k, r, c] = sum_i image[cell of p_i ⊕ (x, y, theta_k)]`` with (x, y) the centre of cell
    ``[r, c]``; float32 (K, H, W). A point that falls off the image adds nothing.

    Parameters
    ----------
    image : (H, W) uint8 or float32 array
        Row 0 is the lowest y. The engines of :data:`EXACT` sum integers exactly. On floats they
        agree up to rounding.
    xy : (N, 2) float array
        Scan points, sensor frame, metres. Points that are not finite are left out.
    thetas : (K,) float array
        Headings, radians.
    resolution : float
        Side of a cell, metres.
    divisor : float
        Divisor of the sums.
    engine : {"auto", "filter2d", "shift", "dft", "remap"}
        How to compute it.
    threads : int
        Number of threads, each for some headings. The result does not depend on it.
    where : (H, W) bool array, optional
        Cells whose poses are wanted. The others are 0. Tiles without a wanted pose are skipped.
    out : (K, H, W) float32 or uint8 array, optional
        Stack to overwrite and return, instead of a new float32 one. Bytes are for a uint8 image
        whose largest value, once for each point, sums up to at most 255, and for no `divisor`.

    Raises
    ------
    ConfigError, ValueError
        If `engine`, `threads` or `resolution` is out of its range; if an array does not fit.

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
    points, headings = finite_points(xy), np.asarray(thetas, dtype=np.float64)
    frame = frame_of(image != 0, len(headings), where, out)
    view, image = frame.view, image[frame.window]
    bytes_fit = image.dtype == np.uint8 and len(points) * int(image.max(initial=0)) <= 255
    if view.dtype == np.uint8 and not (bytes_fit and divisor == 1):
        raise ValueError("the sums do not fit out, an array of bytes")
    if view.size == 0:
        return frame.out
    shape = (int(image.shape[0]), int(image.shape[1]))
    offsets = cell_offsets(points, headings, resolution)
    integers = image.dtype == np.uint8
    # The image in the type of its sums, and how many of its largest value that type can sum. A few
    # points on an image of few levels are summed in bytes.
    top = max(1, int(image.max())) if integers else 1
    kind = np.uint8 if bytes_fit else np.uint16
    wide: Summable = image.astype(kind, copy=False) if integers else np.ascontiguousarray(image)
    limit = np.iinfo(kind if integers else np.int32).max // top
    tiles = tiles_of(shape, frame.where)
    pad = min(int(np.abs(offsets[..., 1]).max(initial=0)), shape[1])
    flat = shape[0] * (shape[1] + pad) <= FLAT_CELLS
    engine = choose_engine(
        engine, offsets, shape, tiles, itemsize=wide.itemsize, flat=flat,
        doubtful=lambda: integers and needs_double(image, offsets[:: max(1, len(offsets) // 8)]),
    )  # fmt: skip
    if engine == "shift" and flat:
        flat_stack(wide, limit, offsets, view, where=frame.where)
        finishing(divisor)(view)
        return frame.out
    finish = finishing(divisor, frame.where, view.dtype)
    once = np.zeros(len(points), dtype=np.int64)

    def scan(cells: IntArray) -> tuple[IntArray, IntArray, IntArray]:
        """Each distinct offset of integers once."""
        return merge_repeats(cells, once) if integers else (cells, once, once)

    if engine == "shift":
        shift_stack([wide], lambda k: scan(offsets[k]), limit, tiles, threads, view, finish)
    elif engine == "remap":
        upright = scan(cell_offsets(points, np.zeros(1), resolution)[0])
        remap_stack(
            image, headings, lambda turned, _: [turned.astype(wide.dtype, copy=False)], upright,
            limit, threads, view, finish,
        )  # fmt: skip
    else:
        weights = np.broadcast_to(np.float32(1), (len(headings), 1, len(points)))
        WEIGHTED[engine](image[None], offsets, weights, threads, view, integers, finish)
    return frame.out


def choose_engine(
    engine: str,
    offsets: IntArray,
    shape: tuple[int, int],
    tiles: Sequence[Tile],
    *,
    itemsize: int = 2,
    flat: bool = False,
    components: int = 1,
    which: IntArray | None = None,
    doubtful: Callable[[], bool] = lambda: False,
) -> str:
    """Return `engine`, or for ``"auto"`` the cheaper one of ``shift`` and ``dft``.

    ``filter2d`` is never chosen, because OpenCV runs it as a DFT, too, and transforms the scan anew
    for each tile. ``remap`` is never chosen, because it interpolates. A name that is neither
    ``"auto"`` nor in :data:`ENGINES` raises a ConfigError.

    `offsets` (K, N, 2) are those of the readings, in cells, and `shape` is that of the image. The
    cost of ``shift`` depends on the `tiles`, the bytes of a cell of its sums, whether
    :func:`~imgloc.likelihoods.shift.flat_stack` does it, and `which` (K, N) images are read if
    there are several. The cost of ``dft`` depends on the `components`, 2 for a vector field, and on
    a function that returns whether double precision is needed.
    """
    if engine in ENGINES:
        return engine
    if engine != "auto":
        raise ConfigError(f"engine must be one of auto, {', '.join(ENGINES)}, got {engine!r}")
    height, width = shape
    some = slice(None, None, max(1, len(offsets) // 8))  # a few headings tell
    sample = np.abs(offsets[some])
    down, across = np.moveaxis(sample, -1, 0)
    rows, columns = min(down.max(initial=0), height), min(across.max(initial=0), width)
    if flat:
        near = (down < height) & (across < width)  # the others miss from every pose
        pad = (across * near).max(initial=0)
        line = height * (width + int(pad)) * itemsize * SHIFT_SECONDS_PER_BYTE
        readings = float(np.count_nonzero(near)) / max(1, len(near))
        shift = readings * float(line + FLAT_SECONDS_PER_CALL)
    else:
        overlap = np.maximum(0, height - down) * np.maximum(0, width - across)
        images = np.zeros(sample.shape[:2], np.int64) if which is None else which[some]
        merged = [len(merge_repeats(o, w)[0]) for o, w in zip(offsets[some], images, strict=True)]
        readings = float(np.mean(merged)) if merged else 0.0
        share = sum(math.prod(t.shape) for t in tiles) / (height * width)
        cells = readings * share * float(overlap.mean()) if overlap.size else 0.0
        shift = cells * itemsize * SHIFT_SECONDS_PER_BYTE
        shift += readings * len(tiles) * SHIFT_SECONDS_PER_CALL
    plane = float((height + rows) * (width + columns))
    # One transform back, half a transform forth (two headings share it) and a product.
    dft = DFT_SECONDS_PER_STEP * plane * np.log2(plane + 1) * (1.6 + 0.4 * components)
    single, double = (
        DFT_SECONDS_PER_HEADING
        + dft * size / 4 * (DFT_BEYOND_CACHE if components * plane * size > DFT_CACHE else 1)
        for size in (4, 8)
    )
    return "shift" if shift < single or (shift < double and doubtful()) else "dft"
