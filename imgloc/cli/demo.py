"""`imgloc demo`: the whole way in one command, without any file."""

import os
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from imgloc.cli.console import LOG, emit
from imgloc.cli.files import check_target
from imgloc.cli.options import (
    Force,
    MemoryBudget,
    Threads,
    console,
    count_threads,
    with_options,
)

if TYPE_CHECKING:
    from imgloc.draw.canvas import Picture
    from imgloc.features.mapfeatures import MapFeatures
    from imgloc.model import LaserScan, Localization, Pose2D
    from imgloc.options import Options

_OUT = Path("imgloc-demo.png")


class DemoMap(StrEnum):
    """The bundled maps; spelled out, as :mod:`imgloc.worlds` loads OpenCV."""

    DOUBLE_WALL = "double_wall"
    VISIBILITY = "visibility"
    LARGE = "large"
    CURVED = "curved"
    CORRIDOR = "corridor"


@with_options(console)
def demo(
    name: Annotated[DemoMap, typer.Option("--map", help="Bundled map.")] = DemoMap.DOUBLE_WALL,
    seed: Annotated[
        int, typer.Option(min=0, metavar="N", help="Seed of the pose and of the noise.")
    ] = 0,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="PNG",
            help="Picture to write. [default: imgloc-demo.png here, or the next free name]",
            show_default=False,
        ),
    ] = None,
    threads: Threads = None,
    memory_budget: MemoryBudget = None,
    force: Force = False,
) -> None:
    """Simulate a scan in a bundled map, localize it, draw the answer.

    The scan has 181 rays over 180 degrees, 2 cm of noise and a reach of 30 m. The picture shows the
    likelihood of CBML, which takes one side of a wall for the other, and the scan at each
    hypothesis of the answer.
    """
    from imgloc.io.maps import bundled_maps

    target = out or _OUT
    maps = bundled_maps()
    if out is not None:
        check_target(out, ".png", force=force, inputs=maps.glob("*.png"))

    import cv2
    import numpy as np

    from imgloc.cli import answers
    from imgloc.cli.budgets import check_answer, check_simulation, fixed_budget
    from imgloc.io.files import display
    from imgloc.io.maps import load_map
    from imgloc.model import Pose2D
    from imgloc.options import Options
    from imgloc.pipeline import localize, prepare
    from imgloc.simulate import simulate_set

    workers = count_threads(threads)
    memory_budget = fixed_budget(memory_budget)
    cv2.setNumThreads(workers)
    path = maps / f"{name.value}.yaml"
    grid = load_map(path)
    options = Options(threads=workers, memory_budget=memory_budget)
    cbml = replace(options, method="cbml")
    features = prepare(grid, name.value, threads=workers)
    hint = "use another --map"
    check_simulation(grid, name.value, 1, 181, memory_budget, hint=hint)
    for each in (options, cbml):
        check_answer(features, each, name.value, hint=hint)
    simulated = simulate_set(grid, 1, seed)
    scan, truth = simulated.scans[0], Pose2D(*np.asarray(simulated.poses)[0])
    answer = localize(features, scan, options)
    LOG.info("map %s, seed %d", display(path), seed)
    emit(answers.as_text(f"map {name.value}, seed {seed}", answer, truth))
    sheet = _sheet(features, scan, answer, truth, cbml)
    emit(f"\npicture: {display(_write(target, sheet, free=out is None, force=force))}")


def _sheet(
    features: "MapFeatures",
    scan: "LaserScan",
    answer: "Localization",
    truth: "Pose2D",
    options: "Options",
) -> "Picture":
    """Draw the likelihood as the paper does, and beside it the answer."""
    from imgloc.cli.pictures import draw_answer, same_height
    from imgloc.draw import draw_likelihood, mosaic
    from imgloc.pipeline import likelihood

    stack = likelihood(features, scan, options)
    pictures = same_height(
        [
            draw_likelihood(stack, grid=features.grid, truth=truth),
            draw_answer(features.grid, scan, answer, truth),
        ]
    )
    captions = (
        "CBML: likelihood of each position at its best heading, black is high; red is the truth",
        f"fused: the scan at each hypothesis; verdict: {answer.verdict}",
    )
    return mosaic(list(zip(captions, pictures, strict=True)), columns=2)


def _write(target: Path, sheet: "Picture", *, free: bool, force: bool) -> Path:
    """Write the picture; with `free` under the next name that is not taken."""
    from imgloc.cli.pictures import free_names, write_picture

    if free and not force:
        target = next(path for path in free_names(target) if not os.path.lexists(path))
    write_picture(target, sheet, force=force)
    return target
