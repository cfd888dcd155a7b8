"""One page about a batch: what became of its items, map by map and answer by answer.

The page has everything in itself but, if they are many, the pictures, which it loads from beside
it when they are looked at. Tables are drawn by a script of its own, some rows at a time; here rows
become columns of short values, and all that does not depend on the reader becomes text.
"""

import base64
import json
import math
import os
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from imgloc.__about__ import __version__
from imgloc.doors import JOBS
from imgloc.errors import OutputError
from imgloc.io.files import PathLike, display
from imgloc.output.export import flat
from imgloc.output.pages import percent
from imgloc.output.svg import ENVIRONMENT
from imgloc.runs.batch import BatchSummary
from imgloc.runs.results import PICTURES, Row, read_picture, read_rows, read_run, read_summary

MARK = b'<meta name="generator" content="imgloc report">'  #: is near the beginning of the page
EMBEDDED = 8 << 20
"""Bytes of pictures that the page takes into itself; of more it takes none."""
_VERDICTS = ("unique", "named", "ambiguous", "undecided", "no-match", "none", "invalid")
_BARS = 28  # of a histogram
_SHOWN = 12  # kinds of failures that are listed with how often they were


@dataclass(frozen=True)
class Column:
    """A column of a table, as the page's script shows it, and what of a row it shows."""

    key: str
    title: str
    digits: int | None = None  #: after the point; None is text
    unit: str = ""  #: shares are shown as %, radians as °
    #: where it stands in a row, keys and indices with points between; by default its own key
    at: str | Callable[[Row], Any] = ""

    def of(self, row: Row) -> Any:
        """Displayed value of the column in a row; None where the row has none."""
        value = self.at(row) if callable(self.at) else _at(row, self.at or self.key)
        if isinstance(value, bool):
            return "yes" if value else "no"
        if self.digits is None or value is None or not math.isfinite(value):
            return value if self.digits is None else None
        value = {"%": 100 * value, "°": math.degrees(value)}.get(self.unit[:1], value)
        return round(value, self.digits or None)


def _at(value: Any, place: str) -> Any:
    for step in place.split("."):
        if isinstance(value, list):
            value = value[int(step)] if value else None
        elif value is not None:
            value = value.get(step)
    return value


def _explained(answer: Row) -> Any:
    return answer["explained"] if answer["hypotheses"] else None


_ANSWERS: Mapping[str, tuple[Column, ...]] = {
    "localize": (
        Column("verdict", "verdict"),
        Column("mass", "mass", 1, "%", "hypotheses.0.mass"),
        Column("explained", "explained", 0, "%", _explained),
        Column("misfit", "misfit", 3, "nats", "evidence.misfit"),
        Column("x", "x", 2, "m", "hypotheses.0.x"),
        Column("y", "y", 2, "m", "hypotheses.0.y"),
        Column("theta", "heading", 1, "°", "hypotheses.0.theta"),
        Column("error", "error", 3, "m", "error.position"),
        Column("turn", "turned", 1, "°", "error.heading"),
        Column("hit", "hit"),
        Column("ms", "time", 0, "ms"),
    ),
    "which": (
        Column("verdict", "verdict"),
        Column("best", "best map", at="maps.0.map"),
        Column("probability", "probability", 1, "%", "maps.0.probability"),
        Column("none", "none of them", 1, "%"),
        Column("ms", "time", 0, "ms"),
    ),
    "check": (
        Column("width", "width", 0, "cells"),
        Column("height", "height", 0, "cells"),
        Column("resolution", "cell", 3, "m"),
        Column("area", "free", 1, "m²", "free_area"),
        Column("warnings", "warnings", 0, at=lambda answer: len(answer["warnings"])),
        Column("codes", "what", at=lambda answer: ", ".join(w["code"] for w in answer["warnings"])),
    ),
}
_ITEM = (Column("map", "map"), Column("scans", "scans"), Column("k", "scan", 0))
_MAPS = (
    Column("map", "map"),
    Column("items", "items", 0),
    Column("failed", "failed", 0),
    Column("answers", "scans", 0),
    *(Column(verdict, verdict, 0) for verdict in _VERDICTS),
    Column("known", "pose known", 0),
    Column("right", "right", 1, "%"),
    Column("error", "median error", 3, "m"),
    Column("ms", "median time", 0, "ms"),
)
_FAILURES = [Column(key, key) for key in ("map", "scans", "status", "code", "message")]


