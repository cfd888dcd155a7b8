"""`imgloc map`: what is in a map, what may be wrong with it, its picture."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from imgloc.cli import options as opt
from imgloc.cli.console import emit, say
from imgloc.cli.options import flag, option
from imgloc.errors import ConfigError, MapError
from imgloc.io.files import display

Subject = StrEnum(
    "Subject", ("MAP", "BMAP", "VMAP", "SURFACE", "VISIBILITY", "DISTANCE", "LIKELIHOOD")
)


@opt.with_options(opt.reading, opt.console)
def check(
    map_path: opt.MapPath,
    reading: "opt.Reading",
    as_json: opt.AsJson = False,
    strict: bool = flag("--strict", "Exit with 3 if there is any warning."),
    memory_budget: opt.MemoryBudget = None,
) -> None:
    """Report what is in a map, and what is likely to be wrong with it.

    A map without walls or without free space is reported, not refused; a file that cannot be read
    exits with 3.
    """
    from imgloc.cli import inputs
    from imgloc.model import to_json
    from imgloc.output.tables import report_text
    from imgloc.runs.check import Check

    desk = inputs.desk_of(1, opt.fixed_budget(memory_budget))
    (answer,) = Check(maps=inputs.one_map(reading)).open(inputs.item_of(map_path), desk)
    emit(to_json(answer.row) if as_json else report_text(answer.of))
    if strict and answer.doubtful:
        raise typer.Exit(MapError.exit_code)


@opt.with_options(opt.reading, opt.console)
def show(
    map_path: opt.MapPath,
    out: Annotated[Path, option(..., "PNG", "Picture to write.", show_default=False)],
    reading: "opt.Reading",
    what: Subject = typer.Option(
        Subject.MAP,
        help="The map as it is read; blurred (bmap); normals, blurred (vmap); surface points "
        "with normals; what one surface point sees; distance to the nearest wall; likelihood of "
        "a scan.",
    ),
    at: Any = option(
        None,
        "X,Y",
        "For visibility: near here, metres, map frame. [default: what sees most]",
        parser=opt.numbers(2),
    ),
    sigma: float | None = option(
        None,
        "M",
        "Blur of bmap and vmap, standard deviation, metres. [default: 0.1]",
        within=(0.001, 100, "metres"),
    ),
    cell: float | None = option(None, "M", "Cell of bmap and vmap, metres.", within=opt.SIDE),
    scans: Path | None = option(None, "SCANS", "For likelihood: the file of the scan."),
    index: opt.Index = None,
    method: opt.MethodName = typer.Option(opt.MethodName.CBML, help="Whose likelihood."),
    memory_budget: opt.MemoryBudget = None,
    force: opt.Force = False,
    allow_lossy: opt.AllowLossy = False,
) -> None:
    """Draw a map, or what is computed from it, into a PNG."""
    import numpy as np

    from imgloc.cli import inputs
    from imgloc.features.mapfeatures import MapFeatures
    from imgloc.geometry import cell_of, in_grid_frame, inside
    from imgloc.io.scanset import Chosen
    from imgloc.likelihoods.stacks import likelihood
    from imgloc.model import Pose2D
    from imgloc.options import Options
    from imgloc.output.pictures import draw

    inputs.check_target(out, ".png", force=force, inputs=inputs.files_of(map_path))
    if (scans is None) == (what == Subject.LIKELIHOOD):
        raise ConfigError("--scans: expected with --what likelihood, and only there")
    if method == opt.MethodName.FUSED:
        raise ConfigError("--method: fused has no likelihood of all poses; use one of the others")
    if at is not None and what != Subject.VISIBILITY:
        raise ConfigError("--at: only --what visibility is drawn at a point")
    for name, value in (("--sigma", sigma), ("--cell", cell)):
        if value is not None and what not in (Subject.BMAP, Subject.VMAP):
            raise ConfigError(f"{name}: only --what bmap and --what vmap are blurred")
    budget = opt.fixed_budget(memory_budget)
    desk, maps = inputs.desk_of(1, budget), inputs.one_map(reading, allow_lossy=allow_lossy)
    grid = desk.grid(map_path, maps, usable=what != Subject.MAP)
    features = MapFeatures(grid, cell=cell or grid.resolution, sigma=sigma or 0.1)
    if at is not None:
        there = in_grid_frame(Pose2D(*at), grid)
        if not inside(cell_of(np.array([there.x, there.y]), grid.resolution), grid.info):
            raise ConfigError(
                f"--at: {at[0]:g},{at[1]:g} is not on the map, expected a point of it"
            )
    if scans is None:
        picture = draw(features, what=what.value, at=at)
    else:
        held = desk.scans(scans, inputs.as_recorded(chosen=Chosen(str(index or 0)))).scans
        options = Options(method=method.value, memory_budget=budget)
        features = desk.features(map_path, maps, options, scans=held.scans)
        picture = draw(grid, likelihood(features, held[0], options))
    picture.save(out, force=force)
    height, width = picture.image.shape[:2]
    say(f"wrote {display(out)}: {what.value}, {width} x {height} pixels")
