"""`imgloc node`: a ROS 2 node that locates a robot."""

from pathlib import Path
from typing import Any

import typer

from imgloc.cli import options as opt
from imgloc.cli.command import Command
from imgloc.cli.console import LACKS, emit, instead
from imgloc.live.settings import Settings
from imgloc.options import Options
from imgloc.ranges import option

_ROS = "--ros-args"
_HEARD = "messages are taken as they are, so mend what publishes them"


class RosCommand(Command):
    """A command after whose own words those of ROS come: `--ros-args -p every:=1.0`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Keep the words of ROS for rclpy."""
        at = args.index(_ROS) if _ROS in args else len(args)
        ctx.meta[_ROS] = args[at:]
        left = list(super().parse_args(ctx, args[:at]))
        lacks = ctx.meta[LACKS]
        lacks |= {name: _HEARD for name, hint in lacks.items() if hint == "it reads no scans"}
        return left


def node(
    *,
    context: typer.Context,
    reading: opt.MapSize,
    taken: opt.Resources,
    map_path: Path | None = option(
        None,
        "Map, the name of a bundled map, or a folder of maps, one for each floor. [default: the "
        "map of the topic map]",
        "MAP|FOLDER",
        parse=opt.find_map,
    ),
    settings: Settings,
    lifecycle: bool = option(
        False, "Wait for a lifecycle manager: configure prepares maps, activate finds the robot."
    ),
    check: bool = option(
        False,
        "Look at the running robot for 10 s, print what is wrong with its topics, clocks, "
        "transforms, map, scale and mounting, and end: with code 1 if anything is.",
    ),
    kept: opt.Kept,
) -> None:
    """Run a ROS 2 node that finds the robot on the map and publishes its first pose.

    The pose goes to /initialpose once scans along some way confirm one place. The topics
    ~/hypotheses, ~/markers, ~/status and /diagnostics show what is found until then. The services
    ~/localize, ~/reset and /reinitialize_global_localization ask for a new pose. Every parameter
    can also be set by ROS: --ros-args -p every:=1.0 -p use_sim_time:=true -r scan:=/front/scan.

    Examples
    --------
    imgloc node
    imgloc node office.yaml --sensor 0.2,0,0 --track
    imgloc node floors --scan front --scan rear --sensor 0.3,0,0 --sensor -0.3,0,180deg
    imgloc node office.yaml --sensor 0,0,0 --ros-args -p use_sim_time:=true
    """
    from imgloc.live.node import load_ros, run_node

    ros = load_ros()  # the first word is of what is not installed
    options = Options(**vars(taken))
    makers: dict[str, Any] = {}
    prepared: Any = None
    if map_path is not None:
        from imgloc.cli import inputs
        from imgloc.io.files import is_folder

        folder, many = inputs.kept_in(kept), is_folder(map_path)
        paths, maps = {map_path.stem: map_path}, inputs.map_files(reading, many=many)
        if many:
            paths = inputs.maps_in(map_path, reading)
        else:  # what is wrong with one map is said at once
            inputs.desk_of(**vars(taken)).grid(map_path, maps, usable=True)
        makers, prepared = inputs.site_makers(paths, maps, options, folder)

    words = ["imgloc", *context.meta[_ROS]]
    if check:
        from imgloc.live.check import check_robot

        rows = check_robot(ros, words, settings, makers, options)
        for row in rows:
            emit(f"{'wrong' if row.do else 'ok':5}  {row.what}: {row.found}")
            if row.do:
                emit(f"       -> {instead(row.do, context.meta[LACKS])}")
        raise typer.Exit(int(any(row.do for row in rows)))
    raise typer.Exit(run_node(ros, words, settings, makers, options, prepared, lifecycle=lifecycle))
