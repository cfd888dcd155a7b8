"""From the strokes of a drawing to maps: what each is, how large, and where a building is.

The name of a layer or block has most of it, in any of several languages. Where no name has it, the
shapes do: an arc with a straight leaf is a door, and the widths of doors are a measure of the unit.
"""

import json
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from imgloc.errors import ConfigError, MapError
from imgloc.features.distance import distance_transform
from imgloc.model import BoolArray, FloatArray, IntArray, Pose2D, compose
from imgloc.numbers import number
from imgloc.plans import building, masks
from imgloc.plans.building import FloorPlan, Kind
from imgloc.plans.doors import HANGS, LEAVES, Door, dense, doors_of
from imgloc.plans.vectors import NAMES, Drawing, Stroke

_KIND = {
    "": Kind.LINE, "wall": Kind.LINE, "note": Kind.TEXT, "stairs": Kind.HATCH, "thing": Kind.SYMBOL,
    "door": Kind.SWING,
}  # fmt: skip
_WALLS = ("wall", "window")
_BITS = 8  # of the fraction of a pixel, that cv2 draws
_FEW = 0.05  # of the strokes of the largest drawing, that another one has: it bounds the work
_ZONE = 1 + HANGS  # widths of a leaf, around its hinge, that its frame and its handle are in
_APART = 2 * building.GAPS[-1]  # metres between two drawings in one file, at least
_PILLARS = 2 * building.THICKEST[-1]  # metres that a filled area may be wide, and be a wall
# Square metres of what is between two lines, at least, for each of the thicknesses of walls: what
# is thicker than most walls has to be longer than a cupboard or a cabin.
_BODY = (building.THINNEST * building.THICKEST[0], building.LEAST)
_SINGLE, _COURT, _BLOCK, _SHUT = number("drawn.signs")
_USUAL = LEAVES[0] * (1 + HANGS), LEAVES[1] * (1 - HANGS)  # metres that half of all doors are wide

#: Of each role what names of layers and blocks begin with, or hold if four letters or more; the
#: first role counts.
_STEMS: dict[str, list[str]] = json.loads(
    Path(__file__).with_name("layers.json").read_text(encoding="utf-8")
)
_BEARING = re.compile(r"port(eur|ant)\w*")  # and no door
_WORDS = re.compile(r"[^\W\d_]+|\.com")


@cache
def role_of(name: str) -> str:
    """Return what is drawn on a layer, in blocks, by their names; empty if no word is known."""
    own, *blocks = (_role(part) for part in name.split(" / "))
    # A block may be called as its floor or its sheet, and have walls.
    some = {"note"} if own == "note" else {own, *blocks} - {"note"} - {""} or {*blocks}
    return next((role for role in _STEMS if role in some), "")


def _role(name: str) -> str:
    words = _WORDS.findall(_BEARING.sub("wall", name.lower()))
    for role, stems in _STEMS.items():
        for stem in stems:
            size = len(stem) if stem.isascii() else 4  # one sign may be a whole word
            fits = str.__eq__ if size < 3 else str.startswith if size == 3 else str.__contains__
            if any(fits(word, stem) for word in words):
                return role
    return ""


