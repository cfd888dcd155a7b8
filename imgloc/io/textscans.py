"""Scans as JSON with the names of sensor_msgs/LaserScan, and what all texts have in common."""

import contextlib
import json
import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime
from typing import Any, NamedTuple

import numpy as np

from imgloc.errors import ScanError
from imgloc.io.badlines import BadLines
from imgloc.io.bags import LASER, LEVEL, ODOMETRY, TF, Beside, choose_topic
from imgloc.io.files import PathLike, display
from imgloc.io.lasers import lasers_of
from imgloc.io.messages import fields_of, frame_name, matrix_of, planar
from imgloc.io.scanset import (
    MAX_RAYS,
    SPACING,
    Entry,
    ScanSet,
    ScansSize,
    collect,
    reach_of,
    scalar,
)
from imgloc.io.text import MAX_TEXT, open_text, read_text
from imgloc.model import FloatArray
from imgloc.options import MAX_BAD
from imgloc.robot.recording import Recording

_BLOCK = 1 << 16  # bytes: other threads have their turn between two
MAX_LINE = 64 * MAX_RAYS
"""Characters of a line of text, which holds a scan."""
_WRAPS = ("msg", "message", "data", "value")  # keys of what a message came in
_SNAKE = re.compile(r"(?<=[a-z])[A-Z]")
NAMES = {
    "start_angle": "angle_min", "end_angle": "angle_max", "distances": "ranges",  # of Foxglove
    "readings": "ranges", "theta": "angles", "odometry": "odom", "true_pose": "pose",  # of CSM
}  # fmt: skip
LASERS = ("laser", "lidar", "sensor", "scanner", "device", "frame", "link", "topic")
"""What a field is called that names one of several lasers, beside frame_id."""
_TABLE = "; readings with an angle each are a table, with a first line angle_deg,distance_mm"
_NO = r"nul+|nil|none|n[/.]?[ad]\.?|#n/?a|k\.? ?a\.?|s[/.]?d\.?|[-?]+|-?1\.#(?:ind|qnan)\d*"
_WORDS = re.compile(rf"{_NO}|(\+?(?:∞|1\.#inf\d*|unendlich|infini(?:to)?))")  # of programs, people
_LISTS = re.compile(r'"(?:array\()?[\[(][^"]*"')  # in a cell, of which NumPy breaks the lines
_PAIR = 3  # numbers at most of a reading with its angle, and a quality
_NANO = 1e14  # seconds that no stamp has, but nanoseconds
_POSES = ("pose", "odom", "mount")
_TYPES = {"ranges": LASER, "child_frame_id": ODOMETRY, "transforms": TF[0]}


def read_jsonl(
    path: PathLike, *, topic: str | None = None, odom: str = "", max_bad: float = MAX_BAD
) -> ScanSet:
    """Read scans from JSON lines, one object per line with the names of sensor_msgs/LaserScan.

    Needed are ``ranges`` and either ``angles`` or ``angle_min`` with ``angle_increment``
    (else ``angle_max``). Optional: ``range_min``, ``range_max``, ``time_increment``, ``stamp``
    (seconds, or ``header.stamp`` with ``sec`` and ``nanosec``), ``pose``, ``odom`` and ``mount``
    (where the sensor sits on the robot) as [x, y, theta] or an object of these names; ``laser`` (or
    ``header.frame_id``), a name for each of several lasers. In ranges, null is NaN, and "inf",
    "-inf", "nan" may be strings.
    Scans of rosbridge, of Foxglove and of CSM are known, too. Of other topics odometry and
    transforms are used; `topic` and `odom` are those of :func:`~imgloc.io.bags.read_bag`. A
    ``.json`` file may also be one such object, or an array of them.
    Broken lines are left out, up to the share `max_bad`, as is a last one that was cut off.
    """
    name, bad = display(path), BadLines(display(path), max_bad)
    whole_file = str(path).lower().removesuffix(".gz").endswith(".json")
    lines = lines_of(path, MAX_TEXT if whole_file else MAX_LINE)
    scans, beside, cut = dict[str, list[Entry]](), Beside(), f"{name}: line {lines.cut}"
    parts = ((f"{name}: line {line}", text) for line, text in lines.numbered)
    found: Iterable[tuple[str, Any]] = parts
    if whole_file:
        text = "\n".join(text for _, text in lines.numbered)
        commas, braces = text.count(","), text.count("{")
        if commas > 4 * MAX_RAYS * max(braces, 1):
            raise ScanError(f"{name}: {commas:,} values, expected at most {MAX_RAYS:,} a scan")
        if braces < 2 or not _is_json(lines.numbered[0][1]) or len(lines.numbered) == 1:
            values = _values(text, name)
            items = [item for value in values for item in _listed(value)]
            found = ((f"{name}: scan {i}", item) for i, item in enumerate(items))
    for where, item in found:
        try:
            entry = _json(item, where) if isinstance(item, str) else item
            entry, on = unwrapped(entry, where)
            if on is None or "ranges" in entry:
                plain = _object(entry, where)
                scans.setdefault(on or "", []).append((where, plain))
            elif {"transforms", "child_frame_id"} & entry.keys():
                with fields_of(ScanError, where):
                    beside.take(on, entry)
        except ScanError as error:
            whole = not isinstance(item, str) or _is_json(item)
            bad.skip(error, where if scans and where == cut and not whole else "")
    counts = {t: len(entries) for t, entries in sorted(scans.items())}
    chosen = choose_topic(counts, topic, name) if counts else ""
    entries = scans.get(chosen, [])
    if not chosen:
        return collect(entries, name, bad)
    about = Recording(tuple(counts), chosen)
    return beside.scans(entries, frame_name(entries[-1][1]["laser"]), about, odom, bad)


