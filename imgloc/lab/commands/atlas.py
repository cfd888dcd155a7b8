"""`imgloc atlas`: where on a map a single scan says where one is."""

from dataclasses import asdict
from pathlib import Path

from imgloc.cli import options as opt
from imgloc.cli.console import emit, progress, say
from imgloc.errors import ConfigError
from imgloc.io.files import display, map_name, write_text_atomic
from imgloc.options import Headings, MemoryBudget, Seed, Sensor, Spacing
from imgloc.ranges import option


def atlas(
    *,
    map_path: opt.MapPath,
    out: Path = option(..., "Picture that is written.", metavar="PNG"),
    sensor: Sensor,
    reading: opt.MapFrame,
    csv: Path | None = option(
        None, "Write a row for each pose into this file, too.", metavar="CSV"
    ),
    step: Spacing = 0.5,
    headings: Headings = 4,
    seed: Seed = 0,
    workers: opt.Workers = None,
    memory_budget: MemoryBudget | None = None,
    as_json: opt.AsJson = False,
    force: opt.Force = False,
) -> None:
    """Draw where on this map, for this lidar, a single scan is enough.

    Simulates a scan at each place and heading and locates it without a guess: unique (one pose, the
    right one), ambiguous (several places fit, drawn red), no-match, or wrong (unique, but
    elsewhere). An interrupted run goes on where it stopped: its rows are kept in PNG.part.
    """
    from imgloc.cli import inputs
    from imgloc.io.cache import cache_key
    from imgloc.lab.atlas import MOST, Spot, summarise
    from imgloc.lab.atlas_rows import Journal, as_csv
    from imgloc.lab.jobs import Atlas
    from imgloc.lab.picture import draw_atlas
    from imgloc.lab.tables import atlas_text
    from imgloc.model import plain, to_json

    inputs.check_target(out, ".png", force=force, inputs=inputs.files_of(map_path))
    inputs.check_target(csv, ".csv", force=force)
    job = Atlas(
        maps=inputs.map_files(reading),
        sensor=sensor, step=step, headings=headings, seed=seed,
    )  # fmt: skip
    desk = inputs.desk_of(1, opt.fixed_budget(memory_budget))
    found = job.open(inputs.item_of(map_path), desk, workers=opt.count_threads(workers))
    if len(found.poses) > MOST:
        raise ConfigError(
            f"{display(map_path)}: {len(found.poses):,} poses, expected at most {MOST:,}; "
            "use a larger --step or fewer --headings"
        )
    about = {"step": step, "headings": headings, "seed": seed, "sensor": plain(asdict(job.sensor))}
    key = {"map": cache_key(found.grid, about)} | about
    journal = Journal(out.with_name(out.name + ".part"), key)
    if done := len(journal.rows):
        say(f"going on after {done} of {len(found.poses)} poses")
    try:
        with progress("atlas", len(found.poses) - done, lines=False) as advance:
            for spot in found.spots(done):
                journal.add(spot.row)
                advance()
    finally:
        journal.close()
    spots = [Spot.of(row) for row in journal.rows]
    title = f"{map_name(map_path)}: is one scan enough? {len(spots):,} scans, {step:g} m apart"
    picture = draw_atlas(found.grid, spots, step=step, headings=headings, title=title)
    if csv is not None:
        write_text_atomic(csv, as_csv(journal.rows), force=force)
    picture.save(out, force=force)
    journal.remove()
    summary = summarise(spots, step) | about
    emit(to_json(summary) if as_json else atlas_text(summary))
