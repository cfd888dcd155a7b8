"""A set of scans, and the checks that every scan format shares; all raise ScanError."""

import contextlib
import logging
import math
from collections.abc import Iterator, Mapping, Sequence
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np

from imgloc.equality import ByContent
from imgloc.errors import ConfigError, ScanError
from imgloc.io.badlines import BadLines
from imgloc.model import (
    MOST_TURNED,
    FloatArray,
    LaserScan,
    Pose2D,
    check_mount,
    freeze,
    wrapped_pose,
)
from imgloc.options import Logs
from imgloc.robot.odometry import velocities_at
from imgloc.robot.recording import Recording

_LOG = logging.getLogger("imgloc")
MAX_READINGS = 50_000_000
"""Readings a scan file may hold: 400 MB as float64."""
MAX_SCANS, MAX_RAYS = 500_000, 100_000
"""Scans a file may hold, and readings a scan: 14 hours at 10 Hz, 278 readings a degree."""
SEVERAL = 8  # lasers of a robot, at most
SPACING = ("angle_min", "angle_max", "angle_increment")
_LIMITS = "range_min", "range_max"
_PACE = "time_increment"
_BESIDE = ("poses", "stamps", "odom")
KEYS = ("ranges", "angles", *_LIMITS, *SPACING, _PACE, *_BESIDE, "mount", "laser")
# The greatest reading of a scan is a code if it is that often there: of all readings, readings, and
# of how often others are. Of 39,000 scans and parts of scans without codes it was so of none.
_OFTEN, _LEAST, _OTHERS = 0.05, 10, 10
_MAX_TURN = 30.0  # radians of a heading that was counted on: nearly five turns, or 30 degrees
# Where a scan stands in the file, for messages, and its fields (named as in LaserScan).
Entry = tuple[str, Mapping[str, Any]]


@dataclass(frozen=True)
class ScansSize:
    """Size of a file of scans at most, before it is read."""

    scans: int
    numbers: int  #: ranges, angles, and what was recorded beside them
    file_bytes: int
    text: bool = False  #: whether it is a file of text


def check_size(scans: int, rays: int, name: str) -> None:
    """Raise ScanError for more scans, or readings a scan, than a file may have.

    This comes before memory is taken for them.
    """
    for count, most, what in (
        (scans, MAX_SCANS, "scans"),
        (rays, MAX_RAYS, "readings a scan"),
        (scans * rays, MAX_READINGS, "readings"),
    ):
        if count > most:
            raise ScanError(f"{name}: {count:,} {what}, expected at most {most:,}; cut the file")


