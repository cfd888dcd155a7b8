"""`imgloc map changes`: where a map has aged."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from imgloc.cli import options as opt
from imgloc.cli.console import LOG, emit, progress, say
from imgloc.errors import ConfigError
from imgloc.io.files import display
from imgloc.options import Chosen, Logs, Mounting, Options
from imgloc.ranges import Option, option

if TYPE_CHECKING:
    from imgloc.answers.diagnose import Given
    from imgloc.lab.batched import Placed
    from imgloc.model import LaserScan
    from imgloc.runs.opening import Desk, MapFiles

_SCANS = 300  # of a file, unless they are chosen


def changes(
    *,
    map_path: opt.MapPath,
    scans_paths: Annotated[
        list[Path],
        Option(
            "Files of scans, or folders of results of imgloc batch; - is standard input.",
            "SCANS|DIR...",
            parse=opt.find_scans,
        ),
    ],
    out: Path | None = option(
        None, "Draw the map with what is gone and what is new into this file.", metavar="PNG"
    ),
    update: Path | None = option(
        None,
        "Write a mended map: walls that are gone are free, new surfaces are walls. Its image gets "
        "the same name with .png.",
        metavar="YAML",
    ),
    reading: opt.MapImages,
    logs: Logs,
    chosen: Chosen,
    mounting: Mounting,
    taken: opt.Resources,
    as_json: opt.AsJson = False,
    kept: opt.Kept,
    force: opt.Force = False,
) -> None:
    """Find where a map has aged: walls that rays pass (gone), surfaces where it has none (new).

    Each scan is located without a guess, and only those that are unique count. A change needs 3
    scans from 2 places or times, so people who walk by are none. Of a file with more than 300 scans
    300 are taken, evenly spread, unless --scans-index or --sample chooses. DIR is a folder of
    results of imgloc batch with its job localize: its poses on MAP are used, nothing is located
    again, and its scans are read as the batch has read them.
    """
    import numpy as np

    from imgloc.cli import inputs
    from imgloc.features.scanpoints import evenly
    from imgloc.io.calibration import calibrated
    from imgloc.io.maps import save_map
    from imgloc.lab.batched import is_batch, read_batch
    from imgloc.lab.changes import map_changes
    from imgloc.lab.picture import draw_changes
    from imgloc.model import LaserScan, to_json
    from imgloc.output.pictures import Picture

    folder = inputs.kept_in(kept)
    read = inputs.files_of(map_path)
    png = None if update is None else update.with_suffix(".png")
    for path, ending in ((out, ".png"), (update, ".yaml"), (png, ".png")):
        inputs.check_target(path, ending, force=force, inputs=read)
    desk = inputs.desk_of(**vars(taken), cache=folder)
    maps = inputs.map_files(reading)
    grid = desk.grid(map_path, maps, usable=True)
    files = inputs.as_recorded(logs, chosen, mounting)
    most = _SCANS if chosen == Chosen() else None
    batches = [path for path in scans_paths if is_batch(path)]
    if batches and (logs, mounting) != (Logs(), Mounting()):
        raise ConfigError(
            f"{display(batches[0])}: its scans are read as imgloc batch has read them; expected no "
            "option for how scans are read"
        )
    placed = [p for path in batches for p in read_batch(path, map_path, maps, desk, chosen, most)]
    some, hints = list[LaserScan](), list[str]()
    for path in scans_paths:
        if path not in batches:
            held = desk.scans(path, files).scans.scans
            some += [held[k] for k in evenly(len(held), most or len(held)).tolist()]
    if not batches or some:
        options = calibrated(Options(**vars(taken)), map_path, grid)
        given = files.given.beside(map_path, grid)
        located, hints = _located(desk, map_path, maps, some, options, given)
        placed.append(located)
    scans = [scan for part in placed for scan in part.scans]
    found = map_changes(grid, scans, np.concatenate([part.poses for part in placed]))
    count = sum(part.given for part in placed)
    if out is not None:
        Picture(draw_changes(found)).save(out, force=force)
    if update is not None:
        save_map(update, found.mended, force=force)
    row: dict[str, Any] = {"map": display(map_path), "given": count, **found.as_row()}
    emit(to_json(row) if as_json else found.text(display(map_path), count))
    for path in (out, update):
        if path is not None:
            say(f"wrote {display(path)}")
    for hint in hints:
        LOG.warning("%s", hint)


def _located(
    desk: "Desk", path: Path, maps: "MapFiles", some: "list[LaserScan]", options: Options,
    given: "Given",
) -> "tuple[Placed, list[str]]":  # fmt: skip
    """Locate scans: those with a sure pose, and what keeps others from it."""
    from imgloc.answers.diagnose import doubts
    from imgloc.features.floor import as_located
    from imgloc.io.scanset import ScanSet
    from imgloc.lab.batched import Placed
    from imgloc.lab.changes import sure_poses
    from imgloc.pipeline import localize

    features = desk.features(path, maps, options, scans=some)
    answers = []
    with progress("locate", len(some), lines=False) as advance:
        for scan in some:
            answers.append(localize(features, scan, options))
            advance()
    desk.keep(features)
    sure, poses = sure_poses(answers)
    said = [(answer.verdict, answer.evidence) for answer in answers]
    found = doubts(features, ScanSet(tuple(some)), said, options, given)
    hints = [hint.text for hint in found if hint.found]  # others lead here
    scans = tuple(as_located(some[k], answers[k].evidence) for k in sure)
    return Placed(len(some), scans, poses), hints
