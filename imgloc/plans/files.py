"""Floor plans as images: read as they are drawn, not as maps; and their scale."""

import math
from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt

from imgloc.errors import ConfigError
from imgloc.io.files import PathLike
from imgloc.io.images import MAX_PIXELS, read_image
from imgloc.io.maps import channel_sum


def load_plan(path: PathLike, *, max_pixels: int = MAX_PIXELS) -> npt.NDArray[np.uint8]:
    """Load a floor plan for :func:`imgloc.plan_to_map`: PNG, JPEG and the others of `load_map`.

    Parameters
    ----------
    path : path
        Image file; a JPEG, too.
    max_pixels : int
        Larger images are refused before they are decoded.

    Returns
    -------
    (H, W) uint8 array
        Row 0 is the lowest; 255 is white. Colours are averaged, what is transparent is paper.

    Raises
    ------
    MapError
        If the file is missing, damaged, too large or no image.

    Examples
    --------
    >>> from imgloc.io.maps import bundled_maps
    >>> load_plan(bundled_maps() / "curved.png").shape
    (130, 160)
    """
    image = read_image(path, max_pixels=max_pixels, allow_lossy=True)
    colours = image.pixels[:, :, :3] if image.channels > 1 else image.pixels
    sums, channels = channel_sum(colours)
    grey = sums * (255.0 / (channels * image.white))
    if image.channels == 4:
        clear = 1 - image.pixels[:, :, 3] / image.white
        grey = grey * (1 - clear) + 255 * clear
    return np.ascontiguousarray(cv2.convertScaleAbs(grey)[::-1].astype(np.uint8))


def measured_resolution(
    distance: Sequence[float], width: float = math.inf, height: float = math.inf
) -> float:
    """Metres a pixel of an image, of two points on it and their distance.

    Parameters
    ----------
    distance : (x1, y1, x2, y2, metres)
        Pixels from the upper left corner, y down, as programs that show images count them.
    width, height : float
        Size of the image, pixels; infinite for a drawing, whose points may be anywhere.

    Raises
    ------
    ConfigError
        If a point is not on the image, the points are one, or the distance is not positive.

    Examples
    --------
    >>> measured_resolution((100, 50, 400, 450, 10.0), 600, 500)
    0.02
    """
    x1, y1, x2, y2, metres = distance
    for x, y in ((x1, y1), (x2, y2)):
        if math.isfinite(width) and not (0 <= x <= width and 0 <= y <= height):
            size = f"{width} x {height} pixels, counted from the upper left corner"
            raise ConfigError(f"`distance`: {x:g},{y:g} is not on the image, which has {size}")
    pixels = math.hypot(x2 - x1, y2 - y1)
    if pixels < (1 if math.isfinite(width) else 1e-9) or metres <= 0:
        got = f"got {pixels:g} pixels and {metres:g} m"
        raise ConfigError(f"`distance`: {got}, expected two points and metres between them")
    return metres / pixels
