"""A ROS 2 node around a :class:`~imgloc.live.localizer.Localizer`: topics in, poses out.

rclpy is loaded when the node is made. It is that of a sourced ROS 2, or of the wheels of the extra
``node``; without tf2_msgs, for which there is no wheel, lasers have to be told where they sit.

All callbacks run in the thread that spins; the localizer's thread only wakes it.
"""

import contextlib
import difflib
import importlib
import math
import signal
import time
from collections import deque
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np

from imgloc.errors import ConfigError, ImglocError, ScanError, printable
from imgloc.filters.belief import LOST, deviations_of
from imgloc.filters.follow import BLIND, Moment
from imgloc.filters.watch import AGREES, DISAGREES, Opinion, Watch
from imgloc.io.clouds import Cloud, seen_in_msg
from imgloc.io.messages import (
    frame_name,
    grid_from_msg,
    link_of,
    move_of,
    planar,
    pose_of,
    seconds_of,
)
from imgloc.live.line import Dropped
from imgloc.live.localizer import Answer, Chosen, Localizer
from imgloc.live.messages import Messages, words_of
from imgloc.live.policy import GIVEN_UP, QUIET, FirstPose, LastPose, alone
from imgloc.live.remember import REFUSED, RESTORED, Kept, checked, identity, load_kept
from imgloc.live.settings import CHANGING, Settings
from imgloc.live.sites import Maker, Site
from imgloc.live.status import (
    ERROR,
    HINTED,
    OK,
    WARN,
    Found,
    found_along,
    found_blind,
    found_of,
    health,
    status_row,
    weighed,
)
from imgloc.model import (
    FloatArray,
    LaserScan,
    Localization,
    OccupancyGrid,
    Pose2D,
    compose,
    inverse,
    to_json,
)
from imgloc.options import RADIUS, TOLERANCE, Hint, Known, Options
from imgloc.output.tables import pose_words
from imgloc.pose import difference
from imgloc.ranges import declared
from imgloc.robot.frames import GAP, Frames
from imgloc.robot.odometry import Odometry
from imgloc.robot.stamps import AHEAD, ANEW, FINE, Stamps

MODULES = {
    "sensor_msgs": "msg", "nav_msgs": "msg", "geometry_msgs": "msg", "std_msgs": "msg",
    "diagnostic_msgs": "msg", "rcl_interfaces": "msg", "visualization_msgs": "msg",
    "std_srvs": "srv",
}  # fmt: skip
_PARTS = (
    "callback_groups", "clock", "duration", "exceptions", "executors", "node", "qos", "signals",
    "time",
)  # fmt: skip
MISSING = (
    "a ROS 2 node needs rclpy: source a ROS 2 whose Python is this one, or pip install "
    "'imgloc[node]'"
)
# Seconds from a scan's arrival until it is left out, if odometry or transforms of its time lack: in
# a longer gap it is not known anyway. Without any by then, the scans alone give the motion.
LATE = GAP
_LOOK = 0.5  # seconds between two looks at what has become of everything
_KEPT = 10.0  # seconds that who comes late still gets /initialpose: what tf2 remembers by default
_WAITING = 100  # scans that wait so, of all lasers
_ANSWERED = 15.0  # seconds that ~/localize waits for a pose at most
_MOVES = 4000  # poses of the odometry, and of a link of tf, remembered: 20 s of 200 a second
_CLAIMS = 200  # poses of the localizer that is watched, remembered
_HINTS = 20  # poses on ~/hint, remembered
_SAVED = 1.0  # seconds between two writes of the pose that is remembered
_STILL = (0.1, 0.05)  # metres, radians: a robot that has gone less far stands
_SAID = 5.0  # seconds between two lines of the log that differ in words alone
_TURN = 0.005  # seconds
_NAME = 100  # letters of a frame's name that are shown
_MAP = "map"
_OTHERS, _POLICIES = ("use_sim_time", "start_type_description_service"), "qos_overrides."  # rclpy's
_PLANE = (0, 1, 5)  # x, y and yaw of a pose's covariance
_ENDING = (signal.SIGINT, signal.SIGTERM)
_AHEAD = 1.0  # seconds that map -> odom on /tf is ahead of its scan, as that of AMCL is


def load_ros() -> Any:
    """The modules of ROS 2 by their names; a ConfigError without them."""
    try:
        found = {name: importlib.import_module(f"{name}.{of}") for name, of in MODULES.items()}
        found |= {name: importlib.import_module(f"rclpy.{name}") for name in _PARTS}
        rclpy = importlib.import_module("rclpy")
    except ImportError as error:
        raise ConfigError(f"{MISSING} ({error})") from None
    some = dict[str, Any](tf2_msgs="tf2_msgs.msg", nav2_msgs="nav2_msgs.srv")  # not everywhere
    some["lifecycle"] = "rclpy.lifecycle"
    for name, module in some.items():
        some[name] = None
        with contextlib.suppress(ImportError):
            some[name] = importlib.import_module(module)
    return SimpleNamespace(rclpy=rclpy, **found, **some)


def with_parameters(ros: Any, node: Any, settings: Settings) -> Settings:
    """The settings with what was said by ROS parameters; ConfigError for a wrong one."""
    said, known = dict[str, Any](), vars(settings)
    given = node.get_parameters_by_prefix("")  # rclpy has declared what was passed, and its own
    for name in sorted(given.keys() - known.keys()):
        if name not in _OTHERS and not name.startswith(_POLICIES):
            near = difflib.get_close_matches(name, known, 1)
            hint = f"did you mean {near[0]}?" if near else f"expected {', '.join(known)}"
            node.get_logger().warning(f"parameter {name}: unknown, and ignored; {hint}")
    for one in declared(Settings):
        name, default = one.name, known[one.name]
        if name in given:
            node.undeclare_parameter(name)
        about = ros.rcl_interfaces.ParameterDescriptor(
            dynamic_typing=True, read_only=name not in CHANGING, description=one.text,
            additional_constraints="" if one.limit is None else str(one.limit),
        )  # fmt: skip
        plain = list(default) if isinstance(default, tuple) else default
        said[name] = node.declare_parameter(name, plain, about).value
    return _changed(settings, said)


