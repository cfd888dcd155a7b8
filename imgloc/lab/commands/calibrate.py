"""`imgloc calibrate`: what evidence is worth in a map, and what error all its readings share."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from imgloc.cli import options as opt
from imgloc.cli.command import Given, Only
from imgloc.cli.console import LOG, emit, progress, say
from imgloc.errors import ConfigError
from imgloc.io.files import display
from imgloc.options import METHODS, Cell, Chosen, Logs, Mounting, Options, Seed, Sensor, StepOf
from imgloc.ranges import Within, option
from imgloc.texts import names

if TYPE_CHECKING:
    from imgloc.lab.calibrate import CalibrationFit
    from imgloc.model import OccupancyGrid
    from imgloc.runs.opening import Desk, MapFiles, ScanFiles


_SIMULATED, _RECORDED = "calibrate without --scans", "calibrate --scans"
#: Of which of the two options are that the other would not notice.
_OF = {
    **dict.fromkeys(("--rays", "--method", "-n", "--count", "--seed"), (_SIMULATED,)),
    **dict.fromkeys(("--theta-step-deg", "--cell"), (_SIMULATED,)),
    "--scans-index": (_RECORDED,),
}


def calibrate(
    *,
    maps: list[Path] = option(
        ...,
        "Maps: the YAML of map_server, an image with --resolution, or the name of a bundled map; "
        "several share one fit.",
        "MAP...",
    ),
    given: Given,
    reading: opt.MapSize,
    sensor: Annotated[Sensor, Only("rays")],
    chosen: Annotated[Chosen, Only("index")],
    logs: Annotated[Logs, Only("fov", "range_max")],
    mounting: Annotated[Mounting, Only("sensor")],
    taken: opt.Resources,
    scans: list[Path] | None = option(
        None,
        "Recorded scans: fit the scale of the map, and the thickness and faces of its walls, by "
        "them. May be repeated.",
        metavar="FILE",
    ),
    method: tuple[str, ...] = option(
        tuple(METHODS),
        "Algorithms of the paper that are fitted, with commas between.",
        metavar="NAMES",
        parse=names(list(METHODS)),
    ),
    count: Annotated[int, Within(1, 10_000, "")] = option(
        30, "Scans that are simulated on each map.", "-n", "--count"
    ),
    seed: Seed = 1000,
    theta_step: StepOf | None = None,
    cell: Cell = 0.1,
    dry_run: bool = option(False, "Print the fit, and store nothing."),
    as_json: opt.AsJson = False,
    force: opt.Force = False,
) -> None:
    """Fit the methods to a map, or with --scans the map's scale and walls to recorded scans.

    The results go into MAP.calibration.json, beside the map. localize and evaluate read that file
    and otherwise use defaults. With --force the file keeps what it has about other methods.

    Without --scans: a blur in x, y and theta and an exponent turn the votes or log-likelihoods of
    a method into probabilities. imgloc simulates scans and takes the blur and the exponent with
    the greatest S (eq. 12). They cover 180 degrees, or --fov-deg, and reach 30 m, or --range-max.

    With --scans, whose poses need not be known, imgloc finds three things: the factor by which all
    readings are too long or too short for the map; by how much the map draws its walls too thick,
    as floor plans do; and how far behind the border of the walls readings end (0 on a sharp map,
    some centimetres on a map made from scans). The method fused then starts from these.

    If others drew the map and no scan fits by itself, give scans with odometry. Together they show
    how thick and how bent the walls are, and how well scans fit this map at their best.

    Examples
    --------
    imgloc calibrate office.yaml
    imgloc calibrate office.yaml --method ght-v,beam --rays 360 --fov-deg 360 --range-max 12
    imgloc calibrate floor1.yaml floor2.yaml -n 15 --json
    imgloc calibrate curved visibility --dry-run
    """
    from imgloc.cli import inputs
    from imgloc.io.calibration import save_calibrations
    from imgloc.lab.calibrate import check_trials, disturbed_set, fit, sweep
    from imgloc.model import plain
    from imgloc.pipeline import prepare
    from imgloc.simulation.scans import fine_image, is_world

    opt.refuse_others(given, _OF, {_SIMULATED if scans is None else _RECORDED})
    paths = [opt.find_map(given) for given in maps]
    targets = _targets(maps, paths, dry_run=dry_run, force=force)
    read = inputs.map_files(reading)
    if scans is not None:
        how = inputs.as_recorded(logs, chosen, mounting)
        _with_scans(paths, scans, how, read, taken, as_json, dry_run, force)
        return
    laser: dict[str, Any] = {"fov": logs.fov, "range_max": logs.range_max, "mount": mounting.sensor}
    sensor = replace(sensor, **{name: value for name, value in laser.items() if value is not None})
    check_trials(count * len(paths))
    desk = inputs.desk_of(**vars(taken))
    grids = _grids(paths, read, desk)
    plans = {name: Options(name, theta_step=theta_step, **vars(taken)) for name in method}
    for path, grid in zip(paths, grids, strict=True):
        name, world = display(path), is_world(path, grid)
        desk.check_simulation(grid, name, count, sensor.rays, world=world, sets=3 * len(grids))
        for options in plans.values():
            desk.check_answer(prepare(grid, name, ready=False, cell=cell), options, name)
    sets = [
        disturbed_set(grid, count, seed, sensor, fine_image(path, grid))
        for path, grid in zip(paths, grids, strict=True)
    ]
    fits: dict[str, CalibrationFit] = {}
    for name, options in plans.items():
        sweeps = []
        with progress(name, count * len(maps), lines=False) as advance:
            for path, grid, told in zip(paths, grids, sets, strict=True):
                features = prepare(grid, display(path), cell=cell, threads=taken.threads)
                sweeps.append(sweep(features, told, options, advance=advance))
        fits[name] = fit(sweeps)
        LOG.info("%s: %s", name, asdict(fits[name].calibration))
    about = {"maps": [display(path) for path in paths], "seed": seed, "trials": count}
    degrees = None if theta_step is None else round(math.degrees(theta_step), 9)
    about |= {"sensor": asdict(sensor), "cell": cell, "theta_step_deg": degrees}
    _show(fits, about, as_json=as_json)
    for target, grid in [] if dry_run else zip(targets, grids, strict=True):
        each = {one: about | {"index": _index(found)} for one, found in fits.items()}
        calibrations = {one: found.calibration for one, found in fits.items()}
        save_calibrations(target, grid, calibrations, plain(each), force=force)
        say(f"wrote {display(target)}")


def _targets(
    maps: Sequence[Path], paths: Sequence[Path], *, dry_run: bool, force: bool
) -> list[Path]:
    """The file beside each map, as it was given and where it is; all that may be written."""
    from imgloc.cli import inputs
    from imgloc.io.calibration import calibration_path

    targets = [calibration_path(path) for path in paths]
    if len(set(targets)) < len(targets):
        raise ConfigError("MAP...: the same map twice, or two that would share a file")
    for given, path, target in [] if dry_run else zip(maps, paths, targets, strict=True):
        if path != given:
            raise ConfigError(
                f"{given}: of a bundled map it would be kept in {display(target)}, among the files "
                f"of imgloc; give {display(path)} if that is meant, else --dry-run or a copy"
            )
        inputs.check_target(target, ".json", force=force)
    return targets


def _grids(paths: Sequence[Path], maps: "MapFiles", desk: "Desk") -> list["OccupancyGrid"]:
    """All maps, each of which has to fit into the memory beside those before it."""
    grids: list[OccupancyGrid] = []
    for path in paths:
        grids.append(desk.grid(path, maps, usable=True))
        desk.held += grids[-1].occupied.nbytes + grids[-1].free.nbytes
    desk.held = 0  # what follows counts them itself
    return grids


def _index(found: "CalibrationFit") -> dict[str, Any]:
    return {"calibrated": asdict(found.index), "bare": asdict(found.bare)}


def _show(fits: "Mapping[str, CalibrationFit]", about: Mapping[str, Any], *, as_json: bool) -> None:
    """Print what was fitted."""
    from imgloc.lab.tables import calibration_table
    from imgloc.model import to_json

    if not as_json:
        emit(calibration_table(fits))
        return
    fitted = {method: asdict(found.calibration) for method, found in fits.items()}
    index = {method: _index(found) for method, found in fits.items()}
    emit(to_json({"methods": fitted, "about": {**about, "index": index}}))


def _with_scans(
    paths: list[Path], files: list[Path], how: "ScanFiles", maps: "MapFiles", taken: opt.Resources,
    as_json: bool, dry_run: bool, force: bool,
) -> None:  # fmt: skip
    """Fit the error that recorded scans share on one map."""
    from imgloc.cli import inputs
    from imgloc.io.calibration import calibration_path, save_calibrations
    from imgloc.lab.calibrate import SCANS, STARTS, fit_along, fit_shared
    from imgloc.lab.tables import shared_words
    from imgloc.model import to_json

    if len(paths) > 1:
        raise ConfigError("--scans: expected one MAP, the one that they are from")
    (path,), desk = paths, inputs.desk_of(**vars(taken))
    grid = desk.grid(path, maps, usable=True)
    logs = [desk.scans(file, how).scans for file in files]
    some = [scan for log in logs for scan in log.scans]
    options = Options(**vars(taken))
    features = desk.features(path, maps, options, scans=some)
    try:
        asked = len(STARTS) * min(SCANS, len(some))
        with progress("scans", asked, lines=False) as advance:
            found = fit_shared(features, some, options, advance=advance)
    except ConfigError:
        if not any(log.odom is not None for log in logs):
            raise
        with progress("along the way", len(some), lines=False) as advance:
            found = fit_along(features, logs, options, advance=advance)
    about = asdict(found) | {"scans": [display(file) for file in files]}
    emit(to_json(about) if as_json else shared_words(found, grid.resolution))
    if not dry_run:
        target = calibration_path(path)
        save_calibrations(target, grid, {}, {"shared": about}, shared=found.shared, force=force)
        say(f"wrote {display(target)}")
