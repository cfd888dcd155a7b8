"""Says what a node of imgloc says, a JSON object for each message."""

import json
import math
import time
from typing import Any, TextIO

from imgloc.io.messages import pose_of, seconds_of


class Listener:
    """A node that listens to /initialpose, the status, the diagnostics and the pose of imgloc."""

    def __init__(self, ros: Any, node: Any, out: TextIO, *, everything: bool) -> None:
        self._out = out
        geometry, qos = ros.geometry_msgs, ros.qos
        latched = qos.QoSProfile(depth=10, durability=qos.DurabilityPolicy.TRANSIENT_LOCAL)
        stamped = geometry.PoseWithCovarianceStamped
        hear = node.create_subscription
        hear(stamped, "initialpose", lambda m: self._pose("initialpose", m), latched)
        if everything:
            hear(stamped, "imgloc/pose", lambda m: self._pose("pose", m), 10)
            hear(ros.std_msgs.String, "imgloc/status", self._status, latched)
            hear(ros.diagnostic_msgs.DiagnosticArray, "/diagnostics", self._diagnostics, 10)

    def _say(self, topic: str, fields: dict[str, Any]) -> None:
        self._out.write(json.dumps({"topic": topic, "heard": time.time(), **fields}) + "\n")
        self._out.flush()

    def _pose(self, topic: str, message: Any) -> None:
        pose = pose_of(message.pose.pose)
        x, y, degrees = round(pose.x, 4), round(pose.y, 4), round(math.degrees(pose.theta), 3)
        stamp, frame = seconds_of(message.header.stamp), message.header.frame_id
        self._say(topic, {"stamp": stamp, "frame": frame, "x": x, "y": y, "theta_deg": degrees})

    def _status(self, message: Any) -> None:
        self._say("status", json.loads(message.data))

    def _diagnostics(self, message: Any) -> None:
        for status in message.status:
            self._say("diagnostics", {"level": status.level[0], "message": status.message})
