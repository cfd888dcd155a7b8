"""The work of `imgloc evaluate` on a map: open it, check it, measure."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, replace
from typing import Annotated, Any

from imgloc.answers.logcheck import located
from imgloc.answers.truth import NOT_TRUE, poses_fit
from imgloc.errors import ScanError
from imgloc.features.mapfeatures import MapFeatures
from imgloc.io.calibration import calibrated
from imgloc.io.contents import content_hash, files_of
from imgloc.io.files import display
from imgloc.io.scanset import ScanSet
from imgloc.lab.evaluation import evaluate, method_options
from imgloc.model import OccupancyGrid
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
from imgloc.ranges import Checked, OneOf
from imgloc.runs.jobs import Item
from imgloc.runs.localize import Localize
from imgloc.runs.opening import LOG, Desk, MapFiles, ScanFiles
from imgloc.simulation.scans import fine_image, is_world, simulate

Source = dict[str, Any]


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
