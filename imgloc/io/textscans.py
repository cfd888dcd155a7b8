"""Scans as text: CSV, one scan a line, and JSON lines with the names of sensor_msgs/LaserScan."""

import contextlib
import json
import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from imgloc.errors import ScanError
from imgloc.io.badlines import BadLines
from imgloc.io.files import PathLike, display
from imgloc.io.scanset import (
    MAX_RAYS,
    SPACING,
    Entry,
    ScanSet,
    ScansSize,
    collect,
    reach_of,
    scalar,
    spread,
)
from imgloc.io.text import MAX_TEXT, open_text, read_text
from imgloc.options import MAX_BAD

_BLOCK = 1 << 20  # bytes
MAX_LINE = 64 * MAX_RAYS
"""Characters of a line of text, which holds a scan."""
_SETTING = re.compile(r"\b(\w+)\s*[=:]\s*([^\s,;]+)")
_SETTINGS = (*SPACING, "range_min", "range_max", "time_increment")
_PLACES = {"pose": ("x", "y", "theta"), "odom": ("odom_x", "odom_y", "odom_theta")}
_BESIDE = ("stamp", *_PLACES["pose"], *_PLACES["odom"])
_POSES = ("pose", "odom", "mount")


def read_csv(path: PathLike, *, fov: float | None = None, max_bad: float = MAX_BAD) -> ScanSet:
    """Read scans from a CSV: one scan a line, its ranges in the order of the angles.

    Lines that begin with ``#`` give what the numbers do not, in metres and radians::

        # angle_min=-1.5708, angle_max=1.5708, range_min=0.05, range_max=30
        2.31,2.30,nan,inf,1.02

    ``angle_min`` is needed with ``angle_max`` or ``angle_increment``, or else `fov`: radians from
    the first ray to the last, straight ahead between. A first line of names
    is optional; columns called ``stamp``, ``x``, ``y``, ``theta`` are the stamp and the known
    pose of the sensor, ``odom_x``, ``odom_y``, ``odom_theta`` the odometry, the robot's pose in
    its own frame; all others are ranges in order, whose names are alike. A file with
    the two columns ``angle`` and ``range``, or with just two columns of numbers, is one scan, one
    reading a line. Empty cells are NaN. Broken lines are left out, up to the share `max_bad`, as is
    a last one that was cut off.
    """
    name, settings, columns = display(path), dict[str, Any](), list[str]()
    rows, bad, lines = list[tuple[str, list[float]]](), BadLines(name, max_bad), _lines(path)
    for line, text in lines.numbered:
        where = f"{name}: line {line}"
        if text.startswith("#"):
            said = [(key, value) for key, value in _SETTING.findall(text) if key in _SETTINGS]
            settings |= {key: _setting(key, value, f"{where}: {key}") for key, value in said}
            continue
        cells = [cell.strip() for cell in text.split(",")]
        # A line of which only some cells are numbers is data with a slip in it.
        if not columns and not rows and not any(map(_is_number, cells)):
            columns = [cell.strip("\"'").lower() for cell in cells]
            continue
        try:
            row = [_number_of(cell, f"{where}: column {i + 1}") for i, cell in enumerate(cells)]
            for before, why in ((rows and rows[0][1], " as before"), (columns, ": one per name")):
                if before and len(row) != len(before):
                    raise ScanError(f"{where}: {len(row)} numbers, expected {len(before)}{why}")
        except ScanError as error:
            if rows and line == lines.cut:
                bad.cut(where)
            else:
                bad.skip(error)
            continue
        rows.append((where, row))
    if not rows:
        bad.check(0)
        raise ScanError(f"{name}: holds no scan, expected one per line")
    table = np.array([row for _, row in rows])
    at = {column: i for i, column in enumerate(columns)}
    if not at and table.shape[1] == 2 and len(table) > 1 and not settings:
        at = {"angle": 0, "range": 1}
    if at.keys() >= {"angle", "range"}:
        bad.check(len(table))
        angles, ranges = table[:, at["angle"]], table[:, at["range"]]
        return collect([(name, {**settings, "angles": angles, "ranges": ranges})], name)
    beside = {column: i for column, i in at.items() if column in _BESIDE}
    places = dict[str, list[int]]()
    for key, wanted in _PLACES.items():
        found = [column for column in wanted if column in beside]
        if found and len(found) < len(wanted):
            expected = f"expected all of {', '.join(wanted)} or none"
            raise ScanError(f"{name}: columns {', '.join(found)}, {expected}")
        places[key] = [beside[column] for column in found]
    _check_alike([column for column in columns if column not in beside], name)
    ranges = np.delete(table, list(beside.values()), axis=1)
    if ranges.shape[1] == 1 and len(ranges) > 1:
        expected = "a scan a line, its ranges with commas between, or two columns, angle and range"
        raise ScanError(f"{name}: {len(ranges):,} lines of one range each, expected {expected}")
    entries: list[Entry] = []
    if fov is not None and "angle_min" not in settings:
        settings["angles"] = spread(ranges.shape[1], fov)
    if rows and not {"angles", "angle_min"} & settings.keys():
        expected = "a first line '# angle_min=..., angle_max=...' in radians, or `fov`"
        raise ScanError(f"{rows[0][0]}: angles: missing, expected {expected}")
    for (where, row), values in zip(rows, ranges, strict=True):
        stamp = row[beside["stamp"]] if "stamp" in beside else None
        poses = {key: [row[i] for i in place] or None for key, place in places.items()}
        entries.append((where, {**settings, "ranges": values, "stamp": stamp, **poses}))
    return collect(entries, name, bad)


