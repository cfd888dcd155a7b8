"""What befalls scans and maps: one disturbance each, all of them seeded.

Scans are of one sensor, maps are images: people and a robot's own body hide neighbouring rays,
glass lets them through, a drawn map has thick or displaced walls. Rooms that are in no map are
drawn and seen from inside.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from types import MappingProxyType

import cv2
import numpy as np

from imgloc.features.distance import distance_image
from imgloc.features.raycast import cast_rays
from imgloc.model import BoolArray, FloatArray, LaserScan, OccupancyGrid
from imgloc.options import Known
from imgloc.simulation.scans import ray_angles

Rng = np.random.Generator
ScanChange = Callable[[LaserScan, Rng], LaserScan]
MapChange = Callable[[OccupancyGrid, Rng], OccupancyGrid]


def with_ranges(scan: LaserScan, ranges: FloatArray) -> LaserScan:
    """The scan with other ranges; readings that are no distance stay as they are."""
    return replace(scan, ranges=np.where(scan.valid, np.maximum(ranges, 1e-3), scan.ranges))


def people(scan: LaserScan, rng: Rng, count: int = 10, around: float = np.pi) -> LaserScan:
    """Discs of 0.5 m, their middles 0.8 to 4 m away: some 30 % of the rays, in clusters."""
    ranges = scan.ranges.astype(np.float64)
    for distance, at in rng.uniform((0.8, -around), (4.0, around), (count, 2)):
        across = distance * np.sin(scan.angles - at)
        ahead = distance * np.cos(scan.angles - at)
        hit = (np.abs(across) < 0.25) & (ahead > 0)
        near = ahead - np.sqrt(np.maximum(0.25**2 - across**2, 0))
        ranges = np.where(hit & (near < ranges), near, ranges)
    return with_ranges(scan, ranges)


def neighbours(scan: LaserScan, rng: Rng, share: float) -> BoolArray:
    """A run of rays: bool (N,)."""
    n = len(scan.ranges)
    first = int(rng.integers(n))
    return (np.arange(n) - first) % n < share * n


def body(scan: LaserScan, rng: Rng) -> LaserScan:
    """The robot's own body in a fifth of the rays."""
    seen = neighbours(scan, rng, 0.2)
    return with_ranges(scan, np.where(seen, rng.uniform(0.15, 0.35, len(seen)), scan.ranges))


def glass(scan: LaserScan, rng: Rng) -> LaserScan:
    """A third of the rays, side by side, at the end of the sensor's range."""
    far = 0.999 * min(scan.range_max, 1e3)
    return with_ranges(scan, np.where(neighbours(scan, rng, 0.3), far, scan.ranges))


def read_through(scan: LaserScan, rng: Rng, count: int, degrees: float) -> LaserScan:
    """Pieces of wall that are gone, or of glass: each shows another wall 0.5 to 4 m behind it."""
    ranges, view = scan.ranges.astype(np.float64), (scan.angles.min(), scan.angles.max())
    for _ in range(count):
        gone = np.abs(scan.angles - rng.uniform(*view)) < np.deg2rad(degrees / 2)
        ranges[gone] += rng.uniform(0.5, 4.0)
    return with_ranges(scan, ranges)


def cart(scan: LaserScan, rng: Rng) -> LaserScan:
    """The straight side of a cart 0.5 to 1.2 m away, on one half of the view."""
    middle, aside = np.median(scan.angles), rng.choice((-1.0, 1.0))
    toward = np.cos(scan.angles - middle - aside * np.pi / 2)
    far = np.where(toward > 0, rng.uniform(0.5, 1.2) / np.maximum(toward, 1e-3), np.inf)
    far += 0.02 * rng.standard_normal(len(far))
    return with_ranges(scan, np.minimum(scan.ranges, far))


def noise(scan: LaserScan, rng: Rng, sigma: float) -> LaserScan:
    """Gaussian noise of the ranges, metres."""
    return with_ranges(scan, scan.ranges + sigma * rng.standard_normal(len(scan.ranges)))


def short(scan: LaserScan, rng: Rng, share: float) -> LaserScan:
    """A share of the rays, each on its own, stopped anywhere before the wall."""
    hit, where = rng.random((2, len(scan.ranges)))
    return with_ranges(scan, np.where(hit < share, where, 1) * scan.ranges)