@dataclass(frozen=True, eq=False)
class ScanSet(ByContent):
    """Scans, with what was recorded beside them."""

    scans: tuple[LaserScan, ...]  #: in the order of the file
    #: (N, 3), known pose of the **sensor** in the map frame (x, y in metres, theta in radians)
    poses: FloatArray | None = None
    stamps: FloatArray | None = None  #: (N,), seconds
    #: (N, 3), pose of the **robot** in the odometry's frame; its sensor is at
    #: ``compose(odom, T_base_laser)``, which is the same where a scan has none. NaN where it is
    #: not known
    odom: FloatArray | None = None
    recording: Recording = field(default_factory=Recording)  #: what else the log holds, by name

    def __post_init__(self) -> None:
        object.__setattr__(self, "scans", tuple(self.scans))
        n = len(self.scans)
        for key, shape in (("poses", (n, 3)), ("stamps", (n,)), ("odom", (n, 3))):
            if getattr(self, key) is not None:
                freeze(self, np.float64, key)
                array = getattr(self, key)
                if array.shape != shape:
                    raise ValueError(f"{key} {array.shape} must be {shape}: one per scan")
                if len(shape) == 2 and (far := np.abs(array[:, 2]) > MOST_TURNED).any():
                    array = array.copy()  # a heading was counted on
                    array[far, 2] = np.remainder(array[far, 2] + np.pi, math.tau) - np.pi
                    array.flags.writeable = False
                    object.__setattr__(self, key, array)

    def __len__(self) -> int:
        return len(self.scans)

    def __repr__(self) -> str:
        rays = sorted({len(scan.ranges) for scan in self.scans})
        sizes = f" of {rays[0]} rays" if len(rays) == 1 else f" of {rays[0]} to {rays[-1]} rays"
        there = [key for key in _BESIDE if getattr(self, key) is not None]
        beside = f", with {', '.join(there)}" if there else ""
        return f"<ScanSet of {len(self):,} scans{sizes if rays else ''}{beside}>"

    def __getitem__(self, index: int) -> LaserScan:
        return self.scans[index]

    def with_poses(self) -> Iterator[tuple[LaserScan, FloatArray]]:
        """Each scan with its pose (3,), map frame; ValueError if these are not known."""
        return zip(self.scans, () if self.poses is None else self.poses, strict=True)

    @property
    def lasers(self) -> list[str]:
        """Names of the lasers, in the order in which they come."""
        return list(dict.fromkeys(scan.laser for scan in self.scans))

    @property
    def poses_are_odometry(self) -> bool:
        """True if one set of poses is both: a log that has no other may hold either in it."""
        both = self.poses is not None and self.odom is not None
        return both and np.array_equal(self.poses, self.odom, equal_nan=True)  # type: ignore[arg-type]

    def with_odometry(self, name: str) -> "tuple[ScanSet, list[int]]":
        """The scans whose odometry is known, and their indices; a warning counts the others.

        ScanError, by the `name` of the log, if there is no odometry at all.
        """
        odom = np.zeros((0, 3)) if self.odom is None else self.odom
        indices = np.flatnonzero(np.isfinite(odom).all(axis=1)).tolist()
        if not indices:
            missing = "odom: missing, expected the odometry of each scan to track a robot"
            csv = name.lower().endswith((".csv", ".csv.gz"))
            hint = "; in a CSV its columns are odom_x, odom_y, odom_theta" if csv else ""
            raise ScanError(f"{name}: {missing}{hint}")
        if len(indices) == len(self):
            return self, indices
        left = sorted(set(range(len(self))) - set(indices))
        _LOG.warning(
            "%s: %d of %d scans, from %d to %d, have no odometry and are left out; do scans and "
            "odometry begin and end together?",
            name, len(left), len(self), left[0], left[-1],
        )  # fmt: skip
        return self.take(indices), indices

    @property
    def velocities(self) -> FloatArray:
        """(N, 3) of the robot in its own frame at each scan, m/s, m/s, rad/s; NaN if not known."""
        if self.odom is None or self.stamps is None:
            return np.full((len(self), 3), np.nan)
        return velocities_at(self.stamps, self.odom)

    def take(self, indices: Sequence[int]) -> "ScanSet":
        """The scans at some indices, in their order, with what was recorded beside them."""
        at = list(indices)
        poses, stamps, odom = (
            None if (array := getattr(self, key)) is None else array[at] for key in _BESIDE
        )
        scans = tuple(self.scans[k] for k in at)
        return ScanSet(scans, poses, stamps, odom, self.recording)


def wrong(where: str, got: object, expected: str) -> ScanError:
    """The error of what stands at `where`: the file, with the line and key."""
    return ScanError(f"{where}: got {got}, expected {expected}")


def numbers(value: Any, name: str, key: str, *, ndim: Sequence[int]) -> FloatArray:
    """Return `value` as a float array; it must be numeric, not ragged, of a dimension in `ndim`."""
    expected = f"numbers of dimension {' or '.join(map(str, ndim))}"
    try:
        array = np.asarray(value)
    except (ValueError, OverflowError):
        raise ScanError(f"{name}: {key}: rows of different length, expected {expected}") from None
    if array.dtype.kind not in "fiu":
        raise wrong(f"{name}: {key}", f"type {array.dtype}", expected)
    if array.ndim not in ndim:
        raise wrong(f"{name}: {key}", f"shape {array.shape}", expected)
    return array.astype(np.float64, copy=False)


_DEGREES = "radians; are these degrees? multiply them by pi / 180"


