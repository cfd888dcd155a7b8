"""The signed distance to the walls as an image: zero on the surface, sub-cell everywhere.

A wall's surface is the border between an occupied cell and its neighbour, not the centre of
the occupied cell; measured from the centres every fit is off by half a cell.
"""

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from imgloc.model import BoolArray, Float32Array
from imgloc.numbers import number

#: Metres; what is farther from a wall than this, or off the map, counts as this far.
FARTHEST = 4.0
#: Metres; what is thicker than this is no wall.
SOLID = 1.0
#: Metres of a straight border that somebody drew, and the share of such borders on a map that is.
RUN, DRAWN = number("distance.drawn")
#: Steps in which a field keeps distances, metres, and slopes, metres per metre.
UNIT, SLOPE = FARTHEST / 32000, 1 / 16000

_BAND = 768  # rows that are computed at a time: a large map takes no more memory than its field
FARTHEST_CELLS = 512.0  # farther counts as this far; up to it OpenCV's errors round off


def distance_transform(image: npt.NDArray[np.uint8]) -> Float32Array:
    """Distance from the centre of every cell to the nearest centre of a cell that is 0.

    (H, W) float32 cells, at most `FARTHEST_CELLS`; that everywhere if no cell is 0. OpenCV's result
    differs in its last bits with threads, version and place in memory, which the refinement of a
    pose would show. The square of a distance is a whole number: rounded to that, it is exact.
    SciPy's is exact at once, and takes several times as long.

    Examples
    --------
    >>> distance_transform(np.array([[0, 1, 1], [1, 1, 1]], np.uint8)).tolist()[0]
    [0.0, 1.0, 2.0]
    """
    out = np.asarray(cv2.distanceTransform(image, cv2.DIST_L2, cv2.DIST_MASK_PRECISE))
    np.minimum(out, np.float32(FARTHEST_CELLS), out=out)
    np.multiply(out, out, out=out)
    np.rint(out, out=out)
    return np.asarray(np.sqrt(out, out=out), dtype=np.float32)


def distance_image(occupied: BoolArray) -> Float32Array:
    """Distance from the centre of every cell to the nearest centre of an occupied cell.

    (H, W) float32, in cells, exact as :func:`distance_transform`; `occupied` is (H, W) bool.

    Examples
    --------
    >>> distance_image(np.array([[True, False, False]])).tolist()
    [[0.0, 1.0, 2.0]]
    """
    return distance_transform(np.logical_not(occupied).astype(np.uint8))


def whole_steps(occupied: BoolArray) -> npt.NDArray[np.uint8]:
    """Whole cells that a ray may go: :func:`distance_image`, cut to bytes, at most 255.

    Rays are the same with it, in more steps; it takes a quarter of the memory.

    Examples
    --------
    >>> whole_steps(np.array([[True, False, False], [False] * 3])).tolist()
    [[0, 1, 2], [1, 1, 2]]
    """
    out, most = np.empty(occupied.shape, np.uint8), np.iinfo(np.uint8).max
    for top in range(0, len(out), _BAND):
        low = max(0, top - most)
        there = distance_image(occupied[low : top + _BAND + most])[top - low :][:_BAND]
        np.minimum(there, most, out=out[top : top + _BAND], casting="unsafe")
    return out


def wall_thickness(distance: Float32Array) -> float:
    """Median thickness of walls, metres: along their middle lines, so that each metre counts alike.

    Parameters
    ----------
    distance : (H, W) float32 array
        Metres to the nearest surface, negative in occupied cells: :func:`signed_distance`.

    Returns
    -------
    float
        What is thicker than a metre is no wall, but solid. A wall of an even number of cells counts
        as one cell less, because its middle is between two. 0 for a map without walls.

    Examples
    --------
    >>> walls = np.zeros((30, 40), bool)
    >>> walls[2], walls[4], walls[8:13], walls[16:] = True, True, True, True
    >>> [round(wall_thickness(signed_distance(some, 0.1)), 3) for some in (walls, walls[6:])]
    [0.1, 0.5]
    """
    middle = (distance < 0) & (distance <= cv2.erode(distance, np.ones((3, 3), np.uint8)))
    thickness = -2 * distance[middle]
    walls = thickness[thickness <= SOLID]
    return float(np.median(walls)) if len(walls) else 0.0