def few(scan: LaserScan, _: Rng, n: int) -> LaserScan:
    """At most `n` rays, evenly spread."""
    pick = np.linspace(0, len(scan.ranges) - 1, min(n, len(scan.ranges))).round().astype(int)
    return replace(scan, ranges=scan.ranges[pick], angles=scan.angles[pick])


def reach(scan: LaserScan, _: Rng, metres: float) -> LaserScan:
    """A sensor of a shorter reach."""
    return replace(scan, range_max=min(scan.range_max, metres))


def view(scan: LaserScan, _: Rng, degrees: float) -> LaserScan:
    """A narrower view, ahead."""
    keep = np.abs(scan.angles - np.median(scan.angles)) <= np.deg2rad(degrees / 2)
    return replace(scan, ranges=scan.ranges[keep], angles=scan.angles[keep])


def scaled_ranges(scan: LaserScan, _: Rng, factor: float) -> LaserScan:
    """A constant relative error of the ranges."""
    return with_ranges(scan, factor * scan.ranges)


def biased_ranges(scan: LaserScan, _: Rng, metres: float) -> LaserScan:
    """A constant error of the ranges."""
    return with_ranges(scan, scan.ranges + metres)


def mixed(scan: LaserScan, rng: Rng, jump: float = 0.3) -> LaserScan:
    """At the edge of a thing the beam meets it and what is behind: the reading is in between."""
    order = np.argsort(scan.angles, kind="stable")
    near = np.where(scan.valid, scan.ranges, np.nan)[order]  # beside no reading there is no edge
    beyond = np.roll(near, -1) - near
    edge = np.abs(beyond) > jump
    ranges = scan.ranges.astype(np.float64)
    ranges[order[edge]] += rng.random(np.count_nonzero(edge)) * beyond[edge]
    return with_ranges(scan, ranges)


def moving(scan: LaserScan, _: Rng, velocity: tuple[float, float, float]) -> LaserScan:
    """A sweep of 0.1 s by a robot that moves: m/s, m/s, rad/s. Its rays keep their directions."""
    times = np.linspace(0, 0.1, len(scan.ranges))
    ends = np.where(scan.valid, scan.ranges, 1.0) * np.exp(1j * scan.angles)
    forth = np.argsort(scan.angles, kind="stable")
    at, seen = times, ends
    for _round in range(4):  # a ray sees what is in its direction when its turn comes
        turn = velocity[2] * at
        way = complex(velocity[0], velocity[1]) * at * np.exp(0.5j * turn)
        seen = (ends - way) * np.exp(-1j * turn)
        where = scan.angles + np.angle(seen * np.exp(-1j * scan.angles))
        at = np.interp(where, scan.angles[forth], times[forth])
    order = np.argsort(where, kind="stable")
    near = np.clip(np.searchsorted(where[order], scan.angles), 1, len(order) - 1)
    near -= np.abs(where[order][near - 1] - scan.angles) < np.abs(where[order][near] - scan.angles)
    ranges = np.where(scan.valid, np.abs(seen), scan.ranges)[order][near]
    return replace(scan, ranges=ranges, time_increment=float(times[1] - times[0]))


def floor(
    scan: LaserScan, rng: Rng, *, distance: float, spread: float = 0.03, cone: bool = False
) -> LaserScan:
    """The floor seen by a laser that is tilted ahead, or all around if its plane is a cone."""
    ahead = np.median(scan.angles) + rng.uniform(-0.6, 0.6)
    across = np.ones(len(scan.angles)) if cone else np.cos(scan.angles - ahead)
    far = np.where(across > 0.05, distance / np.maximum(across, 0.05), np.inf)
    far += spread * rng.standard_normal(len(far))
    wall = np.where(np.isnan(scan.ranges), np.inf, scan.ranges)
    seen = (far < scan.range_max) & (far < wall)
    return replace(scan, ranges=np.where(seen, far, scan.ranges))


