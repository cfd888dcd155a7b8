"""A job: work with a map and its scans, the same for one map and for a thousand.

A job is a frozen dataclass of its options. It opens an item, which reads and checks all that it
needs, and gives an answer at a time. Who takes them is a *sink*: a command prints them as they
come, a batch keeps their rows. Jobs are known by their names, in ``JOBS`` of
:mod:`imgloc.doors`; to add one, write its class and its line there.
"""

import hashlib
import json
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, ClassVar

from imgloc import numbers
from imgloc.doors import JOBS, opened
from imgloc.errors import ConfigError
from imgloc.geometry import pose_errors
from imgloc.model import Pose2D, plain
from imgloc.options import Tolerance
from imgloc.ranges import Checked, OneOf
from imgloc.runs.opening import Desk, MapFiles

PICTURES = ("none", "doubtful", "all")
LOCATING = frozenset({
    "Bending", "Calibration", "EvidenceModel", "FusedOptions", "Trust", "adapt", "background",
    "beam", "covariance", "distance", "faces", "floor", "messages", "odometry", "options",
    "pipeline", "priors", "proposals", "protection", "refine", "rescore",
    "scanpoints", "trust", "truth", "weigh",
})  # fmt: skip
"""Families of :mod:`imgloc.numbers` that decide where a scan is."""


@dataclass(frozen=True)
class Item:
    """A map with a file of scans; several maps for ``which``, no scans for jobs without."""

    map: str  #: names, as the rows have them
    scans: str | None
    maps: tuple[tuple[str, Path], ...]  #: name and file of each map
    scans_path: Path | None = None

    @property
    def id(self) -> tuple[str, str | None]:
        """Its key among all others of a batch."""
        return self.map, self.scans

    @property
    def group(self) -> str:
        """Items of one group use the same maps: a worker is to have as many of one as it can."""
        return self.map

    @property
    def path(self) -> Path:
        """The file of its only map."""
        ((_, path),) = self.maps
        return path


@dataclass(kw_only=True)
class Answer:
    """One answer of a job, as every sink takes it."""

    #: as a command writes it with ``--json``. A batch has ``timings_ms`` and ``cost`` apart, as two
    #: runs do not share them, and ``parameters`` once for all rows
    row: dict[str, Any]
    of: Any = None  #: what the row was made of
    #: what a batch adds: how far it is from a known pose, maps left out
    beside: Mapping[str, Any] = field(default_factory=dict)
    ms: float | None = None  #: what it took
    doubtful: bool = False
    index: int = 0  #: of the scan in its file
    drawn: tuple[Any, ...] = ()  #: the kind of a drawing, and what is drawn


@dataclass(frozen=True, kw_only=True)
class Job(Checked, ABC):
    """Work that is done with each item, and everything that decides its rows."""

    name: ClassVar[str]
    with_scans: ClassVar[bool] = True  #: whether it needs scans
    all_maps: ClassVar[bool] = False  #: whether an item has all maps, not one of them
    decided_by: ClassVar[frozenset[str]] = LOCATING  #: families of numbers that decide its rows

    maps: MapFiles = field(default_factory=MapFiles)  #: how the images of maps are read

    #: of which answers a batch keeps pictures, one of :data:`PICTURES`
    pictures: Annotated[str, OneOf(*PICTURES)] = "none"

    @abstractmethod
    def open(self, item: Item, desk: Desk) -> Iterable[Answer]:
        """Read and check what an item needs; its answers are made as they are asked for.

        Raises
        ------
        ImglocError
            If a file, or what is to be done with it, is at fault.
        """

    @cached_property
    def digest(self) -> str:
        """Hash of the options and numbers that decide the rows, beside files and version."""
        return hash_of([self.parameters, numbers.digest(self.decided_by)])

    @property
    def parameters(self) -> dict[str, Any]:
        """Everything that decides a row, as plain values."""
        own = asdict(self)
        for name in ("prior", "threads", "memory_budget"):
            own.get("options", {}).pop(name, None)
        return dict(json.loads(json.dumps(plain(own), default=str)))


def hash_of(value: object) -> str:
    """32 hexadecimal digits of plain values."""
    text = json.dumps(value, sort_keys=True)
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def job_class(name: str) -> type[Job]:
    """The class of a job by its name; ConfigError if there is none."""
    if name not in JOBS:
        raise ConfigError(f"job: got {name!r}, expected one of {', '.join(JOBS)}")
    found: type[Job] = opened(JOBS[name])
    return found


def make_job(name: str = "localize", **options: Any) -> Job:
    """Make the job of a name, with options that are fields of its class.

    Examples
    --------
    >>> make_job("check").with_scans
    False
    """
    return job_class(name)(**options)


def compared(poses: Any, truth: Pose2D | None, tolerance: Tolerance) -> dict[str, Any]:
    """Errors of the first pose (N, 3) of an answer; nothing if the true one is unknown."""
    if truth is None:
        return {}
    errors = pose_errors(poses[:1], truth)
    near = (tolerance.position, tolerance.heading)
    hit = bool(len(errors) and (errors[0] <= near).all())
    position, heading = errors[0].tolist() if len(errors) else (None, None)
    return {"truth": plain(truth), "hit": hit, "error": {"position": position, "heading": heading}}
