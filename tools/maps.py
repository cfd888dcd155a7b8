"""How well `imgloc map align` and `imgloc map changes` do where the truth is known.

    python -m tools.maps align fr079/map.yaml wean/map.yaml ...    # maps of different places
    python -m tools.maps changes --scans 120

``align`` turns each map by a random angle, coarsens it and gives it another origin; cuts two parts
of 65 % that share 30 %; and thickens its walls. The pose that is found is compared with the true
one at the middle of the map. Each pair of different maps, up to ``--pairs``, must not match.

``changes`` moves 15 boxes in bundled worlds and opens 10 recesses in their walls. It simulates
scans in the world as it is, locates them on the map as it was, and compares the cells found with
the cells that are different. A cell counts if rays of 3 scans with a sure pose pass it, or end in
it. The unchanged world is asked, too.
"""

import itertools
import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from imgloc import (
    LaserScan,
    OccupancyGrid,
    Options,
    Pose2D,
    align_maps,
    load_map,
    localize,
    map_changes,
    prepare,
    sure_poses,
)
from imgloc.geometry import cell_of, inside, rotation, values_at
from imgloc.model import BoolArray, FloatArray, compose, inverse
from imgloc.numbers import number
from imgloc.simulation.scans import ray_angles, sample_free_poses, simulate_ranges
from imgloc.simulation.worlds import WORLDS, render
from tools.script import ended, parser_of, show, table_lines
from tools.trust.disturb import dilated

FINE, CELL = 0.02, 0.1  # metres: cells of a world, and of its map
WORLD_NAMES = ("visibility", "curved", "large", "corridor")
OFF = (0.05, math.radians(0.5))  # metres and radians: a pose that is nearer is right


def turned(
    grid: OccupancyGrid, theta: float, cell: float, origin: Pose2D
) -> tuple[OccupancyGrid, Pose2D]:
    """The same walls in an image turned by theta, and the pose of its frame in that of the grid."""
    R, (height, width) = rotation(theta), grid.occupied.shape
    sides = np.array([(0, 0), (width, 0), (0, height), (width, height)]) * grid.resolution
    low = (sides @ R.T).min(axis=0)
    columns, rows = np.ceil(np.ptp(sides @ R.T, axis=0) / cell).astype(int)
    column, row = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5)
    at = (np.column_stack((column.ravel(), row.ravel())) * cell + low) @ R
    occupied, free = (
        values_at(image, at, grid.resolution).reshape(rows, columns)
        for image in (grid.occupied, grid.free)
    )
    x, y = (low @ R).tolist()
    corner = Pose2D(x, y, -theta)  # of the new image in the old
    made = OccupancyGrid(occupied, free, cell, origin)
    return made, compose(compose(grid.origin, corner), inverse(origin))


def part(grid: OccupancyGrid, begin: float, end: float) -> OccupancyGrid:
    """A share of a map along its longer side; the rest is unknown."""
    axis = int(np.argmax(grid.occupied.shape))
    (known,) = np.nonzero((grid.occupied | grid.free).any(axis=1 - axis))
    low, high = known[0], known[-1] + 1
    at = np.arange(grid.occupied.shape[axis])
    kept = (at >= low + begin * (high - low)) & (at < low + end * (high - low))
    kept = kept[:, None] if axis == 0 else kept
    return OccupancyGrid(grid.occupied & kept, grid.free & kept, grid.resolution, grid.origin)


def disturbed(
    grid: OccupancyGrid, rng: np.random.Generator
) -> Iterator[tuple[str, OccupancyGrid, OccupancyGrid, Pose2D]]:
    """Pairs of one map, and the pose of the second in the first."""
    origin, cell = Pose2D(3.0, -7.0, 0.5), grid.resolution
    coarse = cell * float(rng.choice((1, 1.3, 1.7)))
    yield "turned", grid, *turned(grid, rng.uniform(-np.pi, np.pi), coarse, origin)
    first, second = part(grid, 0, 0.65), part(grid, 0.35, 1)
    yield "parts", first, *turned(second, rng.uniform(-np.pi, np.pi), 1.3 * cell, origin)
    thick = dilated(grid, rng, max(1, round(0.1 / cell)))
    yield "thick", grid, *turned(thick, rng.uniform(-np.pi, np.pi), cell, origin)


