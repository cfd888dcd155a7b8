"""Drawings of architects: scans of their furnished, slightly wrong twins, located on their maps."""

import resource
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np
from ezdxf.filemanagement import new

from imgloc import ImglocError, OccupancyGrid, simulate
from imgloc.geometry import rotation
from imgloc.model import Float32Array, IntArray
from imgloc.plans.drawn import drawing_to_maps
from imgloc.plans.vectors import read_drawing
from tools.plans.drawing import Building, leaves, solid
from tools.plans.measure import AROUND, Row, judge

DRAWINGS_HEAD = (
    "drawing | floor m | rooms | doors | scale | first right | among the answers | unique | "
    "unique and wrong | on a map by scans | seconds | MB | warned of"
)
_OFF, _SMOOTH = 0.03, 1.5  # metres that walls are off, and over how long a way that changes
_BOXES, _PEOPLE = 15.0, 40.0  # square metres a box, and a person
_ROOM = 3.0  # square metres that a robot is in


def measure_drawings(
    paths: Sequence[Path], n: int, advance: Callable[[], None] = lambda: None, seed: int = 1
) -> Iterator[tuple[object, ...]]:
    """Cells of the table of drawings, a row for each floor; `n` scans of each, by a seed.

    Time is that of the processor, and memory the peak of the process so far.
    """
    for path in paths:
        start = time.process_time()
        try:
            drawing = read_drawing(path)
            floors = drawing_to_maps(drawing)
        except ImglocError as error:
            yield path.name, "", "", "", "", "refused", *[""] * 6, str(error)[-150:]
            continue
        took = f"{time.process_time() - start:.1f}"
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
        shut, full = (
            drawing_to_maps(drawing, doors="closed"),
            drawing_to_maps(drawing, furniture=True),
        )
        for k, found in enumerate(floors):
            world = twin(found.grid, shut[k].grid, full[k].grid, seed=k + seed)
            scans = simulate(world, n, k + seed, AROUND, world)
            rows = [Row(path.name, "map plan"), Row(path.name, "by scans")]
            judge(found.grid, scans, rows[0], advance)
            judge(world, scans, rows[1], advance)
            size = f"{found.size[0]:.1f} x {found.size[1]:.1f}"
            yield (
                path.name, size, found.rooms, len(found.doors), "{:g}: {}".format(*found.scale),
                f"{rows[0].right} of {rows[0].scans}", rows[0].among, rows[0].unique, rows[0].wrong,
                rows[1].right, took, peak, found.doubt[:60],
            )  # fmt: skip


def twin(grid: OccupancyGrid, shut: OccupancyGrid, full: OccupancyGrid, seed: int) -> OccupancyGrid:
    """What stands where a drawing has walls: these off by centimetres, half of the doors closed.

    Half of the furniture that is drawn stands there, and boxes and people that are not drawn.
    """
    rng = np.random.default_rng(seed)
    occupied = grid.occupied.copy()
    for other, share in ((shut, 0.5), (full, 0.5)):
        count, labels = cv2.connectedComponents((other.occupied & ~grid.occupied).astype(np.uint8))
        occupied |= np.append(False, rng.random(count - 1) < share)[labels]
    cell, sides = grid.resolution / 2, np.array(grid.occupied.shape) * 2
    fine = np.repeat(np.repeat(occupied, 2, axis=0), 2, axis=1).astype(np.uint8)
    free = np.repeat(np.repeat(grid.free, 2, axis=0), 2, axis=1)
    rows, columns = (axis.astype(np.float32) for axis in np.indices(fine.shape))
    shift = [_field(rng, sides, cell) for _ in range(2)]
    moved = cv2.remap(fine, columns + shift[0], rows + shift[1], cv2.INTER_NEAREST)
    fine = np.asarray(moved, np.uint8)
    area = np.count_nonzero(grid.free) * grid.resolution**2
    where = np.argwhere(free)[:, ::-1].astype(np.float64)
    for _ in range(int(area / _BOXES)):
        half = rng.uniform(0.15, 0.45, 2) / cell
        corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * half
        box = corners @ rotation(rng.uniform(0, 7)).T + where[rng.integers(len(where))]
        cv2.fillPoly(fine, [np.rint(box).astype(np.int32)], 1)
    for _ in range(int(area / _PEOPLE)):
        x, y = where[rng.integers(len(where))].astype(int).tolist()
        cv2.circle(fine, (x, y), round(0.2 / cell), 1, -1)
    known = free | (fine > 0) | np.repeat(np.repeat(grid.occupied, 2, axis=0), 2, axis=1)
    # No robot stands within a table.
    _, labels, stats, _ = cv2.connectedComponentsWithStats((known & (fine == 0)).astype(np.uint8))
    room = stats[:, cv2.CC_STAT_AREA] * cell**2 > _ROOM
    room[0] = False
    return OccupancyGrid(fine > 0, room[labels], cell, grid.origin)


def write_dxf(b: Building, path: Path) -> None:
    """Write a building as an architect draws it, in millimetres: layers, arcs of doors, leaves."""
    document = new(units=4)  # mm
    model, cell = document.modelspace(), 0.01
    shapes, _ = cv2.findContours(
        solid(b, cell).astype(np.uint8), cv2.RETR_LIST, cv2.CHAIN_APPROX_SIMPLE
    )
    lines = [("walls", (shape[:, 0] + 0.5) * cell) for shape in shapes]
    lines += [("windows", b.placed(b.opened(o))) for o in b.openings if o.kind == "window"]
    lines += [("furniture", b.placed(corners)) for kind, corners in b.symbols if kind == "box"]
    for o in b.openings:
        for hinge, leaf, sign in leaves(b, o):
            at, free = b.placed(hinge), b.placed(hinge + leaf @ rotation(sign * np.pi / 2).T)
            lines.append(("doors", np.array([at, free])))
            turns = np.rad2deg(
                [np.arctan2(*(p - at)[::-1]) for p in (b.placed(hinge + leaf), free)]
            )
            first, last = turns if sign > 0 else turns[::-1]
            radius = float(np.hypot(*leaf)) * 1000
            model.add_arc(at * 1000, radius, first, last, dxfattribs={"layer": "doors"})
    for layer, points in lines:
        closed = layer != "doors"
        model.add_lwpolyline(points * 1000, close=closed, dxfattribs={"layer": layer})
    document.saveas(path)


def _field(rng: np.random.Generator, sides: IntArray, cell: float) -> Float32Array:
    """Displacements, cells, that change smoothly."""
    coarse = rng.normal(0, _OFF / cell, np.ceil(sides * cell / _SMOOTH).astype(int) + 2)
    size = (int(sides[1]), int(sides[0]))
    return np.asarray(cv2.resize(coarse.astype(np.float32), size, interpolation=cv2.INTER_LINEAR))
