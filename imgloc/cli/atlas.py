"""`imgloc atlas`: where on a map a single scan says where one is."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from imgloc.cli.console import emit, progress, say
from imgloc.cli.inputs import (
    check_answer,
    check_memory,
    check_simulation,
    check_target,
    files_of,
    load_grid,
)
from imgloc.cli.options import (
    AllowLossy,
    AsJson,
    Force,
    MapPath,
    MemoryBudget,
    Reach,
    Reading,
    Seed,
    check_range,
    console,
    count_threads,
    fixed_budget,
    reading,
    sensor,
    with_options,
)
from imgloc.errors import ConfigError

if TYPE_CHECKING:
    from imgloc.simulate import Sensor

_MOST = 20_000


@with_options(sensor, reading, console)
def atlas(
    map_path: MapPath,
    out: Annotated[Path, typer.Option(metavar="PNG", help="Picture to write.", show_default=False)],
    sensor: "Sensor",
    reading: Reading,
    csv: Annotated[
        Path | None, typer.Option(metavar="CSV", help="Write a row for each pose, too.")
    ] = None,
    step: Annotated[float, typer.Option(metavar="M", help="Metres between places.")] = 0.5,
    headings: Annotated[
        int, typer.Option(min=1, max=72, metavar="K", help="Headings at each place.")
    ] = 4,
    range_max: Reach = 30.0,
    seed: Seed = 0,
    workers: Annotated[
        int | None,
        typer.Option(
            min=1, metavar="N", help="Processes; no result depends on it. [default: all processors]"
        ),
    ] = None,
    memory_budget: MemoryBudget = None,
    as_json: AsJson = False,
    force: Force = False,
    allow_lossy: AllowLossy = False,
) -> None:
    """Draw where on this map, for this lidar, a single scan is enough.

    Simulates a scan at each place and heading and locates it without a guess: unique (one pose, the
    right one), ambiguous (several fit; lines lead to the twins), no-match, or wrong (unique, but
    elsewhere). An interrupted run goes on where it stopped: its rows are kept in PNG.part.
    """
    check_target(out, ".png", force=force, inputs=files_of(map_path))
    if csv is not None:
        check_target(csv, ".csv", force=force)
    check_range("--step", step, 0.02, 1000, "metres")
    check_range("--range-max", range_max, 0.01, 10_000, "metres")

    from imgloc.atlas import AT_ONCE, TOP, Spot, atlas_poses, simulate_at, summarise, survey
    from imgloc.features.budget import poses_bytes
    from imgloc.io.atlasrows import Journal, as_csv
    from imgloc.io.cache import cache_key
    from imgloc.io.files import display, write_text_atomic
    from imgloc.options import Options
    from imgloc.output.json import to_json
    from imgloc.output.pictures import Picture, draw_atlas
    from imgloc.output.tables import atlas_text
    from imgloc.pipeline import prepare
    from imgloc.simulate import fine_image, is_world

    budget, name = fixed_budget(memory_budget), display(map_path)
    grid = load_grid(map_path, budget, allow_lossy=allow_lossy, **reading)
    height, width = grid.occupied.shape
    places = round(height * grid.resolution / step + 1) * round(width * grid.resolution / step + 1)
    check_memory(
        poses_bytes(height * width, places, headings),
        budget,
        f"{name}: {headings} headings at up to {places:,} places on {height} x {width} cells",
        "use a larger --step or fewer --headings, crop the map",
    )
    poses = atlas_poses(grid, step, headings, sensor.clearance)
    if len(poses) > _MOST:
        raise ConfigError(
            f"{name}: {len(poses):,} poses, expected at most {_MOST:,}; "
            "use a larger --step or fewer --headings"
        )
    chosen = replace(sensor, range_max=range_max)
    options = Options(top=TOP, threads=1, memory_budget=budget)
    processes = min(count_threads(workers), max(1, len(poses) // 8))
    check_simulation(
        grid, name, len(poses), sensor.rays, budget,
        world=is_world(map_path, grid), at_once=AT_ONCE, hint="use a larger --step, crop the map",
    )  # fmt: skip
    check_answer(prepare(grid, name), options, name, hint="crop the map", workers=processes)
    about = {"step": step, "headings": headings, "seed": seed, "sensor": repr(chosen)}
    journal = Journal(out.with_name(out.name + ".part"), {"map": cache_key(grid, about)} | about)
    done = len(journal.rows)
    if done:
        say(f"going on after {done} of {len(poses)} poses")
    processes = min(processes, max(1, (len(poses) - done) // 8))
    scans = simulate_at(grid, poses, chosen, seed, fine_image(map_path, grid))[done:]
    try:
        with progress("atlas", len(scans), lines=False) as advance:
            for spot in survey(grid, scans, options, workers=processes):
                journal.add(spot.row)
                advance()
    finally:
        journal.close()
    spots = [Spot.of(row) for row in journal.rows]
    picture = Picture(draw_atlas(grid, spots, step=step, headings=headings))
    if csv is not None:
        write_text_atomic(csv, as_csv(journal.rows), force=force)
    picture.save(out, force=force)
    journal.remove()
    summary = summarise(spots, step) | about
    emit(to_json(summary) if as_json else atlas_text(summary))
