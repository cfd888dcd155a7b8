"""A robot that runs, looked at for some seconds: what is wrong with its topics, and what to do."""

import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from imgloc.answers.causes import Given
from imgloc.answers.logcheck import check_log, on_map
from imgloc.errors import ImglocError, ScanError
from imgloc.features.mapfeatures import MapFeatures
from imgloc.io.clouds import Cloud, seen_in_msg
from imgloc.io.messages import frame_name, grid_from_msg, link_of, move_of, seconds_of
from imgloc.io.scanset import ScanSet
from imgloc.live.node import placed, ros_node
from imgloc.live.settings import Settings
from imgloc.live.sites import Maker, site_of
from imgloc.model import LaserScan
from imgloc.options import Options
from imgloc.pipeline import prepare
from imgloc.robot.frames import Frames
from imgloc.robot.odometry import Odometry

SECONDS = 10.0
"""How long is listened."""
_KEPT = 30  # messages of a topic: clouds are large
# Messages a second at least; a localizer that is watched may be silent while the robot stands.
_SLOW = {"LaserScan": 1.0, "PointCloud2": 1.0, "Odometry": 5.0, "PoseWithCovarianceStamped": 0.0}


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
    kept: float = -np.inf  # monotonic seconds of the last one of them
    times: list[float] = field(default_factory=list)  # monotonic seconds
    ages: list[float] = field(default_factory=list)  # seconds of the stamps


class Ear:
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
        kind, of = "PoseWithCovarianceStamped", settings.watch * (settings.watch != "tf")
        self.watched = self._hear("geometry_msgs", kind, of, sensor) if of else None
        if ros.tf2_msgs is not None:
            still = qos.QoSProfile(depth=100, durability=latched.durability)
            for topic, how in (("/tf", 100), ("/tf_static", still)):
                node.create_subscription(ros.tf2_msgs.TFMessage, topic, self.on_transforms, how)

    def _hear(self, package: str, kind: str, topic: str, qos: Any) -> _Heard:
        heard = _Heard(str(self.node.resolve_topic_name(topic)), kind)
        type_ = getattr(getattr(self.ros, package), kind)
        self.node.create_subscription(type_, topic, partial(self.hear, heard), qos)
        return heard

    def hear(self, heard: _Heard, message: Any) -> None:
        """Take a message of a topic."""
        now = float(self.node.get_clock().now().nanoseconds) * 1e-9
        heard.times.append(here := time.monotonic())
        heard.ages.append(now - seconds_of(message.header.stamp))
        if here - heard.kept >= SECONDS / _KEPT:  # they are of all the time
            heard.kept = here
            heard.messages.append(message)

    def on_transforms(self, message: Any) -> None:
        """Take links of tf."""
        for item in message.transforms:
            child, parent, pose = link_of(item)
            self.frames.add(child, parent, pose)

    def topic_rows(self, heard: _Heard, *, needed: bool) -> Iterator[Row]:
        """Publishers, type, rate and clock of a topic."""
        name, is_map = heard.name, heard.kind == "OccupancyGrid"
        there = self.node.get_publishers_info_by_topic(name)
        like = [t for t, kinds in self.node.get_topic_names_and_types() if t != name
                and any(k.endswith(heard.kind) for k in kinds)
                and self.node.count_publishers(t)]  # fmt: skip
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
            do = "publish it transient local, or give a file" if is_map else "is it active?"
            yield Row(name, found, do)
        if is_map or not heard.times:
            return
        how = there[0].qos_profile.reliability.name.lower().replace("_", " ")
        rate = (len(heard.times) - 1) / max(heard.times[-1] - heard.times[0], 1e-6)
        do = f"raise it to {_SLOW[heard.kind]:g} Hz or more" * (rate < _SLOW[heard.kind])
        yield Row(name, f"{rate:.1f} Hz, {how}", do)
        age, do = float(np.median(heard.ages)), ""
        if unstamped := not seconds_of(heard.messages[-1].header.stamp):
            do = "let the driver set header.stamp"
        elif abs(age) > self.settings.max_age:
            do = "synchronise the clocks, or -p use_sim_time:=true for a bag with /clock"
        yield Row(f"{name} stamps", "0" if unstamped else f"{round(age, 2):.3g} s old", do)

    def mounted(self, k: int) -> tuple[list[Row], list[LaserScan]]:
        """Where a laser sits, and its scans there."""
        heard, base, seen = self.scans[k], self.settings.base_frame, list[LaserScan | Cloud]()
        rows, bad, wrong = list[Row](), 0, ""
        for message in heard.messages:
            try:
                seen.append(seen_in_msg(message, heard.name))
            except ScanError as error:
                bad, wrong = bad + 1, str(error).removeprefix(f"{heard.name}: ")
        if bad:
            rows.append(Row(heard.name, f"{bad} of {len(heard.messages)} are no scans", wrong))
        frame = frame_name(heard.messages[-1].header.frame_id)
        at = None if (mounts := self.settings.mounts) is None else mounts[k]
        link = self.frames.at(frame, base, 0.0) if at is None else None
        if at is None and link is None:
            found = f"tf does not say where {frame} sits on {base}"
            do = "publish it, or set the parameter sensor to X,Y,YAW"
            return [*rows, Row(f"{heard.name} mount", found, do)], []
        scans = [placed(one, self.settings, heard.name, at, link) for one in seen]
        if not scans:
            return rows, []
        mount = scans[0].mount
        same = len(scans) > 1 and len({one.ranges.tobytes() for one in scans}) == 1
        do = "each scan repeats the one before: restart the driver" if same else ""
        if heard.kind == "PointCloud2" and not any(scan.directions for scan in scans):
            do = "no point at this height: is it above the base? are these metres?"
        words = f"{mount.x:g}, {mount.y:g}, {np.rad2deg(mount.theta):.0f} deg by "
        words += "parameter sensor" if link is None else "tf"
        turned = self.settings.flipped if link is None else bool(link[2, 2] < 0)
        return [*rows, Row(f"{heard.name} mount", words + ", flipped" * turned, do)], scans

    def poses_rows(self) -> Iterator[Row]:
        """Rows of those who take poses of the node, or of the localizer that it watches."""
        if self.watched is not None:
            yield from self.topic_rows(self.watched, needed=True)
        elif self.settings.watch:
            base, frame = self.settings.base_frame, self.settings.map_frame
            do = f"let the localizer publish {frame} -> odom, and the odometry odom -> {base}"
            lacks = self.frames.at(base, frame, 0.0) is None
            yield Row(f"tf {frame} -> {base}", "not " * lacks + "published", do * lacks)
        else:
            name = self.node.resolve_topic_name("initialpose")
            if not self.node.count_subscribers(name):
                yield Row(name, "nobody listens", "start AMCL, or remap initialpose")

    def log(self, scans: Sequence[LaserScan]) -> ScanSet:
        """Scans with the odometry of their times, in order."""
        some = sorted(scans, key=lambda scan: scan.stamp)
        moved = np.reshape([move_of(message) for message in self.odom.messages], (-1, 4))
        moves = Odometry(moved[:, 0], moved[:, 1:])
        stamps, unknown = [scan.stamp for scan in some], np.full(3, np.nan)
        odom = np.array([unknown if (at := moves.at(one)) is None else at for one in stamps])
        known = odom.reshape(-1, 3) if len(moves) else None
        return ScanSet(tuple(some), None, np.array(stamps), known)


