"""CARMEN logs: lines of words, a message a line; and those of DP-SLAM, which are much alike.

>>> from tempfile import TemporaryDirectory
>>> from pathlib import Path
>>> line = "FLASER 181 " + 181 * "2.5 " + "1 2 0.5 1 2 0.5 1211.5 robot 0.1"
>>> with TemporaryDirectory() as folder:
...     path = Path(folder, "a.log")
...     _ = path.write_text(line)
...     scans = read_carmen(path)
>>> scans.odom.tolist(), scans.stamps.tolist(), scans[0].range_max
([[1.0, 2.0, 0.5]], [1211.5], 80.0)
"""

import contextlib
import logging
import math
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from string import digits

import numpy as np

from imgloc.errors import ScanError
from imgloc.io.badlines import BadLines
from imgloc.io.files import PathLike, display
from imgloc.io.scanset import Entry, ScanSet, collect, spread, wrong
from imgloc.io.text import read_text
from imgloc.io.textscans import check_lines
from imgloc.model import MOUNTED, FloatArray, LaserScan, Pose2D, compose, inverse, wrapped_pose
from imgloc.options import MAX_BAD
from imgloc.robot.odometry import Odometry

_LOG = logging.getLogger("imgloc")
# In the order of preference: a log may hold the same laser in an old and in a new form.
_LASERS = re.compile(r"ROBOTLASER\d|FLASER|RAWLASER\d|Laser|RLASER|LASER\d|L")
_PREFERRED = ("ROBOTLASER1", "FLASER", "RAWLASER1", "Laser", "L", "RLASER")
_WHOLE = ("ROBOTLASER1", "FLASER", "Laser", "L")  # with the robot's pose in or before them
_ODOMETRY = ("ODOM", "Odometry")
# SICK scanners, the only ones when FLASER was made: readings of a half turn, and the step of the
# rays in degrees, the first at -90 (the last of an even number is not recorded).
_SICK_STEPS = {180: 1.0, 181: 1.0, 360: 0.5, 361: 0.5}
# Their greatest words of 13 to 15 bits, which mean "nothing seen", and how far they reach then.
_SICK_REACH = ((8.18, 8.2, 8.0), (16.36, 16.4, 16.0), (32.72, 32.8, 32.0))
_REACH = 80.0
_RIGID = 5e-3  # metres, radians: six digits of a pose that is hundreds of metres away
_CENTIMETRES = 0.01  # metres
# For each kind of message, the place of the number of readings, and the least words behind them.
_COUNTS = {"ROBOTLASER": (8, 14), "FLASER": (1, 6), "RLASER": (1, 6), "Laser": (1, 0)}
_RAW = (8, 3)


@dataclass(frozen=True, eq=False)
class _Message:
    """Contents of a line about a laser."""

    where: str
    ranges: FloatArray
    stamp: float
    angles: FloatArray | None = None  # None: from the number of readings
    range_max: float = math.nan  # NaN: the log does not state it
    laser: Pose2D | None = None
    robot: Pose2D | None = None


