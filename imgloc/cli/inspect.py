"""`imgloc inspect`: what is in a log or a map, before it is used."""

from pathlib import Path

from imgloc.cli import options as opt
from imgloc.cli.command import Typed
from imgloc.errors import ConfigError
from imgloc.options import Logs, Mounting
from imgloc.ranges import option


def inspect(
    *,
    files: list[Path] = option(
        ...,
        "Logs or other files of scans, and maps. Logs are checked against the map if there is one.",
        "FILE...",
        parse=opt.find_file,
    ),
    logs: Logs,
    mounting: Mounting,
    reading: opt.MapImages,
    as_json: opt.AsJson = False,
    picture: Path | None = option(
        None,
        "Draw the way of the odometry, one scan and the histogram of ranges into this file; of "
        "several logs into NAME-0003.png and so on.",
        metavar="PNG",
    ),
    kept: opt.Kept,
    memory_budget: opt.MemoryBudget | None = None,
    force: opt.Force = False,
    typed: Typed,
) -> None:
    """Look at a log or a map before it is used, and name what is wrong with it.

    Of a log: kinds of lines or topics, scans, rays, ranges, codes for nothing seen, units, stamps,
    odometry, known poses, the place of the sensor, and whether scans and odometry agree. Of a log
    with a map, also whether the scans fit the map. The last line is the command to go on with.

    Examples
    --------
    imgloc inspect run.log
    imgloc inspect office.yaml run.bag --picture run.png
    imgloc inspect office.yaml monday.log tuesday.log.gz --json
    """
    from imgloc.cli import inputs
    from imgloc.cli.inspection import Look, is_map, show_map

    desk = inputs.desk_of(1, opt.fixed_budget(memory_budget), inputs.kept_in(kept))
    given = [opt.find_map(path) if is_map(path) else path for path in files]
    maps = [path for path in given if is_map(path)]
    found = [path for path in given if path not in maps]
    names = inputs.targets(picture, ".png", range(len(found)), force=force, inputs=files)
    if picture is not None and not found:
        raise ConfigError("--picture: is of logs; imgloc map show draws a map")
    how = inputs.map_files(reading)
    for path in maps:
        show_map(path, how, desk, typed, as_json=as_json)
    look = Look(desk, how, maps[0] if len(maps) == 1 else None, logs, mounting, typed)
    for k, path in enumerate(found):
        look.at(path, as_json=as_json, picture=names.get(k), force=force)
