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
from collections.abc import Callable, Mapping, Sequence
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
        kind: Any = type(self)
        for key, check in _checks(kind):
            if (refused := check(getattr(self, key))) is not None:
                at, expected = refused
                got = f"got {getattr(self, key)!r:.60}, expected {expected}"
                raise ConfigError(f"{kind.__name__}.{key}{at}: {got}")


#: Where in a value, and what was expected there; None where all is as it should be.
Refused = tuple[str, object] | None
Check = Callable[[Any], Refused]
_PLAIN: Mapping[Any, tuple[Any, str]] = {
    bool: (bool, "True or False"), int: (Integral, "a whole number"),
    float: (Real, "a number"), str: (str, "a text"),
}  # fmt: skip


@cache
def _checks(kind: Any) -> tuple[tuple[str, Check], ...]:
    """The fields of a dataclass that have something to check, and how."""
    hints = get_type_hints(kind, include_extras=True)
    made = [(part.name, _check_of(hints[part.name])) for part in fields(kind)]
    return tuple((name, check) for name, check in made if check is not None)


def _check_of(hint: Any) -> Check | None:
    """What checks a value by an annotation; None for one that says nothing of values."""
    origin, parts = get_origin(hint), get_args(hint)
    if origin is Annotated:
        return _limited(parts[0], parts[1])
    if origin in (Union, types.UnionType):
        inner = [_check_of(part) for part in parts if part is not type(None)]
        (one,) = inner  # nothing here is one of several kinds, but it may be None
        return None if one is None else lambda value: None if value is None else one(value)
    if origin is tuple or origin is Sequence:
        return _each(parts, exact=origin is tuple and ... not in parts)
    if hint not in _PLAIN and not is_dataclass(hint):
        return None
    kind, said = _PLAIN.get(hint, (hint, getattr(hint, "__name__", "")))

    def check(value: Any) -> Refused:
        fine = isinstance(value, kind) and (hint is bool or not isinstance(value, bool))
        return None if fine and not (hint is float and math.isnan(value)) else ("", said)

    return check


def _limited(kind: Any, limit: Within | OneOf) -> Check:
    """What checks a number or text that has a limit."""
    whole, expected = kind is int, f"a whole number, {limit}" if kind is int else str(limit)

    def check(value: Any) -> Refused:
        fine = limit.admits(value) and not (whole and not isinstance(value, Integral))
        return None if fine else ("", expected)

    return check


def _each(parts: Any, *, exact: bool) -> Check:
    """What checks the parts of a tuple, or of a sequence of any length but none."""
    checks = [_check_of(part) for part in parts if part is not ...]

    def check(value: Any) -> Refused:
        several = isinstance(value, tuple | list) or hasattr(value, "tolist")
        if exact and not (several and len(value) == len(checks)):
            return "", f"{len(checks)} values"
        if not several or len(value) == 0:
            return "", "at least one value"
        for k, one in enumerate(value):
            here = checks[k if exact else 0]
            if here is not None and (refused := here(one)) is not None:
                return f"[{k}]", refused[1]
        return None

    return check