def _changed(settings: Settings, values: Mapping[str, Any]) -> Settings:
    """The settings with the values of some ROS parameters; ConfigError for a wrong one."""
    said = dict[str, Any]()
    for name, value in values.items():
        default = getattr(settings, name)
        if isinstance(default, tuple):
            value = (value,) if isinstance(value, str | int | float) else tuple(value or ())
        elif isinstance(default, float) and type(value) is int:
            value = float(value)
        said[name] = value
    try:
        return replace(settings, **said)
    except ConfigError as error:
        raise ConfigError(f"parameter {str(error).removeprefix('Settings.')}") from None


def on_change(ros: Any, settings: Settings, told: Callable[[Settings], None]) -> Callable[..., Any]:
    """Return what takes ROS parameters while the node runs; a refusal has the reason."""

    def change(parameters: Sequence[Any]) -> Any:
        nonlocal settings
        own = {one.name: one.value for one in parameters if one.name in CHANGING}
        try:
            settings = _changed(settings, own)
        except ConfigError as error:
            return ros.rcl_interfaces.SetParametersResult(successful=False, reason=str(error))
        told(settings)
        return ros.rcl_interfaces.SetParametersResult(successful=True)

    return change


@dataclass(eq=False)
class Topic:
    """One topic of scans."""

    topic: str  #: its name with namespace and remapping
    mount: Pose2D | None  #: None: tf says it
    stamps: Stamps
    heard: float = -math.inf  #: seconds, monotonic, of the last message
    age: float = math.nan  #: seconds that the last scan had when it came
    ranges: bytes = b""  #: of the last scan
    bad: int = 0  #: messages that are no scan, and what is wrong with the last one
    wrong: str = ""
    skipped: int = 0  #: scans that came late, or again
    fresh: float = -math.inf  #: seconds, monotonic, of the last scan that repeats none
    frozen: bool = False  #: whether the last scan repeats the one before
    stamped: bool = True  #: whether the last scan has a stamp
    frame: str = ""  #: whose place tf does not say
    late: str = ""  #: what the last scan that was left out waited for


@dataclass(eq=False)
class _Waiting:
    """A scan that waits for what the robot did at its time."""

    laser: Topic
    scan: LaserScan | Cloud  # not mounted yet
    frame: str
    stamp: Any  # as it stands in the message
    until: float  # monotonic seconds


@dataclass(eq=False)
class _Asked:
    """A scan that is looked at."""

    scan: LaserScan
    stamp: Any
    odom: Pose2D | None
    future: "Future[Any]"
    era: int


@dataclass(eq=False)
class _Caller:
    """One who waits for a service to answer; rclpy asks at each turn whether it may."""

    until: float  # monotonic seconds
    answer: tuple[bool, str] | None = None

    def __await__(self) -> Generator[None, None, tuple[bool, str]]:
        while self.answer is None:
            time.sleep(_TURN)  # else it would ask all the time
            yield
        return self.answer