def read_carmen(
    path: PathLike, *, topic: str | None = None, fov: float | None = None, max_bad: float = MAX_BAD
) -> ScanSet:
    """Read the scans of a CARMEN log, with the robot's odometry and where its laser sits.

    Messages read are ``ROBOTLASER1`` (and 2 to 5; with or without the number of remissions),
    ``FLASER``, ``RLASER``, ``RAWLASER1``, ``ODOM``, ``PARAM``; ``Laser`` with ``Odometry`` of
    DP-SLAM; and ``L`` of the logs that many courses use for a first particle filter: poses and
    180 ranges, all in centimetres. Any other line is left out, as is a last line that was cut off.

    `odom` is the robot's pose as each message holds it, or that of the ODOM lines at its time.
    If the laser's poses move against the robot's, a mapper has corrected them: they are `poses`
    then. If not, they are the place of the laser: `T_base_laser`. If the robot's poses never change
    and the laser's do, the laser's are the odometry; whether they are true poses, too, is up to the
    map (:func:`imgloc.answers.truth.poses_fit`).

    Parameters
    ----------
    path : path
        ScanError, with the line, if it cannot be read, or holds no laser.
    topic : str, optional
        Messages of which laser, by the word they begin with; the front laser by default.
    fov : float, optional
        Angle from the first to the last ray, radians, of lasers without it (FLASER,
        RLASER, Laser). 180, 181, 360 and 361 readings need none, those are SICK scanners, nor
        does a log whose parameters have ``laser_front_laser_resolution``.
    max_bad : float
        Share of the laser's lines, 0 to 1, that may be broken: they are left out, with a warning.
    """
    name, lines = display(path), _lines(path)
    first = [line.split(None, 1)[0] for _, line in lines]
    counts = Counter(word for word in first if _LASERS.fullmatch(word))
    chosen = _choose(counts, topic, name)
    parameters = {
        words[1]: words[2]
        for (_, line), word in zip(lines, first, strict=True)
        if word == "PARAM" and len(words := line.split()) > 2
    }
    messages, moves = list[_Message](), list[tuple[float, float, float, float]]()
    bad = BadLines(name, max_bad)
    for (number, line), word in zip(lines, first, strict=True):
        words = line.split()
        where = f"{name}: line {number}: {word}"
        try:
            if word == chosen:
                messages.append(_message(words, where))
                if chosen == "Laser" and moves:  # the pose of the line before
                    messages[-1] = replace(messages[-1], robot=wrapped_pose(*moves[-1][1:]))
            elif word in _ODOMETRY:
                moves.append(_move(words, where))
        except ScanError as error:
            off = messages and number == lines[-1][0]  # whoever wrote the log was switched off
            bad.skip(error, where if off else "")
    if not messages:
        bad.check(0)
        raise ScanError(f"{name}: holds no whole {chosen}, expected at least one")
    messages = _stamped(messages, bad)
    bad.check(len(messages) + len(moves))
    return _assemble(messages, moves, parameters, fov, name, rear=chosen == "RLASER")


def _stamped(messages: list[_Message], bad: BadLines) -> list[_Message]:
    """The messages, without those that lack a stamp if most have one."""
    lacking = [message for message in messages if math.isnan(message.stamp)]
    if 2 * len(lacking) > len(messages):
        return messages
    for message in lacking:
        bad.skip(ScanError(f"{message.where}: the stamp is missing, expected seconds"))
    return [message for message in messages if not math.isnan(message.stamp)]


class CarmenLines:
    """The scans of a CARMEN log that is still being written, each of its own line alone.

    Read are messages that hold the robot's pose: ``ROBOTLASER1``, ``FLASER``, and ``Laser`` after
    ``Odometry``. Scans are those of :func:`read_carmen`, as far as a line goes: the place of the
    laser is that of the first message, and a stamp written with six digits for seconds since 1970
    is none.

    Parameters
    ----------
    topic, fov : str, float
        As of :func:`read_carmen`; by default the first laser that comes, of one of these.

    Examples
    --------
    >>> lines = CarmenLines()
    >>> lines.take("PARAM robot_front_laser_max 50", "line 1")
    >>> lines.take("FLASER 2 2.5 2.5 1 2 0.5 1 2 0.5 1211.5 robot 0.1", "line 2")
    Traceback (most recent call last):
        ...
    imgloc.errors.ScanError: line 2: FLASER: 2 readings, expected with them the angle that they ...
    >>> lines.take("FLASER 181 " + 181 * "2.5 " + "1 2 0.5 1 2 0.5 1211.5 robot 0.1", "line 3").odom
    array([[1. , 2. , 0.5]])
    """

    def __init__(self, topic: str | None = None, fov: float | None = None) -> None:
        self._word, self._fov = topic, fov
        self._parameters = dict[str, str]()
        self._odometry: Pose2D | None = None
        self._mount: Pose2D | None = None
        self._count = 0

    def take(self, line: str, where: str) -> ScanSet | None:
        """The scan of a line; None for a line of anything else.

        ScanError, by `where` it is, if a word is missing, or the laser's poses move against the
        robot's: a mapper has corrected them.
        """
        words = line.split()
        where = f"{where}: {words[0]}"
        if words[0] in _ODOMETRY:
            self._odometry = wrapped_pose(*_move(words, where)[1:])
        elif words[0] == "PARAM" and len(words) > 2:
            self._parameters[words[1]] = words[2]
        elif words[0] == self._word or (self._word is None and words[0] in _WHOLE):
            scan = self._scan(words, where)
            self._word = words[0]
            return scan
        return None

    def _scan(self, words: Sequence[str], where: str) -> ScanSet:
        word, message = words[0], _message(words, where)
        if word == "Laser":
            message = replace(message, robot=self._odometry)
        elif "e" in words[-3].lower():
            message = replace(message, stamp=math.nan)
        scans = _assemble([message], [], self._parameters, self._fov, where, rear=word == "RLASER")
        return replace(scans, scans=(self._placed(scans.scans[0], where),))

    def _placed(self, scan: LaserScan, where: str) -> LaserScan:
        """The scan with the laser where it was at first."""
        at, self._count = scan.T_base_laser, self._count + 1
        if self._count == 1:
            self._mount = at
        if self._mount is None:
            return replace(scan, T_base_laser=None)
        off = (getattr(at, k, 0.0) - getattr(self._mount, k) for k in ("x", "y", "theta"))
        if max(abs(math.remainder(value, math.tau)) for value in off) > _RIGID:
            raise ScanError(
                f"{where}: the laser has moved on the robot since the first message: a mapper has "
                "corrected its poses; give the log as a file, not as a stream"
            )
        return replace(scan, T_base_laser=self._mount)


