"""The sheet that pictures are drawn on: cells and metres to pixels, colours, text, the map.

Row 0 of a grid is the lowest y and row 0 of a picture is at the top: the flip happens here
and nowhere else.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from imgloc.model import FloatArray, GridInfo, OccupancyGrid

Image = npt.NDArray[np.uint8]
"""(H, W, 3) uint8, blue-green-red as OpenCV has it, row 0 at the top."""
Colour = tuple[int, int, int]

INK: Colour = (56, 47, 40)
PAPER: Colour = (255, 255, 255)
SHADE: Colour = (236, 233, 230)
# Okabe and Ito's colours, which colour-blind readers can tell apart; the best one stands out.
PALETTE: tuple[Colour, ...] = (
    (0, 94, 213), (178, 114, 0), (115, 158, 0), (167, 121, 204), (0, 159, 230), (233, 180, 86),
)  # fmt: skip
TURQUOISE: Colour = (210, 220, 105)
TRUTH: Colour = (60, 20, 220)  #: of true poses and paths
LEGEND = 38  #: pixels that a legend of one line is high, on a picture up to 1500 pixels wide
_SIDE = 1000  # pixels that the longer side of a small map has at least
_LARGEST = 4000  # pixels that a part of a map may be enlarged to with all that is around it
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_SHIFT = 4  # positions are drawn to a sixteenth of a pixel


@dataclass(frozen=True)
class Canvas:
    """A picture of a part of the plane, with the lower-left corner at (0, 0).

    Examples
    --------
    >>> canvas = Canvas(np.zeros((40, 30, 3), np.uint8), 10.0)
    >>> canvas.pixels(np.array([[0.0, 0.0], [3.0, 4.0]])).tolist()
    [[-0.5, 39.5], [29.5, -0.5]]
    """

    image: Image  #: drawn on in place
    px_per_m: float  #: pixels per metre

    def pixels(self, xy: FloatArray) -> FloatArray:
        """Positions (N, 2) in metres as (N, 2) pixels, whose centres are at integers."""
        x, y = np.asarray(xy, dtype=np.float64).reshape(-1, 2).T * self.px_per_m
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


def sheet(cells: npt.NDArray[np.uint8], grid: GridInfo, scale: int | None) -> Canvas:
    """Draw the cells (H, W, 3) of a grid as squares of `scale` pixels, upside up.

    By default small grids are enlarged to 1000 pixels a side or more.
    """
    if scale is None:
        scale = max(1, min(16, -(-_SIDE // max(grid.shape))))
    up = np.ascontiguousarray(cells[::-1])
    size = (grid.width * scale, grid.height * scale)
    image = cv2.resize(up, size, interpolation=cv2.INTER_NEAREST)
    return Canvas(np.asarray(image, dtype=np.uint8), scale / grid.resolution)


def text(image: Image, message: str, x: int, y: int, colour: Colour = INK, size: int = 13) -> int:
    """Write `message` with its baseline's left end at pixel (x, y) and return its width."""
    thick = max(1, round(size / 16))
    cv2.putText(image, message, (x, y), _FONT, size / 22, colour, thick, cv2.LINE_AA)
    return text_width(message, size)


def outlined(image: Image, message: str, x: int, y: int, size: int, wide: int) -> None:
    """Write `message` as :func:`text` does, with a rim of paper `wide` pixels around it."""
    for dx, dy in ((-wide, 0), (wide, 0), (0, -wide), (0, wide)):
        text(image, message, x + dx, y + dy, PAPER, size)
    text(image, message, x, y, INK, size)


def text_width(message: str, size: int = 13) -> int:
    """Width of `message` in pixels."""
    return int(cv2.getTextSize(message, _FONT, size / 22, max(1, round(size / 16)))[0][0])


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


