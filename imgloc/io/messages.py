"""ROS messages as what flows through imgloc: scans, maps, poses, odometry, transforms.

A message is any object with the fields of its type: one of rclpy, one of rosbags, or a mapping, as
``ros2 topic echo`` prints it and JSON holds it.
"""

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np

from imgloc.errors import ConfigError, ImglocError, MapError, ScanError, expect
from imgloc.io.mapyaml import RESOLUTION_RANGE
from imgloc.io.scanset import collect
from imgloc.model import FloatArray, LaserScan, OccupancyGrid, Pose2D
from imgloc.numbers import number

_SPACING = ("angle_min", "angle_max", "angle_increment", "range_min", "range_max")
FREE, OCCUPIED = 19.6, 65.0
"""Occupancies of a cell, per cent, up to which it is free and from which it is a wall: the
thresholds that ROS's map_saver writes beside a map."""
_MOST = 100  # per cent
_FAR = 1e9  # metres that a map lies from its frame
_LONGEST = number("messages.longest")  # seconds of a sweep
_UNEVEN = 1e-3  # of the step between two rays, by which one may be off


def field(message: Any, path: str) -> Any:
    """The field of a message, or of a mapping, at a path with dots.

    Examples
    --------
    >>> field({"header": {"frame_id": "map"}}, "header.frame_id")
    'map'
    """
    for name in path.split("."):
        message = message[name] if isinstance(message, Mapping) else getattr(message, name)
    return message


@contextmanager
def fields_of(error: type[ImglocError], name: str) -> Iterator[None]:
    """Any field that is missing, or of another kind, is an `error` about the message `name`."""
    try:
        yield
    except (KeyError, AttributeError) as e:
        key = e.args[0] if isinstance(e, KeyError) else e.name
        raise error(f"{name}: it has no field {key!r}") from None
    except (TypeError, ValueError, OverflowError) as e:
        raise error(f"{name}: a field is of another kind: {e}") from None


def entry_of(message: Any, received: float) -> dict[str, Any]:
    """A sensor_msgs/LaserScan as other files hold it; its stamp, or when it was received."""
    entry: dict[str, Any] = {key: float(field(message, key)) for key in _SPACING}
    ranges = np.asarray(field(message, "ranges"), dtype=np.float64)
    pace = float(field(message, "time_increment")) if has_field(message, "time_increment") else 0.0
    if 0 < pace * len(ranges) <= _LONGEST:  # some drivers write the time since the last scan
        entry["time_increment"] = pace
    return entry | {
        "ranges": ranges,
        "stamp": seconds_of(field(message, "header.stamp")) or received,
    }


def scan_from_msg(
    message: Any, name: str = "scan", mount: Pose2D | None = None, received: float = math.nan
) -> LaserScan:
    """The scan of a sensor_msgs/LaserScan: of rclpy, rospy or rosbags, or a mapping of its fields.

    Parameters
    ----------
    message : object or mapping
    name : str
        What errors call it.
    mount : Pose2D, optional
        Where the sensor sits on the robot.
    received : float
        Seconds: the stamp of a scan that has none.

    Raises
    ------
    ScanError
        If a field is missing or of another kind, it has no readings, or its angles and limits
        contradict each other.

    Examples
    --------
    >>> stamp = {"sec": 5, "nanosec": 500_000_000}
    >>> message = {"header": {"stamp": stamp, "frame_id": "laser"}, "angle_min": -0.5,
    ...            "angle_max": 0.5, "angle_increment": 0.5, "range_min": 0.1, "range_max": 9.0,
    ...            "ranges": [1.0, 2.0, float("inf")]}
    >>> scan_from_msg(message), scan_from_msg(message).stamp
    (<LaserScan of 3 rays, 2 valid: -28.65 to 28.65 deg, 1 to 2 m of at most 9>, 5.5)
    """
    with fields_of(ScanError, name):
        entry = entry_of(message, received) | {"mount": mount}
    return collect([(name, entry)], name)[0]


