"""Clouds of points, of 3-D lidars and depth cameras: a slice of one, at a height, is a scan.

>>> points = np.array([[2.0, 0.0, 0.1], [1.5, 0.0, 0.9], [0.0, 3.0, 0.0], [np.nan, 0.0, 0.0]])
>>> slice_of(points, (-0.2, 0.2))["ranges"][[360, 540]].tolist()
[2.0, 3.0]
"""

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from imgloc.errors import ConfigError, ScanError
from imgloc.io.files import PathLike, display, open_file
from imgloc.io.messages import fields_of, has_field, scan_from_msg, seconds_of
from imgloc.io.scanset import MAX_READINGS, ScanSet, ScansSize, collect, wrong
from imgloc.model import FloatArray, LaserScan, Pose2D

Height = tuple[float, float]
"""The lowest and the highest point of a slice, metres above the sensor, in its own frame."""
RAYS = 720
"""Rays of a scan that is a slice: half a degree each, as pointcloud_to_laserscan has them."""
_POINTS = 20_000_000  # of a cloud
_HEADER = 4096  # bytes of a PCD
_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}  # PointField
_PCD_TYPES = {"F": "f", "I": "i", "U": "u"}
_AXES = ("x", "y", "z")


def check_height(height: Height | None, what: str) -> Height:
    """The height of a slice; ScanError, which names `what` is cut, if there is none.

    ConfigError for a slice without thickness.
    """
    if height is None:
        raise ScanError(
            f"{what} is a cloud of points: a slice of it is a scan; pass `height=-0.1,0.1`, the "
            "heights above the sensor between which points are taken, metres"
        )
    if not (-math.inf < height[0] < height[1] < math.inf):
        raise ConfigError(f"`height`: got {height[0]:g},{height[1]:g}, expected a lower end first")
    return height


