"""Whole sheets, as other programs, scanners and telephones make them: a plan is a part of each.

A sheet is a picture in colour and the pose of its lower left corner in the frame of its building.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import PIL.Image
from PIL import ImageDraw, ImageFont

from imgloc.geometry import rotation
from imgloc.model import FloatArray, Pose2D
from tools.plans.drawing import Building, Image, Opening, box, building, draw_plan, hospital

Colour = tuple[int, int, int]
BLACK: Colour = (0, 0, 0)
ON_IT = Pose2D(0.0, 0.0)


@dataclass(frozen=True)
class Sheet:
    """A picture of a building, (H, W, 3) uint8 BGR, top row first."""

    building: Building
    image: Image
    resolution: float  #: metres a pixel
    origin: Pose2D = ON_IT  #: of its lower left corner in the frame of the building

    def changed(self, image: Image) -> "Sheet":
        """The same with another picture of the same size."""
        return replace(self, image=image)

    @property
    def size(self) -> tuple[float, float]:
        """Width and height, metres."""
        high, wide = self.image.shape[:2]
        return wide * self.resolution, high * self.resolution

    def pixels(self, xy: FloatArray) -> list[tuple[int, int]]:
        """Where points (N, 2) are, metres from the lower left corner; column and row."""
        column, row = np.rint(np.asarray(xy) / self.resolution).astype(int).T
        return list(zip(column.tolist(), (len(self.image) - 1 - row).tolist(), strict=True))

    def placed(self, xy: FloatArray) -> FloatArray:
        """Points (N, 2) of the building, metres from the lower left corner of the sheet."""
        return self.building.placed(xy) - (self.origin.x, self.origin.y)

    def line(self, points: list[tuple[float, float]], width: float, colour: Colour = BLACK) -> None:
        """Draw a line through points, metres, as wide as that, at least a pixel."""
        thick = max(1, round(width / self.resolution))
        way = [np.array(self.pixels(np.array(points, float)), np.int32)]
        cv2.polylines(self.image, way, False, colour, thick, cv2.LINE_AA)

    def box(self, x: float, y: float, wide: float, high: float, width: float) -> None:
        """Draw a rectangle from its lower left corner."""
        corners = [(x, y), (x + wide, y), (x + wide, y + high), (x, y + high), (x, y)]
        self.line(corners, width)

    def fill(self, corners: FloatArray, colour: Colour) -> None:
        """Fill a polygon, corners in metres, beneath what is drawn."""
        mask = np.zeros(self.image.shape[:2], np.uint8)
        cv2.fillPoly(mask, [np.array(self.pixels(corners), np.int32)], 1)
        here = mask > 0
        self.image[here] = np.minimum(self.image[here], colour)

    def words(self, text: str, x: float, y: float, height: float, bold: float = 0.0) -> None:
        """Write a text from its lower left corner, letters so high, `bold` of this thicker."""
        sheet = PIL.Image.fromarray(self.image)
        font = ImageFont.load_default(max(6, round(height / self.resolution / 0.7)))
        stroke = round(bold * height / self.resolution)
        (at,) = self.pixels(np.array([(x, y)]))
        ImageDraw.Draw(sheet).text(at, text, BLACK, font, "ls", stroke_width=stroke)
        self.image[:] = np.asarray(sheet)


def drawn(b: Building, resolution: float, style: str, *, clutter: bool = True) -> Sheet:
    """The plan of a building as a sheet without anything around it."""
    grey = draw_plan(b, resolution, style, clutter=clutter)
    return Sheet(b, np.repeat(grey[..., None], 3, axis=2), resolution)


def padded(s: Sheet, left: float, below: float, right: float, above: float) -> Sheet:
    """Paper around a sheet, metres."""
    sides = [round(side / s.resolution) for side in (above, below, left, right)]
    image = np.pad(s.image, (sides[:2], sides[2:], (0, 0)), constant_values=255)
    x, y = s.origin.x - sides[2] * s.resolution, s.origin.y - sides[1] * s.resolution
    return replace(s, image=image, origin=Pose2D(x, y))


def framed(s: Sheet, width: float = 0.1, inner: float | None = 0.03) -> Sheet:
    """A frame along the border: a bold line and, half a metre within, a thinner one."""
    wide, high = s.size
    s.box(0.4, 0.4, wide - 0.8, high - 0.8, width)
    if inner is not None:
        s.box(0.9, 0.9, wide - 1.8, high - 1.8, inner)
        for x in np.linspace(0.9, wide - 0.9, 7)[1:-1].tolist():  # the marks of its fields
            for y in (0.4, high - 0.9):
                s.line([(x, y), (x, y + 0.5)], inner)
    return s


def title_block(s: Sheet, width: float = 0.06) -> Sheet:
    """A table in the lower right corner, joined to the frame."""
    wide, high = 9.0, 4.2
    x, y = s.size[0] - 0.9 - wide, 0.9
    s.box(x, y, wide, high, width)
    for k, text in enumerate(
        ("DRAWN  K.M.  12.03.", "SCALE 1:200   A1", "FLOOR PLAN 2", "SHEET 7")
    ):
        s.line([(x, y + 1.05 * k), (x + wide, y + 1.05 * k)], width / 2)
        s.words(text, x + 0.4, y + 1.05 * k + 0.3, 0.4)
    s.line([(x + 6.5, y), (x + 6.5, y + high)], width)
    return s


def titled(s: Sheet, text: str, height: float, bold: float = 0.06) -> Sheet:
    """A title in large letters along the upper border."""
    s.words(text, 3.0, s.size[1] - 1.6 - height, height, bold)
    return s


def legend(s: Sheet, height: float = 0.6, box: float = 1.2) -> Sheet:
    """Samples of walls, and what they are, along the right border."""
    x, y = s.size[0] - 9.0, s.size[1] - 4.0
    for k, text in enumerate(("WALL F90", "WALL F30", "GLASS", "DEMOLISH", "NEW")):
        low = y - k * (box + 0.6)
        s.box(x, low, 2 * box, box, (0.3, 0.12, 0.03, 0.06, 0.2)[k])
        if k in (0, 3):
            for step in np.arange(0.0, box, 0.15).tolist():
                s.line([(x + step, low), (x + step + box, low + box)], 0.03)
        s.words(text, x + 2 * box + 0.4, low + 0.2, height, 0.05)
    return s


def axes(s: Sheet, step: float = 6.0) -> Sheet:
    """Dashed axes through the building, with a letter in a circle at both ends."""
    (w, h), radius = s.building.size, 0.5
    ways = [((x, -1.4), (x, h + 1.4)) for x in np.arange(1.0, w, step)]
    ways += [((-1.4, y), (w + 1.4, y)) for y in np.arange(1.0, h, step)]
    for k, way in enumerate(ways):
        a, b = s.placed(np.array(way))
        parts = np.linspace(0, 1, max(2, int(np.hypot(*(b - a)) / 0.5)))
        for t, u in zip(parts[:-1:2], parts[1::2], strict=False):
            s.line([tuple(a + t * (b - a)), tuple(a + u * (b - a))], 0.02)
        for end, sign in ((a, -1), (b, 1)):
            c = end + sign * radius * (b - a) / np.hypot(*(b - a))
            (at,) = s.pixels(c[None])
            reach = round(radius / s.resolution)
            cv2.circle(s.image, at, reach, BLACK, 1, cv2.LINE_AA)
            s.words(chr(65 + k % 26), c[0] - 0.15, c[1] - 0.2, 0.4)
    return s


def dimensions(s: Sheet) -> Sheet:
    """A chain of dimensions through each room, both ways, with slanted ends and a number."""
    for room in s.building.rooms:
        (x0, y0), (x1, y1) = s.placed(room)[0], s.placed(room)[2]
        x, y = x0 + 0.37 * (x1 - x0), y0 + 0.68 * (y1 - y0)
        for a, b in (((x0, y), (x1, y)), ((x, y0), (x, y1))):
            s.line([a, b], 0.015)
            for end in (a, b):
                s.line([(end[0] - 0.1, end[1] - 0.1), (end[0] + 0.1, end[1] + 0.1)], 0.04)
        s.words(f"{x1 - x0:.2f}", x + 0.1, y + 0.08, 0.22)
    return s


def zones(s: Sheet, colours: tuple[Colour, ...]) -> Sheet:
    """Rooms in colours."""
    for k, room in enumerate(s.building.rooms):
        s.fill(s.placed(room), colours[k % len(colours)])
    return s


def inked(s: Sheet, ink: Colour, paper: Colour) -> Sheet:
    """Another ink and another paper; greys between them."""
    share = s.image / 255.0
    return s.changed(np.rint(share * paper + (1 - share) * np.array(ink)).astype(np.uint8))


def smaller(s: Sheet, by: float) -> Sheet:
    """The same with fewer pixels: averaged, as an editor does."""
    size = round(s.image.shape[1] / by), round(s.image.shape[0] / by)
    image = np.asarray(cv2.resize(s.image, size, interpolation=cv2.INTER_AREA), np.uint8)
    return replace(s, image=image, resolution=s.resolution * s.image.shape[1] / size[0])


def turned(s: Sheet, degrees: float = 2.0, beyond: int = 255) -> Sheet:
    """The sheet turned, on a larger one of the tone `beyond`."""
    high, wide = s.image.shape[:2]
    turn = rotation(angle := float(np.deg2rad(degrees)))
    corners = np.array([(0, 0), (wide, 0), (wide, high), (0, high)]) @ turn.T
    shift = -corners.min(axis=0)
    size = tuple(np.ceil(corners.max(axis=0) + shift).astype(int).tolist())
    # Rows of an image run down: x' = x, y' = height - y, on both sheets.
    flip, back = np.diag([1.0, -1.0]), np.array([0.0, size[1]])
    matrix = flip @ turn @ flip
    move = flip @ (turn @ [0.0, high] + shift) + back
    tone = (beyond,) * 3
    image = cv2.warpAffine(
        s.image, np.column_stack((matrix, move)), size, flags=cv2.INTER_LINEAR, borderValue=tone
    )
    corner = (s.origin.x, s.origin.y) - turn.T @ shift * s.resolution
    origin = Pose2D(float(corner[0]), float(corner[1]), -angle)
    return replace(s, image=np.asarray(image, np.uint8), origin=origin)


def jpeg(s: Sheet, quality: int = 40) -> Sheet:
    """What is left of it after a JPEG."""
    _, data = cv2.imencode(".jpg", s.image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return s.changed(np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), np.uint8))


def scanned(s: Sheet, seed: int, share: float = 0.003) -> Sheet:
    """A scanner's grey and grain, and specks of dust and toner of one to three pixels."""
    rng = np.random.default_rng(seed)
    high, wide = s.image.shape[:2]
    image = cv2.GaussianBlur(s.image, (0, 0), 0.7).astype(np.float32)
    image += rng.normal(0, 6, (high, wide, 1))
    for tone in (30, 240):
        for _ in range(round(share / 4 * high * wide)):
            x, y, r = rng.integers(wide), rng.integers(high), rng.integers(1, 4)
            image[y : y + r, x : x + r] = tone
    return s.changed(np.clip(image * 0.95, 0, 255).astype(np.uint8))


