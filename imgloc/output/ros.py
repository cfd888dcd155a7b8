"""Tracks as ROS messages: what `/initialpose` of AMCL accepts, in YAML or a bag.

One pose is a PoseWithCovarianceStamped; while several places fit it is a PoseArray of all of them.
AMCL takes the diagonal of a covariance for the variances of its particles, and refuses values
below 0, a negative correlation among them: what is written is a diagonal whose ellipse contains
the true one. The full matrix is in the JSON.
"""

import contextlib
import importlib
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml

from imgloc.errors import OutputError
from imgloc.filters.follow import Moment
from imgloc.geometry import transform_poses
from imgloc.io.files import PathLike, write_bytes_atomic
from imgloc.io.messages import header_fields, pose_fields
from imgloc.model import FloatArray, Pose2D

POSE, ARRAY = "geometry_msgs/msg/PoseWithCovarianceStamped", "geometry_msgs/msg/PoseArray"
TOPICS = {POSE: "/initialpose", ARRAY: "/imgloc/hypotheses"}
GUESSES = "/imgloc/guess"  #: topic of poses that are not unique


class Message(NamedTuple):
    """A message: its type, its fields, and whether its pose is no more than a guess."""

    kind: str
    body: dict[str, Any]
    guess: bool = False


_LISTED = 20  # poses of an array
_LEAST, _MOST = 1e-9, 1e9  # of a variance


def containing_diagonal(covariance: FloatArray) -> FloatArray:
    """Variances (3,) of a diagonal matrix that is nowhere less than the covariance (3, 3).

    Examples
    --------
    >>> C = np.array([[4.0, -2.0, 0.0], [-2.0, 4.0, 0.0], [0.0, 0.0, 1.0]])
    >>> containing_diagonal(C).tolist()
    [6.0, 6.0, 1.0]
    """
    deviation = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    # Gershgorin on the correlations: D - C has a dominant diagonal.
    correlation = np.abs(covariance / np.outer(deviation, deviation))
    return np.asarray(np.clip(deviation**2 * correlation.sum(axis=1), _LEAST, _MOST))


def message(moment: Moment, origin: Pose2D, *, best: bool = False) -> Message | None:
    """The message of a moment; None while no place is known.

    Parameters
    ----------
    origin : Pose2D
        Origin of the grid, in whose frame beliefs are.
    best : bool
        Whether the best pose is written, as a guess, although several fit or the robot is lost.
    """
    header = header_fields(moment.stamp, "map")
    pose = moment.best if best else moment.pose
    if pose is not None:
        covariance = amcl_covariance(moment.covariance)
        fields = {"pose": pose_fields(pose), "covariance": covariance.tolist()}
        return Message(POSE, {"header": header, "pose": fields}, moment.pose is None)
    if moment.belief.verdict == "lost" or not len(moment.belief.poses):
        return None
    poses = transform_poses(origin, moment.belief.poses[:_LISTED])
    return Message(ARRAY, {"header": header, "poses": [pose_fields(Pose2D(*p)) for p in poses]})


def amcl_covariance(covariance: FloatArray, least: Sequence[float] = (0.0, 0.0)) -> FloatArray:
    """Covariance (36,) of a pose that AMCL takes, of that (3, 3) of x, y and theta.

    Its deviations are at `least` so many metres and radians.
    """
    metres, radians = least
    diagonal = np.zeros((6, 6))
    floor = np.square([metres, metres, radians])
    diagonal[[0, 1, 5], [0, 1, 5]] = np.maximum(containing_diagonal(covariance), floor)
    return diagonal.ravel()


def yaml_text(messages: Iterable[Message]) -> str:
    """Messages as `ros2 topic echo` shows them: one document each."""
    return "".join(
        f"# {kind}{', a guess' if guess else ''}\n{yaml.safe_dump(body, sort_keys=False)}---\n"
        for kind, body, guess in messages
    )


class Bag:
    """A recording of messages while it is made: MCAP of ROS 2, or a ROS 1 bag.

    Use it in a ``with`` block: what was recorded is dropped at its end.

    Raises
    ------
    OutputError
        If rosbags is not installed.
    """

    def __init__(self, ending: str = ".mcap") -> None:
        try:
            ros1, ros2, typesys = (
                importlib.import_module(f"rosbags.{name}")
                for name in ("rosbag1", "rosbag2", "typesys")
            )
        except ImportError:
            raise OutputError("bags need rosbags: pip install 'imgloc[ros]'") from None
        stores, self._old, self._count = typesys.Stores, ending == ".bag", 0
        self._store = typesys.get_typestore(stores.ROS1_NOETIC if self._old else stores.ROS2_HUMBLE)
        self._folder = tempfile.TemporaryDirectory()
        self._path = Path(self._folder.name, f"track{ending}")
        mcap = {"version": 9, "storage_plugin": ros2.StoragePlugin.MCAP}
        self._bag: Any = ros1.Writer(self._path) if self._old else ros2.Writer(self._path, **mcap)
        self._bag.open()
        self._to: dict[str, Any] = {}

    def write(self, topic: str, kind: str, seconds: float, fields: Mapping[str, Any]) -> None:
        """Add a message of some seconds; fields that are not given are zeros."""
        if topic not in self._to:
            self._to[topic] = self._bag.add_connection(topic, kind, typestore=self._store)
        if "header" in fields:  # a message of ROS 1 has a number
            fields = {**fields, "header": {**fields["header"], "seq": self._count}}
        self._count += 1
        pack = self._store.serialize_ros1 if self._old else self._store.serialize_cdr
        data = bytes(pack(filled(self._store, kind, fields), kind))
        self._bag.write(self._to[topic], round(1e9 * seconds), data)

    def content(self) -> bytes:
        """End the recording; return its file."""
        self._end()
        (file,) = [self._path] if self._old else self._path.glob("*.mcap")
        return file.read_bytes()

    def __enter__(self) -> "Bag":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Drop what was recorded."""
        with contextlib.suppress(OSError):
            self._end()
        self._folder.cleanup()

    def _end(self) -> None:
        bag, self._bag = self._bag, None
        if bag is not None:
            bag.close()


def write_bag(path: PathLike, messages: Iterable[Message], *, force: bool = False) -> None:
    """Write messages as a ROS 1 bag, whole or not at all; guesses have a topic of their own."""
    with Bag(".bag") as bag:
        for kind, body, guess in messages:
            sec, nanosec = body["header"]["stamp"].values()
            bag.write(GUESSES if guess else TOPICS[kind], kind, sec + 1e-9 * nanosec, body)
        write_bytes_atomic(path, bag.content(), force=force)


def filled(store: Any, kind: str, given: Mapping[str, Any]) -> Any:
    """The message of a type store of rosbags with some fields as given, and zeros in the others."""
    nodes = importlib.import_module("rosbags.interfaces").Nodetype
    values = dict[str, Any]()
    for field, (node, about) in store.fielddefs[kind][1]:
        if node == nodes.NAME:
            values[field] = filled(store, about, given.get(field, {}))
        elif node == nodes.BASE:
            values[field] = given.get(field, "" if about[0] == "string" else 0)
        elif about[0][0] == nodes.NAME:
            values[field] = [filled(store, about[0][1], part) for part in given[field]]
        else:
            values[field] = np.array(given.get(field, [0] * about[1]), about[0][1][0])
    return store.types[kind](**values)
