"""`imgloc map plan`: a map of a floor plan."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from imgloc.cli import options as opt
from imgloc.cli.console import emit, say
from imgloc.cli.options import option
from imgloc.errors import ConfigError, MapError
from imgloc.io.files import display

if TYPE_CHECKING:
    from imgloc.plans.floorplan import FloorPlan

_WALLS = (0.005, 3, "metres")


@opt.with_options(opt.console)
def plan(
    path: Annotated[
        Path, typer.Argument(metavar="PLAN", help="Image of a floor plan: PNG, JPEG, TIFF ...")
    ],
    out: Annotated[
        Path, option(..., "YAML", "Map to write, and its PNG beside it.", "--out", "-o")
    ],
    resolution: float | None = option(
        None, "M", "Metres a pixel of the plan.", within=(0.0005, 1, "metres a pixel")
    ),
    distance: Any = option(
        None,
        "X1,Y1,X2,Y2,M",
        "Or two points of the plan, in pixels from its upper left corner, and the metres between "
        "them: of a dimension line, or the outer walls.",
        parser=opt.numbers(5),
    ),
    origin: Any = opt.pose_of(
        "--origin", "Pose of the plan's lower-left corner in the map frame. [default: 0,0,0]"
    ),
    cell: float | None = option(
        None, "M", "Cell of the map. [default: 0.05, or a pixel]", within=(0.01, 1, "metres")
    ),
    thinnest: float = option(0.07, "M", "Of walls: what is thinner is a line.", within=_WALLS),
    thickest: float = option(
        0.5, "M", "Of walls that are drawn as two lines: what is wider is a room.", within=_WALLS
    ),
    gap: float | None = option(
        None, "M", "Outer doors are no wider. [default: found]", within=(0, 30, "metres")
    ),
    ink: float | None = option(
        None, "P", "Darkness from which on a pixel is ink, 0..1. [default: found]",
        within=(0.01, 0.99, "a share"),
    ),
    picture: Path | None = option(
        None, "PNG", "Draw the plan, what was taken from it in colour, beside the map."
    ),
    memory_budget: opt.MemoryBudget = None,
    as_json: opt.AsJson = False,
    force: opt.Force = False,
) -> None:  # fmt: skip
    """Make a map of a floor plan: walls as they stand, doors open, nothing else.

    Walls may be filled, two lines, hatched, or single thick lines. Door swings, text, furniture,
    stairs, dimensions and thin lines are taken away, and what is outside becomes unknown.
    """
    from imgloc.cli import inputs
    from imgloc.io.images import image_size
    from imgloc.io.maps import save_map
    from imgloc.model import Pose2D, to_json
    from imgloc.plans.files import load_plan, measured_resolution
    from imgloc.plans.floorplan import plan_bytes, plan_to_map
    from imgloc.plans.picture import draw_floor_plan

    png = out.with_suffix(".png")
    for target, ending in ((out, ".yaml"), (png, ".png"), (picture, ".png")):
        inputs.check_target(target, ending, force=force, inputs=[path])
    if picture is not None and picture.resolve() == png.resolve():
        raise ConfigError(f"--picture: {display(picture)} is the image of the map; another name")
    name, budget = display(path), opt.fixed_budget(memory_budget)
    size = image_size(path)
    if (resolution is None) == (distance is None):
        raise ConfigError(
            f"{name}: the scale is {'missing' if distance is None else 'given twice'}, expected "
            "--resolution, metres a pixel, or --distance: two points and the metres between them"
        )
    if resolution is None:
        resolution = measured_resolution(distance, size.width, size.height)
        opt.check_range("--distance", resolution, 0.0005, 1, "metres a pixel")
    what = f"{name}: a plan of {size.width} x {size.height} pixels"
    need = plan_bytes(size.height, size.width, resolution, cell)
    inputs.desk_of(1, budget).check(need, what, "crop the plan, use a larger --cell")
    with inputs.quiet_libraries():
        grey = load_plan(path)
    try:
        found = plan_to_map(
            grey, resolution, origin=None if origin is None else Pose2D(*origin), cell=cell,
            thinnest=thinnest, thickest=thickest, gap=gap, ink=ink,
        )  # fmt: skip
    except MapError as error:
        raise MapError(f"{name}: {error}") from None
    save_map(out, found.grid, force=force)
    if picture is not None:
        draw_floor_plan(grey, found).save(picture, force=force)
    if as_json:
        about = {"path": name, "resolution": resolution, "map": display(out), "image": display(png)}
        emit(to_json(about | found.as_row()))
    else:
        emit(plan_text(name, resolution, found, display(out)))
    if picture is not None:
        say(f"wrote {display(picture)}")


def plan_text(name: str, resolution: float, plan: "FloorPlan", out: str) -> str:
    """Return what was found on a floor plan and what was taken from it."""
    low, median, high = plan.thickness
    doors = "no swings found"
    if plan.doors:
        doors = f"{len(plan.doors)} swings, leaves of {plan.doors[0]:.2f} to {plan.doors[-1]:.2f} m"
    height, width = plan.grid.info.shape
    corner = plan.grid.origin
    lines = [
        name,
        f"  plan        {resolution:.4g} m a pixel" + (", light on dark" if plan.inverted else ""),
        f"  building    {plan.size[0]:.2f} x {plan.size[1]:.2f} m, {plan.free_area:.1f} m2 free",
        f"  walls       {plan.walls} pieces, {plan.length:.0f} m; {low:.2f} to {high:.2f} m thick, "
        f"median {median:.2f} m",
        f"  doors       {doors}; in outer walls openings up to {plan.gap:g} m count as closed",
        "  removed" + ("" if plan.removed else "     nothing"),
        *(f"    {r.kind:<24} {r.count:>5,} {r.area:>8.2f} m2" for r in plan.removed),
        f"  map         {out}: {width:,} x {height:,} cells of {plan.grid.resolution:g} m, "
        f"corner at x {corner.x:g}, y {corner.y:g}",
    ]
    return "\n".join(lines)
