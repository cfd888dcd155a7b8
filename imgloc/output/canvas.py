"""The pixels of a map that pictures begin with: cells and metres to pixels, colours, marks.

Row 0 of a grid is the lowest y and row 0 of a picture is at the top: the flip happens here
and nowhere else. What is around the pixels is in :mod:`imgloc.output.plots`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from imgloc.io.files import PathLike, write_bytes_atomic
from imgloc.io.images import encode_picture
from imgloc.model import FloatArray, GridInfo, OccupancyGrid, Pose2D

Image = npt.NDArray[np.uint8]
"""(H, W, 3) uint8, blue-green-red as OpenCV has it, row 0 at the top."""
Colour = tuple[int, int, int]

INK: Colour = (56, 47, 40)
PAPER: Colour = (255, 255, 255)
SHADE: Colour = (236, 233, 230)
GREY: Colour = (146, 140, 134)  #: of walls under what is drawn on them
# Okabe and Ito's colours, which colour-blind readers can tell apart; the best one stands out.
PALETTE: tuple[Colour, ...] = (
    (0, 94, 213), (178, 114, 0), (115, 158, 0), (167, 121, 204), (0, 159, 230), (233, 180, 86),
)  # fmt: skip
TURQUOISE: Colour = (210, 220, 105)
TRUTH: Colour = (60, 20, 220)  #: of true poses and paths
_SIDE = 1000  # pixels that the longer side of a small map has at least
_AROUND = 1.0  # metres around a building that belong to its picture
_SHIFT = 4  # positions are drawn to a sixteenth of a pixel


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture of a part of the plane: to look at, in a notebook too, to save, to draw on.

    Examples
    --------
    >>> picture = Picture(np.zeros((40, 30, 3), np.uint8), 10.0)
    >>> picture.pixels(np.array([[0.0, 0.0], [3.0, 4.0]])).tolist()
    [[-0.5, 39.5], [29.5, -0.5]]
    """

    image: Image  #: drawn on in place
    px_per_m: float = 1.0  #: pixels per metre of the map
    corner: tuple[float, float] = (0.0, 0.0)  #: the lower left one, grid frame, metres

    def save(self, path: PathLike, *, force: bool = False) -> None:
        """Write it, whole or not at all, as PNG, JPEG or WebP, by the ending of the name.

        A ConfigError for another name; an OutputError if it exists, without `force`.
        """
        data = encode_picture(self.image, Path(path).suffix.lower().replace("jpg", "jpeg")[1:])
        write_bytes_atomic(path, data, force=force)

    def __repr__(self) -> str:
        height, width = self.image.shape[:2]
        return f"<Picture of {width} x {height} pixels; save(path) writes it>"

    def _repr_png_(self) -> bytes:
        return encode_picture(self.image)

    @property
    def box(self) -> FloatArray:
        """Lower left and upper right corner (2, 2), metres."""
        size = np.array(self.image.shape[1::-1]) / self.px_per_m
        return np.array([self.corner, self.corner + size])

    def pixels(self, xy: FloatArray) -> FloatArray:
        """Positions (N, 2) in metres as (N, 2) pixels, whose centres are at integers."""
        away = np.asarray(xy, dtype=np.float64).reshape(-1, 2) - self.corner
        x, y = away.T * self.px_per_m
        return np.column_stack((x - 0.5, len(self.image) - 0.5 - y))

    def _fixed(self, xy: FloatArray) -> npt.NDArray[np.int32]:
        return np.rint(self.pixels(xy) * (1 << _SHIFT)).astype(np.int32)

    def dots(self, xy: FloatArray, colour: Colour, radius: float) -> None:
        """Draw a disc of `radius` pixels at each of the points (N, 2), in metres."""
        r = round(radius * (1 << _SHIFT))
        for x, y in self._fixed(xy).tolist():
            cv2.circle(self.image, (x, y), r, colour, cv2.FILLED, cv2.LINE_AA, _SHIFT)

    def lines(self, ends: FloatArray, colour: Colour, thickness: int = 1) -> None:
        """Draw polylines (N, P, 2), in metres."""
        fixed = self._fixed(ends).reshape(*ends.shape[:-1], 1, 2)
        cv2.polylines(self.image, list(fixed), False, colour, thickness, cv2.LINE_AA, _SHIFT)

    def polygon(self, xy: FloatArray, colour: Colour, opacity: float = 1.0) -> None:
        """Fill a polygon (N, 2), in metres, with a translucent colour."""
        layer = self.image.copy() if opacity < 1 else self.image
        cv2.fillPoly(layer, [self._fixed(xy)], colour, cv2.LINE_AA, _SHIFT)
        if opacity < 1:
            cv2.addWeighted(layer, opacity, self.image, 1 - opacity, 0, dst=self.image)

    def robot(self, x: float, y: float, theta: float, colour: Colour, size: float) -> None:
        """Draw a pose: a disc of `size` pixels with a nose that points along theta."""
        r = size / self.px_per_m
        nose = np.array([(2.1, 0.0), (0.45, 0.9), (0.45, -0.9)]) * r
        c, s = np.cos(theta), np.sin(theta)
        tip = nose @ np.array([[c, s], [-s, c]]) + (x, y)
        for grow, ink in ((2, PAPER), (0, colour)):
            self.dots(np.array([[x, y]]), ink, size + grow)
            outline, thick = [self._fixed(tip)], 1 + 2 * grow
            cv2.polylines(self.image, outline, True, ink, thick, cv2.LINE_AA, _SHIFT)
            self.polygon(tip, ink)
        self.dots(np.array([[x, y]]), PAPER, 0.45 * size)