class LocalizerNode:
    """The node: :meth:`spin` until it is told to end.

    Parameters
    ----------
    ros : object
        Of :func:`load_ros`.
    node : rclpy.node.Node
    settings : Settings
    core : Localizer
    from_topic : bool
        Whether the map is that of the topic ``map``.

    Raises
    ------
    ConfigError
        If the places of the lasers are not known, or a setting is out of its range.
    """

    def __init__(
        self, ros: Any, node: Any, settings: Settings, core: Localizer, *, from_topic: bool
    ) -> None:
        mounts = settings.mounts
        if mounts is None and ros.tf2_msgs is None:
            raise ConfigError(
                "sensor: missing, expected X,Y,YAW, the pose of the laser on the robot (0,0,0 if "
                "they are equal); tf cannot give it, because tf2_msgs is not installed"
            )
        for name, instead in (("tf", "~/map_odom has map -> odom"), ("watch", "name a topic")):
            if getattr(settings, name) in (True, "tf") and ros.tf2_msgs is None:
                raise ConfigError(f"parameter {name}: tf2_msgs is not installed; {instead}")
        self.ros, self.node, self.settings, self.core = ros, node, settings, core
        self.made = Messages(ros)
        self.from_topic = from_topic
        self.first = FirstPose(settings)
        self.lasers = [
            Topic(topic, None if mounts is None else mounts[k], Stamps(settings.max_age))
            for k, (topic, _) in enumerate(settings.topics)
        ]  # fmt: skip
        self.found: Found | None = None
        self._sure = False  # whether that is a pose that was published
        self._took = 0.0  # seconds from the last scan that was tried to its answer
        self._followed = False  # whether the filter has had a pose
        self._map_frame, self._odom = settings.map_frame, ("odom", "")  # its frame and child
        self._moves, self._move_stamps = Odometry(most=_MOVES), Stamps(settings.max_age)
        self._frames = Frames(most=_MOVES)
        self._waiting = deque[_Waiting]()
        self._first = math.inf  # monotonic seconds of the first scan
        self._moved = False  # whether there is odometry
        self._stood: Pose2D | None = None  # where a robot that stands was looked at, by odometry
        self._last = LastPose()
        self._hints = deque[tuple[float, Hint]](maxlen=_HINTS)  # of the base, map frame, at a time
        self._claims = deque[tuple[float, Pose2D]](maxlen=_CLAIMS)  # of who is watched
        self._watch: Watch | None = None
        self._judging: Future[Opinion] | None = None
        self.opinion = Opinion()
        self._kept = _kept_of(settings)
        self._checks = self._kept is not None  # whether that pose is to be checked by a scan
        self._remembered = ""  # what came of it
        self._hashed: tuple[OccupancyGrid, str] | None = None  # a map, and its identity
        self._map: tuple[Any, ...] | None = None
        self._map_error = ""
        self._era = 0  # of the answers that count
        self._asked: _Asked | None = None
        self._tracked = deque[_Asked]()
        self._robot = core.robot()
        self._callers = list[_Caller]()  # who waits for an answer of ~/localize
        self._said = (-1, "", 0.0)  # level and sentence that were logged last, and when
        self._ended = False
        before = self._entities()
        self._connect()
        self._own = {one: end for one, end in self._entities().items() if one not in before}

    # What is heard and said.

    def _connect(self) -> None:
        ros, node = self.ros, self.node
        qos, reliable = ros.qos, ros.qos.ReliabilityPolicy.RELIABLE
        sensor = ros.qos.qos_profile_sensor_data
        latched = qos.QoSProfile(
            depth=1, reliability=reliable, durability=qos.DurabilityPolicy.TRANSIENT_LOCAL
        )
        passing = qos.QoSProfile(
            depth=1, reliability=reliable, durability=latched.durability,
            lifespan=ros.duration.Duration(seconds=_KEPT),
        )  # fmt: skip
        for (name, cloud), laser in zip(self.settings.topics, self.lasers, strict=True):
            kind = ros.sensor_msgs.PointCloud2 if cloud else ros.sensor_msgs.LaserScan
            laser.topic = self._hear(kind, name, partial(self._on_scan, laser), sensor)
        self._hear(ros.nav_msgs.Odometry, "odom", self._on_odometry, sensor)
        if self.from_topic:
            self._map_topic = self._hear(ros.nav_msgs.OccupancyGrid, "map", self._on_map, latched)
        if ros.tf2_msgs is not None:
            still = qos.QoSProfile(depth=100, reliability=reliable, durability=latched.durability)
            on_static = partial(self._on_transforms, static=True)
            self._hear(ros.tf2_msgs.TFMessage, "/tf_static", on_static, still)
            self._hear(ros.tf2_msgs.TFMessage, "/tf", self._on_transforms, 100)
        say = node.create_publisher
        geometry = ros.geometry_msgs
        stamped = geometry.PoseWithCovarianceStamped
        self._hear(stamped, "~/hint", self._on_hint, 10)
        if self.settings.watch not in ("", "tf"):
            self._hear(stamped, self.settings.watch, self._on_claim, sensor)
        if not self.settings.watch:
            self._initial = say(stamped, "initialpose", passing)
        self._hypotheses = say(geometry.PoseArray, "~/hypotheses", latched)
        self._markers = say(ros.visualization_msgs.MarkerArray, "~/markers", latched)
        self._status = say(ros.std_msgs.String, "~/status", latched)
        self._diagnostics = say(ros.diagnostic_msgs.DiagnosticArray, "/diagnostics", 10)
        if self.settings.track:
            self._pose = say(geometry.PoseWithCovarianceStamped, "~/pose", 10)
            self._map_odom = say(geometry.TransformStamped, "~/map_odom", 10)
        if self.settings.tf:
            self._tf = say(ros.tf2_msgs.TFMessage, "/tf", 100)
        trigger = ros.std_srvs.Trigger
        beside = ros.callback_groups.ReentrantCallbackGroup()  # while one waits all else goes on
        node.create_service(trigger, "~/localize", self._on_localize, callback_group=beside)
        node.create_service(trigger, "~/reset", self._on_reset, callback_group=beside)
        # By these names AMCL is called, by people and by behaviour trees.
        node.create_service(
            ros.std_srvs.Empty, "reinitialize_global_localization", self._on_reinitialize
        )
        if ros.nav2_msgs is not None:
            node.create_service(ros.nav2_msgs.SetInitialPose, "set_initial_pose", self._on_set_pose)
        self._wake = node.create_guard_condition(self._guarded("answers", self._on_answers))
        steady = ros.clock.Clock(clock_type=ros.clock.ClockType.STEADY_TIME)
        node.create_timer(_LOOK, self._guarded("status", self._report), clock=steady)

    def _hear(self, kind: Any, topic: str, heard: Callable[[Any], None], qos: Any) -> str:
        """Listen to a topic; return its name with namespace and remapping."""
        try:
            made = self.node.create_subscription(kind, topic, heard, qos)
        except self.ros.exceptions.InvalidTopicNameException as error:
            why = str(error).splitlines()[0].removesuffix(":")
            raise ConfigError(f"topic: got {topic!r}: {why}") from None
        name = str(made.topic_name)
        made.callback = self._guarded(name, heard)
        return name

    def _guarded(self, what: str, call: Callable[..., None]) -> Callable[..., None]:
        """`call`, whose errors are logged: neither a message nor a defect may end the node."""

        def guarded(*given: Any) -> None:
            try:
                call(*given)
            except ImglocError as error:
                said = str(error).removeprefix(f"{what}: ")
                self.node.get_logger().warning(f"{what}: {said}", throttle_duration_sec=5.0)
            except Exception as error:
                text = f"{what}: left out; a defect, {type(error).__name__}: {error}"
                self.node.get_logger().error(printable(text), throttle_duration_sec=5.0)

        return guarded

    # What comes in.

    @property
    def now(self) -> float:
        """Seconds of the clock that stamps are of."""
        return float(self.node.get_clock().now().nanoseconds) * 1e-9

    def _on_scan(self, laser: Topic, message: Any) -> None:
        before, laser.heard = laser.heard, time.monotonic()
        now = self.now
        try:
            scan = seen_in_msg(message, laser.topic, received=0.0)
        except ScanError as error:
            laser.bad, laser.wrong = laser.bad + 1, str(error).removeprefix(f"{laser.topic}: ")
            raise
        laser.wrong, laser.age = "", now - scan.stamp
        laser.stamped = bool(scan.stamp) or self.first.fresh(0.0, now)  # a clock may begin at 0
        if not laser.stamped:
            laser.skipped += 1
            return
        judged = laser.stamps.take(scan.stamp, now)
        if judged == ANEW:
            self.start_anew("the time of the scans has gone back")
            laser.stamps.take(scan.stamp, now)
        elif judged != FINE:
            laser.skipped += 1
            if judged != AHEAD:
                laser.heard = before
                self._repeat(laser, now)
            return
        content = (scan.points if isinstance(scan, Cloud) else scan.ranges).tobytes()
        laser.frozen, laser.ranges = content == laser.ranges, content
        if not laser.frozen:
            laser.fresh = laser.heard
        frame = frame_name(message.header.frame_id)
        lost = laser.mount is None and self._frames.path(frame, self.settings.base_frame) is None
        laser.frame = printable(frame)[:_NAME] if lost else ""
        if not self.core.ready:
            return
        if not self.first.fresh(scan.stamp, now):
            laser.skipped += 1
            return
        self._first = min(self._first, laser.heard)
        until = laser.heard + LATE
        self._waiting.append(_Waiting(laser, scan, frame, message.header.stamp, until))
        self._go_on()

    def _go_on(self) -> None:
        """Look at the scans of whose time odometry and transforms are known by now."""
        late, kept = time.monotonic(), deque[_Waiting]()
        while self._waiting:
            one = self._waiting.popleft()
            era = self._era
            scan, odom, lacks = self._complete(one)
            if scan is not None:
                self._look_at(one, scan, odom)
                one.laser.late = ""
            elif one.until > late and len(kept) < _WAITING:
                kept.append(one)
            else:
                one.laser.skipped, one.laser.late = one.laser.skipped + 1, lacks
            if era != self._era:
                return  # all that waits is of another time
        self._waiting = kept

    def _complete(self, one: _Waiting) -> tuple[LaserScan | None, Pose2D | None, str]:
        """The scan, cut and mounted, with the odometry of its time; or what it waits for."""
        laser, stamp, base = one.laser, one.scan.stamp, self.settings.base_frame
        link = self._frames.at(one.frame, base, stamp) if laser.mount is None else None
        if link is None and laser.mount is None:
            return None, None, f"transforms from {base} to {one.frame}"
        odom = self._moves.at(stamp)
        silent = not self._moved and time.monotonic() > self._first + LATE
        if odom is None and not silent:
            return None, None, "odometry"
        scan = placed(one.scan, self.settings, laser.topic, laser.mount, link)
        return scan, None if odom is None else Pose2D(*odom), ""

    def _look_at(self, one: _Waiting, scan: LaserScan, odom: Pose2D | None) -> None:
        """Follow the robot by a scan, or ask on which floor it is."""
        floors = self._robot.map is None and len(self.core.names) > 1
        alone = (self.settings.standing or self._checks) and self.first.wanted and self._stays(odom)
        if (floors or alone) and self.first.due(scan.stamp, odom):
            self._stood = odom or Pose2D(0.0, 0.0)
            self._ask(one, scan, odom)
        follows = self.settings.track or self.settings.remember or self.settings.watch
        if floors or not (self.first.wanted or follows):
            return
        if scan.directions < self.core.options.trust.readings and any(
            asked.scan.laser == scan.laser and not asked.future.done() for asked in self._tracked
        ):
            return  # a blind scan does not push out one that waits, and may see
        pose = None if odom is None else np.array([odom.x, odom.y, odom.theta])
        with contextlib.suppress(Dropped):  # another map has come meanwhile
            future = self._robot.update_soon(scan, pose, source=one.laser.topic)
            self._tracked.append(_Asked(scan, one.stamp, odom, future, self._era))
            future.add_done_callback(self._done)

    def _stays(self, odom: Pose2D | None) -> bool:
        """Return whether one scan of this place has not been asked alone yet: it is asked once."""
        return self._stood is None or not _still(self._stood, odom or Pose2D(0.0, 0.0))

    def _repeat(self, laser: Topic, now: float) -> None:
        """Take note of a scan that has the stamp of the one before, or comes after a later one."""
        laser.frozen = True
        if self.core.ready and all(self._frozen(one) or self._silent(one) for one in self.lasers):
            self.first.believed(now, None, now)

    def _on_odometry(self, message: Any) -> None:
        stamp, *pose = move_of(message)
        if not all(map(math.isfinite, (stamp, *pose))):
            return
        odom = frame_name(message.header.frame_id) or "odom", frame_name(message.child_frame_id)
        if self._moved and odom != self._odom and stamp <= self._moves.last + GAP:
            both = " and ".join(printable(" -> ".join(one)) for one in (self._odom, odom))
            raise ScanError(f"of two robots, {both}? only the first is used; remap odom")
        judged = self._move_stamps.take(stamp, self.now)
        if judged == ANEW:
            self._moves.clear()
        elif judged != FINE:
            return
        self._moved, self._odom = True, odom
        self._moves.add(stamp, pose)
        self._go_on()

    def _odometry(self, stamp: float) -> Pose2D | None:
        """The robot's pose by odometry at a time, or shortly before; None if that is not known."""
        found = self._moves.lately(stamp)
        return None if found is None else Pose2D(*found)

    def _on_map(self, message: Any) -> None:
        frame, info = frame_name(message.header.frame_id), message.info
        same = (frame, info.resolution, info.width, info.height, info.origin, bytes(message.data))
        if same == self._map:
            self._map_error = ""
            return  # the same map once more: it is latched, or published each few seconds
        try:
            self.core.put(_MAP, grid_from_msg(message, "map"))
        except ImglocError as error:
            self._map_error = str(error)
            raise
        self._map, self._map_error = same, ""
        self._map_frame = frame or self.settings.map_frame
        self.start_anew("a map came")

    def _on_transforms(self, message: Any, *, static: bool = False) -> None:
        for item in message.transforms:
            child, parent, pose = link_of(item)
            stamp = -math.inf if static else seconds_of(item.header.stamp)
            self._frames.add(child, parent, pose, stamp)
        self._go_on()

    # What is asked, and what becomes of the answers.

    def start_anew(self, why: str) -> None:
        """Know nothing any more: of the place, the way, and what was asked."""
        self.node.get_logger().info(f"starts anew: {why}")
        self._again()
        self.found, self._sure = None, False
        self._moves.clear()
        self._hints.clear()
        self._move_stamps.start()
        self._first, self._moved = math.inf, False
        self._frames.forget()
        self._waiting.clear()
        for laser in self.lasers:
            laser.stamps.start()
            laser.ranges = b""

    def _again(self) -> None:
        """Look for a first pose once more; answers to what was asked before do not count."""
        self.first.start()
        self._robot.reset()
        if len(self.core.names) > 1:
            self._robot.map = None  # on which floor is not known
        self._took, self._stood, self._last, self._followed = 0.0, None, LastPose(), False
        self._era += 1
        self._asked = None
        self._tracked.clear()

    def _ask(self, one: _Waiting, scan: LaserScan, odom: Pose2D | None) -> None:
        """Ask a scan alone: on which floor it is, or where a robot stands."""
        floors = self._robot.map is None and len(self.core.names) > 1
        future: Future[Any]
        known = Known(hints=self._hinted(scan.stamp, scan.T_base_laser))
        try:
            ask = self.core.which_soon if floors else partial(self.core.localize_soon, known=known)
            future = ask(scan)
        except Dropped:  # another map has come meanwhile
            self.first.answered()
            return
        self._asked = _Asked(scan, one.stamp, odom, future, self._era)
        future.add_done_callback(self._done)

    def _done(self, _: object) -> None:
        if not self._ended:  # in the localizer's thread
            self._wake.trigger()

    def _on_answers(self) -> None:
        asked = self._asked
        if asked is not None and asked.future.done():
            self._asked = None
            self._take(asked)
        while self._tracked and self._tracked[0].future.done():
            tracked = self._tracked.popleft()
            answer = self._result(tracked)
            if answer is not None:
                self._take_moment(tracked, answer)
        if self._judging is not None and self._judging.done():
            self._judged()

    def _result(self, asked: _Asked) -> Answer[Any] | None:
        """The answer, if there is one that counts."""
        try:
            answer: Answer[Any] = asked.future.result()
        except Dropped:
            return None
        except ImglocError as error:
            self.node.get_logger().warning(str(error), throttle_duration_sec=5.0)
            return None
        return answer

    def _take(self, asked: _Asked) -> None:
        """Take the answer to one scan alone: the floor, or where a robot stands."""
        self.first.answered()
        answer = self._result(asked)
        if answer is None or asked.era != self._era:
            return
        value, name = answer.value, answer.map
        self._took = self.now - asked.scan.stamp
        if self._checks and self._check(value, name, asked):
            return
        if isinstance(value, Localization):
            fresh = self.first.fresh(asked.scan.stamp, self.now)
            if self.settings.standing and self.first.wanted and alone(value) and fresh:
                found = found_of(value, asked.scan.stamp, name)
                self._show(found, asked, sure=True)
                self._publish(found, asked)
            return
        assert isinstance(value, Chosen)
        found = Found(asked.scan.stamp, None, "no-match")
        if value.best is not None:
            found = found_of(value.best, asked.scan.stamp, name)
        if value.choice.verdict == "invalid":
            found = found_blind(asked.scan, name)
        self._show(found, asked, sure=False)
        self.first.believed(asked.scan.stamp, None, self.now)
        if value.best is not None:
            self._robot.reset(name)  # the filter finds its own way there
        self._report()

    def _check(self, value: Localization | Chosen, name: str | None, asked: _Asked) -> bool:
        """Hold the remembered pose against a scan; whether a pose was published."""
        best = value.best if isinstance(value, Chosen) else value
        verdict = value.choice.verdict if isinstance(value, Chosen) else value.verdict
        self._stood = None if verdict == "invalid" else self._stood
        if verdict == "invalid" or not self.first.fresh(asked.scan.stamp, self.now):
            return False  # the next scan may see more, or come in time
        assert self._kept is not None
        self._checks, self._remembered, pose = False, REFUSED, None
        if best is not None:
            self._remembered, pose = checked(self._kept, best, self._identity(name))
        at = "" if pose is None else f", x {pose.x:.3f} m, y {pose.y:.3f} m"
        words = f"{self.settings.remember}: {self._remembered}{at}"
        self.node.get_logger().info(f"{words}, {self.now - asked.scan.stamp:.2f} s after the scan")
        if self._remembered != RESTORED or best is None or not self.first.wanted:
            return False  # where it was moved to is confirmed along a way, unless `standing`
        found = found_of(best, asked.scan.stamp, name)
        self._robot.map = name if len(self.core.names) > 1 else self._robot.map
        self._show(found, asked, sure=True)
        self._publish(found, asked)
        self._report()
        return True

    def _identity(self, name: str | None) -> str:
        grid = self.core.site(name, timeout=0).features.grid
        if self._hashed is None or self._hashed[0] is not grid:
            self._hashed = grid, identity(grid)
        return self._hashed[1]

    def _remember(self, pose: Pose2D, stamp: float, name: str | None) -> None:
        """Keep a sure pose in the file, if the robot has moved since."""
        last = self._kept
        if not self.settings.remember or self._checks:
            return
        new = last is None or (abs(stamp - last.stamp) >= _SAVED and not _still(last.pose, pose))
        if new or last is None or last.identity != self._identity(name):
            self._kept = Kept(str(name), self._identity(name), pose, stamp)
            self._kept.save(self.settings.remember)

    def _on_claim(self, message: Any) -> None:
        self._claims.append((seconds_of(message.header.stamp), self._given(message)[0]))

    def _given(self, message: Any) -> tuple[Pose2D, tuple[float, float]]:
        """Pose and standard deviations of a message that somebody sends; ConfigError in no map."""
        frame, given = frame_name(message.header.frame_id), message.pose
        if frame not in ("", self._map_frame):
            raise ConfigError(f"frame_id: got {printable(frame)!r}, expected {self._map_frame}")
        covariance = np.reshape(given.covariance, (6, 6))[np.ix_(_PLANE, _PLANE)]
        metres, radians = deviations_of(covariance)  # 0: they are not known
        return pose_of(given.pose), (metres or RADIUS, radians or TOLERANCE)

    def _on_hint(self, message: Any) -> None:
        """Take a pose of the base that somebody thinks of: a tag, a QR code, radio."""
        pose, (metres, radians) = self._given(message)
        least, turn = self.settings.least_deviation
        metres, radians = max(metres, least, 0.01), min(max(radians, turn, 0.001), math.pi)
        hint = Hint(pose.x, pose.y, pose.theta, metres, radians)
        self._hints.append((seconds_of(message.header.stamp), hint))

    def _hinted(self, stamp: float, mount: Pose2D | None = None) -> tuple[Hint, ...]:
        """The young hints, carried by the odometry to a time; of the sensor at `mount`."""
        out, here = list[Hint](), self._odometry(stamp)
        for then, hint in self._hints:
            if abs(stamp - then) <= self.settings.max_age:
                pose, before = Pose2D(hint.x, hint.y, hint.theta), self._odometry(then)
                if before is not None and here is not None:
                    pose = compose(pose, compose(inverse(before), here))
                pose = pose if mount is None else compose(pose, mount)
                out.append(replace(hint, x=pose.x, y=pose.y, theta=pose.theta))
        return tuple(out)

    def _judge(self, asked: _Asked, moment: Moment, site: Site) -> None:
        """Hold the last pose of the localizer that is watched against a scan."""
        if self._watch is None or self._watch.features is not site.features:
            self._watch = Watch(site.features, site.options(self.core.options))
        watch, stamp = self._watch, moment.stamp
        if self.settings.watch == "tf":
            link = self._frames.at(self.settings.base_frame, self._map_frame, stamp)
            if link is not None:
                self._claims.append((stamp, Pose2D(*planar(link))))
        before = [claim for claim in self._claims if claim[0] <= stamp] or list(self._claims)[:1]
        at = self._odometry(before[-1][0]) if before else None

        def work() -> Opinion:
            if before:
                watch.hear(*before[-1], at)
            return watch.step(asked.scan, asked.odom, moment)

        with contextlib.suppress(Dropped):
            self._judging = self.core.soon(work, "watch")
            self._judging.add_done_callback(self._done)

    def _judged(self) -> None:
        """Take what is thought of the localizer that is watched."""
        future, self._judging = self._judging, None
        assert future is not None
        with contextlib.suppress(Dropped):
            before, self.opinion = self.opinion, future.result()
            if before.said != self.opinion.said:
                self._report()

    def _publish(self, found: Found, asked: _Asked) -> None:
        """Publish a first pose that is confirmed."""
        if self.settings.watch:
            self.first.published()
            return
        pose, covariance = found.poses[0], found.covariance
        assert covariance is not None
        header = self.made.header(asked.stamp, self._map_frame)
        least = self.settings.least_deviation
        self._initial.publish(self.made.pose(pose, covariance, header, least))
        self.first.published()
        self._remember(pose, found.stamp, found.map)
        self.node.get_logger().info(f"{self._initial.topic_name}: {words_of(found)}")

    def _take_moment(self, asked: _Asked, answer: Answer[Moment]) -> None:
        """Take what the filter believes: publish its pose while that is unique."""
        moment = answer.value
        site = self.core.site(answer.map, timeout=0)
        found = found_along(moment, site.features.grid.origin, answer.map, asked.scan)
        found = weighed(found, self._hinted(moment.stamp), self.core.options.trust.mass)
        if self.settings.watch:
            self._judge(asked, moment, site)
        fresh = self.first.fresh(moment.stamp, self.now)
        sure = moment.pose is not None and found.why != HINTED and fresh
        self._took = self.now - moment.stamp
        self._followed = self._followed or sure
        holds = self._last.take(moment, sure=sure, longest=self.settings.max_age)
        if sure:
            self._remember(found.poses[0], moment.stamp, answer.map)
        shown, before = self.settings.track or self.first.wanted, self.first.state
        new = moment.looked or moment.withheld == BLIND
        if self.first.believed(moment.stamp, found.pose, self.now, new=new):
            self._publish(found, asked)
        if shown:
            self._show(found, asked, sure=holds)
        if sure and self.settings.track:
            header = self.made.header(asked.stamp, self._map_frame)
            self._pose.publish(self.made.pose(found.poses[0], moment.covariance, header))
            if moment.map_odom is not None:
                link = self.made.link(moment.map_odom, header, self._odom[0])
                self._map_odom.publish(link)
                if self.settings.tf:
                    time_ = self.ros.rclpy.time.Time.from_msg(asked.stamp)
                    ahead = time_ + self.ros.duration.Duration(seconds=_AHEAD)
                    link.header.stamp = ahead.to_msg()
                    self._tf.publish(self.ros.tf2_msgs.TFMessage(transforms=[link]))
        elsewhere = moment.belief.verdict == LOST and moment.metres > self.settings.metres
        if elsewhere and not self._followed and len(self.core.names) > 1:
            self._robot.reset()  # not this floor
            self._robot.map = None
        if self.first.state != before:
            self._report()

    # What is said.

    def _show(self, found: Found, asked: _Asked, *, sure: bool) -> None:
        """Publish the places for those who look on."""
        self.found, self._sure = found, sure
        header = self.made.header(asked.stamp, self._map_frame)
        self._hypotheses.publish(self.made.places(found, header))
        self._markers.publish(self.made.markers(found, asked.scan, header))

    def _report(self) -> None:
        """Say how things are: status, diagnostics; and answer callers who wait too long."""
        self._go_on()
        level, said = self._health()
        stands = self._stands()
        dropped = self.core.dropped + sum(laser.skipped + laser.bad for laser in self.lasers)
        row = status_row(
            self.found, self.first, now=self.now, stands=stands, dropped=dropped, said=said,
            late=bool(self._waits()) or all(map(self._silent, self.lasers)),
        )  # fmt: skip
        if self.settings.watch:
            row["watch"] = {"of": self.settings.watch, **self.opinion.row(self.now)}
        if self.settings.remember:
            row["remembered"] = self._remembered
        self._status.publish(self.made.text(to_json(row)))
        name, time_ = self.node.get_fully_qualified_name(), self.node.get_clock().now().to_msg()
        self._diagnostics.publish(self.made.diagnostics(level, row, name, time_))
        now = time.monotonic()
        if level != self._said[0] or (said != self._said[1] and now > self._said[2] + _SAID):
            if level == ERROR:  # two lines of code: rclpy refuses two severities from one
                self.node.get_logger().error(said)
            else:
                self.node.get_logger().info(said)
            self._said = level, said, now
        self._answer_callers(said)

    def _health(self) -> tuple[int, str]:
        errors = [self._map_error] if self._map_error else []
        errors += [f"map {name}: {error}" for name, error in self.core.errors.items()]
        silent = [
            laser.topic + " (its stamp stays the same)" * laser.frozen
            for laser in self.lasers if self._silent(laser)
        ]  # fmt: skip
        level, said = health(
            self.first, self.found, silent=silent, alive=len(silent) < len(self.lasers),
            errors=errors, waits=self._waits(), track=self._followed and self.settings.track,
            stands=self._stands(),
        )  # fmt: skip
        if self.settings.watch and not (silent or errors or self._waits()):
            level = {AGREES: OK, DISAGREES: ERROR}.get(self.opinion.said, WARN)
            given = self.opinion.pose if level == ERROR else None
            own = f"; imgloc would give {pose_words(given)}" if given is not None else ""
            said = f"{self.settings.watch} {self.opinion.text}{own}"
        return level, said.replace("~/", f"{self.node.get_fully_qualified_name()}/")

    def _silent(self, laser: Topic) -> bool:
        """Return whether a laser has said nothing for too long."""
        return time.monotonic() - laser.heard > self.settings.scan_timeout

    def _frozen(self, laser: Topic) -> bool:
        """Return whether a laser has repeated one scan too long, though it should have changed."""
        stuck = laser.heard < laser.fresh + self.settings.scan_timeout
        blind = self.found is not None and self.found.why == BLIND
        long = time.monotonic() - laser.fresh > self.settings.scan_timeout
        return laser.frozen and long and (blind or stuck)

    def _waits(self) -> str:
        """Lack that keeps scans from being looked at; empty if there is none."""
        if not self.core.names:
            return f"waiting for a map on {self._map_topic}"
        if not self.core.ready:
            return "the map is being prepared"
        for laser in self.lasers:
            if laser.wrong:
                return f"{laser.topic}: {laser.wrong}"
            if laser.late and not laser.frame:
                return f"{laser.topic}: late: no {laser.late} of the time of its scans"
            if laser.frame:
                base = self.settings.base_frame
                return f"{laser.topic}: tf does not say where {laser.frame} sits on {base}"
            if not laser.stamped:
                return f"{laser.topic}: its scans have the stamp 0; expected the driver to set it"
            if self._frozen(laser) and self.first.state != QUIET:
                return f"{laser.topic}: each scan repeats the one before; is its driver frozen?"
            if abs(laser.age) > self.settings.max_age:
                hint = "are the clocks the same, or is use_sim_time needed?"
                return (
                    f"{laser.topic}: its scans are {laser.age:.3g} s old when they come, at most "
                    f"{self.settings.max_age:g} s are taken; {hint}"
                )
        if self._took > self.settings.max_age:
            return (
                f"answers come {self._took:.3g} s after their scans, and poses are published up to "
                f"{self.settings.max_age:g} s: this computer is too slow or too busy; raise max_age"
            )
        return ""

    def _stands(self) -> bool:
        """Return whether what was found still holds: it is new, or the robot has not moved."""
        found = self.found
        if found is None or not self._sure or all(map(self._silent, self.lasers)):
            return False
        if self.first.fresh(found.stamp, self.now):
            return True
        then, here = self._odometry(found.stamp), self._odometry(self.now)
        return then is not None and here is not None and _still(then, here)

    # Services.

    async def _on_localize(self, _: Any, response: Any) -> Any:
        """Start anew, and answer when there is a pose, or it is given up."""
        level, said = self._health()
        if not self.core.ready or level >= ERROR:
            response.success, response.message = False, said
            return response
        self._again()
        caller = _Caller(time.monotonic() + _ANSWERED)
        self._callers.append(caller)
        response.success, response.message = await caller
        return response

    def _answer_callers(self, said: str) -> None:
        state, found, late = self.first.state, self.found, time.monotonic()
        decided = state in (QUIET, GIVEN_UP)
        if not decided and all(caller.until > late for caller in self._callers):
            return
        words = said
        if decided and found is not None and not found.readings:
            words = f"{found.verdict}: {words_of(found)}"
        for caller in self._callers:
            if decided or caller.until <= late:
                caller.answer = state == QUIET, words
        self._callers = [caller for caller in self._callers if caller.answer is None]

    def _on_reset(self, _: Any, response: Any) -> Any:
        self.start_anew("~/reset was called")
        response.success, response.message = True, "starts anew, and looks for a first pose"
        return response

    def _on_reinitialize(self, _: Any, response: Any) -> Any:
        self.start_anew(f"{self.node.resolve_service_name('reinitialize_global_localization')}")
        return response

    def _on_set_pose(self, request: Any, response: Any) -> Any:
        """Follow the robot from a pose that somebody gives; errors are logged."""
        self._guarded("set_initial_pose", self._start_at)(request.pose)
        return response

    def _start_at(self, message: Any) -> None:
        pose, deviation = self._given(message)
        self._robot.start_at(pose, deviation)
        self.node.get_logger().info(f"follows the robot from {pose_words(pose)}")

    def change(self, settings: Settings) -> None:
        """Go on with other values of the parameters that may change."""
        self.settings = self.first.rules = settings
        for stamps in (self._move_stamps, *(laser.stamps for laser in self.lasers)):
            stamps.most = settings.max_age

    def close(self) -> None:
        """Say and hear nothing any more."""
        self._ended = True
        for one, end in self._own.items():
            end(one)

    def _entities(self) -> dict[Any, Callable[[Any], Any]]:
        """All that the node has, and what ends it."""
        node = self.node
        return {one: getattr(node, f"destroy_{kind}") for kind, there in (
            ("publisher", node.publishers), ("subscription", node.subscriptions),
            ("service", node.services), ("timer", node.timers), ("guard_condition", node.guards),
        ) for one in there}  # fmt: skip


