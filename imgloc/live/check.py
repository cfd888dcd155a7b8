"""A robot that runs, looked at for some seconds: what is wrong with its topics, and what to do."""

import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from imgloc.answers.causes import Given
from imgloc.answers.diagnose import doubts
from imgloc.errors import ImglocError
from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.scanpoints import evenly
from imgloc.io.clouds import seen_in_msg
from imgloc.io.messages import frame_name, grid_from_msg, link_of, seconds_of
from imgloc.io.scanset import ScanSet
from imgloc.live.node import placed, ros_node
from imgloc.live.settings import Settings
from imgloc.live.sites import Maker, site_of
from imgloc.model import LaserScan
from imgloc.options import Options
from imgloc.pipeline import localize, prepare
from imgloc.robot.frames import Frames

SECONDS = 10.0
"""How long is listened."""
_KEPT = 30  # messages of a topic: clouds are large
_SCANS = 3  # that are looked for on the map
_SLOW = {"LaserScan": 1.0, "PointCloud2": 1.0, "Odometry": 5.0}  # messages a second at least


@dataclass(frozen=True)
class Row:
    """One thing that was looked at."""

    what: str
    found: str
    do: str = ""  #: what mends it; empty if nothing is wrong


@dataclass
class _Heard:
    """Messages of a topic."""

    name: str  #: with namespace and remapping
    kind: str
    messages: deque[Any] = field(default_factory=lambda: deque(maxlen=_KEPT))
    times: list[float] = field(default_factory=list)  # monotonic seconds
    ages: list[float] = field(default_factory=list)  # seconds of the stamps

    def rate(self) -> float:
        """Messages a second."""
        way = self.times[-1] - self.times[0] if self.times else 0.0
        return (len(self.times) - 1) / way if way > 0 else 0.0


class _Ear:
    """Listens to all that the node would hear."""

    def __init__(self, ros: Any, node: Any, settings: Settings, *, map_topic: bool) -> None:
        self.ros, self.node, self.settings, self.frames = ros, node, settings, Frames()
        qos, sensor = ros.qos, ros.qos.qos_profile_sensor_data
        latched = qos.QoSProfile(depth=1, durability=qos.DurabilityPolicy.TRANSIENT_LOCAL)
        self.scans = [
            self._hear("sensor_msgs", "PointCloud2" if cloud else "LaserScan", t, sensor)
            for t, cloud in settings.topics
        ]
        self.odom = self._hear("nav_msgs", "Odometry", "odom", sensor)
        self.map = self._hear("nav_msgs", "OccupancyGrid", "map", latched) if map_topic else None
        if ros.tf2_msgs is not None:
            still = qos.QoSProfile(depth=100, durability=latched.durability)
            for topic, how in (("/tf", 100), ("/tf_static", still)):
                node.create_subscription(ros.tf2_msgs.TFMessage, topic, self._on_tf, how)

    def _hear(self, package: str, kind: str, topic: str, qos: Any) -> _Heard:
        heard = _Heard(str(self.node.resolve_topic_name(topic)), kind)
        type_ = getattr(getattr(self.ros, package), kind)
        self.node.create_subscription(type_, topic, partial(self._on, heard), qos)
        return heard

    def _on(self, heard: _Heard, message: Any) -> None:
        now = float(self.node.get_clock().now().nanoseconds) * 1e-9
        heard.times.append(time.monotonic())
        heard.ages.append(now - seconds_of(message.header.stamp))
        heard.messages.append(message)

    def _on_tf(self, message: Any) -> None:
        for item in message.transforms:
            child, parent, pose = link_of(item)
            self.frames.add(child, parent, pose)

    def topic_rows(self, heard: _Heard, *, needed: bool) -> Iterator[Row]:
        """Publishers, type, rate and clock of a topic."""
        name = heard.name
        there = self.node.get_publishers_info_by_topic(name)
        types = dict(self.node.get_topic_names_and_types())
        like = [t for t, kinds in types.items() if any(k.endswith(heard.kind) for k in kinds)
                and t != name and self.node.count_publishers(t)]  # fmt: skip
        if not there:
            do = "start its driver; is ROS_DOMAIN_ID the same?"
            do = f"remap it: -r {name.rpartition('/')[2]}:={like[0]}" if like else do
            yield Row(name, "no publisher", do if needed or like else "")
            return
        wrong = sorted({one.topic_type for one in there if not one.topic_type.endswith(heard.kind)})
        if wrong:
            yield Row(name, f"of type {wrong[0]}", f"expected {heard.kind}: remap the right topic")
            return
        if not heard.times:
            found = f"{len(there)} publisher, no message in {SECONDS:g} s"
            volatile = heard.kind == "OccupancyGrid"
            do = "publish it transient local, or give a file" if volatile else "is it active?"
            yield Row(name, found, do)
            return
        if heard.kind == "OccupancyGrid":
            return
        how = there[0].qos_profile.reliability.name.lower().replace("_", " ")
        slow = heard.rate() < _SLOW[heard.kind]
        do = f"raise it to {_SLOW[heard.kind]:g} Hz or more" if slow else ""
        yield Row(name, f"{heard.rate():.1f} Hz, {how}", do)
        age = float(np.median(heard.ages))
        if not seconds_of(heard.messages[-1].header.stamp):
            yield Row(f"{name} stamps", "0", "let the driver set header.stamp")
        elif abs(age) > self.settings.max_age:
            do = "synchronise the clocks, or -p use_sim_time:=true for a bag with /clock"
            yield Row(f"{name} stamps", f"{age:.3g} s old", do)
        else:
            yield Row(f"{name} stamps", f"{age:.2f} s old")

    def mounted(self, k: int) -> tuple[Row, list[LaserScan]]:
        """Where a laser sits, and some of its scans there."""
        heard, base = self.scans[k], self.settings.base_frame
        frame = frame_name(heard.messages[-1].header.frame_id)
        mounts, link = self.settings.mounts, self.frames.at(frame, base, 0.0)
        if mounts is not None:
            link = None
        elif link is None:
            found = f"tf does not say where {frame} sits on {base}"
            do = "publish it, or set the parameter sensor to X,Y,YAW"
            return Row(f"{heard.name} mount", found, do), []
        chosen = [heard.messages[i] for i in evenly(len(heard.messages), _SCANS)]
        at = mounts[k] if mounts is not None else None
        scans = [
            placed(seen_in_msg(one, heard.name), self.settings, heard.name, at, link)
            for one in chosen
        ]
        mount = scans[0].mount
        same = len(chosen) > 1 and len({one.ranges.tobytes() for one in scans}) == 1
        do = "each scan repeats the one before: restart the driver" if same else ""
        if heard.kind == "PointCloud2" and not any(scan.directions for scan in scans):
            do = "no point at this height: is it above the base? are these metres?"
        words = f"{mount.x:g}, {mount.y:g}, {np.rad2deg(mount.theta):.0f} deg by "
        words += "parameter sensor" if link is None else "tf"
        turned = self.settings.flipped if link is None else link[2, 2] < 0
        return Row(f"{heard.name} mount", words + ", flipped" * turned, do), scans


