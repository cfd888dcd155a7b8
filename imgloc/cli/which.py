"""`imgloc which`: which of the maps in a folder a scan is from."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from imgloc.cli import options as opt
from imgloc.cli.console import LOG, emit, progress, say
from imgloc.cli.options import flag, option
from imgloc.errors import ConfigError, MapError
from imgloc.io.files import display

if TYPE_CHECKING:
    from imgloc.model import Localization

FAILED_ROWS = 5


@opt.with_options(opt.logs, opt.resources, opt.console)
def which(
    maps_dir: Annotated[
        Path,
        typer.Argument(metavar="MAPS_DIR", help="Folder with map_server YAML files, at any depth."),
    ],
    scans_path: opt.ScansPath,
    logs: opt.Logs,
    resources: opt.Take,
    range_max: opt.Cut = None,
    flipped: opt.Flipped = False,
    sure: float = option(
        0.5, "P", "Probability that a map needs to be named.", within=(0.5, 1, "a probability")
    ),
    as_json: opt.AsJson = False,
    no_cache: bool = flag("--no-cache", "Prepare the maps anew and keep nothing."),
    allow_lossy: opt.AllowLossy = False,
) -> None:
    """Say which of the maps in a folder each scan is from: one of them, none, or undecided.

    The scan is located in every map. Evidence is the likelihood averaged over all poses of a map,
    so that a large map does not win by having more places. It is from none if it fits badly, or,
    asked of three maps or more, if the best fits hardly better than the third best does by chance.
    Of fewer than five maps, one is named only if the scan has a unique place in it.
    A scan with too few readings is invalid. A map that cannot be used is reported and left out;
    the exit code is then 5.
    """
    from imgloc.choice import choose, find_maps, fit, names_of
    from imgloc.cli import inputs
    from imgloc.model import to_json
    from imgloc.options import Options
    from imgloc.output.tables import CHOICE_HEADER, choice_line
    from imgloc.pipeline import check_options

    taken = resources()
    paths = find_maps(maps_dir)
    recorded = inputs.load_set(scans_path, taken.memory_budget, logs).scans
    scans = [inputs.cut_scan(scan, range_max, flipped=flipped) for scan in recorded]
    options = Options(top=20, threads=taken.threads, memory_budget=taken.memory_budget)
    folder = inputs.kept_in(None, wanted=not no_cache)
    fits: list[dict[str, Localization]] = [{} for _ in scans]
    names, failed = names_of(paths, maps_dir), list[MapError | ConfigError]()
    with progress("which", len(paths) * len(scans), lines=False) as advance:
        for path, name in zip(paths, names, strict=True):
            try:
                grid = inputs.load_grid(
                    path, taken.memory_budget, allow_lossy=allow_lossy, usable=False
                )
                features = inputs.open_features(
                    grid, display(path), folder, options,
                    hint="crop the map", scans=scans, threads=taken.threads,
                )  # fmt: skip
                check_options(features, options)
            except (MapError, ConfigError) as error:
                say(f"left out: {error}")
                failed.append(error)
                continue
            for scan, found in zip(scans, fits, strict=True):
                found[name] = fit(features, scan, options)
                advance()
            inputs.keep_features(features, folder)
            del features  # before the next map's are loaded
            LOG.info("%s: %d scans located", display(path), len(scans))
    if len(failed) == len(paths):
        # Too little memory is no fault of the maps.
        kind = MapError if any(isinstance(e, MapError) for e in failed) else ConfigError
        raise kind(f"{display(maps_dir)}: none of its {len(failed)} maps can be used")
    if not as_json:
        emit(CHOICE_HEADER)
    for k, found in enumerate(fits):
        choice = choose(found, options.trust, sure=sure)
        emit(to_json(choice.as_row(found, k)) if as_json else choice_line(k, choice, found))
    if failed:
        raise typer.Exit(FAILED_ROWS)
