"""`imgloc map plan`: a map of a floor plan."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from imgloc.cli import options as opt
from imgloc.cli.console import LOG, emit, progress, say
from imgloc.errors import ConfigError, MapError, as_options
from imgloc.io.files import display, is_file
from imgloc.options import PlanWalls
from imgloc.pose import Pose2D
from imgloc.ranges import OneOf, Within, option, require
from imgloc.texts import numbers, pose

if TYPE_CHECKING:
    from imgloc.io.mapyaml import MapYaml
    from imgloc.plans.building import FloorPlan
    from imgloc.plans.masks import Grey

PlanScale = Annotated[float, Within(1e-6, 1, "metres a pixel, or a unit")]


def plan(
    *,
    path: Path = option(
        ...,
        "Floor plan: an image (PNG, JPEG, TIFF ...), or a drawing (DXF, SVG, PDF; pip install "
        "'imgloc[cad]').",
        "PLAN",
    ),
    out: Path = option(
        ...,
        "Map that is written; its image gets the same name with .png. Of a drawing with several "
        "floors the largest one; the others are NAME-2.yaml and so on.",
        "--out",
        "-o",
        metavar="YAML",
    ),
    resolution: PlanScale | None = option(
        None,
        "Side of a pixel of the plan, or unit of a drawing, metres. [default: found by "
        "--distance, or that of a YAML beside the plan; a DXF has it]",
        metavar="M",
    ),
    distance: Any = option(
        None,
        "Two points of the plan, pixels from its upper left corner or units of a drawing, and the "
        "metres between them, such as those of a dimension line: they give the scale.",
        metavar="X1,Y1,X2,Y2,M",
        parse=numbers(5),
    ),
    origin: Pose2D | None = option(
        None,
        "Pose of the plan's lower-left corner, or of a drawing's zero point, in the map frame: "
        "metres, radians (or 90deg). [default: that of a YAML beside the plan, or 0,0,0]",
        metavar="X,Y,YAW",
        parse=pose,
    ),
    drawing: PlanWalls,
    doors: Annotated[str, OneOf("open", "closed", "unknown")] = option(
        "open", "Doors of a drawing are left open, are closed, or are unknown space."
    ),
    walls: str | None = option(
        None,
        "Layers of a drawing that are its walls, with commas between. [default: by their names, "
        "or else by what lines look like]",
        metavar="NAME,...",
    ),
    furniture: bool = option(False, "Keep the furniture of a drawing: its lines are occupied."),
    picture: Path | None = option(
        None,
        "Draw the plan, with what was taken from it in colour, beside the map into this file.",
        metavar="PNG",
    ),
    memory_budget: opt.MemoryBudget | None = None,
    as_json: opt.AsJson = False,
    force: opt.Force = False,
) -> None:  # fmt: skip
    """Make a map of a floor plan: walls as they stand, doors open, nothing else.

    A drawing states what an image only shows: layers, blocks, doors, units. Names of layers and
    blocks are understood in several languages.

    Walls may be filled, two lines, hatched, or single thick lines. Door swings, text, furniture,
    stairs, dimensions and thin lines are taken away, and what is outside becomes unknown. The
    building is the largest space within walls: frames, titles and legends are not part of it.

    Examples
    --------
    imgloc map plan drawing.png --resolution 0.02 --out office.yaml --picture plan-check.png
    imgloc map plan drawing.jpg --distance 210,880,1650,880,24.5 --out office.yaml
    """
    from imgloc.cli import inputs
    from imgloc.io.maps import save_map
    from imgloc.model import to_json
    from imgloc.plans.drawn import drawing_to_maps
    from imgloc.plans.floorplan import STEPS
    from imgloc.plans.picture import draw_floor_plan
    from imgloc.plans.vectors import READERS, read_drawing

    beside, name = _beside(path), display(path)
    read = [path] if beside is None else [path, path.with_suffix(".yaml")]

    def targets(k: int) -> list[Path]:
        """The map of a floor, its image and its picture, which are free."""
        files = [f for f in (out, out.with_suffix(".png"), picture) if f is not None]
        files = [f if k == 1 else f.with_stem(f"{f.stem}-{k}") for f in files]
        for file, ending in zip(files, (".yaml", ".png", ".png"), strict=False):
            inputs.check_target(file, ending, force=force, inputs=read)
        return files

    if len({file.resolve() for file in targets(1)}) == 2 and picture is not None:
        raise ConfigError(f"--picture: {display(picture)} is the image of the map; another name")
    origin = beside.origin if origin is None and beside is not None else origin
    if beside is not None and resolution is None and distance is None:
        resolution = beside.resolution
    is_drawn = path.suffix.lower() in READERS
    other = {"doors": doors != "open", "walls": walls, "furniture": furniture}
    if is_drawn:
        other = vars(drawing) | {"memory-budget": memory_budget, "cell": 0, "thickest": 0, "gap": 0}
    for word in (word for word, value in other.items() if value):
        kind = "an image" if is_drawn else "a drawing: DXF, SVG or PDF"
        raise ConfigError(f"--{word}: {name} is none that has it, expected {kind}; leave it out")
    try:
        if is_drawn:
            if resolution is not None or distance is not None:
                resolution = _scale(name, resolution, distance)
            floors = drawing_to_maps(
                read_drawing(path), resolution=resolution, origin=origin, cell=drawing.cell,
                thickest=drawing.thickest, gap=drawing.gap, doors=doors, furniture=furniture,
                walls=[] if walls is None else walls.split(","),
            )  # fmt: skip
            greys = [255 - 255 * (f.kinds > 0).astype("uint8") for f in floors]
        else:
            with progress("plan", STEPS, lines=False) as advance:
                inverted = True if beside is not None and beside.negate else None
                grey, resolution, found = _pixels(
                    path, resolution, distance, origin, drawing, memory_budget, advance, inverted
                )
            floors, greys = [found], [grey]
    except MapError as error:
        raise MapError(str(error) if name in str(error) else f"{name}: {error}") from None
    # All names are free, or none is written.
    names = [targets(k) for k in range(1, len(floors) + 1)]
    for files, grey, found in zip(names, greys, floors, strict=True):
        save_map(files[0], found.grid, force=force)
        if found.doubt:
            LOG.warning("%s: %s", name, as_options(found.doubt))
        for to in files[2:]:
            draw_floor_plan(grey, found).save(to, force=force)
            say(f"wrote {display(to)}")
        scale, target, image = found.scale[0] or resolution or 0.0, *map(display, files[:2])
        if as_json:
            about = {"path": name, "resolution": scale, "map": target, "image": image}
            emit(to_json(about | found.as_row()))
        else:
            emit(plan_text(name, scale, found, target))


def _pixels(
    path: Path, resolution: float | None, distance: Any, origin: Pose2D | None,
    drawing: PlanWalls, budget: int | None, advance: Callable[[], None], inverted: bool | None,
) -> "tuple[Grey, float, FloorPlan]":  # fmt: skip
    """The image of a plan, its scale and its map."""
    from imgloc.cli import inputs
    from imgloc.io.images import image_size
    from imgloc.plans.files import load_plan
    from imgloc.plans.floorplan import plan_bytes, plan_to_map

    size = image_size(path)
    scale = _scale(display(path), resolution, distance, size.width, size.height)
    what = f"{display(path)}: a plan of {size.width} x {size.height} pixels"
    need = plan_bytes(size.height, size.width, scale, drawing.cell)
    inputs.desk_of(1, opt.fixed_budget(budget)).check(
        need, what, "crop the plan, use a larger --cell"
    )
    with inputs.quiet_libraries():
        grey = load_plan(path)
    found = plan_to_map(
        grey, scale, origin=origin, **vars(drawing), advance=advance, inverted=inverted
    )
    return grey, scale, found


def _scale(
    name: str, resolution: float | None, distance: Sequence[float] | None, *size: float
) -> float:
    """Metres a pixel of a plan, or unit of a drawing, as stated or by two points.

    A ConfigError without either, or with both. `size` is that of an image, pixels.
    """
    from imgloc.plans.files import measured_resolution

    if (resolution is None) == (distance is None):
        raise ConfigError(
            f"{name}: the scale is {'missing' if distance is None else 'given twice'}, expected "
            "--resolution, metres a pixel, or --distance: two points and the metres between them"
        )
    scale = resolution or measured_resolution(distance or (), *size)
    require(PlanScale, scale, "--distance")
    return scale


def _beside(path: Path) -> "MapYaml | None":
    """The YAML beside a plan, as map_server has it, if it is of this image."""
    from imgloc.io.mapyaml import load_map_yaml

    if not is_file(yaml := path.parent / f"{path.stem}.yaml"):
        return None
    found = load_map_yaml(yaml)
    return found if found.image.name == path.name else None


def plan_text(name: str, resolution: float, plan: "FloorPlan", out: str) -> str:
    """Return what was found on a floor plan and what was taken from it."""
    low, median, high = plan.thickness
    doors = "no swings found"
    if plan.doors:
        doors = f"{len(plan.doors)} swings, leaves of {plan.doors[0]:.2f} to {plan.doors[-1]:.2f} m"
    of = f"unit: {plan.scale[1]}" if plan.scale[1] else "pixel"
    rooms = "" if plan.rooms is None else f", {plan.rooms} rooms"
    height, width = plan.grid.info.shape
    corner = plan.grid.origin
    lines = [
        name,
        f"  plan        {resolution:.4g} m a {of}" + (", light on dark" if plan.inverted else ""),
        f"  building    {plan.size[0]:.2f} x {plan.size[1]:.2f} m, {plan.free_area:.1f} m2 "
        f"free{rooms}",
        f"  walls       {plan.walls} pieces, {plan.length:.0f} m; {low:.2f} to {high:.2f} m thick, "
        f"median {median:.2f} m; lines up to {plan.thickest:g} m apart are one wall",
        f"  doors       {doors}; in outer walls openings up to {plan.gap:g} m count as closed",
        "  removed" + ("" if plan.removed else "     nothing"),
        *(f"    {r.kind:<24} {r.count:>5,} {r.area:>8.2f} m2" for r in plan.removed),
        f"  map         {out}: {width:,} x {height:,} cells of {plan.grid.resolution:g} m, "
        f"corner at x {corner.x:g}, y {corner.y:g}",
    ]
    return "\n".join(lines)
