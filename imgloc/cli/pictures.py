"""Pictures that the commands write."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from imgloc.draw import draw_hypotheses
from imgloc.draw.canvas import Picture
from imgloc.features.scanpoints import scan_xy
from imgloc.geometry import compose, in_map_frame, inverse
from imgloc.io.files import write_bytes_atomic
from imgloc.io.images import encode_png
from imgloc.model import Hypothesis, LaserScan, Localization, OccupancyGrid, Pose2D


def picture_name(path: Path, index: int, many: bool) -> Path:
    """Name of the picture of a scan.

    Examples
    --------
    >>> picture_name(Path("out.png"), 3, many=True).name
    'out-0003.png'
    """
    return path.with_name(f"{path.stem}-{index:04d}{path.suffix}") if many else path


def free_names(path: Path) -> Iterator[Path]:
    """Yield `path`, then its name with -1, -2 and so on, without end.

    Examples
    --------
    >>> names = free_names(Path("demo.png"))
    >>> [next(names).name for _ in range(3)]
    ['demo.png', 'demo-1.png', 'demo-2.png']
    """
    yield path
    k = 1
    while True:
        yield path.with_name(f"{path.stem}-{k}{path.suffix}")
        k += 1


def draw_answer(
    grid: OccupancyGrid, scan: LaserScan, answer: Localization, truth: Pose2D | None = None
) -> Picture:
    """Draw a scan at each hypothesis of an answer in the map frame; see draw_hypotheses."""
    return draw_hypotheses(
        grid,
        scan_xy(scan)[scan.valid],
        in_grid_frame(answer, grid),
        truth=None if truth is None else compose(inverse(grid.origin), truth),
    )


def in_grid_frame(answer: Localization, grid: OccupancyGrid) -> list[Hypothesis]:
    """Take the hypotheses of an answer from the map frame to the grid frame."""
    there = replace(grid.info, origin=inverse(grid.origin))
    return [in_map_frame(h, there) for h in answer.hypotheses]


def same_height(pictures: Sequence[Picture]) -> list[Picture]:
    """Extend pictures with white below, so that they stand side by side in line."""
    height = max(len(p) for p in pictures)
    return [
        np.pad(p, ((0, height - len(p)), (0, 0), (0, 0)), constant_values=255) for p in pictures
    ]


def write_hypotheses(
    path: Path,
    grid: OccupancyGrid,
    scan: LaserScan,
    answer: Localization,
    truth: Pose2D | None,
    *,
    force: bool,
) -> None:
    """Write the picture of :func:`draw_answer` as PNG.

    Raises
    ------
    OutputError
        If it exists (without `force`) or cannot be written.
    """
    write_picture(path, draw_answer(grid, scan, answer, truth), force=force)


def write_picture(path: Path, picture: Picture, *, force: bool) -> None:
    """Write a picture as PNG.

    Raises
    ------
    OutputError
        If it exists (without `force`) or cannot be written.
    """
    write_bytes_atomic(path, encode_png(picture), force=force)