SCANS: Mapping[str, ScanChange] = MappingProxyType(
    {
        "undisturbed": lambda scan, _: scan,
        "people": people,
        "body": body,
        "glass": glass,
        "a wall gone": partial(read_through, count=1, degrees=24.0),
        "panes of glass": partial(read_through, count=6, degrees=10.0),
        "a cart": cart,
        "a crowd": partial(people, count=12, around=np.pi / 2),
        "noise of 5 cm": partial(noise, sigma=0.05),
        "noise of 10 cm": partial(noise, sigma=0.1),
        "noise of 30 cm": partial(noise, sigma=0.3),
        "40 % of the rays stopped short": partial(short, share=0.4),
        "18 beams": partial(few, n=18),
        "reach of 5 m": partial(reach, metres=5.0),
        "view of 90 deg": partial(view, degrees=90.0),
        "1 m/s and 120 deg/s": partial(moving, velocity=(1.0, 0.0, 2.1)),
        "floor on a line 5 m away": partial(floor, distance=5.0),
        "floor on a circle 5 m away": partial(floor, distance=5.0, cone=True),
        "ranges x 0.95": partial(scaled_ranges, factor=0.95),
        "ranges x 1.05": partial(scaled_ranges, factor=1.05),
        "ranges + 0.15 m": partial(biased_ranges, metres=0.15),
        "mixed pixels": mixed,
    }
)


def dilated(grid: OccupancyGrid, _: Rng, cells: int = 2) -> OccupancyGrid:
    """Walls thicker by some cells on all sides."""
    size = 2 * cells + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    occupied = cv2.dilate(grid.occupied.astype(np.uint8), kernel) > 0
    return replace(grid, occupied=occupied, free=grid.free & ~occupied)


def displaced(grid: OccupancyGrid, rng: Rng, metres: float, over: float = 8.0) -> OccupancyGrid:
    """Walls moved by a smooth field of up to so many metres."""
    height, width = grid.occupied.shape
    knots = tuple(max(3, round(n * grid.resolution / over)) for n in (width, height))
    field = rng.uniform(-1, 1, (2, knots[1], knots[0])).astype(np.float32)
    dx, dy = (cv2.resize(f, (width, height), interpolation=cv2.INTER_CUBIC) for f in field)
    length = float(np.sqrt(dx * dx + dy * dy).max())
    step = np.float32(metres / grid.resolution / length)
    x, y = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    to = (x + step * dx, y + step * dy)
    occupied, free = (
        np.asarray(cv2.remap(image.astype(np.uint8), *to, cv2.INTER_NEAREST) > 0)
        for image in (grid.occupied, grid.free)
    )
    return replace(grid, occupied=occupied, free=free)


def furnished(grid: OccupancyGrid, rng: Rng, each: float = 30.0) -> OccupancyGrid:
    """Half of what stands free is gone, and one box for `each` square metres has come."""
    parts, label, stats, _ = cv2.connectedComponentsWithStats(grid.occupied.astype(np.uint8))
    small = stats[:, cv2.CC_STAT_WIDTH : cv2.CC_STAT_HEIGHT + 1].max(axis=1) * grid.resolution < 1.5
    gone = (small & (rng.random(parts) < 0.5))[label] & grid.occupied
    occupied, free = (grid.occupied & ~gone).astype(np.uint8), grid.free | gone
    where = np.argwhere(grid.free)
    count = int(len(where) * grid.resolution**2 / each)
    for (row, column), sides, turn in zip(
        where[rng.integers(len(where), size=count)], rng.uniform(0.3, 1.2, (count, 2)),
        rng.uniform(0, 180, count), strict=True,
    ):  # fmt: skip
        box = (float(column), float(row)), (sides / grid.resolution).tolist(), turn
        corners = cv2.boxPoints(box)
        cv2.fillConvexPoly(occupied, np.rint(corners).astype(np.int32), 1)
    return replace(grid, occupied=occupied > 0, free=free & (occupied == 0))


def shut(grid: OccupancyGrid, rng: Rng, widest: float = 1.1, share: float = 0.5) -> OccupancyGrid:
    """A share of the gaps between walls, doorways among them, is closed by a thin door."""
    cells = max(2, round(widest / grid.resolution))
    occupied = grid.occupied.copy()
    for image, drawn in ((grid.occupied, occupied), (grid.occupied.T, occupied.T)):
        wall = image.astype(np.uint8)
        across = cv2.morphologyEx(wall, cv2.MORPH_CLOSE, np.ones((1, cells), np.uint8)) > 0
        # A doorway is short: beyond it, both ways, there is no wall on one side at least.
        parts, label, stats, _ = cv2.connectedComponentsWithStats(
            (across & ~image).astype(np.uint8)
        )
        deep = stats[:, cv2.CC_STAT_HEIGHT] * grid.resolution
        wide = stats[:, cv2.CC_STAT_WIDTH] * grid.resolution
        doors = (deep < 0.5) & (wide > 0.6) & (rng.random(parts) < share)
        doors[0] = False
        for k in np.flatnonzero(doors).tolist():
            middle = stats[k, cv2.CC_STAT_TOP] + stats[k, cv2.CC_STAT_HEIGHT] // 2
            drawn[middle] |= label[middle] == k
    return replace(grid, occupied=occupied, free=grid.free & ~occupied)