def unit_of(drawing: Drawing, doors: Sequence[Door], roles: Sequence[str]) -> tuple[float, str]:
    """Metres of a unit of a drawing, and how that was found: from its header, if doors agree."""
    some = [s.points for s, r in zip(drawing.strokes, roles, strict=True) if r in _WALLS]
    points = np.concatenate(some or [s.points for s in drawing.strokes])
    span = float(np.ptp(np.percentile(points, (5, 95), axis=0), axis=0).max())

    def agree(unit: float) -> int:
        return len(_fit(doors, unit)) if span * unit > 2 * building.PIECE else 0

    guesses = [] if drawing.page else [unit for unit in NAMES if unit not in (0.1, 0.9144)]
    most = max(map(agree, [*guesses, *(unit for unit, _ in drawing.units)]), default=0)
    for unit, said in drawing.units:
        if 2 * agree(unit) > most and (agree(unit) >= 2 or len(doors) < 3):
            return unit, f"{said} as the file states, and {agree(unit)} doors fit"
        if not len(doors) and span * unit > 2 * building.PIECE:
            return unit, f"{said} as the file states; there is no door to check it by"
    stated = " or ".join(said for _, said in drawing.units)
    best = max(guesses, key=agree, default=0.0)
    if agree(best) >= 2:
        but = f", and not {stated} as the file states" if stated else ""
        return best, f"{NAMES[best]}, by the widths of {agree(best)} doors{but}"
    raise MapError(
        f"its scale is unknown: the file states {stated or 'none'}, and no doors fit; "
        "`resolution` is metres a unit of the drawing, and `distance` finds it"
    )


def clusters(points: FloatArray, near: float) -> IntArray:
    """Labels of points (N, 2): those of two pieces are farther apart than `near`, or nearly so."""
    cells, of = np.unique(np.floor(points / near).astype(np.int64), axis=0, return_inverse=True)
    pairs, n = cKDTree(cells).query_pairs(1.5, output_type="ndarray"), len(cells)
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    labels: IntArray = connected_components(graph, directed=False)[1]
    return np.asarray(labels[of.ravel()], np.int64)


@dataclass(eq=False)
class Sheet:
    """Strokes as pixels: what is a line, an area, a door that is closed; and what each is."""

    corner: FloatArray  #: (2,) metres
    pixel: float
    parts: int  #: pixels along a cell
    shape: tuple[int, ...]
    unit: float  #: metres

    def fixed(self, points: FloatArray) -> masks.Labels:
        """Points of the drawing as cv2 takes them."""
        at = (points * self.unit - self.corner) / self.pixel - 0.5
        return np.asarray(np.rint(np.clip(at, -2e4, 4e4) * 2**_BITS), np.int32)

    def lines(self, strokes: Iterable[Stroke]) -> BoolArray:
        """Pixels of lines, as wide as they are drawn."""
        out = np.zeros(self.shape, np.uint8)
        for s in strokes:
            cv2.polylines(out, [self.fixed(s.points)], False, 1, 1, cv2.LINE_8, _BITS)
            if (wide := min(s.wide * self.unit, _PILLARS)) > 1.5 * self.pixel:
                half, step = (wide - self.pixel) / 2 / self.unit, np.diff(s.points, axis=0)
                side = half * step[:, ::-1] * (-1, 1) / np.hypot(*step.T).clip(1e-12)[:, None]
                for a, b, to in zip(s.points[:-1], s.points[1:], side, strict=True):
                    corners = self.fixed(np.array([a - to, b - to, b + to, a + to]))
                    cv2.fillConvexPoly(out, corners, 1, cv2.LINE_8, _BITS)
                radius = round(half * self.unit / self.pixel * 2**_BITS)
                for corner in self.fixed(s.points[1:-1]).tolist():  # no line goes on at its ends
                    cv2.circle(out, corner, radius, 1, -1, cv2.LINE_8, _BITS)
        return out > 0

    def areas(self, strokes: Iterable[Stroke]) -> BoolArray:
        """Pixels of filled areas; of two in one another the inner one is a hole."""
        out = np.zeros(self.shape, np.uint8)
        some = [self.fixed(s.points) for s in strokes if s.filled]
        if some:
            cv2.fillPoly(out, some, 1, cv2.LINE_8, _BITS)
        # What is wider than any pillar is paper, or the colour of a floor.
        labels, stats = masks.pieces(out > 0)
        wide = 2 * self.pixel * masks.greatest(masks.depth(out > 0), labels, out > 0, len(stats))
        return np.asarray((out > 0) & (wide < _PILLARS)[labels])

    def crosses(self, line: FloatArray, walls: BoolArray) -> bool:
        """Return whether a straight line goes through walls and ends at none, as an axis does.

        Examples
        --------
        >>> sheet = Sheet(np.zeros(2), 0.1, 1, (20, 100), 1.0)
        >>> walls = np.zeros((20, 100), bool)
        >>> walls[:, 48:52] = True
        >>> [sheet.crosses(np.array([(1.0, 1.0), (x, 1.0)]), walls) for x in (5.0, 9.0)]
        [False, True]
        """
        long = float(np.hypot(*(line[-1] - line[0]))) * self.unit
        if len(line) > 2 or long < 2 * building.PIECE:
            return False
        ways = np.linspace(0, 1, int(long / self.pixel))[:, None]
        spots = self.fixed(line[0] + ways * (line[1] - line[0])) >> _BITS
        on = walls[tuple(spots.clip(0, np.array(self.shape[::-1]) - 1).T[::-1])]
        free = np.split(~on, np.flatnonzero(np.diff(on)) + 1)
        least = building.THICKEST[-1] / self.pixel
        rooms = sum(bool(run[0]) and len(run) > least for run in free)
        return rooms > 1 and not (on[0] or on[-1])

    def at(self, point: FloatArray, cells: masks.Labels | BoolArray, cell: float) -> int:
        """The value of the cell that a point of the drawing is in; 0 if it is in none."""
        column, row = np.floor((point * self.unit - self.corner) / cell).astype(int).tolist()
        here = 0 <= row < cells.shape[0] and 0 <= column < cells.shape[1]
        return int(cells[row, column]) if here else 0


