"""ROS bags, without ROS: ROS 1 ``.bag``, ROS 2 sqlite3 ``.db3`` and ``.mcap``, by rosbags."""

import contextlib
import logging
import math
import re
import sys
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path, PurePath
from typing import Any

import numpy as np

from imgloc.errors import ImglocError, MapError, ScanError
from imgloc.io.badlines import BadLines
from imgloc.io.bagbounds import MAX_METADATA, bounded, largest_chunk, messages_of, metadata
from imgloc.io.clouds import Height, check_height, check_seen, points_of, slice_of
from imgloc.io.files import PathLike, display, is_folder, is_there, open_file, read_file, reason
from imgloc.io.lasers import lasers_of
from imgloc.io.messages import (
    entry_of,
    field,
    frame_name,
    grid_from_msg,
    has_field,
    link_of,
    move_of,
    planar,
    seconds_of,
)
from imgloc.io.scanset import MAX_RAYS, MOUNTED, Entry, ScanSet, ScansSize, check_size, collect
from imgloc.model import OccupancyGrid, Pose2D
from imgloc.options import MAX_BAD
from imgloc.robot.frames import Frames, space_of
from imgloc.robot.odometry import Odometry
from imgloc.robot.recording import SCANS, Recording, Source, frames_of, mounted, pick_odometry

_LOG = logging.getLogger("imgloc")
LASER, ODOMETRY = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/Odometry"
GRID, _CLOUD = "nav_msgs/msg/OccupancyGrid", "sensor_msgs/msg/PointCloud2"
BAG_ENDINGS = (".bag", ".mcap", ".db3")
TF = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
_SHOWN = 8  # topics in a message
_FAR = 1e9  # metres that a robot is from where its odometry began
_SAVES = {".bag": "rosbag reindex", ".mcap": "mcap recover", ".db3": "sqlite3 FILE .recover"}
LEVEL = math.cos(math.radians(5))
_TURNED = math.radians(5)  # by which tf may turn a laser whose place is stated
NO_CLOUDS = "%s: `height` is not used: %s has scans, no clouds of points"
_HINTS = {
    "sensor_msgs/msg/MultiEchoLaserScan": "ros2 run laser_proc laser_proc_node makes scans of them",
}


def read_bag(
    path: PathLike, *, topic: str | None = None, height: Height | None = None, odom: str = "",
    max_bad: float = MAX_BAD,
) -> ScanSet:  # fmt: skip
    """Read the scans of a topic of a bag, with the robot's odometry and the sensor's place.

    `odom` of the set is the robot's pose at the time of each scan, between two poses of the
    odometry that :func:`~imgloc.robot.recording.pick_odometry` picks; NaN where there are none.
    `T_base_laser` is where the scan's frame is in that of the odometry, by the transforms at its
    time; a sensor that hangs upside down is turned over by them. Scans whose place is not known at
    their time, or of a moving laser that is tilted then, are left out, with a warning.

    Parameters
    ----------
    path : path
        A ``.bag``, ``.db3`` or ``.mcap`` file, or the folder of a ROS 2 recording. ScanError if it
        is damaged, or rosbags is not installed (the extra ``ros``).
    topic : str, optional
        Topic with sensor_msgs/LaserScan messages; default ``/scan``, or the only such topic.
        Without any such topic those of sensor_msgs/PointCloud2 are looked at.
    height : (float, float), optional
        Lowest and highest point of the slice of a cloud that is a scan, metres above the sensor.
    odom : str
        Topic or frame of the odometry; empty to pick the one of the robot that has the laser.
    max_bad : float
        Share of the messages, 0 to 1, that may be broken: they are left out, with a warning.
    """
    name, bad = display(path), BadLines(display(path), max_bad, "scans")
    with _opened(path, name) as bag:
        chosen = _choose(bag, topic, name)
        beside = Beside()
        wanted = {chosen, *(t for kind in (ODOMETRY, *TF) for t in _by_type(bag, kind))}
        lasers = tuple(_by_type(bag, LASER)) or tuple(_by_type(bag, _CLOUD))
        maps = tuple(_by_type(bag, GRID))
        connections = [c for c in bag.connections if c.topic in wanted]
        entries, laser, frames = list[Entry](), "", set[str]()
        count = sum(c.msgcount for c in connections if c.topic == chosen)
        readings = most = 0
        for connection, time, data in messages_of(bag, connections):
            message = bag.deserialize(data, connection.msgtype)
            if connection.topic == chosen:
                laser = frame_name(message.header.frame_id)
                frames.add(laser)
                where = f"{name}: {chosen}: message {len(entries)}"
                entry = _entry(message, connection.msgtype, 1e-9 * time, height, where)
                rays = len(entry["ranges"])
                readings += rays
                # Twice what bag_size() says, for lasers whose scans differ, and a scan.
                most = most or (2 * count * readings + MAX_RAYS if readings else 0)
                check_size(len(entries) + 1, rays, where)
                if readings > most > 0:
                    hint = f"expected {count:,} scans like the first; ros2 bag reindex"
                    raise ScanError(f"{where}: {readings:,} readings up to it, {hint}")
                entries.append((where, {**entry, "laser": chosen}))
            else:
                beside.take(connection.topic, message)
    if len(frames) > 1:
        text = (
            "%s: %s: its scans are of several frames, %s: of several lasers? All are taken for %s"
        )
        some = ", ".join(sorted(frames)[:_SHOWN])
        _LOG.warning(text, name, chosen, some, laser, extra={"code": "two-lasers"})
    if height is not None and entries and "angles" in entries[0][1]:
        check_seen([entry for _, entry in entries], height, f"{name}: {chosen}")
    elif height is not None:
        _LOG.warning(NO_CLOUDS, name, chosen, extra={"code": "unused"})
    return beside.scans(entries, laser, Recording(lasers, chosen, maps=maps), odom, bad)


