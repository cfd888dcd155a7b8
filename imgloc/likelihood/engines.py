"""Which engine of the correlation costs least: a model of a few measured constants."""

from collections.abc import Callable, Sequence

import numpy as np

from imgloc.errors import ConfigError
from imgloc.likelihood.flat import FLAT_CELLS
from imgloc.likelihood.shift import Tile, merge_repeats
from imgloc.model import IntArray

ENGINES = ("filter2d", "shift", "dft")

# Measured on one core of a server CPU. Only their ratios matter, and only to `auto`.
SHIFT_SECONDS_PER_BYTE = 2.9e-11
SHIFT_SECONDS_PER_CALL = 3.5e-6
FLAT_SECONDS_PER_CALL = 6e-7
DFT_SECONDS_PER_STEP = 1.4e-10
DFT_CACHE = 4.5e6  # bytes of a plane; a larger one
DFT_BEYOND_CACHE = 1.3  # costs so many times as much


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
    """Return `engine`, or for ``"auto"`` the one of ``shift`` and ``dft`` with the lower cost.

    ``filter2d`` is never chosen: OpenCV runs it as a DFT too, of the scan anew for each tile.

    Parameters
    ----------
    engine : str
        One of :data:`ENGINES` or ``"auto"``.
    offsets : (K, N, 2) int array
        Of :func:`~imgloc.likelihood.slices.cell_offsets`.
    shape : (int, int)
        Rows and columns.
    tiles : sequence of Tile
        Where the shift engine would compute.
    itemsize : int
        Bytes of a cell of the shift engine's sums.
    flat : bool
        Whether :func:`~imgloc.likelihood.flat.flat_stack` would compute them: :func:`is_flat`.
    components : int
        Correlations to add up: 1 for a scalar image, 2 for a vector field (``dft`` only).
    which : (K, N) int array, optional
        Image that each reading takes its values from, if there are several (``shift`` only).
    doubtful : callable
        Tells whether the transforms need double precision, asked if it matters (``dft`` only).

    Raises
    ------
    ConfigError
        If there is no such engine.
    """
    if engine in ENGINES:
        return engine
    if engine != "auto":
        raise ConfigError(f"engine must be one of auto, {', '.join(ENGINES)}, got {engine!r}")
    height, width = shape
    down, across = np.moveaxis(np.abs(offsets[:: max(1, len(offsets) // 8)]), -1, 0)
    rows, columns = min(down.max(initial=0), height), min(across.max(initial=0), width)
    if flat:
        near = (down < height) & (across < width)  # the others miss from every pose
        pad = (across * near).max(initial=0)
        line = height * (width + int(pad)) * itemsize * SHIFT_SECONDS_PER_BYTE
        readings = np.count_nonzero(near) / max(1, len(near))
        shift = float(readings * (line + FLAT_SECONDS_PER_CALL))
    else:
        shift = _shift_seconds(offsets, shape, tiles, itemsize, which)
    plane = float((height + rows) * (width + columns))
    # One transform back, half a transform forth (two headings share it) and a product.
    dft = DFT_SECONDS_PER_STEP * plane * np.log2(plane + 1) * (1.2 + 0.8 * components)
    single, double = (
        dft * size / 4 * (DFT_BEYOND_CACHE if plane * size > DFT_CACHE else 1) for size in (4, 8)
    )
    return "shift" if shift < single or (shift < double and doubtful()) else "dft"


def _shift_seconds(
    offsets: IntArray,
    shape: tuple[int, int],
    tiles: Sequence[Tile],
    itemsize: int,
    which: IntArray | None,
) -> float:
    """What a heading costs by :func:`shift_stack`, judged from a few headings."""
    height, width = shape
    some = slice(None, None, max(1, len(offsets) // 8))
    sample = np.abs(offsets[some])
    overlap = np.maximum(0, height - sample[..., 0]) * np.maximum(0, width - sample[..., 1])
    if which is None:
        which = np.zeros(offsets.shape[:2], dtype=np.int64)
    merged = [len(merge_repeats(o, w)[0]) for o, w in zip(offsets[some], which[some], strict=True)]
    readings = float(np.mean(merged)) if merged else 0.0
    share = sum((t.r1 - t.r0) * (t.c1 - t.c0) for t in tiles) / (height * width)
    cells = readings * share * float(overlap.mean()) if overlap.size else 0.0
    seconds = cells * itemsize * SHIFT_SECONDS_PER_BYTE
    return seconds + readings * len(tiles) * SHIFT_SECONDS_PER_CALL


def is_flat(offsets: IntArray, shape: tuple[int, ...]) -> bool:
    """Whether the image with its padding is small enough for :func:`flat_stack`."""
    columns = min(int(np.abs(offsets[..., 1]).max(initial=0)), shape[1])
    return shape[0] * (shape[1] + columns) <= FLAT_CELLS
