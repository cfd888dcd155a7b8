"""Where a map has aged: walls that rays pass, and endpoints where the map has no wall.

Each scan with a sure pose votes for some cells that they are free, and of some that a surface is
there. A cell is free where the fan of neighbouring rays, each shortened, covers it and all cells
around it: so a pose that is a little off does not pass through a wall beside it. What scans from
several places, or at several times, vote for a cell is compared with the map. People who walk by
hide walls and are seen in free space, but later rays pass where they were.

>>> wall = np.pad(np.zeros((40, 60), bool), 2, constant_values=True)
>>> old = wall.copy()
>>> old[10:34, 30:32] = True  # this wall is gone
>>> grid = OccupancyGrid(old, ~old, 0.1)
>>> poses = np.array([(x, y, 0.0) for x in (1.0, 2.0, 4.5) for y in (1.0, 2.2, 3.4)])
>>> from imgloc.features.raycast import cast_rays
>>> angles, walls = np.deg2rad(np.arange(-180.0, 180.0)), distance_image(wall)
>>> ranges = [cast_rays(walls, p[:2], p[2] + angles, 20.0, 0.1) for p in poses]
>>> found = map_changes(grid, [LaserScan(r, angles, range_max=20.0) for r in ranges], poses)
>>> found.new_m2, int(found.gone[12:32, 30:32].sum()), int(found.gone.sum()) <= 48
(0.0, 40, True)
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from imgloc.answers.causes import Cause, cause
from imgloc.answers.logcheck import MANY
from imgloc.equality import ByContent
from imgloc.errors import ConfigError, expect
from imgloc.features.distance import distance_image
from imgloc.features.scanpoints import evenly
from imgloc.features.surface import surface_points
from imgloc.geometry import cell_of, poses_of, transform_points, transform_poses, values_at
from imgloc.model import (
    BoolArray,
    FloatArray,
    IntArray,
    LaserScan,
    Localization,
    OccupancyGrid,
    inverse,
    plain,
)
from imgloc.numbers import number
from imgloc.options import EvidenceModel

_EDGE = min(EvidenceModel.sigmas)  # metres around a free cell that are free, too
_SHORT = 3 * _EDGE  # metres by which an endpoint may lie off its wall
_GAP = number("changes.gap")  # metres between neighbouring rays that say free between them
_SCANS, _PLACES = number("changes.scans"), number("changes.places")  # that must say so
_AGAINST = number("changes.against")  # scans that say so, to each that says otherwise
_PLACE, _TIME = number("changes.place")  # metres and seconds, within which scans are one look
# For a hint that the map has aged: scans, metres of wall surface, and share of it that is gone.
# The second share is that of a map of another place.
_HINT_SCANS, _HINT_WALLS, _HINT_GONE, _OTHER = number("changes.hint")

Counts = npt.NDArray[np.uint16]


@dataclass(frozen=True)
class Seen:
    """Counts for each cell of a map: of scans, and from how many places or times."""

    passed: Counts  #: (H, W) scans that see it free, with all cells around it
    passed_from: Counts  #: (H, W) places of these
    hit: Counts  #: (H, W) scans with an endpoint in it
    near_from: Counts  #: (H, W) places from which an endpoint is in it or around it
    near: Counts  #: (H, W) scans with an endpoint in it or in a cell around it
    grazed: Counts  #: (H, W) scans that see it free, whatever is beside it
    scans: int


@dataclass(frozen=True)
class Piece:
    """A connected part of a map that has changed."""

    kind: str  #: ``gone`` or ``new``
    x: float  #: its middle, map frame, metres
    y: float
    length: float  #: the longer side of its box along the grid, metres
    area: float  #: m2
    scans: int  #: the most that say so about one of its cells
    places: int  #: from how many places or times


@dataclass(frozen=True, eq=False)
class Changes(ByContent):
    """Where a map has aged."""

    grid: OccupancyGrid
    gone: BoolArray  #: (H, W) wall cells that are free now
    new: BoolArray  #: (H, W) free or unknown cells in which there is a surface now
    seen: Seen

    @cached_property
    def _wall(self) -> tuple[float, float]:
        """Metres of wall surface that scans have seen, and that are gone."""
        grid = self.grid
        surface = surface_points(grid.occupied, grid.free, grid.resolution)
        some = surface.select(np.isfinite(surface.alpha))
        out = np.column_stack((np.cos(some.alpha), np.sin(some.alpha)))
        at = some.xy - 0.5 * grid.resolution * out, grid.resolution
        looked = values_at(self.seen.passed + self.seen.near, *at) >= _SCANS
        gone = looked & values_at(self.gone, *at)
        return tuple(grid.resolution * np.count_nonzero(x) for x in (looked, gone))  # type: ignore[return-value]

    @property
    def seen_m(self) -> float:
        """Metres of wall surface that enough scans have looked at."""
        return self._wall[0]

    @property
    def gone_m(self) -> float:
        """Metres of wall surface that are gone."""
        return self._wall[1]

    @property
    def gone_share(self) -> float:
        """Share of the wall surface, of what was looked at, that is gone; NaN if none was."""
        return self.gone_m / self.seen_m if self.seen_m else math.nan

    @property
    def new_m2(self) -> float:
        """Area of the cells with a surface that the map has not."""
        return float(np.count_nonzero(self.new)) * self.grid.resolution**2

    @cached_property
    def pieces(self) -> tuple[Piece, ...]:
        """The connected parts that have changed, the longest first."""
        made = list[Piece]()
        for kind, mask, scans, places in (
            ("gone", self.gone, self.seen.passed, self.seen.passed_from),
            ("new", self.new, self.seen.near, self.seen.near_from),
        ):
            cell = self.grid.resolution
            count, labels, boxes, middles = _parts(mask)
            for k in range(1, count):
                left, top, width, height, cells = boxes[k].tolist()
                part = (slice(top, top + height), slice(left, left + width))
                here = labels[part] == k
                at = transform_points(self.grid.origin, (middles[k : k + 1] + 0.5) * cell)[0]
                size = cell * max(width, height), cell**2 * cells
                most = (int(counts[part][here].max()) for counts in (scans, places))
                made.append(Piece(kind, float(at[0]), float(at[1]), *size, *most))
        return tuple(sorted(made, key=lambda p: (-p.length, p.kind, p.x, p.y)))

    def text(self, name: str, given: int, most: int = 10) -> str:
        """The changes as text: of the map called `name`, by some of `given` scans."""
        lines = [f"{name}: no wall was looked at by enough scans with a sure pose"]
        if self.seen_m:
            lines = [
                f"{name}: {100 * self.gone_share:.1f} % of its walls are gone, "
                f"{self.new_m2:.1f} m2 new",
                f"  walls      {self.seen_m:.0f} m of surface seen, {self.gone_m:.1f} m of it gone",
            ]
        lines.append(f"  scans      {self.seen.scans} of {given} have a sure pose")
        lines += [
            f"  {piece.kind:<10} {piece.length:.1f} m at x {piece.x:.2f} m, y {piece.y:.2f} m: "
            f"{piece.scans} scans from {piece.places} places"
            for piece in self.pieces[:most]
        ]
        if (rest := len(self.pieces) - most) > 0:
            lines.append(f"             and {rest} smaller pieces")
        return "\n".join(lines)

    @property
    def mended(self) -> OccupancyGrid:
        """The map as it is now: walls that are gone are free, new surfaces are walls."""
        occupied = (self.grid.occupied & ~self.gone) | self.new
        free = (self.grid.free | self.gone) & ~occupied
        return replace(self.grid, occupied=occupied, free=free)

    def as_row(self) -> dict[str, Any]:
        """Plain values for JSON."""
        names = ("gone_share", "gone_m", "seen_m", "new_m2")
        row: dict[str, Any] = {name: getattr(self, name) for name in names}
        row |= {"scans": self.seen.scans, "pieces": [vars(piece) for piece in self.pieces]}
        return dict(plain(row))


def sure_poses(answers: Sequence[Localization]) -> tuple[list[int], FloatArray]:
    """Which scans have a pose that is sure, a `unique` one, and these poses (N, 3), map frame."""
    sure = [k for k, a in enumerate(answers) if a.verdict == "unique" and a.complete]
    return sure, poses_of([answers[k].hypotheses[0] for k in sure])


def aging_hint(grid: OccupancyGrid, scans: Sequence[LaserScan], poses: FloatArray) -> Cause | None:
    """Say that walls of a map are gone; None if they stand, or too few were in view.

    The scans are in metres of the map, the `poses` (N, 3) of their sensors in the map frame, both
    sure. At most 100 of them are looked at, evenly spread.
    """
    if len(scans) < _HINT_SCANS:
        return None
    some = evenly(len(scans), MANY)
    found = map_changes(grid, [scans[k] for k in some], poses[some])
    if found.seen_m < _HINT_WALLS or found.gone_share < _HINT_GONE:
        return None
    key = "map/other" if found.gone_share >= _OTHER else "old/walls"
    return cause(key, share=found.gone_share)


def map_changes(grid: OccupancyGrid, scans: Sequence[LaserScan], poses: FloatArray) -> Changes:
    """Find where a map has aged, by scans whose poses are sure.

    Parameters
    ----------
    grid : OccupancyGrid
        The map.
    scans : sequence of LaserScan
        Scans whose lengths fit the map; their stamps distinguish times.
    poses : (N, 3) float array
        Poses of the sensor, map frame: metres, metres, radians. :func:`sure_poses` gives those of
        answers.

    Returns
    -------
    Changes
        Walls that are gone, surfaces that are new, and how many scans from how many places saw
        them.

    Raises
    ------
    ValueError
        If there are not as many poses as scans.
    ConfigError
        If a pose is not finite.
    TypeError
        If `grid` is no OccupancyGrid.
    """
    expect(grid, OccupancyGrid, "grid")
    poses = np.asarray(poses, dtype=np.float64).reshape(-1, 3)
    if len(scans) != len(poses):
        raise ValueError(f"expected a pose for each of {len(scans)} scans, got {len(poses)}")
    if not np.isfinite(poses).all():
        k = int(np.flatnonzero(~np.isfinite(poses).all(axis=1))[0])
        raise ConfigError(f"poses[{k}]: got {poses[k].tolist()}, expected metres and radians")
    seen = look(grid, scans, transform_poses(inverse(grid.origin), poses))
    # A piece is sure where nothing beside it blocks rays; its ends lie beside what still stands.
    sure = grid.occupied & _mostly(seen.passed, seen.hit) & (seen.passed_from >= _PLACES)
    # Cells beside it are gone, too, as far as the margin around free cells reaches.
    beside = cv2.dilate(sure.view(np.uint8), np.ones((5, 5), np.uint8)) > 0
    more = beside & grid.occupied & _mostly(seen.grazed, seen.hit)
    gone = _large(sure | more, grid.resolution)
    away = distance_image(grid.occupied & ~gone) * grid.resolution > _SHORT
    # Noise puts the endpoints on a surface into the cells on both of its sides.
    there = _mostly(seen.near, seen.passed) & (seen.near_from >= _PLACES)
    new = _large(~grid.occupied & there & away & (seen.hit > 0), grid.resolution)
    return Changes(grid, gone, new, seen)


def _mostly(so: Counts, otherwise: Counts) -> BoolArray:
    """Cells with enough votes, and far more than votes against."""
    return np.asarray((so >= _SCANS) & (so >= _AGAINST * otherwise.astype(np.float64)))


def look(grid: OccupancyGrid, scans: Sequence[LaserScan], poses: FloatArray) -> Seen:
    """Count the votes of scans at poses (N, 3) of the grid frame for each cell."""
    shape, cell = grid.occupied.shape, grid.resolution
    counts = [np.zeros(shape, np.uint16) for _ in range(6)]
    passed, passed_from, hit, near_from, near, grazed = counts
    groups = _looks(scans, poses)
    for group in groups:
        any_passed, any_near = np.zeros(shape, np.bool_), np.zeros(shape, np.bool_)
        for k in group:
            window, bare, free, ends = _one(scans[k], poses[k], shape, cell)
            grazed[window] += bare
            passed[window] += free
            any_passed[window] |= free
            mark = np.zeros(shape, np.uint8)
            mark[ends[:, 0], ends[:, 1]] = 1
            hit += mark
            beside = cv2.dilate(mark, np.ones((3, 3), np.uint8)) > 0
            near += beside
            any_near |= beside
        passed_from += any_passed
        near_from += any_near
    return Seen(passed, passed_from, hit, near_from, near, grazed, len(scans))


def _looks(scans: Sequence[LaserScan], poses: FloatArray) -> list[list[int]]:
    """Indices of the scans of each look: taken in one square and in one span of time."""
    groups = dict[tuple[float, ...], list[int]]()
    for k, (scan, pose) in enumerate(zip(scans, poses, strict=True)):
        time = 0.0 if math.isnan(scan.stamp) else scan.stamp // _TIME
        groups.setdefault((*(pose[:2] // _PLACE).tolist(), time), []).append(k)
    return list(groups.values())


def _one(
    scan: LaserScan, pose: FloatArray, shape: tuple[int, ...], cell: float
) -> tuple[tuple[slice, slice], BoolArray, BoolArray, IntArray]:
    """The evidence of one scan: a window of the map, cells there that are free, cells of endpoints.

    The free cells come twice: all, and those that have only free cells around them.
    """
    order = np.argsort(scan.angles, kind="stable")
    valid = scan.valid[order]
    ranges, angles = scan.ranges[order], scan.angles[order] + pose[2]
    along = np.column_stack((np.cos(angles), np.sin(angles)))
    ends = cell_of(pose[:2] + ranges[valid, None] * along[valid], cell)
    on = ((ends >= 0) & (ends < shape)).all(axis=1)
    # Between two rays it is free up to the shorter one, if they are close together there.
    step = np.diff(angles)
    pair = valid[1:] & valid[:-1] & (step > 0)
    short = np.minimum(ranges[1:], ranges[:-1], where=pair, out=np.zeros(len(step)))
    short = np.minimum(short - _SHORT, _GAP / np.maximum(step, 1e-6))
    pair &= short > 0
    a, b = (pose[:2] + short[:, None] * side for side in (along[:-1], along[1:]))
    corners = np.stack((np.broadcast_to(pose[:2], a.shape), a, b), axis=1)[pair] / cell - 0.5
    edge = max(1, round(_EDGE / cell))
    none = np.zeros((0, 0), np.bool_)
    nowhere = (slice(0, 0), slice(0, 0)), none, none, ends[on]
    if not len(corners):
        return nowhere
    low = np.maximum(np.floor(corners.min(axis=(0, 1))).astype(int) - edge - 1, 0)
    high = np.minimum(np.ceil(corners.max(axis=(0, 1))).astype(int) + edge + 2, shape[::-1])
    if (high <= low).any():
        return nowhere
    image = np.zeros((high - low)[::-1], np.uint8)
    fixed = np.rint((corners - low) * 16).astype(np.int32)
    for triangle in fixed:
        cv2.fillConvexPoly(image, triangle, 1, cv2.LINE_8, 4)
    free = cv2.erode(image, np.ones((2 * edge + 1,) * 2, np.uint8), borderValue=0) > 0
    return (slice(low[1], high[1]), slice(low[0], high[0])), image > 0, free, ends[on]


def _parts(mask: BoolArray) -> tuple[int, Any, Any, Any]:
    """Connected parts of a mask, corners included: OpenCV's number, labels, boxes and middles."""
    return cv2.connectedComponentsWithStats(mask.view(np.uint8), connectivity=8)


def _large(mask: BoolArray, cell: float) -> BoolArray:
    """A mask without parts that are no longer than an endpoint may lie off its wall."""
    _, labels, boxes, _ = _parts(mask)
    keep = boxes[:, 2:4].max(axis=1) * cell >= _SHORT - 1e-9
    keep[0] = False
    return np.asarray(keep[labels])