class Beside:
    """Odometry and transforms of a log, in messages that :mod:`imgloc.io.messages` knows."""

    def __init__(self) -> None:
        # By topic, frame and child: seconds, x, y and yaw.
        self.moves = defaultdict[tuple[str, str, str], list[tuple[float, ...]]](list)
        self.frames, self.odd = defaultdict[str, Frames](Frames), 0  # by the topic's namespace

    def take(self, topic: str, message: Any) -> None:
        """Take a message of a topic: a nav_msgs/Odometry, or transforms."""
        if has_field(message, "transforms"):
            for item in field(message, "transforms"):
                child, parent, pose = link_of(item)
                still = topic.endswith("_static")
                stamp = -math.inf if still else seconds_of(field(item, "header.stamp"))
                self.odd += not self.frames[space_of(topic)].add(child, parent, pose, stamp)
            return
        frame, child = field(message, "header.frame_id"), field(message, "child_frame_id")
        self.moves[topic, frame_name(frame), frame_name(child)].append(move_of(message))

    def scans(
        self, entries: Sequence[Entry], laser: str, about: Recording, odom: str, bad: BadLines
    ) -> ScanSet:
        """The set of the scans of a frame `laser`, with what is known beside them."""
        name, frames = bad.name, frames_of(about.taken, self.frames)
        if self.odd:
            _LOG.warning("%s: left out %d transforms, which are not finite", name, self.odd)
        moves = sorted(self.moves.items())
        known = [Source(*of, _odometry(rows, f"{name}: {of[0]}")) for of, rows in moves]
        asked = "" if odom == SCANS else odom
        source, about = pick_odometry(known, frames, laser, about, asked, name, self.frames)
        if odom == SCANS:
            source, about = None, replace(about, odometry="", why="")
        return replace(_assemble(entries, source, frames, laser, bad), recording=about)


def _odometry(moves: Sequence[tuple[float, ...]], name: str) -> Odometry:
    """The poses of an odometry that can be; a warning counts the others."""
    kept = [move for move in moves if all(abs(value) < _FAR for value in move[1:])]
    if left := len(moves) - len(kept):
        text = "%s: left out %d of %d poses of the odometry, which are not finite, or beyond %g m"
        _LOG.warning(text, name, left, len(moves), _FAR)
    table = np.array(kept).reshape(-1, 4)
    return Odometry(table[:, 0], table[:, 1:])


def _entry(
    message: Any, kind: str, received: float, height: Height | None, where: str
) -> dict[str, Any]:
    """The entry of a scan, or of a slice of a cloud."""
    if kind != _CLOUD:
        return entry_of(message, received)
    stamp = seconds_of(message.header.stamp) or received
    return slice_of(points_of(message, where), check_height(height, where)) | {"stamp": stamp}


def bag_size(
    path: PathLike, *, topic: str | None = None, height: Height | None = None
) -> ScansSize:
    """Size of what :func:`read_bag` would read: messages of the topic, readings of its first."""
    name = display(path)
    if topic is not None and len(topics := lasers_of(topic)) > 1:
        sizes = [bag_size(path, topic=t, height=height) for t in topics]
        beside = max(s.file_bytes for s in sizes)
        return ScansSize(sum(s.scans for s in sizes), sum(s.numbers for s in sizes), beside)
    with _opened(path, name) as bag:
        chosen = _choose(bag, topic, name)
        connections = [c for c in bag.connections if c.topic == chosen]
        count = sum(c.msgcount for c in connections)
        readings = 0
        for connection, _, data in messages_of(bag, connections):
            message = bag.deserialize(data, connection.msgtype)
            entry = _entry(message, connection.msgtype, 0.0, height, f"{name}: {chosen}")
            if readings := len(entry["ranges"]):  # the first ones of a laser may be empty
                break
        # Beside the scans: a chunk as it is packed, unpacked and cut, and the robot's poses.
        moves = sum(c.msgcount for c in bag.connections if c.msgtype in (ODOMETRY, *TF))
        beside = 3 * largest_chunk() + 300 * moves
    check_size(count, readings, name)
    return ScansSize(count, 2 * count * readings, beside)


