"""What the greys of a map image mean: trinary, scale and raw, after Nav2 and ROS 1."""

from typing import Any

import numpy as np
import numpy.typing as npt

from imgloc.io.images import MapImage

SEMANTICS = ("nav2", "ros1")
UNKNOWN = -1
Int8Array = npt.NDArray[np.int8]


def occupancy(
    image: MapImage,
    *,
    mode: str,
    semantics: str,
    negate: bool,
    occupied_thresh: float,
    free_thresh: float,
) -> Int8Array:
    r"""Occupancy of every pixel, as map_server would publish it.

    With ``occ = (white - mean of the channels) / white`` (its complement under `negate`):

    ============================ ===================================== =======================
    \                            ``nav2`` (map_io)                     ``ros1`` (map_server)
    ============================ ===================================== =======================
    occupied / free              occ >= / <= its threshold             occ > / < its threshold
    trinary, transparent pixel   unknown                               alpha is averaged in as
                                                                       a colour channel
    scale, between, r in (0, 1)  round(100 r); transparent: unknown    1 + 98 r; unknown only if
                                                                       alpha is 0
    raw                          the sample itself, above 100 unknown  same, after `negate`
    ============================ ===================================== =======================

    Colours are averaged, not weighed as luma: a pure green wall (0, 255, 0) is as dark as
    ``85`` for ROS and occupied, where luma would make it unknown.

    Parameters
    ----------
    image : MapImage
        Top row first.
    mode : {'trinary', 'scale', 'raw'}
    semantics : {'nav2', 'ros1'}
    negate : bool
        White is occupied.
    occupied_thresh, free_thresh : float
        0..1.

    Returns
    -------
    values : (H, W) int8 array
        Top row first; 0 free, 100 occupied, -1 unknown.

    Examples
    --------
    >>> image = MapImage(np.array([[0, 205, 254]], np.uint8), 255, "png")
    >>> occupancy(image, mode="trinary", semantics="nav2", negate=False,
    ...           occupied_thresh=0.65, free_thresh=0.196).tolist()
    [[100, -1, 0]]
    """
    pixels, white = image.pixels, image.white
    ros1 = semantics == "ros1"
    averaged = pixels
    if image.channels == 4 and not (ros1 and mode == "trinary"):
        averaged = pixels[:, :, :3]
    sums, channels = channel_sum(averaged)
    # Everything depends on the sum of the channels alone: decide once per possible sum.
    levels = np.arange(channels * white + 1, dtype=np.float64)
    full = channels * white
    if mode == "raw":
        table = _raw(levels / channels, white, negate and ros1)
    else:
        occ = levels / full if negate else (full - levels) / full
        table = _thresholded(occ, mode, ros1, occupied_thresh, free_thresh)
    values: Int8Array = table[sums]
    if image.channels == 4 and mode != "raw":
        alpha = pixels[:, :, 3]
        if not ros1:
            values[alpha < white] = UNKNOWN
        elif mode == "scale":
            values[(alpha == 0) & (values != 0) & (values != 100)] = UNKNOWN
    return values


def classify(
    values: Int8Array, *, mode: str, occupied_thresh: float, free_thresh: float
) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
    """Occupied and free cells of an occupancy image of 0..100 and -1.

    Trinary and scale have spent the thresholds already: as in AMCL, 100 is a wall, 0 is
    free, and what lies between is unknown. Raw values are occupancies in per cent and are
    compared with the thresholds here: at or above ``100 occupied_thresh``, at or below
    ``100 free_thresh``.

    Returns
    -------
    occupied, free : bool arrays shaped like `values`

    Examples
    --------
    >>> v = np.array([0, 20, 70, 100, -1], np.int8)
    >>> [a.astype(int).tolist() for a in
    ...  classify(v, mode="raw", occupied_thresh=0.65, free_thresh=0.25)]
    [[0, 0, 1, 1, 0], [1, 1, 0, 0, 0]]
    """
    high, low = (100 * occupied_thresh, 100 * free_thresh) if mode == "raw" else (100.0, 0.0)
    return values >= high, (values >= 0) & (values <= low)


def channel_sum(pixels: npt.NDArray[Any]) -> tuple[npt.NDArray[Any], int]:
    """Return the sum over the channels of (H, W) or (H, W, C) samples, and C."""
    if pixels.ndim == 2:
        return pixels, 1
    wide = np.uint32 if pixels.dtype == np.uint16 else np.uint16
    return pixels.sum(axis=2, dtype=wide), int(pixels.shape[2])


def _thresholded(
    occ: npt.NDArray[np.float64], mode: str, ros1: bool, occupied_thresh: float, free_thresh: float
) -> Int8Array:
    table = np.full(occ.shape, UNKNOWN, np.int8)
    if mode == "scale":
        r = np.clip((occ - free_thresh) / (occupied_thresh - free_thresh), 0.0, 1.0)
        # ROS 1 stores the double in a signed byte: truncation.
        table[:] = 1 + 98 * r if ros1 else np.round(100 * r)
    table[occ > occupied_thresh if ros1 else occ >= occupied_thresh] = 100
    table[occ < free_thresh if ros1 else occ <= free_thresh] = 0
    return table


def _raw(mean: npt.NDArray[np.float64], white: int, negate: bool) -> Int8Array:
    stored = np.floor(white - mean if negate else mean)
    return np.where(stored <= 100, stored, UNKNOWN).astype(np.int8)
