"""`imgloc evaluate`: how often, how precisely and how fast each method finds known poses."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from imgloc.cli import options as opt
from imgloc.cli.console import emit, width
from imgloc.cli.options import flag, option
from imgloc.errors import ConfigError
from imgloc.io.files import display

_METHODS = ",".join(opt.MethodName)
_MAX_SCANS = 100_000
_FLOOR = (1e-12, 0.5, "a share")
_SCANS, _SEQUENCE = ("evaluate without --sequence",), ("evaluate --sequence",)
#: Of which of the two options are that the other would not notice.
_OF = {
    **dict.fromkeys(("methods", "count", "tolerance", "theta_step_deg", "cell", "floor"), _SCANS),
    **dict.fromkeys(("rays", "fov_deg", "sigma", "outliers", "dropped"), _SCANS),
    **dict.fromkeys(("clearance", "mount", "index", "sample", "sample_seed"), _SCANS),
    **dict.fromkeys(("filters", "begin", "metres", "resets", "mounted"), _SEQUENCE),
}


@opt.with_options(opt.sensor, opt.reading, opt.chosen, opt.taken, opt.console)
def evaluate(
    context: typer.Context,
    maps: Annotated[
        list[Path],
        typer.Argument(
            metavar="MAP...", help="map_server YAML, image, or the name of a bundled map."
        ),
    ],
    sensor: "opt.Sensor",
    reading: "opt.Reading",
    chosen: "opt.Chosen",
    taken: opt.Resources,
    methods: str = option(_METHODS, "NAMES", "With commas between."),
    count: int | None = option(
        None, "N", "Scans simulated. [default: 100]", "-n", "--count", min=1
    ),
    seed: int = option(0, "N", "Seed of what is simulated.", min=0),
    range_max: float | None = option(
        None, "M", "Reach of the simulated sensor [default: 30]; cuts recorded readings."
    ),
    scans: list[Path] | None = option(
        None, "FILE", "Recorded scans with poses; once for each MAP."
    ),
    flipped: opt.Flipped = False,
    tolerance: list[str] | None = option(
        None, "M,DEG", "Report success within this too; the last rules unique, wrong."
    ),
    theta_step_deg: list[str] | None = option(
        None, "[METHOD=]DEG", "Step of the headings. [default: as in the paper]"
    ),
    cell: list[str] | None = option(
        None, "[METHOD=]M", "Cell of the poses, metres. [default: 0.1]"
    ),
    floor: float = option(
        1e-3, "P", "Share of the uniform density mixed into each, for S.", within=_FLOOR
    ),
    sequence: bool = flag(
        "--sequence", "Follow the robot along each log, from many starts, instead of scan by scan."
    ),
    filters: str = option("tracker", "NAMES", "Of --sequence: tracker, grid, particle."),
    begin: int = option(50, "N", "Of --sequence: random starts.", "--starts", min=1),
    metres: float = option(
        15.0, "M", "Of --sequence: driven from each start.", within=(1, 1000, "metres")
    ),
    resets: bool = flag("--resets/--no-resets", "Of --sequence: start again when lost.", True),
    mounted: Any = opt.pose_of(
        "--mounted", "Of --sequence: pose of the sensor on the robot whose odometry it is."
    ),
    as_json: opt.AsJson = False,
    allow_lossy: opt.AllowLossy = False,
) -> None:
    """Measure methods on scans whose poses are known: simulated at random, or recorded.

    S is the paper's performance index (eq. 12), the mean logarithm of the density at the true pose
    relative to that of no idea at all: 0 knows nothing, S max is certainty on a lattice of poses.
    S calibrated is that of the posterior which localize uses, see `imgloc calibrate`; for fused it
    is on the lattice, too, where S of its Gaussians may be above S max. The paper's methods run on
    its cells: 3 degrees (cbml, cbml-o, beam) and 30 (ght, ght-v). "S all cells" is over walls and
    unknown space too, "at floor" counts trials whose density is no more than --floor, "not free"
    those whose true pose is in a cell that the map does not call free.
    Everything but what is under "cost" is the same in every run.
    """
    from imgloc.cli import inputs
    from imgloc.lab.jobs import Evaluate
    from imgloc.lab.tables import evaluation_tables
    from imgloc.model import to_json
    from imgloc.options import TOLERANCES

    opt.given(context, _OF, set(_SEQUENCE if sequence else _SCANS))
    if sequence:
        from imgloc.lab.commands.sequence import measure_sequences
        from imgloc.lab.sequences import Trials

        if scans is None or len(scans) != len(maps):
            raise ConfigError("--sequence: expected --scans, recorded ones, once for each MAP")
        names = opt.names_of("--filters", filters, list(opt.FilterName))
        measure_sequences(
            maps, scans, names, Trials(begin, metres, seed=seed, resets=resets),
            opt.Mounting(mounted, flipped), range_max, taken, reading, as_json, allow_lossy,
        )  # fmt: skip
        return
    names = opt.methods_of(methods, list(opt.MethodName))
    steps = opt.for_each("--theta-step-deg", theta_step_deg, names, *opt.STEP)
    cells = opt.for_each("--cell", cell, names, *opt.SIDE)
    opt.check_range("--range-max", range_max, 1e-3, 10_000 if scans is None else 1e6, "metres")
    _check_sources(maps, scans, count, chosen, sensor, flipped=flipped)
    reach = 30.0 if scans is not None or range_max is None else range_max
    jobs = [
        Evaluate(
            method=name,
            theta_step=math.radians(steps[name]) if name in steps else None,
            cell=cells.get(name, 0.1),
            tolerances=(*TOLERANCES, *map(opt.tolerance_of, tolerance or ())),
            floor=floor,
            maps=inputs.one_map(reading, allow_lossy=allow_lossy),
            scans=inputs.as_recorded(range_max=range_max, chosen=chosen, flipped=flipped),
            sensor=replace(sensor, range_max=reach),
            count=count or 100,
            seed=seed,
        )
        for name in names
    ]
    table: list[dict[str, Any]] = []
    for k, given in enumerate(maps):
        path = opt.find_map(given)
        # The folder of a map.yaml says more than its name.
        name = display((given.stem == "map" and given.parent.name) or given.stem)
        item = inputs.item_of(path, None if scans is None else scans[k], name)
        desk = inputs.desk_of(taken.threads, taken.memory_budget)
        # All of them are opened before the first one takes its time.
        for answer in itertools.chain.from_iterable([job.open(item, desk) for job in jobs]):
            table.append(answer.row)
            if as_json:
                emit(to_json(answer.row))
    if not as_json:
        emit(evaluation_tables(table, width()))


def _check_sources(
    maps: Sequence[Path], scans: Sequence[Path] | None, count: int | None, chosen: "opt.Chosen",
    sensor: "opt.Sensor", *, flipped: bool,
) -> None:  # fmt: skip
    """Refuse options that would be ignored."""
    from imgloc.simulation.scans import Sensor

    n, many, sampled = len(scans or ()), count or 0, chosen.sample is not None
    simulated = {
        "--flipped: expected --scans; simulated sensors are upright": flipped,
        "--sample: expected --scans to take from; -n is for simulated scans": sampled,
        "--index: expected --scans to take from": chosen.index is not None,
        f"-n: got {many:,}, expected at most {_MAX_SCANS:,} scans": many > _MAX_SCANS,
    }
    recorded = {
        f"--scans: got {n} for {len(maps)} maps, expected one each": n != len(maps),
        "-n: recorded scans are not simulated; use --sample": count is not None,
        "--scans: options of a simulated sensor do not go with recorded scans": sensor != Sensor(),
    }
    for message, wrong in (simulated if scans is None else recorded).items():
        if wrong:
            raise ConfigError(message)
