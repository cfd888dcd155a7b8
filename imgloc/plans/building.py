"""From walls and openings to a map: what encloses rooms, and what was found of a building.

Pixels and strokes end here alike: as walls that stand, doors that are open, and a building within.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from enum import IntEnum
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from skimage.morphology import skeletonize

from imgloc.features.distance import distance_transform
from imgloc.model import BoolArray, OccupancyGrid, Pose2D, compose, plain
from imgloc.numbers import number
from imgloc.plans import masks

#: metres of a cell of the map, unless a pixel of the plan is larger
CELL: float = number("floorplan.cell")
THINNEST: float = number("floorplan.thinnest")  #: metres that walls are thick at least
#: metres that walls drawn as two lines are thick at most, the first that encloses the building
THICKEST: tuple[float, ...] = tuple(number("floorplan.thickest"))


class Kind(IntEnum):
    """Kinds of a pixel of a plan."""

    PAPER, WALL, SWING, TEXT, SYMBOL, HATCH, LINE, OUTSIDE, FRAME = range(9)


KINDS = (
    "paper", "walls", "door swings", "text", "furniture and symbols", "stairs and hatching",
    "thin lines", "outside the building", "a frame round the sheet",
)  # fmt: skip
"""Names of the kinds, by their numbers in :attr:`FloorPlan.kinds`."""
PARTS, MOST_PIXELS = (4, 3, 2, 1), 16_000_000  # pixels along a cell, the finest of at most so many
#: metres of openings in outer walls, that are tried
GAPS: tuple[float, ...] = number("floorplan.gaps")
SOFT: float = number("floorplan.soft")  #: as wide as it is, a line may be with soft edges
PEN: float = number("floorplan.pen")  #: metres that lines are wide at most
ENOUGH: float = number("floorplan.enough")
PIECE: float = number("floorplan.piece")  #: metres that a wall is long at least
LEAST = PIECE * PIECE  #: square metres inside a building
# Without a doubt: least share of the drawing that is free, greatest share of the ink that is
# outside, of the walls' faces that look into gaps, and of the walls that have no room beside them.
DOUBT: tuple[float, float, float, float] = number("floorplan.doubt")
_OPEN: tuple[float, float] = number("floorplan.open")
OTHER: float = number("floorplan.other")
_HOLLOW = 2**0.5 * THICKEST[-1]  # metres: across where two of the thickest walls cross
_ROW = (
    "doors", "rooms", "free_area", "free_share", "outside_share", "framed_area", "other_area",
    "largest_share", "roomless_share", "gaps_share", "gap", "thinnest", "thickest", "inverted",
)  # fmt: skip


@dataclass(frozen=True)
class Removed:
    """Pieces of one kind that were taken from a plan."""

    kind: str  #: of :data:`KINDS`
    count: int  #: connected pieces
    area: float  #: of their ink, square metres


@dataclass(frozen=True, eq=False)
class FloorPlan:
    """The map that was made of a plan, or of a floor of a drawing, and how."""

    grid: OccupancyGrid  #: the map: walls occupied, rooms free, all around the building unknown
    #: (H, W) uint8: what each pixel was taken for, an index of :data:`KINDS`; row 0 is the lowest
    #: y, its first corner that of the plan
    kinds: masks.Grey
    pixel: float  #: side of a pixel of `kinds`, metres
    size: tuple[float, float]  #: width and height of the building, metres
    walls: int  #: connected pieces of wall
    length: float  #: of their middle lines together, metres
    #: of walls, metres: 5 % of their length are thinner, and 5 % thicker, than the first and last;
    #: the second is the median
    thickness: tuple[float, float, float]
    doors: tuple[float, ...]  #: widths of the leaves whose swings were found, metres
    removed: tuple[Removed, ...]  #: by kind, in the order of :data:`KINDS`
    gap: float  #: openings in the outer walls up to so wide count as closed, metres
    thinnest: float  #: what is thinner was no wall, metres
    thickest: float  #: lines farther apart were no wall, metres
    inverted: bool = False  #: the plan was light on dark
    #: what walls enclose by themselves within an outer rectangle, as the frame of a sheet is,
    #: square metres; 0 without such a rectangle
    framed_area: float = 0.0
    #: what walls enclose elsewhere on the drawing, the largest such space, square metres
    other_area: float = 0.0
    single: float = 0.0  #: share of the walls, 0..1, that are single lines
    doorless: float = 0.0  #: the largest space without a way in, square metres
    rooms: int | None = None  #: with closed doors, if the drawing tells which are doors
    scale: tuple[float, str] = (0.0, "")  #: metres a unit of the drawing, and how that was found
    signs: tuple[str, ...] = ()  #: what a drawing tells against its map, the worst first

    @property
    def free_area(self) -> float:
        """Free area of the map, square metres."""
        return float(np.count_nonzero(self.grid.free)) * self.grid.resolution**2

    @property
    def free_share(self) -> float:
        """Share of the drawing, 0..1, that became free: of the box around all that is drawn."""
        span = masks.span((self.kinds > 0) & (self.kinds != Kind.FRAME))
        return self.free_area / (max(1, span) * self.pixel**2)

    @property
    def outside_share(self) -> float:
        """Share of the ink, 0..1, that lies outside of the building; a frame does not count."""
        ink = int(np.count_nonzero((self.kinds > 0) & (self.kinds != Kind.FRAME)))
        return float(np.count_nonzero(self.kinds == Kind.OUTSIDE)) / max(1, ink)

    @cached_property
    def gaps_share(self) -> float:
        """Share of the faces of walls, 0..1, that look into gaps in which no robot fits.

        Spaces without a door that are nowhere wider than a wall may be are such gaps, too.
        """
        free, radius = self.grid.free, THICKEST[0] / 2 / self.grid.resolution
        depth = masks.depth(free)
        wide = distance_transform((depth <= radius).astype(np.uint8)) <= radius + 0.5
        labels, stats = masks.pieces(free, 4)
        rooms = masks.met(labels, len(stats), free & (depth > _HOLLOW / 2 / self.grid.resolution))
        wide &= rooms[labels]
        faces = self.grid.occupied & masks.beside(free)
        into = int(np.count_nonzero(faces & ~masks.beside(free & wide)))
        return into / max(1, int(np.count_nonzero(faces)))

    @cached_property
    def roomless_share(self) -> float:
        """Share of the walls, 0..1, with nothing free as near as the thickest wall is thick."""
        away = distance_transform((~self.grid.free).astype(np.uint8)) * self.grid.resolution
        without = int(np.count_nonzero(self.grid.occupied & (away > THICKEST[-1])))
        return without / max(1, int(np.count_nonzero(self.grid.occupied)))

    @cached_property
    def largest_share(self) -> float:
        """Share of the free area, 0..1, of the largest part that a robot can drive through."""
        areas = masks.pieces(self.grid.free, 4)[1][1:, cv2.CC_STAT_AREA]
        return float(areas.max(initial=0)) / max(1, int(areas.sum()))

    @property
    def doubt(self) -> str:
        """Why the map is most likely wrong; empty if nothing is against it."""
        missed = "the building was most likely missed"
        signs = (
            (self.free_share < DOUBT[0],
             f"{missed}: only {self.free_share:.0%} of the drawing became free"),
            (self.other_area > OTHER * self.free_area,
             f"walls enclose another {self.other_area:.0f} m2 elsewhere on the drawing, as a "
             "second building or floor does; the map has the largest only"),
            (self.outside_share > DOUBT[1],
             f"{missed}: {self.outside_share:.0%} of the ink lies outside of what was found"),
            (self.framed_area > 0,
             f"{missed}: a rectangle surrounds a building of {self.framed_area:.0f} m2, as the "
             "frame of a sheet does"),
            (self.roomless_share > DOUBT[3],
             "a part of the building was most likely cut off, or lines around it are taken for "
             f"walls: {self.roomless_share:.0%} of the walls have no room beside them"),
            (self.gaps_share > DOUBT[2],
             f"walls were most likely misread: {self.gaps_share:.0%} of their faces look into gaps "
             f"less than {THICKEST[0]:g} m wide, or spaces less than {_HOLLOW:.2g} m wide without "
             "a door, as the two lines of a wall do, its hatching, or furniture"),
            (self.largest_share < _OPEN[bool(self.scale[1])],
             "its walls were most likely misread, or its doors are drawn closed, or it is no plan, "
             "but a table or a grid: no part without a wall across it has more than "
             f"{self.largest_share:.0%} of the free area"),
        )  # fmt: skip
        what = next((text for sign, text in signs if sign), "".join(self.signs[:1]))
        return what and (
            f"{what}. Look at `picture`; a larger `thickest` is for walls drawn as two lines, a "
            "larger `gap` for wide doors; crop frames, titles and legends; is the resolution right?"
        )

    def as_row(self) -> dict[str, Any]:
        """The row of the plan, as `imgloc map plan --json` writes it."""
        low, median, high = self.thickness
        return {
            "size": dict(zip(("width", "height"), self.size, strict=True)),
            "walls": {
                "pieces": self.walls,
                "length": self.length,
                "thickness": {"low": low, "median": median, "high": high},
            },
            **{key: getattr(self, key) for key in _ROW},
            "scale": self.scale[1] or None,
            "removed": [asdict(removed) for removed in self.removed],
            "doubt": self.doubt or None,
            "cell": self.grid.resolution,
            "cells": dict(zip(("height", "width"), self.grid.info.shape, strict=True)),
            "origin": plain(self.grid.origin),
        }


def standing(walls: BoolArray, drawn: BoolArray, pixel: float) -> tuple[BoolArray, BoolArray]:
    """The pieces of wall that are long; and pillars: filled, and nearly as wide as long."""
    labels, stats = masks.pieces(walls)
    area = np.maximum(1, stats[:, cv2.CC_STAT_AREA])
    span = np.hypot(stats[:, cv2.CC_STAT_WIDTH], stats[:, cv2.CC_STAT_HEIGHT]) * pixel
    ink = np.bincount(labels[drawn], minlength=len(stats)) / area
    wide = 2 * masks.greatest(masks.depth(walls), labels, walls, len(stats))
    long = span >= PIECE
    # White specks of a scan cut a line into pieces, some of them short.
    groups, found = masks.pieces(masks.grown(walls, max(1, round(THINNEST / pixel))))
    own = masks.greatest(groups, labels, walls, len(stats))
    joined = np.zeros(len(found), np.bool_)
    joined[own[long]] = True
    pillar = ~long & (ink > 0.9) & (wide * pixel > SOFT * PEN) & (area < 4 * wide**2)
    long |= joined[own] & ~pillar
    long[0] = pillar[0] = False
    return long[labels], pillar[labels]


def touching(walls: BoolArray, inside: BoolArray) -> BoolArray:
    """The pieces of wall at the inside of the building."""
    labels, stats = masks.pieces(walls)
    return masks.met(labels, len(stats), walls & masks.grown(inside, 4))[labels]


def inside_of(taken: BoolArray, cell: float, gap: float | None) -> tuple[BoolArray, float]:
    """Cells that walls enclose, with doors in the outer walls closed, up to which width."""
    gaps = GAPS if gap is None else (gap,)
    found = [enclosed(taken, g / 2 / cell) for g in gaps]
    # Of all buildings: the paper between two is not what a wider gap is for.
    areas = np.array([np.count_nonzero(cells) for cells in found])
    # One more: a disc that only just fails to get through a door reaches far into it.
    k = min(int(np.argmax(areas >= ENOUGH * areas.max())) + 1, len(found) - 1)
    # The largest building: cells joined by walls, as a title's are not.
    labels, _ = masks.pieces(found[k] | taken)
    return found[k] & (labels == np.bincount(labels[found[k]], minlength=1).argmax()), gaps[k]


def enclosed(taken: BoolArray, radius: float) -> BoolArray:
    """Cells that a disc from outside does not reach; in cells."""
    pad = int(np.ceil(radius)) + 3
    taken = np.pad(taken, pad)
    # Its centre must get in: on both sides of a small hole in a thin wall it may fill half of it.
    centres, _ = masks.pieces(distance_transform((~taken).astype(np.uint8)) > radius, 4)
    outside, cores = (
        ~taken & (masks.depth(~m) <= radius)
        for m in (centres == centres[0, 0], centres > centres[0, 0])
    )
    cores &= ~outside
    # What only the disc's size keeps it from, a corner outside, or a door: what has an inner side.
    seals, stats = masks.pieces(~(outside | cores | taken))
    out, inner = (masks.met(seals, len(stats), masks.grown(m, 2)) for m in (outside, cores))
    shut = inner | ~out
    shut[0] = False
    within = cores | shut[seals]
    return np.asarray(within[pad:-pad, pad:-pad])


def finished(
    walls: BoolArray, inside: BoolArray, kinds: masks.Grey, cell: float, corner: Pose2D,
    doors: Sequence[float], more: BoolArray | None = None, hidden: BoolArray | None = None,
    movable: BoolArray | None = None, **found: Any,
) -> FloorPlan:  # fmt: skip
    """Make the map of a building of its walls, pixels, and of the cells inside.

    `corner` is the pose of the first cell, `doors` are widths in metres; `more` pixels are
    occupied, cells with `hidden` pixels are unknown, with `movable` ones they may be taken or not.
    The rest is what else was found. The map is cropped to the building, half a metre around it.
    """
    parts = len(walls) // len(inside)
    pixel, middle = cell / parts, skeletonize(walls)
    through = (2 * masks.depth(walls)[middle] - 0.5) * pixel
    low, median, high = np.percentile(through, (5, 50, 95)).tolist()
    _, _, wide, tall = cv2.boundingRect(walls.astype(np.uint8))
    solid = walls if more is None else walls | more
    share = masks.coarser(solid, parts)
    # A wall thinner than a cell may fill no half of any: then its middle counts.
    thin = masks.coarser(middle | (solid & ~walls), parts) * parts > 0.75
    occupied = (share >= 0.5) | thin
    free = (inside | ((share > 0) & masks.grown(inside, 1))) & ~occupied
    if hidden is not None:  # neither of both
        free &= masks.coarser(hidden, parts) == 0
    x, y, columns, rows = cv2.boundingRect((free | occupied).astype(np.uint8))
    pad = round(0.5 / cell)

    def cropped(mask: BoolArray) -> BoolArray:
        return np.pad(mask[y : y + rows, x : x + columns], pad)

    stands = None
    if movable is not None and movable.any():  # a line of one pixel takes a cell that it crosses
        stands = cropped(free & (masks.coarser(movable, parts) * parts > 0.5))
    origin = compose(corner, Pose2D((x - pad) * cell, (y - pad) * cell))
    return FloorPlan(
        OccupancyGrid(cropped(occupied), cropped(free), cell, origin, stands),
        kinds, pixel, (wide * pixel, tall * pixel), len(masks.pieces(walls)[1]) - 1,
        len(through) * pixel, (low, median, high), tuple(sorted(doors)),
        _counted(kinds, len(doors), pixel), single=float(np.mean(through < 3 * pixel)), **found,
    )  # fmt: skip


def _counted(kinds: masks.Grey, swings: int, pixel: float) -> tuple[Removed, ...]:
    out = []
    for k in range(Kind.SWING, len(KINDS)):
        mask = kinds == k
        sizes = masks.pieces(mask)[1][1:, cv2.CC_STAT_AREA]
        large = int(np.count_nonzero(sizes > (THINNEST / 2 / pixel) ** 2))
        if count := swings if k == Kind.SWING else large:
            out.append(Removed(KINDS[k], count, float(np.count_nonzero(mask)) * pixel**2))
    return tuple(out)
