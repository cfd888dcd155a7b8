"""`imgloc atlas`: where on a map a single scan says where one is."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from imgloc.cli.console import emit, progress, say
from imgloc.cli.files import check_target, files_of
from imgloc.cli.options import (
    AllowLossy,
    AsJson,
    Force,
    MapPath,
    MemoryBudget,
    Reading,
    console,
    count_threads,
    reading,
    with_options,
)
from imgloc.cli.sensor import sensor
from imgloc.cli.values import check_range
from imgloc.errors import ConfigError

if TYPE_CHECKING:
    from imgloc.atlas import Spot
    from imgloc.model import FloatArray, LaserScan, OccupancyGrid, Pose2D
    from imgloc.simulate import Sensor

_MOST = 20_000
_AT_ONCE = 1000  # scans that are simulated at a time


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
    range_max: Annotated[
        float, typer.Option(metavar="M", help="Reach of the sensor, metres.")
    ] = 30.0,
    seed: Annotated[int, typer.Option(min=0, metavar="N", help="Seed of everything random.")] = 0,
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

    from imgloc.atlas import TOP, atlas_poses, survey
    from imgloc.cli.answers import to_json
    from imgloc.cli.budgets import (
        check_answer,
        check_picture,
        check_poses,
        check_simulation,
        fixed_budget,
    )
    from imgloc.cli.loading import load_usable
    from imgloc.cli.pictures import write_picture
    from imgloc.draw.atlas import draw_atlas
    from imgloc.io.atlasrows import Journal, as_csv
    from imgloc.io.cache import cache_key
    from imgloc.io.files import display, write_text_atomic
    from imgloc.model import Pose2D
    from imgloc.options import Options
    from imgloc.pipeline import prepare
    from imgloc.simulate import is_world

    memory_budget = fixed_budget(memory_budget)
    grid = load_usable(map_path, memory_budget, allow_lossy=allow_lossy, **reading)
    check_poses(grid, display(map_path), step, headings, memory_budget)
    poses = atlas_poses(grid, step, headings, sensor.clearance)
    if len(poses) > _MOST:
        raise ConfigError(
            f"{display(map_path)}: {len(poses):,} poses, expected at most {_MOST:,}; "
            "use a larger --step or fewer --headings"
        )
    chosen = replace(sensor, range_max=range_max)
    name, features = display(map_path), prepare(grid, display(map_path))
    options = Options(top=TOP, threads=1, memory_budget=memory_budget)
    processes = min(count_threads(workers), max(1, len(poses) // 8))
    check_simulation(
        grid, name, len(poses), sensor.rays, memory_budget,
        world=is_world(map_path, grid), at_once=_AT_ONCE, hint="use a larger --step, crop the map",
    )  # fmt: skip
    check_answer(features, options, name, hint="crop the map", workers=processes)
    check_picture(features, "map", name, memory_budget, marks=len(poses))
    about = {"step": step, "headings": headings, "seed": seed, "sensor": repr(chosen)}

    def pose_of(values: Sequence[object]) -> Pose2D:
        x, y, theta = (float(str(v)) for v in values)
        return Pose2D(x, y, theta)

    journal = Journal(out.with_name(out.name + ".part"), {"map": cache_key(grid, about)} | about)
    done = len(journal.rows)
    if done:
        say(f"going on after {done} of {len(poses)} poses")
    processes = min(processes, max(1, (len(poses) - done) // 8))
    scans = _scans(map_path, grid, poses, chosen, seed)[done:]
    try:
        with progress("atlas", len(scans), lines=False) as advance:
            for spot in survey(grid, scans, options, workers=processes):
                journal.add(_row(spot))
                advance()
    finally:
        journal.close()
    rows = journal.rows
    kinds = [str(row[3]) for row in rows]
    picture = draw_atlas(
        grid,
        [pose_of(row[:3]) for row in rows],
        kinds,
        [None if row[7] is None else pose_of(row[7:10]) for row in rows],
        step=step,
        headings=headings,
    )
    if csv is not None:
        write_text_atomic(csv, as_csv(rows), force=force)
    write_picture(out, picture, force=force)
    journal.remove()
    emit(to_json(_numbers(rows, about)) if as_json else _text(rows, about))


def _scans(
    path: Path, grid: "OccupancyGrid", poses: "FloatArray", sensor: "Sensor", seed: int
) -> "list[tuple[Pose2D, LaserScan]]":
    """A simulated scan at each pose, grid frame."""
    import numpy as np

    from imgloc.model import LaserScan, Pose2D
    from imgloc.simulate import fine_image, ray_angles, refine_grid, simulate

    fine = fine_image(path, grid) or refine_grid(grid)
    angles = ray_angles(sensor.rays, sensor.fov)
    ranges = np.concatenate(
        [
            simulate(
                fine, part, angles, sigma=sensor.sigma, range_max=sensor.range_max,
                seed=seed + k, outliers=sensor.outliers, dropped=sensor.dropped,
            )
            for k, part in enumerate(np.array_split(poses, -(-len(poses) // _AT_ONCE)))
        ]
    )  # fmt: skip
    return [
        (Pose2D(*pose), LaserScan(r, angles, range_max=sensor.range_max))
        for pose, r in zip(poses, ranges, strict=True)
    ]


def _row(spot: "Spot") -> list[object]:
    twin = (None,) * 3 if spot.twin is None else (spot.twin.x, spot.twin.y, spot.twin.theta)
    pose = spot.pose
    return [
        pose.x, pose.y, pose.theta, spot.kind, spot.mass, spot.error, spot.turn, *twin,
        spot.twin_mass,
    ]  # fmt: skip


def _numbers(rows: Sequence[Sequence[object]], about: dict[str, object]) -> dict[str, object]:
    """Shares of the poses, and of the places: of the free area."""
    from imgloc.atlas import KINDS
    from imgloc.evaluate import share

    places: dict[tuple[object, object], list[bool]] = {}
    for row in rows:
        places.setdefault((row[0], row[1]), []).append(row[3] == "unique")
    return {
        "poses": len(rows),
        "places": len(places),
        "area": len(places) * float(str(about["step"])) ** 2,
        **{kind: vars(share(row[3] == kind for row in rows)) for kind in KINDS},
        "unique_area": vars(share(all(flags) for flags in places.values())),
        **about,
    }


def _text(rows: Sequence[Sequence[object]], about: dict[str, object]) -> str:
    found = _numbers(rows, about)
    lines = [f"{found['poses']} poses at {found['places']} places, {found['area']:.1f} m²"]
    for key, words in (
        ("unique", "one scan is enough"),
        ("unique_area", "whatever the heading (share of the free area)"),
        ("ambiguous", "several places fit"),
        ("no-match", "not recognized"),
        ("wrong", "wrong, but sure"),
    ):
        s = found[key]
        assert isinstance(s, dict)
        lines.append(
            f"{100 * s['value']:6.1f} % [{100 * s['low']:.1f}, {100 * s['high']:.1f}]  {words}"
        )
    return "\n".join(lines)