@dataclass(frozen=True, eq=False)
class Part:
    """The part of a grid that is drawn, and how large."""

    box: FloatArray | None = None  #: two corners (2, 2), grid frame, metres; without them, all
    scale: int | None = None  #: pixels of a cell; by default a side has 1000 or more
    most: int = 4000  #: cells of a side; of more, several share a pixel


WHOLE = Part()


def sheet(
    cells: npt.NDArray[np.uint8], grid: GridInfo, part: Part = WHOLE,
    palette: Sequence[Colour] = (),
) -> Picture:  # fmt: skip
    """Draw cells as squares, upside up: colours (H, W, 3), or indices (H, W) of a `palette`.

    Of the cells that share a pixel the one with the greatest index is drawn, or the darkest.

    Examples
    --------
    >>> classes, info = np.array([[0, 1, 1]], np.uint8), GridInfo(1, 3, 0.5)
    >>> canvas = sheet(classes, info, Part(np.array([[0.5, 0], [1, 1]]), 1), (PAPER, INK))
    >>> canvas.image.tolist(), canvas.corner
    ([[[56, 47, 40]]], (0.5, 0.0))
    """
    cell, scale = grid.resolution, part.scale
    low, high = np.zeros(2, int), np.array(cells.shape[1::-1])
    if part.box is not None:
        low = np.clip(np.floor(part.box[0] / cell + 1e-6).astype(int), 0, high - 1)
        high = np.clip(np.ceil(part.box[1] / cell - 1e-6).astype(int), low + 1, high)
    cells = cells[low[1] : high[1], low[0] : high[0]]
    longest = max(cells.shape[:2])
    if (block := -(-longest // part.most)) > 1:
        join, square = cv2.dilate if palette else cv2.erode, np.ones((block, block), np.uint8)
        cells = np.asarray(join(cells, square, anchor=(0, 0)), np.uint8)[::block, ::block]
        scale = 1
    elif scale is None:
        scale = max(1, min(16, -(-_SIDE // longest)))
    if palette:
        cells = np.array(palette, np.uint8)[cells]
    up = np.ascontiguousarray(cells[::-1])
    image = cv2.resize(up, None, None, scale, scale, cv2.INTER_NEAREST)
    x, y = (low * cell).tolist()
    return Picture(np.asarray(image, dtype=np.uint8), scale / (cell * block), (x, y))


def faded(colour: Colour, share: float) -> Colour:
    """A colour of which `share` is left, the rest is paper.

    Examples
    --------
    >>> faded((0, 100, 200), 0.5)
    (128, 178, 228)
    """
    b, g, r = (round(255 + share * (c - 255)) for c in colour)
    return b, g, r


def enlarged(image: Image) -> float:
    """By how much words on a picture are larger than on a screen: it is read on a phone, too.

    Examples
    --------
    >>> enlarged(np.zeros((500, 1000, 3), np.uint8)), enlarged(np.zeros((3000, 900, 3), np.uint8))
    (1.0, 2.0)
    """
    return float(max(1.0, max(image.shape[:2]) / 1500))


def wheel(direction: npt.ArrayLike, strength: npt.ArrayLike) -> Image:
    """Colours (..., 3) of directions in radians, from white at strength 0 to full at 1."""
    hue = np.rint(np.asarray(direction) / (2 * np.pi) * 180).astype(np.int64) % 180
    saturation = np.rint(255 * np.broadcast_to(strength, hue.shape))
    value = 255 - 0.22 * saturation
    hsv = np.stack((hue, saturation, np.rint(value)), axis=-1).astype(np.uint8)
    if hsv.size == 0:  # which cv2 refuses
        return hsv
    bgr = cv2.cvtColor(hsv.reshape(-1, 1, 3), cv2.COLOR_HSV2BGR)
    return np.asarray(bgr, dtype=np.uint8).reshape(hsv.shape)


def map_canvas(grid: OccupancyGrid, part: Part = WHOLE, wall: Colour = GREY) -> Picture:
    """Draw a map, to draw on: free space is white, unknown space light grey."""
    classes = np.maximum(grid.free.view(np.uint8), 2 * grid.occupied.view(np.uint8))
    return sheet(classes, grid.info, part, (SHADE, PAPER, wall))


def building(grid: OccupancyGrid, poses: Sequence[Pose2D] = ()) -> Part:
    """The part of a map that it knows, and where poses are, grid frame, with a metre around.

    Examples
    --------
    >>> free = np.pad(np.ones((40, 60), bool), 100)
    >>> building(OccupancyGrid(~free & False, free, 0.1)).box.round(3).tolist()
    [[9.0, 9.0], [17.0, 15.0]]
    """
    sides = [np.flatnonzero((~grid.unknown).any(axis=axis)) for axis in (0, 1)]
    if not all(map(len, sides)):
        sides = [np.arange(n) for n in grid.occupied.shape[::-1]]
    low = np.array([[side[0], side[-1] + 1] for side in sides]).T * grid.resolution
    points = np.concatenate((low, np.array([(p.x, p.y) for p in poses]).reshape(-1, 2)))
    whole = grid.resolution * np.array(grid.occupied.shape[::-1])
    out = points.min(axis=0) - _AROUND, points.max(axis=0) + _AROUND
    return Part(np.clip(out, 0.0, whole))


def round_length(longest: float) -> float:
    """The greatest of 1, 2, 5, 10, 20 ... that is no more than `longest`.

    Examples
    --------
    >>> round_length(0.3), round_length(70.0)
    (0.2, 50.0)
    """
    decade = float(10.0 ** np.floor(np.log10(longest)))
    return decade * max(k for k in (1, 2, 5) if k * decade <= longest * (1 + 1e-9))


def deviation_ellipse(covariance: FloatArray, n: int = 64) -> FloatArray:
    """Outline (n, 2) of one standard deviation of x and y around 0, of a covariance (3, 3)."""
    values, vectors = np.linalg.eigh(covariance[:2, :2])
    s = np.linspace(0, 2 * np.pi, n)
    circle = np.column_stack((np.cos(s), np.sin(s)))
    return np.asarray((circle * np.sqrt(np.maximum(values, 0))) @ vectors.T)


def marker_size(canvas: Picture) -> float:
    """Radius of a robot in pixels: 0.25 m, but never too small to see nor very large."""
    side = max(canvas.image.shape[:2])
    return float(np.clip(0.25 * canvas.px_per_m, max(5.0, side / 160), max(9.0, side / 80)))