@dataclass
class _Counted(BatchSummary):
    """The sums of rows, with what their errors and times are made of."""

    errors: list[float] = field(default_factory=list)  #: metres, of answers with a known pose
    ms: list[float] = field(default_factory=list)

    def add(self, row: Row) -> None:
        super().add(row)
        self.ms += row["cost"].get("ms", ())
        errors = [answer["error"]["position"] for answer in row["answers"] if "error" in answer]
        self.errors += [error for error in errors if error is not None]


def _plain(folder: PathLike) -> list[Column]:
    """Columns of a job that has none of its own: the numbers and texts of its first answer."""
    answers = (answer for row in read_rows(folder) for answer in row["answers"])
    values = flat(next(answers, {}))
    return [
        Column(key, key, at=partial(_shown, key))
        for key, value in values
        if isinstance(value, str | int | float)
    ]


def _shown(place: str, answer: Row) -> str | None:
    value = _at(answer, place) if isinstance(answer, dict) else None
    return f"{value:.6g}" if isinstance(value, float) else None if value is None else str(value)


def render_report(folder: PathLike, *, beside: PathLike | None = None) -> str:
    """Write the page about a folder of results, HTML; it is to be `beside` others in a folder.

    Raises
    ------
    OutputError
        If it is not the folder of a batch, or cannot be read.
    """
    run, summary = read_run(folder), _Counted()
    if (job := run["job"]) not in JOBS:
        known = ", ".join(JOBS)
        raise OutputError(f"{display(folder)}: results of the job {job!r}, expected {known}")
    columns = [*_ITEM, *(_ANSWERS.get(job) or _plain(folder))]
    answers, failures, pictures = list[list[Any]](), list[list[Any]](), list[Any]()
    pages = list[Any]()
    kinds = Counter[tuple[str, str]]()
    maps, versions = dict[str, _Counted](), Counter[str]()
    for row in read_rows(folder):
        summary.add(row)
        maps.setdefault(row["map"], _Counted()).add(row)
        versions[row["version"]] += 1
        if row["status"] != "ok":
            failures.append([column.of(row) for column in _FAILURES])
            kinds[row["status"], str(row["code"])] += 1
        times = row["cost"].get("ms", ())
        for k, answer in enumerate(row["answers"]):
            index = answer.get("index")  # of the scan in its file; S of `evaluate`
            about = {"map": row["map"], "scans": row["scans"]}
            about["k"] = index if isinstance(index, int) else k
            said = {**answer, **about, "ms": times[k] if k < len(times) else None}
            answers.append([column.of(said) for column in columns])
            pictures.append(answer.get("pictures") or 0)
            pages.append(answer.get("page") or 0)
    verdicts, in_order = summary.verdicts, dict.fromkeys((*_VERDICTS, *summary.verdicts))
    of_maps = [_of_map(name, m, verdicts) for name, m in sorted(maps.items())]
    data = {
        "answers": _table(columns, answers) | {"pictures": pictures, "pages": pages},
        "maps": _table(_MAPS, of_maps),
        "failures": _table(_FAILURES, failures, whole=True),
        "folder": Path(os.path.relpath(Path(folder) / PICTURES, beside or folder)).as_posix(),
    }
    embedded = _embedded(folder, pictures)
    return ENVIRONMENT.get_template("report.html").render(
        title=f"{display(Path(folder).resolve().name)}: {job}",
        run=run,
        summary=summary,
        versions=versions.most_common(),
        version=__version__,
        verdicts=[(v, verdicts[v]) for v in in_order if v in verdicts],
        hints=read_summary(folder).get("hints", []),
        statuses=sorted(summary.statuses.items(), key=lambda kv: -kv[1]),
        kinds=[(*kind, n) for kind, n in kinds.most_common(_SHOWN)],
        error_bars=histogram(summary.errors, 0.01, 100.0),
        time_bars=histogram(summary.ms, 1.0, 1e5),
        error_middle=_median(summary.errors),
        time_middle=_median(summary.ms),
        pictured=sum(map(bool, pictures)),
        linked=embedded is None,
        parameters=[(digest, list(flat(p))) for digest, p in run["parameters"].items()],
        data=_script(data),
        embedded=_script(embedded or {}),
    )


