"""`imgloc atlas`: where on a map a single scan says where one is."""

from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated

from imgloc.cli import options as opt
from imgloc.cli.console import emit, progress, say
from imgloc.cli.options import option
from imgloc.errors import ConfigError
from imgloc.io.files import display, write_text_atomic


@opt.with_options(opt.sensor, opt.reading, opt.console)
def atlas(
    map_path: opt.MapPath,
    out: Annotated[Path, option(..., "PNG", "Picture to write.", show_default=False)],
    sensor: "opt.Sensor",
    reading: "opt.Reading",
    csv: Path | None = option(None, "CSV", "Write a row for each pose, too."),
    step: float = option(0.5, "M", "Metres between places.", within=(0.02, 1000, "metres")),
    headings: int = option(4, "K", "Headings at each place.", min=1, max=72),
    range_max: opt.Reach = 30.0,
    seed: opt.Seed = 0,
    workers: int | None = option(
        None, "N", "Processes; no result depends on it. [default: all processors]", min=1
    ),
    memory_budget: opt.MemoryBudget = None,
    as_json: opt.AsJson = False,
    force: opt.Force = False,
    allow_lossy: opt.AllowLossy = False,
) -> None:
    """Draw where on this map, for this lidar, a single scan is enough.

    Simulates a scan at each place and heading and locates it without a guess: unique (one pose, the
    right one), ambiguous (several fit; lines lead to the twins), no-match, or wrong (unique, but
    elsewhere). An interrupted run goes on where it stopped: its rows are kept in PNG.part.
    """
    from imgloc.cli import inputs
    from imgloc.features.budget import poses_bytes
    from imgloc.io.cache import cache_key
    from imgloc.lab.atlas import (
        AT_ONCE,
        MOST,
        TOP,
        Spot,
        atlas_poses,
        simulate_at,
        summarise,
        survey,
    )
    from imgloc.lab.atlas_rows import Journal, as_csv
    from imgloc.lab.picture import draw_atlas
    from imgloc.lab.tables import atlas_text
    from imgloc.model import plain, to_json
    from imgloc.options import Options
    from imgloc.output.pictures import Picture
    from imgloc.pipeline import prepare
    from imgloc.simulation.scans import fine_image, is_world

    inputs.check_target(out, ".png", force=force, inputs=inputs.files_of(map_path))
    inputs.check_target(csv, ".csv", force=force)
    budget, name = opt.fixed_budget(memory_budget), display(map_path)
    grid = inputs.load_grid(map_path, budget, allow_lossy=allow_lossy, **reading)
    height, width = grid.occupied.shape
    places = round(height * grid.resolution / step + 1) * round(width * grid.resolution / step + 1)
    inputs.check_memory(
        poses_bytes(height * width, places, headings),
        budget,
        f"{name}: {headings} headings at up to {places:,} places on {height} x {width} cells",
        "use a larger --step or fewer --headings, crop the map",
    )
    poses = atlas_poses(grid, step, headings, sensor.clearance)
    if len(poses) > MOST:
        raise ConfigError(
            f"{name}: {len(poses):,} poses, expected at most {MOST:,}; "
            "use a larger --step or fewer --headings"
        )
    chosen = replace(sensor, range_max=range_max)
    options = Options(top=TOP, threads=1, memory_budget=budget)
    processes = min(opt.count_threads(workers), max(1, len(poses) // 8))
    inputs.check_simulation(
        grid, name, len(poses), sensor.rays, budget,
        world=is_world(map_path, grid), at_once=AT_ONCE, hint="use a larger --step, crop the map",
    )  # fmt: skip
    inputs.check_answer(prepare(grid, name), options, name, hint="crop the map", workers=processes)
    about = {"step": step, "headings": headings, "seed": seed, "sensor": plain(asdict(chosen))}
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
