"""Plays a map and a log to ROS 2 in the log's own time: map, odom, and a laser or two."""

import json
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from imgloc import ConfigError, LaserScan, OccupancyGrid, Pose2D, ScanSet
from imgloc.io.messages import pose_fields
from imgloc.live.messages import fill
from imgloc.model import FloatArray, base_of, compose
from imgloc.simulation.scans import simulate_ranges
from imgloc.simulation.worlds import WORLDS, render

DISTURBED = ("nan", "empty", "short", "unstamped", "ahead")
"""What every other scan may be instead of itself."""
# Seconds that a scan and its odometry may be stamped ahead, and by how many fewer the next one:
# two in a row are no clock that is ahead, even if the scan between them is lost.
_AHEAD, _FEWER = 3600, 2
FROZEN = ("stamp", "ranges")
"""What each scan may have of the first one: its stamp and ranges, or its ranges alone."""


@dataclass(frozen=True)
class Playing:
    """How a log is played."""

    lasers: int = 1  #: two: the front half of each scan is a laser, the rear half another one
    cloud: bool = False  #: of points, on /points: walls, and a floor before them
    best_effort: bool = False
    disturb: Sequence[str] = ("",)  #: some of `DISTURBED`, in turns
    freeze: str = ""  #: one of `FROZEN`
    clock: bool = False  #: the recorded stamps with a clock, not those of now
    first: int = 0  #: scan to begin with
    count: int = 0  #: scans to play; 0: all
    times: int = 1  #: how often, one after the other
    amcl: Path | None = None  #: true poses on /amcl_pose, 3 m off once there is this file


WORLD, START = "double_wall", Pose2D(18.3, 3.1, -0.05)
"""The bundled world of the robot that is not there, and where it starts."""
_ANGLES = np.deg2rad(np.arange(-180, 180, 1.0))
_REACH, _STEP, _WAY, _SCANS = 12.0, 0.04, 1.0, 1200  # metres; two minutes of a scan each 0.1 s


def to_and_fro(mount: Pose2D | None = None) -> ScanSet:
    """A robot drives a metre to and fro; the poses of its laser, which sits at `mount`, are known.

    Odometry is as it drives. Scans have 2 cm of noise.
    """
    mount = mount or Pose2D(0.0, 0.0)
    along = np.abs((_STEP * np.arange(_SCANS) + _WAY) % (2 * _WAY) - _WAY)
    odom = np.column_stack((along, 0 * along, 0 * along))
    laser = [compose(START, compose(Pose2D(d, 0.0), mount)) for d in along.tolist()]
    poses = np.array([(pose.x, pose.y, pose.theta) for pose in laser])
    fine = render(WORLDS[WORLD](), 0.02)
    ranges = simulate_ranges(fine, poses, _ANGLES, seed=3, range_max=_REACH)
    scans = tuple(LaserScan(r, _ANGLES, range_max=_REACH, T_base_laser=mount) for r in ranges)
    return ScanSet(scans, poses, 1000 + 0.1 * np.arange(float(_SCANS)), odom)


def topics_of(lasers: int) -> tuple[str, ...]:
    """The topics of the lasers."""
    return ("scan",) if lasers == 1 else ("front", "rear")


