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
from types import SimpleNamespace
from typing import Any

import numpy as np

from imgloc.errors import ConfigError, ImglocError, ScanError, printable
from imgloc.filters.follow import Moment
from imgloc.io.messages import (
    Frames,
    frame_name,
    grid_from_msg,
    link_of,
    mounting_of,
    move_of,
    planar,
    scan_from_msg,
)
from imgloc.io.odometry import odometry_at
from imgloc.live.line import Dropped
from imgloc.live.localizer import Answer, Chosen, Localizer
from imgloc.live.messages import Messages, words_of
from imgloc.live.policy import GIVEN_UP, QUIET, FirstPose, Rules, Sighting
from imgloc.live.sites import Maker, Site
from imgloc.live.status import ERROR, Found, found_along, found_blind, found_of, health, status_row
from imgloc.model import LaserScan, Localization, Pose2D, check_mount, to_json
from imgloc.options import Options

MODULES = {
    "sensor_msgs": "msg", "nav_msgs": "msg", "geometry_msgs": "msg", "std_msgs": "msg",
    "diagnostic_msgs": "msg", "rcl_interfaces": "msg", "visualization_msgs": "msg",
    "std_srvs": "srv",
}  # fmt: skip
_PARTS = ("callback_groups", "clock", "duration", "exceptions", "executors", "qos", "signals")
MISSING = (
    "a ROS 2 node needs rclpy: source a ROS 2 whose Python is this one, or pip install "
    "'imgloc[node]'"
)
_LOOK = 0.5  # seconds between two looks at what has become of everything
_KEPT = 10.0  # seconds that who comes late still gets /initialpose: what tf2 remembers by default
_BACK = 1.0  # seconds; stamps that go back farther are a time that begins anew
_AHEAD = 1.0  # seconds; a stamp farther ahead of the clock counts if the one before is so as well
_ANSWERED = 15.0  # seconds that ~/localize waits for a pose at most
_MOVES = 4000  # poses of the odometry that are remembered: 20 s of 200 a second
_STILL = (0.1, 0.05)  # metres, radians: a robot that has gone less far stands
_SAID = 5.0  # seconds between two lines of the log that differ in words alone
_TURN = 0.005  # seconds
_NEAR, _WIDE = 0.01, 1e3  # metres and seconds at least; metres and radians at most
_NAME = 100  # letters of a frame's name that are shown
_MAP = "map"
_OTHERS, _POLICIES = ("use_sim_time", "start_type_description_service"), "qos_overrides."  # rclpy's
_ENDING = (signal.SIGINT, signal.SIGTERM)
INTERRUPTED = 128 + signal.SIGINT


@dataclass(frozen=True)
class Settings:
    """What the node does; each field but `maps` is a ROS parameter of its name."""

    scan_topics: tuple[str, ...] = ("scan",)
    sensor: tuple[float, ...] = ()  #: x, y, yaw on the robot of each laser; none: by tf
    flipped: bool = False  #: whether the lasers hang upside down
    range_max: float = math.inf  #: metres at which readings are cut
    base_frame: str = "base_link"
    map_frame: str = "map"
    every: float = 0.3  #: seconds between scans that are tried
    metres: float = 0.3  #: or metres of driving
    tries: int = 100  #: until the first pose is given up
    max_age: float = 2.0  #: seconds of a scan whose pose is published
    scan_timeout: float = 1.0  #: seconds until a laser counts as silent
    #: standard deviations of /initialpose at least, metres and radians: a localizer that starts
    #: from it needs room for its own errors
    least_deviation: tuple[float, ...] = (0.1, 0.05)
    track: bool = False  #: follow the robot

    def __post_init__(self) -> None:
        for name, low in (("range_max", _NEAR), ("scan_timeout", _NEAR)):
            if not (value := getattr(self, name)) >= low:
                raise ConfigError(f"parameter {name}: got {value:g}, expected {low:g} or more")
        least = self.least_deviation
        if len(least) != 2 or not all(0 <= value < _WIDE for value in least):
            raise ConfigError(
                f"parameter least_deviation: got {list(least)}, expected metres and radians, each "
                f"0 to {_WIDE:g}"
            )
        if not self.scan_topics or not all(self.scan_topics):
            got = list(self.scan_topics)
            raise ConfigError(f"parameter scan_topics: got {got}, expected at least one name")
        for name in ("map_frame", "base_frame"):
            if not frame_name(getattr(self, name)):
                raise ConfigError(f"parameter {name}: is empty, expected the name of a frame")
        if not all(map(math.isfinite, self.sensor)):
            raise ConfigError(f"parameter sensor: got {list(self.sensor)}, expected finite numbers")

    @property
    def rules(self) -> Rules:
        """Those of the first pose."""
        try:
            return Rules(self.every, self.metres, self.tries, self.max_age)
        except ConfigError as error:
            raise ConfigError(f"parameter {str(error).removeprefix('Rules.')}") from None

    @property
    def mounts(self) -> list[Pose2D] | None:
        """Where each laser sits; None if tf has to say it."""
        if not self.sensor:
            return None
        if len(self.sensor) != 3 * len(self.scan_topics):
            raise ConfigError(
                f"sensor: got {len(self.sensor)} numbers, expected x, y, yaw for each of "
                f"{len(self.scan_topics)} scan_topics"
            )
        mounts = [Pose2D(*row) for row in np.reshape(self.sensor, (-1, 3)).tolist()]
        for mount in mounts:
            check_mount(mount, "sensor")
        if len(set(mounts)) < len(mounts):
            raise ConfigError("sensor: two lasers sit at the same place, expected one of them")
        return mounts


