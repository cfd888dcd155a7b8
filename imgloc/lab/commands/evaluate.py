"""`imgloc evaluate`: how often, how precisely and how fast each method finds known poses."""

from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from imgloc.cli import options as opt
from imgloc.cli.command import Given, Only
from imgloc.cli.console import LOG, emit, progress, say, width
from imgloc.errors import ConfigError, MapError, ScanError
from imgloc.io.files import display, is_there, map_name
from imgloc.options import ALL_METHODS, TOLERANCES, Cell, Chosen, Logs, Seed, Sensor, StepOf
from imgloc.ranges import Within, option
from imgloc.texts import names

if TYPE_CHECKING:
    from imgloc.io.scanset import ScanSet
    from imgloc.model import OccupancyGrid
    from imgloc.runs.opening import Desk, ScanFiles

_SIMULATED, _RECORDED = "evaluate without --scans", "evaluate --scans"
#: Of which of the two options are that the other would not notice.
_OF = {
    **dict.fromkeys(("-n", "--count", "--seed"), (_SIMULATED,)),
    **dict.fromkeys(("--scans-index", "--sample"), (_RECORDED,)),
}


def evaluate(
    *,
    given: Given,
    reading: opt.MapSize,
    maps: list[Path] = option(
        ...,
        "Maps: the YAML of map_server, an image with --resolution, or the name of a bundled map.",
        "MAP...",
        parse=lambda path: _map_of(path),
    ),
    chosen: Chosen,
    logs: Annotated[Logs, Only("range_max")],
    taken: opt.Resources,
    method: tuple[str, ...] = option(
        ALL_METHODS,
        "Localization methods that are measured, with commas between.",
        metavar="NAMES",
        parse=names(ALL_METHODS),
    ),
    count: Annotated[int, Within(1, 100_000, "")] = option(
        100, "Scans that are simulated on each map.", "-n", "--count"
    ),
    seed: Seed = 0,
    scans: list[Path] | None = option(
        None,
        "Scans with poses, as imgloc simulate or a recording has them; once for each map. "
        "[default: scans that are simulated here]",
        metavar="FILE",
    ),
    tolerance: opt.ToleranceOf = TOLERANCES[-1],
    theta_step: StepOf | None = None,
    cell: Cell = 0.1,
    as_json: opt.AsJson = False,
) -> None:
    """Measure methods on scans whose poses are known: simulated at random, or recorded.

    S is the paper's performance index (eq. 12). It compares the density at the true pose with a
    uniform density: S is the mean logarithm of their ratio. At 0 a method knows nothing; at S max
    it is certain of one cell in a lattice of poses. "S calibrated" is the S of the posterior that
    localize uses (see `imgloc calibrate`). For fused, S is that of Gaussians and may be above
    S max; its S calibrated is on the lattice. "S all cells" includes walls and unknown space. "at
    floor" counts the trials whose density is at most 0.001 of a uniform one; "not free" those whose
    true pose is in a cell that is not free on the map. The paper's methods try a heading every 3
    degrees (cbml, cbml-o, beam) or 30 (ght, ght-v). Only the columns under "cost" differ between
    runs. Scans that are simulated here reach 30 m, or --range-max.

    Examples
    --------
    imgloc evaluate curved visibility large --method cbml,cbml-o,ght,ght-v,beam
    imgloc evaluate office.yaml -n 50 --method fused --range-max 10 --tolerance 0.3,10
    imgloc evaluate office.yaml --scans scans.npz --sample 60 --json > results.jsonl
    imgloc evaluate a.yaml b.yaml --scans a.npz --scans b.npz --method fused,ght-v
    imgloc evaluate curved --method ght,ght-v --theta-step-deg 10 --cell 0.2
    """
    from imgloc.cli import inputs
    from imgloc.io.badlines import warned
    from imgloc.io.calibration import calibrated
    from imgloc.lab import evaluation
    from imgloc.lab.tables import evaluation_tables
    from imgloc.model import to_json

    read = inputs.map_files(reading)
    opt.refuse_others(given, _OF, {_SIMULATED if scans is None else _RECORDED})
    if scans is not None and len(scans) != len(maps):
        raise ConfigError(f"--scans: got {len(scans)} for {len(maps)} maps, expected one each")
    sensor = Sensor() if logs.range_max is None else Sensor(range_max=logs.range_max)
    how = inputs.as_recorded(logs, chosen)
    table = list[dict[str, Any]]()
    with warned(also_printed=True) as said:
        for k, path in enumerate(maps):
            desk, name = inputs.desk_of(**vars(taken)), map_name(path)
            grid = desk.grid(path, read, usable=True)
            file = None if scans is None else scans[k]
            if file is None:
                trials, source = _simulated(path, grid, sensor, count, seed, desk)
            else:
                trials, source = _recorded(file, how, desk)
            plans = []  # all of them are checked before the first one takes its time
            for one in method:
                plan = replace(evaluation.method_options(one, theta_step), **vars(taken))
                known = calibrated(plan, path, grid)
                if file is None:  # scans simulated in the map have no error of its scale
                    known = replace(known, shared=plan.shared)
                # What one method makes of the map is not held while another is measured.
                features = desk.features(
                    path, read, known, cell=cell, scans=trials.scans, fresh=True
                )
                plans.append((known, features))
            rows = []
            while plans:
                known, features = plans.pop(0)
                with progress(f"{name}: {known.method}", len(trials), lines=False) as advance:
                    found = evaluation.evaluate(
                        features, trials, known,
                        tolerances=tuple(dict.fromkeys((*TOLERANCES, tolerance))),
                        advance=advance,
                    )  # fmt: skip
                LOG.info("%s: %s: S %.2f", name, known.method, found.summary.index.value)
                rows.append(found.as_row(name, {"map": display(path), **source}))
                if as_json:
                    emit(to_json(rows[-1]))
            table += rows
    if not as_json:
        emit(evaluation_tables(table, width()))
    # Lines that were left out are told once more, below the table.
    for note in (text for text, code in said.items() if code in ("broken", "cut")):
        say(note)


