"""`imgloc map`: what is in a map, what may be wrong with it, its picture."""

from pathlib import Path
from typing import Annotated

import typer

from imgloc.cli import options as opt
from imgloc.cli.command import Without
from imgloc.cli.console import emit, say
from imgloc.errors import ConfigError, MapError
from imgloc.io.files import display, map_name, write_text_atomic
from imgloc.options import METHODS, Chosen, Options
from imgloc.ranges import OneOf, Within, option
from imgloc.texts import numbers

SUBJECTS = ("map", "bmap", "vmap", "surface", "visibility", "distance", "likelihood")


def check(
    *,
    map_path: opt.MapPath,
    reading: Annotated[opt.MapImages, Without("allow_lossy")],
    as_json: opt.AsJson = False,
    strict: bool = option(False, "Exit with code 3 if there is any warning."),
    write: Path | None = option(
        None,
        "Write a YAML that reads the map as it is read here. Only imgloc knows the key semantics.",
        metavar="YAML",
    ),
    memory_budget: opt.MemoryBudget | None = None,
    force: opt.Force = False,
) -> None:
    """Report what is in a map, and what is likely to be wrong with it.

    A map without walls or without free space is reported, not refused; a file that cannot be read
    exits with 3.

    Examples
    --------
    imgloc map check office.yaml
    imgloc map check a.yaml --json
    imgloc map check office.png --resolution 0.05 --negate --write office-read.yaml
    """
    from imgloc.cli import inputs
    from imgloc.io.maps import resolve_settings, yaml_text
    from imgloc.model import to_json
    from imgloc.output.tables import report_text
    from imgloc.runs.check import Check

    inputs.check_target(write, ".yaml", force=force, inputs=inputs.files_of(map_path))
    desk = inputs.desk_of(1, opt.fixed_budget(memory_budget))
    job = Check(maps=inputs.map_files(reading))
    (answer,) = job.open(inputs.item_of(map_path), desk)
    emit(to_json(answer.row) if as_json else report_text(answer.of))
    if write is not None:
        settings = resolve_settings(map_path, **job.maps.reading)
        write_text_atomic(write, yaml_text(settings, write.parent), force=force)
        say(f"wrote {display(write)}")
    if strict and answer.doubtful:
        raise typer.Exit(MapError.exit_code)


def show(
    *,
    map_path: opt.MapPath,
    out: Path = option(..., "Picture that is written.", metavar="PNG"),
    reading: opt.MapSize,
    what: Annotated[str, OneOf(*SUBJECTS)] = option(
        "map",
        "What is drawn: the map as it is read; the blurred map (bmap); its blurred normals "
        "(vmap); surface points with normals; what one surface point sees; the distance to the "
        "nearest wall; the likelihood of a scan.",
    ),
    at: tuple[float, float] | None = option(
        None,
        "Surface point whose view --what visibility draws: the one nearest to this point of the "
        "map frame, metres. [default: the one that sees most]",
        metavar="X,Y",
        parse=numbers(2),
    ),
    scans: Path | None = option(
        None, "File of the scan whose likelihood is drawn.", metavar="SCANS", parse=opt.find_scans
    ),
    scans_index: Annotated[int, Within(0, 1e9, "")] = option(
        0, "Scan of the file whose likelihood is drawn, counted from 0."
    ),
    method: Annotated[str, OneOf(*METHODS)] = option(
        "cbml", "Algorithm of the paper whose likelihood of the scan is drawn."
    ),
    memory_budget: opt.MemoryBudget | None = None,
    force: opt.Force = False,
) -> None:
    """Draw a map, or what is computed from it, into a PNG.

    Examples
    --------
    imgloc map show office.yaml --out office-view.png
    imgloc map show office.yaml --what surface --out normals.png
    imgloc map show office.yaml --what visibility --at 3.5,2 --out fan.png
    imgloc map show office.yaml --what likelihood --scans scan.csv --out where.png
    """
    from imgloc.cli import inputs
    from imgloc.features.mapfeatures import MapFeatures
    from imgloc.likelihoods.stacks import likelihood
    from imgloc.output.pictures import draw

    inputs.check_target(out, ".png", force=force, inputs=inputs.files_of(map_path))
    if (scans is None) == (what == "likelihood"):
        raise ConfigError("--scans: expected with --what likelihood, and only there")
    if at is not None and what != "visibility":
        raise ConfigError("--at: only --what visibility is drawn at a point")
    budget = opt.fixed_budget(memory_budget)
    desk, maps = inputs.desk_of(1, budget), inputs.map_files(reading)
    grid = desk.grid(map_path, maps, usable=what != "map")
    features = MapFeatures(grid, cell=grid.resolution)
    if scans is None:
        picture = draw(features, what=what, at=at)
    else:
        held = desk.scans(scans, inputs.as_recorded(chosen=Chosen(str(scans_index)))).scans
        options = Options(method=method, memory_budget=budget)
        features = desk.features(map_path, maps, options, scans=held.scans)
        title = f"{map_name(map_path)}: {inputs.name_of(scans)}, scan {scans_index}"
        picture = draw(grid, likelihood(features, held[0], options), title=title)
    picture.save(out, force=force)
    height, width = picture.image.shape[:2]
    say(f"wrote {display(out)}: {what}, {width} x {height} pixels")
