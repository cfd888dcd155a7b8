"""Whatever is around the pixels of a picture, by matplotlib: axes, titles, legends, colour bars.

Figures are objects of their own. The frame of a map takes no style from matplotlib's settings: it
is the same whatever a user has set, and may be drawn in several threads.
"""

import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from imgloc.geometry import rotation, transform_points
from imgloc.model import FloatArray, Pose2D
from imgloc.output.canvas import INK, Colour, Image, Picture, enlarged, round_length

Entry = tuple[Colour, str, str]
"""A line of a legend: colour, marker, words. A marker is one below, one of matplotlib's, or ""."""
AREA, DOT, LINE, DASHED, ROBOT = "s", "o", "-", "--", "robot"
_ROOM = 480  # pixels that words have beside each other on a narrow picture
_LETTER, _WIDE = 7.3, 9.5  # pixels of a letter of a legend, and of a title
_APART = (75, 60)  # pixels from tick to tick at least: along the lower edge, and the left one
_SMALL, _LARGE = 9.0, 10.5  # points of words
_ROW, _HANDLE, _GAP = 19, 26, 30  # pixels of a legend: line, what is before words, between columns
_BAR = (360, 14)  # pixels of a colour bar


@dataclass(frozen=True)
class Bar:
    """A colour bar: its colours stand for values from `low` to `high`, with a tick each `step`."""

    colours: Image  #: (1, N, 3)
    low: float
    high: float
    step: float
    words: str  #: the quantity, with its unit


def framed(
    canvas: Picture, origin: Pose2D, title: str = "", entries: Sequence[Entry] = (), *,
    columns: int | None = None, labels: Sequence[tuple[float, float, str]] = (),
    bar: Bar | None = None, inset: Picture | None = None,
) -> Picture:  # fmt: skip
    """Put axes of the map frame, a title, and a legend around the pixels of a map.

    Each pixel of the map is one of the picture, under a light grid. The legend stands below the
    map, or beside a high one, so that nothing covers the map but the `labels`.

    Parameters
    ----------
    canvas, inset : Picture
        The map, grid frame, and a part of it in larger.
    origin : Pose2D
        Of the grid frame, in the map frame.
    columns : int, optional
        Of the legend, by default as many as there is room for.
    labels : sequence of (x, y, str)
        Words on the map: metres, grid frame.

    Returns
    -------
    Picture
        The whole picture, in which each point of the map is where the axes have it.

    Examples
    --------
    >>> map_ = Picture(np.full((100, 200, 3), 255, np.uint8), 10.0)
    >>> picture = framed(map_, Pose2D(5.0, 0.3), "A yard", [(INK, AREA, "wall")])
    >>> column, row = np.rint(picture.pixels(np.array([[3.05, 9.95]]))[0]).astype(int).tolist()
    >>> picture.image[row - 1 : row + 2, column].tolist()  # the line around the map, and the map
    [[56, 47, 40], [255, 255, 255], [255, 255, 255]]
    """
    sheet, (height, width) = _Sheet(enlarged(canvas.image)), canvas.image.shape[:2]
    f, beside = sheet.f, height > 1.3 * width
    sheet.add_map(canvas, origin, 0, 0)
    room = max(width, _ROOM * f)
    lines = textwrap.wrap(title, round(room / f / _WIDE), break_on_hyphens=False)
    sheet.text((0, height + 9 * f), "\n".join(lines), size=_LARGE, va="bottom", weight="bold")
    for x, y, label in labels:
        u, v = ((np.array((x, y)) - canvas.corner) * canvas.px_per_m).tolist()
        sheet.text((u, v), label, size=_LARGE, ha="center", va="center", rim=True)
    left, top = (width + 20 * f, height) if beside else (0.0, -46 * f)
    if bar is not None:
        top = sheet.add_bar(bar, left, top)
    right, low = sheet.add_legend(entries, left, top, _ROOM * f if beside else room, columns)
    if inset is not None:
        high, wide = inset.image.shape[:2]
        x, y = (left + 50 * f, low) if beside else (max(width - wide, right + 70 * f), top)
        x, y = round(x), round(y - 24 * f) - high
        sheet.add_map(inset, origin, x, y)
        sheet.text((x, y + high + 9 * f), "the frame in the map, larger", va="bottom")
        ends = (_around(inset.box) - canvas.corner) * canvas.px_per_m
        sheet.lines(ends[None], INK, 1.0)
    return sheet.finished(canvas)