def _check_angles(angles: FloatArray, name: str, key: str = "angles") -> None:
    """Refuse angles that cannot be directions in radians."""
    low, high = float(angles.min(initial=0.0)), float(angles.max(initial=0.0))
    if not math.isfinite(low + high):
        hint = "finite radians (a reading without a direction has to be left out)"
        _check_finite(angles, name, "angles", hint)
    if abs(worst := max(low, high, key=abs)) > MOST_TURNED:
        raise wrong(f"{name}: {key}", f"{worst:g}", _DEGREES)
    if (span := float(np.ptp(angles)) if angles.size else 0.0) > 1.5 * math.tau:
        raise wrong(f"{name}: {key}", f"a span of {span:.3g}", f"at most one turn in {_DEGREES}")


_STATED: ContextVar[Logs] = ContextVar("stated", default=Logs())  # noqa: B039, it is frozen
MOUNTED: ContextVar[Pose2D | None] = ContextVar("mounted", default=None)
"""Where the sensor is stated to sit, while a file is read."""


@contextlib.contextmanager
def stated(how: Logs, sensor: Pose2D | None = None) -> Iterator[None]:
    """Let what is stated about a file win over what the file contains.

    `sensor` replaces every mount; the other settings replace values that cannot be.

    Examples
    --------
    >>> entry = {"ranges": [1.0, 2.0], "angles": [0.0, 0.5], "range_max": 0.0}
    >>> with stated(Logs(range_max=9.0)):
    ...     collect([("a", entry)], "a")[0].range_max
    9.0
    """
    token, mounted = _STATED.set(how), MOUNTED.set(sensor)
    try:
        yield
    finally:
        _STATED.reset(token)
        MOUNTED.reset(mounted)


def reach_of(value: Any, where: str, low: float = 0.0) -> float:
    """The range_max in a file, or the stated one where the file's cannot be."""
    how = _STATED.get()
    try:
        high = scalar(value, where)
        _check_limits(low, high, where.removesuffix(": range_max"))
    except ScanError as error:
        if how.range_max is None or low < 0 or how.range_max / how.scale <= low:
            raise ScanError(f"{error}; or pass `range_max`") from None
        return how.range_max / how.scale
    return high


def _check_limits(range_min: float, range_max: float, name: str) -> None:
    """Refuse limits unless ``0 <= range_min < range_max``; range_max may be infinite."""
    if not (0 <= range_min < np.inf):
        raise wrong(f"{name}: range_min", f"{range_min:g}", "metres, 0 or more")
    if not range_max > range_min:
        expected = f"metres, more than range_min = {range_min:g}"
        raise wrong(f"{name}: range_max", f"{range_max:g}", expected)


def _check_finite(
    array: FloatArray, name: str, key: str, expected: str = "a finite number"
) -> None:
    """Refuse an array with an entry that is NaN or infinite."""
    if np.isfinite(array).all():
        return
    for at in np.argwhere(~np.isfinite(array))[:1]:
        raise wrong(f"{name}: {key}{at.tolist()}", array[tuple(at)], expected)


def _told_apart(names: Sequence[str], times: Sequence[object]) -> bool:
    """Return whether a field of any name has those of several lasers, of each scan with its time.

    Of several lasers are scans that follow each other at one time. Words alone may be of rooms,
    days or directions, and a second run may begin at the time of the first one.

    >>> _told_apart(["0", "1"] * 2, [5, 5, 6, 6]), _told_apart(["0", "0", "1", "1"], [5, 6] * 2)
    (True, False)
    >>> _told_apart(["there", "back"] * 9, range(18))
    False
    """
    count, several = len(names), len({*names})
    groups = np.cumsum([a != b for a, b in pairwise([None, *times])]).tolist()
    pairs = len({*zip(groups, names, strict=True)})
    return 1 < several <= min(SEVERAL, count / 2) and 3 * len({*groups}) <= 2 * pairs == 2 * count


