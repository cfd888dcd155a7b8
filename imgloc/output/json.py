"""Rows of results as JSON: one object a line, and nothing in it that is not JSON."""

import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from imgloc.geometry import base_of
from imgloc.model import Evidence, Localization, Pose2D

if TYPE_CHECKING:
    from imgloc.evaluate import Evaluation
    from imgloc.io.mapcheck import MapReport
    from imgloc.which import Choice

SURE = ("unique", "ambiguous")
"""Verdicts under which there is a pose to be named; the others list what fits best at most."""


def to_json(row: Mapping[str, object]) -> str:
    """Return one line of JSON; what is not finite becomes null."""
    return json.dumps(plain(row), allow_nan=False)


def plain(value: Any) -> Any:
    """Return `value` as JSON knows it: what is not finite becomes null.

    Examples
    --------
    >>> plain({"a": (1.5, float("inf")), "at": Pose2D(1.0, 2.0)})
    {'a': [1.5, None], 'at': {'x': 1.0, 'y': 2.0, 'theta': 0.0}}
    """
    if isinstance(value, Pose2D):
        return {"x": value.x, "y": value.y, "theta": value.theta}
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if hasattr(value, "tolist"):  # NumPy's scalars and arrays
        return plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def answer_row(
    answer: Localization, index: int = 0, more: Mapping[str, object] | None = None
) -> dict[str, Any]:
    """Return the row of the scan `index` of a file, as `imgloc localize --json` writes it.

    What is `more` is joined to the answer's parameters. ``base_pose`` is the robot's, if it is
    known how the sensor sits on it.

    Examples
    --------
    >>> row = answer_row(Localization((), "invalid", 0.0, float("nan")), 3)
    >>> row["index"], row["verdict"], row["pose"], row["explained"]
    (3, 'invalid', None, None)
    """
    pose, mount = answer.pose if answer.verdict in SURE else None, answer.T_base_laser
    hypotheses = [
        plain(h.pose)
        | {"mass": h.mass, "log_likelihood": h.log_likelihood, "covariance": h.covariance}
        | ({} if mount is None else {"base": base_of(h.pose, mount)})
        for h in answer.hypotheses
    ]
    row = {
        "index": index,
        "verdict": answer.verdict,
        "pose": pose,
        "base_pose": None if pose is None or mount is None else base_of(pose, mount),
        "hypotheses": hypotheses,
        "elsewhere": answer.elsewhere,
        "evidence": _evidence_row(answer.evidence),
        "complete": answer.complete,
        "entropy": answer.entropy,
        "explained": answer.explained,
        "counts": answer.counts,
        "timings_ms": {key: round(ms, 3) for key, ms in answer.timings_ms.items()},
        "parameters": {**answer.parameters, **(more or {})},
    }
    return dict(plain(row))


def _evidence_row(evidence: Evidence) -> dict[str, Any]:
    t = evidence.temperature
    return {
        "readings": evidence.readings,
        "misfit": evidence.misfit,
        "temperature": t.value,
        **{name: getattr(t, name) for name in ("base", "strain", "crowding", "cell")},
        **{name: getattr(evidence, name) for name in ("found", "listed", "unlisted")},
    }


def choice_row(
    choice: "Choice", fits: Mapping[str, Localization], index: int = 0
) -> dict[str, Any]:
    """Return the row of `imgloc which` of one scan: each map with its pose in it."""
    maps = [
        {
            "map": name,
            "probability": share,
            "log_evidence": choice.log_evidence.get(name),
            "misfit": fits[name].evidence.misfit,
            "verdict": fits[name].verdict,
            "pose": fits[name].pose,
            "explained": fits[name].explained,
        }
        for name, share in choice.probability.items()
    ]
    row = {"index": index, **{k: getattr(choice, k) for k in ("verdict", "none", "temperature")}}
    return dict(plain(row | {"maps": maps}))


def evaluation_row(name: str, result: "Evaluation", source: Mapping[str, object]) -> dict[str, Any]:
    """Return the row of `imgloc evaluate` of one map, called `name`, and method."""
    return {
        "map": name,
        **asdict(result.summary),
        "lattice": asdict(result.lattice),
        "source": source,
        "parameters": result.parameters,
    }


def report_row(report: "MapReport") -> dict[str, Any]:
    """Return the row of `imgloc map check`."""
    keys = (
        "path image kind width height resolution size free_area free_parts origin mode semantics "
        "negate occupied_thresh free_thresh shares greys grey_levels semantics_differ warnings"
    )
    named = {
        "size": dict(zip(("width", "height"), report.size, strict=True)),
        "free_area": report.area,
        "origin": plain(report.origin),
        "greys": [{"value": value, "cells": cells} for value, cells in report.greys],
        "warnings": [{"code": w.code, "text": w.text} for w in report.warnings],
    }
    return {key: named[key] if key in named else getattr(report, key) for key in keys.split()}