def straight_share(occupied: BoolArray, run: int) -> float:
    """Share of the borders of walls, (H, W) bool, in runs of so many cells along rows or columns.

    Scans leave no border straight for a metre; of a building that is drawn most are.

    Examples
    --------
    >>> walls = np.zeros((20, 60), bool)
    >>> walls[5:8, 10:50] = True
    >>> ragged = walls.copy()
    >>> ragged[4, 10:50:3] = ragged[8, 11:50:3] = True
    >>> [round(straight_share(some, 20), 2) for some in (walls, ragged)]
    [0.93, 0.0]
    """
    long, length = 0, 0
    for image in (occupied, occupied.T):  # cells of walls alone, which are few
        line, width = np.pad(image, 1).reshape(-1), image.shape[1] + 2
        cells = np.flatnonzero(line)
        for side in (-width, width):
            border = cells[~line[cells + side]]
            runs = np.diff(np.flatnonzero(np.diff(border, append=-1) != 1), prepend=-1)
            long, length = long + int(runs[runs >= run].sum()), length + len(border)
    return long / length if length else 0.0


def peeled(occupied: BoolArray) -> BoolArray:
    """Take a layer of cells off the walls of a map, (H, W) bool; lines of one cell stay.

    A step of Guo & Hall (1989), as :func:`skimage.morphology.thin` takes it, but at the cells of
    walls alone, which are few.

    Examples
    --------
    >>> peeled(np.ones((3, 5), bool)).astype(int).tolist()
    [[0, 0, 0, 0, 0], [0, 1, 1, 1, 0], [0, 0, 0, 0, 0]]
    """
    walls, width = np.pad(occupied, 1), occupied.shape[1] + 2
    line = walls.reshape(-1)
    cells = np.flatnonzero(line)
    around = (1, 1 - width, -width, -width - 1, -1, width - 1, width, width + 1)
    for turned in (around, around[4:] + around[:4]):
        on = [line.take(cells + step) for step in turned]
        pairs = [on[k] | on[k - 1] for k in range(8)]
        runs = np.sum([pairs[k] & ~on[k - 2] for k in range(0, 8, 2)], axis=0)
        few = np.minimum(np.sum(pairs[::2], axis=0), np.sum(pairs[1::2], axis=0))
        stays = (runs != 1) | (few < 2) | (few > 3) | (on[0] & (on[1] | on[2] | ~on[7]))
        line[cells[~stays]] = False
        cells = cells[stays]
    return walls[1:-1, 1:-1]


@dataclass(frozen=True, eq=False)
class DistanceField:
    """Signed distance and its gradient, one 8-byte row per cell, for lookups by the million."""

    #: (H * W + 1, 4) Distance at the cell's centre in units of :data:`UNIT`, its derivatives in x
    #: and y in units of :data:`SLOPE`, a spare column for alignment. The last row is "off the map".
    table: npt.NDArray[np.int16]
    height: int  #: rows and columns
    width: int
    resolution: float  #: side of a cell, metres
    recess: float = 0.0  #: metres by which the surfaces lie deeper in the walls than in the table

    def lookup(
        self, x: npt.ArrayLike, y: npt.ArrayLike
    ) -> tuple[Float32Array, Float32Array, Float32Array]:
        """Distance and gradient at points of the grid frame.

        Returns
        -------
        distance, gx, gy : (...) float32 arrays
            At `x` and `y` (...), metres: distance in metres, negative inside walls; gradient in
            metres per metre.
            The distance is the one at the centre of the point's cell plus the gradient times the
            offset from it: exact along straight walls. Off the map it is :data:`FARTHEST`, with no
            gradient.
        """
        u = np.asarray(x, dtype=np.float32) / np.float32(self.resolution)
        v = np.asarray(y, dtype=np.float32) / np.float32(self.resolution)
        column, row = np.floor(u), np.floor(v)
        last = np.int32(self.height * self.width)
        with np.errstate(invalid="ignore", over="ignore"):  # of what is off the map anyway
            c, r = column.astype(np.int32), row.astype(np.int32)
            # As unsigned numbers those below 0 are beyond the map, too.
            inside = (c.view(np.uint32) < self.width) & (r.view(np.uint32) < self.height)
            # np.where would take as long as all the rest.
            index = (r * np.int32(self.width) + c - last) * inside + last
        rows = self.table.take(index.astype(np.intp), axis=0)
        gx = rows[..., 1] * np.float32(SLOPE)
        gy = rows[..., 2] * np.float32(SLOPE)
        u -= column
        v -= row
        u -= np.float32(0.5)
        v -= np.float32(0.5)
        off = np.float32(self.resolution) * (gx * u + gy * v)
        off += rows[..., 0] * np.float32(UNIT)
        if self.recess:
            off += np.float32(self.recess)
        return off, gx, gy

    @property
    def steps(self) -> npt.NDArray[np.int16]:
        """Distance at the centres of all cells, (H, W), in units of :data:`UNIT`."""
        return self.table[:-1, 0].reshape(self.height, self.width)

    @property
    def distance(self) -> Float32Array:
        """Distance at the centres of all cells, (H, W) float32 metres."""
        return np.asarray(self.steps * np.float32(UNIT))