def _named(entries: Sequence[Entry]) -> Sequence[Entry]:
    """The entries, named by a field that sets lasers apart where none has a laser's name."""
    if not entries or any(entry.get("laser") for _, entry in entries):
        return entries
    times = [k if (t := e.get("stamp")) is None else t for k, (_, e) in enumerate(entries)]
    for key in entries[0][1]:
        names: list[Any] = [entry.get(key) for _, entry in entries]
        if all(isinstance(name, str) for name in names) and _told_apart(names, times):
            return [(where, {**entry, "laser": entry[key]}) for where, entry in entries]
    return entries


def collect(entries: Sequence[Entry], name: str, bad: BadLines | None = None) -> ScanSet:
    """Check each entry of the file `name` and make the set.

    Entries that are broken are left out if there are no more of them than `bad` allows; without it
    none may be. `odom` is NaN for an entry without odometry.
    """
    scans, beside = list[LaserScan](), {"pose": list[FloatArray](), "odom": list[FloatArray]()}
    for where, entry in _named(entries):
        try:
            scan = _scan(entry, where)
            poses = {key: _pose(entry.get(key), where, key) for key in beside}
        except ScanError as error:
            if bad is None:
                raise
            bad.skip(error)
            continue
        scans.append(scan)
        for key, pose in poses.items():
            beside[key].append(pose)
    if bad is not None:
        bad.check(len(scans))
    if not scans:
        raise ScanError(f"{name}: contains no scan, expected one per line")
    tables = {key: np.array(poses) for key, poses in beside.items()}
    known = {key: None if np.isnan(table).all() else table for key, table in tables.items()}
    if known["pose"] is not None and (there := np.isfinite(known["pose"][:, 0])).sum() < len(scans):
        some = f"in {there.sum()} of {len(scans)} scans"
        raise ScanError(f"{name}: pose: {some}, expected all or none")
    times = np.array([scan.stamp for scan in scans])
    stamps = None if np.isnan(times).all() else times
    return ScanSet(_without_codes(scans, name), known["pose"], stamps, known["odom"])


def _pose(value: Any, where: str, key: str) -> FloatArray:
    """A pose (3,), NaN where it is not known."""
    if value is None or (isinstance(value, np.ndarray) and np.isnan(value).all()):
        return np.full(3, np.nan)
    pose = numbers(value, where, key, ndim=(1,))
    if pose.shape != (3,):
        raise wrong(f"{where}: {key}", f"{len(pose)} numbers", "x, y, theta")
    _check_finite(pose, where, key)
    if abs(pose[2]) > _MAX_TURN:
        raise wrong(f"{where}: {key}", f"a theta of {pose[2]:g}", _DEGREES)
    return pose


def _scan(entry: Mapping[str, Any], where: str) -> LaserScan:
    if entry.get("ranges") is None:
        raise ScanError(f"{where}: ranges: missing, expected a list of metres")
    ranges = numbers(entry["ranges"], where, "ranges", ndim=(1,))
    if not len(ranges):
        raise ScanError(f"{where}: ranges: empty, expected at least one reading")
    check_size(1, len(ranges), where)
    spaced = entry.get("angles") is None
    given = {
        key: scalar(entry[key], f"{where}: {key}")
        for key in (*(SPACING if spaced else ()), "range_min", _PACE, "stamp")
        if entry.get(key) is not None
    }
    angles = _angles_of(entry.get("angles"), given, len(ranges), where)
    low, high = given.get("range_min", 0.0), entry.get("range_max")
    _check_limits(low, math.inf, where)
    high = math.inf if high is None else reach_of(high, f"{where}: range_max", low)
    stamp, mount = given.get("stamp", math.nan), MOUNTED.get() or entry.get("mount")
    if mount is not None and not isinstance(mount, Pose2D):
        mount = _mount(mount, where)
    laser = entry.get("laser", "")
    if not isinstance(laser, str):
        raise wrong(f"{where}: laser", repr(laser)[:40], "the name of the laser, a text")
    try:
        return LaserScan(ranges, angles, low, high, stamp, mount, given.get(_PACE, 0.0), laser)
    except (ConfigError, ValueError) as error:
        raise ScanError(f"{where}: {error}") from None