def photographed(s: Sheet, seed: int, dark: float = 0.5) -> Sheet:
    """Uneven light, from 1 down to `dark`, a soft lens and grain."""
    rng = np.random.default_rng(seed)
    high, wide = s.image.shape[:2]
    y, x = np.mgrid[0:high, 0:wide].astype(np.float32)
    x, y = x / wide, y / high
    bright = 1 - (1 - dark) * np.clip(0.6 * x + 0.4 * y + 0.3 * np.sin(4 * x + 3 * y) * y, 0, 1)
    image = cv2.GaussianBlur(s.image, (0, 0), 0.9) * 0.9 * bright[..., None] + 8
    image = image * (0.93, 0.98, 1.0) + rng.normal(0, 4, (high, wide, 1))
    return s.changed(np.clip(image, 0, 255).astype(np.uint8))


PASTEL: tuple[Colour, ...] = ((180, 235, 255), (200, 255, 200), (255, 220, 190), (215, 200, 255))
STRONG: tuple[Colour, ...] = ((80, 200, 255), (110, 220, 110), (240, 170, 90), (140, 130, 250))


def _whole(b: Building, resolution: float, style: str, *, clutter: bool = True) -> Sheet:
    """A plan on a sheet with room for a title above, a legend to the right, a block below."""
    return padded(drawn(b, resolution, style, clutter=clutter), 2.0, 6.0, 11.0, 6.0)


