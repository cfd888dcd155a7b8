"""`imgloc demo`: the whole way in one command, without any file."""

import itertools
import os
from dataclasses import replace
from pathlib import Path
from typing import Annotated

from imgloc.cli import options as opt
from imgloc.cli.console import LOG, emit
from imgloc.io.files import display
from imgloc.options import Options, Seed
from imgloc.ranges import OneOf, option

_OUT = Path("imgloc-demo.png")


# The bundled maps; spelled out, as imgloc.simulation.worlds loads OpenCV.
DEMO_MAPS = ("double_wall", "visibility", "large", "curved", "corridor")


def demo(
    *,
    name: Annotated[str, OneOf(*DEMO_MAPS)] = option(
        "double_wall", "Bundled map in which a scan is simulated.", "--map"
    ),
    seed: Seed = 0,
    out: Path | None = option(
        None,
        "Picture that is written. [default: imgloc-demo.png here, or the next free name]",
        metavar="PNG",
    ),
    force: opt.Force = False,
) -> None:
    """Simulate a scan in a bundled map, localize it, draw the answer.

    The scan has 181 rays over 180 degrees, 2 cm of noise and a reach of 30 m. The picture shows the
    likelihood of CBML, which takes one side of a wall for the other, and the scan at each
    hypothesis of the answer.

    Examples
    --------
    imgloc demo
    imgloc demo --map corridor --seed 4
    """
    import numpy as np

    from imgloc.cli import inputs
    from imgloc.io.maps import bundled_maps, load_map
    from imgloc.likelihoods.stacks import likelihood
    from imgloc.model import Pose2D
    from imgloc.output.pictures import draw, mosaic
    from imgloc.output.tables import answer_text
    from imgloc.pipeline import localize, prepare
    from imgloc.simulation.scans import simulate

    maps = bundled_maps()
    inputs.check_target(out, ".png", force=force, inputs=maps.glob("*.png"))
    path = maps / f"{name}.yaml"
    grid = load_map(path)
    options = Options(threads=opt.count_threads())
    cbml = replace(options, method="cbml")
    features = prepare(grid, name, ready=False, threads=options.threads)
    desk = inputs.desk_of(options.threads, opt.fixed_budget())
    for each in (options, cbml):
        desk.check_answer(features, each, name, hint="use another --map")
    simulated = simulate(grid, 1, seed)
    scan = replace(simulated.scans[0], T_base_laser=None)  # of no robot
    truth = Pose2D(*np.asarray(simulated.poses)[0])
    answer = localize(features, scan, options)
    LOG.info("map %s, seed %d", display(path), seed)
    emit(answer_text(f"map {name}, seed {seed}", answer, truth))
    stack = draw(grid, likelihood(features, scan, cbml), truth=truth)
    where = draw(grid, answer, scan, truth=truth)
    target = out or _OUT
    if out is None and not force:
        names = (_OUT.with_stem(f"{_OUT.stem}-{k}") for k in itertools.count(1))
        target = next(p for p in itertools.chain([_OUT], names) if not os.path.lexists(p))
    mosaic([stack, where], columns=2).save(target, force=force)
    emit(f"\npicture: {display(target)}")
