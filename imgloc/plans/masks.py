"""Masks of pixels: how deep, how large, in which pieces, on finer and coarser cells."""

from typing import TypeVar

import cv2
import numpy as np
import numpy.typing as npt
from skimage.morphology import disk

from imgloc.features.distance import distance_transform
from imgloc.model import BoolArray, Float32Array, IntArray

_T = TypeVar("_T", np.float32, np.int32, np.uint8)
Grey = npt.NDArray[np.uint8]  #: an image of greys
Labels = npt.NDArray[np.int32]


def depth(mask: BoolArray) -> Float32Array:
    """Distance of each pixel of a mask from the nearest one outside, beyond the border too."""
    return distance_transform(np.pad(mask, 1).astype(np.uint8))[1:-1, 1:-1]


def opened(mask: BoolArray, thickness: float) -> BoolArray:
    """The parts of a mask that are at least so many pixels thick, where they were."""
    side = max(1, round(thickness))
    radius, off = (side - 1) / 2, np.arange(side) - (side - 1) / 2
    # If the side is even, MORPH_OPEN shifts by a pixel, and MORPH_ELLIPSE is lopsided.
    disc = (abs(off) <= np.sqrt(radius**2 - off[:, None] ** 2) + 0.5).astype(np.uint8)
    after, before = (side // 2,) * 2, ((side - 1) // 2,) * 2
    cores = cv2.erode(np.pad(mask, 1).astype(np.uint8), disc, anchor=after)
    return cv2.dilate(cores, disc, anchor=before)[1:-1, 1:-1] > 0


def grown(mask: BoolArray, by: int) -> BoolArray:
    """Return a mask with all that is nearer to it than so many pixels."""
    return cv2.dilate(mask.astype(np.uint8), disk(by)) > 0


def beside(mask: BoolArray) -> BoolArray:
    """A mask with the eight pixels around each of its own."""
    return cv2.dilate(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0


def pieces(mask: BoolArray, connectivity: int = 8) -> tuple[Labels, IntArray]:
    """Labels of the connected pieces, and left, top, width, height and area of each, 0 first."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(
        mask.astype(np.uint8), connectivity=connectivity
    )
    return np.asarray(labels, np.int32), np.asarray(stats, np.int64)


def met(labels: Labels, count: int, where: BoolArray) -> BoolArray:
    """Which labels lie somewhere in a mask, (count,); 0 does not."""
    out = np.zeros(count, np.bool_)
    out[labels[where]] = True
    out[0] = False
    return out


def greatest(
    image: npt.NDArray[_T], labels: Labels, where: BoolArray, count: int
) -> npt.NDArray[_T]:
    """The greatest value of each label within a mask, (count,); 0 for one that is not there."""
    out = np.zeros(count, image.dtype)
    np.maximum.at(out, labels[where], image[where])
    return out


def coarser(mask: BoolArray, parts: int) -> Float32Array:
    """Share of each cell that is in a mask of pixels."""
    size = mask.shape[1] // parts, mask.shape[0] // parts
    out = cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    return np.asarray(out, np.float32)


def border(image: npt.NDArray[_T]) -> npt.NDArray[_T]:
    """The pixels along the four sides of an image."""
    return np.concatenate((image[0], image[-1], image[:, 0], image[:, -1]))


def finer(mask: BoolArray, parts: int) -> BoolArray:
    """Return a mask of cells as one of pixels."""
    return np.repeat(np.repeat(mask, parts, axis=0), parts, axis=1)


def spans(stats: IntArray) -> IntArray:
    """Areas of the boxes around pieces; 0 for what is none."""
    return np.append(0, stats[1:, cv2.CC_STAT_WIDTH] * stats[1:, cv2.CC_STAT_HEIGHT])


def span(drawn: BoolArray) -> int:
    """Pixels of the box around all that is drawn."""
    _, _, wide, high = cv2.boundingRect(drawn.astype(np.uint8))
    return int(wide * high)


def closed(mask: BoolArray, by: float) -> BoolArray:
    """Return a mask without gaps of so many pixels."""
    kernel = np.ones((2 * round(by / 2) + 1,) * 2, np.uint8)
    return cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, kernel) > 0