def slice_of(points: FloatArray, height: Height) -> dict[str, Any]:
    """The nearest of some points (N, 3) in each direction, as the entry of a scan.

    Directions without a point in the slice are NaN: a beam may have passed above it, or below.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        ranges = np.hypot(points[:, 0], points[:, 1])
        there = (points[:, 2] >= height[0]) & (points[:, 2] <= height[1]) & (ranges > 0)
    there &= np.isfinite(ranges)
    xy, ranges = points[there, :2], ranges[there]
    step = math.tau / RAYS
    at = np.arctan2(xy[:, 1], xy[:, 0])
    ray = np.rint((at + math.pi) / step).astype(np.int64) % RAYS
    order = np.lexsort((ranges, ray))
    nearest = order[np.unique(ray[order], return_index=True)[1]]
    out = {"ranges": np.full(RAYS, np.nan), "angles": np.arange(RAYS) * step - math.pi}
    out["ranges"][ray[nearest]] = ranges[nearest]
    out["angles"][ray[nearest]] = at[nearest]
    return out


@dataclass(frozen=True, eq=False)
class Cloud:
    """A cloud as a sensor sends it."""

    points: FloatArray  #: (N, 3) in the sensor's frame, metres; not all need be finite
    stamp: float  #: seconds

    def scan(self, height: Height, pose: FloatArray | None = None) -> LaserScan:
        """Slice it level, at heights above the base.

        `pose` (4, 4) is that of the sensor on the base. Without it the sensor is taken for level,
        and heights are above the sensor.

        Examples
        --------
        A camera whose z looks forward, 0.5 m above the base, sees a wall 2 m ahead:

        >>> pose = np.array([[0, 0, 1.0, 0.1], [-1, 0, 0, 0], [0, -1, 0, 0.5], [0, 0, 0, 1]])
        >>> scan = Cloud(np.array([[0.0, 0.3, 2.0]]), 0.0).scan((0.1, 0.3), pose)
        >>> scan.ranges[scan.valid].tolist(), scan.T_base_laser
        ([2.0], Pose2D(x=0.1, y=0.0, theta=0.0))
        """
        points, mount = self.points, None
        if pose is not None:
            with np.errstate(invalid="ignore", over="ignore"):
                points = points @ pose[:3, :3].T + (0.0, 0.0, pose[2, 3])
            mount = Pose2D(pose[0, 3], pose[1, 3])
        entry = slice_of(points, height) | {"stamp": self.stamp, "mount": mount}
        return collect([("cloud", entry)], "cloud")[0]


def seen_in_msg(message: Any, name: str, received: float = math.nan) -> LaserScan | Cloud:
    """The scan of a sensor_msgs/LaserScan, or the cloud of a sensor_msgs/PointCloud2."""
    if not has_field(message, "point_step"):
        return scan_from_msg(message, name, received=received)
    with fields_of(ScanError, name):
        return Cloud(points_of(message, name), seconds_of(message.header.stamp) or received)


def check_seen(entries: Iterable[Mapping[str, Any]], height: Height, where: str) -> None:
    """Raise ScanError, by `where` they are, if no slice at a height has any point."""
    if all(np.isnan(entry["ranges"]).all() for entry in entries):
        raise ScanError(
            f"{where}: no point {height[0]:g} to {height[1]:g} m above the sensor; is its z up, "
            "and are these metres? Pass another `height`"
        )


def points_of(message: Any, where: str) -> FloatArray:
    """The points (N, 3) of a sensor_msgs/PointCloud2; ScanError if its fields contradict."""
    fields = {str(f.name): f for f in message.fields}
    if not all(axis in fields for axis in _AXES):
        raise wrong(f"{where}: fields", ", ".join(sorted(fields)) or "none", "x, y and z")
    count = int(message.width) * int(message.height)
    step, data = int(message.point_step), bytes(message.data)
    if not 0 < count <= _POINTS or len(data) < count * step:
        found = f"{message.width} x {message.height} points of {step} bytes in {len(data):,}"
        raise ScanError(f"{where}: {found}, expected as many and at most {_POINTS:,}")
    order = ">" if message.is_bigendian else "<"
    kinds = [_TYPES.get(int(fields[axis].datatype), "") for axis in _AXES]
    offsets = [int(fields[axis].offset) for axis in _AXES]
    for kind, offset in zip(kinds, offsets, strict=True):
        if not kind or not 0 <= offset <= step - int(kind[1]):
            raise ScanError(f"{where}: fields: x, y or z is no number within its point")
    about = np.dtype({"names": _AXES, "formats": [order + k for k in kinds], "offsets": offsets,
                      "itemsize": step})  # fmt: skip
    return _stacked(np.frombuffer(data, about, count))


def read_pcd(path: PathLike, *, height: Height | None = None) -> ScanSet:
    """Read a slice of a PCD, ASCII or binary, as one scan.

    Parameters
    ----------
    path : path
        ScanError if it is damaged, compressed, or has no point in the slice.
    height : (float, float)
        The lowest and the highest point of the slice, metres above the sensor.
    """
    name = display(path)
    height = check_height(height, name)
    with open_file(path, limit=16 * MAX_READINGS, error=ScanError, what="PCD") as (file, _):
        header, start = _header(file.read(_HEADER), name)
        file.seek(start)
        data = file.read()
    about, count = _layout(header, name)
    if header["DATA"] == ["ascii"]:
        try:
            table = np.array(data.split(), dtype=np.float64).reshape(count, -1)
            columns = [_column(header, axis) for axis in _AXES]
            points = np.ascontiguousarray(table[:, columns])
        except (ValueError, IndexError):
            found = f"numbers of {count:,} points"
            raise ScanError(f"{name}: damaged, expected the {found}") from None
    elif header["DATA"] == ["binary"]:
        if len(data) < count * about.itemsize:
            raise wrong(name, f"{len(data):,} bytes of points", f"{count * about.itemsize:,}")
        points = _stacked(np.frombuffer(data, about, count))
    else:
        hint = "expected ascii or binary: pcl_convert_pcd_ascii_binary cloud.pcd plain.pcd 0"
        raise ScanError(f"{name}: DATA: got {' '.join(header['DATA'])[:40]}, {hint}")
    entry = slice_of(points, height)
    check_seen([entry], height, name)
    return collect([(name, entry)], name)


def pcd_size(path: PathLike) -> ScansSize:
    """Size of what :func:`read_pcd` would read."""
    with open_file(path, limit=16 * MAX_READINGS, error=ScanError, what="PCD") as (_, length):
        return ScansSize(1, 2 * RAYS, 4 * length, text=True)


def _stacked(points: Any) -> FloatArray:
    return np.stack([points[axis].astype(np.float64) for axis in _AXES], axis=1)


def _header(data: bytes, name: str) -> tuple[dict[str, list[str]], int]:
    """The words behind each word of the header, and where the data begin."""
    found = re.search(rb"^DATA[ \t]+\w+[ \t]*\r?\n", data, re.MULTILINE)
    if found is None:
        raise ScanError(f"{name}: no PCD, expected a header with FIELDS, SIZE, TYPE and DATA")
    lines = data[: found.end()].decode("ascii", "replace").splitlines()
    words = [line.split() for line in lines if line.strip() and not line.startswith("#")]
    return {key: rest for key, *rest in words}, found.end()


def _layout(header: dict[str, list[str]], name: str) -> tuple[np.dtype[Any], int]:
    """Type of a point, and number of the points."""
    try:
        fields, types = header["FIELDS"], header["TYPE"]
        sizes = [int(size) for size in header["SIZE"]]
        counts = [int(count) for count in header.get("COUNT", ["1"] * len(fields))]
        points = int(header["POINTS"][0])
        kinds = [f"<{_PCD_TYPES[t]}{n}" for t, n in zip(types, sizes, strict=True)]
        wide = [n * c for n, c in zip(sizes, counts, strict=True)]
        if min(wide) < 1 or not 0 < points <= _POINTS or not set(_AXES) <= set(fields):
            raise ValueError
        at = [fields.index(axis) for axis in _AXES]
        offsets = [sum(wide[:k]) for k in at]
        return np.dtype({"names": _AXES, "formats": [kinds[k] for k in at], "offsets": offsets,
                         "itemsize": sum(wide)}), points  # fmt: skip
    except (KeyError, IndexError, ValueError, TypeError, OverflowError):
        expected = "FIELDS with x y z, their SIZE, TYPE and COUNT, and POINTS"
        raise ScanError(f"{name}: damaged header, expected {expected}") from None


def _column(header: dict[str, list[str]], axis: str) -> int:
    """The column of an axis where points are lines of text."""
    counts = header.get("COUNT", ["1"] * len(header["FIELDS"]))
    return sum(map(int, counts[: header["FIELDS"].index(axis)]))