class Player:
    """A node that plays."""

    def __init__(self, ros: Any, node: Any, how: Playing, said: TextIO | None = None) -> None:
        self._ros, self._node, self._how, self._said = ros, node, how, said
        qos = ros.qos
        kind = (
            qos.ReliabilityPolicy.BEST_EFFORT if how.best_effort else qos.ReliabilityPolicy.RELIABLE
        )
        sensor = qos.QoSProfile(depth=10, reliability=kind)
        latched = qos.QoSProfile(depth=1, durability=qos.DurabilityPolicy.TRANSIENT_LOCAL)
        self._map = node.create_publisher(ros.nav_msgs.OccupancyGrid, "map", latched)
        self._odom = node.create_publisher(ros.nav_msgs.Odometry, "odom", sensor)
        self._frozen = dict[Any, Any]()  # the first message of each publisher
        kind, topics = ros.sensor_msgs.LaserScan, topics_of(how.lasers)
        if how.cloud:
            kind, topics = ros.sensor_msgs.PointCloud2, ("points",)
        self._scans = [node.create_publisher(kind, topic, sensor) for topic in topics]
        self._amcl: Any = None
        if how.amcl is not None:
            kind = ros.geometry_msgs.PoseWithCovarianceStamped
            self._amcl = node.create_publisher(kind, "amcl_pose", sensor)
        self._clock = None
        if how.clock:
            import importlib

            clock = importlib.import_module("rosgraph_msgs.msg").Clock
            self._clock = (node.create_publisher(clock, "/clock", 10), clock)

    def show(self, grid: OccupancyGrid) -> None:
        """Publish a map."""
        cells = np.full(grid.occupied.shape, -1, np.int8)
        cells[grid.free], cells[grid.occupied] = 0, 100
        info = {
            "resolution": float(grid.resolution), "width": grid.info.width,
            "height": grid.info.height,
            "origin": pose_fields(grid.origin),
        }  # fmt: skip
        message = fill(self._ros.nav_msgs.OccupancyGrid(), {"info": info})
        message.header.frame_id = "map"
        message.header.stamp = self._node.get_clock().now().to_msg()
        message.data.frombytes(cells.tobytes())
        self._map.publish(message)

    def play(self, log: ScanSet, then: Sequence[OccupancyGrid] = (), after: float = 0.0) -> None:
        """Play the scans and the odometry of a log, in its time; `after` seconds come more maps."""
        if log.stamps is None:
            raise ConfigError("the log has no stamps, in whose time it could be played")
        how = self._how
        last = len(log) if not how.count else min(len(log), how.first + how.count)
        maps = list(then)
        for _ in range(how.times):
            begin, since = time.time(), time.monotonic()
            for k in range(how.first, last):
                late = float(log.stamps[k] - log.stamps[how.first])
                time.sleep(max(0.0, late - (time.monotonic() - since)))
                if maps and late >= after:
                    self.show(maps.pop(0))
                stamp = float(log.stamps[k]) if how.clock else begin + late
                if how.amcl is not None and log.poses is not None:
                    pose = base_of(Pose2D(*log.poses[k]), log[k].mount)
                    off = 3.0 * how.amcl.exists()
                    self._amcl.publish(self._claim(replace(pose, x=pose.x + off), stamp))
                self._step(k, log[k], None if log.odom is None else log.odom[k], stamp)

    def _claim(self, pose: Pose2D, stamp: float) -> Any:
        at = {"sec": math.floor(stamp), "nanosec": round(999_999_999 * (stamp % 1.0))}
        message = self._ros.geometry_msgs.PoseWithCovarianceStamped()
        fill(message, {"header": {"stamp": at, "frame_id": "map"}})
        return fill(message, {"pose": {"pose": pose_fields(pose)}})

    def _step(self, k: int, scan: LaserScan, odom: FloatArray | None, stamp: float) -> None:
        whole = math.floor(stamp)
        at = {"sec": whole, "nanosec": min(999_999_999, round(1e9 * (stamp - whole)))}
        wrong = self._how.disturb[k // 2 % len(self._how.disturb)] if k % 2 else ""
        if self._clock is not None:
            publisher, kind = self._clock
            publisher.publish(fill(kind(), {"clock": at}))
        if wrong == "ahead":
            at["sec"] += _AHEAD - _FEWER * k
        if odom is not None:
            message = fill(self._ros.nav_msgs.Odometry(), {"child_frame_id": "base_link"})
            fill(message, {"header": {"stamp": at, "frame_id": "odom"}})
            fill(message, {"pose": {"pose": pose_fields(Pose2D(*odom))}})
            self._odom.publish(message)
        for publisher, part in zip(self._scans, _parts(scan, self._how.lasers), strict=True):
            make = _cloud if self._how.cloud else _message
            message = make(self._ros, part, at, wrong)
            first = self._frozen.setdefault(publisher, message)
            if self._how.freeze:
                message.ranges = first.ranges
            publisher.publish(first if self._how.freeze == "stamp" else message)
        if self._said is not None:
            said = {"index": k, "stamp": at["sec"] + 1e-9 * at["nanosec"], "disturbed": wrong}
            self._said.write(json.dumps(said) + "\n")
            self._said.flush()


def _parts(scan: LaserScan, lasers: int) -> Iterator[LaserScan]:
    """The scan of each laser, in its own frame."""
    if lasers == 1:
        yield scan
        return
    n = len(scan.ranges)
    for first, turn in ((n // 4, 0.0), (n // 4 + n // 2, math.pi)):
        k = np.arange(first, first + n // 2) % n
        angles = np.unwrap(scan.angles[k]) - turn
        yield LaserScan(scan.ranges[k], angles, scan.range_min, scan.range_max)


def _message(ros: Any, scan: LaserScan, at: dict[str, int], wrong: str) -> Any:
    ranges = scan.ranges.copy()
    if wrong == "unstamped":
        at = {"sec": 0, "nanosec": 0}
    elif wrong == "nan":
        ranges[:] = np.nan
    elif wrong in ("empty", "short"):
        ranges = ranges[: 0 if wrong == "empty" else 4]
    fields = {
        "angle_min": float(scan.angles[0]), "angle_max": float(scan.angles[-1]),
        "angle_increment": float(np.mean(np.diff(scan.angles))),
        "range_min": float(scan.range_min), "range_max": float(scan.range_max),
        "ranges": ranges.astype(np.float32).tolist(),
        "header": {"stamp": at, "frame_id": "laser"},
    }  # fmt: skip
    return fill(ros.sensor_msgs.LaserScan(), fields)


def _cloud(ros: Any, scan: LaserScan, at: dict[str, int], _: str) -> Any:
    there, kind = scan.ranges[scan.valid], ros.sensor_msgs.PointField
    xy = there[:, None] * np.column_stack((np.cos(a := scan.angles[scan.valid]), np.sin(a)))
    layers = [(xy, 0.3), (xy, 0.2), (0.5 * xy, -0.1)]
    points = np.concatenate([np.insert(at, 2, z, axis=1) for at, z in layers]).astype(np.float32)
    message = ros.sensor_msgs.PointCloud2(height=1, width=len(points), point_step=12)
    message.fields = [kind(name=n, offset=4 * k, datatype=7, count=1) for k, n in enumerate("xyz")]
    message.data.frombytes(points.tobytes())
    return fill(message, {"header": {"stamp": at, "frame_id": "lidar"}})


def write_to(path: Path | None) -> TextIO | None:
    """A file that lines are added to; None for none."""
    return None if path is None else path.open("a", encoding="utf-8")