def colour_bar(image: Image, colours: Image, ends: Sequence[str], title: str) -> Image:
    """Put a bar of `colours` (1, N, 3) below a picture, with words at its ends and a title."""
    f = enlarged(image)
    size, gap, high = round(14 * f), round(14 * f), round(16 * f)
    words = [text_width(word, size) for word in (*ends, title)]
    wide = max(image.shape[1], sum(words) + 5 * gap + round(120 * f))
    out = np.full((image.shape[0] + 2 * gap + high, wide, 3), 255, np.uint8)
    out[: image.shape[0], : image.shape[1]] = image
    top, x = image.shape[0] + gap, gap
    x += text(out, title, x, top + high - round(3 * f), size=size) + gap
    x += text(out, ends[0], x, top + high - round(3 * f), size=size) + gap // 2
    length = min(round(320 * f), wide - x - words[1] - 2 * gap)
    bar = cv2.resize(colours, (length, high), interpolation=cv2.INTER_LINEAR)
    out[top : top + high, x : x + length] = bar
    cv2.rectangle(out, (x, top), (x + length, top + high), INK, 1)
    text(out, ends[1], x + length + gap // 2, top + high - round(3 * f), size=size)
    return out


def legend(image: Image, entries: Sequence[tuple[Colour, str]]) -> Image:
    """Put coloured boxes with words below a picture, in as many lines as they need.

    Examples
    --------
    >>> legend(np.zeros((40, 300, 3), np.uint8), [(INK, "wall"), (PAPER, "free")]).shape
    (78, 300, 3)
    """
    f = enlarged(image)
    size, box, line, gap = (round(length * f) for length in (14, 14, 26, 20))
    wide = max(image.shape[1], *(2 * gap + 2 * box + text_width(word, size) for _, word in entries))
    lines: list[list[tuple[int, Colour, str]]] = [[]]
    x = gap
    for colour, word in entries:
        need = box + box // 2 + text_width(word, size) + gap
        if x + need > wide and lines[-1]:
            lines.append([])
            x = gap
        lines[-1].append((x, colour, word))
        x += need
    strip = np.full((line * len(lines) + round((LEGEND - 26) * f), wide, 3), 255, np.uint8)
    for k, some in enumerate(lines):
        y = round(10 * f) + k * line
        for x, colour, word in some:
            for ink, thickness in ((colour, cv2.FILLED), (INK, 1)):
                cv2.rectangle(strip, (x, y), (x + box, y + box), ink, thickness)
            text(strip, word, x + box + box // 2, y + box - round(2 * f), size=size)
    around = ((0, 0), (0, wide - image.shape[1]), (0, 0))
    return np.concatenate((np.pad(image, around, constant_values=255), strip))


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


def draw_map(grid: OccupancyGrid, *, scale: int | None = None, bar: bool = True) -> Image:
    """Draw a map: walls dark, free space white, unknown space grey, and a scale bar.

    A cell is `scale` pixels wide, as in :func:`sheet`.
    """
    canvas = map_canvas(grid, scale, faded=False)
    if bar:
        scale_bar(canvas)
    return canvas.image


def deviation_ellipse(covariance: FloatArray, n: int = 64) -> FloatArray:
    """Outline (n, 2) of one standard deviation of x and y around 0, of a covariance (3, 3)."""
    values, vectors = np.linalg.eigh(covariance[:2, :2])
    s = np.linspace(0, 2 * np.pi, n)
    circle = np.column_stack((np.cos(s), np.sin(s)))
    return np.asarray((circle * np.sqrt(np.maximum(values, 0))) @ vectors.T)


def map_canvas(grid: OccupancyGrid, scale: int | None = None, *, faded: bool = True) -> Canvas:
    """Return a canvas with the map, to draw on; `faded`, its walls are grey."""
    colours = np.array([SHADE, PAPER, (146, 140, 134) if faded else INK], dtype=np.uint8)
    classes = np.where(grid.occupied, 2, grid.free.astype(np.int64))
    return sheet(colours[classes], grid.info, scale)


def building(grid: OccupancyGrid) -> tuple[FloatArray, int]:
    """Corners (2, 2) of what a map knows with a metre around it, grid frame, metres; and a scale.

    The scale, pixels per cell, is that of :func:`sheet` for this part.

    Examples
    --------
    >>> free = np.pad(np.ones((40, 60), bool), 100)
    >>> corners, scale = building(OccupancyGrid(~free & False, free, 0.1))
    >>> corners.round(3).tolist(), scale
    ([[9.0, 9.0], [17.0, 15.0]], 13)
    """
    known, cell = ~grid.unknown, grid.resolution
    sides = [np.flatnonzero(known.any(axis=axis)) for axis in (0, 1)]
    whole = cell * np.array(known.shape[::-1])
    if not all(map(len, sides)):
        sides = [np.arange(n) for n in known.shape[::-1]]
    low = [cell * side[0] - 1.0 for side in sides]
    high = [cell * (side[-1] + 1) + 1.0 for side in sides]
    corners = np.array([np.maximum(low, 0.0), np.minimum(high, whole)])
    longest = float((corners[1] - corners[0]).max()) / cell
    most = max(1, _LARGEST // max(known.shape))
    return corners, max(1, min(16, most, -(-_SIDE // max(1, round(longest)))))


def marker_size(canvas: Canvas) -> float:
    """Radius of a robot in pixels: 0.25 m, but never too small to see nor very large."""
    side = max(canvas.image.shape[:2])
    return float(np.clip(0.25 * canvas.px_per_m, max(5.0, side / 160), max(9.0, side / 80)))


def scale_bar(canvas: Canvas) -> None:
    """Draw a bar of a round length, at most a fifth of the width.

    It stands as close to the lower left corner as it can without covering anything darker
    than unknown space.
    """
    height, width = canvas.image.shape[:2]
    if width < 120 or height < 60:
        return
    length = round_length(0.2 * width / canvas.px_per_m)
    label = f"{length:g} m"
    px = round(length * canvas.px_per_m)
    wide, high = max(px, text_width(label)) + 14, 32
    ink = cv2.integral((canvas.image.min(axis=2) < SHADE[2]).astype(np.uint8))
    y0, x0 = np.mgrid[5 : height - high - 4 : 3, 5 : width - wide - 4 : 3]
    y1, x1 = y0 + high, x0 + wide
    covered = ink[y1, x1] - ink[y0, x1] - ink[y1, x0] + ink[y0, x0]
    away = np.hypot(x0, height - high - y0)
    best = int(np.argmin(covered + away / (1 + away.max())))
    top, left = int(y0.flat[best]), int(x0.flat[best])
    box = canvas.image[top : top + high, left : left + wide]
    box[:] = np.rint(0.15 * box + 0.85 * 255)
    x, y = left + (wide - px) // 2, top + high - 7
    canvas.image[y - 1 : y + 1, x : x + px + 1] = INK
    canvas.image[y - 5 : y + 1, [x, x + px]] = INK
    text(canvas.image, label, left + (wide - text_width(label)) // 2, y - 8)


def round_length(longest: float) -> float:
    """The greatest of 1, 2, 5, 10, 20 ... that is no more than `longest`.

    Examples
    --------
    >>> round_length(0.3), round_length(70.0)
    (0.2, 50.0)
    """
    decade = float(10.0 ** np.floor(np.log10(longest)))
    return decade * max(k for k in (1, 2, 5) if k * decade <= longest * (1 + 1e-9))
