"""`imgloc which`: which of the maps in a folder a scan is from."""

from pathlib import Path
from typing import Annotated

import typer

from imgloc.cli import options as opt
from imgloc.cli.command import Only, Without
from imgloc.cli.console import FAILED_ROWS, LOG, emit, say
from imgloc.errors import ConfigError
from imgloc.io.files import display
from imgloc.options import NAMED, Known, Mounting, Sure
from imgloc.ranges import option


def which(
    *,
    maps_dir: Path = option(
        ...,
        "Folder tree of maps: map_server YAML; with --resolution also images without one.",
        "MAPS_DIR",
    ),
    known: Annotated[Known, Without("near", "sd")],
    reading: opt.MapSize,
    logs: opt.LogTaken,
    taken: opt.Resources,
    scans_path: Path | None = option(
        None,
        f"{opt.SCANS} Without any the file of --maps-index is made.",
        "SCANS",
        parse=opt.find_scans,
    ),
    maps_index: Path | None = option(
        None,
        "Keep the coarse look at all maps in this file, for the next run: it is made if it is "
        "not there, and made anew for maps that have changed.",
        metavar="NPZ",
    ),
    picture: Path | None = option(
        None,
        "Draw the scan in the best map into this file; of several scans into NAME-0003.png and "
        "so on.",
        metavar="PNG",
    ),
    mounting: Annotated[Mounting, Only("flipped")],
    sure: Sure = NAMED,
    as_json: opt.AsJson = False,
    kept: opt.Kept,
    force: opt.Force = False,
) -> None:
    """Say which of the maps in a folder each scan is from: one of them, none, or undecided.

    A coarse look at all maps shows which of them the scan can fit; in these it is located.
    Evidence is the likelihood averaged over all poses of a map, so that a large map does not win
    by having more places. The answer is none if the scan fits badly. With three maps or more
    it is also none if the best fits hardly better than the third. Of fewer than five maps, one is
    named only if the scan has a unique place in it. A scan with too few readings is invalid. A map
    that cannot be used is reported and left out; the exit code is then 5.

    Examples
    --------
    imgloc which floors scans.npz
    imgloc which floors scan.csv --range-max 20 --heading 90deg --json
    imgloc which sites --maps-index sites.npz
    imgloc which sites scans.npz --maps-index sites.npz --picture where.png
    """
    from imgloc.cli import inputs
    from imgloc.model import to_json
    from imgloc.output.pictures import draw
    from imgloc.output.tables import CHOICE_HEADER, choice_line
    from imgloc.runs.jobs import Item
    from imgloc.runs.which import Named, Which

    if scans_path is None and maps_index is None:
        raise ConfigError("expected scans, or --maps-index, a file to make of the maps")
    if maps_index is not None:
        inputs.check_target(maps_index, ".npz", force=True)  # nothing is replaced but an index
    maps = inputs.maps_in(maps_dir, reading)
    job = Which(
        maps=inputs.map_files(reading, many=True),
        scans=inputs.as_recorded(logs, mounting=mounting),
        known=known,
        sure=sure,
    )
    desk = inputs.desk_of(**vars(taken), cache=inputs.kept_in(kept))
    asked = None if scans_path is None else desk.scans(scans_path, job.scans)
    numbers = [] if asked is None else asked.indices
    read = [file for path in maps.values() for file in inputs.files_of(path)]
    targets = inputs.targets(picture, ".png", numbers, force=force, inputs=read)
    item = Item(display(maps_dir), None, tuple(maps.items()), scans_path)
    found = job.look(item, desk, asked, file=maps_index)
    if asked is None:
        say(f"{display(maps_index or maps_dir)}: {len(found.index.names):,} maps")
    answers = list[Named]()
    for k, answer in enumerate(found):
        answers.append(answer)
        if k == 0 and not as_json:
            emit(CHOICE_HEADER)
        line = choice_line(answer.index, answer.of, answer.fits)
        emit(to_json(answer.row) if as_json else line)
        if answer.index in targets:
            grid = desk.grid(found.files[answer.best], job.maps)
            title = f"{answer.best}: {asked.name if asked else ''}, scan {answer.index}"
            image = draw(grid, answer.fits[answer.best], answer.scan, title=title)
            image.save(targets[answer.index], force=force)
    for hint in found.doubts(answers):
        LOG.warning("%s", hint.said)
    if found.failed:
        raise typer.Exit(FAILED_ROWS)
