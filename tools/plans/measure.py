"""Scans of true buildings, located on their plans, on maps made of these, and on their walls."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np

from imgloc import FloorPlan, OccupancyGrid, Options, Pose2D, ScanSet, Sensor, load_map, plan_to_map
from imgloc.errors import MapError
from imgloc.geometry import pose_errors, poses_of, rotation, values_at
from imgloc.io.files import write_bytes_atomic
from imgloc.io.images import encode_png
from imgloc.pipeline import localize, prepare
from imgloc.plans.files import load_plan
from imgloc.simulation.scans import simulate
from tools.plans.drawing import Building, Image, building, draw_plan, inside, solid, true_world
from tools.plans.sheets import Sheet
from tools.script import table_lines

CELL = 0.05  #: metres: of the maps that plans are compared with
NEAR, TURNED = 0.5, float(np.deg2rad(10))  #: of a right answer, metres and radians


@dataclass(frozen=True)
class Drawn:
    """How plans are drawn."""

    style: str  #: of :data:`tools.plans.drawing.STYLES`
    resolution: float  #: metres a pixel
    noise: int | None = None  #: quality of a JPEG that they went through
    turn: float = 0.0  #: radians, of the building on the sheet

    def __str__(self) -> str:
        said = f"{self.style}, {self.resolution:g} m a pixel"
        said += "" if self.noise is None else f", JPEG of quality {self.noise}"
        return said + (f", turned by {np.rad2deg(self.turn):.0f} deg" if self.turn else "")


DRAWN = (
    Drawn("filled", 0.02), Drawn("outlined", 0.02, turn=0.3), Drawn("hatched", 0.02, 50),
    Drawn("grey", 0.05), Drawn("lines", 0.03), Drawn("filled", 0.01, 30),
)  # fmt: skip
MAPS = ("plan", "map plan", "removed is unknown", "walls")
"""What scans are located on: the plan as it is; the map made of it, free where things were removed;
the same, unknown there; the walls as they stand, without furniture."""


@dataclass
class Row:
    """What became of some scans."""

    drawn: str
    where: str  #: of :data:`MAPS`
    scans: int = 0
    right: int = 0  #: the first answer is
    among: int = 0  #: one of the answers is
    unique: int = 0
    wrong: int = 0  #: ``unique``, and not right
    nothing: int = 0  #: ``no-match``


def measure(
    seeds: Sequence[int], n: int, drawn: Sequence[Drawn], maps: Sequence[str],
    advance: Callable[[], None] = lambda: None, made: Callable[..., Building] = building,
) -> Iterator[Row]:  # fmt: skip
    """Locate `n` scans of each building of `seeds`, on each of `maps` of plans as `drawn`.

    Buildings are `made` of a seed and a turn.
    """
    for how in drawn:
        rows = {where: Row(str(how), where) for where in maps}
        for seed in seeds:
            b = made(seed, how.turn)
            scans = scans_of(b, n, seed)
            image = draw_plan(b, how.resolution, how.style, noise=how.noise)
            for where, row in rows.items():
                judge(map_of(b, image, how.resolution, where), scans, row, advance)
        yield from rows.values()


def measure_sheets(
    n: int, sheets: Mapping[str, Callable[[], Sheet]], advance: Callable[[], None] = lambda: None
) -> Iterator[tuple[object, ...]]:
    """Cells of the table of whole sheets, a row each; `n` scans of each building."""
    for name, make in sheets.items():
        sheet = make()
        b = sheet.building
        with TemporaryDirectory() as folder:
            path = Path(folder, "sheet.png")
            write_bytes_atomic(path, encode_png(sheet.image))
            grey = load_plan(path)
        scans = scans_of(b, n, 1, AROUND)
        rows = [Row(name, "walls"), Row(name, "map plan")]
        judge(map_of(b, sheet.image, sheet.resolution, "walls"), scans, rows[0], advance)
        try:
            found = plan_to_map(grey, sheet.resolution, origin=sheet.origin)
        except MapError as error:
            yield name, "", "", "", "", f"{rows[0].right}", f"refused: {error}"[:60]
            continue
        judge(found.grid, scans, rows[1], advance)
        free, walls = (f"{share:.0%}" for share in shares_found(found.grid, b))
        right = f"{rows[1].right} of {n}"
        yield name, free, walls, right, rows[1].wrong, rows[0].right, "yes" if found.doubt else ""


SHEETS_HEAD = (
    "sheet | became free | walls found | first right | unique and wrong | on the walls | warned of"
)


def shares_found(grid: OccupancyGrid, b: Building) -> tuple[float, float]:
    """Share of the room within a building that is free on a map; of its walls near occupied."""
    walls = solid(b, CELL)
    near = cv2.dilate(grid.occupied.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    shares = []
    for truth, found in ((inside(b, CELL) & ~walls, grid.free), (walls, near)):
        rows, columns = np.nonzero(truth)
        points = (np.column_stack((columns, rows)) + 0.5) * CELL - (grid.origin.x, grid.origin.y)
        local = points @ rotation(grid.origin.theta)
        shares.append(float(values_at(found, local, grid.resolution).sum() / len(rows)))
    return shares[0], shares[1]


AROUND = Sensor(rays=360, fov=2 * np.pi, range_max=25.0)  #: of whole sheets


def scans_of(b: Building, n: int, seed: int, sensor: Sensor | None = None) -> ScanSet:
    """Scans of 270 degrees and 12 m, with noise of 2 cm, where there is room for a robot."""
    sensor = sensor or Sensor(rays=271, fov=1.5 * np.pi, range_max=12.0)
    return simulate(true_world(b, CELL), n, seed, sensor, true_world(b))


def map_of(b: Building, image: Image, resolution: float, where: str) -> OccupancyGrid:
    """One of :data:`MAPS` of a building and its plan."""
    if where == "walls":
        walls = solid(b, CELL)
        return OccupancyGrid(walls, inside(b, CELL) & ~walls, CELL)
    if where == "plan":
        with TemporaryDirectory() as folder:
            path = Path(folder, "plan.png")
            write_bytes_atomic(path, encode_png(image))
            return load_map(path, resolution=resolution)
    found = plan_to_map(np.ascontiguousarray(image[::-1]), resolution)
    return found.grid if where == "map plan" else _unknown(found)


def _unknown(found: FloorPlan) -> OccupancyGrid:
    """The map with the cells unknown from which something was removed."""
    grid = found.grid
    parts = round(grid.resolution / found.pixel)
    height, width = (side // parts for side in found.kinds.shape)
    taken = (found.kinds > 1).reshape(height, parts, width, parts).any(axis=(1, 3))
    column, row = round(grid.origin.x / grid.resolution), round(grid.origin.y / grid.resolution)
    padded = np.pad(taken, 100)
    rows, columns = grid.info.shape
    here = padded[row + 100 : row + 100 + rows, column + 100 : column + 100 + columns]
    return replace(grid, free=grid.free & ~here)


def judge(
    grid: OccupancyGrid, scans: ScanSet, row: Row, advance: Callable[[], None] = lambda: None,
    options: Options | None = None,
) -> None:  # fmt: skip
    """Locate scans on a map, and count in its row what became of them."""
    features = prepare(grid)
    for scan, truth in scans.with_poses():
        answer = localize(features, scan, options)
        errors = pose_errors(poses_of(answer.hypotheses), Pose2D(*truth))
        fits = np.asarray((errors < (NEAR, TURNED)).all(axis=1))
        right = bool(fits[:1].any())
        row.scans += 1
        row.right += right
        row.among += bool(fits.any())
        row.unique += answer.verdict == "unique"
        row.wrong += answer.verdict == "unique" and not right
        row.nothing += answer.verdict == "no-match"
        advance()


def table(rows: Iterable[Row]) -> Iterator[str]:
    """The lines of a Markdown table, each as soon as its row is there."""
    cells = (
        (r.drawn, r.where, f"{r.right} of {r.scans}", r.unique, r.wrong, r.nothing) for r in rows
    )
    head = "plan | located on | first right | unique | unique and wrong | no-match"
    return table_lines(head, cells)