def drawing_to_maps(
    drawing: Drawing, *, resolution: float | None = None, origin: Pose2D | None = None,
    cell: float | None = None, thickest: float | None = None, gap: float | None = None,
    doors: str = "open", walls: Sequence[str] = (), furniture: bool = False,
) -> list[FloorPlan]:  # fmt: skip
    """Make a map of each floor of a drawing, the largest first."""
    cell = building.CELL if cell is None else cell
    roles = _roles(drawing.strokes, walls)
    leaves = doors_of(drawing.strokes, roles)
    unit, said = (resolution, "as given") if resolution else unit_of(drawing, leaves, roles)
    other = sum(not _fit([d], unit) and any(_fit([d], u) for u, _ in drawing.units) for d in leaves)
    leaves = _fit(leaves, unit)
    roles = _without_doors(drawing.strokes, roles, leaves)
    best, plans, box = list[Floor](), list[FloorPlan](), np.inf
    pairs = [(s, role) for s, role in zip(drawing.strokes, roles, strict=True) if not s.dashed]
    for taken in (_WALLS, (*_WALLS, "")):
        some = [s for s, role in pairs if role in taken]
        if not some or (walls and "" in taken):
            continue
        if sum(f.area for f in best) * cell**2 > building.DOUBT[0] * box:
            break
        box = np.ptp(np.concatenate([s.points for s in some]), axis=0).prod() * unit**2
        floors = _floors(some, leaves, unit, cell, thickest, gap, named="" not in taken)
        if sum(f.area for f in floors) > 2 * sum(f.area for f in best):
            best = floors
    if not best:
        raise MapError(
            "its lines enclose no room, not even with openings in outer walls closed; its scale is "
            f"{unit:g} metres a unit, {said}; `walls` names the layers of walls, and `resolution` "
            "is another scale"
        )
    lost = sum(not any(f.has(d) for f in best) for d in leaves)
    usual = np.median([d.width for d in leaves] or [0]) * unit
    about = (
        (not resolution and not leaves,
         f"no door tells whether its scale of {unit:g} metres a unit is right: measure a room "
         "on the map; `distance` gives another scale"),
        (not resolution and drawing.page and not _USUAL[0] < usual < _USUAL[1],
         f"its doors are {usual:.2f} m wide, half of them less: is its scale right, {said}?"),
        (drawing.page and not resolution and other > 1,
         f"{other} doors fit another scale that is written on it: a part of it has that one, "
         f"and is not right at {said}; make a map of each part by `resolution`"),
    )  # fmt: skip
    for floor in best:
        plan = _map_of(
            floor, drawing.strokes, roles, origin or Pose2D(0, 0), doors, said, furniture=furniture
        )
        cut = "a part of the building was most likely cut off: leaves of doors outside of what was "
        signs = ((lost > 0 and not plans, f"{cut}found: {lost}"), *about, *floor.signs(plan))
        plans.append(replace(plan, signs=tuple(text for sign, text in signs if sign)))
    return plans


