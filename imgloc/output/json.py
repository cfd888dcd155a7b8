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
    answer: Localization,
    index: int = 0,
    more: Mapping[str, object] | None = None,
    mount: Pose2D | None = None,
) -> dict[str, Any]:
    """Return the row of one scan, as `imgloc localize --json` writes it.

    Parameters
    ----------
    answer : Localization
    index : int
        Of the scan in its file.
    more : mapping, optional
        Joined to the answer's parameters.
    mount : Pose2D, optional
        Pose of the sensor on the robot; None if it is not known. ``base_pose`` is the robot's.

    Examples
    --------
    >>> row = answer_row(Localization((), "invalid", 0.0, float("nan")), 3)
    >>> row["index"], row["verdict"], row["pose"], row["explained"]
    (3, 'invalid', None, None)
    """
    pose = answer.pose if answer.verdict in SURE else None
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
    row = {
        "index": index,
        "verdict": choice.verdict,
        "none": choice.none,
        "temperature": choice.temperature,
        "maps": maps,
    }
    return dict(plain(row))


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
    width, height = report.size
    return {
        **{key: getattr(report, key) for key in ("path", "image", "kind", "width", "height")},
        "resolution": report.resolution,
        "size": {"width": width, "height": height},
        "free_area": report.area,
        "free_parts": report.free_parts,
        "origin": plain(report.origin),
        **{key: getattr(report, key) for key in ("mode", "semantics", "negate")},
        "occupied_thresh": report.occupied_thresh,
        "free_thresh": report.free_thresh,
        "shares": report.shares,
        "greys": [{"value": value, "cells": cells} for value, cells in report.greys],
        "grey_levels": report.grey_levels,
        "semantics_differ": report.semantics_differ,
        "warnings": [{"code": w.code, "text": w.text} for w in report.warnings],
    }
