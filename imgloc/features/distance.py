"""The signed distance to the walls as an image: zero on the surface, sub-cell everywhere.

A wall's surface is the border between an occupied cell and its neighbour, not the centre of
the occupied cell; measured from the centres every fit is off by half a cell.
"""

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from imgloc.features.transform import distance_transform
from imgloc.model import BoolArray, Float32Array

#: Metres; what is farther from a wall than this, or off the map, counts as this far.
FAR = 4.0


@dataclass(frozen=True)
class DistanceField:
    """Signed distance and its gradient, one 16-byte row per cell, for lookups by the million.

    Parameters
    ----------
    table : (H * W + 1, 4) float32 array
        Distance at the centre of the cell [m], its derivatives in x and y [m/m], and a spare
        column that keeps a row aligned. The last row stands for "off the map".
    height, width : int
        Rows and columns.
    resolution : float
        Side of a cell, metres.
    """

    table: Float32Array
    height: int
    width: int
    resolution: float

    def index(self, x: Float32Array, y: Float32Array) -> npt.NDArray[np.int32]:
        """Rows of `table` for points given in cells; the last row for points off the map."""
        with np.errstate(invalid="ignore"):
            column, row = np.floor(x).astype(np.int32), np.floor(y).astype(np.int32)
        inside = (column >= 0) & (column < self.width) & (row >= 0) & (row < self.height)
        return np.where(inside, row * self.width + column, np.int32(self.height * self.width))

    def lookup(
        self, x: npt.ArrayLike, y: npt.ArrayLike
    ) -> tuple[Float32Array, Float32Array, Float32Array]:
        """Distance and gradient at points of the grid frame.

        Parameters
        ----------
        x, y : (...) arrays
            Metres.

        Returns
        -------
        distance, gx, gy : (...) float32 arrays
            Metres, negative inside walls, and metres per metre. The distance is the one at the
            centre of the point's cell plus the gradient times the offset from it: exact along
            straight walls. Off the map it is :data:`FAR`, with no gradient.
        """
        u = np.asarray(x, dtype=np.float32) / np.float32(self.resolution)
        v = np.asarray(y, dtype=np.float32) / np.float32(self.resolution)
        rows = self.table.take(self.index(u, v), axis=0)
        gx, gy = rows[..., 1], rows[..., 2]
        du, dv = u - np.floor(u) - np.float32(0.5), v - np.floor(v) - np.float32(0.5)
        off = np.float32(self.resolution) * (gx * du + gy * dv)
        return rows[..., 0] + off, gx, gy


def signed_distance(occupied: BoolArray, resolution: float) -> Float32Array:
    """Distance from every cell centre to the surface of the nearest wall.

    Parameters
    ----------
    occupied : (H, W) bool array
        Row 0 is the lowest y.
    resolution : float
        Side of a cell, metres.

    Returns
    -------
    (H, W) float32 array
        Metres, negative in occupied cells, at most :data:`FAR`. Beyond the border of the map
        nothing is occupied.

    Notes
    -----
    It is the distance between cell *centres*, to the nearest one of the other kind, less half
    a cell: along the axes that is the distance to the border between the two cells. It is not
    the distance to the steps into which a slanted wall has been cut, nor to a corner, off which
    it is diagonally 0.2 cells more. That is on purpose. Away from a slanted wall the distance
    to the steps is 0.2 to 0.45 cells short of that to the wall itself, as the steps stick out;
    this one is 0.15 to 0.3 short. The zero lies on the wall for both.

    Examples
    --------
    >>> signed_distance(np.array([[False, True, True, True]]), 1.0).tolist()
    [[0.5, -0.5, -0.5, -0.5]]
    """
    wall = np.pad(occupied, 1).astype(np.uint8)
    if not occupied.any():
        return np.full(occupied.shape, FAR, dtype=np.float32)
    outside, inside = distance_transform(1 - wall), distance_transform(wall)
    # One of the two is 0 everywhere; the border lies half a cell before the other's centre.
    cells = (outside - inside - np.where(wall > 0, -0.5, 0.5))[1:-1, 1:-1]
    return np.asarray(np.clip(cells * resolution, -FAR, FAR), dtype=np.float32)


def distance_field(occupied: BoolArray, resolution: float) -> DistanceField:
    """Prepare the lookups of :class:`DistanceField` for a map.

    Parameters
    ----------
    occupied : (H, W) bool array
    resolution : float
        Metres.

    Examples
    --------
    A wall fills two columns; its surface is at x = 3 m:

    >>> field = distance_field(np.array([[False, False, False, True, True]] * 3), 1.0)
    >>> distance, gx, gy = field.lookup([2.25, 2.75], [1.5, 1.5])
    >>> distance.tolist(), gx.tolist()
    ([0.75, 0.25], [-1.0, -1.0])
    """
    distance = signed_distance(occupied, resolution)
    height, width = distance.shape
    scale = 1.0 / (2.0 * resolution)
    table = np.zeros((height * width + 1, 4), dtype=np.float32)
    table[:-1, 0] = distance.ravel()
    for column, order, edge in ((1, (1, 0), np.s_[:, [0, -1]]), (2, (0, 1), np.s_[[0, -1], :])):
        slope = cv2.Sobel(
            distance, cv2.CV_32F, *order, ksize=1, scale=scale, borderType=cv2.BORDER_REPLICATE
        )
        slope[edge] *= 2  # half of a one-sided difference: there the cell is its own neighbour
        table[:-1, column] = slope.ravel()
    table[-1, 0] = FAR
    table.flags.writeable = False
    return DistanceField(table, height, width, resolution)