def read_jsonl(path: PathLike, *, max_bad: float = MAX_BAD) -> ScanSet:
    """Read scans from JSON lines, one object per line with the names of sensor_msgs/LaserScan.

    Needed are ``ranges`` and either ``angles`` or ``angle_min`` with ``angle_increment``
    (else ``angle_max``). Optional: ``range_min``, ``range_max``, ``time_increment``, ``stamp``
    (seconds, or ``header.stamp`` with ``sec`` and ``nanosec``), ``pose``, ``odom`` and ``mount``
    (where the sensor sits on the robot) as [x, y, theta] or an object of these names. In ranges,
    null is NaN, and "inf", "-inf", "nan" may be strings.
    A ``.json`` file may also be one such object, or an array of them. Broken lines are left out,
    up to the share `max_bad`, as is a last one that was cut off.
    """
    name, bad = display(path), BadLines(display(path), max_bad)
    whole_file = str(path).lower().removesuffix(".gz").endswith(".json")
    lines = _lines(path, MAX_TEXT if whole_file else MAX_LINE)
    entries = list[Entry]()
    if whole_file:
        text = "\n".join(text for _, text in lines.numbered)
        commas, braces = text.count(","), text.count("{")
        if commas > 4 * MAX_RAYS * max(braces, 1):
            raise ScanError(f"{name}: {commas:,} values, expected at most {MAX_RAYS:,} a scan")
        whole = _json(text, name)
        for i, item in enumerate(whole if isinstance(whole, list) else [whole]):
            where = f"{name}: scan {i}"
            try:
                entries.append((where, _object(item, where)))
            except ScanError as error:
                bad.skip(error)
        return collect(entries, name, bad)
    for line, text in lines.numbered:
        where = f"{name}: line {line}"
        try:
            entries.append((where, _object(_json(text, where), where)))
        except ScanError as error:
            if entries and line == lines.cut:
                bad.cut(where)
            else:
                bad.skip(error)
    return collect(entries, name, bad)


def read_jsonl_line(text: str, where: str) -> ScanSet:
    """The scan of one of the lines of :func:`read_jsonl`; `where` it stands, for errors."""
    return collect([(where, _object(_json(text, where), where))], where)


def _object(entry: object, where: str) -> dict[str, Any]:
    if not isinstance(entry, dict):
        raise ScanError(f"{where}: got {type(entry).__name__}, expected an object with ranges")
    return plain_entry(entry, where)