def load_ros() -> Any:
    """The modules of ROS 2 by their names; a ConfigError without them."""
    try:
        found = {name: importlib.import_module(f"{name}.{of}") for name, of in MODULES.items()}
        found |= {name: importlib.import_module(f"rclpy.{name}") for name in _PARTS}
        rclpy = importlib.import_module("rclpy")
    except ImportError as error:
        raise ConfigError(f"{MISSING} ({error})") from None
    tf = None
    with contextlib.suppress(ImportError):
        tf = importlib.import_module("tf2_msgs.msg")
    return SimpleNamespace(rclpy=rclpy, tf2_msgs=tf, **found)


def with_parameters(ros: Any, node: Any, settings: Settings) -> Settings:
    """The settings with what was said by ROS parameters; ConfigError for a wrong one."""
    said, known = dict[str, Any](), vars(settings)
    given = node.get_parameters_by_prefix("")  # rclpy has declared what was passed, and its own
    for name in sorted(given.keys() - known.keys()):
        if name not in _OTHERS and not name.startswith(_POLICIES):
            near = difflib.get_close_matches(name, known, 1)
            hint = f"did you mean {near[0]}?" if near else f"expected {', '.join(known)}"
            node.get_logger().warning(f"parameter {name}: unknown, and ignored; {hint}")
    for name, default in known.items():
        if name in given:
            node.undeclare_parameter(name)
        about = ros.rcl_interfaces.ParameterDescriptor(dynamic_typing=True, read_only=True)
        plain = list(default) if isinstance(default, tuple) else default
        value = node.declare_parameter(name, plain, about).value
        said[name] = _as(value, default, name)
    return replace(settings, **said)


def _as(value: Any, default: Any, name: str) -> Any:
    """A parameter's value as the setting has it."""
    kind = type(default)
    if kind is tuple:
        items = [value] if isinstance(value, str | int | float) else list(value or [])
        names = name == "scan_topics"
        if any(isinstance(i, bool) or isinstance(i, str) != names for i in items):
            expected = "names" if names else "numbers"
            raise ConfigError(f"parameter {name}: got {items}, expected {expected}")
        return tuple(items if names else map(float, items))
    numbers = kind in (int, float) and isinstance(value, int | float)
    if isinstance(value, bool) != (kind is bool) or not (numbers or isinstance(value, kind)):
        raise ConfigError(f"parameter {name}: got {value!r}, expected {kind.__name__}")
    return kind(value)


@dataclass(eq=False)
class Laser:
    """One topic of scans."""

    topic: str
    mount: Pose2D | None  #: None: tf says it
    heard: float = -math.inf  #: seconds, monotonic, of the last message
    stamp: float = -math.inf  #: of the last scan
    latest: float = -math.inf  #: the highest stamp so far, no higher than the clock was
    age: float = math.nan  #: seconds that the last scan had when it came
    ranges: bytes = b""  #: of the last scan
    bad: int = 0  #: messages that are no scan, and what is wrong with the last one
    wrong: str = ""
    skipped: int = 0  #: scans that came late, or again
    fresh: float = -math.inf  #: seconds, monotonic, of the last scan that repeats none
    frozen: bool = False  #: whether the last scan repeats the one before
    stamped: bool = True  #: whether the last scan has a stamp
    frame: str = ""  #: whose place tf does not say