def _fit(leaves: Sequence[Door], unit: float) -> list[Door]:
    """Those of the leaves that are as wide as doors are."""
    return [d for d in leaves if LEAVES[0] < d.width * unit < LEAVES[1]]


def _roles(strokes: Sequence[Stroke], walls: Sequence[str]) -> list[str]:
    """Roles of strokes by their names; `walls` are the layers of walls, if any are given."""
    names = {s.layer: role_of(s.layer) for s in strokes}
    if walls:
        of = {name: {*name.lower().split(" / ")} for name in names}
        known, taken = set[str]().union(*of.values()), {name.strip().lower() for name in walls}
        for asked in sorted(taken):
            if asked not in known:
                some = ", ".join(sorted(name[:30] for name in known)[:12])
                raise ConfigError(f"`walls`: got {asked}, expected of the layers {some}")
        names = {
            name: "wall" if of[name] & taken else "" if role == "wall" else role
            for name, role in names.items()
        }
    if not {*_WALLS, ""} & {*names.values()}:  # a program names what its parts are
        return [""] * len(strokes)
    return [names[s.layer] for s in strokes]


def _without_doors(
    strokes: Sequence[Stroke], roles: Sequence[str], leaves: Sequence[Door]
) -> list[str]:
    """The roles, that of a door for leaves, frames and handles: all near a swing but walls."""
    hinges = np.array([d.hinge for d in leaves]).reshape(-1, 2)
    widths = np.array([d.width for d in leaves])

    def hangs(s: Stroke, role: str) -> bool:
        near = np.hypot(*(s.points[:, None] - hinges).T).max(axis=1) < _ZONE * widths
        # A short line without a name may be the end of a wall.
        long = np.ptp(s.points, axis=0).max() >= widths / 2
        return bool((near & (long | bool(role))).any())

    return [
        "door" if role != "wall" and len(s.points) < 200 and hangs(s, role) else role
        for s, role in zip(strokes, roles, strict=True)
    ]