def grid_from_msg(message: Any, name: str = "map") -> OccupancyGrid:
    """The map of a nav_msgs/OccupancyGrid: free up to :data:`FREE`, a wall from :data:`OCCUPIED`.

    Anything between, or below 0, is unknown.

    Raises
    ------
    MapError
        If a field is missing or of another kind, width, height and data do not agree, or
        resolution or origin cannot be.

    Examples
    --------
    >>> pose = {"position": {"x": 1.0, "y": 2.0, "z": 0.0},
    ...         "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
    >>> info = {"resolution": 0.5, "width": 3, "height": 1, "origin": pose}
    >>> grid_from_msg({"info": info, "data": [0, 100, -1]})
    <OccupancyGrid 3 x 1 cells of 0.5 m: 1.5 x 0.5 m, 33.3% occupied, 33.3% free>
    """
    with fields_of(MapError, name):
        width, height = (int(field(message, f"info.{key}")) for key in ("width", "height"))
        data = np.asarray(field(message, "data"))
        with np.errstate(invalid="ignore"):
            cells = data.astype(np.int8)
        if (cells != data).any():
            raise MapError(f"{name}: data: expected whole numbers, -1 to 100")
        resolution = float(field(message, "info.resolution"))
        origin = pose_of(field(message, "info.origin"))
    if not (width > 0 < height and data.size == width * height):
        raise MapError(f"{name}: {data.size:,} cells, expected {width:,} x {height:,} and some")
    low, high = RESOLUTION_RANGE
    if not 0.999 * low <= resolution <= high:  # a float32
        raise MapError(
            f"{name}: info.resolution: got {resolution:g}, expected metres, {low:g} to {high:g}"
        )
    if not all(abs(value) < _FAR for value in origin):
        raise MapError(f"{name}: info.origin: got {list(origin)}, expected finite metres and a yaw")
    cells = cells.reshape(height, width)
    free, occupied = (cells >= 0) & (cells <= FREE), (cells >= OCCUPIED) & (cells <= _MOST)
    # A float32: 0.05 is not 0.05000000074505806.
    resolution = float(np.format_float_positional(np.float32(resolution)))
    return OccupancyGrid(occupied, free, resolution, origin)


def scan_to_msg(scan: LaserScan, frame_id: str = "laser") -> dict[str, Any]:
    """The fields of a sensor_msgs/LaserScan, as :func:`scan_from_msg` reads them.

    ``rosidl_runtime_py.set_message_fields(message, fields)`` puts them into a message of rclpy.

    Parameters
    ----------
    scan : LaserScan
        Its angles are evenly spaced.
    frame_id : str
        Name of the sensor's frame.

    Raises
    ------
    ConfigError
        If the angles are not evenly spaced, which such a message cannot hold.

    Examples
    --------
    >>> fields = scan_to_msg(LaserScan([1.0, 2.0], [-0.5, 0.5], range_max=9.0, stamp=5.5))
    >>> fields["angle_increment"], fields["header"]["stamp"]
    (1.0, {'sec': 5, 'nanosec': 500000000})
    >>> scan_from_msg(fields).ranges.tolist()
    [1.0, 2.0]
    """
    expect(scan, LaserScan, "scan")
    angles, count = scan.angles, len(scan.angles)
    step = float(angles[-1] - angles[0]) / (count - 1) if count > 1 else 0.0
    even = angles[0] + step * np.arange(count) if count else angles
    if not count or np.abs(even - angles).max() > max(_UNEVEN * abs(step), _UNEVEN**2):
        raise ConfigError("scan: its angles are not evenly spaced, as those of a LaserScan are")
    return {
        "header": header_fields(scan.stamp, frame_id),
        "angle_min": float(angles[0]),
        "angle_max": float(angles[-1]),
        "angle_increment": step,
        "time_increment": float(scan.time_increment),
        "scan_time": 0.0,
        "range_min": float(scan.range_min),
        "range_max": float(scan.range_max),
        "ranges": scan.ranges.tolist(),
        "intensities": [],
    }


def grid_to_msg(grid: OccupancyGrid, frame_id: str = "map", stamp: float = 0.0) -> dict[str, Any]:
    """The fields of a nav_msgs/OccupancyGrid: 0 is free, 100 a wall, -1 unknown.

    ``rosidl_runtime_py.set_message_fields(message, fields)`` puts them into a message of rclpy.

    Parameters
    ----------
    grid : OccupancyGrid
    frame_id : str
        Name of the map frame.
    stamp : float
        Seconds.

    Raises
    ------
    TypeError
        If `grid` is something else.

    Examples
    --------
    >>> wall = np.eye(2, dtype=bool)
    >>> fields = grid_to_msg(OccupancyGrid(wall, ~wall, 0.5, Pose2D(1.0, 2.0, 0.5)))
    >>> fields["data"], round(grid_from_msg(fields).origin.theta, 3)
    ([100, 0, 0, 100], 0.5)
    """
    expect(grid, OccupancyGrid, "grid")
    height, width = grid.occupied.shape
    data = np.where(grid.occupied, _MOST, np.where(grid.free, 0, -1))
    header = header_fields(stamp, frame_id)
    info = {"map_load_time": header["stamp"], "resolution": float(grid.resolution),
            "width": width, "height": height, "origin": pose_fields(grid.origin)}  # fmt: skip
    return {"header": header, "info": info, "data": data.ravel().tolist()}