def _simulated(
    path: Path, grid: "OccupancyGrid", sensor: Sensor, count: int, seed: int, desk: "Desk"
) -> "tuple[ScanSet, dict[str, Any]]":
    """Scans simulated in a map, and their source."""
    from imgloc.simulation.scans import fine_image, is_world, simulate

    world = is_world(path, grid)  # in a bundled map rays meet its true walls, not its cells
    desk.check_simulation(grid, display(path), count, sensor.rays, world=world)
    trials = simulate(grid, count, seed, sensor, fine_image(path, grid))
    return trials, {"seed": seed, "sensor": asdict(sensor)}


def _recorded(path: Path, how: "ScanFiles", desk: "Desk") -> "tuple[ScanSet, dict[str, Any]]":
    """Scans of a file, and their source; a ScanError if their poses are not known."""
    taken = desk.scans(path, how)
    if taken.scans.poses is None:
        raise ScanError(f"{taken.name}: no poses; expected the true pose of each scan")
    chosen = how.chosen
    source: dict[str, Any] = {"scans": taken.name, "sample": chosen.sample}
    source |= {"sample_seed": chosen.seed, "range_max": how.range_max}
    return taken.scans, source | ({} if chosen.index is None else {"index": chosen.index})


def _map_of(path: Path) -> Path:
    """A map that is there; a ConfigError for a file of scans, before anything is simulated."""
    from imgloc.io.bags import BAG_ENDINGS
    from imgloc.io.scans import SCAN_ENDINGS

    if path.suffix.lower() in SCAN_ENDINGS and path.suffix.lower() not in BAG_ENDINGS:
        name = display(path)
        raise ConfigError(f"{name} is a file of scans, expected a map: pass --scans {name}")
    found = opt.find_map(path)
    if not is_there(found):
        raise MapError(f"{display(path)}: no such file")
    return found
