"""What `imgloc evaluate` and `imgloc atlas` do with a map: open it, check it, measure."""

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

from imgloc.answers.logcheck import located
from imgloc.answers.truth import NOT_TRUE, poses_fit
from imgloc.errors import ScanError
from imgloc.features.budget import poses_bytes
from imgloc.features.mapfeatures import MapFeatures
from imgloc.io.calibration import calibrated
from imgloc.io.contents import content_hash, files_of
from imgloc.io.files import display
from imgloc.io.scanset import ScanSet
from imgloc.lab.atlas import AT_ONCE, MOST, TOP, Spot, atlas_poses, simulate_at, survey
from imgloc.lab.evaluation import evaluate, method_options
from imgloc.model import FloatArray, OccupancyGrid
from imgloc.options import (
    ALL_METHODS,
    FUSED,
    TOLERANCES,
    Count,
    Length,
    Options,
    Sensor,
    Step,
    Tolerance,
)
from imgloc.pipeline import prepare
from imgloc.ranges import Checked, OneOf
from imgloc.runs.jobs import Item
from imgloc.runs.localize import Localize
from imgloc.runs.opening import LOG, Desk, MapFiles, ScanFiles
from imgloc.simulation.scans import fine_image, is_world, simulate

Source = dict[str, Any]
_EACH = 8  # poses that are worth a process


@dataclass(frozen=True, kw_only=True)
class Evaluate(Checked):
    """Measure a method: with recorded scans whose poses are known, or with simulated ones."""

    maps: MapFiles = field(default_factory=MapFiles)  #: how the images of maps are read
    method: Annotated[str, OneOf(*ALL_METHODS)] = FUSED
    theta_step: Step | None = None  #: radians; None is that of the paper
    cell: Length = 0.1  #: side of a cell of the poses, metres
    tolerances: tuple[Tolerance, ...] = TOLERANCES  #: how near to a known pose an answer is right
    scans: ScanFiles = field(default_factory=ScanFiles)
    sensor: Sensor = field(default_factory=Sensor)  #: sensor of simulated scans
    count: Count = 100
    seed: int = 0

    def open(self, item: Item, desk: Desk) -> Iterator[dict[str, Any]]:
        """Read a map and the scans that are located on it, or simulate them; yield a row."""
        path, ((where, _),) = item.path, item.maps
        grid = desk.grid(path, self.maps, usable=True)
        options = method_options(self.method, self.theta_step, desk.threads)
        options = replace(options, memory_budget=desk.memory_budget)
        files = [*files_of(path), *([] if item.scans_path is None else [item.scans_path])]
        of = item.maps, content_hash(files), self.scans, self.sensor, self.count, self.seed
        make = self._simulated if item.scans_path is None else self._recorded
        trials, source = desk.once("trials", of, lambda: make(item, desk, grid))
        known = calibrated(options, path, grid)
        if item.scans_path is None:  # scans simulated in the map have no error of its scale
            known = replace(known, shared=options.shared)
        # The bytes of the features are part of the row, so no other method may have used them.
        features = desk.features(
            path, self.maps, known, cell=self.cell, scans=trials.scans, fresh=True
        )
        return self._measured(item, desk, features, trials, known, {"map": where, **source})

    def doubts(self, item: Item, desk: Desk) -> list[str]:
        """What may keep recorded scans from being found: sentences, tried on a few of them."""
        run = Localize(maps=self.maps, scans=self.scans, cell=self.cell).open(item, desk)
        scans, features = run.taken.scans, run.features
        some, answers = located(features, scans, run.options)
        said = [(answer.verdict, answer.evidence) for answer in answers]
        found = run.doubts(some, said)
        poses = scans.poses
        if (
            not found
            and poses is not None
            and poses_fit(features.grid, scans.scans, poses) is False
        ):
            return [f"{run.taken.name}: {NOT_TRUE}"]
        return [doubt.said for doubt in found]

    def _simulated(self, item: Item, desk: Desk, grid: OccupancyGrid) -> tuple[ScanSet, Source]:
        path, sensor = item.path, self.sensor
        world, name = is_world(path, grid), display(path)
        desk.check_simulation(grid, name, self.count, sensor.rays, world=world)
        # In a bundled map rays meet its true walls, not its cells.
        trials = simulate(grid, self.count, self.seed, sensor, fine_image(path, grid))
        return trials, {"seed": self.seed, "sensor": asdict(sensor)}

    def _recorded(self, item: Item, desk: Desk, _: OccupancyGrid) -> tuple[ScanSet, Source]:
        taken, files = desk.scans(item.scans_path, self.scans), self.scans
        if taken.scans.poses is None:
            raise ScanError(
                f"{taken.name}: no poses; expected the true pose of each scan to compare with"
            )
        chosen = files.chosen
        source: Source = {"scans": item.scans, "sample": chosen.sample, "sample_seed": chosen.seed}
        source |= {"range_max": files.range_max, "flipped": files.flipped}
        source |= {} if files.scale == 1 else {"range_scale": files.scale}
        return taken.scans, source | ({} if chosen.index is None else {"index": chosen.index})

    def _measured(
        self, item: Item, desk: Desk, features: MapFeatures, trials: ScanSet, options: Options,
        source: Source,
    ) -> Iterator[dict[str, Any]]:  # fmt: skip
        with desk.progress(f"{item.map}: {self.method}", len(trials), lines=False) as advance:
            found = evaluate(
                features,
                trials,
                options,
                tolerances=self.tolerances,
                advance=advance,
            )
        LOG.info("%s: %s: S %.2f", item.map, self.method, found.summary.index.value)
        yield found.as_row(item.map, source)