def placed(scans: ScanSet) -> ScanSet:
    """Scans of a laser; its mount is the identity by default."""
    if scans.poses is not None or scans.odom is None:
        return scans
    at = tuple(replace(s, T_base_laser=s.mount) for s in scans.scans)
    return replace(scans, scans=at)


def _lines(path: PathLike) -> list[tuple[int, str]]:
    """The lines that are neither blank nor comments, with their numbers."""
    # Only names of hosts may be anything else than ASCII, and what an editor puts in front.
    lines = check_lines(read_text(path, errors="replace").split("\n"), display(path))
    return [(i, line) for i, line in lines if not line.startswith("#")]


def _choose(counts: Counter[str], topic: str | None, name: str) -> str:
    """The laser asked for, else the front one."""
    if not counts:
        expected = "expected FLASER, ROBOTLASER1 or RAWLASER1 in a .log; tables are .csv or .txt"
        raise ScanError(f"{name}: no line of a laser, {expected}")
    if topic is None:
        return next((word for word in _PREFERRED if word in counts), min(counts))
    if topic not in counts:
        there = ", ".join(f"{word} ({n})" for word, n in sorted(counts.items()))
        raise ScanError(f"{name}: no messages {topic}; it has {there}")
    return topic


def _message(words: Sequence[str], where: str) -> _Message:
    """The message of a line; a ScanError that names the word that is missing or is no number."""
    try:
        return _OTHER.get(words[0], _configured)(words, where)
    except (ValueError, IndexError):
        raise ScanError(f"{where}: {_fault(words)}") from None


def _move(words: Sequence[str], where: str) -> tuple[float, float, float, float]:
    """Stamp, x, y and theta of ``ODOM x y theta tv rv accel time`` or ``Odometry x y theta``."""
    try:
        x, y, theta = map(float, words[1:4])
        stamp = float(words[7]) if words[0] == "ODOM" and len(words) > 7 else math.nan
    except ValueError:
        raise ScanError(f"{where}: {_fault(words)}") from None
    return stamp, x, y, theta


