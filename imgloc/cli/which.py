"""`imgloc which`: which of the maps in a folder a scan is from."""

import re
from pathlib import Path
from typing import Annotated

import typer

from imgloc.cli import options as opt
from imgloc.cli.console import emit, say
from imgloc.cli.options import flag, option
from imgloc.errors import ConfigError
from imgloc.io.files import display

FAILED_ROWS = 5


@opt.with_options(opt.known, opt.reading, opt.logs, opt.taken, opt.console)
def which(
    maps_dir: Annotated[
        Path,
        typer.Argument(
            metavar="MAPS_DIR",
            help="Folder tree of maps: map_server YAML; with --resolution bare images, too.",
        ),
    ],
    known: opt.Known,
    reading: "opt.Reading",
    logs: opt.Logs,
    taken: opt.Resources,
    scans_path: Annotated[
        Path | None,
        typer.Argument(
            metavar="SCANS",
            callback=lambda path: None if path is None else opt.find_scans(path),
            help="Scans, as of localize; none with --build.",
        ),
    ] = None,
    index: Path | None = option(
        None,
        "NPZ",
        "Keep what is looked at of all maps in this file: made if it is not there, and where maps "
        "have changed made anew.",
    ),
    build: bool = flag("--build", "Only make the --index."),
    picture: Path | None = option(
        None, "PNG", "Draw the scan in the best map; several scans: NAME-0003.png and so on."
    ),
    range_max: opt.Cut = None,
    flipped: opt.Flipped = False,
    sure: float = option(
        0.5, "P", "Probability that a map needs to be named.", within=(0.5, 1, "a probability")
    ),
    as_json: opt.AsJson = False,
    no_cache: bool = flag("--no-cache", "Prepare the maps anew and keep nothing of them."),
    force: opt.Force = False,
    allow_lossy: opt.AllowLossy = False,
) -> None:
    """Say which of the maps in a folder each scan is from: one of them, none, or undecided.

    A coarse look at all maps tells which of them the scan can fit; in these it is located.
    Evidence is the likelihood averaged over all poses of a map, so that a large map does not win
    by having more places. It is from none if it fits badly, or, asked of three maps or more, if
    the best fits hardly better than the third best does by chance. Of fewer than five maps, one is
    named only if the scan has a unique place in it. A scan with too few readings is invalid. A map
    that cannot be used is reported and left out; the exit code is then 5.
    """
    from imgloc.choice.choose import names_of
    from imgloc.cli import inputs
    from imgloc.io.folders import find_maps
    from imgloc.model import to_json
    from imgloc.output.pictures import draw
    from imgloc.output.tables import CHOICE_HEADER, choice_line
    from imgloc.runs.jobs import Item
    from imgloc.runs.opening import MapFiles
    from imgloc.runs.which import Which

    _check(known, scans_path, index, build=build)
    if index is not None:
        inputs.check_target(index, ".npz", force=True)  # nothing is replaced but an index
    paths = find_maps(maps_dir, images=reading["resolution"] is not None)
    files = tuple(zip(names_of(paths, maps_dir), paths, strict=True))
    job = Which(
        maps=MapFiles(reading, allow_lossy),
        scans=inputs.as_recorded(logs, range_max, flipped=flipped),
        known=inputs.known_of(known),
        sure=sure,
    )
    folder = inputs.kept_in(None, wanted=not no_cache)
    desk = inputs.desk_of(taken.threads, taken.memory_budget, folder)
    asked = None if scans_path is None else desk.scans(scans_path, job.scans)
    numbers = [] if asked is None else asked.indices
    read = [file for path in paths for file in inputs.files_of(path)]
    targets = inputs.targets(picture, ".png", numbers, force=force, inputs=read)
    found = job.look(Item(display(maps_dir), None, files, scans_path), desk, asked, file=index)
    if build:
        say(f"{display(index or maps_dir)}: {len(found.index.names):,} maps")
    for k, answer in enumerate(found):
        if k == 0 and not as_json:
            emit(CHOICE_HEADER)
        line = choice_line(answer.index, answer.of, answer.fits)
        emit(to_json(answer.row) if as_json else line)
        if answer.index in targets:
            grid = desk.grid(found.files[answer.best], job.maps)
            image = draw(grid, answer.fits[answer.best], answer.scan)
            image.save(targets[answer.index], force=force)
    if found.failed:
        raise typer.Exit(FAILED_ROWS)


def _check(known: opt.Known, scans: Path | None, index: Path | None, *, build: bool) -> None:
    """Refuse options that do not go together."""
    if known.near is not None or known.region is not None:
        said = "--near" if known.near is not None else "--region"
        raise ConfigError(f"{said}: is about one map; of many, --heading or --clearance are known")
    if build and (scans is not None or index is None):
        raise ConfigError("--build: expected --index, which it makes, and no scans")
    if scans is None and not build:
        raise ConfigError("expected scans, or --build with --index")
    if index is not None and re.fullmatch(r"[\d:,]+", str(index)):
        raise ConfigError(
            f"--index: got {index}, expected a name that ends in .npz: here it is of all maps "
            "what is looked at; which takes all scans of a file"
        )
