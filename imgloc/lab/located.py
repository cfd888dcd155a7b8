"""Scans of several files that are located in one map, each once."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field

from imgloc.features.scanpoints import evenly
from imgloc.io.scanset import ScanSet
from imgloc.model import LaserScan
from imgloc.options import Chosen
from imgloc.runs.jobs import Item
from imgloc.runs.localize import Localize, Located, Locating
from imgloc.runs.opening import Desk, held_bytes

LOG = logging.getLogger("imgloc")


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


def open_some(
    job: Localize, item: Item, desk: Desk, most: int, once: Once | None = None
) -> Locating:
    """Open an item: at most so many of its scans, evenly spread, unless they are chosen.

    With `once` none that a file before had.
    """
    run = job.open(item, desk)
    if job.scans.chosen == Chosen():
        run = run.some(evenly(len(run), most).tolist())
    if once is not None:
        run = run.some(once.new(run.taken.scans.scans, run.taken.name))
    desk.held += held_bytes(run.taken.scans.scans)
    return run


def hints_of(run: Locating, located: Sequence[Located]) -> list[str]:
    """Causes that keep scans, located like those of a run, from a sure pose."""
    said = [(one.of.verdict, one.of.evidence) for one in located]
    found = run.doubts(ScanSet(tuple(one.scan for one in located)), said)
    return [hint.said for hint in found if hint.found]  # others lead to `imgloc map changes`
