"""Starts `imgloc node`.

    ros2 launch imgloc_ros first_pose.launch.py map:=office.yaml sensor:=0.2,0,0

Without `map` the node takes the topic map. Parameters are in config/imgloc.params.yaml.
"""

from pathlib import Path
from typing import Any

SHARE = Path(__file__).resolve().parents[1]
ARGUMENTS = {
    "map": ("", "map_server YAML, or a folder of maps; empty: the topic map"),
    "sensor": ("", "x,y,yaw of the laser on the robot; empty: tf says it"),
    "scan": ("scan", "topic of the laser"),
    "namespace": ("", "namespace of the robot"),
    "remember": ("", "file that keeps the pose for the next start"),
    "watch": ("", "topic of another localizer's poses: a second opinion, no pose is published"),
    "use_sim_time": ("false", "whether the time is that of /clock"),
    "params": (str(SHARE / "config" / "imgloc.params.yaml"), "file of ROS parameters"),
}


def words_of(given: dict[str, str]) -> list[str]:
    """The command line of the node, with what was said."""
    own = SHARE.parents[1] / "lib" / "imgloc_ros" / "imgloc"  # as colcon installs it
    words = [str(own) if own.exists() else "imgloc", "node", *filter(None, [given["map"]])]
    words += ["--sensor", given["sensor"]] if given["sensor"] else []
    words += ["--ros-args", "--params-file", given["params"], "-r", f"scan:={given['scan']}"]
    words += ["-r", f"__ns:={given['namespace']}"] if given["namespace"] else []
    for name in ("remember", "watch"):
        words += ["-p", f"{name}:={given[name]}"] if given[name] else []
    return [*words, "-p", f"use_sim_time:={given['use_sim_time']}"]


def start(context: Any) -> list[Any]:
    """The process."""
    from launch.actions import ExecuteProcess
    from launch.substitutions import LaunchConfiguration

    given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    return [ExecuteProcess(cmd=words_of(given), output="screen")]


def generate_launch_description() -> Any:
    """What `ros2 launch` asks for."""
    from launch import LaunchDescription
    from launch.actions import DeclareLaunchArgument, OpaqueFunction

    said = [
        DeclareLaunchArgument(name, default_value=value, description=text)
        for name, (value, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*said, OpaqueFunction(function=start)])
