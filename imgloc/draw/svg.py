"""A window on the map as SVG: the map's cells as an image, and lines that stay sharp in print.

The grid frame has y up, SVG has y down: :class:`View` is where it is turned round.
"""

import base64
from dataclasses import dataclass

import numpy as np

from imgloc.draw.canvas import INK, PAPER, SHADE, Picture
from imgloc.features.pyramid import any_of_blocks
from imgloc.io.images import encode_png
from imgloc.model import FloatArray, OccupancyGrid, Pose2D

_SIDE = 1400  # pixels that the image of the map has at most along a side


@dataclass(frozen=True)
class View:
    """A window of the grid frame, and the width in pixels that it is drawn at.

    Parameters
    ----------
    x, y : float
        Lower left corner, metres.
    width, height : float
        Metres.
    px : float
        Width of the drawing, pixels.

    Examples
    --------
    >>> view = View(1.0, 0.0, 4.0, 2.0, 400.0)
    >>> view.pixels(np.array([[1.0, 2.0], [5.0, 0.0]])).tolist(), view.box
    ([[0.0, 0.0], [400.0, 200.0]], '0 0 400 200')
    """

    x: float
    y: float
    width: float
    height: float
    px: float

    @property
    def scale(self) -> float:
        """Pixels per metre."""
        return self.px / self.width

    @property
    def box(self) -> str:
        """Of SVG's ``viewBox``."""
        return f"0 0 {self.px:g} {number(self.height * self.scale)}"

    def pixels(self, xy: FloatArray) -> FloatArray:
        """Positions (N, 2) in metres as (N, 2) pixels from the upper left corner."""
        corner = np.array([self.x, self.y + self.height])
        return np.asarray((xy - corner) * (self.scale, -self.scale)) + 0.0  # no -0


def number(value: float) -> str:
    """A coordinate, to a tenth of a pixel.

    Examples
    --------
    >>> number(3.04), number(-0.02), number(12.5)
    ('3', '0', '12.5')
    """
    return f"{round(float(value), 1) + 0.0:g}" if abs(value) < 1e5 else f"{value:.0f}"


def path(lines: FloatArray) -> str:
    """Polylines (N, P, 2) in pixels as the ``d`` of a path; of one point each, dots.

    Examples
    --------
    >>> path(np.array([[[0, 0], [1.5, 2]]])), path(np.array([[[3, 4]]]))
    ('M0 0L1.5 2', 'M3 4h0')
    """
    parts = []
    for line in np.asarray(lines).tolist():
        words = [f"{number(x)} {number(y)}" for x, y in line]
        parts.append(f"M{'L'.join(words)}" + ("h0" if len(words) == 1 else ""))
    return "".join(parts)


def map_image(grid: OccupancyGrid, view: View) -> str:
    """The cells of a map within a view as an image; what is off the map stays empty."""
    cell = grid.resolution
    low = np.floor(np.array([view.y, view.x]) / cell).astype(int)
    high = np.ceil(np.array([view.y + view.height, view.x + view.width]) / cell).astype(int)
    low, high = np.maximum(low, 0), np.minimum(high, grid.occupied.shape)
    if (high <= low).any():
        return ""
    factor = -(-int((high - low).max()) // _SIDE)
    picture = cells_picture(grid, np.s_[low[0] : high[0], low[1] : high[1]], factor)
    height, width = np.array(picture.shape[:2]) * factor * cell * view.scale
    x, bottom = view.pixels(np.array([[low[1] * cell, low[0] * cell]]))[0]
    return embed(
        picture,
        f'x="{number(x)}" y="{number(bottom - height)}" width="{number(width)}" '
        f'height="{number(height)}" preserveAspectRatio="none" class="cells"',
    )


def cells_picture(grid: OccupancyGrid, window: tuple[slice, slice], factor: int = 1) -> Picture:
    """A pixel for each block of cells: a wall if there is any in it, however thin."""
    occupied, free = (any_of_blocks(cells[window], factor) for cells in (grid.occupied, grid.free))
    colours = np.array([SHADE, PAPER, INK], dtype=np.uint8)
    return np.asarray(colours[np.where(occupied, 2, free.astype(np.int64))][::-1])


def embed(picture: Picture, attributes: str) -> str:
    """A picture as an SVG image that carries its own bytes."""
    data = base64.b64encode(encode_png(picture)).decode("ascii")
    return f'<image {attributes} href="data:image/png;base64,{data}"/>'


def robot(view: View, pose: Pose2D, label: str, style: str, size: float = 10.0) -> str:
    """A disc with a nose along theta and a label in it."""
    (x, y), turn = view.pixels(np.array([[pose.x, pose.y]]))[0], -np.rad2deg(pose.theta)
    nose = path(np.array([[(0.35, -1), (2, 0), (0.35, 1)]]) * size)
    return (
        f'<g class="robot {style}" transform="translate({number(x)} {number(y)})">'
        f'<g transform="rotate({number(turn)})"><path d="{nose}Z"/></g>'
        f'<circle r="{number(size)}"/><text y="{number(0.36 * size)}">{label}</text></g>'
    )


def scale_bar(view: View) -> str:
    """A bar of a round length in the lower left corner."""
    longest = 0.25 * view.width
    decade = 10.0 ** np.floor(np.log10(longest))
    length = decade * max(k for k in (1, 2, 5) if k * decade <= longest * (1 + 1e-9))
    label = (
        f"{length:g} m"
        if length >= 1
        else f"{100 * length:g} cm"
        if length >= 0.01
        else f"{1000 * length:g} mm"
    )
    wide, bottom = length * view.scale, view.height * view.scale
    y = bottom - 9
    box = max(wide, 8.0 * len(label)) + 12
    return (
        f'<g class="rule"><rect x="5" y="{number(bottom - 33)}" width="{number(box)}" height="28"/>'
        f'<path d="M11 {number(y - 4)}v4h{number(wide)}v-4"/>'
        f'<text x="{number(11 + wide / 2)}" y="{number(y - 8)}">{label}</text></g>'
    )
