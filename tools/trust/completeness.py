"""Does the search list what scores? Its modes beside those of a far wider search."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from imgloc import FusedOptions, LaserScan, MapFeatures, OccupancyGrid, Options, Pose2D, ScanSet
from imgloc.features.floor import left_out
from imgloc.features.scanpoints import one_per_place
from imgloc.geometry import pose_errors, transform_poses, wrap
from imgloc.model import FloatArray
from imgloc.pipeline import find_adapted_modes, prepare
from imgloc.search.hypotheses import masses
from imgloc.search.modes import temperature_of
from tools.script import table_lines
from tools.trust.disturb import SCANS
from tools.trust.exhaustive import exhaustive
from tools.trust.reliability import RIGHT

MISSED = (0.01, 0.1)
"""Shares of the mass that a search may miss."""
_FIFTH, _CLEAR = 5, 1.0  # which mode a missed one must beat, and by how many nats: ties are chance
_COUNTS = 0.001  # of the mass, that it must have
#: No error is shared: both searches are of the same score.
SEARCH = FusedOptions(adapted=1e9)


@dataclass(frozen=True)
class Compared:
    """One scan, searched for twice."""

    condition: str
    missed: float  #: share of the mass of the wider search's modes that the search does not have
    above: bool  #: whether one that it does not have scores above its own fifth, or last
    right: bool  #: whether the search's first mode is right
    wider_right: bool  #: and that of the wider search


def compared(condition: str, features: MapFeatures, scan: LaserScan, pose: FloatArray) -> Compared:
    """Search for a scan that was taken at a `pose` (3,), map frame."""
    options = Options(fused=SEARCH)
    search = find_adapted_modes(features, scan, options)
    found, wider = search.poses, exhaustive(features, left_out(scan, search.floor), SEARCH)
    n, cell = len(wider.readings), features.grid.resolution
    score = wider.scores.things
    share = masses(score, temperature_of(wider.scores, n, options, cell).value)
    lacks = ~listed(wider.poses, found, SEARCH.separation)
    fifth = search.scores.things[:_FIFTH].min(initial=np.inf)
    above = np.any(lacks & (score > fifth + _CLEAR) & (share > _COUNTS))

    def is_right(poses: FloatArray) -> bool:
        there = transform_poses(features.grid.origin, poses[:1])
        return bool(np.all(pose_errors(there, Pose2D(*pose)) <= RIGHT, axis=1).any())

    return Compared(
        condition, float(share[lacks].sum()), bool(above), is_right(found), is_right(wider.poses)
    )


def listed(poses: FloatArray, among: FloatArray, within: tuple[float, float]) -> np.ndarray:
    """Which poses (M, 3) are nearer to one `among` others than metres and radians: bool (M,).

    Examples
    --------
    >>> poses = np.array([[0.0, 0.0, 3.1], [2.0, 0.0, 0.0]])
    >>> listed(poses, np.array([[0.1, 0.0, -3.1]]), (0.5, 0.2)).tolist()
    [True, False]
    """
    off = poses[:, None] - among
    near = np.hypot(off[..., 0], off[..., 1]) < within[0]
    return np.asarray((near & (np.abs(wrap(off[..., 2])) < within[1])).any(axis=1))


def of_place(grid: OccupancyGrid, scans: ScanSet, seed: int, first: int) -> Iterator[Compared]:
    """Each scan in one disturbance after another, from the one that is `first`."""
    features, names = prepare(grid), [*SCANS]
    for k, (scan, pose) in enumerate(scans.with_poses()):
        name = names[(first + k) % len(names)]
        disturbed = SCANS[name](scan, np.random.default_rng((seed, k)))
        seen = one_per_place(disturbed, SEARCH.place)
        if len(seen) >= Options().trust.readings:
            yield compared(name, features, disturbed, pose)


def completeness_table(all_compared: Sequence[Compared]) -> str:
    """A Markdown table, a line for each disturbance and one for all."""
    groups = {name: [c for c in all_compared if c.condition == name] for name in SCANS}
    groups = {name: some for name, some in groups.items() if some} | {"all": [*all_compared]}
    head = " | ".join((
        "scans", "number", *(f"misses {100 * most:g} % of the mass" for most in MISSED),
        "misses one above its fifth", "first right", "of the wider search",
    ))  # fmt: skip
    rows = (
        (
            name,
            len(some),
            *(sum(c.missed > most for c in some) for most in MISSED),
            sum(c.above for c in some),
            sum(c.right for c in some),
            sum(c.wider_right for c in some),
        )
        for name, some in groups.items()
    )
    return "\n".join(table_lines(head, rows))