def check_robot(
    ros: Any, words: Sequence[str], settings: Settings, makers: Mapping[str, Maker],
    options: Options,
) -> list[Row]:  # fmt: skip
    """Look at a robot for :data:`SECONDS`; parameters are those of ``run_node``."""
    rows = list[Row]()
    with ros_node(ros, words, settings) as (node, settings, asked):
        ear = _Ear(ros, node, settings, map_topic=not makers)
        executor = ros.executors.SingleThreadedExecutor()
        executor.add_node(node)
        until = time.monotonic() + SECONDS
        while not asked and time.monotonic() < until:
            executor.spin_once(timeout_sec=0.1)
        for heard in ear.scans:
            rows += ear.topic_rows(heard, needed=True)
        rows += ear.topic_rows(ear.odom, needed=False)
        simulated = bool(node.get_parameter("use_sim_time").value)
        if simulated != (clocks := bool(node.count_publishers("/clock"))):
            do = "-p use_sim_time:=true" if clocks else "play the bag with its clock"
            rows.append(Row("/clock", "published" if clocks else "not published", do))
        if not node.count_subscribers("initialpose"):
            name = node.resolve_topic_name("initialpose")
            rows.append(Row(name, "nobody listens", "start AMCL, or remap initialpose"))
        if ear.map is not None:
            rows += ear.topic_rows(ear.map, needed=True)
        known = [ear.mounted(k) for k, heard in enumerate(ear.scans) if heard.messages]
        rows += [row for row, _ in known]
        scans = [scan for _, some in known for scan in some]
    return rows + list(_on_the_map(ear.map, makers, scans, settings, options))


def _on_the_map(
    heard: _Heard | None, makers: Mapping[str, Maker], scans: Sequence[LaserScan],
    settings: Settings, options: Options,
) -> Iterator[Row]:  # fmt: skip
    """The map, and whether the scans fit it: scale and mounting."""
    made = dict[str, MapFeatures]()
    try:
        if heard is not None and heard.messages:
            made[heard.name] = prepare(grid_from_msg(heard.messages[-1], heard.name))
        for name, maker in makers.items():
            made[name] = site_of(maker, name).features
    except ImglocError as error:
        yield Row("map", str(error), "imgloc map check")
    for name, features in made.items():
        yield Row(f"map {name}", str(features.grid).strip("<>"))
        if not scans:
            continue
        answers = [localize(features, scan, options) for scan in scans]
        said = [(answer.verdict, answer.evidence) for answer in answers]
        given = Given(flipped=settings.flipped)
        found = doubts(features, ScanSet(tuple(scans)), said, options, given)
        counts = ", ".join(f"{sum(v == w for v, _ in said)} {w}" for w in
                           dict.fromkeys(v for v, _ in said))  # fmt: skip
        yield Row(f"scans on {name}", counts, "; ".join(doubt.said for doubt in found))
