"""Settings of the ROS 2 node: options of the command, and ROS parameters of the same fields."""

import math
from dataclasses import dataclass
from functools import partial
from typing import Annotated

from imgloc.errors import ConfigError
from imgloc.options import Flipped, Metres, Place, Radians
from imgloc.pose import Pose2D, check_mount
from imgloc.ranges import Checked, Doc, Matches, Within, option
from imgloc.texts import numbers, pose

_Frame = Annotated[str, Matches(r"/*[^/]+.*", 1000, "the name of a frame")]
_Topic = Annotated[str, Matches(r".+", 1000, "the name of a topic")]


def _poses(text: str) -> tuple[float, ...]:
    """Numbers of poses, in threes."""
    words = text.split(",")
    threes = [",".join(words[k : k + 3]) for k in range(0, len(words), 3)]
    return tuple(value for three in threes for value in pose(three))


def _topics(text: str) -> tuple[str, ...]:
    return tuple(text.split(","))


@dataclass(frozen=True)
class Rules(Checked):
    """Rules by which a first pose is tried and published."""

    every: Annotated[float, Within(0, 3600, "seconds")] = option(
        0.3, "Seconds between two scans that are tried."
    )
    metres: Annotated[
        float, Within(0, 1000, "metres"), Doc("Metres of driving between two scans that are tried.")
    ] = 0.3
    #: scans that weigh the belief, or are blind, until it is given up
    tries: Annotated[int, Within(2, 1_000_000, "scans")] = option(
        100, "Scans without a confirmed pose after which the node gives up.", metavar="N"
    )
    max_age: Annotated[float, Within(0.01, 3600, "seconds")] = option(
        2.0, "Age of a scan, seconds, from which its pose is not published any more."
    )


#: parameters that may change while the node runs
CHANGING = {"every", "metres", "tries", "max_age", "scan_timeout", "least_deviation", "standing",
            "range_max", "height"}  # fmt: skip


_topics_option = partial(option, (), metavar="TOPIC", parse=_topics, joined=True)


@dataclass(frozen=True)
class Settings(Rules):
    """Settings of the node; each field is a ROS parameter of its name."""

    scan_topics: tuple[_Topic, ...] = _topics_option(
        "Topic of a laser. Repeat it for several lasers. [default: scan, or none with --cloud]",
        "--scan",
    )
    cloud_topics: tuple[_Topic, ...] = _topics_option(
        "Topic of a 3-D lidar or depth camera, whose clouds of points are cut at --height. Repeat "
        "it for several.",
        "--cloud",
    )
    height: tuple[Place, ...] = option(
        (),
        "Points of a cloud between the heights MIN and MAX are a scan: metres over base_frame by "
        "tf; with --sensor, over the sensor, which is level then.",
        metavar="MIN,MAX",
        parse=numbers(2),
    )
    sensor: tuple[Place, ...] = option(
        (),
        "Pose of the laser on the robot: metres, metres, radians (or 90deg). Repeat it for several "
        "lasers, in the order of their topics, clouds last. [default: tf says it, if tf2_msgs is "
        "installed]",
        metavar="X,Y,YAW",
        parse=_poses,
        joined=True,
    )
    flipped: Flipped = False
    range_max: Annotated[float, Within(1e-3, math.inf, "metres")] = option(
        math.inf,
        "Reach of the sensor, metres: a reading of this length or more counts as no return. "
        "[default: that of the messages]",
    )
    base_frame: Annotated[_Frame, Doc("Frame of the poses that are published.")] = "base_link"
    map_frame: Annotated[_Frame, Doc("Frame of a map file; the topic map has its own.")] = "map"
    scan_timeout: Annotated[
        float, Within(0.01, 1e6, "seconds"), Doc("Seconds until a laser counts as silent.")
    ] = 1.0
    #: a localizer that starts from it needs room for its own errors
    least_deviation: Annotated[
        tuple[Metres, Radians],
        Doc("Least standard deviations of /initialpose and ~/hint, metres and radians."),
    ] = (0.1, 0.05)
    track: bool = option(False, "Follow the robot, too, on the topics ~/pose and ~/map_odom.")
    tf: bool = option(False, "With --track, also publish map -> odom on /tf, as AMCL does.")
    standing: bool = option(
        False,
        "Publish the pose of a robot that has not moved, by one scan that is very sure: a second "
        "look from the same place would tell nothing new.",
    )
    remember: str = option(
        "",
        "File that keeps the last sure pose. When the node starts, one scan is looked for on the "
        "whole map: the pose is restored, refused, or the robot was moved.",
        metavar="FILE",
    )
    watch: str = option(
        "",
        "A second opinion: say on ~/status and /diagnostics whether scans agree with the poses on "
        "this topic, /amcl_pose, or of tf. The node then publishes no pose.",
        metavar="TOPIC|tf",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        own = [name for name in ("track", "standing", "remember") if getattr(self, name)]
        if self.watch and own:
            raise ConfigError(f"Settings.watch: publishes no pose, so {own[0]} does not go with it")
        if self.tf and not self.track:
            raise ConfigError("Settings.tf: expected track, too: map -> odom is of the tracker")

        if bool(self.cloud_topics) != bool(self.height):
            raise ConfigError("Settings.height: expected with cloud_topics, and they with it")
        if self.height and not (len(self.height) == 2 and self.height[0] < self.height[1]):
            raise ConfigError(f"Settings.height: got {self.height}, expected a lower end first")

    @property
    def topics(self) -> list[tuple[str, bool]]:
        """The topics of lasers, and then of clouds; and whether each is of clouds."""
        lasers = self.scan_topics or (() if self.cloud_topics else ("scan",))
        return [(one, False) for one in lasers] + [(one, True) for one in self.cloud_topics]

    @property
    def mounts(self) -> list[Pose2D] | None:
        """Where each laser sits; None if that is up to tf."""
        if not self.sensor:
            return None
        if len(self.sensor) != 3 * len(self.topics):
            raise ConfigError(
                f"sensor: got {len(self.sensor)} numbers, expected x, y, yaw for each of "
                f"{len(self.topics)} topics"
            )
        at = self.sensor
        mounts = [Pose2D(*at[k : k + 3]) for k in range(0, len(at), 3)]
        for mount in mounts:
            check_mount(mount, "sensor")
        return mounts
