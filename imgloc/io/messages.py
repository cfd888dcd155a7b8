"""ROS messages, whoever made them, as what flows through imgloc."""

import math
from typing import Any

import numpy as np

from imgloc.model import FloatArray

_BASES = ("base_footprint", "base_link", "base")
Frames = dict[str, tuple[str, FloatArray]]
"""Of a frame: its parent, and the pose in it, 4 x 4."""


def entry_of(message: Any, recorded: float) -> dict[str, Any]:
    """A scan as other files hold it; its stamp, or when it was recorded if it has none."""
    fields = ("angle_min", "angle_max", "angle_increment", "range_min", "range_max")
    entry: dict[str, Any] = {key: float(getattr(message, key)) for key in fields}
    if not entry["angle_increment"]:
        del entry["angle_increment"]
    ranges = np.asarray(message.ranges, dtype=np.float64)
    return entry | {"ranges": ranges, "stamp": seconds_of(message.header.stamp) or recorded}


def seconds_of(stamp: Any) -> float:
    """Seconds of a stamp."""
    return float(stamp.sec) + 1e-9 * float(stamp.nanosec)


def frame_name(name: str) -> str:
    """The name of a frame without the stroke that it may begin with."""
    return name.lstrip("/")  # as the frames of ROS 1's tf were called


def matrix_of(pose: Any) -> FloatArray:
    """A Pose or a Transform as 4 x 4."""
    at = pose.position if hasattr(pose, "position") else pose.translation
    q = pose.orientation if hasattr(pose, "orientation") else pose.rotation
    # A quaternion of zeros, which scipy's Rotation refuses, is one that nobody filled in.
    x, y, z, w = np.array([q.x, q.y, q.z, q.w]) / (math.hypot(q.x, q.y, q.z, q.w) or 1.0)
    out = np.eye(4)
    out[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    out[:3, 3] = at.x, at.y, at.z
    return out


def planar(matrix: FloatArray) -> tuple[float, float, float]:
    """x, y and yaw."""
    return matrix[0, 3], matrix[1, 3], math.atan2(matrix[1, 0], matrix[0, 0])


def mounting_of(frames: Frames, laser: str, base: str) -> FloatArray | None:
    """Pose of the frame `laser` in that of the base, 4 x 4; None if no transforms lead there."""
    bases = (base,) if base else _BASES
    at, pose = laser, np.eye(4)
    for _ in range(len(frames) + 1):
        if at in bases:
            return pose
        if at not in frames:
            return None
        at, step = frames[at]
        pose = step @ pose
    return None
