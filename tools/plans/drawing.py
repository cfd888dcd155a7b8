"""Buildings that are not there: as an architect draws them, and as a laser sees them.

The two come from the same walls, doors and windows. The laser also sees furniture that is on no
plan, the leaves of doors that stand open, and neither text nor dimension lines.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
import numpy.typing as npt
import PIL.Image
from PIL import ImageDraw, ImageFont

from imgloc.geometry import rotation
from imgloc.model import BoolArray, FloatArray, OccupancyGrid, Pose2D

Image = npt.NDArray[np.uint8]
Wall = tuple[FloatArray, FloatArray, float]
"""From, to, thickness: metres."""
FINE = 0.01  #: metres a cell of the true world
STYLES = ("filled", "outlined", "hatched", "grey", "lines")
"""How walls are drawn: black, two lines, hatched between these, grey between these, one line."""
_SHIFT = 8  # fractional bits of the positions that cv2 draws
_AROUND = 2.5  # metres of paper around a building, for dimensions and titles
_PEN = 0.02  # metres: the width of a thin line, at least a pixel


@dataclass(frozen=True)
class Opening:
    """A door, a window or a passage in a wall."""

    wall: int  #: its index
    start: float  #: metres from the beginning of the wall, as the next
    width: float
    kind: str  #: ``door``, ``double`` (two leaves), ``window`` or ``passage``
    side: int = 1  #: to which side of the wall leaves turn: 1 is the left one
    hinge: int = 0  #: of a door: 0 if it is at its start
    angle: float = np.pi / 2  #: by which leaves stand open in the true world


@dataclass
class Building:
    """A building of straight walls, metres; turned as a whole about its lower left corner."""

    size: tuple[float, float]
    walls: list[Wall] = field(default_factory=list)
    openings: list[Opening] = field(default_factory=list)
    pillars: list[FloatArray] = field(default_factory=list)
    #: drawn: ``box``, ``circle``, ``stairs``; corners
    symbols: list[tuple[str, FloatArray]] = field(default_factory=list)
    names: list[tuple[str, FloatArray]] = field(default_factory=list)  #: and where they are written
    #: polygons that stand there and are not drawn
    things: list[FloatArray] = field(default_factory=list)
    turn: float = 0.0  #: radians
    corner: FloatArray = field(default_factory=lambda: np.zeros(2))  #: added after the turn
    rooms: list[FloatArray] = field(default_factory=list)  #: corners
    yards: list[FloatArray] = field(default_factory=list)  #: open to the sky, within the walls

    def wall(self, x0: float, y0: float, x1: float, y1: float, thick: float) -> int:
        """Add a wall by its centre line; its index."""
        self.walls.append((np.array([x0, y0]), np.array([x1, y1]), thick))
        return len(self.walls) - 1

    def placed(self, xy: npt.ArrayLike) -> FloatArray:
        """Points (..., 2) of the building in the frame of its plan."""
        return np.asarray(np.asarray(xy) @ rotation(self.turn).T + self.corner)

    @property
    def extent(self) -> tuple[float, float]:
        """Width and height of the sheet, metres."""
        w, h = self.size
        wide, high = self.placed([(0, 0), (w, 0), (w, h), (0, h)]).max(axis=0) + _AROUND
        return float(wide), float(high)

    def sheet(self, cell: float, ink: int = 0) -> Image:
        """An empty sheet, (H, W), of so many metres a pixel."""
        wide, high = (round(side / cell) for side in self.extent)
        return np.full((high, wide), ink, np.uint8)

    def fill(self, image: Image, corners: FloatArray, cell: float, ink: int = 1) -> None:
        """Fill a polygon of the building on its sheet, row 0 the lowest y."""
        cv2.fillPoly(image, [_fixed(self.placed(corners), cell)], ink, cv2.LINE_8, _SHIFT)

    def opened(self, o: Opening, deeper: float = 0.0) -> FloatArray:
        """Corners of the part of a wall where an opening is."""
        a, end, thick = self.walls[o.wall]
        return _piece((a, end, thick + deeper), o.start, o.start + o.width)


def box(x0: float, y0: float, x1: float, y1: float) -> FloatArray:
    """Corners of a rectangle."""
    return np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)], np.float64)


def building(seed: int, turn: float = 0.0, floor: int | None = None) -> Building:
    """An office floor: rooms of random widths on both sides of a corridor, and a hall.

    Outer walls are 0.3 to 0.4 m thick, those of the corridor 0.2, the others 0.1 to 0.15. Another
    `floor` of the same seed has the same outer walls and the same corridor, but other rooms.
    """
    rng = np.random.default_rng(seed)
    width, depth = rng.uniform(24, 34), rng.uniform(13, 16)
    outer, low = rng.uniform(0.3, 0.4), rng.uniform(4.5, 6.0)
    high = low + rng.uniform(1.8, 2.4)
    corner = np.array([_AROUND + (depth * np.sin(turn)), _AROUND])
    b = Building((width, depth), turn=turn, corner=corner)

    # Outer walls by their centre lines, ends overlapping at the corners.
    h = outer / 2
    south, north = b.wall(0, h, width, h, outer), b.wall(0, depth - h, width, depth - h, outer)
    west, east = b.wall(h, 0, h, depth, outer), b.wall(width - h, 0, width - h, depth, outer)
    sides = [b.wall(0, low, width, low, 0.2), b.wall(0, high, width, high, 0.2)]
    for facade, hinge in ((west, 0), (east, 1)):
        kind = "double" if facade == west else "door"
        wide = 1.6 if kind == "double" else 1.0
        middle = (low + high) / 2 - wide / 2
        side = 1 if facade == east else -1
        b.openings.append(Opening(facade, middle, wide, kind, side, hinge))

    rng = rng if floor is None else np.random.default_rng((seed, floor))
    for row, (side, bottom, top) in enumerate(
        zip(sides, (outer, high + 0.1), (low - 0.1, depth - outer), strict=True)
    ):
        area = outer, bottom, width - outer, top
        b.rooms += _rooms(rng, b, area, side, (south, north)[row], "AB"[row], up=row == 1)
    _furnish_all(rng, b)
    return b


def hospital(seed: int, outer: float = 0.8, yard: bool = True) -> Building:
    """Two corridors along a floor of 46 to 54 m x 28 m, and two across it: thick walls.

    Outer walls are `outer` thick, those of corridors 0.3 m. In the middle may be a `yard`.
    """
    rng = np.random.default_rng((seed, 7))
    width, depth, h = rng.uniform(46, 54), 28.0, outer / 2
    b = Building((width, depth), corner=np.full(2, _AROUND))

    south, north = b.wall(0, h, width, h, outer), b.wall(0, depth - h, width, depth - h, outer)
    west, east = b.wall(h, 0, h, depth, outer), b.wall(width - h, 0, width - h, depth, outer)
    low, high = rng.uniform(6.0, 7.0, 2)
    sides = [b.wall(0, low, width, low, 0.3), b.wall(0, depth - high, width, depth - high, 0.3)]
    y0, y1 = low + 2.5, depth - high - 2.5  # of the core, between the corridors
    for facade, y, hinge in ((west, y0 - 2.1, 0), (east, y1 + 0.5, 1)):
        b.openings.append(Opening(facade, y, 1.8, "double", 1 if facade == east else -1, hinge))
    strips = [((outer, outer, width - outer, low - 0.15), sides[0], south, "A", False)]
    strips.append(((outer, depth - high + 0.15, width - outer, depth - outer), sides[1], north,
                   "B", True))  # fmt: skip
    ends = np.array([outer, rng.uniform(0.3, 0.36) * width, rng.uniform(0.64, 0.7) * width])
    for k, (x0, x1) in enumerate(
        zip(ends + [0, 2.4, 2.4], [*ends[1:], width - outer], strict=True)
    ):
        thick = 0.5 if yard and k == 1 else 0.3
        lower, upper = (b.wall(x0, y, x1, y, thick) for y in (y0, y1))
        for x in ((x0, x1), (x1,), (x0,))[(1, 0, 2)[k]]:
            b.wall(x, y0, x, y1, thick)
        if yard and k == 1:
            b.yards.append(box(x0, y0, x1, y1))
            for side in (lower, upper):
                b.openings += [Opening(side, s, 1.6, "window") for s in (2.0, 6.0)]
            continue
        middle = (y0 + y1) / 2
        spine = b.wall(x0, middle, x1, middle, 0.2)
        here = x0 + 0.15, x1 - 0.15
        for side, bottom, top, up in ((lower, y0 + 0.15, middle - 0.1, True),
                                      (upper, middle + 0.1, y1 - 0.15, False)):  # fmt: skip
            strips.append(((here[0], bottom, here[1], top), side, spine, "CDE"[k], up))
    for area, side, facade, letter, up in strips:
        b.rooms += _rooms(rng, b, area, side, facade, letter, up=up)
    b.openings = [o for o in b.openings if o.kind != "window" or b.walls[o.wall][2] > 0.2]
    _furnish_all(rng, b)
    return b


def _furnish_all(rng: np.random.Generator, b: Building) -> None:
    """Furnish each room."""
    doors = [b.opened(o).mean(axis=0) for o in b.openings if o.kind != "window"]
    for corners in b.rooms:
        _furnish(rng, corners, [*doors, *(p.mean(axis=0) for p in b.pillars)], b)


def _rooms(
    rng: np.random.Generator, b: Building, area: tuple[float, float, float, float], side: int,
    facade: int, letter: str, *, up: bool,
) -> list[FloatArray]:  # fmt: skip
    """Rooms side by side in `area` (x0, y0, x1, y1), with doors in the wall `side`, below if `up`.

    Windows are in the wall `facade`; both begin at the same x and run to the right.
    """
    (begin, bottom, end, top), rooms = area, list[FloatArray]()
    x, number, start = begin, 0, b.walls[side][0][0]
    while x < end - 2.0:
        left, length = x, rng.uniform(2.6, 6.5)
        if end - (x + length) < 2.6:
            length = end - x
        x += length
        if x < end - 1e-6:
            thin = float(rng.choice([0.1, 0.12, 0.15]))
            between = b.wall(x, bottom - 0.05, x, top + 0.05, thin)
            if rng.random() < 0.35:  # a door to the next room
                where = rng.uniform(0.4, top - bottom - 1.4)
                b.openings.append(
                    Opening(between, where, 0.8, "door", int(rng.choice([-1, 1])), 0,
                            rng.uniform(1.2, 1.7))
                )  # fmt: skip
        wide = float(rng.choice([0.8, 0.9, 1.0]))
        kind = "passage" if length > 5.8 else "door"
        where = rng.uniform(left + 0.25, x - 2 * wide - 0.25) - start
        b.openings.append(
            Opening(side, where, wide * (2 if kind == "passage" else 1), kind, 1 if up else -1,
                    int(rng.integers(2)), rng.uniform(1.1, 1.7))
        )  # fmt: skip
        if length > 2.9:
            glass = rng.uniform(1.0, min(2.4, length - 1.2))
            at = left + (length - glass) / 2 - start
            b.openings.append(Opening(facade, at, glass, "window"))
        centre = np.array([left + length / 2, (bottom + top) / 2])
        b.names.append((f"{letter}{number + 1:02d} {length * (top - bottom):.0f} m2", centre))
        number += 1
        if length > 5.0:
            c = centre + (rng.uniform(-1, 1), rng.uniform(0.5, 1.2))
            b.pillars.append(box(*(c - 0.2), *(c + 0.2)))
        rooms.append(box(left, bottom, x, top))
    return rooms


def _furnish(
    rng: np.random.Generator, room: FloatArray, doors: list[FloatArray], b: Building
) -> None:
    """Symbols on the plan, and things in the room, which are not the same; not before `doors`."""
    (x0, y0), (x1, y1) = room[0], room[2]
    wide, high = x1 - x0, y1 - y0
    taken = [(c, 1.4) for c in doors]

    def put(width: float, height: float) -> FloatArray | None:
        for _ in range(20):
            c = rng.uniform(
                (x0 + 0.2 + width, y0 + 0.2 + height), (x1 - 0.2 - width, y1 - 0.2 - height)
            )
            reach = float(np.hypot(width, height))
            if all(np.hypot(*(c - at)) > reach + far for at, far in taken):
                taken.append((c, reach))
                return np.asarray(c)
        return None

    if wide < 3.4 and rng.random() < 0.4:
        b.symbols.append(("stairs", box(x0 + 0.3, y0 + 1.4, x0 + 1.5, y1 - 1.4)))
        return
    if rng.random() < 0.5:  # a cupboard near the wall
        b.symbols.append(("box", box(x1 - 0.7, y1 - 2.2, x1 - 0.1, y1 - 0.5)))
        taken.append((np.array([x1 - 0.4, y1 - 1.3]), 0.9))
    for _ in range(int(wide * high / 7)):
        if (c := put(0.7, 0.6)) is not None:
            b.symbols.append(("box", box(c[0] - 0.7, c[1] - 0.1, c[0] + 0.7, c[1] + 0.6)))
            b.symbols.append(("circle", np.array([c - (0, 0.36), c - (0.22, 0.36)])))
    taken = [(c, 1.4) for c in doors]
    for _ in range(int(wide * high / 9)):
        half = rng.uniform(0.15, 0.45, 2)
        if (c := put(*half)) is not None:
            b.things.append(box(*-half, *half) @ rotation(rng.uniform(0, 7)).T + c)


def _fixed(xy: FloatArray, cell: float) -> npt.NDArray[np.int32]:
    """Points of a sheet as cv2 takes them: pixels, with :data:`_SHIFT` fractional bits."""
    return np.rint((xy / cell - 0.5) * (1 << _SHIFT)).astype(np.int32)


def _piece(wall: Wall, start: float = 0.0, end: float | None = None) -> FloatArray:
    """Corners of a wall, or of a part of it."""
    a, b, thick = wall
    length = np.hypot(*(b - a))
    along = (b - a) / length
    across = np.array([-along[1], along[0]]) * thick / 2
    p, q = a + along * start, a + along * (length if end is None else end)
    return np.array([p - across, q - across, q + across, p + across])


def leaves(b: Building, o: Opening) -> list[tuple[FloatArray, FloatArray, float]]:
    """Hinge, direction of the closed leaf (its length is the leaf's), and the sign of its turn."""
    a, end, thick = b.walls[o.wall]
    along = (end - a) / np.hypot(*(end - a))
    across = np.array([-along[1], along[0]]) * o.side
    start, stop = (a + along * s + across * thick / 2 for s in (o.start, o.start + o.width))
    if o.kind == "double":
        half = along * o.width / 2
        return [(start, half, float(o.side)), (stop, -half, -float(o.side))]
    if o.kind == "door" and o.hinge == 0:
        return [(start, along * o.width, float(o.side))]
    return [(stop, -along * o.width, -float(o.side))] if o.kind == "door" else []


def solid(b: Building, cell: float, *, windows: bool = True) -> BoolArray:
    """Walls and pillars on the sheet, without doors and passages: (H, W), row 0 the lowest y."""
    image = b.sheet(cell)
    for wall in b.walls:
        b.fill(image, _piece(wall), cell)
    for o in b.openings:
        if o.kind != "window" or not windows:
            # A little deeper than the wall, which is drawn with its outline.
            b.fill(image, b.opened(o, 4 * cell), cell, 0)
    for pillar in b.pillars:
        b.fill(image, pillar, cell)
    return image > 0


def inside(b: Building, cell: float) -> BoolArray:
    """What is within the outer walls, walls and all; as :func:`solid`."""
    image = b.sheet(cell)
    b.fill(image, box(0, 0, *b.size), cell)
    for yard in b.yards:
        b.fill(image, yard, cell, 0)
    return image > 0


def true_world(b: Building, cell: float = FINE) -> OccupancyGrid:
    """What a laser meets: walls, leaves of open doors, furniture. Outside is unknown."""
    occupied = solid(b, cell).astype(np.uint8)
    for thing in b.things:
        b.fill(occupied, thing, cell)
    for o in b.openings:
        for hinge, leaf, sign in leaves(b, o):
            b.fill(occupied, _piece((hinge, hinge + leaf @ rotation(sign * o.angle).T, 0.04)), cell)
    return OccupancyGrid(occupied > 0, inside(b, cell) & (occupied == 0), cell, Pose2D(0, 0))


def draw_plan(
    b: Building, resolution: float, style: str = "filled", *, clutter: bool = True,
    noise: int | None = None,
) -> Image:  # fmt: skip
    """The plan of a building, (H, W) grey, top row first, of so many metres a pixel.

    `noise` is the quality of a JPEG that the plan went through, 1 to 100.
    """
    walls = solid(b, FINE, windows=False)
    line, image = max(1, round(_PEN / resolution)), b.sheet(resolution, 255)
    high, wide = image.shape
    share = cv2.resize(walls.astype(np.float32), (wide, high), interpolation=cv2.INTER_AREA)

    def stroke(xy: FloatArray, closed: bool = False, width: int = line) -> None:
        points = _fixed(b.placed(xy), resolution)
        cv2.polylines(image, [points], closed, 0, width, cv2.LINE_AA, _SHIFT)

    if style == "filled":
        image[:] = np.rint(255 * (1 - share))
    elif style == "lines":
        for k, (a, end, _) in enumerate(b.walls):
            length = float(np.hypot(*(end - a)))
            gaps = sorted(
                (o.start, o.start + o.width)
                for o in b.openings
                if o.wall == k and o.kind != "window"
            )
            cuts = [0.0, *(s for gap in gaps for s in gap), length]
            for s, t in zip(cuts[::2], cuts[1::2], strict=True):
                stroke(a + np.outer([s, t], (end - a) / length), width=2 * line)
        for pillar in b.pillars:
            stroke(pillar, closed=True)
    else:
        if style == "grey":
            image[:] = np.rint(255 - 95 * share)
        if style == "hatched":
            lines = np.full_like(image, 255)
            step = max(4, round(0.09 / resolution))
            for k in range(-high, wide, step):
                cv2.line(lines, (k, 0), (k + high, high), 0, 1, cv2.LINE_AA)
            image[:] = np.where(share > 0.5, lines, image)
        outlines, _ = cv2.findContours(
            walls.astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_SIMPLE
        )
        for outline in outlines:
            turned = _fixed((outline[:, 0].astype(np.float64) + 0.5) * FINE, resolution)
            cv2.polylines(image, [turned], True, 0, line, cv2.LINE_AA, _SHIFT)
    if style != "lines":
        for o in b.openings:
            if o.kind == "window":  # three lines between the ends of the wall
                right, left = (c := b.opened(o))[:2], c[:1:-1]
                for ends in (right, (right + left) / 2, left):
                    stroke(ends)
    if clutter:
        for o in b.openings:
            for hinge, leaf, sign in leaves(b, o):
                turns = np.linspace(0, sign * np.pi / 2, 24)
                arc = np.array([hinge + leaf @ rotation(t).T for t in turns])
                stroke(arc)
                stroke(_piece((hinge, arc[-1], 0.04)), closed=True)
        for kind, corners in b.symbols:
            if kind == "circle":
                radius = float(np.hypot(*(corners[1] - corners[0])))
                around = np.linspace(0, 2 * np.pi, 33)
                stroke(corners[0] + radius * np.column_stack((np.cos(around), np.sin(around))))
                continue
            stroke(corners, closed=True)
            if kind == "stairs":
                for y in np.arange(corners[0, 1], corners[2, 1], 0.28):
                    stroke(np.array([(corners[0, 0], y), (corners[2, 0], y)]))
    image = np.ascontiguousarray(image[::-1])
    if clutter:
        _write(image, b, resolution, line)
    if noise is not None:
        _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, noise])
        image = np.asarray(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE), np.uint8)
    return image