def placed(
    seen: LaserScan | Cloud, settings: Settings, name: str, mount: Pose2D | None,
    link: FloatArray | None,
) -> LaserScan:  # fmt: skip
    """The scan of a laser, or the slice of a cloud, cut and mounted.

    The sensor sits at `mount`, or where `link` (4, 4), its pose on the base, has it.
    """
    turned = settings.flipped if link is None else bool(link[2, 2] < 0)
    if isinstance(seen, Cloud):
        low, high = settings.height
        turned, seen = turned and link is None, seen.scan((low, high), link)
        mount = seen.T_base_laser if mount is None else mount
    elif link is not None:
        mount = Pose2D(*planar(link))
    scan = seen.flipped if turned else seen
    reach = min(scan.range_max, settings.range_max)
    return replace(scan, range_max=reach, T_base_laser=mount, laser=name)


def _still(then: Pose2D, here: Pose2D) -> bool:
    """Return whether a robot that was there has hardly moved."""
    metres, turned = difference(here, then)
    return metres < _STILL[0] and turned < _STILL[1]


def managed(
    ros: Any, node: Any, prepare: Callable[[], Localizer],
    start: Callable[[Localizer], LocalizerNode],
) -> Any:  # fmt: skip
    """Managed entity of a lifecycle node: what each transition does.

    `configure` fails, with the reason in the log, if a map or a setting cannot be used.
    """
    done = ros.lifecycle.TransitionCallbackReturn

    class Managed(ros.lifecycle.ManagedEntity):  # type: ignore[misc]
        core: Localizer | None = None
        running: LocalizerNode | None = None

        def on_configure(self, _: Any) -> Any:
            self.core = prepare()
            self.core.wait()
            for error in self.core.errors.values():
                node.get_logger().error(str(error))
            return done.FAILURE if self.core.errors else done.SUCCESS

        def on_activate(self, _: Any) -> Any:
            try:
                self.running = start(self.core)  # type: ignore[arg-type]  # it is configured
            except ImglocError as error:
                node.get_logger().error(str(error))
                return done.FAILURE
            return done.SUCCESS

        def on_deactivate(self, _: Any) -> Any:
            if self.running is not None:
                self.running.close()
                self.running = None
            return done.SUCCESS

        def on_cleanup(self, _: Any) -> Any:
            self.on_deactivate(None)
            if self.core is not None:
                self.core.close()
                self.core = None
            return done.SUCCESS

        on_shutdown = on_error = on_cleanup

    node.add_managed_entity(entity := Managed())
    return entity