def read_bag_map(path: PathLike) -> OccupancyGrid:
    """The last nav_msgs/OccupancyGrid of a bag: on ``/map``, or the only such topic.

    MapError if there is none, or it is damaged.
    """
    name = display(path)
    try:
        with _opened(path, name) as bag:
            topics, last = _by_type(bag, GRID), None
            wanted = "/map" if "/map" in topics or len(topics) != 1 else next(iter(topics))
            found = [c for c in bag.connections if c.topic == wanted and wanted in topics]
            for connection, _, data in messages_of(bag, found) if found else ():
                last = connection, data
            if last is None:
                there = _some([f"{t} ({n})" for t, n in topics.items()]) or "none"
                hint = "expected a map, then scans; the bag's maps (OccupancyGrid)"
                raise MapError(f"{name}: no map on {wanted}: {hint}: {there}")
            return grid_from_msg(bag.deserialize(last[1], last[0].msgtype), f"{name}: {wanted}")
    except ScanError as error:
        raise MapError(str(error)) from None


def topics_of(path: PathLike) -> list[tuple[str, str, int]]:
    """Topic, type and number of messages of what is in a bag."""
    with _opened(path, display(path)) as bag:
        return [(topic, kind, n) for (topic, kind), n in _counts(bag)]


@contextlib.contextmanager
def _opened(path: PathLike, name: str) -> Iterator[Any]:
    """The bag, open; whatever is wrong with it is a ScanError."""
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        hint = "reading ROS bags needs rosbags: pip install 'imgloc[ros]'"
        raise ScanError(f"{name}: {hint}") from None
    file, parts = _files(Path(path), name)
    if not is_folder(file) and file.suffix not in _SAVES:
        raise ScanError(f"{name}: is a bag, expected a name that ends in {', '.join(_SAVES)}")
    size = 0
    for part in parts:
        if part.suffix == ".db3" and re.search(r"[?#]|%[0-9a-fA-F]{2}", str(part)):
            hint = "rename it: SQLite takes names with ?, # and % for other files"
            raise ScanError(f"{display(part)}: cannot be opened; {hint}")
        with open_file(part, limit=sys.maxsize, error=ScanError, what="bag") as (_, length):
            size += length
    try:
        # Bags of ROS 2 before Iron do not hold what their messages look like.
        store = get_typestore(Stores.ROS2_HUMBLE)
        with bounded(name, size), AnyReader([file], default_typestore=store) as bag:
            yield bag
    except ImglocError:
        raise
    except Exception as e:  # of rosbags, of SQLite, of what unpacks them; lengths that are wrong
        why = "a length beyond any memory" if isinstance(e, MemoryError) else reason(e)
        if "Profile is not ros2" in why:
            raise ScanError(
                f"{name}: no MCAP of ROS 2: let `mcap cat` write its messages as JSON lines"
            ) from None
        hint = f"{_SAVES.get(parts[0].suffix, 'ros2 bag reindex')} may save what is in it"
        raise ScanError(f"{name}: damaged or not a bag ({why}); record it again; {hint}") from None


def _files(file: Path, name: str) -> tuple[Path, list[Path]]:
    """Path that rosbags is to open, and the files that it will read then."""
    if not is_folder(file):
        return file, [file]
    about = file / "metadata.yaml"
    if is_there(about):
        text = read_file(about, limit=MAX_METADATA, error=ScanError, what="recording's metadata")
        said = metadata(text.decode("utf-8", "replace"), display(about))
        info = said.get("rosbag2_bagfile_information") if isinstance(said, dict) else None
        parts = info.get("relative_file_paths") if isinstance(info, dict) else None
        if not isinstance(parts, list) or not parts or not all(isinstance(p, str) for p in parts):
            raise ScanError(f"{display(about)}: names no files, expected relative_file_paths")
        return file, [file / PurePath(part).name for part in parts]  # as rosbags has it
    try:
        inside = sorted(p for p in file.iterdir() if p.suffix in (".db3", ".mcap"))
    except OSError as e:
        raise ScanError(f"{name}: cannot be opened: {e.strerror}") from None
    if len(inside) != 1:
        found = f"a folder with {len(inside)} .db3 or .mcap files and no metadata.yaml"
        raise ScanError(f"{name}: {found}, expected a recording: ros2 bag reindex makes it one")
    return inside[0], inside


