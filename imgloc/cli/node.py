"""`imgloc node`: a ROS 2 node that says where a robot is."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from imgloc.cli import options as opt
from imgloc.cli.command import Command
from imgloc.cli.console import emit
from imgloc.options import Flipped, Options, RangeMax
from imgloc.ranges import Within, option
from imgloc.texts import pose

if TYPE_CHECKING:
    from imgloc.model import Pose2D
else:
    Pose2D = Any

_ROS = "--ros-args"


class RosCommand(Command):
    """A command after whose own words those of ROS come: `--ros-args -p every:=1.0`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Keep the words of ROS for rclpy."""
        at = args.index(_ROS) if _ROS in args else len(args)
        ctx.meta[_ROS] = args[at:]
        return list(super().parse_args(ctx, args[:at]))


def node(
    *,
    context: typer.Context,
    reading: opt.MapImages,
    taken: opt.Resources,
    map_path: Path | None = option(
        None,
        "Map, the name of a bundled map, or a folder of maps, one for each floor. [default: the "
        "map of the topic map]",
        "MAP|FOLDER",
        parse=opt.find_map,
    ),
    scan: list[str] = option(
        ["scan"], "Topic of a laser. Repeat it for several lasers.", metavar="TOPIC"
    ),
    sensor: list[Pose2D] = option(
        [],
        "Pose of the laser on the robot: metres, metres, radians (or 90deg). Repeat it for several "
        "lasers, in the order of their topics. [default: tf says it, if tf2_msgs is installed]",
        metavar="X,Y,YAW",
        parse=pose,
    ),
    flipped: Flipped = False,
    range_max: RangeMax | None = None,
    track: bool = option(False, "Follow the robot, too, on the topics ~/pose and ~/map_odom."),
    tf: bool = option(False, "With --track, also publish map -> odom on /tf, as AMCL does."),
    standing: bool = option(
        False,
        "Publish the pose of a robot that has not moved, by one scan that is very sure: a second "
        "look from the same place would tell nothing new.",
    ),
    watch: str = option(
        "",
        "A second opinion: say on ~/status and /diagnostics whether scans agree with the poses on "
        "this topic, /amcl_pose, or of tf. The node then publishes no pose.",
        metavar="TOPIC|tf",
    ),
    remember: Path | None = option(
        None,
        "File that keeps the last sure pose. When the node starts, one scan is looked for on the "
        "whole map: the pose is restored, refused, or the robot was moved.",
        metavar="FILE",
    ),
    lifecycle: bool = option(
        False, "Wait for a lifecycle manager: configure prepares maps, activate finds the robot."
    ),
    check: bool = option(
        False,
        "Look at the running robot for 10 s, print what is wrong with its topics, clocks, "
        "transforms, map, scale and mounting, and end: with code 1 if anything is.",
    ),
    every: Annotated[float, Within(0, 1e9, "seconds")] = option(
        0.3, "Seconds between two scans that are tried."
    ),
    tries: Annotated[int, Within(2, 1e12, "scans")] = option(
        100, "Scans without a confirmed pose after which the node gives up.", metavar="N"
    ),
    max_age: Annotated[float, Within(0.01, 1e9, "seconds")] = option(
        2.0, "Age of a scan, seconds, from which its pose is not published any more."
    ),
    kept: opt.Kept,
) -> None:
    """Run a ROS 2 node that finds the robot on the map and publishes its first pose.

    The pose goes to /initialpose once scans along some way confirm one place. The topics
    ~/hypotheses, ~/markers, ~/status and /diagnostics say what is found until then. The services
    ~/localize, ~/reset and /reinitialize_global_localization ask for a new pose. Every parameter
    can also be set by ROS: --ros-args -p every:=1.0 -p use_sim_time:=true -r scan:=/front/scan.
    """
    from imgloc.live.node import Settings, load_ros, run_node

    ros = load_ros()  # the first word is of what is not installed
    settings = Settings(
        tuple(scan),
        tuple(value for at in sensor for value in (at.x, at.y, at.theta)),
        flipped=flipped,
        range_max=math.inf if range_max is None else range_max,
        track=track,
        tf=tf,
        standing=standing,
        watch=watch,
        remember="" if remember is None else str(remember),
        every=every,
        tries=tries,
        max_age=max_age,
    )
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
                emit(f"       -> {row.do}")
        raise typer.Exit(int(any(row.do for row in rows)))
    raise typer.Exit(run_node(ros, words, settings, makers, options, prepared, lifecycle=lifecycle))
