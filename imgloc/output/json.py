"""Rows of results as JSON: one object a line, and nothing in it that is not JSON."""

import json
from collections.abc import Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from imgloc.model import Localization, plain

if TYPE_CHECKING:
    from imgloc.choice import Choice
    from imgloc.evaluation import Evaluation
    from imgloc.io.mapcheck import MapReport


def to_json(row: Mapping[str, object]) -> str:
    """Return one line of JSON; what is not finite becomes null."""
    return json.dumps(plain(row), allow_nan=False)


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
