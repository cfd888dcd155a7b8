"""`imgloc map align`: where one map lies in the frame of another map of the same place."""

from pathlib import Path
from typing import Annotated, Any

import typer

from imgloc.cli import options as opt
from imgloc.cli.console import NOT_UNIQUE, emit, say
from imgloc.errors import ConfigError, as_options
from imgloc.io.files import display, map_name, write_text_atomic
from imgloc.ranges import Option, option

_SCANS = 24  # of a file


def align(
    *,
    a_path: Annotated[Path, Option("Map whose frame is kept.", "A", parse=opt.find_map)],
    b_path: Annotated[
        Path, Option("Map of the same place, in a frame of its own.", "B", parse=opt.find_map)
    ],
    scans: Path | None = option(
        None,
        f"Locate scans of this file in both maps, too, {_SCANS} at most, evenly spread: they must "
        "differ by one transform. [default: no scans]",
        metavar="SCANS",
        parse=opt.find_scans,
    ),
    scale: bool = option(False, "B may have another scale, 0.8 to 1.25 times that of A."),
    picture: Path | None = option(
        None,
        "Draw B over A into this file: the walls that both have, and those that only one has.",
        metavar="PNG",
    ),
    move: Path | None = option(
        None,
        "Carry these poses of B over to A: columns x, y and, if there is one, theta or yaw, metres "
        "and radians; other columns stay. Needs --out.",
        metavar="CSV",
    ),
    out: Path | None = option(
        None, "File of the poses of --move in the frame of A that is written.", metavar="CSV"
    ),
    write: Path | None = option(
        None,
        "Write a YAML of B in the frame of A: the same image with another origin. Many parts of "
        "ROS ignore the yaw of an origin.",
        metavar="YAML",
    ),
    taken: opt.Resources,
    as_json: opt.AsJson = False,
    strict: bool = option(False, "Exit with code 6 unless one place alone matches."),
    force: opt.Force = False,
) -> None:
    """Find where map B lies in the frame of map A, and how well the two agree.

    The maps may have other resolutions, origins, wall thicknesses, be turned by any angle, and
    overlap in part. The pose of B's frame in A's comes with a verdict: unique, ambiguous (another
    place agrees about as well) or no-match (walls contradict each other, as in two buildings).

    Examples
    --------
    imgloc map align office.yaml office-new.yaml --picture both.png
    imgloc map align new.yaml old.yaml --move waypoints.csv --out waypoints-new.csv
    imgloc map align a.yaml b.yaml --scans run.bag --json
    imgloc map align a.yaml drawing.yaml --scale --write drawing-in-a.yaml
    """
    from imgloc.cli import inputs
    from imgloc.io.maps import reading_of, resolve_settings
    from imgloc.lab.align import align_maps, align_scans, differences
    from imgloc.lab.aligned import (
        alignment_text,
        draw_alignment,
        moved_text,
        moved_yaml,
        read_poses,
    )
    from imgloc.lab.located import some_of
    from imgloc.model import to_json
    from imgloc.runs.localize import Localize

    read = [*inputs.files_of(a_path), *inputs.files_of(b_path), *([] if move is None else [move])]
    for path, ending in ((picture, ".png"), (out, ".csv"), (write, ".yaml")):
        inputs.check_target(path, ending, force=force, inputs=read)
    if (move is None) != (out is None):
        raise ConfigError("--move, --out: expected both: poses of B, and the file for those of A")
    poses = None if move is None else read_poses(move)
    desk, maps = inputs.desk_of(**vars(taken)), inputs.map_files(many=True)
    paths, by_scans = (a_path, b_path), None
    grids = [desk.grid(path, maps, usable=True) for path in paths]
    if scans is not None:
        job = Localize(maps=maps, scans=inputs.as_recorded())
        items = [inputs.item_of(path, scans) for path in paths]
        answers = [[one.of for one in some_of(job.open(item, desk), _SCANS)] for item in items]
        by_scans = align_scans(list(zip(*answers, strict=True)))
    found = align_maps(grids[0], grids[1], scale=scale, scans=by_scans)
    row: dict[str, Any] = {"a": display(a_path), "b": display(b_path), **found.as_row()}
    if by_scans is not None:
        row["scans"] = by_scans.as_row() | differences(found, by_scans)
    written = [] if picture is None else [picture]
    if picture is not None:
        names = [map_name(path) for path in paths]
        draw_alignment(grids[0], grids[1], found, names).save(picture, force=force)
    sure = found.verdict == "unique"
    if sure and poses is not None and out is not None:
        write_text_atomic(out, moved_text(poses, found), force=force)
        written.append(out)
    if sure and write is not None:
        settings = resolve_settings(b_path, **reading_of(b_path, maps.reading))
        write_text_atomic(write, moved_yaml(settings, found, write.parent), force=force)
        written.append(write)
    emit(to_json(row) if as_json else as_options(alignment_text(row)))
    for path in written:
        say(f"wrote {display(path)}")
    if not sure and (strict or move is not None or write is not None):
        if move is not None or write is not None:
            say(f"the maps are {found.verdict}: no pose and no YAML is written")
        raise typer.Exit(NOT_UNIQUE)