@dataclass(frozen=True, eq=False)
class Floor:
    """Walls that enclose rooms on a drawing."""

    sheet: Sheet
    walls: BoolArray  #: pixels
    shut: BoolArray  #: pixels of closed doors
    leaves: Sequence[Door]
    inside: BoolArray  #: cells
    gap: float  #: metres
    guessed: bool  #: no names tell which lines are walls
    axes: Sequence[Stroke] = ()  #: straight lines through walls that are none

    @property
    def area(self) -> int:
        """Cells of the building."""
        return int(np.count_nonzero(self.inside))

    @property
    def block(self) -> float:
        """Square metres of walls thicker than where two of the thickest walls cross."""
        cores = masks.opened(self.walls, 2**0.5 * building.THICKEST[-1] / self.sheet.pixel)
        return float(np.count_nonzero(cores)) * self.sheet.pixel**2

    def has(self, door: Door) -> bool:
        """Return whether a door is in the building, or in a wall of it."""
        cell = self.sheet.pixel * self.sheet.parts
        near = masks.grown(self.inside, round(building.GAPS[0] / cell))
        return bool(self.sheet.at(door.closed, near, cell))

    def signs(self, plan: FloorPlan) -> tuple[tuple[bool, str], ...]:
        """Pairs: is this against the map of the floor, and in words; the worst first."""
        cell, shut = self.sheet.pixel * self.sheet.parts, self.blocked
        ends = [end for s in self.axes for end in s.points if self.sheet.at(end, self.inside, cell)]
        at = ", ".join("{:.1f} {:.1f}".format(*end * self.sheet.unit) for end in ends[:3])
        return (
            (len(ends) > 0,
             "lines that go through walls were taken for axes, and left out, but end in rooms: "
             f"{len(ends)} ends, at {at} m; if one is a wall it is missing"),
            (shut > _SHUT * len(self.leaves),
             f"{shut} of {len(self.leaves)} doors are in walls, or open into walls, as if two "
             "floors lay over each other, or thresholds were walls; `walls` names the layers"),
            (plan.single > _SINGLE,
             f"{plan.single:.0%} of its walls are single lines: rooms are half a wall too large"),
            (bool(self.leaves) and plan.doorless > _COURT * plan.free_area,
             f"{plan.doorless:.0f} m2 have no door: a courtyard, or a door that was not found"),
            (self.block > _BLOCK,
             f"{self.block:.0f} m2 of its walls are thicker than walls: a table among them?"),
            (self.guessed,
             "no name of a layer tells what is a wall, so furniture may be part of walls; `walls` "
             "names the layers"),
        )  # fmt: skip

    @property
    def blocked(self) -> int:
        """Leaves that walls are across where they are closed, or where they swing."""
        count, walls = 0, masks.beside(self.walls)
        for d in self.leaves:
            turns = np.linspace(0, 1, 6)[:, None] * (d.opened - d.closed) + d.closed - d.hinge
            turns *= d.width / np.hypot(*turns.T).clip(1e-9 * d.width)[:, None]
            spots = d.hinge + np.outer((0.3, 0.5, 0.7, 0.85), turns).reshape(-1, 2)
            on = np.array([self.sheet.at(spot, walls, self.sheet.pixel) for spot in spots])
            count += bool(on[::6].mean() > 0.5 or on.reshape(4, 6)[:, 2:].mean() > _SHUT)
        return count


def _floors(
    strokes: Sequence[Stroke], leaves: Sequence[Door], unit: float, cell: float,
    thickest: float | None, gap: float | None, *, named: bool,
) -> list[Floor]:  # fmt: skip
    """The floors that strokes enclose, the largest first; `named` if all of them are walls."""
    points = [dense(s.points * unit, _APART / 2) for s in strokes]
    labels = clusters(np.concatenate(points), _APART)
    of = labels[np.cumsum([0, *(len(p) for p in points[:-1])])]
    floors = list[Floor]()
    counts = np.bincount(of)
    for k in np.flatnonzero(counts >= _FEW * counts.max()).tolist():
        some = [s for s, own in zip(strokes, of, strict=True) if own == k]
        floors += _floors_of(some, leaves, unit, cell, thickest, gap, named=named)
    if any(len(f.leaves) > 1 for f in floors):
        floors = [f for f in floors if f.leaves]
    floors.sort(key=lambda f: -f.area)
    return [f for f in floors if f.area > building.OTHER * floors[0].area]