def enclosed(s: Sheet, away: Sequence[float], width: float = 0.06) -> Sheet:
    """A frame of one line, `away` metres left of, below, right of and above the building.

    Where it is 0 m away the line is that of the facade.
    """
    wide, high = s.building.size
    x, y = s.placed(np.array([(-away[0], -away[1])]))[0]
    s.box(x, y, wide + away[0] + away[2], high + away[1] + away[3], width)
    return s


def block(s: Sheet, x: float, y: float, width: float = 0.06) -> Sheet:
    """A table of 7 x 3 m, its lower left corner so far from that of the building."""
    x, y = s.placed(np.array([(x, y)]))[0]
    s.box(x, y, 7.0, 3.0, width)
    for k, text in enumerate(("SCALE 1:100", "OFFICE BLOCK", "SHEET 3")):
        s.line([(x, y + k), (x + 7.0, y + k)], width)
        s.words(text, x + 0.4, y + k + 0.3, 0.4)
    s.line([(x + 4.5, y), (x + 4.5, y + 3.0)], width)
    return s


def beside(s: Sheet, other: Sheet, apart: float) -> Sheet:
    """Another sheet to the right of this one, `apart` metres between the two buildings."""
    edge = s.placed(np.array([s.building.size]))[0, 0] + apart
    first = other.placed(np.zeros((1, 2)))[0, 0]
    keep = round((edge - first) / s.resolution)  # pixels of this sheet, left of the other
    high = max(len(s.image), len(other.image))
    parts = []
    for image in (s.image, other.image):
        parts.append(np.pad(image, ((high - len(image), 0), (0, 0), (0, 0)), constant_values=255))
    wide = max(parts[0].shape[1], keep + parts[1].shape[1])
    out = np.full((high, wide, 3), 255, np.uint8)
    out[:, : parts[0].shape[1]] = parts[0]
    there = out[:, keep : keep + parts[1].shape[1]]
    np.minimum(there, parts[1], out=there)
    return s.changed(out)