def text_size(path: PathLike, *, between: bytes = b",") -> ScansSize:
    """How much a text may hold: a scan on each line or in each brace, numbers `between` marks.

    Where numbers are on lines of their own, messages are between lines of dashes.
    """
    counts = np.array([1, 0, 0, 0, 1])
    with open_text(path) as (file, length):
        while block := file.read(_BLOCK):
            counts += [block.count(mark) for mark in (b"\n", b"{", b",", between, b"\n---")]
    lines, braces, commas, marks, dashes = counts.tolist()
    if between == b"\n":
        return ScansSize(dashes, lines + commas, length, text=True)
    return ScansSize(max(lines, braces), lines + marks, length, text=True)


class _Lines(NamedTuple):
    """The lines of a file that are not blank, numbered from 1."""

    numbered: list[tuple[int, str]]
    cut: int  # number of the last line if that does not end, else 0


def _lines(path: PathLike, most: int = MAX_LINE) -> _Lines:
    """The lines of a file of text, each of at most so many characters."""
    text = read_text(path)
    numbered = check_lines(text.split("\n"), display(path), most)
    return _Lines(numbered, 0 if text.endswith("\n") or not numbered else numbered[-1][0])


def check_lines(lines: Sequence[str], name: str, most: int = MAX_LINE) -> list[tuple[int, str]]:
    """The lines that are not blank, stripped, with their numbers from 1; ScanError for a long one.

    Each is looked at before it is cut into words, which take ten times as much memory.
    """
    for i, line in enumerate(lines, 1):
        if len(line) > most:
            found = f"{len(line):,} characters"
            raise ScanError(f"{name}: line {i}: {found}, expected at most {most:,} for a scan")
    return [(i, s) for i, line in enumerate(lines, 1) if (s := line.strip())]


def _check_alike(columns: Sequence[str], name: str) -> None:
    """ScanError if most columns have one name and a number, such as r0, and others do not.

    Else a time or a heading would be a range, and all rays after it would have a wrong angle.
    """
    stems = [re.sub(r"[-+.\d]+", "", column) for column in columns]
    usual, count = max(Counter(stems).items(), key=lambda item: item[1], default=("", 0))
    others = [column for column, stem in zip(columns, stems, strict=True) if stem != usual]
    if count > len(others) > 0:
        like = columns[stems.index(usual)]
        expected = f"expected ranges called as {like} is, or {', '.join(_BESIDE)}"
        raise ScanError(f"{name}: columns {', '.join(others[:5])}: {expected}")


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


def _setting(key: str, text: str, where: str) -> float:
    """The number of a setting: of range_max what is stated, where there is no number."""
    try:
        return _number_of(text, where)
    except ScanError:
        if key != "range_max":
            raise
        return reach_of(text, where)


def _json(text: str, where: str) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as e:
        raise ScanError(f"{where}: not valid JSON: {e}") from None


def plain_entry(entry: Mapping[str, Any], where: str) -> dict[str, Any]:
    """The entry with the numbers that JSON cannot write put in."""
    plain = dict(entry)
    if isinstance(entry.get("ranges"), list):
        plain["ranges"] = [
            _number_of(v or "", f"{where}: ranges[{i}]") if isinstance(v, str | None) else v
            for i, v in enumerate(entry["ranges"])
        ]
    for key in ("range_min", "range_max"):
        if isinstance(entry.get(key), str):
            plain[key] = _setting(key, entry[key], f"{where}: {key}")
    header = h if isinstance(h := entry.get("header"), dict) else {}
    stamp = entry.get("stamp", header.get("stamp"))
    if isinstance(stamp, dict):
        parts = [stamp.get(a, stamp.get(b, 0)) for a, b in (("sec", "secs"), ("nanosec", "nsecs"))]
        seconds, nanoseconds = (scalar(part, f"{where}: stamp") for part in parts)
        stamp = seconds + nanoseconds * 1e-9
    plain["stamp"] = stamp
    for key in _POSES:
        if isinstance(entry.get(key), dict):
            plain[key] = [entry[key].get(k) for k in ("x", "y", "theta")]
    for key in ("ranges", "angles", *_POSES):
        # Beside numbers NumPy takes true for 1.
        if isinstance(plain.get(key), list) and any(isinstance(v, bool) for v in plain[key]):
            raise ScanError(f"{where}: {key}: got true or false in it, expected numbers")
    return plain