def _fault(words: Sequence[str]) -> str:
    """Which word of a message is missing or is no number, and what was expected there."""
    word = words[0]
    if word in _ODOMETRY or word == "L":
        before, readings, after = (4, 0, 0) if word in _ODOMETRY else (7, 1, 1)
    else:
        at, after = _COUNTS.get(word.rstrip(digits), _RAW)
        if len(words) <= at:
            return f"{len(words)} words, expected the number of readings as word {at + 1}"
        if not words[at].isascii() or not words[at].isdigit() or int(words[at][:9]) < 1:
            return f"word {at + 1} is {words[at][:40]!r}, expected the number of readings"
        before, readings = at + 1, int(words[at][:9])
    need = before + readings + after
    for k, value in enumerate(words[1 : need + 1], 1):
        try:
            float(value)
        except ValueError:
            what = "a range" if before <= k < before + readings else "a number"
            return f"word {k + 1} is {value[:40]!r}, expected {what}"
    expected = f"{readings:,} readings and {after} words behind them" if readings else "x, y, theta"
    return f"{len(words):,} words, expected {need:,} or more: {expected}"


def _cut(words: Sequence[str]) -> tuple[FloatArray, Sequence[str], int]:
    """The readings of a message, the words behind them, and how many there are at the least.

    ValueError or IndexError if there are fewer.
    """
    at, after = _COUNTS.get(words[0].rstrip(digits), _RAW)
    n = int(words[at])
    ranges, rest = np.array(words[at + 1 : at + 1 + n], np.float64), words[at + 1 + n :]
    if len(ranges) != n or n < 1 or len(rest) < after:
        raise ValueError
    return ranges, rest, after


def _flaser(words: Sequence[str], where: str) -> _Message:
    """``FLASER n r.. laser-pose robot-pose time host time``."""
    ranges, rest, _ = _cut(words)
    laser, robot = wrapped_pose(*map(float, rest[:3])), wrapped_pose(*map(float, rest[3:6]))
    stamp = math.nan
    with contextlib.suppress(ValueError, IndexError):  # a word that is no number is the host
        stamp = float(rest[6])
    return _Message(where, ranges, stamp, laser=laser, robot=robot)


def _laser(words: Sequence[str], where: str) -> _Message:
    """``Laser n r..`` of DP-SLAM."""
    return _Message(where, _cut(words)[0], math.nan)


def _centimetres(words: Sequence[str], where: str) -> _Message:
    """``L robot-pose laser-pose r.. time``, centimetres and radians."""
    values = np.array(words[1:], np.float64)
    ranges, stamp = values[6:-1] * _CENTIMETRES, float(values[-1])
    if not len(ranges):
        raise ValueError
    scale = (_CENTIMETRES, _CENTIMETRES, 1.0)
    robot, laser = (wrapped_pose(*(values[k : k + 3] * scale).tolist()) for k in (0, 3))
    return _Message(where, ranges, stamp, laser=laser, robot=robot)


def _configured(words: Sequence[str], where: str) -> _Message:
    """``ROBOTLASER1``, ``RAWLASER1``: ``type start fov res max accuracy mode n r.. [m rem..]``.

    Then comes ``laser-pose robot-pose tv rv forward side turn`` of the former, and of both
    ``time host time``. Old messages have no number of remissions, which only the number of words
    shows.
    """
    start, fov, step, reach = map(float, words[2:6])
    ranges, rest, after = _cut(words)
    n = len(ranges)
    if len(rest) > after:
        rest = rest[1 + int(rest[0]) :]
    if len(rest) != after:
        total = len(words)
        raise wrong(where, f"{total} words", f"{n} readings and {after} words after remissions")
    angles = start + np.arange(n) * (step if step else fov / max(n - 1, 1))
    poses = (rest[:3], rest[3:6]) if words[0].startswith("ROBOT") else ()
    at = [wrapped_pose(*map(float, pose)) for pose in poses]
    return _Message(where, ranges, float(rest[-3]), np.asarray(angles), reach, *at)


_OTHER = {"FLASER": _flaser, "RLASER": _flaser, "Laser": _laser, "L": _centimetres}


