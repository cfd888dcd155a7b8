"""Answers as messages of ROS 2: poses, places, markers, diagnostics."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from imgloc.geometry import transform_points
from imgloc.io.messages import link_fields, pose_fields
from imgloc.live.status import Found
from imgloc.model import FloatArray, LaserScan, Pose2D, compose
from imgloc.output.ros import amcl_covariance
from imgloc.output.tables import percent, pose_words

_COLOURS = {
    "unique": (0.0, 0.45, 0.70), "ambiguous": (0.90, 0.62, 0.0), "no-match": (0.31, 0.31, 0.31),
    "invalid": (0.31, 0.31, 0.31),
}  # fmt: skip
_ARROW, _LETTERS, _POINT = (0.8, 0.12, 0.12), (0.0, 0.0, 0.4), (0.06, 0.06, 0.0)  # metres


def fill(message: Any, fields: Mapping[str, Any]) -> Any:
    """Set the fields of a message from a nested mapping; return it."""
    for name, value in fields.items():
        if isinstance(value, Mapping):
            fill(getattr(message, name), value)
        else:
            setattr(message, name, value)
    return message


def words_of(found: Found) -> str:
    """The first pose in words."""
    if not found.poses:
        return "no pose"
    mass = percent(found.masses[0])
    return f"{pose_words(found.poses[0])}, mass {mass}, map {found.map}"


class Messages:
    """Makes messages, of the modules that :func:`imgloc.live.node.load_ros` has found."""

    def __init__(self, ros: Any) -> None:
        self._ros = ros

    def header(self, stamp: Any, frame: str) -> Any:
        """A Header; the stamp is one of another message."""
        return fill(self._ros.std_msgs.Header(), {"stamp": stamp, "frame_id": frame})

    def text(self, data: str) -> Any:
        """A String."""
        return fill(self._ros.std_msgs.String(), {"data": data})

    def pose(
        self, pose: Pose2D, covariance: FloatArray, header: Any,
        least: Sequence[float] = (0.0, 0.0),
    ) -> Any:  # fmt: skip
        """A PoseWithCovarianceStamped: see :func:`~imgloc.output.ros.amcl_covariance`."""
        body = {"pose": pose_fields(pose), "covariance": amcl_covariance(covariance, least)}
        message = self._ros.geometry_msgs.PoseWithCovarianceStamped()
        return fill(message, {"header": header, "pose": body})

    def link(self, pose: Pose2D, header: Any, child: str) -> Any:
        """A TransformStamped to a frame at a pose."""
        message = self._ros.geometry_msgs.TransformStamped()
        return fill(message, link_fields(pose, header, child))

    def places(self, found: Found, header: Any) -> Any:
        """A PoseArray of all places, best first."""
        made = self._ros.geometry_msgs
        poses = [fill(made.Pose(), pose_fields(pose)) for pose in found.poses]
        return fill(made.PoseArray(), {"header": header, "poses": poses})

    def markers(self, found: Found, scan: LaserScan, header: Any) -> Any:
        """A MarkerArray: arrows with their masses, and the scan at the first pose."""
        kinds = self._ros.visualization_msgs.Marker
        out = [fill(kinds(), {"header": header, "action": kinds.DELETEALL})]

        def add(
            space: str, kind: int, size: tuple[float, float, float], alpha: float = 1.0, **more: Any
        ) -> None:
            colour = dict(zip("rgba", (*_COLOURS[found.verdict], alpha), strict=True))
            scale = dict(zip("xyz", size, strict=True))
            fields = {"header": header, "ns": space, "id": len(out), "type": kind}
            out.append(fill(kinds(), fields | {"scale": scale, "color": colour} | more))

        for pose, mass in zip(found.poses, found.masses, strict=True):
            at = pose_fields(pose)
            add("places", kinds.ARROW, _ARROW, 0.25 + 0.75 * math.sqrt(max(0.0, mass)), pose=at)
            add("masses", kinds.TEXT_VIEW_FACING, _LETTERS, pose=at, text=f"{100 * mass:.1f} %")
        if found.poses and scan.T_base_laser is not None:
            ends = np.column_stack((np.cos(scan.angles), np.sin(scan.angles)))
            ends = (ends * scan.ranges[:, None])[scan.valid]
            at_map = transform_points(compose(found.poses[0], scan.T_base_laser), ends).tolist()
            made = self._ros.geometry_msgs.Point
            add("scan", kinds.POINTS, _POINT, points=[made(x=x, y=y) for x, y in at_map])
        return fill(self._ros.visualization_msgs.MarkerArray(), {"markers": out})

    def diagnostics(self, level: int, row: Mapping[str, Any], name: str, stamp: Any) -> Any:
        """A DiagnosticArray of one status; `row` is that of ``~/status``."""
        made = self._ros.diagnostic_msgs
        shown = ("localized", "verdict", "localizationScore", "state", "age", "tries", "dropped")
        values = [made.KeyValue(key=key, value=str(row[key])) for key in shown]
        status = made.DiagnosticStatus(
            level=bytes([level]), name="imgloc: localization", message=row["message"],
            hardware_id=name, values=values,
        )  # fmt: skip
        return fill(made.DiagnosticArray(), {"header": {"stamp": stamp}, "status": [status]})
