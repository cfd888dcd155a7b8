"""Five small worlds drawn as polygons, and their rendering as occupancy grids.

Each shows one thing that the paper argues with: see the docstring of its function. Polygons
know no cells, so that a map of any resolution and the finer image on which scans are
simulated come from the same walls.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import cv2
import numpy as np
import numpy.typing as npt

from imgloc.errors import ConfigError
from imgloc.geometry import rotation, transform_points
from imgloc.model import FloatArray, OccupancyGrid, Pose2D

_UNKNOWN, _FREE, _OCCUPIED = 0, 1, 2
_SHIFT = 8  # fractional bits of the corner coordinates that cv2 draws


@dataclass(frozen=True)
class World:
    """A world made of polygons; the origin is its lower-left corner, y points up."""

    name: str  #: also the stem of its map file
    size: tuple[float, float]  #: width and height, metres
    rooms: tuple[FloatArray, ...]  #: (N, 2) free space; overlapping rooms open into each other
    blocks: tuple[FloatArray, ...] = ()  #: (N, 2) solid parts inside the rooms
    shell: float = 0.2  #: of the walls around, metres. What lies beyond is unknown.


def render(world: World, resolution: float) -> OccupancyGrid:
    """Draw a world as an occupancy grid with its origin at (0, 0, 0).

    Cells wider than 1 cm are averaged from cells of about 1 cm: one is known if at least half of
    it is, and occupied if no less of it is occupied than free. `resolution` is the side of a cell
    in metres; one that is not positive and finite is a ConfigError.

    Examples
    --------
    >>> render(WORLDS["curved"](), 0.1).occupied.shape
    (130, 160)
    """
    if not (np.isfinite(resolution) and resolution > 0):
        raise ConfigError(f"resolution must be positive and finite, got {resolution}")
    width, height = (max(1, round(side / resolution)) for side in world.size)
    parts = max(1, round(resolution / 0.01))
    image = np.full((height * parts, width * parts), _UNKNOWN, dtype=np.uint8)
    fine = resolution / parts
    rooms, blocks = ([_corners(p, fine) for p in group] for group in (world.rooms, world.blocks))
    thickness = max(1, round(2 * world.shell / fine))
    cv2.polylines(image, rooms, True, _OCCUPIED, thickness, cv2.LINE_8, _SHIFT)
    for room in rooms:  # one by one: fillPoly of all at once would leave their overlaps empty
        cv2.fillPoly(image, [room], _FREE, cv2.LINE_8, _SHIFT)
    for block in blocks:
        cv2.fillPoly(image, [block], _OCCUPIED, cv2.LINE_8, _SHIFT)
    shares = [(image == k).astype(np.float32) for k in (_OCCUPIED, _FREE)]
    if parts > 1:
        size = (width, height)
        shares = [cv2.resize(s, size, interpolation=cv2.INTER_AREA) for s in shares]
    occupied, free = shares
    known = occupied + free >= 0.5 - 1e-6
    return OccupancyGrid(known & (occupied >= free), known & (occupied < free), resolution)


def _corners(polygon: FloatArray, resolution: float) -> npt.NDArray[np.int32]:
    """Corners as cv2 takes them: pixel centres at integers, fixed point."""
    return np.rint((polygon / resolution - 0.5) * (1 << _SHIFT)).astype(np.int32)


def _box(x0: float, y0: float, x1: float, y1: float) -> FloatArray:
    """Rectangle from corner to corner."""
    return np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])


# Outline of a niche that is open toward +x, one of its sides to the left of the way along it.
NICHE: FloatArray = np.array(
    [(3.2, 1.9), (0.8, 2.3), (0.0, 0.7), (0.4, -1.5), (1.5, -2.3), (3.2, -2.0)]
)
"""(N, 2) metres: the inside of one niche of `double_wall` and the outside of the others."""
NICHES = ((5.0, 2.6, np.pi / 2), (17.2, 5.0, np.pi), (5.4, 13.6, -np.pi / 2), (13.6, 11.3, 0.0))
"""Where `double_wall` has its niches, (x, y, theta); the first is the one seen from inside."""


def _beside(path: FloatArray, distance: float) -> FloatArray:
    """Path (N, 2) moved to its left by `distance`, with mitred corners."""
    along = np.diff(path, axis=0)
    along /= np.hypot(*along.T)[:, None]
    left = np.column_stack((-along[:, 1], along[:, 0]))
    before, after = np.vstack((left[:1], left)), np.vstack((left, left[-1:]))
    shared = 1 + np.sum(before * after, axis=1, keepdims=True)
    return np.asarray(path + distance * (before + after) / shared)


def double_wall() -> World:
    """Figs. 1 and 4: four niches in a hall, told apart only by which side of a wall is seen.

    A scan taken inside the first one, whose walls stand outside the outline `NICHE`, fits the
    other three as well if the side of the wall is ignored: theirs stand inside of it.
    """
    blocks = []
    for k, (x, y, theta) in enumerate(NICHES):
        wall = np.vstack((NICHE, _beside(NICHE, -0.3 if k == 0 else 0.3)[::-1]))
        blocks.append(transform_points(Pose2D(x, y, theta), wall))
    return World("double_wall", (20.0, 16.0), (_box(0.4, 0.4, 19.6, 15.6),), tuple(blocks))


def visibility() -> World:
    """Fig. 2: two rooms, one turned by 180 degrees, alike but for a screen across the second.

    A scan that looks up through the first room fits the second one just as well, with the
    screen between the robot and the walls that it claims to see.
    """
    room = np.array([(0.4, 0.4), (9.9, 0.4), (9.9, 13.6), (3.4, 13.6), (0.4, 11.4)])
    inside = (_box(2.0, 9.0, 2.8, 10.2), _box(6.6, 11.2, 7.2, 13.6), _box(8.6, 9.4, 9.9, 10.2))
    rooms = (room, _turned(room), _box(9.5, 6.4, 10.5, 7.6))
    screen = _box(10.1, 5.6, 18.2, 5.8)
    blocks = (*inside, *(_turned(b) for b in inside), screen)
    return World("visibility", (20.0, 14.0), rooms, blocks)


def _turned(polygon: FloatArray) -> FloatArray:
    """Polygon of the visibility world turned by 180 degrees about its middle."""
    return np.asarray((20.0, 14.0) - polygon)


def large() -> World:
    """Fig. 5: 50 x 40 m with double walls at the centre and readings of 10 to 40 m."""
    hall = np.array(
        [
            (0.4, 0.4), (49.6, 0.4), (49.6, 24.0), (44.0, 29.0),
            (44.0, 39.6), (14.0, 39.6), (14.0, 34.0), (0.4, 34.0),
        ]
    )  # fmt: skip
    core = (  # two walls around a gap of 0.4 m, as between the sections of a building
        _box(17.0, 19.0, 23.0, 19.2), _box(17.0, 18.4, 23.0, 18.6),
        _box(25.0, 19.0, 33.0, 19.2), _box(25.0, 18.4, 33.0, 18.6),
        _box(24.2, 20.6, 24.4, 30.0), _box(24.8, 20.6, 25.0, 30.0),
        _box(24.2, 8.0, 24.4, 17.0), _box(24.8, 8.0, 25.0, 17.0),
    )  # fmt: skip
    rest = (
        _box(7.0, 8.0, 8.0, 9.0), _box(7.0, 26.0, 8.0, 27.0), _box(40.0, 8.0, 41.0, 9.0),
        _box(36.0, 27.0, 36.2, 39.6), _box(0.4, 16.0, 6.0, 16.2), _box(43.0, 14.0, 49.6, 14.2),
        transform_points(Pose2D(15.0, 7.0, 0.5), _box(-1.5, -0.6, 1.5, 0.6)),
        transform_points(Pose2D(34.0, 12.0, -0.7), _box(-2.0, -0.4, 2.0, 0.4)),
    )  # fmt: skip
    return World("large", (50.0, 40.0), (hall,), core + rest)


def curved() -> World:
    """Sec. VI, "curved env.": no straight wall and no corner anywhere."""
    s = np.linspace(0, 2 * np.pi, 240, endpoint=False)
    rx, ry = 6.6 + 0.8 * np.cos(3 * s + 2.0), 5.2 + 0.7 * np.sin(4 * s + 0.6)
    outline = np.column_stack((8.04 + rx * np.cos(s), 6.43 + ry * np.sin(s)))
    ellipse = np.column_stack((1.4 * np.cos(s), 0.6 * np.sin(s))) @ rotation(0.9).T + (11.0, 4.6)
    disc = np.column_stack((np.cos(s), np.sin(s))) * 0.6 + (4.2, 4.8)
    arc = np.linspace(0.0, 2.2, 60)
    ring = np.column_stack((np.cos(arc), np.sin(arc)))
    wall = np.concatenate((2.3 * ring, 2.1 * ring[::-1])) @ rotation(0.9).T + (7.2, 6.6)
    return World("curved", (16.0, 13.0), (outline,), (ellipse, disc, wall))


def corridor() -> World:
    """Corridor of 39 m whose door niches repeat every 4 m: what it looks like repeats too."""
    rooms = [_box(0.4, 3.8, 39.6, 6.2)]
    rooms += [_box(x, 6.0, x + 1.0, 6.5) for x in np.arange(3.0, 28.0, 4.0)]
    rooms += [_box(x, 3.5, x + 1.0, 4.0) for x in np.arange(5.0, 36.0, 4.0)]
    rooms += [_box(31.0, 6.7, 37.0, 9.6), _box(31.0, 6.2, 32.0, 6.8)]
    rooms += [_box(1.4, 0.4, 4.4, 3.3), _box(3.0, 3.2, 4.0, 4.0)]
    return World("corridor", (40.0, 10.0), tuple(rooms))


WORLDS: Mapping[str, Callable[[], World]] = MappingProxyType(
    {f.__name__: f for f in (double_wall, visibility, large, curved, corridor)}
)
"""The bundled worlds by name, in the order in which they are drawn."""
