"""The rows of JSON that commands print, and that who answers live gives too: one writer of each.

The row of `imgloc which --json` is :meth:`imgloc.choice.choose.Choice.as_row`.
"""

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from imgloc.geometry import transform_poses
from imgloc.io.scanset import ScanSet
from imgloc.model import LaserScan, Localization, Pose2D, plain

if TYPE_CHECKING:
    from imgloc.filters.belief import Belief
    from imgloc.filters.follow import Moment


def answer_row(
    answer: Localization, scan: LaserScan, index: int = 0, *, sensor: Pose2D | None = None,
    flipped: bool = False, about: Mapping[str, object] | None = None,
) -> dict[str, Any]:  # fmt: skip
    """The row of `imgloc localize --json`.

    Parameters
    ----------
    answer : Localization
    scan : LaserScan
        The located scan, mounted and cut to its reach.
    index : int
        Index of the scan in its file.
    sensor, flipped : Pose2D, bool
        The mount of the sensor as the user gave it, where the scans do not state it.
    about : mapping, optional
        Further parameters for the row.
    """
    how = {**(about or {}), "range_max": scan.range_max, "sensor": sensor, "flipped": flipped}
    return answer.as_row(index, **how)


PLACES = 20  #: places of a belief that are listed


def places_of(belief: "Belief", origin: Pose2D) -> list[dict[str, float]]:
    """The places of a belief with their masses, map frame, best first.

    `origin` is that of the grid, in whose frame beliefs are.
    """
    poses = transform_poses(origin, belief.poses[:PLACES]).tolist()
    return [
        dict(zip(("x", "y", "theta", "mass"), (*pose, mass), strict=True))
        for pose, mass in zip(poses, belief.mass[:PLACES].tolist(), strict=True)
    ]


def moment_row(
    moment: "Moment", origin: Pose2D | None = None, *, best: bool = False
) -> dict[str, Any]:
    """The row of `imgloc track --json`: the pose is null unless it is unique.

    With the `origin` of the grid it lists all places. With `best` it has the best guess, which is
    null where the pose is unique.
    """
    belief, pose = moment.belief, moment.pose
    row: dict[str, Any] = {
        **{name: getattr(moment, name) for name in ("index", "stamp", "age")},
        "deviation": None if moment.best is None else moment.deviation,
        "looked": moment.looked,
        "verdict": belief.verdict,
        "withheld": moment.withheld or None,
        "pose": pose,
        "covariance": None if pose is None else moment.covariance,
        "map_odom": None if pose is None else moment.map_odom,
        "lost": belief.lost,
        "protection": [vars(level) for level in moment.protection],
        "mass": float(belief.mass[0]) if len(belief.mass) else 0.0,
        "neff": belief.neff,
        "resets": belief.resets,
        **{name: getattr(moment, name) for name in ("scale", "thinner", "bent")},
    }
    if best:
        row["guess"] = moment.best if pose is None else None
    if origin is not None:
        row["places"] = places_of(belief, origin)
    return dict(plain(row))


def scan_row(scans: ScanSet, k: int) -> dict[str, Any]:
    """A scan of a set as JSON that is read back as the same scan; what is not known is left out.

    Examples
    --------
    >>> scans = ScanSet((LaserScan([1.0, np.inf, np.nan], [0.0, 0.1, 0.2]),))
    >>> scan_row(scans, 0)
    {'index': 0, 'ranges': [1.0, 'inf', None], 'angles': [0.0, 0.1, 0.2], 'range_min': 0.0, \
'time_increment': 0.0}
    """
    scan = scans[k]
    words = {math.inf: "inf", -math.inf: "-inf"}
    ranges = [r if math.isfinite(r) else words.get(r) for r in scan.ranges.tolist()]
    row: dict[str, Any] = {"index": k, "ranges": ranges, "angles": scan.angles.tolist()}
    stamp = scan.stamp if scans.stamps is None else float(scans.stamps[k])
    numbers = {"range_min": scan.range_min, "range_max": scan.range_max, "stamp": stamp}
    numbers["time_increment"] = scan.time_increment
    row |= {key: value for key, value in numbers.items() if math.isfinite(value)}
    poses = {"pose": scans.poses, "odom": scans.odom}
    for key, rows in poses.items():
        if rows is not None and np.isfinite(rows[k]).all():
            row[key] = dict(zip(("x", "y", "theta"), rows[k].tolist(), strict=True))
    if scan.T_base_laser is not None:
        row["mount"] = plain(scan.T_base_laser)
    return row | ({"laser": scan.laser} if scan.laser else {})
