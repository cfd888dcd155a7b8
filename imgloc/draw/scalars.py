"""Pictures of images with one number in each cell: blurred maps, distances."""

import cv2
import numpy as np
import numpy.typing as npt

from imgloc.draw.canvas import INK, Canvas, Picture, sheet
from imgloc.draw.maps import scale_bar
from imgloc.model import GridInfo


def draw_bmap(bmap: npt.ArrayLike, grid: GridInfo, *, scale: int | None = None) -> Picture:
    """Draw a blurred map (Fig. 3): white at 0, black at 1.

    Parameters
    ----------
    bmap : (H, W) array
        0..1.
    grid : GridInfo
        Its lattice.
    scale : int, optional
        Pixels per cell.

    Returns
    -------
    (H * scale, W * scale, 3) uint8 array

    Examples
    --------
    >>> draw_bmap([[0.0, 1.0]], GridInfo(1, 2, 0.1), scale=1)[..., 0].tolist()
    [[255, 56]]
    """
    share = np.clip(np.asarray(bmap, dtype=np.float64), 0, 1)[..., None]
    canvas = sheet(np.rint(255 + share * (np.array(INK) - 255)).astype(np.uint8), grid, scale)
    return _with_bar(canvas)


def draw_distance(distance: npt.ArrayLike, grid: GridInfo, *, scale: int | None = None) -> Picture:
    """Draw distances to the nearest wall: dark at the walls, bright far from them.

    Parameters
    ----------
    distance : (H, W) array
        Metres; 0 in walls.
    grid : GridInfo
        Its lattice.
    scale : int, optional
        Pixels per cell.

    Returns
    -------
    (H * scale, W * scale, 3) uint8 array
        Every full metre is a fine line.

    Examples
    --------
    >>> draw_distance([[0.0, 0.1, 0.2]], GridInfo(1, 3, 0.1), scale=2).shape
    (2, 6, 3)
    """
    metres = np.asarray(distance, dtype=np.float64)
    grey = np.rint(255 * metres / max(float(metres.max()), 1e-12)).astype(np.uint8)
    colours = np.asarray(cv2.applyColorMap(grey, cv2.COLORMAP_VIRIDIS), dtype=np.uint8)
    floor = np.floor(metres)
    steps = np.pad(floor, ((0, 1), (0, 1)), mode="edge")
    line = (floor != steps[1:, :-1]) | (floor != steps[:-1, 1:])
    colours[line] = np.rint(0.6 * colours[line] + 0.4 * 255)
    colours[metres <= 0] = INK
    return _with_bar(sheet(colours, grid, scale))


def _with_bar(canvas: Canvas) -> Picture:
    scale_bar(canvas)
    return canvas.image
