"""Maps of a wrong scale: what `imgloc calibrate --scans` finds, and how good answers then are."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imgloc import MapFeatures, OccupancyGrid, Options, Pose2D, ScanSet, Shared, localize, prepare
from imgloc.geometry import pose_errors, poses_of
from imgloc.lab.calibrate import fit_shared
from imgloc.model import FloatArray, compose, inverse
from tools.script import table_lines
from tools.trust.reliability import RIGHT


@dataclass(frozen=True)
class ScaleRow:
    """A map whose cells say another size than they have: shares of scans whose first is right."""

    name: str
    factor: float  #: by which the size of a cell is wrong
    found: float  #: the scale of the scans that calibration finds; right is `factor`
    deviation: float  #: that it claims
    undisturbed: float
    before: float  #: with the wrong scale
    after: float  #: with that of the calibration


def scaled_pose(pose: FloatArray, origin: Pose2D, factor: float) -> FloatArray:
    """Where a pose (3,), map frame, is if the cells of the map are so many times as large.

    Examples
    --------
    >>> scaled_pose(np.array([3.0, 2.0, 0.5]), Pose2D(1.0, 0.0, 0.0), 1.1).round(3).tolist()
    [3.2, 2.2, 0.5]
    """
    local = compose(inverse(origin), Pose2D(*pose))
    there = compose(origin, Pose2D(local.x * factor, local.y * factor, local.theta))
    return np.array([there.x, there.y, there.theta])


def scale_rows(
    name: str,
    grid: OccupancyGrid,
    known: ScanSet,
    asked: ScanSet,
    factors: Sequence[float],
    advance: Callable[[], None] = lambda: None,
) -> list[ScaleRow]:
    """Calibrate by scans `known`, without their poses, and localize those `asked`, with poses."""

    def right(features: MapFeatures, factor: float, shared: Shared) -> float:
        hits = []
        for scan, pose in asked.with_poses():
            found = poses_of(localize(features, scan, Options(shared=shared)).hypotheses[:1])
            there = Pose2D(*scaled_pose(pose, grid.origin, factor))
            hits.append((pose_errors(found, there) <= RIGHT).all(axis=1).any())
        return float(np.mean(hits))

    rows, home = [], right(prepare(grid, name), 1.0, Shared())
    for factor in factors:
        features = prepare(replace(grid, resolution=grid.resolution * factor), name)
        fit = fit_shared(features, known.scans)
        before, after = (right(features, factor, s) for s in (Shared(), fit.shared))
        error = fit.deviation or 0.0
        rows.append(ScaleRow(name, factor, fit.shared.scale, error, home, before, after))
        advance()
    return rows


def scale_table(rows: Sequence[ScaleRow]) -> str:
    """The rows as Markdown."""
    head = "set | map x | scale found | claimed | off | undisturbed | before | calibrated"
    cells = (
        (r.name, f"{r.factor:g}", f"{r.found:.4f}", f"{r.deviation:.4f}",
         f"{100 * (r.found / r.factor - 1):+.2f} %",
         *(f"{share:.2f}" for share in (r.undisturbed, r.before, r.after)))
        for r in rows
    )  # fmt: skip
    return "\n".join(table_lines(head, cells))
