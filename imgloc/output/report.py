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
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from imgloc.__about__ import __version__
from imgloc.batch import BatchSummary
from imgloc.io.files import PathLike, display
from imgloc.io.results import PICTURES, Row, read_rows, read_run, read_summary
from imgloc.output.pages import flat
from imgloc.output.svg import ENVIRONMENT

MARK = b'<meta name="generator" content="imgloc report">'  #: is near the beginning of the page
EMBEDDED = 8 << 20
"""Bytes of pictures that the page takes into itself; of more it takes none."""
_VERDICTS = ("unique", "named", "ambiguous", "undecided", "no-match", "none", "invalid")
_BARS = 28  # of a histogram
_SHOWN = 12  # kinds of failures that are listed with how often they were


@dataclass(frozen=True)
class Column:
    """A column of a table, as the page's script shows it."""

    key: str
    title: str
    digits: int | None = None  #: after the point; None is text
    unit: str = ""


_ANSWERS: Mapping[str, tuple[Column, ...]] = {
    "localize": (
        Column("verdict", "verdict"),
        Column("mass", "mass", 1, "%"),
        Column("explained", "explained", 0, "%"),
        Column("misfit", "misfit", 3, "nats"),
        Column("x", "x", 2, "m"),
        Column("y", "y", 2, "m"),
        Column("theta", "heading", 1, "°"),
        Column("error", "error", 3, "m"),
        Column("turn", "turned", 1, "°"),
        Column("hit", "hit"),
        Column("ms", "time", 0, "ms"),
    ),
    "which": (
        Column("verdict", "verdict"),
        Column("best", "best map"),
        Column("probability", "probability", 1, "%"),
        Column("none", "none of them", 1, "%"),
        Column("ms", "time", 0, "ms"),
    ),
    "evaluate": (
        Column("method", "method"),
        Column("trials", "scans", 0),
        Column("index", "S", 2, "nats"),
        Column("right", "right", 1, "%"),
        Column("wrong", "unique, wrong", 1, "%"),
        Column("error", "median error", 3, "m"),
    ),
    "check": (
        Column("width", "width", 0, "cells"),
        Column("height", "height", 0, "cells"),
        Column("resolution", "cell", 3, "m"),
        Column("area", "free", 1, "m²"),
        Column("warnings", "warnings", 0),
        Column("codes", "what"),
    ),
    "atlas": (
        Column("places", "places", 0),
        Column("unique", "unique", 1, "%"),
        Column("ambiguous", "ambiguous", 1, "%"),
        Column("wrong", "wrong", 1, "%"),
        Column("area", "one scan is enough", 1, "% of the area"),
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
_FAILURES = (
    Column("map", "map"),
    Column("scans", "scans"),
    Column("status", "status"),
    Column("code", "code"),
    Column("message", "message"),
)


@dataclass
class _OfMap:
    """What the items of one map come to."""

    items: int = 0
    failed: int = 0
    verdicts: Counter[str] = field(default_factory=Counter)
    known: int = 0
    hits: int = 0
    errors: list[float] = field(default_factory=list)
    ms: list[float] = field(default_factory=list)


def render_report(folder: PathLike, *, beside: PathLike | None = None) -> str:
    """Write the page about a folder of results, HTML; it is to be `beside` others in a folder.

    Raises
    ------
    OutputError
        If it is not the folder of a batch, or cannot be read.
    """
    run, summary = read_run(folder), BatchSummary()
    job = str(run["job"])
    columns = [*_ITEM, *_ANSWERS[job]]
    answers: dict[str, list[Any]] = {column.key: [] for column in columns} | {"pictures": []}
    failures: dict[str, list[Any]] = {column.key: [] for column in _FAILURES}
    maps: dict[str, _OfMap] = {}
    versions: Counter[str] = Counter()
    of_job = _DESCRIBED[job]
    for row in read_rows(folder):
        summary.add(row)
        versions[row["version"]] += 1
        of_map = maps.setdefault(row["map"], _OfMap())
        of_map.items += 1
        if row["status"] != "ok":
            of_map.failed += 1
            for column in _FAILURES:
                failures[column.key].append(row[column.key])
        for k, answer in enumerate(row["answers"]):
            index = answer.get("index") if "verdict" in answer else None  # S of `evaluate` else
            said = {"map": row["map"], "scans": row["scans"], "k": k if index is None else index}
            said |= of_job(answer, row, k)
            for column in columns:
                answers[column.key].append(_short(said.get(column.key), column.digits))
            answers["pictures"].append(answer.get("pictures") or 0)
            _count(of_map, answer, row, k)
    errors = [e for m in maps.values() for e in m.errors]
    times = [t for m in maps.values() for t in m.ms]
    shown = [column for column in columns if any(v is not None for v in answers[column.key])]
    data = {
        "answers": _table(shown, answers) | {"pictures": answers["pictures"]},
        "maps": _table_of_maps(maps),
        "failures": _table(_FAILURES, failures),
        "folder": Path(os.path.relpath(Path(folder) / PICTURES, beside or folder)).as_posix(),
    }
    embedded = _embedded(Path(folder) / PICTURES, answers["pictures"])
    return ENVIRONMENT.get_template("report.html").render(
        title=f"{display(Path(folder).resolve().name)}: {job}",
        run=run,
        summary=summary,
        versions=versions.most_common(),
        version=__version__,
        verdicts=_in_order(summary.verdicts),
        hints=read_summary(folder).get("hints", []),
        statuses=sorted(summary.statuses.items(), key=lambda kv: -kv[1]),
        kinds=_kinds(failures),
        error_bars=histogram(errors, 0.01, 100.0),
        time_bars=histogram(times, 1.0, 1e5),
        error_middle=_median(errors),
        time_middle=_median(times),
        pictured=sum(bool(p) for p in answers["pictures"]),
        linked=embedded is None,
        parameters=[(digest, list(flat(p))) for digest, p in run["parameters"].items()],
        data=_script(data),
        embedded=_script(embedded or {}),
    )


def histogram(values: Sequence[float], low: float, high: float) -> list[tuple[float, float, int]]:
    """Counts of values in bars of equal width of their logarithm: (from, to, count).

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


def _count(of_map: _OfMap, answer: Row, row: Row, k: int) -> None:
    if "verdict" in answer:
        named = "maps" in answer and answer["verdict"] not in _VERDICTS
        of_map.verdicts["named" if named else answer["verdict"]] += 1
    if k < len(row["cost"].get("ms", ())):
        of_map.ms.append(row["cost"]["ms"][k])
    if "hit" in answer:
        of_map.known += 1
        of_map.hits += answer["hit"]
        if (error := answer["error"]["position"]) is not None:
            of_map.errors.append(error)


def _table(columns: Sequence[Column], values: Mapping[str, list[Any]]) -> dict[str, Any]:
    """A table for the page's script: columns, each with its values; texts by their number."""
    out = []
    for column in columns:
        said = {**vars(column), "values": values[column.key]}
        if column.digits is None:
            texts = {text: k for k, text in enumerate(dict.fromkeys(values[column.key]))}
            said |= {"values": [texts[v] for v in values[column.key]], "texts": list(texts)}
        out.append(said)
    return {"columns": out, "count": len(next(iter(values.values())))}


def _table_of_maps(maps: Mapping[str, _OfMap]) -> dict[str, Any]:
    values: dict[str, list[Any]] = {column.key: [] for column in _MAPS}
    for name, m in sorted(maps.items()):
        row: dict[str, Any] = {
            "map": name, "items": m.items, "failed": m.failed,
            "answers": sum(m.verdicts.values()) or None, **m.verdicts, "known": m.known or None,
            "right": 100 * m.hits / m.known if m.known else None,
            "error": _median(m.errors), "ms": _median(m.ms),
        }  # fmt: skip
        for column in _MAPS:
            values[column.key].append(_short(row.get(column.key), column.digits))
    kept = [c for c in _MAPS if any(v is not None for v in values[c.key])]
    for column in kept:
        if column.key in _VERDICTS:
            values[column.key] = [v or 0 for v in values[column.key]]
    return _table(kept, values)


def _kinds(failures: Mapping[str, list[Any]]) -> list[tuple[str, str, int]]:
    """Kinds of failures, how often they were, most often first."""
    pairs = Counter(zip(failures["status"], map(str, failures["code"]), strict=True))
    return [(status, code, n) for (status, code), n in pairs.most_common(_SHOWN)]


def _in_order(verdicts: Mapping[str, int]) -> list[tuple[str, int]]:
    known = [(v, verdicts[v]) for v in _VERDICTS if v in verdicts]
    return known + [(v, n) for v, n in verdicts.items() if v not in _VERDICTS]


def _median(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if len(values) else None


def _short(value: Any, digits: int | None) -> Any:
    if digits is None or value is None:
        return value
    return None if not math.isfinite(value) else round(value, digits) if digits else round(value)


def _embedded(folder: Path, pictures: Iterable[Any]) -> dict[str, str] | None:
    """The pictures as base64, by their names; None if they are too many for a page."""
    names = [name for some in pictures if some for name in some]
    try:
        if sum((folder / name).stat().st_size for name in names) > EMBEDDED:
            return None
        return {n: base64.b64encode((folder / n).read_bytes()).decode("ascii") for n in names}
    except OSError:
        return None


def _script(data: object) -> Markup:
    """JSON that may stand within a script element."""
    text = json.dumps(data, separators=(",", ":"), allow_nan=False)
    return Markup(text.replace("<", "\\u003c").replace("\u2028", "\\u2028"))  # noqa: S704


def _located(answer: Row, row: Row, k: int) -> dict[str, Any]:
    best = answer["hypotheses"][0] if answer["hypotheses"] else None
    out = {"verdict": answer["verdict"], "misfit": answer["evidence"]["misfit"]}
    if k < len(row["cost"].get("ms", ())):
        out["ms"] = row["cost"]["ms"][k]
    if best is not None:
        out |= {"x": best["x"], "y": best["y"], "theta": math.degrees(best["theta"])}
        out |= {"mass": 100 * best["mass"], "explained": 100 * (answer["explained"] or 0)}
    if "hit" in answer:
        error = answer["error"]
        turned = None if error["heading"] is None else math.degrees(error["heading"])
        out |= {"hit": "yes" if answer["hit"] else "no", "error": error["position"]}
        out["turn"] = turned
    return out


def _named(answer: Row, row: Row, k: int) -> dict[str, Any]:
    best = answer["maps"][0]
    probability = best["probability"]
    return {
        "verdict": answer["verdict"],
        "best": best["map"],
        "probability": None if probability is None else 100 * probability,
        "none": None if answer["none"] is None else 100 * answer["none"],
        "ms": row["cost"]["ms"][k] if k < len(row["cost"].get("ms", ())) else None,
    }


def _measured(answer: Row, _row: Row, _k: int) -> dict[str, Any]:
    success = answer["success"][-1]
    return {
        "method": answer["method"],
        "trials": answer["trials"],
        "index": answer["index"]["value"],
        "right": 100 * success["at_1"]["value"],
        "wrong": 100 * success["unique_wrong"]["value"],
        "error": answer["position"]["p50"],
    }


def _checked(answer: Row, _row: Row, _k: int) -> dict[str, Any]:
    codes = [w["code"] for w in answer["warnings"]]
    own = {key: answer[key] for key in ("width", "height", "resolution")}
    about = {"area": answer["free_area"], "warnings": len(codes), "codes": ", ".join(codes)}
    return own | about


def _surveyed(answer: Row, _row: Row, _k: int) -> dict[str, Any]:
    shares = {kind: 100 * answer[kind]["value"] for kind in ("unique", "ambiguous", "wrong")}
    return {"places": answer["places"], **shares, "area": 100 * answer["unique_area"]["value"]}


_DESCRIBED: Mapping[str, Callable[[Row, Row, int], dict[str, Any]]] = {
    "localize": _located, "which": _named, "evaluate": _measured, "check": _checked,
    "atlas": _surveyed,
}  # fmt: skip
ENVIRONMENT.filters["brief"] = brief
