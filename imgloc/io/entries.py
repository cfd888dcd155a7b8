"""One scan as names and values: the checks that CSV and JSON lines share."""

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

Entry = tuple[str, Mapping[str, Any]]
"""Where it stands in the file, for messages, and what it says (names of LaserScan)."""
_LIMIT = 8 * MAX_READINGS  # bytes
_BLOCK = 1 << 20


def text_lines(path: PathLike) -> list[tuple[int, str]]:
    """Return the lines of a UTF-8 file that are not blank, with their numbers from 1.

    Raises
    ------
    ScanError
        Missing, not a regular file, too long, or not UTF-8.
    """
    name = display(path)
    data = read_file(path, limit=_LIMIT, error=ScanError, what="scan file")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as e:
        raise ScanError(f"{name}: byte {e.start} is not UTF-8 text") from None
    return [(i, s.strip()) for i, s in enumerate(text.split("\n"), 1) if s.strip()]


def text_size(path: PathLike) -> ScansSize:
    """How much a text may hold: a scan on each line or in each brace, numbers between commas.

    Raises
    ------
    ScanError
        Missing, not a regular file, or too long.
    """
    lines, braces, commas, ascii_only = 1, 0, 0, True
    with open_file(path, limit=_LIMIT, error=ScanError, what="scan file") as (file, length):
        while block := file.read(_BLOCK):
            lines += block.count(b"\n")
            braces += block.count(b"{")
            commas += block.count(b",")
            ascii_only &= block.isascii()
    return ScansSize(max(lines, braces), lines + commas, length, True, ascii_only)


def number_of(text: str, where: str) -> float:
    """Return the number that `text` spells; nothing and ``null`` are NaN.

    Raises
    ------
    ScanError
        Beginning with `where`.

    Examples
    --------
    >>> number_of("-inf", "a.csv: line 1"), number_of("", "a.csv: line 2")
    (-inf, nan)
    """
    if not text or text.lower() == "null":
        return math.nan
    try:
        return float(text)
    except ValueError:
        hint = "; separate by commas, with decimal points" if re.search(r"[;\t ]", text) else ""
        raise ScanError(f"{where}: got {text[:40]!r}, expected a number{hint}") from None


def scalar(value: Any, where: str) -> float:
    """Return a JSON value that must be one number.

    Raises
    ------
    ScanError
        Beginning with `where`.
    """
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ScanError(f"{where}: got {str(value)[:40]!r}, expected a number")
    try:
        return float(value)
    except OverflowError:  # JSON writes integers of any length
        raise ScanError(f"{where}: got a number of {len(str(value))} digits") from None


def collect(entries: Sequence[Entry], name: str) -> ScanSet:
    """Check each entry and make the set.

    Raises
    ------
    ScanError
        Naming the place and the key.
    """
    if not entries:
        raise ScanError(f"{name}: holds no scan, expected one per line")
    scans: list[LaserScan] = []
    beside: dict[str, list[FloatArray]] = {"pose": [], "odom": []}
    for where, entry in entries:
        scan = _scan(entry, where)
        scans.append(scan)
        for key in ("pose", "odom"):
            if entry.get(key) is not None:
                value = numbers(entry[key], where, key, ndim=(1,))
                if value.shape != (3,):
                    raise ScanError(
                        f"{where}: {key}: got {len(value)} numbers, expected x, y, theta"
                    )
                check_finite(value, where, key)
                beside[key].append(value)
    for key in ("pose", "odom"):
        if len(beside[key]) not in (0, len(scans)):
            raise ScanError(
                f"{name}: {key}: in {len(beside[key])} of {len(scans)} scans, expected all or none"
            )
    stamps = np.array([scan.stamp for scan in scans])
    poses, odom = (np.array(beside[key]) if beside[key] else None for key in ("pose", "odom"))
    return ScanSet(tuple(scans), poses, None if np.isnan(stamps).all() else stamps, odom)


def _scan(entry: Mapping[str, Any], where: str) -> LaserScan:
    if entry.get("ranges") is None:
        raise ScanError(f"{where}: ranges: missing, expected a list of metres")
    ranges = numbers(entry["ranges"], where, "ranges", ndim=(1,))
    if not len(ranges):
        raise ScanError(f"{where}: ranges: empty, expected at least one reading")
    angles = _entry_angles(entry, len(ranges), where)
    low, high = _value(entry, "range_min", 0.0, where), _value(entry, "range_max", math.inf, where)
    check_limits(low, high, where)
    return LaserScan(ranges, angles, low, high, _value(entry, "stamp", math.nan, where))


def _value(entry: Mapping[str, Any], key: str, default: float, where: str) -> float:
    return default if entry.get(key) is None else scalar(entry[key], f"{where}: {key}")


def _entry_angles(entry: Mapping[str, Any], n: int, where: str) -> FloatArray:
    angles: FloatArray
    if entry.get("angles") is not None:
        angles = numbers(entry["angles"], where, "angles", ndim=(1,))
        if len(angles) != n:
            raise ScanError(f"{where}: angles: got {len(angles)}, expected {n} as in ranges")
    else:
        given = {
            key: scalar(entry[key], f"{where}: {key}")
            for key in ("angle_min", "angle_max", "angle_increment")
            if entry.get(key) is not None
        }
        if "angle_min" not in given or len(given) < 2:
            raise ScanError(
                f"{where}: angles: missing, expected angles, or angle_min with "
                "angle_increment or angle_max, in radians"
            )
        if "angle_increment" in given:
            step = given["angle_increment"]
            angles = given["angle_min"] + np.arange(n, dtype=np.float64) * step
            # Drivers disagree on whether angle_max is the last ray or the one after it.
            if abs(given.get("angle_max", angles[-1]) - angles[-1]) > 2.5 * abs(step):
                raise ScanError(
                    f"{where}: angle_max: got {given['angle_max']:g}, expected "
                    f"{angles[-1]:g} = angle_min + {n - 1} x angle_increment; "
                    "were readings left out?"
                )
        else:
            angles = np.linspace(given["angle_min"], given["angle_max"], n)
    check_angles(angles, where)
    return angles