def signed_distance(
    occupied: BoolArray, resolution: float, walls: Float32Array | None = None
) -> Float32Array:
    """Distance from every cell centre to the surface of the nearest wall.

    Parameters
    ----------
    occupied, resolution : (H, W) bool array, float
        Row 0 is the lowest y, beyond the border nothing is occupied; side of a cell, metres.
    walls : (H, W) float32 array, optional
        The :func:`distance_image` of the map, cells, if it is there already.

    Returns
    -------
    (H, W) float32 array
        Metres, negative in occupied cells, at most :data:`FARTHEST`.

    Notes
    -----
    It is the distance between cell *centres*, to the nearest one of the other kind, less half
    a cell, and not that to the steps of a slanted wall, on purpose: the steps stick out, 0.2 to
    0.45 cells short of the wall itself; this one is 0.15 to 0.3 short. The zero is on it for both.

    Examples
    --------
    >>> signed_distance(np.array([[False, True, True, True]]), 1.0).tolist()
    [[0.5, -0.5, -0.5, -0.5]]
    """
    if not occupied.any():
        return np.full(occupied.shape, FARTHEST, dtype=np.float32)
    outside = distance_image(occupied) if walls is None else walls
    wall = np.pad(occupied, 1).astype(np.uint8)
    # Walls of one or two cells are one cell deep everywhere.
    thick = cv2.erode(wall, cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))).any()
    inside = distance_transform(wall) if thick else wall
    # One of the two is 0 everywhere; the border lies half a cell before the other's centre.
    cells = outside - inside[1:-1, 1:-1]
    cells -= np.copysign(np.float32(0.5), cells)
    np.multiply(cells, np.float64(resolution), out=cells, casting="same_kind")
    return np.asarray(np.clip(cells, -FARTHEST, FARTHEST, out=cells))


def distance_field(
    occupied: BoolArray, resolution: float, walls: Float32Array | None = None
) -> DistanceField:
    """Prepare the lookups of :class:`DistanceField` for a map.

    The parameters are those of :func:`signed_distance`.

    Examples
    --------
    A wall fills two columns; its surface is at x = 3 m:

    >>> field = distance_field(np.array([[False, False, False, True, True]] * 3), 1.0)
    >>> distance, gx, gy = field.lookup([2.25, 2.75], [1.5, 1.5])
    >>> distance.tolist(), gx.tolist()
    ([0.75, 0.25], [-1.0, -1.0])
    """
    height, width = occupied.shape
    table = np.zeros((height * width + 1, 4), dtype=np.int16)
    cells = table[:-1].reshape(height, width, 4)
    # Rows farther than this change neither a distance up to FARTHEST nor its slope.
    margin = int(np.ceil(FARTHEST / resolution)) + 2
    for top in range(0, height, _BAND):
        low, high = max(0, top - margin), min(height, top + _BAND + margin)
        here = slice(top - low, min(height, top + _BAND) - low)
        some = None if walls is None else walls[low:high]
        distance = signed_distance(occupied[low:high], resolution, some)
        rows = cells[top : top + _BAND]
        rows[..., 0] = np.rint(distance[here] / np.float32(UNIT))
        for column, order in ((1, (1, 0)), (2, (0, 1))):
            slope = cv2.Sobel(
                distance, cv2.CV_32F, *order, ksize=1,
                scale=0.5 / (resolution * SLOPE), borderType=cv2.BORDER_REPLICATE,
            )  # fmt: skip
            # Half of a one-sided difference: at an edge the cell is its own neighbour.
            slope[np.s_[:, [0, -1]] if column == 1 else np.s_[[0, -1], :]] *= 2
            rows[..., column] = np.rint(slope[here])
    table[-1, 0] = round(FARTHEST / UNIT)
    table.flags.writeable = False
    return DistanceField(table, height, width, resolution)