class _Sheet:
    """A figure whose artists are at pixels from the lower left corner of a map.

    Its size is what all of them need. Words are `f` times as large as on a screen.
    """

    def __init__(self, f: float) -> None:
        from matplotlib.transforms import Affine2D

        self.figure, self._draw = blank(1, 1, dpi=100 * f, facecolor="none")
        self.f, self._at, self._images = f, Affine2D(), list[tuple[Image, int, int]]()

    def text(
        self, at: Sequence[float], text: str, *, size: float = _SMALL, mono: bool = False,
        rim: bool = False, **more: Any,
    ) -> Any:  # fmt: skip
        """Write words; `rim`, with paper around the letters."""
        from matplotlib.patheffects import withStroke

        return self.figure.text(
            *at, words(text), color=ink(INK), transform=self._at, size=size, usetex=False,
            family="DejaVu Sans Mono" if mono else "DejaVu Sans",  # which come with matplotlib
            path_effects=[withStroke(linewidth=2.5, foreground="white")] if rim else None, **more,
        )  # fmt: skip

    def lines(
        self, ends: FloatArray, colour: Colour, width: float, within: Sequence[float] = (),
        **more: Any,
    ) -> None:  # fmt: skip
        """Draw polylines (N, P, 2); of those only what is `within` a box (x, y, width, height)."""
        from matplotlib.collections import LineCollection
        from matplotlib.transforms import Bbox, TransformedBbox

        drawn = LineCollection(
            ends.tolist(), colors=[ink(colour)], linewidths=width, antialiaseds=True,
            transform=self._at, capstyle="projecting", **more,
        )  # fmt: skip
        self.figure.add_artist(drawn)
        if within:
            drawn.set_clip_box(TransformedBbox(Bbox.from_bounds(*within), self._at))

    def add_image(self, image: Image, x: int, y: int) -> None:
        """Put an image with a line around it; its lower left corner is at (x, y)."""
        self._images.append((image, x, y))
        (height, width), line = image.shape[:2], round(self.f)  # pixels, just outside
        box = np.array([(x, y), (x + width, y + height)]) + [[-line / 2], [line / 2]]
        self.lines(_around(box)[None], INK, 0.72 * line / self.f, snap=False)

    def add_ticks(self, edge: int, x: float, y: float, at: FloatArray, names: list[str]) -> None:
        """Put ticks, pixels from (x, y) along a lower edge, 0, or along a left one, 1."""
        ends = np.zeros((len(at), 2, 2)) + (x, y)
        ends[:, :, edge] += at[:, None]
        ends[:, 1, 1 - edge] -= 5 * self.f
        if len(at):
            self.lines(ends, INK, 0.72)
        far = np.array([(0, -3), (-3, 0)][edge]) * self.f
        ha, va = ("center", "right")[edge], ("top", "center_baseline")[edge]
        for spot, name in zip((ends[:, 1] + far).tolist(), names, strict=True):
            self.text(spot, name, ha=ha, va=va)

    def add_map(self, canvas: Picture, origin: Pose2D, x: int, y: int) -> None:
        """Put a map at (x, y): lines of equal x and y of the map frame, which may be turned.

        Ticks are where these meet the lower edge, which has the coordinate that changes more along
        it, and the left one, which has the other.
        """
        f, box, turn, size = self.f, canvas.box, rotation(origin.theta), canvas.image.shape[1::-1]
        self.add_image(canvas.image, x, y)
        corners = transform_points(origin, _around(box))
        swapped = int(abs(turn[0, 1]) > abs(turn[0, 0]))
        for edge in (0, 1):
            of, other = edge ^ swapped, 1 - edge
            pixels = min(_APART[edge] * f, size[edge] / 2.5)
            apart = pixels / canvas.px_per_m * abs(turn[of, edge])
            values, names = _ticks(corners[:, of].min(), corners[:, of].max(), apart)
            # A value is shift + turn[of] @ (x, y), where one of x and y is that of the edge.
            across = (origin.x, origin.y)[of] + turn[of, other] * box[0, other]
            at = ((values - across) / turn[of, edge] - box[0, edge]) * canvas.px_per_m
            start = np.zeros((len(at), 2)) + (x, y)
            start[:, edge] += at
            way = np.array((-turn[of, 1], turn[of, 0])) * sum(size)
            ends = np.stack((start - way, start + way), axis=1)
            self.lines(ends, INK, 0.72, (x, y, *size), alpha=0.15)
            on = np.flatnonzero((at >= -0.01) & (at <= size[edge] + 0.01))
            self.add_ticks(edge, x, y, at[on], [names[k] for k in on])
            spot = ((x + size[0], y - 25 * f), (x - 8 * f, y + size[1] + 9 * f))[edge]
            self.text(spot, f"{'xy'[of]} / m", ha="right", va=("top", "bottom")[edge])

    def add_bar(self, bar: Bar, x: float, y: float) -> float:
        """Put a colour bar below (x, y); returns the height at which there is room again."""
        long, high = (round(length * self.f) for length in _BAR)
        low = round(y) - high
        image = cv2.resize(bar.colours, (long, high), interpolation=cv2.INTER_LINEAR)
        self.add_image(np.asarray(image, np.uint8), round(x), low)
        values = np.arange(bar.low, bar.high + bar.step / 2, bar.step)
        at = (values - bar.low) / (bar.high - bar.low) * long
        self.add_ticks(0, round(x), low, at, [f"{value:g}" for value in values])
        self.text((x, low - 25 * self.f), bar.words, va="top")
        return low - 52 * self.f

    def add_legend(
        self, entries: Sequence[Entry], x: float, y: float, room: float, columns: int | None
    ) -> tuple[float, float]:
        """Put a legend below (x, y), in columns; returns where it ends, to the right and below."""
        f, rows = self.f, list[tuple[Colour, str, Any]]()
        for colour, marker, text in entries:
            for line in textwrap.wrap(text, round((room / f - _HANDLE) / _LETTER)):
                rows.append((colour, marker, self.text((0, 0), line, mono=True)))
                marker = ""
        wide = (_HANDLE + _GAP) * f + max((t.get_window_extent().x1 for *_, t in rows), default=0.0)
        columns = columns or max(1, int((room + _GAP * f) / wide))
        each = max(1, -(-len(rows) // columns))
        for k, (colour, marker, shown) in enumerate(rows):
            left, base = x + k // each * wide, y - (12 + k % each * _ROW) * f
            shown.set_position((left + _HANDLE * f, base))
            self._add_handle(colour, marker, left, base + 4.5 * f)
        return x + wide * -(-len(rows) // each), y - each * _ROW * f

    def _add_handle(self, colour: Colour, marker: str, x: float, y: float) -> None:
        from matplotlib.lines import Line2D
        from matplotlib.path import Path

        f, nose = self.f, Path([(0.45, -0.9), (2.1, 0.0), (0.45, 0.9), (0.45, -0.9)])
        robot = Path.make_compound_path(Path.unit_circle(), nose)
        if marker in (LINE, DASHED):
            self.lines(np.array([[(x, y), (x + 18 * f, y)]]), colour, 2.0, linestyles=marker)
        elif marker:
            shape, size = (robot, 13) if marker == ROBOT else (marker, 9)
            self.figure.add_artist(Line2D(
                [x + 9 * f], [y], marker=shape, markersize=size, linestyle="None",
                color=ink(colour), markeredgecolor=ink(INK if marker == AREA else colour),
                markeredgewidth=1.5 if marker == "x" else 0.7, transform=self._at,
            ))  # fmt: skip

    def finished(self, canvas: Picture) -> Picture:
        """Draw all of it; `canvas` is the map in the corner of which pixels begin."""
        boxes = [t.get_window_extent().get_points() for t in self.figure.texts if t.get_text()]
        boxes += [np.array([(x, y), (x + i.shape[1], y + len(i))]) for i, x, y in self._images]
        pad = round(8 * self.f)
        low = np.floor(np.min([box[0] for box in boxes], axis=0)).astype(int) - pad
        high = np.ceil(np.max([box[1] for box in boxes], axis=0)).astype(int) + pad
        self._at.translate(*-low)
        self.figure.set_size_inches((high - low + 0.01) / self.figure.dpi)
        out = np.full((high[1] - low[1], high[0] - low[0], 3), 255, np.uint8)
        for image, x, y in self._images:
            out[high[1] - y - len(image) :, x - low[0] :][: len(image), : image.shape[1]] = image
        drawn = self._draw()
        at = np.nonzero(drawn[..., 3])
        over, share = drawn[..., :3][at], drawn[..., 3][at][:, None] / 255
        out[at] = np.rint(out[at] + share * (over[:, ::-1] - out[at].astype(float)))
        x, y = (canvas.box[0] + low / canvas.px_per_m).tolist()
        return Picture(out, canvas.px_per_m, (x, y))


def _around(box: FloatArray) -> FloatArray:
    """The outline (5, 2) of two corners (2, 2)."""
    return box[[[0, 0], [0, 1], [1, 1], [1, 0], [0, 0]], [0, 1]]


def _ticks(low: float, high: float, apart: float) -> tuple[FloatArray, list[str]]:
    """Round values (N,) from `low` to `high`, at least so far apart, and their names.

    Examples
    --------
    >>> values, names = _ticks(-1.0, 0.6, 0.3)
    >>> names
    ['-1.0', '-0.5', '0.0', '0.5']
    """
    step = round_length(2.5 * apart)
    values = step * np.arange(np.ceil(low / step - 1e-6), np.floor(high / step + 1e-6) + 1)
    digits = max(0, -int(np.floor(np.log10(step) + 1e-9)))
    return values, [f"{value + 0.0:.{digits}f}" for value in values]


@cache
def _letters() -> frozenset[int]:
    """The letters that the font has."""
    from matplotlib import font_manager

    font = font_manager.get_font(font_manager.findfont("DejaVu Sans"))
    return frozenset(font.get_charmap()) | {ord("\n")}


def words(text: str) -> str:
    r"""A text as matplotlib takes it: without formulas, and without letters that no font here has.

    Examples
    --------
    >>> words("5 $ a scan"), words("run \x1b")
    ('5 \\$ a scan', 'run \ufffd')
    """
    known = "".join(c if ord(c) in _letters() else "\N{REPLACEMENT CHARACTER}" for c in text)
    return known.replace("$", r"\$")


def blank(
    width: float, height: float, **options: Any
) -> tuple[Any, Callable[[], npt.NDArray[np.uint8]]]:
    """An empty matplotlib figure, in inches of 100 pixels, and what draws it.

    Pixels are (H, W, 3) BGR, or (H, W, 4) RGBA of a figure without a `facecolor`.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # takes half a second
    from matplotlib.figure import Figure

    figure = Figure((width, height), **{"dpi": 100, **options})
    canvas = FigureCanvasAgg(figure)

    def pixels() -> npt.NDArray[np.uint8]:
        canvas.draw()
        rgba = np.asarray(canvas.buffer_rgba())
        return rgba if clear else np.asarray(cv2.cvtColor(rgba, cv2.COLOR_RGBA2BGR), np.uint8)

    clear = options.get("facecolor") == "none"
    return figure, pixels


def ink(colour: Colour) -> tuple[float, float, float]:
    """A colour of a picture as matplotlib has it: red, green, blue, 0..1."""
    b, g, r = (value / 255 for value in colour)
    return r, g, b