def _floors_of(
    strokes: Sequence[Stroke], leaves: Sequence[Door], unit: float, cell: float,
    thickest: float | None, gap: float | None, *, named: bool,
) -> list[Floor]:  # fmt: skip
    """The floors of strokes that lie together."""
    points = np.concatenate([s.points for s in strokes]) * unit
    low, high = np.floor((points.min(axis=0) - 1) / cell) * cell, points.max(axis=0) + 1
    size = np.ceil((high - low)[::-1] / cell).astype(int)
    parts = next((p for p in building.PARTS if np.prod(size * p) <= building.MOST_PIXELS / 2), 1)
    if np.prod(size) > building.MOST_PIXELS:
        raise MapError(
            f"it is {size[1] * cell:.0f} x {size[0] * cell:.0f} m at {unit:g} metres a unit, more "
            "than its map may have; a larger `cell`, or another `resolution`"
        )
    sheet = Sheet(low, cell / parts, parts, tuple((size * parts).tolist()), unit)
    drawn = sheet.lines(strokes)
    shut = sheet.lines(Stroke(np.array([d.hinge, d.closed]), "") for d in leaves)
    walls = _bodies(sheet, drawn | sheet.areas(strokes), leaves, thickest, named=named)
    firm = masks.opened(walls, max(3.0, building.THINNEST / sheet.pixel))
    if named:
        firm |= sheet.lines(s for s in strokes if role_of(s.layer) == "window")
        about = masks.grown(firm, 2)
        if axes := [s for s in strokes if sheet.crosses(s.points, about)]:
            others = [s for s in strokes if s not in axes]
            floors = _floors_of(others, leaves, unit, cell, thickest, gap, named=named)
            return [replace(floor, axes=(*floor.axes, *axes)) for floor in floors]
    else:  # lines are walls only beside what is between two of them
        walls = firm = np.logical_or(*building.standing(firm, drawn, sheet.pixel))
    taken = masks.coarser(walls | shut, parts) > 0
    # Without a known door no leaf joins the walls beside it.
    near = building.GAPS[0 if leaves else 1] / cell
    labels, stats = masks.pieces(masks.grown(taken, max(1, round(near))))
    floors = list[Floor]()
    spans = masks.spans(stats)
    at = np.array([sheet.at(d.closed, labels, cell) for d in leaves], int)
    doors = np.bincount(at, minlength=len(stats))[1:].max(initial=0) > 1
    pad, bare = round(building.GAPS[-1] / 2 / cell), masks.coarser(firm | shut, parts) > 0
    for k in np.argsort(-spans, kind="stable").tolist():
        most = max((f.area for f in floors), default=0)
        if spans[k] <= max(building.LEAST / cell**2, building.OTHER * most):
            break
        if doors and not (at == k).any():  # a frame, a site or a section, where others have doors
            continue
        corner = np.maximum(stats[k, :2] - pad, 0)  # column and row
        here = tuple(map(slice, corner[::-1], (stats[k, :4].reshape(2, 2).sum(axis=0) + pad)[::-1]))
        fine = tuple(slice(s.start * parts, s.stop * parts) for s in here)
        own, lines = labels[here] == k, walls[fine]
        inside, closed = building.inside_of(taken[here] & own, cell, gap)
        less, _ = building.inside_of(bare[here] & own, cell, gap)
        lines, inside = _cleared(lines, firm[fine], inside, less, cell)
        if np.count_nonzero(inside) * cell**2 > building.LEAST:
            lines = building.touching(lines, masks.finer(inside, parts))
            inside |= (masks.coarser(shut[fine] & ~lines, parts) > 0) & masks.grown(inside, 1)
            hung = [d for d, of in zip(leaves, at, strict=True) if of == k]
            part = replace(sheet, corner=low + corner * cell, shape=lines.shape)
            floors.append(Floor(part, lines, shut[fine], hung, inside, closed, not named))
    return floors


def _cleared(
    walls: BoolArray, firm: BoolArray, inside: BoolArray, less: BoolArray, cell: float
) -> tuple[BoolArray, BoolArray]:
    """Walls and the inside of a floor without lines that bound no wall, as those of dimensions.

    What firm walls enclose without them, `less`, is the building, with rooms that have firm walls
    on most sides. Lines in it stay if they are joined to a wall.
    """
    if 2 * np.count_nonzero(less) < np.count_nonzero(inside):  # walls are drawn as lines
        return walls, inside
    lone, parts = walls & ~masks.grown(firm, 2), len(walls) // len(less)
    labels, stats = masks.pieces(inside & ~less, 4)
    wide = 2 * cell * masks.greatest(masks.depth(labels > 0), labels, labels > 0, len(stats))
    sides = [
        np.bincount(labels[masks.beside(masks.coarser(m, parts) > 0)], minlength=len(stats))
        for m in (firm, lone)
    ]
    rooms = (wide > building.PIECE) & (sides[0] > building.ENOUGH * sides[1])
    inside = less | rooms[labels]
    labels, stats = masks.pieces(lone & masks.finer(masks.grown(inside, 1), parts))
    joined = masks.met(labels, len(stats), masks.grown(firm, 3))
    return (walls & ~lone) | joined[labels], inside


