"""One declaration: command line, HTTP, ROS and Python have the same names, limits and texts."""

import json
import math
import re
from dataclasses import is_dataclass
from typing import Any

import pytest
from command import ROOT, params_of, tree

from imgloc import options
from imgloc.live import bounds, openapi, settings
from imgloc.live.parameters import option, schema_of
from imgloc.ranges import Declared, OneOf, Within, declared, help_of

KINDS = (
    options.Options, options.Known, options.Logs, options.Mounting, options.Drawn, options.Chosen,
    options.Sensor, options.Followed, options.Reading, bounds.Bounds, settings.Settings,
    options.PlanWalls,
)  # fmt: skip
#: Parameters of requests that no command has: names and ids, one scan of what was sent, a pose.
OWN = {"map", "scans", "name", "topic", "index", "pose", "scale", "thinner", "bent", "allow_lossy",
       "start", "count", "slice", "step", "headings", "at", "places", "region",
       "hints"}  # fmt: skip


def typed() -> dict[str, set[str]]:
    """The help of each option, by its name, of all commands that have it."""
    found: dict[str, set[str]] = {}
    waiting: list[Any] = [tree()]
    while waiting:
        one = waiting.pop()
        waiting += getattr(one, "commands", {}).values()
        for param in params_of(one):
            found.setdefault(param.opts[0], set()).add(param.help or "")
    return found


HELP = typed()
NAMES = [one.name for kind in KINDS for one in declared(kind) if one.option]
OPTIONS = [(kind, one) for kind in KINDS for one in declared(kind) if one.option]


@pytest.mark.parametrize(("kind", "one"), OPTIONS, ids=NAMES)
def test_the_command_line_has_each_option_as_it_is_declared(kind: Any, one: Declared) -> None:
    assert one.flag not in HELP or help_of(one) in HELP[one.flag]


def asked() -> dict[str, list[Declared]]:
    """The parameters of all requests by their names."""
    found: dict[str, list[Declared]] = {}
    for operation in (*openapi.OPERATIONS, openapi.TRACK):
        for one in operation.parameters:
            found.setdefault(one.name, []).append(one)
    return found


@pytest.mark.parametrize("name", sorted(asked()))
def test_a_request_has_each_option_as_the_command_line(name: str) -> None:
    options = [one for kind, one in OPTIONS if option(kind, one.name).name == name]
    for there in asked()[name]:
        same = [one for one in options if one.text == there.text]
        assert bool(same) != (name in OWN) or there.text == "Method of the likelihood."
        for one in same:
            schema, limit = schema_of(there), one.limit
            if isinstance(limit, Within):
                factor = 180 / math.pi if one.in_degrees else 1.0
                low, high = (round(bound * factor, 9) for bound in (limit.low, limit.high))
                assert (schema["minimum"], schema["maximum"]) == (low, high)
                assert schema["type"] == ("integer" if one.kind is int else "number")
            if isinstance(limit, OneOf):
                assert schema["enum"] == list(limit.names)
            assert there.default == one.default


@pytest.mark.parametrize(("kind", "one"), OPTIONS, ids=NAMES)
def test_python_has_the_default_and_the_limits_of_the_text(kind: Any, one: Declared) -> None:
    if is_dataclass(kind) and one.default is not None:
        assert getattr(kind(), one.name) == one.default
    if isinstance(one.limit, Within) and one.limit.high <= 1e5:
        factor = 180 / math.pi if one.in_degrees else 1.0
        assert one.limit.limits(factor) in help_of(one)


def test_the_guide_has_each_parameter_of_the_node_with_its_default() -> None:
    page = (ROOT / "tools" / "docs" / "node.md").read_text("utf-8").partition("## Parameters")[2]
    rows = dict[str, str]()
    for names, values in re.findall(r"^\| (`.*?) \| (.*?) \|", page, re.MULTILINE):
        some = values.replace("`", "").split(", ") if "`, `" in names else [values.strip("`")]
        keys = re.findall(r"`(\w+)`", names)
        rows |= dict(zip(keys, some * (len(keys) if len(some) == 1 else 1), strict=True))
    for one in declared(settings.Settings):
        listed = json.dumps(one.default) if one.default != math.inf else "inf"
        listed = listed.strip('"') or "empty"
        assert rows[one.name] == listed, one.name