def _kept_of(settings: Settings) -> Kept | None:
    """The pose that the file to remember holds, if there is one."""
    return load_kept(settings.remember) if settings.remember else None


@contextlib.contextmanager
def ros_node(
    ros: Any, words: Sequence[str], settings: Settings, *, lifecycle: bool = False
) -> Generator[tuple[Any, Settings, list[int]], None, None]:
    """A node, the settings with its parameters, and the signals that have come to end it."""
    if lifecycle and ros.lifecycle is None:
        raise ConfigError("lifecycle: this rclpy has no rclpy.lifecycle, expected Humble or later")
    asked = list[int]()
    signals = {number: signal.signal(number, lambda n, _: asked.append(n)) for number in _ENDING}
    try:
        # Its own handlers would end it in the middle of a callback.
        ros.rclpy.init(args=list(words), signal_handler_options=ros.signals.SignalHandlerOptions.NO)
        kind = ros.lifecycle.LifecycleNode if lifecycle else ros.node.Node
        node = kind("imgloc", automatically_declare_parameters_from_overrides=True)
    except Exception as error:  # rclpy has a class for each kind of wrong word
        raise ConfigError(f"the arguments of ROS: {error}") from None
    with contextlib.ExitStack() as undo:
        for number, before in signals.items():
            undo.callback(signal.signal, number, before)
        undo.callback(ros.rclpy.try_shutdown)
        undo.callback(node.destroy_node)
        settings = with_parameters(ros, node, settings)
        # What is wrong is said before maps are prepared.
        _ = settings.mounts, _kept_of(settings)
        yield node, settings, asked