def topics_in(path: PathLike) -> Counter[tuple[str, str]]:
    """Count messages in JSON lines by topic and type, or by the laser's name."""
    found = Counter[tuple[str, str]]()
    for _, text in lines_of(path, MAX_TEXT).numbered:
        with contextlib.suppress(ScanError):
            entry, on = unwrapped(_json(text, ""))
            if on := str(_object(entry, "")["laser"]) if on is None else on:
                found[on, next((kind for key, kind in _TYPES.items() if key in entry), "")] += 1
    return found


def _is_json(text: str) -> bool:
    with contextlib.suppress(ValueError, RecursionError):
        return isinstance(json.loads(text), dict)
    return False


def _values(text: str, name: str) -> list[Any]:
    """The JSON values of a file: one, or several one after the other, each on several lines."""
    values, at, decoder = list[Any](), 0, json.JSONDecoder()
    try:
        while at < len(text):
            value, at = decoder.raw_decode(text, at)
            at += len(text[at:]) - len(text[at:].lstrip())
            values.append(value)
    except (ValueError, RecursionError) as e:
        raise ScanError(f"{name}: not valid JSON: {e}") from None
    return values


def _listed(whole: Any) -> list[Any]:
    """The scans of one JSON value: itself, or those that it lists."""
    if isinstance(whole, list):
        is_flat = whole and not any(isinstance(item, dict | list | str) for item in whole)
        rows = [whole] if is_flat else whole
        are_rows = all(isinstance(row, list) and len(row) > _PAIR for row in rows)
        return [{"ranges": row} for row in rows] if are_rows or is_flat else whole
    ranges = whole.get("ranges") if isinstance(whole, dict) else None
    if isinstance(ranges, list) and ranges and all(isinstance(row, list) for row in ranges):
        stamps = whole.pop("stamps", None) or [None] * len(ranges)
        pairs = zip(ranges, stamps, strict=False)
        return [{**whole, "ranges": row, "stamp": stamp} for row, stamp in pairs]
    lists = [v for v in whole.values() if isinstance(v, list)] if isinstance(whole, dict) else []
    inside = [v for v in lists if v and all(isinstance(item, dict) for item in v)]
    return inside[0] if len(inside) == 1 and "ranges" not in whole else [whole]


