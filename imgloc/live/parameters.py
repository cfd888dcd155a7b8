"""Parameters of requests: declarations of :mod:`imgloc.ranges`, as a JSON schema and from a query.

>>> from imgloc.options import Known
>>> near = option(Known, "near")
>>> read_query(b"near=1,2,0.5", (near,))
{'near': (1.0, 2.0, 0.5, 2.0, 0.8)}
>>> read_query(b"near=1,2,0.5,0", (near,))
Traceback (most recent call last):
    ...
imgloc.live.problems.Refused: near: got R 0, expected metres, 0.01 to 1e+06
"""

import math
from collections.abc import Sequence
from dataclasses import MISSING, replace
from typing import Annotated, Any, get_args, get_origin
from urllib.parse import parse_qsl

from imgloc.errors import ConfigError
from imgloc.live.problems import Refused
from imgloc.options import Angle, Place
from imgloc.ranges import (
    Declared,
    Matches,
    OneOf,
    Within,
    declaration,
    declared,
    expected_of,
    parts_of,
    value_of,
)
from imgloc.texts import pose

_LONGEST = 8192  # characters of a value
CORNERS = 6, 200  #: numbers of a polygon


def option(kind: Any, field: str, **changed: Any) -> Declared:
    """The parameter of an option: called as it is on the command line, with its limits and text.

    Examples
    --------
    >>> from imgloc.options import Options
    >>> one = option(Options, "theta_step")
    >>> one.name, schema_of(one)
    ('theta_step_deg', {'type': 'number', 'minimum': 0.05, 'maximum': 180.0})
    """
    (one,) = (part for part in declared(kind) if part.name == field)
    default = None if one.default is MISSING else one.default
    name = one.flag.removeprefix("--").partition("/")[0].replace("-", "_")
    return replace(one, **{"name": name, "default": default, **changed})


def schema_of(one: Declared) -> dict[str, Any]:
    """Allowed values, as a JSON schema; in a query numbers of an array have commas between."""
    kind, limit = one.kind, one.limit
    if one.option is not None and one.option.parse is pose:
        place = Place if limit is None else Annotated[float, limit]
        one = declaration("", tuple[place, place, Angle])  # type: ignore[valid-type]
        kind = one.kind
    if get_origin(kind) is tuple:
        if get_args(kind)[-1] is ...:
            item = schema_of(declaration("", get_args(kind)[0]))
            return {"type": "array", "items": item, "minItems": CORNERS[0], "maxItems": CORNERS[1]}
        each = [schema_of(part) for part in parts_of(one)]
        about = {"minItems": len(each) - len(one.rest), "maxItems": len(each)}
        if all(part == each[0] for part in each):
            return {"type": "array", "items": each[0], **about}
        return {"type": "array", "prefixItems": each, "items": False, **about}
    if isinstance(limit, OneOf):
        return {"type": "string", "enum": list(limit.names)}
    if isinstance(limit, Matches):
        pattern = f"^(?:{limit.pattern})$"
        return {"type": "string", "pattern": pattern, "maxLength": limit.most}
    if isinstance(limit, Within):
        factor = 180 / math.pi if one.in_degrees else 1.0
        low, high = (round(bound * factor, 9) for bound in (limit.low, limit.high))
        what = "integer" if kind is int else "number"
        return {"type": what, "minimum": low, "maximum": high}
    return {"type": "boolean" if kind is bool else "string"}


def read_query(query: bytes, parameters: Sequence[Declared]) -> dict[str, Any]:
    """The values of a query string by their names; what is not in it has its default.

    What is unknown, comes twice, is missing or wrong is refused.
    """
    known = {one.name: one for one in parameters}
    try:
        pairs = parse_qsl(
            query.decode("ascii"), keep_blank_values=True, errors="strict", max_num_fields=64
        )
    except ValueError:
        raise Refused("bad-parameter", "the query is no list of name=value in UTF-8") from None
    out: dict[str, Any] = {}
    for name, text in pairs:
        shown = repr(name[:40])
        if name not in known:
            some = f"one of {', '.join(known)}" if known else "no parameter"
            raise Refused("bad-parameter", f"got the parameter {shown}, expected {some}")
        if name in out:
            raise Refused("bad-parameter", f"{name}: got it twice, expected it once")
        out[name] = _value(known[name], text)
    for one in parameters:
        if one.default is MISSING and one.name not in out:
            expected = one.text if one.limit is None else expected_of(one.kind, one.limit)
            raise Refused("bad-parameter", f"{one.name}: missing, expected {expected}")
    return {one.name: out.get(one.name, one.default) for one in parameters}


def _value(one: Declared, text: str) -> Any:
    try:
        if one.kind is bool and text not in ("true", "false"):
            raise ConfigError(f"got {text!r}, expected true or false")
        if len(text) > _LONGEST:
            raise ConfigError(f"got {len(text)} characters, expected at most {_LONGEST}")
        return text == "true" if one.kind is bool else value_of(one, text)
    except ConfigError as error:
        raise Refused("bad-parameter", f"{one.name}: {error}") from None
