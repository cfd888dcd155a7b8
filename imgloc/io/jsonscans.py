"""Scans as JSON lines, with the names of sensor_msgs/LaserScan."""

import json
from collections.abc import Mapping
from typing import Any

from imgloc.errors import ScanError
from imgloc.io.entries import Entry, collect, number_of, scalar, text_lines
from imgloc.io.files import PathLike, display
from imgloc.io.scanset import ScanSet


def read_jsonl(path: PathLike) -> ScanSet:
    """Read scans from JSON lines, one object per line with the names of sensor_msgs/LaserScan.

    Needed are ``ranges`` and either ``angles`` or ``angle_min`` with ``angle_increment``
    (else ``angle_max``). Optional: ``range_min``, ``range_max``, ``stamp`` (seconds, or
    ``header.stamp`` with ``sec`` and ``nanosec``), ``pose`` and ``odom`` as [x, y, theta] or
    an object of these names. In ranges, null is NaN, and "inf", "-inf", "nan" may be strings.
    A ``.json`` file may also be one such object, or an array of them.

    Raises
    ------
    ScanError
        Naming the line and the key.
    """
    name = display(path)
    entries: list[Entry] = []
    lines = list(text_lines(path))
    if str(path).lower().endswith(".json"):
        whole = _json("\n".join(text for _, text in lines), name)
        items = whole if isinstance(whole, list) else [whole]
        entries = [(f"{name}: scan {i}", item) for i, item in enumerate(items)]
    else:
        for line, text in lines:
            where = f"{name}: line {line}"
            entries.append((where, _json(text, where)))
    for where, entry in entries:
        if not isinstance(entry, dict):
            raise ScanError(f"{where}: got {type(entry).__name__}, expected an object with ranges")
    return collect([(where, _plain(entry, where)) for where, entry in entries], name)


def _json(text: str, where: str) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as e:
        raise ScanError(f"{where}: not valid JSON: {e}") from None


def _plain(entry: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Return the entry with the numbers that JSON cannot write put in."""
    plain = dict(entry)
    if isinstance(entry.get("ranges"), list):
        plain["ranges"] = [
            number_of("" if v is None else v, f"{where}: ranges[{i}]")
            if v is None or isinstance(v, str)
            else v
            for i, v in enumerate(entry["ranges"])
        ]
    for key in ("range_min", "range_max"):
        if entry.get(key) is None:
            plain.pop(key, None)
        elif isinstance(entry[key], str):
            plain[key] = number_of(entry[key], f"{where}: {key}")
    header = entry.get("header")
    stamp = entry.get("stamp", header.get("stamp") if isinstance(header, dict) else None)
    if isinstance(stamp, dict):
        parts = [stamp.get(a, stamp.get(b, 0)) for a, b in (("sec", "secs"), ("nanosec", "nsecs"))]
        seconds, nanoseconds = (scalar(part, f"{where}: stamp") for part in parts)
        stamp = seconds + nanoseconds * 1e-9
    plain["stamp"] = stamp
    for key in ("pose", "odom"):
        if isinstance(entry.get(key), dict):
            plain[key] = [entry[key].get(k) for k in ("x", "y", "theta")]
    return plain