def _bodies(
    sheet: Sheet, drawn: BoolArray, leaves: Sequence[Door], thickest: float | None, *, named: bool
) -> BoolArray:
    """The lines of walls, and what is between them: nowhere wider than a wall, or a dead end.

    No door leads into a wall: a space on either side of a leaf is a room.
    """
    free, pixel = ~drawn, sheet.pixel
    depth = masks.depth(free)
    ways = [(d.hinge + d.closed + k * (d.opened - d.hinge)) / 2 for d in leaves for k in (-1, 1)]

    def filled(enough: BoolArray, labels: masks.Labels) -> BoolArray:
        enough[[0, *(sheet.at(spot, labels, pixel) for spot in ways)]] = False
        return enough[labels]

    labels, stats = masks.pieces(free, 4)
    most = thickest or building.THICKEST[-1 if named else 0]
    wide = 2 * pixel * masks.greatest(depth, labels, free, len(stats))
    out = drawn | filled(wide <= most, labels)
    for most, least in zip(
        building.THICKEST if thickest is None else (thickest,), _BODY, strict=False
    ):
        radius = most / 2 / pixel
        near = distance_transform((depth <= radius).astype(np.uint8)) <= radius
        for _ in range(round(0.7 * radius)):  # into corners, and no line is crossed
            near = masks.grown(near, 1) & free
        labels, stats = masks.pieces(free & ~near, 4)
        out |= filled(stats[:, cv2.CC_STAT_AREA] > least / pixel**2, labels)
    return out


def _map_of(
    floor: Floor, strokes: Sequence[Stroke], roles: Sequence[str], origin: Pose2D, doors: str,
    said: str, *, furniture: bool,
) -> FloorPlan:  # fmt: skip
    """The map of a floor, and what each pixel around it was taken for."""
    sheet, n, inside = floor.sheet, floor.sheet.parts, floor.inside
    walls, shut, cell = floor.walls, floor.shut, sheet.pixel * n
    kinds = np.zeros(sheet.shape, np.uint8)
    # Where no name tells furniture, a line that is no wall may be some.
    for role, kind in (_KIND | {"": Kind.SYMBOL if floor.guessed else Kind.LINE}).items():
        kinds[sheet.lines(s for s, r in zip(strokes, roles, strict=True) if r == role)] = kind
    kinds[(kinds > 0) & ~masks.grown(masks.finer(inside, n), 2)] = Kind.OUTSIDE
    kinds[walls] = Kind.WALL
    corner = compose(origin, Pose2D(*sheet.corner.tolist()))
    more, movable, within = np.zeros_like(walls), np.zeros_like(walls), masks.finer(inside, n)
    (more if doors == "closed" else movable)[shut & within] = True
    (more if furniture else movable)[(kinds == Kind.SYMBOL) & within] = True
    hidden = masks.grown(shut, round(0.1 / sheet.pixel)) & ~walls if doors == "unknown" else None
    apart = inside & ~masks.grown(masks.coarser(walls | shut, n) > 0, 1)
    labels, stats = masks.pieces(apart, 4)
    rooms = stats[1:, cv2.CC_STAT_AREA] * cell**2
    doors_at = masks.met(labels, len(stats), masks.grown(masks.coarser(shut, n) > 0, 3))[1:]
    return building.finished(
        walls, inside, kinds, cell, corner, [d.width * sheet.unit for d in floor.leaves],
        more, hidden, movable,
        gap=floor.gap, thinnest=sheet.pixel, thickest=building.THICKEST[-1],
        rooms=int(np.count_nonzero(rooms > building.LEAST / 2)), scale=(sheet.unit, said),
        doorless=float(rooms[~doors_at].max(initial=0.0)),
    )  # fmt: skip