def run_node(
    ros: Any, words: Sequence[str], settings: Settings, makers: Mapping[str, Maker],
    options: Options, prepared: Callable[[str, Site], object] | None = None, *,
    lifecycle: bool = False,
) -> int:  # fmt: skip
    """Run a node until a signal ends it; return the exit code, 0.

    Parameters
    ----------
    ros : object
        Of :func:`load_ros`.
    words : sequence of str
        Arguments of ROS.
    settings : Settings
        Where no ROS parameter is set.
    makers : mapping of str to callable
        What makes each map; empty if the map is that of the topic.
    options, prepared : Options, callable
        As of :class:`~imgloc.live.localizer.Localizer`.
    lifecycle : bool
        Wait for a lifecycle manager: `configure` prepares the maps, `activate` answers.
    """
    with (
        ros_node(ros, words, settings, lifecycle=lifecycle) as (node, settings, asked),
        contextlib.ExitStack() as undo,
    ):

        def prepare() -> Localizer:
            return Localizer(
                makers, options, background=True, prepared=prepared,
                clock=lambda: float(node.get_clock().now().nanoseconds) * 1e-9,
            )  # fmt: skip

        running = list[LocalizerNode]()

        def told(changed: Settings) -> None:
            nonlocal settings
            settings = changed
            for one in running:
                one.change(settings)

        node.add_on_set_parameters_callback(on_change(ros, settings, told))

        def start(core: Localizer) -> LocalizerNode:
            running[:] = [LocalizerNode(ros, node, settings, core, from_topic=not makers)]
            return running[0]

        if lifecycle:
            undo.callback(managed(ros, node, prepare, start).on_cleanup, None)
        else:
            undo.callback((core := prepare()).close)
            undo.callback(start(core).close)
        executor = ros.executors.SingleThreadedExecutor()
        executor.add_node(node)
        undo.callback(executor.remove_node, node)
        while not asked:
            executor.spin_once(timeout_sec=_LOOK)
    return 0
