"""What the benchmark times of the likelihoods, beside plain references."""

from collections.abc import Callable, Sequence

import numpy as np

from imgloc.experiments.bench import Case
from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.scanpoints import scan_points, scan_xy
from imgloc.geometry import uniform_thetas
from imgloc.likelihood.cbml import cbml, cbml_o, project
from imgloc.likelihood.ght import ght, ght_v
from imgloc.likelihood.slices import cell_offsets
from imgloc.model import Float32Array, FloatArray, LaserScan
from imgloc.search.branch_and_bound import best_poses

HEADINGS = 120
PAIR_HEADINGS = 36


def stack_cases(features: MapFeatures, scans: Sequence[LaserScan], threads: int) -> list[Case]:
    """The stacks of CBML and CBML-O by every engine, and plain references; branch and bound.

    A stack costs the same for any scan, so that one will do; branch and bound takes them all.
    """
    scan, seen = scans[0], [scan_xy(s)[s.valid] for s in scans]
    thetas = uniform_thetas(2 * np.pi / HEADINGS)
    cell, xy = features.lattice.resolution, scan_xy(scan)[scan.valid]
    points = scan_points(scan.ranges, scan.angles, scan.valid)
    bmap, vmap, free = features.bmap, features.vmap, features.free
    pooled, projections = features.pooled, project(vmap)
    out = np.empty((HEADINGS, *bmap.shape), np.float32)
    work = out.size * len(xy)
    slow = uniform_thetas(np.pi)  # two headings of what takes long
    few = work * len(slow) / HEADINGS

    def stack(engine: str, workers: int) -> Callable[[], object]:
        return lambda: cbml(bmap, xy, thetas, cell, engine=engine, threads=workers, out=out)

    def oriented(engine: str, workers: int) -> Callable[[], object]:
        return lambda: cbml_o(
            vmap, points, thetas, cell, engine=engine, threads=workers, out=out,
            projections=projections,
        )  # fmt: skip

    unit = "pose and reading"
    cases: list[Case] = [
        ("Alg. 1 in NumPy", unit, few, lambda: gathered(bmap, xy, slow, cell)),
        ("cbml filter2d", unit, few, lambda: cbml(bmap, xy, slow, cell, engine="filter2d")),
    ]
    for engine in ("shift", "dft", "auto"):
        cases.append((f"cbml {engine}", unit, work, stack(engine, 1)))
        cases.append((f"cbml-o {engine}", unit, work, oriented(engine, 1)))
    if threads > 1:
        cases.append((f"cbml auto, {threads} threads", unit, work, stack("auto", threads)))
        cases.append((f"cbml-o auto, {threads} threads", unit, work, oriented("auto", threads)))
    cases.append(
        (
            "cbml auto, free cells, argmax", unit, work,
            lambda: int(cbml(bmap, xy, thetas, cell, where=free, out=out).argmax()),
        )
    )  # fmt: skip
    every = out.size * sum(map(len, seen))
    cases.append(
        (
            f"branch and bound, {len(scans)} scans", unit, every,
            lambda: [best_poses(pooled, one, thetas) for one in seen],
        )
    )  # fmt: skip
    return cases


def vote_cases(features: MapFeatures, scan: LaserScan, threads: int) -> list[Case]:
    """The votes of GHT and GHT-V, and Alg. 4 as one ``np.add.at``."""
    points = scan_points(scan.ranges, scan.angles, scan.valid)
    surface, visibility = features.surface, features.visibility
    shape, cell = features.lattice.shape, features.lattice.resolution
    pairs = int(points.valid.sum()) * int(surface.valid.sum())
    args = points, PAIR_HEADINGS, shape, cell
    out = np.empty((PAIR_HEADINGS, *shape), dtype=np.float32)
    cases: list[Case] = [
        ("Alg. 4 by np.add.at", "pair", pairs, lambda: added(features, scan)),
        ("ght", "pair", pairs, lambda: ght(surface, *args, out=out)),
        ("ght-v", "pair", pairs, lambda: ght_v(surface, visibility, *args, out=out)),
    ]
    if threads > 1:
        many = threads
        cases.append(
            (
                f"ght-v, {many} threads", "pair", pairs,
                lambda: ght_v(surface, visibility, *args, threads=many, out=out),
            )
        )  # fmt: skip
    return cases


def gathered(bmap: Float32Array, xy: FloatArray, thetas: FloatArray, cell: float) -> FloatArray:
    """Alg. 1 in NumPy: for each heading and reading the map under all poses, added up."""
    height, width = bmap.shape
    out = np.zeros((len(thetas), height, width))
    rows, columns = np.indices((height, width))
    for total, offsets in zip(out, cell_offsets(xy, thetas, cell), strict=True):
        for dr, dc in offsets:
            r, c = rows + dr, columns + dc
            on = (r >= 0) & (r < height) & (c >= 0) & (c < width)
            total[on] += bmap[r[on], c[on]]  # Alg. 1, l. 5-6
    return out


def added(features: MapFeatures, scan: LaserScan) -> FloatArray:
    """Alg. 4 in NumPy: where each pair of points votes, all at once, into one stack."""
    points = scan_points(scan.ranges, scan.angles, scan.valid)
    s = features.surface.select(np.flatnonzero(features.surface.valid))
    p = points.select(np.flatnonzero(points.valid))
    height, width = features.lattice.shape
    out = np.zeros((PAIR_HEADINGS, height, width))
    theta = s.alpha[:, None] - p.alpha  # Alg. 4, l. 4
    c, si = np.cos(theta), np.sin(theta)
    x = s.xy[:, :1] - (c * p.xy[:, 0] - si * p.xy[:, 1])  # Alg. 4, l. 5
    y = s.xy[:, 1:] - (si * p.xy[:, 0] + c * p.xy[:, 1])
    k = np.floor(theta * (PAIR_HEADINGS / (2 * np.pi)) + 0.5).astype(int) % PAIR_HEADINGS
    col, row = (np.floor(v / features.lattice.resolution).astype(int) for v in (x, y))
    on = (col >= 0) & (col < width) & (row >= 0) & (row < height)
    np.add.at(out, (k[on], row[on], col[on]), 1.0)
    return out