@dataclass(eq=False)
class _Asked:
    """A scan that is looked at."""

    scan: LaserScan
    stamp: Any  # as it stands in the message
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
        If nothing can say where the lasers sit, or a setting is out of its range.
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
        self.ros, self.node, self.settings, self.core = ros, node, settings, core
        self.made = Messages(ros)
        self.from_topic = from_topic
        self.first = FirstPose(settings.rules)
        self.lasers = [
            Laser(topic, None if mounts is None else mounts[k])
            for k, topic in enumerate(settings.scan_topics)
        ]
        self.found: Found | None = None
        self._sure = False  # whether that is a pose that was published
        self._took = 0.0  # seconds from the last scan that was tried to its answer
        self._followed = False  # whether the filter has had a pose
        self._map_frame, self._odom_frame = settings.map_frame, "odom"
        self._moves = deque[tuple[float, float, float, float]](maxlen=_MOVES)
        self._odom_age = math.nan  # seconds that the last of the odometry had when it came
        self._frames = Frames()
        self._map: tuple[Any, bytes] | None = None
        self._map_error = ""
        self._era = 0  # of the answers that count
        self._asked: _Asked | None = None
        self._tracked = deque[_Asked]()
        self._robot = core.robot() if settings.track else None
        self._callers = list[_Caller]()  # who waits for an answer of ~/localize
        self._said = (-1, "", 0.0)  # level and sentence that were logged last, and when
        self._ended = False
        self._connect()

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
        for laser in self.lasers:
            self._hear(ros.sensor_msgs.LaserScan, laser.topic, self._scan_of(laser), sensor)
        self._hear(ros.nav_msgs.Odometry, "odom", self._on_odometry, sensor)
        if self.from_topic:
            self._hear(ros.nav_msgs.OccupancyGrid, "map", self._on_map, latched)
        if ros.tf2_msgs is not None:
            still = qos.QoSProfile(depth=100, reliability=reliable, durability=latched.durability)
            self._hear(ros.tf2_msgs.TFMessage, "/tf_static", self._on_transforms, still)
            self._hear(ros.tf2_msgs.TFMessage, "/tf", self._on_transforms, 100)
        say = node.create_publisher
        geometry = ros.geometry_msgs
        self._initial = say(geometry.PoseWithCovarianceStamped, "initialpose", passing)
        self._hypotheses = say(geometry.PoseArray, "~/hypotheses", latched)
        self._markers = say(ros.visualization_msgs.MarkerArray, "~/markers", latched)
        self._status = say(ros.std_msgs.String, "~/status", latched)
        self._diagnostics = say(ros.diagnostic_msgs.DiagnosticArray, "/diagnostics", 10)
        if self._robot is not None:
            self._pose = say(geometry.PoseWithCovarianceStamped, "~/pose", 10)
            self._map_odom = say(geometry.TransformStamped, "~/map_odom", 10)
        trigger = ros.std_srvs.Trigger
        beside = ros.callback_groups.ReentrantCallbackGroup()  # while one waits all else goes on
        node.create_service(trigger, "~/localize", self._on_localize, callback_group=beside)
        node.create_service(trigger, "~/reset", self._on_reset, callback_group=beside)
        self._wake = node.create_guard_condition(self._guarded("answers", self._on_answers))
        steady = ros.clock.Clock(clock_type=ros.clock.ClockType.STEADY_TIME)
        node.create_timer(_LOOK, self._guarded("status", self._report), clock=steady)

    def _hear(self, kind: Any, topic: str, heard: Callable[[Any], None], qos: Any) -> None:
        guarded = self._guarded(topic, heard)
        try:
            self.node.create_subscription(kind, topic, guarded, qos)
        except self.ros.exceptions.InvalidTopicNameException as error:
            why = str(error).splitlines()[0].removesuffix(":")
            raise ConfigError(f"parameter scan_topics: got {topic!r}: {why}") from None

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

    def _scan_of(self, laser: Laser) -> Callable[[Any], None]:
        return lambda message: self._on_scan(laser, message)

    def _on_scan(self, laser: Laser, message: Any) -> None:
        before, laser.heard = laser.heard, time.monotonic()
        now = self.now
        try:
            scan = self._complete(laser, message)
        except ScanError as error:
            laser.bad, laser.wrong = laser.bad + 1, str(error).removeprefix(f"{laser.topic}: ")
            raise
        age, laser.wrong, laser.age = laser.age, "", now - scan.stamp
        laser.stamped = bool(scan.stamp) or self.first.fresh(0.0, now)  # a clock may begin at 0
        if not laser.stamped or self._leaps_ahead(age, laser.age):
            laser.skipped += 1
            return
        if scan.stamp < laser.latest - _BACK:
            self.start_anew("the time of the scans has gone back")
        elif scan.stamp <= laser.latest or scan.stamp == laser.stamp:
            laser.skipped, laser.heard = laser.skipped + 1, before
            self._repeat(laser, now)
            return
        content = scan.ranges.tobytes()
        again, laser.ranges, laser.stamp = content == laser.ranges, content, scan.stamp
        laser.latest = max(laser.latest, min(scan.stamp, now))
        if again:
            self._repeat(laser, now)
        else:
            laser.fresh, laser.frozen = laser.heard, False
        if scan.T_base_laser is None or not self.core.ready:
            return
        odom = self._odometry(scan.stamp)
        if self._robot is not None and odom is not None:
            self._follow(laser, scan, message.header.stamp, odom)
        if again or not self.first.fresh(scan.stamp, now):
            laser.skipped += 1
            return
        if self.first.due(scan.stamp, odom):
            self._ask(scan, message.header.stamp, odom)

    def _leaps_ahead(self, before: float, age: float) -> bool:
        """Whether a stamp is wrong: ahead of the clock, unlike the one before, or by too much.

        Ages are in seconds. All that comes after such a stamp would seem to lie in the past. A
        sensor whose clock is a little ahead has all its stamps ahead.
        """
        return age < -_AHEAD and (not before < -_AHEAD or age < -self.settings.max_age)

    def _repeat(self, laser: Laser, now: float) -> None:
        """Take note of a scan that repeats the one before, or comes after a later one."""
        laser.frozen = True
        if self.core.ready and all(self._frozen(one) or self._silent(one) for one in self.lasers):
            self.first.repeated(now)

    def _complete(self, laser: Laser, message: Any) -> LaserScan:
        """The scan, cut and mounted; with no mounting as long as tf does not say it."""
        mount, turned = laser.mount, self.settings.flipped
        if mount is None:
            name = frame_name(message.header.frame_id)
            laser.frame = printable(name)[:_NAME]
            link = mounting_of(self._frames, name, self.settings.base_frame)
            if link is not None:
                mount, turned, laser.frame = Pose2D(*planar(link)), link[2, 2] < 0, ""
        scan = scan_from_msg(message, laser.topic, mount, received=0.0)
        if turned:
            scan = scan.flipped
        return replace(scan, range_max=min(scan.range_max, self.settings.range_max))

    def _on_odometry(self, message: Any) -> None:
        move = move_of(message)
        if not all(map(math.isfinite, move)):
            return
        before, self._odom_age = self._odom_age, self.now - move[0]
        if self._leaps_ahead(before, self._odom_age):
            return
        if self._moves and move[0] < self._moves[-1][0] - _BACK:
            self._moves.clear()
        self._odom_frame = frame_name(message.header.frame_id) or "odom"
        self._moves.append(move)

    def _odometry(self, stamp: float) -> Pose2D | None:
        """The robot's pose by odometry at a time; None if that is not known."""
        if not self._moves:
            return None
        table = np.array(self._moves)
        found = odometry_at(np.array([stamp]), table[:, 0], table[:, 1:])
        return None if found is None or np.isnan(found).any() else Pose2D(*found[0])

    def _on_map(self, message: Any) -> None:
        stamp, data = message.header.stamp, bytes(message.data)
        if self._map is not None and (stamp, data) == self._map:
            return  # the same message once more: it is latched
        try:
            grid = grid_from_msg(message, "map")
            self.core.put(_MAP, grid)
        except ImglocError as error:
            self._map_error = str(error)
            raise
        self._map, self._map_error = (stamp, data), ""
        self._map_frame = frame_name(message.header.frame_id) or self.settings.map_frame
        self.start_anew("a map came")

    def _on_transforms(self, message: Any) -> None:
        for item in message.transforms:
            child, parent, pose = link_of(item)
            if np.isfinite(pose).all():
                self._frames[child] = parent, pose

    # What is asked, and what becomes of the answers.

    def start_anew(self, why: str) -> None:
        """Know nothing any more: of the place, the way, and what was asked."""
        self.node.get_logger().info(f"starts anew: {why}")
        self._again()
        self.found, self._sure, self._followed = None, False, False
        self._moves.clear()
        for laser in self.lasers:
            laser.stamp, laser.latest, laser.ranges = -math.inf, -math.inf, b""
        if self._robot is not None:
            self._robot.reset()
        self._tracked.clear()

    def _again(self) -> None:
        """Look for a first pose once more; answers to what was asked before do not count."""
        self.first.start()
        self._took = 0.0
        self._era += 1
        self._asked = None

    def _ask(self, scan: LaserScan, stamp: Any, odom: Pose2D | None) -> None:
        many = len(self.core.names) > 1
        future: Future[Any]
        try:
            future = self.core.which_soon(scan) if many else self.core.localize_soon(scan)
        except Dropped:  # another map has come meanwhile
            self.first.answered(None, self.now)
            return
        self._asked = _Asked(scan, stamp, odom, future, self._era)
        future.add_done_callback(self._done)

    def _follow(self, laser: Laser, scan: LaserScan, stamp: Any, odom: Pose2D) -> None:
        assert self._robot is not None
        if self._robot.map is None and len(self.core.names) > 1:
            return  # on which floor is not known yet
        pose = np.array([odom.x, odom.y, odom.theta])
        with contextlib.suppress(Dropped):
            future = self._robot.update_soon(scan, pose, source=laser.topic)
            self._tracked.append(_Asked(scan, stamp, odom, future, self._era))
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
        """Take the answer to a scan: say it, and publish its pose if it is confirmed."""
        answer = self._result(asked)
        if answer is None or asked.era != self._era:
            self.first.answered(None, self.now)
            return
        value, name = answer.value, answer.map
        if isinstance(value, Chosen):
            found = Found(asked.scan.stamp, None, "no-match")
            verdict = value.choice.verdict
            if value.best is not None:
                found = found_of(value.best, asked.scan.stamp, name)
        else:
            assert isinstance(value, Localization)
            verdict, found = value.verdict, found_of(value, asked.scan.stamp, name)
        blind = verdict == "invalid"
        if blind:
            found = found_blind(asked.scan, name)
        self._took = self.now - asked.scan.stamp
        sighting = Sighting(asked.scan.stamp, found.map, found.pose, asked.odom, blind)
        sure = self.first.answered(sighting, self.now)
        if not self._followed:
            self._show(found, asked, sure=sure)
        if sure:
            self._publish(found, asked)
        self._report()

    def _publish(self, found: Found, asked: _Asked) -> None:
        """Publish a first pose that is confirmed."""
        pose, covariance = found.pose, found.covariance
        assert pose is not None
        assert covariance is not None
        header = self.made.header(asked.stamp, self._map_frame)
        least = self.settings.least_deviation
        self._initial.publish(self.made.pose(pose, covariance, header, least))
        self.first.published()
        self.node.get_logger().info(f"initialpose: {words_of(found)}")
        if self._robot is not None and self._robot.map is None and len(self.core.names) > 1:
            self._robot.reset(found.map)  # the filter finds its own way there

    def _take_moment(self, asked: _Asked, answer: Answer[Moment]) -> None:
        """Take what the filter believes: publish its pose while that is unique."""
        moment = answer.value
        site = self.core.site(answer.map, timeout=0)
        found = found_along(moment, site.features.grid.origin, answer.map)
        sure = moment.pose is not None and self.first.fresh(moment.stamp, self.now)
        self._followed = self._followed or sure
        if self._followed:  # until then the first pose is what is known
            self._show(found, asked, sure=sure)
        if moment.pose is None or moment.map_odom is None or not sure:
            return
        header = self.made.header(asked.stamp, self._map_frame)
        self._pose.publish(self.made.pose(moment.pose, moment.covariance, header))
        self._map_odom.publish(self.made.link(moment.map_odom, header, self._odom_frame))

    # What is said.

    def _show(self, found: Found, asked: _Asked, *, sure: bool) -> None:
        """Publish the places for those who look on."""
        self.found, self._sure = found, sure
        header = self.made.header(asked.stamp, self._map_frame)
        self._hypotheses.publish(self.made.places(found, header))
        self._markers.publish(self.made.markers(found, asked.scan, header))

    def _report(self) -> None:
        """Say how things are: status, diagnostics; and answer callers who wait too long."""
        level, said = self._health()
        stands = self._stands()
        dropped = self.core.dropped + sum(laser.skipped + laser.bad for laser in self.lasers)
        row = status_row(
            self.found, self.first, now=self.now, stands=stands, dropped=dropped, said=said
        )
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
        return health(
            self.first, self.found, silent=silent, alive=len(silent) < len(self.lasers),
            errors=errors, waits=self._waits(), track=self._followed,
        )  # fmt: skip

    def _silent(self, laser: Laser) -> bool:
        """Whether a laser has said nothing for too long."""
        return time.monotonic() - laser.heard > self.settings.scan_timeout

    def _frozen(self, laser: Laser) -> bool:
        """Whether a laser has repeated one scan for too long."""
        return laser.frozen and time.monotonic() - laser.fresh > self.settings.scan_timeout

    def _waits(self) -> str:
        """What is lacking before a scan can be looked at."""
        if not self.core.names:
            return "waiting for a map on the topic map"
        if not self.core.ready:
            return "the map is being prepared"
        for laser in self.lasers:
            if laser.wrong:
                return f"{laser.topic}: {laser.wrong}"
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
        """Whether what was found still holds: it is new, or the robot has not moved since."""
        found = self.found
        if found is None or not self._sure or all(map(self._silent, self.lasers)):
            return False
        if self.first.fresh(found.stamp, self.now):
            return True
        then, here = self._odometry(found.stamp), self._odometry(self.now)
        if then is None or here is None:
            return False
        turned = abs(math.remainder(here.theta - then.theta, math.tau))
        return math.hypot(here.x - then.x, here.y - then.y) < _STILL[0] and turned < _STILL[1]

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

    def close(self) -> None:
        """Say nothing any more."""
        self._ended = True