def cottage(seed: int) -> Building:
    """A house of five rooms, 9 to 11 m wide, with wide doors in walls 0.1 m thick."""
    rng = np.random.default_rng((seed, 3))
    wide, high = rng.uniform(9, 11), rng.uniform(7, 8)
    b = Building((wide, high), corner=np.full(2, 2.5))
    t = 0.1
    x1, x2, y1 = 0.36 * wide, 0.68 * wide, 0.5 * high

    h = t / 2
    south, north = b.wall(0, h, wide, h, t), b.wall(0, high - h, wide, high - h, t)
    west, spine = b.wall(h, 0, h, high, t), b.wall(0, y1, wide, y1, t)
    below, above = b.wall(x1, 0, x1, y1, t), b.wall(x1, y1, x1, high, t)
    b.wall(wide - h, 0, wide - h, high, t)
    b.wall(x2, 0, x2, y1, t)
    doors = ((south, 0.5, 2.4), (south, x2 + 0.5, 2.0), (north, x2 - 0.6, 2.4), (west, 0.8, 1.0),
             (spine, 0.8, 1.8), (spine, x1 + 0.5, 1.8), (spine, x2 + 0.6, 1.4),
             (below, 0.9, 1.6), (above, 1.0, 1.4))  # fmt: skip
    for where, start, width in doors:
        b.openings.append(Opening(where, start, width, "double", 1, 0, rng.uniform(1.3, 1.7)))
    for k, c in enumerate(((0, 0, x1, y1), (x1, 0, x2, y1), (x2, 0, wide, y1), (0, y1, x1, high),
                           (x1, y1, wide, high))):  # fmt: skip
        b.rooms.append(box(*c))
        b.names.append((f"R{k + 1}", np.array([(c[0] + c[2]) / 2, (c[1] + c[3]) / 2])))
    return b