def align(paths: Sequence[Path], pairs: int, seed: int) -> Iterator[str]:
    """Measure :func:`imgloc.align_maps`; yield the lines of two tables."""
    grids = {str(path): load_map(path, free_thresh=0.196) for path in paths}
    rng, rows = np.random.default_rng(seed), []
    for name, grid in grids.items():
        for kind, a, b, truth in disturbed(grid, rng):
            found = align_maps(a, b)
            row, column = np.argwhere(b.free).mean(axis=0)
            middle = compose(b.origin, Pose2D(column * b.resolution, row * b.resolution))
            there, best = compose(truth, middle), compose(found.places[0].pose, middle)
            off = compose(inverse(there), best)
            right = math.hypot(off.x, off.y) <= OFF[0] and abs(off.theta) <= OFF[1]
            rows.append(
                (name, kind, found.verdict, "yes" if right else "no",
                 f"{math.hypot(off.x, off.y):.3f}", f"{math.degrees(abs(off.theta)):.2f}",
                 f"{found.places[0].agreement.share:.2f}")
            )  # fmt: skip
    yield from table_lines("map | pair | verdict | right | off, m | off, deg | agreement", rows)
    names = list(itertools.combinations(grids, 2))
    rng.shuffle(names)
    others = []
    for one, other in sorted(map(tuple, names[:pairs])):
        found = align_maps(grids[one], grids[other])
        fit = found.places[0].agreement
        numbers = f"{fit.share:.2f}", f"{fit.overlap:.2f}", f"{fit.hit:.0f}"
        others.append((one, other, found.verdict, *numbers))
    yield ""
    yield from table_lines("map | other map | verdict | agreement | overlap | m", others)


def boxes(
    blocked: BoolArray, count: int, sizes: tuple[float, float], rng: np.random.Generator
) -> BoolArray:
    """Boxes with sides between two lengths, at random angles, where nothing is within 0.25 m."""
    made, room = np.zeros(blocked.shape, np.uint8), blocked.copy()
    kernel = np.ones((round(0.5 / FINE),) * 2, np.uint8)
    for _ in range(5000):
        if not count:
            break
        row, column = (float(rng.integers(n)) for n in blocked.shape)
        sides = rng.uniform(sizes[0], sizes[1], 2) / FINE
        box = cv2.boxPoints(((column, row), tuple(sides.tolist()), rng.uniform(0, 180)))
        one = np.zeros(blocked.shape, np.uint8)
        cv2.fillConvexPoly(one, np.rint(box).astype(np.int32), 1)
        if not room[cv2.dilate(one, kernel) > 0].any():
            made |= one
            room |= one > 0
            count -= 1
    return made > 0


def recesses(
    occupied: BoolArray, free: BoolArray, count: int, rng: np.random.Generator
) -> tuple[BoolArray, BoolArray]:
    """Openings 0.8 to 1.6 m wide in walls with nothing known behind, and the walls around them."""
    carved, shell = np.zeros(free.shape, np.bool_), np.zeros(free.shape, np.bool_)
    away = cv2.distanceTransform((~free).astype(np.uint8), cv2.DIST_L2, 5)
    slope = [cv2.Sobel(away, cv2.CV_32F, *order, ksize=7) for order in ((1, 0), (0, 1))]
    faces = np.argwhere((cv2.dilate(free.view(np.uint8), np.ones((3, 3), np.uint8)) > 0) & occupied)

    def box(at: FloatArray, out: FloatArray, half: float, near: float, far: float) -> BoolArray:
        side = np.array((-out[1], out[0]))
        corners = ((-half, near), (half, near), (half, far), (-half, far))
        ends = np.array([at + (s * side + d * out) / FINE for s, d in corners])
        image = np.zeros(free.shape, np.uint8)
        if (ends >= 0).all() and (ends < free.shape[::-1]).all():
            cv2.fillConvexPoly(image, np.rint(ends).astype(np.int32), 1)
        return image > 0

    for _ in range(4000):
        if not count:
            break
        row, column = faces[rng.integers(len(faces))]
        out = np.array([s[row, column] for s in slope], dtype=np.float64)
        if (length := np.hypot(*out)) < 1e-3:
            continue
        at, out, half = (
            np.array((column, row), dtype=np.float64),
            out / length,
            rng.uniform(0.4, 0.8),
        )
        opening = box(at, out, half, 0, 1.2)
        behind, around = box(at, out, half + 0.3, 0.15, 1.6), box(at, out, half + 0.4, -0.3, 1.7)
        clear = around.any() and not (free & behind).any() and not ((carved | shell) & around).any()
        if clear and np.count_nonzero(opening & free) < 0.1 * np.count_nonzero(opening):
            carved |= opening
            shell |= box(at, out, half + 0.15, 0.1, 1.35) & ~opening
            count -= 1
    return carved, shell


def aged(name: str, seed: int, *, changed: bool) -> tuple[OccupancyGrid, OccupancyGrid]:
    """A world as it was and as it is, at 2 cm."""
    rng, world = np.random.default_rng(seed), render(WORLDS[name](), FINE)
    occupied, free = (np.pad(image, round(2 / FINE)) for image in (world.occupied, world.free))
    count = (15, 10) if changed else (0, 0)
    before = boxes(~free, count[0], (0.3, 0.7), rng)
    after = boxes(~free | before, count[0], (0.3, 0.7), rng)
    carved, shell = recesses(occupied, free, count[1], rng)
    now = (occupied | after | (shell & ~free)) & ~carved
    return (
        OccupancyGrid(occupied | before, free & ~before, FINE),
        OccupancyGrid(now, (free | carved) & ~now, FINE),
    )


