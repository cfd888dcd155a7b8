"""Scans of several files that are located in one map, each once."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from imgloc.features.floor import as_located
from imgloc.features.scanpoints import evenly
from imgloc.filters.follow import Moment, Tracking, follow, moves
from imgloc.io.scanset import ScanSet
from imgloc.lab.changes import sure_poses
from imgloc.model import FloatArray, LaserScan, compose
from imgloc.runs.localize import Locating
from imgloc.runs.opening import held_bytes

LOG = logging.getLogger("imgloc")


@dataclass(frozen=True, eq=False)
class Placed:
    """Scans with a sure pose."""

    given: int  #: scans that were located, with a sure pose or not
    scans: tuple[LaserScan, ...]  #: the readings with which each was located
    poses: FloatArray  #: (N, 3) of their sensor, map frame: metres, metres, radians
    hints: list[str] = field(default_factory=list)  #: what keeps others from a sure pose


@dataclass
class Once:
    """Tells which scans no file before had, so that a log that is given twice counts once.

    Examples
    --------
    >>> import numpy as np
    >>> one, other = (LaserScan(np.full(4, r), np.arange(4.0), range_max=9.0) for r in (2, 3))
    >>> once = Once()
    >>> once.new([one, one], "a"), once.new([other, one], "b")
    ([0, 1], [0])
    """

    _seen: set[tuple[str, bytes, bytes]] = field(default_factory=set)

    def new(self, scans: Sequence[LaserScan], name: str) -> list[int]:
        """Indices of the scans of the file called `name` that are in no file before."""
        keys = [(repr(s.stamp), s.ranges.tobytes(), s.angles.tobytes()) for s in scans]
        some = [k for k, key in enumerate(keys) if key not in self._seen]
        self._seen.update(keys)
        if left := len(keys) - len(some):
            LOG.warning("%s: %d of its scans are in a file before, and count once", name, left)
        return some


def some_of(run: Locating, most: int, once: Once | None = None) -> Locating:
    """At most so many scans of a file, evenly spread.

    With `once` none that a file before had.
    """
    run = run.some(evenly(len(run), most).tolist())
    if once is not None:
        run = run.some(once.new(run.taken.scans.scans, run.taken.name))
    run.desk.held += held_bytes(run.taken.scans.scans)
    return run


def placed(run: Locating, most: int, once: Once) -> Placed:
    """Scans of a file, at most so many, at sure poses: where the file has odometry, along it.

    Where a map has changed, few scans are sure of a place by themselves.
    """
    if moves(run.taken.scans):
        return _followed(run, most, once)
    located = list(some_of(run, most, once))
    sure, poses = sure_poses([one.of for one in located])
    scans = tuple(as_located(located[k].scan, located[k].of.evidence) for k in sure)
    said = [(one.of.verdict, one.of.evidence) for one in located]
    found = run.doubts(ScanSet(tuple(one.scan for one in located)), said) if located else []
    hints = [hint.said for hint in found if hint.found]  # others lead to `imgloc map changes`
    return Placed(len(located), scans, poses, hints)


def _followed(run: Locating, most: int, once: Once) -> Placed:
    """The whole log is followed; only scans that no file before had count."""
    scans, made = run.taken.scans, Tracking().made(run.features, run.options)
    new, sure = set(once.new(scans.scans, run.taken.name)), list[Moment]()
    with run.desk.progress("track", len(scans)) as advance:
        for moment in follow(run.features, scans, made, name=run.taken.name):
            advance()
            if moment.pose is not None and moment.index in new:
                sure.append(moment)
    some = [sure[k] for k in evenly(len(sure), most)]
    seen = tuple(scans[one.index].scaled(one.scale) for one in some)
    pairs = zip(some, seen, strict=True)
    poses = [[*compose(m.pose, scan.mount)] for m, scan in pairs if m.pose]
    return Placed(len(new), seen, np.array(poses).reshape(-1, 3))
