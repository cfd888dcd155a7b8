"""Starts `imgloc node`.

    ros2 launch tools/docs/nav2/imgloc.launch.py map:=office.yaml sensor:=0.2,0,0

Without `map` the node takes the topic map. Parameters are in imgloc.params.yaml beside this file.
"""

from pathlib import Path
from typing import Any

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction
from launch.substitutions import LaunchConfiguration

HERE = Path(__file__).parent
ARGUMENTS = {
    "map": ("", "map_server YAML, or a folder of maps; empty: the topic map"),
    "sensor": ("", "x,y,yaw of the laser on the robot; empty: tf says it"),
    "scan": ("scan", "topic of the laser"),
    "use_sim_time": ("false", "whether the time is that of /clock"),
    "params": (str(HERE / "imgloc.params.yaml"), "file of ROS parameters"),
}


def start(context: Any) -> list[Any]:
    """The process, with what was said."""
    given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    words = ["imgloc", "node", *filter(None, [given["map"]])]
    words += ["--sensor", given["sensor"]] if given["sensor"] else []
    words += ["--ros-args", "--params-file", given["params"], "-r", f"scan:={given['scan']}"]
    words += ["-p", f"use_sim_time:={given['use_sim_time']}"]
    return [ExecuteProcess(cmd=words, output="screen")]


def generate_launch_description() -> Any:
    """What `ros2 launch` asks for."""
    said = [
        DeclareLaunchArgument(name, default_value=value, description=text)
        for name, (value, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*said, OpaqueFunction(function=start)])