@dataclass(frozen=True, kw_only=True)
class Atlas(Checked):
    """Simulate a scan at each place and heading of a map, and see where one is enough."""

    maps: MapFiles = field(default_factory=MapFiles)  #: how the images of maps are read
    sensor: Sensor = field(default_factory=Sensor)
    step: Length = 0.5  #: between the places, metres
    headings: Count = 4  #: at each of them
    seed: int = 0

    def open(self, item: Item, desk: Desk, *, workers: int = 1) -> "Surveying":
        """Read a map, and find its places; `workers` is the largest number of processes."""
        path, name = item.path, display(item.path)
        grid = desk.grid(path, self.maps, usable=True)
        height, width = grid.occupied.shape
        sides = (round(cells * grid.resolution / self.step + 1) for cells in (height, width))
        desk.check(
            poses_bytes(height * width, places := math.prod(sides), MOST),
            f"{name}: {self.headings} headings at up to {places:,} places "
            f"on {height} x {width} cells",
            "use a larger `step` or fewer `headings`, crop the map",
        )
        poses = atlas_poses(grid, self.step, self.headings, self.sensor.clearance)
        workers = min(workers, max(1, len(poses) // _EACH))
        desk.check_simulation(
            grid, name, len(poses), self.sensor.rays, world=is_world(path, grid), at_once=AT_ONCE,
            hint="use a larger `step`, crop the map",
        )  # fmt: skip
        options = Options(top=TOP, threads=1, memory_budget=desk.memory_budget)
        desk.check_answer(
            prepare(grid, name, ready=False), options, name, hint="crop the map", workers=workers
        )
        return Surveying(self, path, grid, poses, options, workers)


@dataclass(frozen=True, eq=False)
class Surveying:
    """A map and the poses that are located on it."""

    job: Atlas
    path: Path
    grid: OccupancyGrid
    poses: FloatArray  #: (N, 3), grid frame
    options: Options
    workers: int

    def spots(self, begin: int = 0) -> Iterator[Spot]:
        """Yield the spot of each pose, from the index `begin` on."""
        fine = fine_image(self.path, self.grid)
        scans = simulate_at(self.grid, self.poses, self.job.sensor, self.job.seed, fine)[begin:]
        workers = min(self.workers, max(1, len(scans) // _EACH))
        return survey(self.grid, scans, self.options, workers=workers)