def histogram(values: Sequence[float], low: float, high: float) -> list[tuple[float, float, int]]:
    """Counts of values in bars as wide as each other in their logarithm: (from, to, count).

    What is below `low` or above `high` is in the first or last bar; bars at the ends without any
    are left out.

    Examples
    --------
    >>> [(round(a, 2), round(b, 2), n) for a, b, n in histogram([0.5, 1.1, 1.2], 0.01, 100)]
    [(0.37, 0.52, 1), (0.52, 0.72, 0), (0.72, 1.0, 0), (1.0, 1.39, 2)]
    """
    if not values:
        return []
    edges = np.geomspace(low, high, _BARS + 1)
    counts, _ = np.histogram(np.clip(values, low, high), edges)
    (there,) = np.nonzero(counts)
    kept = range(there[0], there[-1] + 1)
    return [(float(edges[k]), float(edges[k + 1]), int(counts[k])) for k in kept]


def brief(value: float) -> str:
    """Three digits, without an exponent.

    Examples
    --------
    >>> brief(0.01234), brief(318.4), brief(18699.0)
    ('0.0123', '318', '18,700')
    """
    return f"{float(f'{value:.3g}'):,}".removesuffix(".0")


def _table(
    columns: Sequence[Column], lines: Sequence[Sequence[Any]], *, whole: bool = False
) -> dict[str, Any]:
    """A table for the page's script: columns, each with its values; texts by their number.

    Columns that are empty in every line are left out, unless it is to be `whole`.
    """
    out = []
    for k, column in enumerate(columns):
        values = [line[k] for line in lines]
        if not whole and all(value is None for value in values):
            continue
        shown = ("key", "title", "digits", "unit")
        said = {name: getattr(column, name) for name in shown} | {"values": values}
        if column.digits is None:
            texts = {text: n for n, text in enumerate(dict.fromkeys(values))}
            said |= {"values": [texts[value] for value in values], "texts": list(texts)}
        out.append(said)
    return {"columns": out, "count": len(lines)}


def _of_map(name: str, m: _Counted, verdicts: Iterable[str]) -> list[Any]:
    """The line of a map in the table of all; of the `verdicts` each has a number."""
    row = {
        "map": name, "items": m.items, "failed": m.failed,
        "answers": sum(m.verdicts.values()) or None, **{v: m.verdicts.get(v, 0) for v in verdicts},
        "known": m.known or None,
        "right": m.hits / m.known if m.known else None,
        "error": _median(m.errors), "ms": _median(m.ms),
    }  # fmt: skip
    return [column.of(row) for column in _MAPS]


def _median(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if len(values) else None


def _embedded(folder: PathLike, pictures: Iterable[Any]) -> dict[str, str] | None:
    """The pictures as base64, by their names; None if they are too many for a page."""
    found, room = dict[str, str](), EMBEDDED
    for name in (name for some in pictures if some for name in some):
        data = read_picture(folder, name, room + 1)
        if data is None or len(data) > room:
            return None
        room -= len(data)
        found[name] = base64.b64encode(data).decode("ascii")
    return found


def _script(data: object) -> Markup:
    """JSON that may stand within a script element."""
    text = json.dumps(data, separators=(",", ":"), allow_nan=False)
    return Markup(text.replace("<", "\\u003c").replace("\u2028", "\\u2028"))  # noqa: S704


ENVIRONMENT.filters |= {"brief": brief, "percent": percent}
