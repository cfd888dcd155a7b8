"""`imgloc evaluate --sequence`: filters along logs whose poses are known."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from imgloc.cli import options as opt
from imgloc.cli.console import LOG, emit, progress, width
from imgloc.io.files import display, map_name
from imgloc.options import Logs, Mounting, Options

if TYPE_CHECKING:
    from imgloc.lab.sequences import Trials
    from imgloc.runs.opening import MapFiles

GRID_CELL = 0.2  # metres: of the grid filter, whose stacks are held whole


def measure_sequences(
    maps: Sequence[Path], logs: Sequence[Path], filters: Sequence[str], trials: "Trials",
    mounting: Mounting, range_max: float | None, taken: opt.Resources,
    read: "MapFiles", as_json: bool,
) -> None:  # fmt: skip
    """Measure each filter on each log, and print a table or rows."""
    from imgloc.cli import inputs
    from imgloc.filters.follow import with_odometry
    from imgloc.io.calibration import calibrated
    from imgloc.lab.sequences import measure
    from imgloc.lab.tables import sequence_row, sequence_tables
    from imgloc.model import to_json

    rows: list[dict[str, Any]] = []
    plain = Options(**vars(taken))
    for given, log in zip(maps, logs, strict=True):
        path = opt.find_map(given)
        name = map_name(path)
        desk = inputs.desk_of(**vars(taken))
        grid = desk.grid(path, read, usable=True)
        options = calibrated(plain, path, grid)
        how = inputs.as_recorded(Logs(range_max=range_max), mounting=mounting)
        scans = desk.scans(log, how).scans
        scans = scans if scans.odom is None else scans.with_odometry(display(log))[0]
        scans, odometry = with_odometry(scans, trials.seed)
        for filter_ in filters:
            cell = GRID_CELL if filter_ == "grid" else 0.1
            features = desk.features(path, read, options, cell=cell, scans=scans.scans)
            with progress(f"{name}: {filter_}", trials.count(scans), lines=False) as advance:
                summary = measure(features, scans, filter_, trials, options, advance=advance)
            LOG.info("%s: %s: %s wrong seconds", name, filter_, summary.wrong)
            about = {"odometry": odometry, "log": display(log), "resets": trials.resets}
            rows.append(sequence_row(name, filter_, summary, about))
            if as_json:
                emit(to_json(rows[-1]))
    if not as_json:
        emit(sequence_tables(rows, width()))
