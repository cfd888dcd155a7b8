"""Scans as text: CSV, one scan a line, and JSON lines with the names of sensor_msgs/LaserScan."""

import contextlib
import json
import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from imgloc.errors import ScanError
from imgloc.io.files import PathLike, display, open_file, read_file
from imgloc.io.scanset import (
    MAX_READINGS,
    ScanSet,
    ScansSize,
    check_angles,
    check_finite,
    check_limits,
    numbers,
)
from imgloc.model import FloatArray, LaserScan

_LIMIT = 8 * MAX_READINGS  # bytes
_BLOCK = 1 << 20
_SETTING = re.compile(r"\b(\w+)\s*[=:]\s*([^\s,;]+)")
_SPACING = ("angle_min", "angle_max", "angle_increment")
_SETTINGS = (*_SPACING, "range_min", "range_max")
_BESIDE = ("stamp", "x", "y", "theta")
# Where a scan stands in the file, for messages, and what is said of it (names of LaserScan).
_Entry = tuple[str, Mapping[str, Any]]


def read_csv(path: PathLike) -> ScanSet:
    """Read scans from a CSV: one scan a line, its ranges in the order of the angles.

    Lines that begin with ``#`` give what the numbers do not, in metres and radians::

        # angle_min=-1.5708, angle_max=1.5708, range_min=0.05, range_max=30
        2.31,2.30,nan,inf,1.02

    ``angle_min`` is needed with ``angle_max`` or ``angle_increment``. A first line of names
    is optional; columns called ``stamp``, ``x``, ``y``, ``theta`` are the stamp and the known
    pose of the sensor, all others are ranges in order. A file with the two columns ``angle``
    and ``range`` is one scan, one reading a line. Empty cells are NaN.
    """
    name = display(path)
    settings: dict[str, float] = {}
    columns: list[str] = []
    rows: list[tuple[str, list[float]]] = []
    for line, text in _lines(path):
        where = f"{name}: line {line}"
        if text.startswith("#"):
            for key, value in _SETTING.findall(text):
                if key in _SETTINGS:
                    settings[key] = _number_of(value, f"{where}: {key}")
            continue
        cells = [cell.strip() for cell in text.split(",")]
        # A line of which only some cells are numbers is data with a slip in it.
        if not columns and not rows and not any(map(_is_number, cells)):
            columns = [cell.strip("\"'").lower() for cell in cells]
            continue
        row = [_number_of(cell, f"{where}: column {i + 1}") for i, cell in enumerate(cells)]
        for before, why in ((rows and rows[0][1], " as before"), (columns, ": one per name")):
            if before and len(row) != len(before):
                raise ScanError(f"{where}: {len(row)} numbers, expected {len(before)}{why}")
        rows.append((where, row))
    if not rows:
        raise ScanError(f"{name}: holds no scan, expected one per line")
    table = np.array([row for _, row in rows])
    at = {column: i for i, column in enumerate(columns)}
    if at.keys() >= {"angle", "range"}:
        angles, ranges = table[:, at["angle"]], table[:, at["range"]]
        return _collected([(name, {**settings, "angles": angles, "ranges": ranges})], name)
    beside = {column: i for column, i in at.items() if column in _BESIDE}
    place = [beside[column] for column in ("x", "y", "theta") if column in beside]
    if len(place) not in (0, 3):
        named = ", ".join(columns[i] for i in place)
        raise ScanError(f"{name}: columns {named}, expected all of x, y, theta or none")
    ranges = np.delete(table, list(beside.values()), axis=1)
    entries: list[_Entry] = []
    for (where, row), values in zip(rows, ranges, strict=True):
        stamp = row[beside["stamp"]] if "stamp" in beside else None
        pose = [row[i] for i in place] or None
        entries.append((where, {**settings, "ranges": values, "stamp": stamp, "pose": pose}))
    return _collected(entries, name)


def read_jsonl(path: PathLike) -> ScanSet:
    """Read scans from JSON lines, one object per line with the names of sensor_msgs/LaserScan.

    Needed are ``ranges`` and either ``angles`` or ``angle_min`` with ``angle_increment``
    (else ``angle_max``). Optional: ``range_min``, ``range_max``, ``stamp`` (seconds, or
    ``header.stamp`` with ``sec`` and ``nanosec``), ``pose`` and ``odom`` as [x, y, theta] or
    an object of these names. In ranges, null is NaN, and "inf", "-inf", "nan" may be strings.
    A ``.json`` file may also be one such object, or an array of them.
    """
    name, lines = display(path), _lines(path)
    if str(path).lower().endswith(".json"):
        whole = _json("\n".join(text for _, text in lines), name)
        items = whole if isinstance(whole, list) else [whole]
        entries = [(f"{name}: scan {i}", item) for i, item in enumerate(items)]
    else:
        entries = [(where := f"{name}: line {i}", _json(text, where)) for i, text in lines]
    for where, entry in entries:
        if not isinstance(entry, dict):
            raise ScanError(f"{where}: got {type(entry).__name__}, expected an object with ranges")
    return _collected([(where, _plain(entry, where)) for where, entry in entries], name)


def text_size(path: PathLike) -> ScansSize:
    """How much a text may hold: a scan on each line or in each brace, numbers between commas."""
    counts = np.array([1, 0, 0])
    with open_file(path, limit=_LIMIT, error=ScanError, what="scan file") as (file, length):
        while block := file.read(_BLOCK):
            counts += [block.count(mark) for mark in (b"\n", b"{", b",")]
    lines, braces, commas = counts.tolist()
    return ScansSize(max(lines, braces), lines + commas, length, text=True)


