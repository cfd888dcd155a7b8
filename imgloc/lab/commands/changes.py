"""`imgloc map changes`: where a map has aged."""

from pathlib import Path
from typing import Any

from imgloc.cli import options as opt
from imgloc.cli.console import LOG, emit, say
from imgloc.errors import ConfigError
from imgloc.io.files import display
from imgloc.options import Chosen, Logs, Mounting
from imgloc.ranges import option

_SCANS = 300  # of a file, unless they are chosen


def changes(
    *,
    map_path: opt.MapPath,
    scans_paths: list[Path] = option(
        ..., "Files of scans; - is standard input.", "SCANS...", parse=opt.find_scans
    ),
    out: Path | None = option(
        None, "Draw the map with what is gone and what is new into this file.", metavar="PNG"
    ),
    update: Path | None = option(
        None,
        "Write a mended map: walls that are gone are free, new surfaces are walls. Its image gets "
        "the same name with .png.",
        metavar="YAML",
    ),
    reading: opt.MapFrame,
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
    scans from 2 places or times, so passers-by are not counted. Of a file with more than 300 scans
    300 are taken, evenly spread, unless --scans-index or --sample chooses. A scan counts
    once: one with the same stamp, ranges and angles as another, in a file before, is left out.
    """
    from imgloc.cli import inputs
    from imgloc.features.floor import as_located
    from imgloc.io.files import map_name
    from imgloc.io.maps import save_map
    from imgloc.lab.changes import map_changes, sure_poses
    from imgloc.lab.located import Once, hints_of, open_some
    from imgloc.lab.picture import draw_changes
    from imgloc.model import to_json
    from imgloc.runs.localize import Localize

    folder = inputs.kept_in(kept)
    read = inputs.files_of(map_path)
    png = None if update is None else update.with_suffix(".png")
    if out is not None and png is not None and out.resolve() == png.resolve():
        raise ConfigError(
            f"`out`, `update`: both would write {display(png)}, the image of the mended map; "
            "expected two names"
        )
    for path, ending in ((out, ".png"), (update, ".yaml"), (png, ".png")):
        inputs.check_target(path, ending, force=force, inputs=read)
    desk = inputs.desk_of(**vars(taken), cache=folder)
    files = inputs.as_recorded(logs, chosen, mounting)
    job = Localize(maps=inputs.map_files(reading), scans=files)
    grid = desk.grid(map_path, job.maps, usable=True)
    once = Once()
    runs = [
        open_some(job, inputs.item_of(map_path, path), desk, _SCANS, once) for path in scans_paths
    ]
    located = [one for run in runs for one in run]
    sure, poses = sure_poses([one.of for one in located])
    scans = [as_located(located[k].scan, located[k].of.evidence) for k in sure]
    found, count = map_changes(grid, scans, poses), len(located)
    if out is not None:
        title = f"{map_name(map_path)}: changes by {found.seen.scans} scans with a sure pose"
        draw_changes(found, title).save(out, force=force)
    if update is not None:
        save_map(update, found.mended, force=force)
    row: dict[str, Any] = {"map": display(map_path), "given": count, **found.as_row()}
    emit(to_json(row) if as_json else found.text(display(map_path), count))
    for path in (out, update):
        if path is not None:
            say(f"wrote {display(path)}")
    for hint in hints_of(runs[0], located):
        LOG.warning("%s", hint)
