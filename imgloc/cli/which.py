"""`imgloc which`: which of the maps in a folder a scan is from."""

import contextlib
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from imgloc.cli import options as opt
from imgloc.cli.console import LOG, emit, progress, say
from imgloc.cli.options import flag, option
from imgloc.errors import ConfigError, ImglocError, MapError
from imgloc.io.files import display

if TYPE_CHECKING:
    from imgloc.choice.choose import Opened
    from imgloc.features.mapfeatures import MapFeatures

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
    from imgloc.choice.choose import FIRST, OPTIONS, bounds_of, choose, names_of, search
    from imgloc.choice.folder_index import open_index
    from imgloc.cli import inputs
    from imgloc.io.calibration import calibrated
    from imgloc.io.folders import find_maps
    from imgloc.io.maps import reading_of
    from imgloc.model import to_json
    from imgloc.options import Prior
    from imgloc.output.pictures import draw
    from imgloc.output.tables import CHOICE_HEADER, choice_line
    from imgloc.search.asked import check_options
    from imgloc.search.priors import leaves_none

    if known.near is not None or known.region is not None:
        said = "--near" if known.near is not None else "--region"
        raise ConfigError(f"{said}: is about one map; of many, --heading or --clearance are known")
    if build and (scans_path is not None or index is None):
        raise ConfigError("--build: expected --index, which it makes, and no scans")
    if scans_path is None and not build:
        raise ConfigError("expected scans, or --build with --index")
    if index is not None:  # of what is there, nothing is replaced but an index
        if re.fullmatch(r"[\d:,]+", str(index)):
            raise ConfigError(
                f"--index: got {index}, expected a name that ends in .npz: here it is of all maps "
                "what is looked at; which takes all scans of a file"
            )
        inputs.check_target(index, ".npz", force=True)
    budget = taken.memory_budget
    paths = find_maps(maps_dir, images=reading["resolution"] is not None)
    files = dict(zip(names_of(paths, maps_dir), paths, strict=True))
    recorded = () if scans_path is None else inputs.load_set(scans_path, budget, logs).scans
    scans = [inputs.cut_scan(scan, range_max, flipped=flipped) for scan in recorded]
    targets = inputs.numbered(picture, range(len(scans)))
    for path in targets.values():
        read = [file for map_path in paths for file in inputs.files_of(map_path)]
        inputs.check_target(path, ".png", force=force, inputs=read)
    options = replace(OPTIONS, threads=taken.threads, memory_budget=budget)
    folder = inputs.kept_in(None, wanted=not no_cache)

    failed: dict[str, ImglocError] = {}

    def leave_out(name: str, error: ImglocError) -> None:
        say(f"left out: {error}")
        failed[name] = error

    def prepare(path: Path) -> "MapFeatures":
        grid = inputs.load_grid(
            path, budget, allow_lossy=allow_lossy, usable=False, **reading_of(path, reading)
        )
        return inputs.open_features(
            grid, display(path), folder, options,
            hint="crop the map", scans=scans, threads=taken.threads,
        )  # fmt: skip

    about = f"{sorted(reading.items())} {allow_lossy}"
    with progress("prepare", len(files)) as advance:
        found, errors = open_index(
            files, prepare, about=about, file=index, memory_budget=budget, advance=advance
        )
    for name, error in errors.items():
        leave_out(name, error)

    @contextlib.contextmanager
    def open_map(name: str) -> "Iterator[Opened | None]":
        try:
            features = prepare(files[name])
            prior = inputs.prior_of(known, features.grid)
            here = calibrated(replace(options, prior=prior), files[name], features.grid)
            if leaves_none(prior, features):
                LOG.info("%s: has no place for the robot", display(files[name]))
                yield None
                return
            check_options(features, here)
        except (MapError, ConfigError) as error:
            leave_out(name, error)
            yield None
            return
        yield features, here
        inputs.keep_features(features, folder)

    coarse = replace(options, prior=Prior(None, known.heading))
    bounds = [bounds_of(found, files, scan, coarse) for scan in scans]
    with progress("which", len(scans) * min(FIRST, len(files)), lines=False) as advance:
        fits = search(scans, bounds, open_map, advance)
    if len(failed) == len(files):
        # Too little memory is no fault of the maps.
        kind = MapError if any(isinstance(e, MapError) for e in failed.values()) else ConfigError
        raise kind(f"{display(maps_dir)}: none of its {len(failed)} maps can be used")
    if build:
        say(f"{display(index or maps_dir)}: {len(found.names):,} maps")
    elif not all(fits):
        raise ConfigError("--clearance: no map has a place in which the robot can be")
    if scans and not as_json:
        emit(CHOICE_HEADER)
    for k, (scan, some) in enumerate(zip(scans, fits, strict=True)):
        choice = choose(some, options.trust, sure=sure, ruled_out=len(found.names) - len(some))
        best = next(iter(choice.probability))
        emit(to_json(choice.as_row(some, k)) if as_json else choice_line(k, choice, some))
        if k in targets:
            path = files[best]
            grid = inputs.load_grid(
                path, budget, allow_lossy=allow_lossy, **reading_of(path, reading)
            )
            draw(grid, some[best], scan).save(targets[k], force=force)
    if failed:
        raise typer.Exit(FAILED_ROWS)