def _mount(value: Any, where: str) -> Pose2D:
    try:
        pose = wrapped_pose(*_pose(value, where, "mount"))
        check_mount(pose, "mount")
    except (ConfigError, ScanError) as error:
        text = str(error)
        text = text if text.startswith(where) else f"{where}: {text}"
        raise ScanError(f"{text}; or pass `sensor`") from None
    return pose


def scalar(value: Any, where: str) -> float:
    """A JSON value that must be one number."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise wrong(where, repr(str(value)[:40]), "a number")
    try:
        return float(value)
    except OverflowError:  # JSON writes integers of any length
        raise ScanError(f"{where}: got a number of {len(str(value))} digits") from None


def _angles_of(value: Any, given: Mapping[str, float], count: int, where: str) -> FloatArray:
    """Angles of `count` rays: a value, or those of spacing that is `given`, or the stated view."""
    try:
        for key in (key for key in SPACING if key in given):
            _check_angles(np.array([given[key]]), where, key)
        if value is None:
            angles = _spaced_angles(given, count, where)
        else:
            angles = numbers(value, where, "angles", ndim=(1,))
        if len(angles) != count:
            raise wrong(f"{where}: angles", len(angles), f"{count} as in ranges")
        _check_angles(angles, where)
    except ScanError as error:
        if (fov := _STATED.get().fov) is None:
            raise ScanError(f"{error}; or pass `fov`") from None
        angles = spread(count, fov)
    return angles


def _spaced_angles(given: Mapping[str, float], count: int, where: str) -> FloatArray:
    """Angles of `count` rays from the first one, and from their spacing or the last one."""
    first, last, step = (given.get(key) for key in SPACING)
    step = step if last is None else step or None  # drivers leave it at 0
    if first is None or (step is None and last is None):
        expected = "angles, or angle_min with angle_increment or angle_max, in radians"
        raise ScanError(f"{where}: angles: missing, expected {expected}")
    if step is None:
        if last == first and count > 1:
            expected = f"another one than angle_min: there are {count} readings"
            raise wrong(f"{where}: angle_max", f"{last:g}", expected)
        return np.linspace(first, last or 0.0, count)
    angles = first + np.arange(count, dtype=np.float64) * step
    # Drivers disagree on whether angle_max is the last ray or the one after it.
    if last is not None and abs(last - angles[-1]) > 2.5 * abs(step):
        rule = f"angle_min + {count - 1} x angle_increment; were readings left out?"
        raise wrong(f"{where}: angle_max", f"{last:g}", f"{angles[-1]:g} = {rule}")
    return np.asarray(angles)


def spread(count: int, fov: float) -> FloatArray:
    """Angles of `count` rays about straight ahead, `fov` radians from the first to the last.

    With a whole turn the last ray is one step before the first.

    Examples
    --------
    >>> np.rad2deg(spread(3, np.pi)).tolist(), np.rad2deg(spread(4, 2 * np.pi)).tolist()
    ([-90.0, 0.0, 90.0], [-180.0, -90.0, 0.0, 90.0])
    """
    whole = fov > math.tau - 1e-6
    return np.linspace(-fov / 2, fov / 2, count, endpoint=not whole)


def covers(angles: FloatArray, fov: float) -> bool:
    """Return whether angles are as far from the first to the last as :func:`spread` has them."""
    return bool(abs(np.ptp(angles) - np.ptp(spread(len(angles), fov))) <= 0.01)


def scan_set(arrays: dict[str, FloatArray], name: str) -> ScanSet:
    """Check that the shapes agree, and cut the arrays into scans."""
    ranges = np.array(np.atleast_2d(arrays["ranges"]))
    n, readings = ranges.shape
    if not ranges.size:
        raise wrong(f"{name}: ranges", f"shape {ranges.shape}", "at least one scan and one reading")
    check_size(n, readings, name)

    def each(key: str, *tail: int, one_for_all: bool = True) -> Any:
        """The values of a key for each scan: numbers, or arrays of this shape."""
        value = arrays.get(key)
        if value is None:
            return [None] * n
        value = value.reshape(tail) if value.size == 1 == math.prod(tail) else value
        shapes = [*([tail] if one_for_all or n == 1 else []), (n, *tail)]
        if value.shape not in shapes:
            expected = (
                f"{' or '.join(map(str, shapes))}: ranges are {n} scans of {readings} readings"
            )
            expected += "; or pass `sensor`" * (key == "mount")
            raise wrong(f"{name}: {key}", f"shape {value.shape}", expected)
        rows = np.broadcast_to(value, (n, *tail))
        return rows if tail else rows.tolist()

    if "angles" not in arrays:
        given = {
            key: arrays[key].item() for key in SPACING if key in arrays and arrays[key].size == 1
        }
        arrays["angles"] = _angles_of(None, given, readings, name)
    arrays["angles"] = np.array(arrays["angles"])
    for array in (ranges, arrays["angles"]):  # scans hold parts of them
        array.flags.writeable = False
    _check_finite(arrays.get("poses", np.zeros(0)), name, "poses")
    if (odd := np.ravel([v for v in each("laser") if v is not None and v % 1 != 0])).size:
        raise wrong(f"{name}: laser", odd[0], "whole numbers")
    mounts = [None] * n if MOUNTED.get() is not None else each("mount", 3)
    columns = {
        "ranges": ranges, "angles": each("angles", readings),
        **{key: each(key) for key in (*_LIMITS, _PACE)},
        "stamp": each("stamps", one_for_all=False),
        "pose": each("poses", 3, one_for_all=False), "odom": each("odom", 3, one_for_all=False),
        "mount": [None if m is None or np.isnan(m).all() else m for m in mounts],
        "laser": ["" if number is None else str(int(number)) for number in each("laser")],
    }  # fmt: skip
    rows = zip(*columns.values(), strict=True)
    places = [name] if n == 1 else [f"{name}: scan {k}" for k in range(n)]
    entries = [dict(zip(columns, row, strict=True)) for row in rows]
    return collect([*zip(places, entries, strict=True)], name)


def _without_codes(scans: Sequence[LaserScan], name: str) -> tuple[LaserScan, ...]:
    """The scans, the greatest reading being no distance where it is a code for nothing seen.

    Drivers write one number, such as 81.83, for each ray that met nothing. Where the file has no
    range_max it would be a wall. 65535 is such a number however rare it is.
    """
    silent = [scan for scan in scans if math.isinf(scan.range_max)]
    codes = [code for code in map(_code_of, silent) if code is not None]
    if not codes:
        return tuple(scans)
    code = min(codes)
    beyond = [np.unique(s.ranges[np.isfinite(s.ranges) & (s.ranges > code)]) for s in silent]
    if len(np.unique(np.concatenate(beyond))) > _LEAST:  # others see farther: it was a wall
        return tuple(scans)
    readings = sum(scan.ranges.size for scan in silent)
    share = sum(int(np.count_nonzero(scan.ranges == code)) for scan in silent) / readings
    said = (
        f"range_max is missing, and {share:.1%} of the readings have the greatest range, {code:g}; "
        f"imgloc takes it for the code of rays that met nothing, range_max = {code:g}; add "
        "range_max to the file if these are distances"
    )
    _LOG.warning("%s: %s", name, said, extra={"code": "codes"})
    return tuple(replace(s, range_max=code) if math.isinf(s.range_max) else s for s in scans)


def _code_of(scan: LaserScan) -> float | None:
    """Code of a scan in place of ranges where nothing was seen; None if they look like ranges."""
    seen = scan.ranges[scan.valid]
    top = float(seen.max(initial=0.0))
    if top in [65535 * metres for metres in (1.0, 1e-2, 1e-3, 0.0254)]:  # all of 16 bits
        return top
    often = int(np.count_nonzero(seen == top))
    if often < max(_LEAST, _OFTEN * len(seen)) or often == len(seen):
        return None
    others = np.unique(seen[seen < top], return_counts=True)[1]
    return top if often >= _OTHERS * np.median(others) else None
