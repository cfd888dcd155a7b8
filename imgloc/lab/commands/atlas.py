"""`imgloc atlas`: where on a map a single scan is enough."""

import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from imgloc.cli import options as opt
from imgloc.cli.command import Without
from imgloc.cli.console import emit, progress
from imgloc.io.files import display, map_name, write_text_atomic
from imgloc.options import Headings, Options, Seed, Sensor, Spacing
from imgloc.ranges import option

if TYPE_CHECKING:
    from imgloc.model import FloatArray, OccupancyGrid
    from imgloc.runs.opening import Desk

_EACH = 8  # poses that are worth a process


def atlas(
    *,
    map_path: opt.MapPath,
    out: Path = option(..., "Picture that is written.", metavar="PNG"),
    sensor: Annotated[Sensor, Without("outliers", "dropped")],
    csv: Path | None = option(
        None, "Write a row for each pose into this file, too.", metavar="CSV"
    ),
    step: Spacing = 0.5,
    headings: Headings = 4,
    seed: Seed = 0,
    workers: opt.Workers = None,
    memory_budget: opt.MemoryBudget | None = None,
    as_json: opt.AsJson = False,
    force: opt.Force = False,
) -> None:
    """Draw where on this map, for this lidar, a single scan is enough.

    Simulates a scan at each place and heading and locates it without a guess: unique (one pose, the
    right one), ambiguous (several places fit, drawn red), no-match, or wrong (unique, but
    elsewhere). Blue is the darker, the more exact a pose by one scan can be there.

    Examples
    --------
    imgloc atlas office.yaml --out atlas.png
    imgloc atlas office.yaml --out atlas.png --csv atlas.csv --rays 360 --fov-deg 360
    imgloc atlas visibility --out atlas.png --range-max 5 --json
    """
    from imgloc.cli import inputs
    from imgloc.lab.atlas import Spot, as_csv, simulate_at, summarise, survey
    from imgloc.lab.picture import draw_atlas
    from imgloc.lab.tables import atlas_text
    from imgloc.model import plain, to_json
    from imgloc.simulation.scans import fine_image

    inputs.check_target(out, ".png", force=force, inputs=inputs.files_of(map_path))
    inputs.check_target(csv, ".csv", force=force)
    desk = inputs.desk_of(1, opt.fixed_budget(memory_budget))
    grid = desk.grid(map_path, inputs.map_files(), usable=True)
    count = opt.count_threads(workers)
    poses, options = _poses(map_path, grid, desk, sensor, step, headings, count)
    about = {"step": step, "headings": headings, "seed": seed, "sensor": plain(asdict(sensor))}
    scans, spots = simulate_at(grid, poses, sensor, seed, fine_image(map_path, grid)), list[Spot]()
    many = _useful(count, len(scans))
    with progress("atlas", len(scans), lines=False) as advance:
        for spot in survey(grid, scans, options, sigma=sensor.sigma, workers=many):
            spots.append(spot)
            advance()
    title = f"{map_name(map_path)}: is one scan enough? {len(spots):,} scans, {step:g} m apart"
    picture = draw_atlas(grid, spots, step=step, headings=headings, title=title)
    if csv is not None:
        write_text_atomic(csv, as_csv(spots), force=force)
    picture.save(out, force=force)
    summary = summarise(spots, step) | about
    emit(to_json(summary) if as_json else atlas_text(summary))


def _useful(workers: int, poses: int) -> int:
    """The number of processes that is worth starting."""
    return min(workers, max(1, poses // _EACH))


def _poses(
    path: Path, grid: "OccupancyGrid", desk: "Desk", sensor: Sensor, step: float, headings: int,
    workers: int,
) -> "tuple[FloatArray, Options]":  # fmt: skip
    """The poses (N, 3) of an atlas, grid frame, and the options; an error if memory is short."""
    from imgloc.features.budget import poses_bytes
    from imgloc.lab.atlas import AT_ONCE, MOST, TOP, atlas_poses
    from imgloc.pipeline import prepare
    from imgloc.simulation.scans import is_world

    name, (height, width) = display(path), grid.occupied.shape
    sides = (round(cells * grid.resolution / step + 1) for cells in (height, width))
    desk.check(
        poses_bytes(height * width, places := math.prod(sides), MOST),
        f"{name}: {headings} headings at up to {places:,} places on {height} x {width} cells",
        "use a larger `step` or fewer `headings`, crop the map",
    )
    poses = atlas_poses(grid, step, headings, sensor.clearance)
    desk.check_simulation(
        grid, name, len(poses), sensor.rays, world=is_world(path, grid), at_once=AT_ONCE,
        hint="use a larger `step`, crop the map",
    )  # fmt: skip
    options = Options(top=TOP, threads=1, memory_budget=desk.memory_budget)
    there, workers = prepare(grid, name, ready=False), _useful(workers, len(poses))
    desk.check_answer(there, options, name, hint="crop the map", workers=workers)
    return poses, options
