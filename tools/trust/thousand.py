"""A thousand maps of few: pieces of maps, cut out, turned and mirrored; each another building.

Some places are set aside first: each is the middle of one piece, and other pieces that overlap that
one are mirrored, so that a scan taken there is from one of the maps alone.
"""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from imgloc import ConfigError, Sensor, load_map, prepare, save_map, simulate
from imgloc.choice.choose import NO_MAP, OPTIONS, Choice, bounds_of, choose, fit, search
from imgloc.choice.folder_index import open_index
from imgloc.io.folders import find_maps
from imgloc.model import BoolArray, FloatArray, LaserScan, OccupancyGrid

SIDES = (14.0, 30.0)
"""Metres: shortest and longest side of a piece."""
LEAST = 25.0
"""Square metres of free space that a piece has at least."""
_WALL = 0.01  # share of its cells that are occupied, at least
_TRIES = 200  # places that are tried for each piece


@dataclass(frozen=True)
class Piece:
    """A part of a map."""

    grid: OccupancyGrid
    source: int  #: of which map
    centre: tuple[float, float]  #: metres, in the grid frame of that map
    half: float  #: metres from there within which all of it was
    mirrored: bool


def pieces(grids: Sequence[OccupancyGrid], count: int, homes: int, seed: int) -> Iterator[Piece]:
    """Cut maps into `count` pieces; the first `homes` overlap no other that is not mirrored.

    ConfigError if the maps are too small for pieces.
    """
    rng = np.random.default_rng(seed)
    free = [np.argwhere(grid.free) for grid in grids]
    weight = np.array([np.sqrt(len(f)) * g.resolution for f, g in zip(free, grids, strict=True)])
    if not weight.any():
        raise ConfigError("the maps have no free cells to cut pieces around")
    kept: list[Piece] = []
    for k in range(count):
        for _ in range(_TRIES):
            # Large maps are cut more often, but not as often as they are larger.
            source = int(rng.choice(len(grids), p=weight / weight.sum()))
            grid = grids[source]
            row, column = free[source][rng.integers(len(free[source]))]
            centre = ((column + 0.5) * grid.resolution, (row + 0.5) * grid.resolution)
            size = rng.uniform(*SIDES, 2)
            half = float(np.hypot(*size) / 2)
            alone = all(far(home, source, centre, half) for home in kept)
            if k < homes and not alone:
                continue
            mirrored = not alone or (k >= homes and bool(rng.integers(2)))
            cut = turned(grid, centre, size, rng.uniform(0, 2 * np.pi), mirrored=mirrored)
            if usable(cut):
                break
        else:
            raise ConfigError(f"no {_TRIES} places of the maps make a piece of {LEAST:g} m2")
        piece = Piece(cut, source, centre, half, mirrored)
        if k < homes:
            kept.append(piece)
        yield piece


def far(home: Piece, source: int, centre: tuple[float, float], half: float) -> bool:
    """Whether a piece that is planned cannot overlap another."""
    apart = float(np.hypot(*np.subtract(home.centre, centre)))
    return source != home.source or apart > half + home.half


def usable(grid: OccupancyGrid) -> bool:
    """Whether there is something to be localized by, and in."""
    free = np.count_nonzero(grid.free) * grid.resolution**2
    return bool(free >= LEAST and grid.occupied.mean() >= _WALL)


def turned(
    grid: OccupancyGrid,
    centre: tuple[float, float],
    size: FloatArray,
    theta: float,
    *,
    mirrored: bool,
) -> OccupancyGrid:
    """A rectangle of a map as a map of its own, which lies `theta` to the old axes.

    `centre` and `size` (2,) are in metres. Each cell is what the cell under its centre was.
    """
    columns, rows = (max(1, round(side / grid.resolution)) for side in size)
    c, s = np.cos(theta), np.sin(theta)
    turn = np.array([[c, -s], [s, c]]) @ np.diag([-1.0 if mirrored else 1.0, 1.0])
    middle = np.array([(columns - 1) / 2, (rows - 1) / 2])
    offset = np.array(centre) / grid.resolution - 0.5 - turn @ middle
    matrix = np.column_stack((turn, offset))

    def warp(mask: BoolArray) -> BoolArray:
        flags = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
        return np.asarray(cv2.warpAffine(mask.astype(np.uint8), matrix, (columns, rows),
                                         flags=flags) > 0)  # fmt: skip

    return OccupancyGrid(warp(grid.occupied), warp(grid.free), grid.resolution)


@dataclass
class Thousand:
    """What asking a folder of many maps costs, and whether the answers are those of a full search.

    Seconds are of the processor, medians of the scans.
    """

    maps: int
    scans: int
    build: float  #: seconds that the index of all took
    one: float = 0.0  #: seconds to ask one map, as `which` does of a folder with no other
    query: float = 0.0  #: seconds to ask all
    searched: list[int] = field(default_factory=list)  #: maps that were searched to the end
    right: int = 0
    wrong: int = 0
    same: int | None = None  #: verdicts that are those of a search of all maps

    @property
    def times(self) -> float:
        """How many times that of one map a query takes."""
        return self.query / self.one


def make_thousand(
    sources: Sequence[Path], folder: Path, count: int, homes: int, seed: int
) -> tuple[LaserScan, ...]:
    """Write maps ``0000.yaml`` and so on to a folder; return a scan taken in each of the first."""
    scans = []
    for k, piece in enumerate(pieces([load_map(path) for path in sources], count, homes, seed)):
        save_map(folder / f"{k:04d}.yaml", piece.grid)
        if k < homes:
            scans.append(simulate(piece.grid, 1, k, Sensor(rays=361, range_max=20.0)).scans[0])
    return tuple(scans)


def ask_thousand(
    folder: Path, scans: Sequence[LaserScan], *, full: bool = False,
    advance: Callable[[], object] = lambda: None,
) -> Thousand:  # fmt: skip
    """Ask the maps of :func:`make_thousand`; with `full` each scan of each map, too."""
    files = {path.stem: path for path in find_maps(folder)}
    index, start = folder / "index.npz", time.process_time()
    open_index(files, lambda path: prepare(load_map(path)), about="", file=index)
    out = Thousand(len(files), len(scans), time.process_time() - start)
    single, all_of_them = [], []
    for k, scan in enumerate(scans):
        name = f"{k:04d}"
        lone = folder / f"{name}.npz"
        ask({name: files[name]}, scan, lone)  # which makes its index
        start = time.process_time()
        ask({name: files[name]}, scan, lone)
        lone.unlink()
        then = time.process_time()
        found = ask(files, scan, index)
        single.append(then - start)
        all_of_them.append(time.process_time() - then)
        out.searched.append(len(found.probability))
        out.right += found.verdict == name
        out.wrong += found.verdict not in (name, *NO_MAP)
        if full:
            every = choose({n: fit(prepare(load_map(p)), scan) for n, p in files.items()})
            out.same = (out.same or 0) + (every.verdict == found.verdict)
        advance()
    out.one, out.query = float(np.median(single)), float(np.median(all_of_them))
    return out


def ask(files: Mapping[str, Path], scan: LaserScan, index: Path) -> Choice:
    """What `imgloc which` answers on one thread, without its cache of prepared maps."""
    kept, _ = open_index(files, lambda path: prepare(load_map(path)), about="", file=index)
    (fits,) = search(
        [scan], kept.names, partial(bounds_of, kept, [1.0] * len(kept.names), options=OPTIONS),
        lambda name: nullcontext((prepare(load_map(files[name]), ready=False), OPTIONS)),
    )  # fmt: skip
    return choose(fits, ruled_out=len(kept.names) - len(fits))
