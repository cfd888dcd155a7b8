"""The job ``localize``: the pose of each scan of a file in one map."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from imgloc.answers.causes import Cause, Given
from imgloc.answers.diagnose import Said, doubts, misread
from imgloc.answers.truth import with_true_poses
from imgloc.errors import ConfigError
from imgloc.features.mapfeatures import MapFeatures
from imgloc.geometry import poses_of
from imgloc.io.calibration import calibrated
from imgloc.io.files import display, map_name
from imgloc.io.images import image_size, read_image
from imgloc.io.scanset import ScanSet
from imgloc.model import BoolArray, FloatArray, LaserScan, Localization, OccupancyGrid, Pose2D
from imgloc.options import FUSED, TOLERANCES, Drawn, Known, Length, Options, Prior, Tolerance
from imgloc.pipeline import localize_many
from imgloc.runs.jobs import Answer, Item, Job, compared
from imgloc.runs.opening import LOG, Desk, ScanFiles, Taken
from imgloc.search.priors import prior_of


@dataclass(frozen=True, kw_only=True)
class Localize(Job):
    """Locate each scan, without an initial guess."""

    name = "localize"

    options: Options = field(default_factory=Options)
    scans: ScanFiles = field(default_factory=ScanFiles)
    cell: Length = 0.1  #: of the poses, metres
    known: Known = field(default_factory=Known)  #: what is known of all poses
    drawn: Drawn = field(default_factory=Drawn)  #: what is stated of the map's walls
    region: Path | None = None  #: an image as large as the map's, white where the robot may be
    prior_image: Path | None = None  #: an image as large as the map's, whose greys are weights
    tolerance: Tolerance = TOLERANCES[-1]  #: how near a known pose an answer is a hit

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.options.method != FUSED and self.drawn != Drawn():
            method = self.options.method
            raise ConfigError(
                f"`thinner` and `bent`: {method} scores walls as drawn; expected method {FUSED}"
            )

    def open(self, item: Item, desk: Desk) -> "Locating":
        """Read the scans and the map of an item."""
        taken, path = desk.scans(item.scans_path, self.scans), item.path
        timed = any(scan.time_increment for scan in taken.scans.scans)
        if (self.options.max_speed or self.options.max_turn) and not timed:
            text = "%s: `max_speed` and `max_turn` change nothing: the scans have no time_increment"
            LOG.warning(text, taken.name, extra={"code": "unused"})
        options = replace(self.options, threads=desk.threads, memory_budget=desk.memory_budget)
        features = desk.features(path, self.maps, options, cell=self.cell, scans=taken.scans.scans)
        if options.calibration is None:
            options = calibrated(options, path, features.grid, self.drawn)
        prior = prior_of(self.known, features.grid)
        if self.region is not None:
            cells = region_of(self.region, features.grid, allow_lossy=self.maps.allow_lossy)
            prior &= Prior(cells, None, {"region": {"cells": int(cells.sum())}})
        if self.prior_image is not None:
            greys = greys_of(self.prior_image, features.grid, allow_lossy=self.maps.allow_lossy)
            prior &= Prior(None, None, {"prior_image": float(greys.mean())}, greys)
        options = replace(options, prior=prior)
        opened = Locating(self, desk, path, features, options, taken)
        return opened.with_true_poses() if taken.tried.poses_are_odometry else opened


@dataclass(kw_only=True, eq=False)
class Located(Answer):
    """The answer to one scan."""

    of: Localization
    scan: LaserScan
    truth: Pose2D | None  #: of the sensor, map frame, if it is known


@dataclass(frozen=True, eq=False)
class Locating:
    """Scans that are located as they are asked for."""

    job: Localize
    desk: Desk
    path: Path  #: of the map
    features: MapFeatures
    options: Options
    taken: Taken

    def __len__(self) -> int:
        return len(self.taken.indices)

    def __iter__(self) -> Iterator[Located]:
        with self.desk.progress("localize", len(self)) as advance:
            taken = list(self.taken)
            answers = localize_many(self.features, (scan for _, scan, _ in taken), self.options)
            for (k, scan, truth), answer in zip(taken, answers, strict=True):
                beside = compared(poses_of(answer.hypotheses), truth, self.job.tolerance)
                drawn = self.features, answer, scan, truth, self.options, self.title(k)
                advance()
                yield Located(
                    row=answer.as_row(k),
                    of=answer,
                    beside=beside,
                    ms=answer.timings_ms["localize"],
                    doubtful=answer.verdict != "unique" or beside.get("hit") is False,
                    index=k,
                    drawn=("answer", *drawn),
                    scan=scan,
                    truth=truth,
                )
        self.desk.keep(self.features)

    @property
    def map_name(self) -> str:
        """The usual name of the map."""
        return map_name(self.path)

    def title(self, index: int) -> str:
        """Title of a picture of the answer to a scan: map, file and scan."""
        return f"{self.map_name}: {Path(self.taken.name).name}, scan {index}"

    def some(self, which: Sequence[int]) -> "Locating":
        """The same with some of its scans."""
        return replace(self, taken=self.taken.some(which))

    def with_true_poses(self) -> "Locating":
        """The same, without known poses if the scans do not fit the map there."""
        taken, grid = self.taken, self.features.grid
        scans = with_true_poses(taken.scans, grid, taken.name, taken.tried)
        return replace(self, taken=replace(taken, scans=scans))

    def doubts(self, scans: ScanSet, said: Said) -> list[Cause]:
        """Likely faults of scans, by their verdicts `said`."""
        if not self._tries:
            return []
        return doubts(self.features, scans, said, self.options, self._given)

    def misread(self, scans: ScanSet, said: Said) -> Cause | None:
        """The cause if scans that do not fit, by their verdicts `said`, do so read otherwise."""
        if not self._tries:
            return None
        return misread(self.features, scans, said, self.options, self._given)

    @property
    def _tries(self) -> bool:
        """True if a doubtful scan may be located in other ways, too."""
        return self.options.method == FUSED and self.options.time_budget is None

    @property
    def _given(self) -> Given:
        """Statements about the scans and the map."""
        return self.job.scans.given.beside(self.path, self.features.grid, self.job.drawn)


def region_of(path: Path, grid: OccupancyGrid, *, allow_lossy: bool) -> BoolArray:
    """The white pixels of an image that are not transparent, (H, W), row 0 lowest."""
    cells = greys_of(path, grid, allow_lossy=allow_lossy) > 0.5
    if not cells.any():
        raise ConfigError(f"{display(path)}: no white pixel, expected white where the robot may be")
    return cells


def greys_of(path: Path, grid: OccupancyGrid, *, allow_lossy: bool) -> FloatArray:
    """The greys of an image, black 0 and white 1, (H, W), row 0 lowest; black if transparent."""
    size = image_size(path)[:2]  # of which there is memory enough if it is that of the map
    if size[::-1] != grid.occupied.shape:
        height, width = grid.occupied.shape
        raise ConfigError(
            f"{display(path)}: {size[0]} x {size[1]} pixels, expected {width} x {height} as the map"
        )
    read = read_image(path, allow_lossy=allow_lossy)
    # The darkest channel decides, alpha being one of them: neither colour nor nothing is white.
    return np.asarray(np.atleast_3d(read.pixels).min(axis=2)[::-1] / read.white)