def unwrapped(entry: Any, where: str = "scan") -> tuple[Any, str | None]:
    """The fields of a scan by the names of LaserScan, and the topic of what they came in.

    Examples
    --------
    >>> unwrapped({"op": "publish", "topic": "/scan", "msg": {"ranges": [1.0], "angleMin": 0.5}})
    ({'ranges': [1.0], 'angle_min': 0.5}, '/scan')
    >>> unwrapped({"readings": [1.0, None], "theta": [0.0, 0.1], "timestamp": [5, 500000]})[0]
    {'ranges': [1.0, None], 'angles': [0.0, 0.1], 'timestamp': [5, 500000], 'stamp': 5.5}
    """
    if not isinstance(entry, dict):
        return entry, None
    inner = next((entry[key] for key in _WRAPS if isinstance(entry.get(key), dict)), None)
    if inner is not None and "ranges" not in entry:
        topic = entry.get("topic")
        return unwrapped(inner, where)[0], str(topic) if topic is not None else "a topic"
    plain = {_SNAKE.sub(lambda m: f"_{m[0].lower()}", str(key)): v for key, v in entry.items()}
    foxglove = "start_angle" in plain
    plain = {NAMES.get(key, key): value for key, value in plain.items()}
    if foxglove:  # the sensor in its frame, which may be the robot's
        pose = plain.pop("pose", None)
        if isinstance(pose, dict) and "orientation" in pose:
            with fields_of(ScanError, f"{where}: pose"):
                plain |= _turned(plain, matrix_of(pose), where)
    stamp = plain.get("timestamp")
    if "angles" in plain and isinstance(stamp, list) and len(stamp) == 2:  # of CSM
        plain["stamp"] = stamp[0] + 1e-6 * stamp[1]
        valid = plain.get("valid") or [1] * len(plain["ranges"])
        plain["ranges"] = [r if v else None for r, v in zip(plain["ranges"], valid, strict=False)]
        for key in ("pose", "odom"):
            if None in (plain.get(key) or [None]):
                plain.pop(key, None)
    elif stamp is not None and "stamp" not in plain:
        plain["stamp"] = _seconds(stamp)
    return plain, plain["topic"] if isinstance(plain.get("topic"), str) else None


def _turned(plain: Mapping[str, Any], pose: FloatArray, where: str) -> dict[str, Any]:
    """The mount of a scan by its pose (4, 4), and its ends, clockwise if it is upside down."""
    if abs(pose[2, 2]) < LEVEL:
        raise ScanError(f"{where}: pose: tilted by more than 5 degrees, expected a level laser")
    ends = ("angle_min", "angle_max") if pose[2, 2] < 0 else ()
    mount = None if np.array_equal(pose, np.eye(4)) else list(planar(pose))
    return {"mount": mount} | {key: -plain[key] for key in ends}


def _seconds(stamp: Any) -> Any:
    """Seconds of a timestamp: of a text as RFC 3339 has it, or of nanoseconds."""
    if isinstance(stamp, str):
        with contextlib.suppress(ValueError):
            return datetime.fromisoformat(stamp.replace("Z", "+00:00")).timestamp()
        return None
    return 1e-9 * stamp if isinstance(stamp, int) and stamp > _NANO else stamp


def read_jsonl_line(text: str, where: str, topic: str | None = None) -> ScanSet | None:
    """The scan of a line for :func:`read_jsonl`; `where` it stands, for errors.

    None for a line of another topic.
    """
    entry, on = unwrapped(_json(text, where), where)
    if on is None and topic is not None:
        raise ScanError(f"{where}: has one laser, expected no topic, got {topic}: leave it out")
    if on is not None and ("ranges" not in entry or on not in lasers_of(topic or on)):
        return None
    return collect([(where, _object(entry, where))], where)


def _object(entry: object, where: str) -> dict[str, Any]:
    if not isinstance(entry, dict):
        found = f"got {type(entry).__name__}, expected an object with ranges"
        raise ScanError(f"{where}: {found}{_TABLE * isinstance(entry, list)}")
    if "ranges" not in entry:
        raise ScanError(f"{where}: ranges: missing, expected a list of metres{_TABLE}")
    return plain_entry(entry, where)


def text_size(path: PathLike, *, between: bytes = b",") -> ScansSize:
    """Size of a text at most: a scan on each line or in each brace, numbers `between` marks.

    Of several marks it is that which is there most often.

    Where numbers are on lines of their own, messages are between lines of dashes.
    """
    marked = [bytes([mark]) for mark in between]
    counts = np.array([1, 0, 0, 1, *[0] * len(marked)])
    with open_text(path) as (file, length):
        while block := file.read(_BLOCK):
            counts += [block.count(mark) for mark in (b"\n", b"{", b",", b"\n---", *marked)]
    lines, braces, commas, dashes, *marks_of = counts.tolist()
    marks = max(marks_of)
    if between == b"\n":
        return ScansSize(dashes, lines + commas, length, text=True)
    return ScansSize(max(lines, braces), lines + marks, length, text=True)


class Lines(NamedTuple):
    """The lines of a file that are not blank, numbered from 1."""

    numbered: list[tuple[int, str]]
    cut: int  # number of the last line if that does not end, else 0