def check_robot(
    ros: Any, words: Sequence[str], settings: Settings, makers: Mapping[str, Maker],
    options: Options,
) -> list[Row]:  # fmt: skip
    """Look at a robot for :data:`SECONDS`; parameters are those of ``run_node``."""
    rows = list[Row]()
    with ros_node(ros, words, settings) as (node, settings, asked):
        ear = Ear(ros, node, settings, map_topic=not makers)
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
        rows += ear.poses_rows()
        if ear.map is not None:
            rows += ear.topic_rows(ear.map, needed=True)
        known = [ear.mounted(k) for k, heard in enumerate(ear.scans) if heard.messages]
        rows += [row for some, _ in known for row in some]
        log = ear.log([scan for _, some in known for scan in some])
    return rows + list(_on_the_map(ear.map, makers, log, settings, options))


def _on_the_map(
    heard: _Heard | None, makers: Mapping[str, Maker], log: ScanSet, settings: Settings,
    options: Options,
) -> Iterator[Row]:  # fmt: skip
    """The map, and whether scans fit it and the odometry: scale and mounting."""
    made = dict[str, MapFeatures]()
    try:
        if heard is not None and heard.messages:
            made[heard.name] = prepare(grid_from_msg(heard.messages[-1], heard.name))
        made |= {name: site_of(maker, name).features for name, maker in makers.items()}
    except ImglocError as error:
        yield Row("map", str(error), "imgloc map check")
    for name, features in made.items():
        yield Row(f"map {name}", str(features.grid).strip("<>"))
    if not len(log):
        return
    given = Given(flipped=settings.flipped)
    alone = check_log(log, given=given)
    reports = {name: on_map(alone, log, of, options, given) for name, of in made.items()}
    on = {name: report.facts["on_map"] for name, report in reports.items()}
    there = {name for name, counts in on.items() if 2 * counts["unique"] > sum(counts.values())}
    for name, report in reports.items():  # on other floors they need not fit
        found = [] if there and name not in there else report.findings
        words = ", ".join(f"{n} {verdict}" for verdict, n in on[name].items() if n)
        more = "; ".join(one.said for one in found if one not in alone.findings and one.serious)
        yield Row(f"scans on {name}", words or "none sees enough", more)
    told = [one for one in alone.findings if one.serious or one.code in ("few", "disagree")]
    share = alone.facts["agreement"]
    words = "no odometry" if log.odom is None else "too few readings, or too little motion"
    words = words if share is None else f"{share:.0%} of the readings agree"
    held = (f.said for f in told if all(f in of.findings for of in reports.values()))
    yield Row("scans and odometry", words, "; ".join(held))