def thick(b: Building, thickness: float) -> Building:
    """The same with all walls so thick."""
    b.walls = [(a, end, thickness) for a, end, _ in b.walls]
    return b


def escape_plan(s: Sheet) -> Sheet:
    """Green arrows along the way out, red signs in rooms, a broad green border, a strip below."""
    green, red = (60, 140, 20), (30, 30, 200)
    b, w = s.building, s.building.size[0]
    y = float(np.mean([c[:, 1].mean() for c in b.rooms]))
    for x in np.arange(2.0, w - 2.0, 3.0).tolist():
        a, c = s.placed(np.array([(x, y), (x + 1.6, y)]))
        s.line([tuple(a), tuple(c)], 0.18, green)
        s.line([(c[0] - 0.4, c[1] - 0.3), tuple(c), (c[0] - 0.4, c[1] + 0.3)], 0.12, green)
    for room in b.rooms[::3]:
        x0, y0 = s.placed(room.mean(axis=0)[None])[0] + (0.6, 0.6)
        s.fill(np.array([(x0, y0), (x0 + 0.5, y0), (x0 + 0.5, y0 + 0.5), (x0, y0 + 0.5)]), red)
    wide, high = s.size
    for x, y, dx, dy in ((0, 0, wide, 0.5), (0, high - 0.5, wide, 0.5), (0, 0, 0.5, high),
                         (wide - 0.5, 0, 0.5, high)):  # fmt: skip
        s.fill(np.array([(x, y), (x + dx, y), (x + dx, y + dy), (x, y + dy)]), green)
    s.words("EMERGENCY EXITS", 3.0, 1.6, 1.2, 0.1)
    return s


def grid(s: Sheet, step: float, colour: Colour) -> Sheet:
    """Thin lines over the whole sheet, both ways."""
    wide, high = s.size
    for x in np.arange(step / 2, wide, step).tolist():
        s.line([(x, 0.0), (x, high)], 0.0, colour)
    for y in np.arange(step / 2, high, step).tolist():
        s.line([(0.0, y), (wide, y)], 0.0, colour)
    return s


def above(s: Sheet, other: Sheet) -> Sheet:
    """Another sheet above this one."""
    wide = max(s.image.shape[1], other.image.shape[1])
    parts = [
        np.pad(i, ((0, 0), (0, wide - i.shape[1]), (0, 0)), constant_values=255)
        for i in (other.image, s.image)
    ]
    return s.changed(np.concatenate(parts))


def copied(s: Sheet) -> Sheet:
    """The dark margin of a copier's lid, left and above, and a fold across the sheet."""
    image = s.image.copy()
    image[:, : round(0.7 / s.resolution)] = image[: round(0.5 / s.resolution)] = 25
    column = round(0.45 * image.shape[1])
    image[:, column : column + 2] = np.minimum(image[:, column : column + 2], 170)
    return s.changed(image)