def _write(image: Image, b: Building, resolution: float, line: int) -> None:
    """Names of rooms, dimension lines, a title; upright, on an image whose top row is first."""

    def word(text: str, xy: Sequence[float], height: float = 0.28) -> None:
        # Not cv2.putText, whose letters are others from version to version.
        sheet = PIL.Image.fromarray(image)
        font = ImageFont.load_default(round(height / resolution / 0.7))
        at = xy[0] / resolution, len(image) - xy[1] / resolution
        ImageDraw.Draw(sheet).text(at, text, fill=0, font=font, anchor="ms")
        image[:] = np.asarray(sheet)

    def stroke(a: Sequence[float], c: Sequence[float]) -> None:
        p, q = ((round(x / resolution), round(len(image) - y / resolution)) for x, y in (a, c))
        cv2.line(image, p, q, 0, line, cv2.LINE_AA)

    for text, xy in b.names:
        word(text, b.placed(xy).tolist())
    corners = b.placed(box(0, 0, *b.size))
    (x0, y0), (x1, y1) = corners.min(axis=0), corners.max(axis=0)
    for y in (y0 - 0.8, y0 - 1.4):
        stroke((x0 - 0.3, y), (x1 + 0.3, y))
        for x in np.linspace(x0, x1, 2 if y < y0 - 1 else 7):
            stroke((x - 0.15, y - 0.15), (x + 0.15, y + 0.15))
            stroke((x, y - 0.25), (x, y + 0.6))
    word(f"{b.size[0]:.2f}", ((x0 + x1) / 2, y0 - 1.3))
    word("LEVEL 2 - OFFICES  1:100", (x0 + 5.0, y1 + 1.2), 0.5)