def coarse(grid: OccupancyGrid) -> OccupancyGrid:
    """The map of a world: a cell is what most of it is."""
    k = round(CELL / grid.resolution)
    height, width = (n // k for n in grid.occupied.shape)
    shares = [
        image[: height * k, : width * k].reshape(height, k, width, k).mean(axis=(1, 3))
        for image in (grid.occupied, grid.free)
    ]
    known = shares[0] + shares[1] >= 0.5
    occupied = known & (shares[0] >= shares[1])
    return OccupancyGrid(occupied, known & ~occupied, CELL)


def rays(poses: FloatArray, ranges: FloatArray, angles: FloatArray, grid: OccupancyGrid) -> Any:
    """How many scans pass each cell, and how many end in it: by their rays, without noise."""
    counts = np.zeros((2, *grid.occupied.shape), np.int64)
    for pose, lengths in zip(poses, ranges, strict=True):
        for k, far in enumerate((False, True)):
            some = np.isfinite(lengths)
            at = [lengths[some] + 0.01] if far else np.arange(0, lengths[some].max(initial=0), 0.03)
            mark = np.zeros(grid.occupied.shape, np.bool_)
            for reach in at:
                here = some if far else some & (lengths > reach)
                length = lengths[here] + 0.01 if far else reach
                turn = angles[here] + pose[2]
                xy = pose[:2] + np.column_stack((np.cos(turn), np.sin(turn))) * np.reshape(
                    length, (-1, 1)
                )
                cells = cell_of(xy, CELL)
                cells = cells[inside(cells, grid.info)]
                mark[cells[:, 0], cells[:, 1]] = True
            counts[k] += mark
    return counts


def aging(name: str, scans: int, seed: int, *, changed: bool) -> tuple[Any, ...]:
    """One row of the table of ``changes``."""
    worlds = aged(name, seed, changed=changed)
    was, is_ = map(coarse, worlds)
    both = OccupancyGrid(was.occupied | is_.occupied, was.free & is_.free, CELL)
    poses, angles = sample_free_poses(both, scans, seed, 0.3, Pose2D(0, 0)), ray_angles(181, np.pi)
    ranges, exact = (
        simulate_ranges(worlds[1], poses, angles, sigma=sigma, range_max=30.0, seed=seed)
        for sigma in (0.02, 0.0)
    )
    recorded = [LaserScan(r, angles, range_max=30.0) for r in ranges]
    features = prepare(was)
    sure, found_at = sure_poses([localize(features, scan, Options()) for scan in recorded])
    found = map_changes(was, [recorded[k] for k in sure], found_at)
    wrong = int((np.hypot(*(found_at - poses[sure])[:, :2].T) > 0.5).sum())
    passed, ended_in = rays(poses[sure], exact[sure], angles, was)
    least = number("changes.scans")
    gone, new = was.occupied & ~is_.occupied, is_.occupied & ~was.occupied
    seen = gone & (passed >= least), new & (ended_in >= least)

    def wide(mask: BoolArray) -> BoolArray:
        return np.asarray(cv2.dilate(mask.view(np.uint8), np.ones((3, 3), np.uint8)) > 0)

    hits = int((found.gone & seen[0]).sum()), int((wide(found.new) & seen[1]).sum())
    false = int((found.gone & ~wide(gone)).sum() + (found.new & ~wide(new)).sum())
    total, wanted = int(found.gone.sum() + found.new.sum()), int(seen[0].sum() + seen[1].sum())
    return (
        name, "yes" if changed else "no", f"{len(sure)} of {scans}", wrong,
        f"{hits[0]} of {int(seen[0].sum())}", f"{hits[1]} of {int(seen[1].sum())}",
        f"{sum(hits) / wanted:.3f}" if wanted else "",
        f"{false} of {total}", f"{100 * found.gone_share:.1f}", f"{found.new_m2:.2f}",
    )  # fmt: skip


def changes(names: Sequence[str], scans: int, seed: int) -> Iterator[str]:
    """Measure :func:`imgloc.map_changes`; yield the lines of a table."""
    rows = [aging(name, scans, seed, changed=c) for name in names for c in (True, False)]
    head = (
        "world | changed | sure | of these wrong | gone cells found | new cells found | found | "
        "false | walls gone, % | new, m2"
    )
    yield from table_lines(head, rows)


def main(arguments: Sequence[str] | None = None) -> int:
    """Parse the command line, measure, print."""
    parser = parser_of("tools.maps", __doc__, seed=1)
    parser.add_argument("what", choices=("align", "changes"))
    parser.add_argument("maps", nargs="*", type=Path, help="maps of different places, for align")
    parser.add_argument("--pairs", type=int, default=30, help="pairs that must not match")
    parser.add_argument("--worlds", nargs="+", default=WORLD_NAMES, choices=sorted(WORLDS))
    parser.add_argument("--scans", type=int, default=120, help="scans in each world")
    given = parser.parse_intermixed_args(arguments)

    def work() -> int:
        if given.what == "align":
            return show(align(given.maps, given.pairs, given.seed))
        return show(changes(given.worlds, given.scans, given.seed))

    return ended("tools.maps", work)


if __name__ == "__main__":
    raise SystemExit(main())