#: How each sheet is drawn, by its name.
SHEETS: dict[str, Callable[[], Sheet]] = {
    "frame and title block": lambda: title_block(framed(_whole(building(1), 0.02, "outlined"))),
    "thick filled walls, legend and title in large letters": lambda: legend(
        titled(_whole(hospital(1), 0.045, "filled"), "SECOND FLOOR  WARD 2A", 2.6, 0.08), 1.6, 2.0
    ),
    "thick walls as two lines": lambda: titled(
        _whole(hospital(2), 0.03, "outlined"), "LEVEL 2", 1.5
    ),
    "hatched walls, frame, legend": lambda: legend(framed(_whole(building(2), 0.02, "hatched"))),
    "axes and dimensions": lambda: dimensions(axes(_whole(building(3), 0.02, "outlined"))),
    "scanned, turned by 2 deg": lambda: jpeg(
        scanned(turned(framed(_whole(building(1), 0.025, "filled"))), 1)
    ),
    "photographed, turned by 2 deg": lambda: jpeg(
        photographed(turned(titled(_whole(building(2), 0.02, "outlined"), "OFFICES", 1.0)), 2), 60
    ),
    "coloured zones": lambda: legend(zones(_whole(building(3), 0.02, "filled"), PASTEL)),
    "strong coloured zones, walls as two lines": lambda: zones(
        _whole(hospital(3, 0.4, yard=False), 0.03, "outlined"), STRONG
    ),
    "light on dark, title block": lambda: inked(
        title_block(framed(_whole(building(1), 0.02, "outlined"))), (230, 230, 120), (40, 30, 30)
    ),
    "small, grey, soft": lambda: smaller(title_block(_whole(building(2), 0.02, "grey")), 2.5),
    "light grey walls, dark text": lambda: axes(
        inked(_whole(hospital(1, 0.5, yard=False), 0.03, "filled", clutter=False), (190,) * 3,
              (255,) * 3)
    ),
    # Not looked at while `plan_to_map` was mended.
    "aside: thick hatched walls, scanned, title block": lambda: jpeg(
        scanned(title_block(framed(_whole(hospital(4, 0.6), 0.035, "hatched"))), 4), 50
    ),
    "aside: thick walls as two lines, photographed, zones, frame": lambda: jpeg(
        photographed(
            turned(framed(zones(_whole(hospital(5, 0.7), 0.03, "outlined"), PASTEL)), -2.0, 90), 5
        )
    ),
    "aside: red walls on cream paper, legend": lambda: legend(
        inked(_whole(building(4), 0.025, "filled"), (40, 30, 170), (215, 240, 250))
    ),
    "aside: white on blue, turned, dimensions": lambda: turned(
        inked(dimensions(framed(_whole(building(5), 0.02, "outlined"))), (255,) * 3, (120, 60, 20)),
        2.0, 60,
    ),
    "aside: single lines, title block, small": lambda: smaller(
        title_block(framed(_whole(building(6), 0.02, "lines"), inner=None)), 1.7
    ),
    "aside: grey walls, strong zones, large title, JPEG": lambda: jpeg(
        titled(zones(_whole(hospital(6, 0.5), 0.03, "grey"), STRONG), "GROUND FLOOR", 2.4, 0.1), 30
    ),
    # Of buildings that no sheet before has; drawn once the warnings were there.
    "later: frame and title block": lambda: title_block(
        framed(_whole(building(11), 0.02, "outlined"))
    ),
    "later: thick hatched walls, scanned, title block": lambda: jpeg(
        scanned(title_block(framed(_whole(hospital(11, 0.6), 0.035, "hatched"))), 11), 50
    ),
    "later: thick walls as two lines, photographed, zones, frame": lambda: jpeg(
        photographed(
            turned(framed(zones(_whole(hospital(12, 0.7), 0.03, "outlined"), PASTEL)), -2.0, 90), 12
        )
    ),
    "later: thick filled walls, legend and title in large letters": lambda: legend(
        titled(_whole(hospital(13), 0.045, "filled"), "SECOND FLOOR", 2.6, 0.08), 1.6, 2.0
    ),
    "later: grey walls, strong zones, large title, JPEG": lambda: jpeg(
        titled(zones(_whole(hospital(14, 0.5), 0.03, "grey"), STRONG), "GROUND FLOOR", 2.4, 0.1), 30
    ),
    "later: hatched walls, scanned, frame": lambda: jpeg(
        scanned(framed(_whole(building(12), 0.025, "hatched")), 12), 50
    ),
    "later: walls as two lines, photographed": lambda: jpeg(
        photographed(turned(_whole(building(13), 0.02, "outlined")), 13, 0.35), 50
    ),
    "later: walls as two lines, small": lambda: smaller(
        _whole(hospital(15, 0.5), 0.03, "outlined"), 1.8
    ),
    "later: thick filled walls, scanned, many specks": lambda: jpeg(
        scanned(_whole(hospital(16, 0.6), 0.04, "filled"), 16, 0.006), 40
    ),
    "later: single lines, scanned": lambda: jpeg(
        scanned(_whole(building(14), 0.025, "lines"), 14), 50
    ),
    "later: double frame around 13 times the building": lambda: framed(
        padded(drawn(building(1), 0.05, "filled"), 38.0, 20.5, 38.0, 20.5), 0.3, 0.1
    ),
    "hard: title block 1.1 m from the building": lambda: block(
        enclosed(padded(drawn(building(21), 0.02, "filled"), 3, 3, 3, 3), (2.0, 4.6, 2.0, 2.0)),
        building(21).size[0] - 5.0,
        -4.6,
    ),
    "hard: frame 1.2 m around the building, hatched": lambda: enclosed(
        drawn(building(22), 0.02, "hatched"), (1.2, 1.2, 1.2, 1.2)
    ),
    "hard: frame along a facade": lambda: enclosed(
        padded(drawn(building(23), 0.02, "filled"), 2, 2, 2, 2), (2.5, 4.0, 3.0, 0.0)
    ),
    "hard: frame along two facades, walls as two lines": lambda: enclosed(
        padded(drawn(building(24), 0.02, "outlined"), 4, 4, 4, 4), (0.0, 4.0, 5.0, 0.0)
    ),
    "hard: title block joined to the facade": lambda: block(
        enclosed(padded(drawn(building(25), 0.02, "filled"), 3, 3, 3, 3), (2.0, 3.0, 3.0, 2.0)),
        9.0,
        -3.0,
    ),
    "hard: two buildings 4 m apart": lambda: beside(
        drawn(building(26), 0.02, "filled"), drawn(building(27), 0.02, "filled"), 4.0
    ),
    "hard: two buildings 2 m apart, a small one": lambda: beside(
        drawn(building(28), 0.02, "filled"), drawn(cottage(1), 0.02, "filled"), 2.0
    ),
    "hard: single lines, scanned": lambda: jpeg(
        scanned(drawn(building(29), 0.025, "lines"), 29), 50
    ),
    "hard: single lines, scanned, fine": lambda: jpeg(
        scanned(_whole(building(30), 0.015, "lines"), 30), 50
    ),
    "hard: walls 0.88 m thick as two lines": lambda: drawn(
        thick(building(31), 0.88), 0.02, "outlined"
    ),
    "hard: walls 0.88 m thick as two lines, hospital": lambda: drawn(
        hospital(32, 0.88), 0.03, "outlined"
    ),
    "hard: walls 1.2 m thick as two lines, hospital": lambda: drawn(
        hospital(33, 1.2), 0.03, "outlined"
    ),
    "hard: small house, wide doors, filled": lambda: drawn(cottage(2), 0.02, "filled"),
    "hard: small house, wide doors, outlined": lambda: drawn(cottage(3), 0.02, "outlined"),
    "hard: small house, wide doors, no swings": lambda: drawn(
        cottage(4), 0.02, "filled", clutter=False
    ),
    # Of conventions that no sheet before has; drawn when `plan_to_map` was frozen.
    "fresh: escape plan, grey walls, green border": lambda: escape_plan(
        padded(inked(drawn(building(41), 0.025, "filled", clutter=False), (120,) * 3, (255,) * 3),
               2, 3, 2, 2)
    ),
    "fresh: dark screen, a grid all over": lambda: grid(
        inked(padded(drawn(building(42), 0.025, "outlined"), 2, 2, 2, 2), (235,) * 3, (48, 40, 33)),
        1.0, (90, 80, 60),
    ),
    "fresh: two floors in one frame": lambda: framed(
        above(padded(drawn(building(43), 0.025, "filled"), 2, 2, 2, 0),
              padded(drawn(building(43, floor=1), 0.025, "filled"), 2, 0, 2, 2)), 0.12, None
    ),
    "fresh: flyer, tinted rooms, large names, JPEG": lambda: jpeg(
        smaller(
            titled(zones(padded(drawn(building(44), 0.02, "filled"), 1, 1, 1, 4), PASTEL),
                   "TO LET", 2.0, 0.12), 2.5), 30
    ),
    "fresh: copy of a hatched plan, dark margin, fold": lambda: copied(
        turned(padded(drawn(building(45), 0.02, "hatched"), 2, 2, 2, 2), 1.0)
    ),
}  # fmt: skip
