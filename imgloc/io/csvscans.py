"""Scans as CSV: one scan a line."""

import contextlib
import re
from collections.abc import Sequence

import numpy as np

from imgloc.errors import ScanError
from imgloc.io.entries import Entry, collect, number_of, text_lines
from imgloc.io.files import PathLike, display
from imgloc.io.scanset import ScanSet

_SETTING = re.compile(r"\b(\w+)\s*[=:]\s*([^\s,;]+)")
_SETTINGS = ("angle_min", "angle_max", "angle_increment", "range_min", "range_max")
_BESIDE = ("stamp", "x", "y", "theta")


def read_csv(path: PathLike) -> ScanSet:
    """Read scans from a CSV: one scan a line, its ranges in the order of the angles.

    Lines that begin with ``#`` give what the numbers do not, in metres and radians::

        # angle_min=-1.5708, angle_max=1.5708, range_min=0.05, range_max=30
        2.31,2.30,nan,inf,1.02

    ``angle_min`` is needed with ``angle_max`` or ``angle_increment``. A first line of names
    is optional; columns called ``stamp``, ``x``, ``y``, ``theta`` are the stamp and the known
    pose of the sensor, all others are ranges in order. A file with the two columns ``angle``
    and ``range`` is one scan, one reading a line. Empty cells are NaN.

    Raises
    ------
    ScanError
        Naming the line.
    """
    name = display(path)
    settings: dict[str, float] = {}
    columns: list[str] | None = None
    rows: list[tuple[int, list[float]]] = []
    for line, text in text_lines(path):
        where = f"{name}: line {line}"
        if text.startswith("#"):
            for key, value in _SETTING.findall(text):
                if key in _SETTINGS:
                    settings[key] = number_of(value, f"{where}: {key}")
            continue
        cells = [cell.strip() for cell in text.split(",")]
        if columns is None and not rows and _is_header(cells):
            columns = [cell.strip("\"'").lower() for cell in cells]
            continue
        row = [number_of(cell, f"{where}: column {i + 1}") for i, cell in enumerate(cells)]
        if rows and len(row) != len(rows[0][1]):
            raise ScanError(f"{where}: {len(row)} numbers, expected {len(rows[0][1])} as before")
        if columns and len(row) != len(columns):
            raise ScanError(f"{where}: {len(row)} numbers, expected {len(columns)}: one per name")
        rows.append((line, row))
    if not rows:
        raise ScanError(f"{name}: holds no scan, expected one per line")
    table = np.array([row for _, row in rows])
    if columns is not None and {"angle", "range"} <= set(columns):
        angle, reading = columns.index("angle"), columns.index("range")
        entry = {**settings, "angles": table[:, angle], "ranges": table[:, reading]}
        return collect([(name, entry)], name)
    beside = {c: i for i, c in enumerate(columns or []) if c in _BESIDE}
    place = [c for c in ("x", "y", "theta") if c in beside]
    if len(place) not in (0, 3):
        raise ScanError(f"{name}: columns {', '.join(place)}, expected all of x, y, theta or none")
    ranges = np.delete(table, list(beside.values()), axis=1)
    entries: list[Entry] = []
    for k, (line, row) in enumerate(rows):
        entry = {**settings, "ranges": ranges[k]}
        if "stamp" in beside:
            entry["stamp"] = row[beside["stamp"]]
        if place:
            entry["pose"] = [row[beside[key]] for key in place]
        entries.append((f"{name}: line {line}", entry))
    return collect(entries, name)


def _is_header(cells: Sequence[str]) -> bool:
    """Whether no cell is a number; a line of which some are is data with a slip in it."""

    def is_number(cell: str) -> bool:
        with contextlib.suppress(ValueError):
            float(cell)
            return True
        return not cell

    return not any(map(is_number, cells))