def _by_type(bag: Any, kind: str) -> dict[str, int]:
    """Topics of a type, and how many messages each has."""
    return {topic: n for (topic, type_), n in _counts(bag) if n and type_ == kind}


def _counts(bag: Any) -> list[tuple[tuple[str, str], int]]:
    """Topics with their types, and how many messages each has."""
    counts = Counter[tuple[str, str]]()
    for c in bag.connections:
        counts[c.topic, c.msgtype] += c.msgcount
    return sorted(counts.items())


def _choose(bag: Any, topic: str | None, name: str) -> str:
    """The topic asked for, else /scan, else the only one."""
    topics, clouds = _by_type(bag, LASER), _by_type(bag, _CLOUD)
    if not topics or (topic is not None and topic.strip("/") in {t.strip("/") for t in clouds}):
        topics = clouds
    if not topics:
        kinds = sorted({c.msgtype for c in bag.connections if c.msgcount})
        hint = next((f"; {_HINTS[kind]}" for kind in kinds if kind in _HINTS), "")
        raise ScanError(f"{name}: no sensor_msgs/LaserScan in it, but {_some(kinds)}{hint}")
    return choose_topic(topics, topic, name)


def choose_topic(topics: Mapping[str, int], topic: str | None, name: str) -> str:
    """The topic of scans that is asked for, else /scan, else the only one.

    ScanError, by the `name` of the log, if there is none; `topics` counts the scans of each.
    """
    there = _some([f"{t} ({n})" for t, n in topics.items()])
    if topic is not None:
        match = [t for t in topics if t.strip("/") == topic.strip("/")]
        if not match:
            raise ScanError(f"{name}: no scans on {topic}; it has {there}")
        return topic if topic in match else match[0]  # laser is not /laser where both are
    if "/scan" not in topics and len(topics) > 1:
        raise ScanError(f"{name}: scans of several lasers, pass `topic`, one of {there}")
    return "/scan" if "/scan" in topics else next(iter(topics))


def _some(names: Sequence[str]) -> str:
    """The first names of a list that may be long."""
    more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    return ", ".join(name[:80] for name in names[:_SHOWN]) + more


def _assemble(
    entries: Sequence[Entry], source: Source | None, frames: Frames, laser: str, bad: BadLines
) -> ScanSet:
    """The set of the scans, with the odometry at their times, on a sensor that sits so."""
    name = bad.name
    stamps = np.array([entry["stamp"] for _, entry in entries], float)
    odom = None if source is None else source.odometry.along(stamps)
    if odom is None and source is not None and len(source.odometry):
        _LOG.warning("%s: its odometry does not cover the time of its scans, and is ignored", name)
    mounts = mounted(frames, laser, source.child if source else "", stamps)
    poses = [None if mounts is None else mounts.get(t) for t in stamps.tolist()]
    stated = MOUNTED.get() is not None
    level = [stated if pose is None else abs(pose[2, 2]) >= LEVEL for pose in poses]
    yaws = [planar(pose)[2] for pose in (mounts or {}).values()]
    if stated and yaws and (turned := float(np.ptp(np.unwrap(yaws)))) > _TURNED:
        hint = "expected a place that stays; leave `sensor` out, and tf gives it"
        by = f"{math.degrees(turned):.0f} degrees"
        raise ScanError(f"{name}: `sensor`: tf turns {laser} by {by} along the log, {hint}")
    if mounts is not None:
        if not any(level) and mounts:
            _LOG.warning("%s: its laser is tilted in tf; imgloc takes scans for level", name)
            level = [pose is not None for pose in poses]
        if left := len(level) - sum(level):
            lacking = 0 if stated else sum(pose is None for pose in poses)
            said = {"tf does not tell where the laser was": lacking,
                    "it was tilted by more than 5 degrees": left - lacking}  # fmt: skip
            why = ", ".join(f"at {n} {text}" for text, n in said.items() if n)
            _LOG.warning("%s: left out %d of %d scans: %s", name, left, len(level), why)
    whole: list[Entry] = []
    for k, (where, entry) in enumerate(entries):
        pose, more = poses[k], {} if odom is None else {"odom": odom[k]}
        if mounts is not None and not level[k]:
            continue
        if pose is not None:
            more["mount"] = Pose2D(*planar(pose))
            if pose[2, 2] < 0:  # its angles run clockwise
                keys = ("angle_min", "angle_max", "angle_increment", "angles")
                more |= {key: -entry[key] for key in keys if key in entry}
        whole.append((where, {**entry, **more}))
    if entries and not whole:
        hint = "; or pass `sensor`"
        raise ScanError(f"{name}: tf never tells where {laser} is at the time of a scan{hint}")
    return collect(whole, name, bad)