def run_node(
    ros: Any,
    words: Sequence[str],
    settings: Settings,
    makers: Mapping[str, Maker],
    options: Options,
    prepared: Callable[[str, Site], object] | None = None,
) -> int:
    """Run a node until a signal ends it; return the exit code: 0, or 130 after Ctrl-C.

    Parameters
    ----------
    ros : object
        Of :func:`load_ros`.
    words : sequence of str
        Arguments of ROS.
    settings : Settings
        Where ROS parameters say nothing else.
    makers : mapping of str to callable
        What makes each map; empty if the map is that of the topic.
    options, prepared : Options, callable
        As of :class:`~imgloc.live.localizer.Localizer`.
    """
    asked = list[int]()
    signals = {number: signal.signal(number, lambda n, _: asked.append(n)) for number in _ENDING}
    try:
        # Its own handlers would end it in the middle of a callback.
        ros.rclpy.init(args=list(words), signal_handler_options=ros.signals.SignalHandlerOptions.NO)
        node = ros.rclpy.create_node("imgloc", automatically_declare_parameters_from_overrides=True)
    except Exception as error:  # rclpy has a class for each kind of wrong word
        raise ConfigError(f"the arguments of ROS: {error}") from None
    with contextlib.ExitStack() as undo:
        for number, before in signals.items():
            undo.callback(signal.signal, number, before)
        undo.callback(ros.rclpy.try_shutdown)
        undo.callback(node.destroy_node)
        settings = with_parameters(ros, node, settings)
        core = Localizer(
            makers, options, background=True, prepared=prepared,
            clock=lambda: float(node.get_clock().now().nanoseconds) * 1e-9,
        )  # fmt: skip
        undo.callback(core.close)
        running = LocalizerNode(ros, node, settings, core, from_topic=not makers)
        undo.callback(running.close)
        executor = ros.executors.SingleThreadedExecutor()
        executor.add_node(node)
        undo.callback(executor.remove_node, node)
        while not asked:
            executor.spin_once(timeout_sec=_LOOK)
    return INTERRUPTED if asked[0] == signal.SIGINT else 0