def lines_of(path: PathLike, most: int = MAX_LINE, *, other: str = "") -> Lines:
    """The lines of a file of text, each of at most so many characters; see :func:`read_text`."""
    text = read_text(path, other=other)
    text = _LISTS.sub(lambda cell: cell[0].replace("\n", " "), text) if other else text
    text = text if "\n" in text else text.replace("\r", "\n")
    lines = text.split("\n")
    numbered = check_lines(lines, display(path), most)
    if other and not all(lines[i - 1][:1] in "\t#" for i, _ in numbered):  # tabs with empty cells
        numbered = [(i, lines[i - 1].strip(" \r")) for i, _ in numbered]
    return Lines(numbered, 0 if text.endswith("\n") or not numbered else numbered[-1][0])


def check_lines(lines: Sequence[str], name: str, most: int = MAX_LINE) -> list[tuple[int, str]]:
    """The lines that are not blank, stripped, with their numbers from 1; ScanError for a long one.

    Each is looked at before it is cut into words, which take ten times as much memory.
    """
    for i, line in enumerate(lines, 1):
        if len(line) > most:
            found = f"{len(line):,} characters"
            raise ScanError(f"{name}: line {i}: {found}, expected at most {most:,} for a scan")
    return [(i, s) for i, line in enumerate(lines, 1) if (s := line.strip())]


def number_of(text: str, where: str) -> float:
    """The number that `text` spells, seconds of a date and time; nothing and ``null`` are NaN."""
    if not text:
        return math.nan
    try:
        return float(text)
    except ValueError:
        if word := _WORDS.fullmatch(text.lower()):
            return math.inf if word[1] else math.nan
        if isinstance(seconds := _seconds(text), float):
            return seconds
        hint = "; separate by commas, with decimal points" if re.search(r"[;\t ]", text) else ""
        if text == "...":
            hint = "; it was printed shortened: write all numbers"
        elif where.endswith(": column 1") and not hint:
            hint = "; a table has lines such as 90.0,1230 below one of angle_deg,distance_mm"
        elif ": column" in where and not hint:
            hint = "; nan, or nothing, stands where a ray met nothing"
        raise ScanError(f"{where}: got {text[:40]!r}, expected a number{hint}") from None


def setting_of(key: str, text: str, where: str) -> float:
    """The number of a setting: of range_max what is stated, where there is no number."""
    try:
        return number_of(text, where)
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
    plain = entry = dict(entry)
    if isinstance(entry["ranges"], dict):  # of JavaScript's Float32Array
        entry["ranges"] = list(entry["ranges"].values())
    if isinstance(entry.get("ranges"), list):
        plain["ranges"] = [
            number_of(v or "", f"{where}: ranges[{i}]") if isinstance(v, str | None) else v
            for i, v in enumerate(entry["ranges"])
        ]
    for key in (*SPACING, "range_min", "range_max"):
        if isinstance(entry.get(key), str):  # 5e-2 has no point: a string to YAML 1.1
            plain[key] = setting_of(key, entry[key], f"{where}: {key}")
    header = h if isinstance(h := entry.get("header"), dict) else {}
    stamp = entry.get("stamp", header.get("stamp"))
    if isinstance(stamp, dict):
        parts = [stamp.get(a, stamp.get(b, 0)) for a, b in (("sec", "secs"), ("nanosec", "nsecs"))]
        parts[1] = parts[1] or stamp.get("nsec", 0)
        spelled = (number_of(p, f"{where}: stamp") if isinstance(p, str) else p for p in parts)
        seconds, nanoseconds = (scalar(part, f"{where}: stamp") for part in spelled)
        stamp = seconds + nanoseconds * 1e-9
    plain["stamp"] = None if stamp is None else scalar(stamp, f"{where}: stamp")
    named = {**entry, **header}
    names = (named[key] for key in ("frame_id", *LASERS) if isinstance(named.get(key), str))
    plain["laser"] = entry.get("laser", next((str(name) for name in names), ""))
    for key in _POSES:
        if isinstance(entry.get(key), dict):
            plain[key] = [entry[key].get(k) for k in ("x", "y", "theta")]
    for key in ("ranges", "angles", *_POSES):
        # Beside numbers NumPy takes true for 1.
        if isinstance(plain.get(key), list) and any(isinstance(v, bool) for v in plain[key]):
            raise ScanError(f"{where}: {key}: got true or false in it, expected numbers")
    return plain
