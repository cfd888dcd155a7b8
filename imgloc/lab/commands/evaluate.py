"""`imgloc evaluate`: how often, how precisely and how fast each method finds known poses."""

import itertools
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from imgloc.cli import options as opt
from imgloc.cli.command import Without
from imgloc.cli.console import emit, say, width
from imgloc.errors import ConfigError, MapError
from imgloc.io.files import display, is_there, map_name
from imgloc.options import (
    ALL_METHODS,
    TOLERANCES,
    Cell,
    Chosen,
    Count,
    Factor,
    Logs,
    Mounting,
    Reach,
    Seed,
    Sensor,
    Tolerance,
)
from imgloc.ranges import option
from imgloc.texts import metres_degrees, names

_MAX_SCANS = 100_000


def evaluate(
    *,
    maps: list[Path] = option(
        ...,
        "Maps: the YAML of map_server, an image with --resolution, or the name of a bundled map.",
        "MAP...",
        parse=lambda path: _map_of(path),
    ),
    sensor: Annotated[Sensor, Without("range_max", "mount")],
    mounting: Mounting,
    reading: opt.MapFrame,
    chosen: Chosen,
    taken: opt.Resources,
    method: tuple[str, ...] = option(
        ALL_METHODS,
        "Localization methods that are measured, with commas between.",
        metavar="NAMES",
        parse=names(ALL_METHODS),
    ),
    count: Count | None = option(
        None, "Scans that are simulated on each map. [default: 100]", "-n", "--count"
    ),
    seed: Seed = 0,
    range_max: Reach | None = None,
    scans: list[Path] | None = option(
        None,
        "Recorded scans with poses, instead of simulated ones; once for each map.",
        metavar="FILE",
    ),
    range_scale: Factor = option(
        1.0, "Metres that 1 stands for in the ranges of recorded scans: 0.001 for millimetres."
    ),
    tolerance: list[Tolerance] | None = option(
        None,
        "Distance in metres and turn in degrees from the true pose up to which an answer is a "
        "hit, beside the usual ones. May be repeated; the last one decides what is wrong.",
        metavar="M,DEG",
        parse=lambda text: Tolerance(*metres_degrees(text)),
    ),
    theta_step: opt.StepOf | None = None,
    cell: Cell = 0.1,
    as_json: opt.AsJson = False,
) -> None:
    """Measure methods on scans whose poses are known: simulated at random, or recorded.

    S is the paper's performance index (eq. 12). It compares the density at the true pose with a
    uniform density: S is the mean logarithm of their ratio. At 0 a method knows nothing; at S max
    it is certain of one cell of a lattice of poses. "S calibrated" is the S of the posterior that
    localize uses (see `imgloc calibrate`). For fused, S is that of Gaussians and may be above
    S max; its S calibrated is on the lattice. "S all cells" includes walls and unknown space. "at
    floor" counts the trials whose density is at most 0.001 of a uniform one; "not free" those whose
    true pose is in a cell that is not free on the map. The paper's methods try a heading every 3
    degrees (cbml, cbml-o, beam) or 30 (ght, ght-v). Only the columns under "cost" differ between
    runs.
    """
    from imgloc.cli import inputs
    from imgloc.io.badlines import warned
    from imgloc.lab.jobs import Evaluate
    from imgloc.lab.tables import evaluation_tables
    from imgloc.model import to_json

    read = inputs.map_files(reading)
    _check_sources(maps, scans, count, chosen, sensor, mounting, range_scale)
    laser: dict[str, Any] = {"range_max": range_max, "mount": mounting.sensor}
    if scans is None:
        sensor = replace(sensor, **{key: value for key, value in laser.items() if value})
    recorded = Logs(scale=range_scale, range_max=range_max)
    jobs = [
        Evaluate(
            method=name,
            theta_step=theta_step,
            cell=cell,
            tolerances=(*TOLERANCES, *(tolerance or ())),
            maps=read,
            scans=inputs.as_recorded(recorded, chosen, Mounting(flipped=mounting.flipped)),
            sensor=sensor,
            count=count or 100,
            seed=seed,
        )
        for name in method
    ]
    table, notes = list[dict[str, Any]](), list[str]()
    with warned(also_printed=True) as said:
        for k, path in enumerate(maps):
            name = map_name(path)
            item = inputs.item_of(path, None if scans is None else scans[k], name)
            desk = inputs.desk_of(**vars(taken))
            # All of them are opened before the first one takes its time.
            for row in itertools.chain.from_iterable([job.open(item, desk) for job in jobs]):
                table.append(row)
                if as_json:
                    emit(to_json(row))
            if scans is not None and not any(map(_works, table[-len(jobs) :])):
                notes += jobs[0].doubts(item, desk)
    if not as_json:
        emit(evaluation_tables(table, width()))
    # Lines that were left out are told once more, below the table.
    for note in [*(text for text, code in said.items() if code in ("broken", "cut")), *notes]:
        say(note)


def _map_of(path: Path) -> Path:
    """A map that is there; a ConfigError for a file of scans, before anything is simulated."""
    from imgloc.io.bags import BAG_ENDINGS
    from imgloc.io.scans import SCAN_ENDINGS

    if path.suffix.lower() in SCAN_ENDINGS and path.suffix.lower() not in BAG_ENDINGS:
        name = display(path)
        raise ConfigError(f"{name} is a file of scans, expected a map: pass --scans {name}")
    found = opt.find_map(path)
    if not is_there(found):
        raise MapError(f"{display(path)}: no such file")
    return found


def _works(row: dict[str, Any]) -> bool:
    """Return whether a method finds most of the poses."""
    return bool(row["success"][-1]["at_1"]["value"] >= 0.5)


def _check_sources(
    maps: Sequence[Path], scans: Sequence[Path] | None, count: int | None, chosen: Chosen,
    sensor: Sensor, mounting: Mounting, range_scale: float,
) -> None:  # fmt: skip
    """Refuse options that would be ignored."""
    n, many, sampled = len(scans or ()), count or 0, chosen.sample is not None
    simulated = {
        "--flipped: expected --scans; simulated sensors are upright": mounting.flipped,
        "--sample: expected --scans to take from; -n is for simulated scans": sampled,
        "--range-scale: expected --scans; simulated ranges are in metres": range_scale != 1,
        "--scans-index: expected --scans to take from": chosen.index is not None,
        f"-n: got {many:,}, expected at most {_MAX_SCANS:,} scans": many > _MAX_SCANS,
    }
    recorded = {
        f"--scans: got {n} for {len(maps)} maps, expected one each": n != len(maps),
        "-n: recorded scans are not simulated; use --sample": count is not None,
        "--scans: options of a simulated sensor do not go with recorded scans": sensor != Sensor(),
        "--sensor: the poses of recorded scans are those of the sensor": mounting.sensor
        is not None,
    }
    for message, wrong in (simulated if scans is None else recorded).items():
        if wrong:
            raise ConfigError(message)