def _assemble(
    messages: Sequence[_Message], moves: Sequence[tuple[float, float, float, float]],
    parameters: dict[str, str], fov: float | None, name: str, *, rear: bool,
) -> ScanSet:  # fmt: skip
    """Scans of messages, with the facts of the whole log."""
    side = "rear" if rear else "front"
    said = _parameter(parameters, f"robot_{side}_laser_max", name)
    # A SICK, by what it writes where it sees nothing.
    greatest = max(float(np.nanmax(message.ranges, initial=0.0)) for message in messages)
    sick = next((m for low, high, m in _SICK_REACH if low <= greatest <= high), _REACH)
    resolution = _parameter(parameters, f"laser_{side}_laser_resolution", name)
    stamps = np.array([message.stamp for message in messages])
    # Some logs were written with six digits for seconds since 1970.
    timed = len(np.unique(stamps)) > len(stamps) // 2
    odom = _odometry(messages, moves, stamps)
    poses, mount = _laser_poses(messages)
    if odom is not None and poses is not None and len(odom) > 1 and not np.ptp(odom, axis=0).any():
        _LOG.warning(
            "%s: the robot's poses never change (all are %g %g %g); imgloc takes the laser's poses "
            "for the odometry", name, *odom[0], extra={"code": "odometry-zero"},
        )  # fmt: skip
        odom = poses
    entries: list[Entry] = []
    for i, message in enumerate(messages):
        given, count = message.angles, len(message.ranges)
        entry = {
            "ranges": message.ranges,
            "angles": _angles(count, fov, resolution, message.where) if given is None else given,
            "range_max": message.range_max if message.range_max > 0 else said or sick,
            "stamp": float(stamps[i]) if timed else None,
            "odom": None if odom is None else odom[i],
            "pose": None if poses is None else poses[i], "mount": mount,
        }  # fmt: skip
        entries.append((message.where, entry))
    return collect(entries, name)


def _parameter(parameters: dict[str, str], key: str, name: str) -> float | None:
    """A positive number of the log's parameters."""
    if key not in parameters:
        return None
    try:
        value = float(parameters[key])
    except ValueError:
        value = math.nan
    if not 0 < value < math.inf:
        raise wrong(f"{name}: PARAM {key}", repr(parameters[key]), "a positive number")
    return value


def _angles(n: int, fov: float | None, resolution: float | None, where: str) -> FloatArray:
    """Directions of `n` rays, symmetric about 0; a SICK begins at -90 degrees."""
    if fov is None and n in _SICK_STEPS:
        return np.asarray(np.arange(n) * math.radians(_SICK_STEPS[n]) - math.pi / 2)
    if fov is None and resolution is None:
        expected = "the angle that they cover, which this message does not contain: pass `fov`"
        raise ScanError(f"{where}: {n} readings, expected with them {expected}")
    return spread(n, math.radians(resolution or 0.0) * (n - 1) if fov is None else fov)


def _odometry(
    messages: Sequence[_Message], moves: Sequence[tuple[float, float, float, float]],
    stamps: FloatArray,
) -> FloatArray | None:  # fmt: skip
    """Poses of the robot, (N, 3), as the messages have them or the log at their time."""
    robots = [message.robot for message in messages]
    if all(robot is not None for robot in robots):
        return np.array([(r.x, r.y, r.theta) for r in robots if r is not None])
    table = np.array(moves).reshape(-1, 4)
    table = table[np.isfinite(table[:, 0])]
    return Odometry(table[:, 0], table[:, 1:]).along(stamps)


def _laser_poses(messages: Sequence[_Message]) -> tuple[FloatArray | None, Pose2D | None]:
    """Poses of the laser that a mapper has corrected, else where it sits on the robot."""
    pairs = [(m.laser, m.robot) for m in messages if m.laser is not None and m.robot is not None]
    if len(pairs) != len(messages):
        return None, None
    offsets = [compose(inverse(robot), laser) for laser, robot in pairs]
    turn = offsets[0].theta  # about it, for one that looks back is at pi and at -pi
    away = np.array([(p.x, p.y, turn + math.remainder(p.theta - turn, math.tau)) for p in offsets])
    middle = np.median(away, axis=0)
    if np.all(np.abs(away - middle) < _RIGID) and math.hypot(*middle[:2]) <= MOUNTED:
        # A laser without a stated place sits at the robot's own.
        return None, Pose2D(*np.round(middle, 4)) if np.abs(middle).max() > _RIGID else None
    return np.array([(p.x, p.y, p.theta) for p, _ in pairs]), None