def _lines(path: PathLike) -> list[tuple[int, str]]:
    """The lines of a UTF-8 file that are not blank, with their numbers from 1."""
    data = read_file(path, limit=_LIMIT, error=ScanError, what="scan file")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as e:
        raise ScanError(f"{display(path)}: byte {e.start} is not UTF-8 text") from None
    return [(i, s.strip()) for i, s in enumerate(text.split("\n"), 1) if s.strip()]


def _is_number(cell: str) -> bool:
    with contextlib.suppress(ValueError):
        float(cell)
        return True
    return not cell


def _number_of(text: str, where: str) -> float:
    """The number that `text` spells; nothing and ``null`` are NaN."""
    if not text or text.lower() == "null":
        return math.nan
    try:
        return float(text)
    except ValueError:
        hint = "; separate by commas, with decimal points" if re.search(r"[;\t ]", text) else ""
        raise ScanError(f"{where}: got {text[:40]!r}, expected a number{hint}") from None


def _json(text: str, where: str) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as e:
        raise ScanError(f"{where}: not valid JSON: {e}") from None


def _plain(entry: Mapping[str, Any], where: str) -> dict[str, Any]:
    """The entry with the numbers that JSON cannot write put in."""
    plain = dict(entry)
    if isinstance(entry.get("ranges"), list):
        plain["ranges"] = [
            _number_of(v or "", f"{where}: ranges[{i}]") if isinstance(v, str | None) else v
            for i, v in enumerate(entry["ranges"])
        ]
    for key in ("range_min", "range_max"):
        if isinstance(entry.get(key), str):
            plain[key] = _number_of(entry[key], f"{where}: {key}")
    header = entry.get("header")
    stamp = entry.get("stamp", header.get("stamp") if isinstance(header, dict) else None)
    if isinstance(stamp, dict):
        parts = [stamp.get(a, stamp.get(b, 0)) for a, b in (("sec", "secs"), ("nanosec", "nsecs"))]
        seconds, nanoseconds = (_scalar(part, f"{where}: stamp") for part in parts)
        stamp = seconds + nanoseconds * 1e-9
    plain["stamp"] = stamp
    for key in ("pose", "odom"):
        if isinstance(entry.get(key), dict):
            plain[key] = [entry[key].get(k) for k in ("x", "y", "theta")]
    return plain


def _collected(entries: Sequence[_Entry], name: str) -> ScanSet:
    """Check each entry and make the set."""
    if not entries:
        raise ScanError(f"{name}: holds no scan, expected one per line")
    scans = [_scan(entry, where) for where, entry in entries]
    beside: dict[str, FloatArray | None] = {}
    for key in ("pose", "odom"):
        given = [(where, entry[key]) for where, entry in entries if entry.get(key) is not None]
        if len(given) not in (0, len(scans)):
            raise ScanError(
                f"{name}: {key}: in {len(given)} of {len(scans)} scans, expected all or none"
            )
        poses = [_pose(value, where, key) for where, value in given]
        beside[key] = np.array(poses) if poses else None
    stamps = np.array([scan.stamp for scan in scans])
    return ScanSet(
        tuple(scans), beside["pose"], None if np.isnan(stamps).all() else stamps, beside["odom"]
    )


def _pose(value: Any, where: str, key: str) -> FloatArray:
    pose = numbers(value, where, key, ndim=(1,))
    if pose.shape != (3,):
        raise ScanError(f"{where}: {key}: got {len(pose)} numbers, expected x, y, theta")
    check_finite(pose, where, key)
    return pose


def _scan(entry: Mapping[str, Any], where: str) -> LaserScan:
    if entry.get("ranges") is None:
        raise ScanError(f"{where}: ranges: missing, expected a list of metres")
    ranges = numbers(entry["ranges"], where, "ranges", ndim=(1,))
    if not len(ranges):
        raise ScanError(f"{where}: ranges: empty, expected at least one reading")
    spaced = entry.get("angles") is None
    given = {
        key: _scalar(entry[key], f"{where}: {key}")
        for key in (*(_SPACING if spaced else ()), "range_min", "range_max", "stamp")
        if entry.get(key) is not None
    }
    if spaced:
        angles = _spaced_angles(given, len(ranges), where)
    else:
        angles = numbers(entry["angles"], where, "angles", ndim=(1,))
    if len(angles) != len(ranges):
        raise ScanError(f"{where}: angles: got {len(angles)}, expected {len(ranges)} as in ranges")
    check_angles(angles, where)
    low, high = given.get("range_min", 0.0), given.get("range_max", math.inf)
    check_limits(low, high, where)
    return LaserScan(ranges, angles, low, high, given.get("stamp", math.nan))


def _scalar(value: Any, where: str) -> float:
    """A JSON value that must be one number."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ScanError(f"{where}: got {str(value)[:40]!r}, expected a number")
    try:
        return float(value)
    except OverflowError:  # JSON writes integers of any length
        raise ScanError(f"{where}: got a number of {len(str(value))} digits") from None


def _spaced_angles(given: Mapping[str, float], count: int, where: str) -> FloatArray:
    """Angles of `count` rays from the first one, and from their spacing or the last one."""
    first, last = given.get("angle_min"), given.get("angle_max")
    step = given.get("angle_increment")
    if first is None or (step is None and last is None):
        raise ScanError(
            f"{where}: angles: missing, expected angles, or angle_min with "
            "angle_increment or angle_max, in radians"
        )
    if step is None:
        return np.linspace(first, last or 0.0, count)
    angles = first + np.arange(count, dtype=np.float64) * step
    # Drivers disagree on whether angle_max is the last ray or the one after it.
    if last is not None and abs(last - angles[-1]) > 2.5 * abs(step):
        raise ScanError(
            f"{where}: angle_max: got {last:g}, expected {angles[-1]:g} = angle_min + "
            f"{count - 1} x angle_increment; were readings left out?"
        )
    return np.asarray(angles)
