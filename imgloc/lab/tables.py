"""Results of measurements as text and as rows."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from imgloc.lab.calibrate import SharedFit
from imgloc.numbers import number
from imgloc.output.tables import as_plain, percent


def atlas_text(summary: Mapping[str, Any]) -> str:
    """Return the shares of :func:`imgloc.lab.atlas.summarise`."""
    meanings = {
        "unique": "of the poses: one scan is enough",
        "unique_area": "of the free area: one scan is enough at every heading",
        "ambiguous": "of the poses: several places fit",
        "no-match": "of the poses: not recognized",
        "wrong": "of the poses: wrong, but sure",
    }
    lines = [f"{summary['poses']} poses at {summary['places']} places, {summary['area']:.1f} m²"]
    for s, words in ((summary[key], words) for key, words in meanings.items()):
        interval = f"[{100 * s['low']:.1f}, {100 * s['high']:.1f}]"
        lines.append(f"{percent(s['value']):>8} {interval}  {words}")
    lines.append("  in brackets: where the share lies with 95 % confidence")
    lines.append(
        f"a pose by one scan is exact to {summary['bound']:.3f} m at best (median of the poses); "
        f"walls leave a direction free at {percent(summary['free']['value'])} of them"
    )
    return "\n".join(lines)


SHARP: float = number("faces.sharp")
"""Metres behind the border of its cells up to which the face of a wall is called sharp."""


def shared_words(found: SharedFit, resolution: float) -> str:
    """Describe a shared error that was fitted on a map with cells of `resolution` metres."""
    shared, error = found.shared, found.deviation
    thinner = f"{shared.thinner * resolution:.2f} m thinner on each side than drawn"
    if error is None:
        facts = [
            ("scans", f"{found.used} of {found.asked} are at sure places along "
                      f"{found.metres:.0f} m of odometry"),
            ("walls", f"{thinner}, and each piece of them stands {shared.bent:.2f} m off"),
            ("fit", f"scans at sure places lack {shared.usual:.1f} nats per reading here"),
        ]  # fmt: skip
        return "\n".join(f"{name:<6} {fact}" for name, fact in facts)
    right = "imgloc uses that, though the map's scale may be right"
    if shared.scale == 1:
        right = "as the map has it"
    elif abs(shared.scale - 1) > max(2 * error, 0.002):
        right = f"the map's cells are of {resolution / shared.scale:.4g} m, or ranges are off"
    depth, off = shared.depth or 0.0, found.deviation_depth or 0.0
    faces = "sharp, as drawn" if depth < max(3 * off, SHARP) else "blurred, as scans make them"
    facts = [
        ("scans", f"{found.used} of {found.asked} fit at one place"),
        ("scale", f"ranges x {shared.scale:.4f} +- {error:.4f}: {right}"),
        ("walls", thinner),
        ("faces", f"{depth:.3f} +- {off:.3f} m behind the border of the walls: {faces}"),
    ]
    return "\n".join(f"{name:<6} {fact}" for name, fact in facts)


def calibration_table(fits: Mapping[str, Any]) -> str:
    """Return the fits of :func:`imgloc.lab.calibrate.fit` by the name of the method."""
    columns = ("method", "scans", "sigma m", "sigma deg", "exponent", "S +- s.e.", "S of the stack")
    rows = [
        (
            method,
            str(fit.index.trials),
            f"{fit.calibration.sigma_xy:g}",
            f"{math.degrees(fit.calibration.sigma_theta):.3g}",
            f"{1 / fit.calibration.temperature:.3g}",
            _estimate(vars(fit.index)),
            _estimate(vars(fit.bare)),
        )
        for method, fit in fits.items()
    ]
    return as_plain(columns, rows, left=1)


def evaluation_tables(rows: Sequence[Mapping[str, Any]], width: int | None = None) -> str:
    """Return tables, as of :func:`as_plain`, of rows of :meth:`Evaluation.as_row`."""
    tables = []
    for title, make in (
        ("Right answers, % [95 % interval]", _success),
        ("Errors of the first hypothesis, and times", _cost),
        ("Index S (eq. 12, nats) and global maximum, over free cells [95 % interval]", _index),
    ):
        cells = [
            {"map": row["map"], "method": row["method"], "n": str(row["trials"]), **make(row)}
            for row in rows
        ]
        table = as_plain(list(cells[0]), [list(c.values()) for c in cells], left=2, width=width)
        tables.append(f"{title}\n{table}")
    return "\n\n".join(tables)


def _index(row: Mapping[str, Any]) -> dict[str, str]:
    step = row["lattice"]["theta_step"]
    return {
        "cell": f"{row['lattice']['cell']:g} m {math.degrees(step):.3g} deg",
        "S +- s.e.": _estimate(row["index"]), "S calibrated": _estimate(row["index_calibrated"]),
        "S max": f"{row['lattice']['log_poses']:.2f}", "S all cells": _estimate(row["index_box"]),
        "at floor": str(row["index"]["floored"]), "not free": str(row["outside"]),
        "maximum %": _share(row["exact"]), "within 1 cell %": _share(row["near"]),
    }  # fmt: skip


def _success(row: Mapping[str, Any]) -> dict[str, str]:
    out: dict[str, str] = {}
    for s in row["success"]:
        near = f"{s['tolerance']['position']:g} m {math.degrees(s['tolerance']['heading']):.3g} deg"
        out |= {f"{near} @1": _share(s["at_1"]), f"{near} @5": _share(s["at_5"])}
    out["unique"] = _share(row["verdicts"]["unique"])
    out["unique, wrong"] = _share(row["success"][-1]["unique_wrong"])
    return out


def _cost(row: Mapping[str, Any]) -> dict[str, str]:
    cost = row["cost"]
    names = tuple(row["position"])
    degrees = [math.degrees(row["heading"][q]) for q in names]
    return {
        "m " + " ".join(names): " ".join(_number(row["position"][q], 2) for q in names),
        "deg " + " ".join(names): " ".join(_number(d, 1) for d in degrees),
        "ms p50 p99": " ".join(_number(cost["ms"][q], 0) for q in ("median", "p99")),
        "stack ms": _number(cost["stack_ms"]["median"], 1),
    }


def _estimate(index: Mapping[str, Any]) -> str:
    return f"{_number(index['value'], 2)} +- {_number(index['standard_error'], 2)}"


def _share(share: Mapping[str, Any]) -> str:
    low, high = 100 * share["low"], 100 * share["high"]
    return f"{100 * share['value']:.1f} [{low:2.0f}, {high:3.0f}]"


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else "-"