def header_fields(stamp: float, frame_id: str) -> dict[str, Any]:
    """The fields of a std_msgs/Header; a stamp that is not known is 0."""
    stamp = stamp if math.isfinite(stamp) else 0.0
    whole = math.floor(stamp)
    seconds = {"sec": whole, "nanosec": min(999_999_999, round(1e9 * (stamp - whole)))}
    return {"stamp": seconds, "frame_id": frame_id}


def pose_fields(pose: Pose2D) -> dict[str, Any]:
    """The fields of a geometry_msgs/Pose."""
    z, w = math.sin(pose.theta / 2), math.cos(pose.theta / 2)
    return {
        "position": {"x": pose.x, "y": pose.y, "z": 0.0},
        "orientation": {"x": 0.0, "y": 0.0, "z": z, "w": w},
    }


def link_fields(pose: Pose2D, header: Any, child: str) -> dict[str, Any]:
    """The fields of a geometry_msgs/TransformStamped to the frame `child` at a pose."""
    at = pose_fields(pose)
    transform = {"translation": at["position"], "rotation": at["orientation"]}
    return {"header": header, "child_frame_id": child, "transform": transform}


def seconds_of(stamp: Any) -> float:
    """Seconds of a stamp, of ROS 2 or 1.

    Examples
    --------
    >>> seconds_of({"sec": 1, "nanosec": 5}) == seconds_of({"secs": 1, "nsecs": 5})
    True
    """
    names = ("secs", "nsecs") if has_field(stamp, "secs") else ("sec", "nanosec")
    seconds, rest = (float(field(stamp, name)) for name in names)
    return seconds + 1e-9 * rest


def has_field(message: Any, name: str) -> bool:
    """Return whether a message, or a mapping, has a field."""
    return name in message if isinstance(message, Mapping) else hasattr(message, name)


def frame_name(name: str) -> str:
    """The name of a frame without the stroke that it may begin with."""
    return name.lstrip("/")  # as the frames of ROS 1's tf were called


def pose_of(pose: Any) -> Pose2D:
    """The plane's share of a Pose or a Transform.

    Examples
    --------
    >>> turned = {"x": 0.0, "y": 0.0, "z": 1.0, "w": 0.0}
    >>> pose_of({"translation": {"x": 1.0, "y": 2.0, "z": 0.3}, "rotation": turned})
    Pose2D(x=1.0, y=2.0, theta=3.141592653589793)
    """
    return Pose2D(*planar(matrix_of(pose)))


def move_of(message: Any) -> tuple[float, float, float, float]:
    """Seconds, x, y and yaw of a nav_msgs/Odometry."""
    pose = planar(matrix_of(field(message, "pose.pose")))
    return (seconds_of(field(message, "header.stamp")), *pose)


def link_of(message: Any) -> tuple[str, str, FloatArray]:
    """Child, parent and the child's pose in it, 4 x 4, of a geometry_msgs/TransformStamped."""
    child, parent = (
        frame_name(field(message, key)) for key in ("child_frame_id", "header.frame_id")
    )
    return child, parent, matrix_of(field(message, "transform"))


def matrix_of(pose: Any) -> FloatArray:
    """A Pose or a Transform as 4 x 4."""
    names = "position", "orientation"
    if not has_field(pose, names[0]):
        names = "translation", "rotation"
    at, q = (field(pose, name) for name in names)
    # A quaternion of zeros, which scipy's Rotation refuses, is one that nobody filled in.
    quaternion = np.array([float(field(q, key)) for key in "xyzw"])
    length = math.hypot(*quaternion) or 1.0
    x, y, z, w = quaternion / (length if length < math.inf else math.nan)
    out = np.eye(4)
    out[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    out[:3, 3] = [float(field(at, key)) for key in "xyz"]
    return out


def planar(matrix: FloatArray) -> tuple[float, float, float]:
    """x, y and yaw."""
    return matrix[0, 3], matrix[1, 3], math.atan2(matrix[1, 0], matrix[0, 0])
