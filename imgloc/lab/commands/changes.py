"""`imgloc map changes`: where a map has aged."""

from pathlib import Path
from typing import Annotated, Any

from imgloc.cli import options as opt
from imgloc.cli.command import Only
from imgloc.cli.console import LOG, emit, say
from imgloc.errors import ConfigError
from imgloc.io.files import display, map_name
from imgloc.options import Logs, Mounting
from imgloc.ranges import option

_SCANS = 300  # of a file


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
    logs: Annotated[Logs, Only("topic", "range_max")],
    mounting: Mounting,
    taken: opt.Resources,
    as_json: opt.AsJson = False,
    kept: opt.Kept,
    force: opt.Force = False,
) -> None:
    """Find where a map has aged: walls that rays pass (gone), surfaces where it has none (new).

    A log with odometry is followed from anywhere; else each scan is located without a guess. Only
    those that are unique count. A change needs 3 scans from 2 places or times, so passers-by are
    not counted. Of a file with more than 300 such scans 300 are taken, evenly spread.
    A scan counts once: one with the same stamp, ranges and angles as another, in a file before, is
    left out.

    Examples
    --------
    imgloc map changes office.yaml run.log --out aged.png
    imgloc map changes office.yaml monday.bag tuesday.bag --update office-mended.yaml
    imgloc map changes office.yaml scans.npz --range-max 20 --json
    """
    import numpy as np

    from imgloc.cli import inputs
    from imgloc.io.maps import save_map
    from imgloc.lab.changes import map_changes
    from imgloc.lab.located import Once, placed
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
    files = inputs.as_recorded(logs, mounting=mounting)
    job = Localize(maps=inputs.map_files(), scans=files)
    grid = desk.grid(map_path, job.maps, usable=True)
    once = Once()
    runs = (job.open(inputs.item_of(map_path, path), desk) for path in scans_paths)
    parts = [placed(run, _SCANS, once) for run in runs]
    scans = [scan for part in parts for scan in part.scans]
    found = map_changes(grid, scans, np.concatenate([part.poses for part in parts]))
    count = sum(part.given for part in parts)
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
    for hint in dict.fromkeys(hint for part in parts for hint in part.hints):
        LOG.warning("%s", hint)
