"""`imgloc map changes`: where a map has aged."""

from pathlib import Path
from typing import Any

from imgloc.cli import options as opt
from imgloc.cli.console import LOG, emit, progress, say
from imgloc.io.files import display
from imgloc.options import Chosen, Logs, Mounting, Options
from imgloc.ranges import option

_SCANS = 300  # of a file, unless they are chosen


def changes(
    *,
    map_path: opt.MapPath,
    scans_paths: opt.ScansPaths,
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
    300 are taken, evenly spread, unless --scans-index or --sample chooses.
    """
    from imgloc.answers.diagnose import doubts
    from imgloc.cli import inputs
    from imgloc.features.floor import as_located
    from imgloc.features.scanpoints import evenly
    from imgloc.io.calibration import calibrated
    from imgloc.io.maps import save_map
    from imgloc.io.scanset import ScanSet
    from imgloc.lab.changes import map_changes, sure_poses
    from imgloc.lab.picture import draw_changes
    from imgloc.model import to_json
    from imgloc.output.pictures import Picture
    from imgloc.pipeline import localize

    folder = inputs.kept_in(kept)
    read = inputs.files_of(map_path)
    png = None if update is None else update.with_suffix(".png")
    for path, ending in ((out, ".png"), (update, ".yaml"), (png, ".png")):
        inputs.check_target(path, ending, force=force, inputs=read)
    desk = inputs.desk_of(**vars(taken), cache=folder)
    maps = inputs.map_files(reading)
    grid = desk.grid(map_path, maps, usable=True)
    files = inputs.as_recorded(logs, chosen, mounting)
    some = []
    for path in scans_paths:
        held = list(desk.scans(path, files).scans.scans)
        if chosen == Chosen():
            held = [held[k] for k in evenly(len(held), _SCANS).tolist()]
        some += held
    options = Options(**vars(taken))
    options = calibrated(options, map_path, grid)
    features = desk.features(map_path, maps, options, scans=some)
    answers = []
    with progress("locate", len(some), lines=False) as advance:
        for scan in some:
            answers.append(localize(features, scan, options))
            advance()
    desk.keep(features)
    sure, poses = sure_poses(answers)
    scaled = [as_located(some[k], answers[k].evidence) for k in sure]
    found = map_changes(grid, scaled, poses)
    if out is not None:
        Picture(draw_changes(found)).save(out, force=force)
    if update is not None:
        save_map(update, found.mended, force=force)
    row: dict[str, Any] = {"map": display(map_path), "given": len(some), **found.as_row()}
    emit(to_json(row) if as_json else found.text(display(map_path), len(some)))
    for path in (out, update):
        if path is not None:
            say(f"wrote {display(path)}")
    said = [(answer.verdict, answer.evidence) for answer in answers]
    given = files.given.beside(map_path, grid)
    for hint in doubts(features, ScanSet(tuple(some)), said, options, given):
        if hint.found:  # others lead here
            LOG.warning("%s", hint.text)