def averaged(grid: OccupancyGrid, _: Rng) -> OccupancyGrid:
    """A picture made half as large: cells twice as large, of what they have most of."""
    height, width = grid.occupied.shape
    size = (width // 2, height // 2)
    occupied, free = (
        cv2.resize(even.astype(np.float32), size, interpolation=cv2.INTER_AREA)
        for even in (part[: 2 * size[1], : 2 * size[0]] for part in (grid.occupied, grid.free))
    )
    walls = occupied >= 0.5
    return replace(
        grid, occupied=walls, free=(free >= 0.5) & ~walls, resolution=2 * grid.resolution
    )


def half(grid: OccupancyGrid, rng: Rng) -> OccupancyGrid:
    """One half of the map is unknown."""
    return half_of(grid, int(rng.integers(4)))


def half_of(grid: OccupancyGrid, side: int) -> OccupancyGrid:
    """What is left of a map above (0), below (1), to the right (2) or left (3) of its middle."""
    middle = int(np.median(np.argwhere(grid.occupied)[:, side // 2]))
    keep = np.zeros(grid.occupied.shape, bool)
    part = slice(None, middle) if side % 2 else slice(middle, None)
    keep[(part, slice(None)) if side < 2 else (slice(None), part)] = True
    return replace(grid, occupied=grid.occupied & keep, free=grid.free & keep)


MAPS: Mapping[str, MapChange] = MappingProxyType(
    {
        "undisturbed": lambda grid, _: grid,
        "walls dilated by 2 cells": dilated,
        "walls displaced by up to 0.15 m": partial(displaced, metres=0.15),
        "walls displaced by up to 0.3 m": partial(displaced, metres=0.3),
        "furniture moved": furnished,
        "doors shut on the map": shut,
        "map of half the size": averaged,
        "half the map": half,
    }
)

PRIORS: Mapping[str, Callable[[FloatArray], Known]] = MappingProxyType(
    {
        "clearance of 0.3 m known": lambda _: Known(clearance=0.3),
        "heading known to 30 deg": lambda at: Known(heading=(float(at[2]), np.pi / 6)),
        "place known to 3 m and 90 deg": lambda at: Known(
            near=(at[0], at[1], at[2], 3.0, np.pi / 2)
        ),
    }
)
"""What may be known of a pose (3,), map frame."""

_CELL, _REACH, _CLEAR = 0.01, 20.0, 0.3  # metres: of a room's image, of the sensor, of the robot
ROOMS = ("closed room", "room with a door", "dead end", "lift")


def unmapped(kind: str, rng: Rng, fov: float = 2 * np.pi) -> LaserScan:
    """A scan from within a simple place that is in no map: one of :data:`ROOMS`."""
    width, height = rng.uniform(*((1.2, 2.4) if kind == "lift" else (2.5, 9.0)), 2)
    beyond = 0.0  # metres that are free behind the upper side
    if kind == "dead end":
        width, height, beyond = rng.uniform((1.4, 8.0, 8.0), (3.0, 15.0, 8.0))
    elif kind == "room with a door":
        beyond = rng.uniform(1.4, 3.0)  # a corridor
    rows, columns, far = (round(metres / _CELL) for metres in (height, width, beyond))
    free = np.zeros((rows + far + 20, columns + 20), bool)
    free[10 : 10 + rows, 10 : 10 + columns] = True
    if kind == "dead end":
        free[10 + rows :, 10 : 10 + columns] = True
    elif kind == "room with a door":
        door = int(rng.integers(10, columns - 80))
        free[10 + rows : 20 + rows, door : door + 90] = True
        free[20 + rows : 20 + rows + far - 10, :] = True
    at = 0.1 + rng.uniform(_CLEAR, (width - _CLEAR, height - _CLEAR))
    angles = ray_angles(361, fov)
    psi = rng.uniform(-np.pi, np.pi) + angles
    ranges = cast_rays(distance_image(~free), at, psi, _REACH, _CELL).astype(np.float64)
    ranges += 0.02 * rng.standard_normal(len(angles))
    ranges[ranges > _REACH] = np.inf
    return LaserScan(np.maximum(ranges, 1e-3), angles, range_max=_REACH)
