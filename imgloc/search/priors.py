"""What is known before the scan: where the robot may be, and which way it may face.

A prior is a set of poses, all equally likely; the others have no probability at all. A twin of
the true pose that it excludes can therefore make an ambiguous scan unique.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from imgloc.errors import ConfigError
from imgloc.features.lattice import any_of_blocks
from imgloc.features.pyramid import Level
from imgloc.geometry import cell_of, inside, wrap
from imgloc.model import BoolArray, FloatArray, GridInfo, OccupancyGrid


@dataclass(frozen=True)
class Prior:
    """A set of poses.

    Parameters
    ----------
    cells : (H, W) bool array or None
        Cells of the map in which the sensor may be; None is all of them.
    heading : (float, float) or None
        Heading in the grid frame and how far it may be off, radians; None is all of them.
    about : mapping
        What it was made of, as plain values, for the record.

    Examples
    --------
    >>> prior = Prior(np.array([[True, False]]), (0.0, 0.5))
    >>> prior.admits(np.array([[0.5, 0.5, 6.0], [1.5, 0.5, 0], [0.5, 0.5, 1]]), 1.0).tolist()
    [True, False, False]
    """

    cells: BoolArray | None = None
    heading: tuple[float, float] | None = None
    about: Mapping[str, object] = field(default_factory=dict)

    def __and__(self, other: "Prior") -> "Prior":
        """The poses that both allow; of two headings the intersection must be one of them.

        Raises
        ------
        ConfigError
            If both state a heading.
        """
        if self.heading is not None and other.heading is not None:
            raise ConfigError("the heading is given twice: by a pose and on its own")
        given = [c for c in (self.cells, other.cells) if c is not None]
        cells = np.logical_and.reduce(given) if given else None
        heading = self.heading if self.heading is not None else other.heading
        return Prior(cells, heading, {**self.about, **other.about})

    def admits(self, poses: FloatArray, resolution: float) -> BoolArray:
        """Which poses (C, 3), grid frame, are in the set: (C,) bool."""
        ok = self.headings(poses[:, 2])
        if self.cells is not None:
            at = cell_of(poses[:, :2], resolution)
            height, width = self.cells.shape
            on_map = inside(at, GridInfo(height, width, resolution))
            row, col = at[on_map].T
            ok[on_map] &= self.cells[row, col]
            ok &= on_map
        return ok

    def headings(self, thetas: FloatArray, slack: float = 0.0) -> BoolArray:
        """Which headings are in the set, or less than `slack` beside it: bool, as `thetas`."""
        if self.heading is None:
            return np.ones(np.shape(thetas), bool)
        centre, tolerance = self.heading
        return np.asarray(np.abs(wrap(thetas - centre)) <= tolerance + slack + 1e-9)

    def lattice(self, free: BoolArray, factor: int) -> BoolArray:
        """`free` without the lattice cells that hold no cell of the set, (H', W') bool."""
        if self.cells is None:
            return free
        return np.asarray(free & any_of_blocks(self.cells, factor))

    def around(self, shape: tuple[int, int], cell: float, resolution: float) -> BoolArray | None:
        """Cells of another lattice, `cell` metres, that lie in the set or touch it."""
        if self.cells is None:
            return None
        at = (np.argwhere(self.cells) + 0.5) * (resolution / cell)
        row, col = np.minimum(at.astype(np.intp), np.subtract(shape, 1)).T
        out = np.zeros(shape, np.uint8)
        out[row, col] = 1
        return np.asarray(cv2.dilate(out, np.ones((3, 3), np.uint8)) > 0)

    def levels(self, levels: tuple[Level, ...], resolution: float) -> tuple[Level, ...]:
        """A pyramid whose free cells are those of the set."""
        if self.cells is None:
            return levels
        return tuple(
            replace(level, free=self.lattice(level.free, round(level.resolution / resolution)))
            for level in levels
        )


def near(info: GridInfo, x: float, y: float, radius: float) -> BoolArray:
    """Cells (H, W) whose centre is within `radius` of a point, grid frame, metres.

    Raises
    ------
    ConfigError
        If the radius is not positive and finite.

    Examples
    --------
    >>> near(GridInfo(1, 4, 1.0), 0.5, 0.5, 1.0).tolist()
    [[True, True, False, False]]
    """
    if not (np.isfinite(radius) and radius > 0):
        raise ConfigError(f"the radius must be positive and finite, got {radius:g} m")
    columns = (np.arange(info.width) + 0.5) * info.resolution - x
    rows = (np.arange(info.height) + 0.5) * info.resolution - y
    return np.asarray(np.add.outer(rows**2, columns**2) <= radius**2 + 1e-9)


def clearance(grid: OccupancyGrid, radius: float) -> BoolArray:
    """Cells (H, W) whose centre is at least `radius` from all that is not free, metres.

    Unknown cells and the world off the map are not free: a robot has not been there.

    Raises
    ------
    ConfigError
        If the radius is negative or not finite.

    Examples
    --------
    >>> free = np.ones((1, 7), bool)
    >>> clearance(OccupancyGrid(~free, free, 1.0), 0.5).tolist()
    [[True, True, True, True, True, True, True]]
    >>> clearance(OccupancyGrid(~free, free, 1.0), 1.0).any()
    np.False_
    """
    if not (np.isfinite(radius) and radius >= 0):
        raise ConfigError(f"the clearance must be finite and not negative, got {radius:g} m")
    padded = np.pad(grid.free, 1).astype(np.uint8)
    # From centre to centre; the blocked cell itself begins half a cell nearer.
    distance = cv2.distanceTransform(padded, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1]
    return np.asarray(grid.free & ((distance - 0.5) * grid.resolution >= radius - 1e-6))
