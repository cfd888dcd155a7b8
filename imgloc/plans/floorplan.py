"""From a floor plan to a map: walls as solid bodies, all else that is drawn taken away.

An architect draws a wall filled, as two lines, hatched between these, or as one thick line; and
besides walls doors with their swings, windows, stairs, furniture, names and dimensions. They
differ in thickness: a wall is what lines close together enclose, and what is thicker than a
pen. The rest a laser never meets, or not where it is drawn: it is neither wall nor obstacle.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.ndimage import map_coordinates
from skimage.filters import threshold_otsu
from skimage.morphology import skeletonize

from imgloc.errors import ConfigError, MapError, expect
from imgloc.features.distance import distance_image
from imgloc.model import BoolArray, Float32Array, FloatArray, Pose2D
from imgloc.numbers import number
from imgloc.options import PlanWalls
from imgloc.plans import building, masks
from imgloc.plans.building import FloorPlan, Kind
from imgloc.plans.doors import LEAVES, Door, arcs

_BYTES = 60  # of each such pixel, at the peak
# What a plan looks like; numbers.json says of each what it is.
_FRAMED = number("floorplan.framed")
_MOST = number("floorplan.most")
_STRIP: float = number("floorplan.strip")
_CELLS: int = number("floorplan.cells")
_LITTLE = (building.THICKEST[0] / 2) ** 2  # square metres: of a cell of a hatching
_FAINT = number("floorplan.faint")
_LIGHT = np.array(number("floorplan.light"))
_DENSE = number("floorplan.dense")
_THINNER = number("floorplan.thinner")
_CORNERS = number("floorplan.corners")
_WINDOW = number("floorplan.window")
_LETTER = LEAVES[0]  # metres that a letter is high at most: no leaf is as narrow
STEPS = 1 + len(building.THICKEST) + len(_THINNER)  #: of :func:`plan_to_map` at most


@dataclass(frozen=True, eq=False)
class Between:
    """The spaces between lines of a plan, in pixels."""

    thickest: float  #: metres between the lines of a wall at most
    holes: BoolArray  #: spaces between the lines of a wall
    hatching: BoolArray  #: those of stairs, tiles and other hatching
    body: BoolArray  #: walls that are drawn as lines, with these


@dataclass(frozen=True, eq=False)
class Enclosed:
    """Walls that enclose the building."""

    thinnest: float  #: what is thinner was no wall, metres
    walls: BoolArray  #: pixels, without frames and pillars
    pillars: BoolArray  #: pixels
    swings: list[Door]
    inside: BoolArray  #: cells
    gap: float  #: openings up to so wide count as closed, metres
    frame: BoolArray  #: pixels of frames round the sheet


def plan_to_map(
    grey: masks.Grey, resolution: float, *, origin: Pose2D | None = None,
    cell: float | None = None, thinnest: float | None = None, thickest: float | None = None,
    gap: float | None = None, ink: float | None = None, inverted: bool | None = None,
    advance: Callable[[], None] = lambda: None,
) -> FloorPlan:  # fmt: skip
    """Make a map of a floor plan: walls as they stand, everything else that is drawn taken away.

    Parameters
    ----------
    grey : (H, W) uint8 array
        The plan, row 0 its lowest; 255 is white.
    resolution : float
        Metres a pixel.
    origin : Pose2D, optional
        Pose of the plan's lower-left corner in the map frame; default (0, 0, 0).
    cell : float, optional
        Side of a cell of the map, metres; default 0.05, or a pixel if that is larger.
    thinnest : float, optional
        Least thickness of walls, metres, default 0.07: thinner ink is a line. Where such walls
        enclose nothing, or little of the drawing, thinner ones are looked for.
    thickest : float, optional
        Greatest distance between the two lines of a wall, metres: a wider gap is a room. Default:
        the first of 0.5, 0.7 and 0.95 with which walls enclose about as much as with any.
    gap : float, optional
        Openings in the outer walls up to this width, metres, count as closed while the inside is
        found; default: as wide as the plan needs.
    ink : float, optional
        Darkness, 0..1, against the paper around it, from which on a pixel is ink; by default Otsu's
        threshold.
    inverted : bool, optional
        Whether the plan is light on dark; found by default.
    advance : callable
        Called after each of :data:`STEPS` steps, of which some may be left out.

    Returns
    -------
    FloorPlan

    Raises
    ------
    ConfigError
        If a parameter is out of its range.
    MapError
        If it is no plan: a photo, a map that a robot made, no wall, nothing that walls enclose.

    Examples
    --------
    Two rooms, whose walls are drawn as two lines 0.2 m apart:

    >>> plan = np.full((300, 420), 255, np.uint8)
    >>> for x, y, wide, high in ((40, 40, 340, 220), (50, 50, 180, 200), (240, 50, 130, 200)):
    ...     plan = cv2.rectangle(plan, (x, y), (x + wide, y + high), 0, 1)
    >>> found = plan_to_map(plan, 0.02)
    >>> found.walls, [round(metres, 1) for metres in (*found.size, found.thickness[1])]
    (1, [6.8, 4.4, 0.2])
    """
    expect(grey, np.ndarray, "grey")
    PlanWalls(cell, thinnest, thickest, gap, ink)  # refuses what is out of its range
    if not 0.0005 <= resolution <= 1:
        raise ConfigError(f"`resolution`: got {resolution:g}, expected 0.0005 to 1")
    thinnest = building.THINNEST if thinnest is None else thinnest
    if thinnest >= (widest := thickest or building.THICKEST[0]):
        raise ConfigError(f"`thinnest={thinnest:g}`: expected less than `thickest={widest:g}`")
    refuse_recorded(grey)
    grey, inverted = _evened(grey, resolution, inverted)
    refuse_photo(grey)
    advance()
    cell = max(building.CELL, resolution) if cell is None else cell
    drawn, bold, parts = _sheet(grey, resolution, cell, ink)
    pixel = cell / parts
    pen = _pen(bold, 2 * _LETTER / pixel) * pixel
    thin = max(thinnest, min(building.SOFT * max(pen, building.SOFT * resolution), building.PEN))
    tried = (thickest,) if thickest is not None else building.THICKEST
    between, frame = _lined(drawn, bold, resolution, tried, thin, parts, pixel, gap, advance)
    found = _enclosing(drawn, bold, frame, between, thin, parts, pixel, gap, advance)
    inside, solid = masks.finer(found.inside, parts), found.walls & ~found.frame
    walls = building.touching(solid | found.pillars, inside)
    kinds = _kinds(drawn, walls, inside, between.hatching, found.frame, found.swings, pixel)
    plan = building.finished(
        walls, found.inside, kinds, cell, origin or Pose2D(0, 0),
        [door.width * pixel for door in found.swings],
        gap=found.gap, thinnest=found.thinnest, thickest=between.thickest, inverted=inverted,
        other_area=_elsewhere(solid, found.inside, cell, found.gap),
    )  # fmt: skip
    return replace(plan, framed_area=_framed(plan.grid.occupied, cell, gap) * cell**2)


def _lined(
    drawn: BoolArray, bold: BoolArray, resolution: float, thickest: Sequence[float], thin: float,
    parts: int, pixel: float, gap: float | None, advance: Callable[[], None],
) -> tuple[Between, BoolArray]:  # fmt: skip
    """The spaces between lines of walls, by the first thickness that encloses enough; frames."""
    line = max(_pen(drawn, 2 * _LETTER / pixel), building.SOFT * resolution / pixel)
    across = max(building.THINNEST / 2, 2 * building.SOFT * resolution) / pixel
    least, frame = max(2.0, thin / pixel), np.zeros_like(drawn)
    tried = list[tuple[int, Between]]()
    for most in thickest:
        between = _between_lines(drawn, most, line, across, pixel)
        solid = masks.opened(masks.opened(bold, least) | between.body, least)
        walls, _ = building.standing(solid & ~frame, drawn, pixel)
        inside, ring, _ = _building(walls, parts, pixel, gap)
        frame |= ring
        tried.append((int(np.count_nonzero(inside)), between))
        advance()
    enough = _MOST * max(area for area, _ in tried)
    between = next(b for area, b in tried if area >= enough)
    return between, frame


def _enclosing(
    drawn: BoolArray, bold: BoolArray, frame: BoolArray, between: Between, thin: float,
    parts: int, pixel: float, gap: float | None, advance: Callable[[], None],
) -> Enclosed:  # fmt: skip
    """The walls that enclose the building, no thinner than needed: `thin` metres if possible."""
    best, best_area = None, building.LEAST / (parts * pixel) ** 2
    for share in _THINNER:
        walls, pillars, short, swings = _walls(drawn, bold, between, share * thin, pixel)
        inside, ring, closed = _building(walls & ~frame, parts, pixel, gap)
        frame = frame | ring
        inside, corners = _with_corners(walls & ~frame, short, inside, parts * pixel, closed)
        walls, area = walls | corners, float(np.count_nonzero(inside))
        if area >= best_area:
            best, best_area = (share * thin, walls, pillars, swings, inside, closed), area
        advance()
        # A frame is a large share of what is drawn, but thinner lines along it are no walls.
        span = masks.span(walls & ~frame) if frame.any() else masks.span(drawn)
        if best is not None and area * parts**2 >= building.DOUBT[0] * span:
            break
    if best is None:
        _, _, wide, high = cv2.boundingRect(drawn.astype(np.uint8))
        why = (
            f"walls were found, but they enclose nothing of {building.LEAST:g} square metres, even "
            f"with openings of {gap or building.GAPS[-1]:g} m closed; a wider `gap` closes more"
        )
        if np.count_nonzero(walls) * pixel**2 < 0.2:
            why = (
                f"no walls found: no ink is {thin * _THINNER[-1]:.2f} m thick, and no lines run "
                f"less than {between.thickest:g} m apart"
            )
        size = f"{wide * pixel:.3g} x {high * pixel:.3g} m"
        raise MapError(f"{why}; the drawing is {size}; is the resolution right?")
    return Enclosed(*best, frame)


def _walls(
    drawn: BoolArray, bold: BoolArray, between: Between, thinnest: float, pixel: float
) -> tuple[BoolArray, BoolArray, BoolArray, list[Door]]:
    """Walls no thinner than `thinnest`, metres, doors open; pillars; short pieces; door swings.

    Short pieces are too short for a wall, and no pillars.
    """
    least = max(2.0, thinnest / pixel)
    solid = masks.opened(bold, least) | between.body
    rough, _ = building.standing(masks.opened(solid, least), drawn, pixel)
    swings = _swings(drawn, rough, pixel)
    thick, leaf = between.thickest / pixel, building.PEN / pixel
    solid = _without_leaves(solid, between.holes, swings, thick, leaf)
    walls, pillars = building.standing(masks.opened(solid, least), drawn, pixel)
    return walls, pillars, masks.opened(solid, least) & ~walls & ~pillars, swings


def _with_corners(
    walls: BoolArray, short: BoolArray, inside: BoolArray, cell: float, gap: float
) -> tuple[BoolArray, BoolArray]:
    """Cells of the building with the short pieces of its outer walls; and those pieces.

    A corner between two doors is as short as a letter. A piece about as thick as the walls counts
    if it is at a corner of the box around the building, and the building is open without it.
    """
    parts, none = len(walls) // len(inside), np.zeros_like(walls)
    own = building.touching(walls, masks.finer(inside, parts))
    if not own.any():
        return inside, none
    points = cv2.findNonZero(own.astype(np.uint8))
    factor, share, near = _CORNERS
    spots = none.astype(np.uint8)
    for corner in np.rint(cv2.boxPoints(cv2.minAreaRect(points))).astype(np.int32).tolist():
        cv2.circle(spots, corner, round(near * parts / cell), 1, -1)
    labels, stats = masks.pieces(short & ~masks.finer(inside, parts))
    thick = masks.greatest(masks.depth(short), labels, labels > 0, len(stats))
    median = np.median(masks.depth(own)[skeletonize(own)])
    at_corner = masks.met(labels, len(stats), (labels > 0) & (spots > 0))
    corners = (at_corner & (thick >= share * median))[labels]
    taken = masks.coarser(walls | corners, parts) > 0
    with_them, _ = building.inside_of(taken, cell, gap)
    if np.count_nonzero(with_them) <= factor * np.count_nonzero(inside):
        return inside, none
    return with_them, corners


def plan_bytes(height: int, width: int, resolution: float, cell: float | None = None) -> int:
    """Peak of :func:`plan_to_map` for a plan of so many pixels, besides the plan, bytes."""
    area = height * width * resolution**2
    most = area / (min(cell or building.CELL, building.CELL) / building.PARTS[0]) ** 2
    return round(_BYTES * min(most, max(building.MOST_PIXELS, height * width))) + 3 * height * width


def _evened(grey: masks.Grey, resolution: float, inverted: bool | None) -> tuple[masks.Grey, bool]:
    """A plan against the paper around each pixel, dark on light; and whether it was not.

    Shadows, and the colours of rooms, are paper: what is wider than any wall.
    """
    # Odd: see opened.
    side = max(3, min(round(building.PIECE / resolution), min(grey.shape) // 4)) | 1
    kernel = np.ones((side, side), np.uint8)
    smooth = cv2.medianBlur(grey, 3)
    light, dark = cv2.dilate(smooth, kernel), cv2.erode(smooth, kernel)
    if inverted is None:  # most of what lies near lines, even the faintest, is paper, and not ink
        near = cv2.subtract(light, dark) > 255 * _LIGHT[0]
        inked = cv2.subtract(light, smooth) > cv2.subtract(smooth, dark)
        inverted = bool(2 * np.count_nonzero(inked & near) > np.count_nonzero(near))
    if inverted:
        grey, light = 255 - grey, 255 - dark
    paper = cv2.erode(light, kernel)
    # What is darker than the faintest line may be on the lightest paper is no other paper.
    least = max(1, round(_LIGHT[0] * float(np.percentile(paper, 95))))
    evened = cv2.divide(grey, np.maximum(paper, least).astype(np.uint8), scale=255)
    return np.asarray(evened, np.uint8), inverted


def _sheet(
    grey: masks.Grey, resolution: float, cell: float, ink: float | None
) -> tuple[BoolArray, BoolArray, int]:
    """Drawn pixels, and pixels as dark as ink, resampled to whole pixels per cell.

    A thin line whose pixels are half white must not break; but a line is not to look like a wall.
    """
    limit = float(threshold_otsu(grey)) if ink is None else 255 * (1 - ink)
    dark = grey <= limit
    if dark.all() or not dark.any():
        raise MapError("nothing is dark as ink against the paper around it, expected dark walls")
    tones = np.array([np.median(grey[dark]), np.median(grey[~dark])])
    faint = limit if ink is not None else max(limit, _LIGHT @ tones)
    high, wide = (side * resolution for side in grey.shape)
    for parts in (max(1, round(n * cell / building.CELL)) for n in building.PARTS):
        pixel = cell / parts
        size = round(wide / pixel), round(high / pixel)
        if size[0] * size[1] <= building.MOST_PIXELS:
            break
    if resolution < pixel:
        both = [
            cv2.resize(m.astype(np.float32), size, interpolation=cv2.INTER_AREA) > share
            for m, share in ((grey <= faint, _FAINT), (dark, 0.5))
        ]
    else:
        larger = cv2.resize(grey, size, interpolation=cv2.INTER_LINEAR)
        both = [larger <= faint, larger <= limit]
    drawn, bold = (np.pad(m, [(0, -side % parts) for side in m.shape]) for m in both)
    return drawn, bold, parts


def _between_lines(
    drawn: BoolArray, thickest: float, line: float, across: float, pixel: float
) -> Between:
    """Walls that are drawn as lines: `line` wide, `across` at most between two spaces, pixels."""
    holes, hatching = _spaces(drawn, thickest / pixel, across, pixel)
    # The lines between two spaces of a wall are in it, and half of the lines along it.
    body = masks.closed(holes, across) & (drawn | holes)
    body = masks.grown(body, round(line / 2)) & (drawn | body)
    # A narrow hatched wall is more ink than paper.
    beside = masks.grown(holes, round(building.THINNEST / pixel))
    body |= masks.opened(drawn | holes, _DENSE * line) & beside
    if thickest > building.THICKEST[0]:  # so thick are cupboards, too, but outer walls are longer
        labels, stats = masks.pieces(masks.opened(body, building.THICKEST[0] / pixel))
        span = np.hypot(stats[:, cv2.CC_STAT_WIDTH], stats[:, cv2.CC_STAT_HEIGHT])
        short = span < 2 * building.PIECE / pixel
        short[0] = False
        body &= ~masks.grown(short[labels], round(across))
        holes &= body
    return Between(thickest, holes, hatching, body)


def _spaces(
    drawn: BoolArray, thick: float, across: float, pixel: float
) -> tuple[BoolArray, BoolArray]:
    """Spaces between the lines of a wall, and those of stairs, tiles and other hatching."""
    labels, stats = masks.pieces(~drawn, 4)
    half = masks.depth(~drawn)
    narrow = ~masks.met(labels, len(stats), half > thick / 2)
    narrow[0] = False
    narrow[masks.border(labels)] = False
    holes = narrow[labels]
    # Narrow spaces side by side are a wall only if they are as thick as one together.
    together = masks.depth(drawn | holes)
    depth, width = (masks.greatest(m, labels, holes, len(stats)) for m in (together, 2 * half))
    deep = depth > 0.55 * thick + 2
    deep &= ~_windows(drawn, labels, deep, together, thick, across)
    long = stats[:, cv2.CC_STAT_AREA] >= _STRIP * np.maximum(width, 1) ** 2
    # What is not belongs to a wall if it is one of many cells between the lines of a hatching.
    little = stats[:, cv2.CC_STAT_AREA] < _LITTLE / pixel**2
    cells = (narrow & ~deep & (little | ~long))[labels]
    strip, found = masks.pieces(masks.closed(cells, building.THINNEST / pixel))
    members = np.zeros(len(found), np.int64)
    first = np.unique(labels[cells], return_index=True)[1]
    np.add.at(members, strip[cells][first], 1)
    hatched = masks.met(labels, len(stats), cells & (members >= _CELLS)[strip])
    wall = narrow & ~deep & (long | hatched)
    return wall[labels], (narrow & deep)[labels]


def _windows(
    drawn: BoolArray, labels: masks.Labels, deep: BoolArray, together: Float32Array,
    thick: float, across: float,
) -> BoolArray:  # fmt: skip
    """Which of the spaces that are `deep` are panes of windows in thicker solid outer walls, (N,).

    With such a pane, whose lines are `across` pixels wide at most, the wall is no thicker than
    beside it. A cupboard makes it thicker; a door with two leaves leads to no paper outside.
    """
    panes = deep[labels]
    union, solid = (_around(m, thick) for m in (together, masks.depth(drawn)))
    most, wall = (masks.greatest(m, labels, panes, len(deep)) for m in (union, solid))
    flush = deep & (wall > 0.55 * thick) & (most <= _WINDOW * wall + 2)
    paper = np.zeros(len(deep), np.bool_)
    paper[masks.border(labels)] = True
    paper[0] = False
    groups, found = masks.pieces(masks.closed(flush[labels], across))
    outer = masks.met(groups, len(found), masks.grown(paper[labels], round(across) + 2))[groups]
    return np.asarray(flush & masks.met(labels, len(deep), outer & flush[labels]))


def _around(image: Float32Array, radius: float) -> Float32Array:
    """The greatest value within a square around each pixel, to a quarter of its half side."""
    step = max(1, round(radius / 4))
    coarse = cv2.dilate(image, np.ones((2 * step + 1,) * 2, np.uint8))[::step, ::step]
    coarse = cv2.dilate(coarse, np.ones((9, 9), np.uint8))
    size = image.shape[::-1]
    return np.asarray(cv2.resize(coarse, size, interpolation=cv2.INTER_NEAREST), np.float32)


def _pen(bold: BoolArray, letter: float) -> float:
    """Width of the lines of letters and symbols, pixels; 0 if there are next to none."""
    labels, stats = masks.pieces(bold)
    _, _, wide, high, area = stats.T
    small = (area > 12) & (area < 0.4 * wide * high) & (np.maximum(wide, high) < letter)
    if np.count_nonzero(small) < 5:
        return 0.0
    depth = np.bincount(labels.ravel(), masks.depth(bold).ravel(), len(stats))[small] / area[small]
    return float(np.median(4 * depth - 2.2))


def _swings(drawn: BoolArray, walls: BoolArray, pixel: float) -> list[Door]:
    """The arcs among thin lines that hang on a wall, with a leaf at an end: doors, in pixels."""
    step, hangs = building.THINNEST / pixel, building.THICKEST[0] / 2 / pixel
    to_wall, to_ink = masks.depth(~walls), masks.depth(~drawn)
    thin = (drawn & ~masks.grown(walls, 2)).astype(np.uint8)
    found = list[Door]()
    for outline in cv2.findContours(thin, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)[0]:
        parts = np.array_split(outline[:, 0], max(1, round(len(outline) / step)))
        points = np.array([part.mean(axis=0) for part in parts])
        # Twice around: an arc may begin anywhere.
        for hinge, radius, ends in arcs(np.concatenate((points, points))):
            # Where it ends at a wall or at a leaf it may be cut off: it is a quarter of a circle.
            turns = (
                np.arctan2(*(ends[0] + ends[1] - 2 * hinge)[::-1]) + np.array((-1, 1)) * np.pi / 4
            )
            tips = hinge + radius * np.column_stack((np.cos(turns), np.sin(turns)))
            leaves = hinge + np.linspace(0.1, 0.9, 30)[:, None, None] * (tips - hinge)
            there = (_at(to_ink, leaves) < 3).mean(axis=0)
            end = int(there.argmax())
            fits = LEAVES[0] < radius * pixel < LEAVES[1] and there[end] > 0.8
            hung = _at(to_wall, hinge[None]).max() < hangs
            if fits and hung and all(np.hypot(*(d.hinge - hinge)) > radius / 2 for d in found):
                found.append(Door(hinge, tips[1 - end], tips[end], radius, bool(there.min() > 0.8)))
    return found


def _at(image: Float32Array, points: FloatArray) -> Float32Array:
    """Pixels of an image at points (..., 2), or those next to them within it."""
    out = map_coordinates(image, np.moveaxis(points, -1, 0)[::-1], order=0, mode="nearest")
    return np.asarray(out, np.float32)


def _without_leaves(
    solid: BoolArray, holes: BoolArray, swings: list[Door], thick: float, leaf: float
) -> BoolArray:
    """Walls without what is drawn across doors: leaves, open or closed, and thresholds."""
    if not swings:
        return solid
    across = np.zeros(solid.shape, np.uint8)
    middle = across.copy()
    for swing in swings:
        for end in (swing.closed, swing.opened):
            for image, ends in ((across, (0.06, 0.97)), (middle, (0.2, 0.8))):
                p, q = (np.rint(swing.hinge + s * (end - swing.hinge)).astype(int) for s in ends)
                cv2.line(image, p.tolist(), q.tolist(), 1, max(1, round(leaf)))
    thin = (across > 0) & ~masks.opened(solid, leaf)
    labels, stats = masks.pieces(holes, 4)
    small = stats[:, cv2.CC_STAT_AREA] < 1.5 * thick * max(swing.width for swing in swings)
    crossed = masks.met(labels, len(stats), holes & (middle > 0)) & small
    return solid & ~thin & ~crossed[labels]


def _building(
    walls: BoolArray, parts: int, pixel: float, gap: float | None
) -> tuple[BoolArray, BoolArray, float]:
    """Cells of the building that the walls enclose; frames around it; which openings are closed.

    A frame is a rectangle without an opening around walls that enclose much of it by themselves.
    """
    frame = np.zeros(tuple(side // parts for side in walls.shape), np.bool_)
    taken = masks.coarser(walls, parts) > 0
    cell = parts * pixel
    inside, closed = building.inside_of(taken, cell, gap)
    while (ring := _ring(taken & ~frame, cell)) is not None:
        line, within, least = ring
        rest = taken & ~frame & ~line & within
        own, gaps = building.inside_of(rest, cell, gap)
        if np.count_nonzero(own) < least * np.count_nonzero(within):
            break
        # The wall of a hall that rooms are joined to is no thinner than theirs.
        joined = np.any(masks.grown(line, 2) & rest)
        if joined and _width(walls, line, parts) > _MOST * _width(walls, rest, parts):
            break
        frame |= line
        inside, closed = own, gaps
    return inside, walls & masks.finer(frame, parts), closed


def _width(walls: BoolArray, where: BoolArray, parts: int) -> float:
    """Mean thickness, pixels, of the walls in some cells."""
    length = parts * int(np.count_nonzero(skeletonize(where)))
    return float(np.count_nonzero(walls & masks.finer(where, parts))) / max(1, length)


def _ring(taken: BoolArray, cell: float) -> tuple[BoolArray, BoolArray, float] | None:
    """The lines of an outer rectangle; what is within; and what share makes it a frame.

    That is the share of it, 0..1, that other walls enclose by themselves. None if the piece of wall
    around most others is no rectangle, or is a building: has openings, or walls all along.
    """
    labels, stats = masks.pieces(distance_image(taken) <= building.PIECE / 2 / cell)
    if len(stats) < 2:
        return None
    ring = taken & (labels == int(np.argmax(masks.spans(stats))))
    rows, columns = np.nonzero(ring)
    hull = cv2.convexHull(np.column_stack((columns, rows)).astype(np.int32))
    within = cv2.fillConvexPoly(np.zeros(ring.shape, np.uint8), hull, 1) > 0
    if np.count_nonzero(within) <= building.ENOUGH * np.prod(cv2.minAreaRect(hull)[1]):
        return None
    # A hall has doors, and may have a few small rooms.
    rooms = building.enclosed(ring, building.THICKEST[0] / 2 / cell)
    shut = np.count_nonzero(rooms) > 0.5 * np.count_nonzero(within)
    middle, depth = skeletonize(ring), masks.depth(within)
    along = np.count_nonzero(middle & (depth <= 2 * building.PIECE / cell))
    if len(stats) > 2 and 2 * along > np.count_nonzero(middle):
        return ring, within, _FRAMED[0 if shut else 1]
    # The building, or a title block near it, is joined to the frame. Paper is along the rest of it.
    loop = (depth > building.THICKEST[-1] / cell) & (depth <= building.THICKEST[-1] / cell + 2)
    free, found = masks.pieces(loop & ~ring)
    lengths = np.append(0, found[1:, cv2.CC_STAT_AREA])
    if not shut or 2 * lengths.max() < np.count_nonzero(loop):
        return None
    longest = free == int(np.argmax(lengths))
    to_paper, to_rest = distance_image(longest), distance_image(loop & ~longest)
    line = ring & (depth <= building.THICKEST[-1] / cell) & (to_paper < to_rest)
    # With what is joined to it, as a title block is; the building is larger.
    labels, stats = masks.pieces(ring & ~line)
    table = masks.met(labels, len(stats), (labels > 0) & (depth <= 3))
    table[int(np.argmax(masks.spans(stats)))] = False
    line |= table[labels]
    return line, within, _FRAMED[1]


def _framed(taken: BoolArray, cell: float, gap: float | None) -> int:
    """Cells that walls enclose by themselves within an outer rectangle, if there is one."""
    ring = _ring(taken, cell)
    if ring is None:
        return 0
    own, _ = building.inside_of(taken & ~ring[0] & ring[1], cell, gap)
    area = int(np.count_nonzero(own))
    return area if area > building.LEAST / cell**2 else 0


def _elsewhere(walls: BoolArray, inside: BoolArray, cell: float, gap: float) -> float:
    """Square metres that walls enclose which are not joined to the building."""
    taken = masks.coarser(walls, walls.shape[0] // inside.shape[0]) > 0
    labels, stats = masks.pieces(inside | taken)
    joined = masks.met(labels, len(stats), inside)
    other, _ = building.inside_of(taken & ~joined[labels], cell, gap)
    return float(np.count_nonzero(other)) * cell**2


def _kinds(
    drawn: BoolArray, walls: BoolArray, inside: BoolArray, hatching: BoolArray, frame: BoolArray,
    swings: list[Door], pixel: float,
) -> masks.Grey:  # fmt: skip
    """The kind that each pixel was taken for."""
    arcs = np.zeros(drawn.shape, np.uint8)
    for swing in swings:
        a, b = (np.arctan2(*(end - swing.hinge)[::-1]) for end in (swing.closed, swing.opened))
        turns = a + np.linspace(0, 1, 30) * ((b - a + np.pi) % (2 * np.pi) - np.pi)
        arc = swing.hinge + swing.width * np.column_stack((np.cos(turns), np.sin(turns)))
        outline = np.rint(np.concatenate(([swing.hinge], arc, [swing.hinge]))).astype(np.int32)
        cv2.polylines(arcs, [outline], False, 1, round(0.12 / pixel))
    rest = drawn & ~masks.grown(walls, 2) & (arcs == 0)
    labels, stats = masks.pieces(rest)
    count, area = len(stats), np.maximum(1, stats[:, cv2.CC_STAT_AREA])

    def share(mask: BoolArray) -> FloatArray:
        return np.bincount(labels[mask & rest], minlength=count) / area

    wide, high = stats[:, cv2.CC_STAT_WIDTH] * pixel, stats[:, cv2.CC_STAT_HEIGHT] * pixel
    small = np.maximum(wide, high) <= _LETTER
    small[0] = False
    words, found = masks.pieces(masks.closed(small[labels], 0.2 / pixel))
    word = masks.greatest(words, labels, small[labels], count)
    letters = np.bincount(word[small], minlength=len(found))
    span = np.hypot(wide, high)
    kind = np.full(count, Kind.SYMBOL, np.uint8)
    kind[(span > 0.8) & (area * pixel**2 < 0.06 * span)] = Kind.LINE
    kind[small & (letters[word] > 1)] = Kind.TEXT
    kind[share(masks.grown(hatching, 2)) > 0.4] = Kind.HATCH
    kind[share(masks.grown(inside, 2)) < 0.5] = Kind.OUTSIDE
    kind[share(frame) > 0.5] = Kind.FRAME
    kind[0] = 0
    out = kind[labels]
    out[drawn & ~masks.grown(walls, 2) & (arcs > 0)] = Kind.SWING
    out[walls] = Kind.WALL
    return out


def refuse_recorded(grey: masks.Grey) -> None:
    """Raise MapError for an image of one tone, and for a map that a robot made."""
    counts = np.bincount(grey.ravel(), minlength=256)
    unknown = np.mean(abs(masks.border(grey).astype(int) - 205) <= 2)
    known = counts[:10].sum() + counts[200:211].sum() + counts[245:].sum()
    if unknown > 0.5 and known > 0.98 * grey.size:
        raise MapError(
            "it has the greys of a map that a robot made (205 is unknown), expected a floor plan: "
            "use it as it is"
        )
    if np.count_nonzero(counts) < 2:
        raise MapError("it has one tone only, expected a floor plan with dark walls")


def refuse_photo(evened: masks.Grey) -> None:
    """Raise MapError for an image that is little paper, once that is even."""
    share = np.count_nonzero(evened > 255 * building.ENOUGH) / evened.size
    if share < _MOST:
        raise MapError(
            f"only {share:.0%} of it is light as paper, expected a drawing: a photo? Scan the "
            "plan, or export it from its CAD program"
        )
