"""Maps whose walls others drew, thick or bent, each with a log from the world itself."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from places import drive

from imgloc import OccupancyGrid, save_map, save_scans
from imgloc.model import BoolArray
from imgloc.simulation.worlds import WORLDS, render

ANGLES = np.deg2rad(np.arange(-180, 180, 3.0))
THICK = 2  # cells of 0.1 m that each side of a wall is drawn too thick
N = 24
GRID = render(WORLDS["visibility"](), 0.1)


def redrawn(grid: OccupancyGrid, occupied: BoolArray) -> OccupancyGrid:
    """The map with other walls."""
    return replace(grid, occupied=occupied, free=grid.free & ~occupied)


def bent(grid: OccupancyGrid, block: int) -> BoolArray:
    """The walls as somebody else draws them: each block of cells two cells off, any way."""
    occupied, rng = np.zeros_like(grid.occupied), np.random.default_rng(5)
    for row in range(0, len(occupied), block):
        for column in range(0, occupied.shape[1], block):
            there = np.argwhere(grid.occupied[row : row + block, column : column + block])
            y, x = (there + [row, column] + rng.choice([-2, 2], 2)).T
            inside = (y >= 0) & (x >= 0) & (y < len(occupied)) & (x < occupied.shape[1])
            occupied[y[inside], x[inside]] = True
    return occupied


def drawn(folder: Path, occupied: BoolArray, n: int = N) -> Path:
    """The folder, with a map that has these walls, and a log of `n` scans from the world itself."""
    save_map(folder / "map.yaml", redrawn(GRID, occupied))
    poses = np.array([[4.0 + 0.5 * k, 8.0, 0.02 * k] for k in np.arange(n) * N / n])
    save_scans(folder / "log.npz", drive(poses))
    return folder


def thick_in(folder: Path, n: int = N) -> Path:
    """The folder, with a map whose walls are too thick."""
    disc = np.ones((2 * THICK + 1,) * 2, np.uint8)
    return drawn(folder, cv2.dilate(GRID.occupied.astype(np.uint8), disc) > 0, n)
