"""What a batch does with a map, or with scans whose poses are known, to measure."""

from dataclasses import replace

from imgloc.lab.atlas import TOP, atlas_poses, simulate_at, survey
from imgloc.lab.atlas import summarise as summarise_atlas
from imgloc.lab.evaluation import evaluate, method_options
from imgloc.options import FUSED, TOLERANCES, Options
from imgloc.runs.jobs import Done, Item, Job, job_options, open_map, open_scans
from imgloc.simulation.scans import fine_image, simulate


def evaluate_item(item: Item, job: Job) -> Done:
    """Measure a method in a map: with the scans of an item, or with simulated ones."""
    ((name, path),) = item.maps
    given = job.options
    step = given.fused.theta_step if given.method == FUSED else given.theta_step
    options = replace(method_options(given.method, step), memory_budget=job.memory_budget)
    # The bytes of the features are part of the row: no others have used them.
    features = open_map(path, job, options, fresh=True)
    known = job_options(job, path, features.grid)
    options = replace(options, calibration=known.calibration)
    if item.scans_path is not None:  # what is simulated in the map has no error of its own
        options = replace(options, shared=known.shared)
    source: dict[str, object] = {"scans": item.scans}
    if item.scans_path is None:
        image = fine_image(path, features.grid)
        scans = simulate(features.grid, job.count, job.seed, job.sensor, image)
        source = {"simulated": job.count, "seed": job.seed}
    else:
        scans, _ = open_scans(item, job)
    row = evaluate(features, scans, options, tolerances=(*TOLERANCES, job.tolerance)).as_row(
        name, source
    )
    del row["parameters"]
    return Done([row], cost={"summary": row.pop("cost")})


def survey_item(item: Item, job: Job) -> Done:
    """Find where on the map of an item one scan is enough."""
    ((_, path),) = item.maps
    options = Options(top=TOP, memory_budget=job.memory_budget)
    features, sensor = open_map(path, job, options), job.sensor
    grid = features.grid
    poses = atlas_poses(grid, job.step, job.headings, sensor.clearance)
    scans = simulate_at(grid, poses, sensor, job.seed, fine_image(path, grid))
    spots = list(survey(grid, scans, options))
    done = Done([summarise_atlas(spots, job.step)])
    done.draw(job, "atlas", True, 0, grid, spots, job.step, job.headings)
    return done
