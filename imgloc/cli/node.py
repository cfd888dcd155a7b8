"""`imgloc node`: a ROS 2 node that says where a robot is."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand

from imgloc.cli import options as opt
from imgloc.cli.options import flag, option

if TYPE_CHECKING:
    pass

_ROS = "--ros-args"
_SENSOR = (
    "Pose of the laser on the robot (metres; radians, or 90deg). Repeat it for several lasers, in "
    "the order of --scan. [default: tf says it, if tf2_msgs is installed]"
)


class RosCommand(TyperCommand):
    """A command after whose own words those of ROS come: `--ros-args -p every:=1.0`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Keep the words of ROS for rclpy."""
        at = args.index(_ROS) if _ROS in args else len(args)
        ctx.meta[_ROS] = args[at:]
        return list(super().parse_args(ctx, args[:at]))


@opt.with_options(opt.reading, opt.taken, opt.console)
def node(
    context: typer.Context,
    reading: "opt.Reading",
    taken: opt.Resources,
    map_path: Annotated[
        Path | None,
        typer.Argument(
            metavar="MAP|FOLDER",
            help="A map, or a folder of maps, one for each floor. Without it the node takes the "
            "map of the topic map.",
        ),
    ] = None,
    scan: list[str] = typer.Option(
        ["scan"], metavar="TOPIC", help="Topic of a laser; repeat it for several lasers."
    ),
    sensor: list[str] = typer.Option([], metavar="X,Y,YAW", help=_SENSOR),
    flipped: opt.Flipped = False,
    range_max: opt.Cut = None,
    track: bool = flag("--track", "Follow the robot too: topics ~/pose and ~/map_odom."),
    every: float = option(0.3, "S", "Seconds between two scans that are tried.", min=0),
    tries: int = option(100, "N", "Give up after N scans without a confirmed pose.", min=2),
    max_age: float = option(2.0, "S", "Publish no pose of a scan older than S seconds.", min=0.01),
    cache: opt.CacheDir = None,
    no_cache: opt.NoCache = False,
    allow_lossy: opt.AllowLossy = False,
) -> None:
    """Run a ROS 2 node that finds the robot on the map and publishes its first pose.

    The pose goes to /initialpose once two scans have a unique place and agree. The topics
    ~/hypotheses, ~/markers, ~/status and /diagnostics say what is found until then. The services
    ~/localize and ~/reset ask for a new pose. Every parameter can also be set by ROS:
    --ros-args -p every:=1.0 -p use_sim_time:=true -r scan:=/front/scan. Ctrl-C ends the node.
    """
    from imgloc.live.node import Settings, load_ros, run_node
    from imgloc.options import Options

    ros = load_ros()  # the first word is of what is not installed
    mounts = [opt.numbers(3, pose="--sensor")(text) for text in sensor]
    settings = Settings(
        tuple(scan),
        tuple(value for mount in mounts for value in mount),
        flipped=flipped,
        range_max=math.inf if range_max is None else range_max,
        track=track,
        every=every,
        tries=tries,
        max_age=max_age,
    )
    options = Options(threads=taken.threads, memory_budget=taken.memory_budget)
    makers: dict[str, Any] = {}
    prepared: Any = None
    if map_path is not None:
        from imgloc.choice.choose import names_of
        from imgloc.cli import inputs
        from imgloc.io.files import is_folder
        from imgloc.io.folders import find_maps
        from imgloc.runs.opening import MapFiles

        folder, many = inputs.kept_in(cache, wanted=not no_cache), is_folder(map_path)
        paths, maps = {map_path.stem: map_path}, MapFiles(reading, allow_lossy, many=many)
        if many:
            found = find_maps(map_path, images=reading.get("resolution") is not None)
            paths = dict(zip(names_of(found, map_path), found, strict=True))
        else:  # what is wrong with one map is said at once
            inputs.desk_of(*taken).grid(map_path, maps, usable=True)
        makers, prepared = inputs.site_makers(paths, maps, options, folder)

    words = ["imgloc", *context.meta[_ROS]]
    raise typer.Exit(run_node(ros, words, settings, makers, options, prepared))
