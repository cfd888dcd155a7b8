"""What a field of an options dataclass may be: its annotation says it, one function checks it.

>>> from typing import Annotated
>>> @dataclass(frozen=True)
... class Walk(Checked):
...     metres: Annotated[float, Within(0, 10, "metres")] = 1.0
...     kind: Annotated[str, OneOf("there", "back")] = "there"
>>> Walk(2).metres, Walk(kind="back").kind
(2, 'back')
>>> Walk(-1)
Traceback (most recent call last):
    ...
imgloc.errors.ConfigError: Walk.metres: got -1, expected metres, 0 to 10
"""

import math
import types
from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from numbers import Integral, Real
from typing import Annotated, Any, Union, get_args, get_origin, get_type_hints

from imgloc.errors import ConfigError


@dataclass(frozen=True)
class Within:
    """A number from `low` to `high`, both of them allowed, in a unit; NaN is none."""

    low: float
    high: float
    unit: str

    def __str__(self) -> str:
        if math.isinf(self.high):
            return f"{self.unit}, {self.low:g} or more"
        return f"{self.unit}, {self.low:g} to {self.high:g}"

    def admits(self, value: Any) -> bool:
        """Whether the value is such a number."""
        number = isinstance(value, Real) and not isinstance(value, bool)
        return number and self.low <= value <= self.high


class OneOf:
    """One of some names."""

    def __init__(self, *names: str) -> None:
        self.names = names

    def __str__(self) -> str:
        return f"one of {', '.join(self.names)}"

    def admits(self, value: Any) -> bool:
        """Whether the value is one of them."""
        return isinstance(value, str) and value in self.names


class Checked:
    """A dataclass that refuses, by a ConfigError, a value that the annotation does not allow."""

    def __post_init__(self) -> None:
        name = type(self).__name__
        kind: Any = type(self)
        for key, hint in _hints(kind).items():
            if (wanted := _refused(getattr(self, key), hint)) is not None:
                got, (at, expected) = getattr(self, key), wanted
                raise ConfigError(f"{name}.{key}{at}: got {got!r:.60}, expected {expected}")


@cache
def _hints(kind: Any) -> dict[str, Any]:
    hints = get_type_hints(kind, include_extras=True)
    return {part.name: hints[part.name] for part in fields(kind)}


def _refused(value: Any, hint: Any) -> tuple[str, object] | None:
    """Where in a value, and what was expected there, if the annotation does not allow it."""
    origin, parts = get_origin(hint), get_args(hint)
    if origin is Annotated:
        limit = next((m for m in hint.__metadata__ if isinstance(m, Within | OneOf)), None)
        inner = _refused(value, parts[0])
        if limit is not None and (inner is not None or not limit.admits(value)):
            return "", f"a whole number, {limit}" if parts[0] is int else limit
        return inner
    if origin in (Union, types.UnionType):
        if value is None and type(None) in parts:
            return None
        found = [_refused(value, part) for part in parts if part is not type(None)]
        return None if None in found else found[0]
    if origin is tuple or origin is Sequence:
        return _refused_sequence(value, parts, exact=origin is tuple and ... not in parts)
    kinds: dict[Any, tuple[Any, str]] = {
        bool: (bool, "True or False"), int: (Integral, "a whole number"),
        float: (Real, "a number"), str: (str, "a text"),
    }  # fmt: skip
    kind, said = kinds.get(hint, (hint, getattr(hint, "__name__", "")))
    if hint not in kinds and not is_dataclass(hint):
        return None
    fine = isinstance(value, kind) and (hint is bool or not isinstance(value, bool))
    fine = fine and not (hint is float and math.isnan(value))
    return None if fine else ("", said)


def _refused_sequence(value: Any, parts: Any, *, exact: bool) -> tuple[str, object] | None:
    """As :func:`_refused` of a tuple or sequence of parts."""
    numbers = isinstance(value, tuple | list) or hasattr(value, "tolist")
    if exact and not (numbers and len(value) == len(parts)):
        return "", f"{len(parts)} values"
    if not numbers or len(value) == 0:
        return "", "at least one value"
    for k, one in enumerate(value):
        if (wanted := _refused(one, parts[k] if exact else parts[0])) is not None:
            return f"[{k}]", wanted[1]
    return None
