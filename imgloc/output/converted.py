"""Scans in the form of another file: CSV, JSON lines, NPZ, or MCAP with the messages of ROS 2.

All are read back by :func:`imgloc.load_scans`.

>>> from imgloc.model import LaserScan
>>> print(csv_of(ScanSet((LaserScan([1.0, np.inf], [0.0, 0.5], 0.1, 9.0),))), end="")
# angle_min=0.0, angle_max=0.5, range_min=0.1, range_max=9.0
r0,r1
1.0,inf
"""

import json
import math
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from imgloc.errors import ConfigError
from imgloc.io.bags import LASER, ODOMETRY, TF
from imgloc.io.files import PathLike, display, write_bytes_atomic
from imgloc.io.lasers import frame_of, scan_topics
from imgloc.io.messages import header_fields, link_fields, pose_fields, scan_to_msg
from imgloc.io.scans import write_npz
from imgloc.io.scanset import ScanSet
from imgloc.model import Pose2D
from imgloc.output.ros import Bag
from imgloc.output.rows import scan_row

_ANY = "JSON lines can contain such scans: end the name in .jsonl"


def convert(scans: ScanSet, path: PathLike, *, force: bool = False) -> None:
    """Write scans in the form that the ending of the name stands for; see :data:`FORMS`.

    Raises
    ------
    ConfigError
        If the form cannot hold these scans, or there is no such form.
    OutputError
        If there is a file already, unless `force`, or it cannot be written.
    """
    form = FORMS.get(Path(path).suffix.lower())
    if form is None:
        raise ConfigError(f"{display(path)}: expected a name that ends in {', '.join(FORMS)}")
    data = form(scans)
    write_bytes_atomic(path, data if isinstance(data, bytes) else data.encode(), force=force)


def csv_of(scans: ScanSet) -> str:
    """One scan a line of one laser; ConfigError if angles or limits differ, or are not even."""
    first = scans[0]
    if len(scans.lasers) > 1:
        raise ConfigError(f"CSV: no column names the laser, and there are several; {_ANY}")
    about = [(scan.range_min, scan.range_max, scan.time_increment) for scan in scans.scans]
    even = np.linspace(first.angles[0], first.angles[-1], len(first.angles))
    alike = all(np.array_equal(scan.angles, first.angles) for scan in scans.scans)
    if not alike or len(set(about)) > 1 or not np.allclose(first.angles, even, atol=1e-6):
        raise ConfigError(f"CSV: one line has angles and limits for all scans; {_ANY}")
    keys = ("range_min", "range_max", "time_increment")
    said = {"angle_min": float(first.angles[0]), "angle_max": float(first.angles[-1])}
    said |= {key: float(v) for key, v in zip(keys, about[0], strict=True) if v and v != math.inf}
    beside = {
        "stamp": scans.stamps,
        "x,y,theta": scans.poses,
        "odom_x,odom_y,odom_theta": scans.odom,
    }
    there = {key: array for key, array in beside.items() if array is not None}
    lines = ["# " + ", ".join(f"{key}={value}" for key, value in said.items())]
    lines.append(",".join([*there, *(f"r{k}" for k in range(len(first.ranges)))]))
    table = np.column_stack([*there.values(), np.stack([scan.ranges for scan in scans.scans])])
    return "\n".join([*lines, *(",".join(map(repr, row)) for row in table.tolist())]) + "\n"


def jsonl_of(scans: ScanSet) -> str:
    """An object a line, with the names of sensor_msgs/LaserScan."""
    return "".join(f"{json.dumps(scan_row(scans, k))}\n" for k in range(len(scans)))


def mcap_of(scans: ScanSet) -> bytes:
    """A recording of ROS 2 with /scan, and /odom and /tf_static where they are known.

    Of several lasers each has a topic and a frame of its own. A log without stamps has a scan
    a second. Known poses have no topic.
    """
    topics = scan_topics(scans.lasers)
    seen = {(scan.laser, scan.T_base_laser) for scan in scans.scans}
    places, placed = Counter(laser for laser, _ in seen), set[str]()
    with Bag() as bag:
        for k, scan in enumerate(scans.scans):
            seconds = scan.stamp if math.isfinite(scan.stamp) else float(k + 1)
            topic, mount = topics[scan.laser], scan.T_base_laser
            frame = "laser" if len(topics) == 1 else frame_of(topic)
            bag.write(topic, LASER, seconds, scan_to_msg(replace(scan, stamp=seconds), frame))
            moves = places[scan.laser] > 1
            if mount is not None and (moves or topic not in placed):
                placed.add(topic)
                link = link_fields(mount, header_fields(seconds, "base_link"), frame)
                bag.write("/tf" if moves else "/tf_static", TF[0], seconds, {"transforms": [link]})
            if scans.odom is not None and np.isfinite(scans.odom[k]).all():
                pose = {"pose": pose_fields(Pose2D(*scans.odom[k]))}
                about = {"header": header_fields(seconds, "odom"), "child_frame_id": "base_link"}
                bag.write("/odom", ODOMETRY, seconds, about | {"pose": pose})
        return bag.content()


FORMS: Mapping[str, Callable[[ScanSet], str | bytes]] = {
    ".csv": csv_of, ".jsonl": jsonl_of, ".npz": write_npz, ".mcap": mcap_of,
}  # fmt: skip
"""What makes the bytes or the text of each form, by the ending of the name."""
