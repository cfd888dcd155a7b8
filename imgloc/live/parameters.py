"""Parameters of requests: what each may be, as a JSON schema and as what reads it.

One declaration serves both the OpenAPI document and the check of a request.

>>> near = Parameter("near", "Where.", Numbers(3, ((-1e6, 1e6), (-1e6, 1e6), TURN)))
>>> read_query(b"near=1,2,0.5", (near,))
{'near': (1.0, 2.0, 0.5)}
>>> read_query(b"near=1,2,90", (near,))
Traceback (most recent call last):
    ...
imgloc.live.problems.Refused: near: got '1,2,90', expected 3 numbers with commas between: \
-1e+06 to 1e+06, -1e+06 to 1e+06, -6.2832 to 6.2832
"""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol
from urllib.parse import parse_qsl

from imgloc.live.problems import Refused
from imgloc.options import Radius, Turn
from imgloc.ranges import OneOf, Within, declaration, declared

_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", re.ASCII)
_LONGEST = 8192  # characters of a value
TURN = (-6.2832, 6.2832)  #: radians, once around either way
PLACE = (-1e6, 1e6)  #: metres


def _limits(hint: Any) -> tuple[float, float]:
    limit = declaration("", hint).limit
    assert isinstance(limit, Within)
    return limit.low, limit.high


NEAR, OFF = _limits(Radius), _limits(Turn)  #: metres around a place, radians beside a heading


class Kind(Protocol):
    """What a parameter may be."""

    @property
    def schema(self) -> dict[str, Any]:
        """The same as a JSON schema."""

    def read(self, text: str) -> Any:
        """The value; None of a text that is none."""

    def __str__(self) -> str:
        """What is expected, in words."""


@dataclass(frozen=True)
class Number:
    """A number from `low` to `high`, both of them allowed."""

    low: float
    high: float
    unit: str = ""
    whole: bool = False

    @property
    def schema(self) -> dict[str, Any]:
        """A number, or an integer."""
        kind = "integer" if self.whole else "number"
        return {"type": kind, "minimum": self.low, "maximum": self.high}

    def read(self, text: str) -> float | int | None:
        """The number."""
        value = float(text) if _NUMBER.fullmatch(text) else float("nan")
        if not self.low <= value <= self.high or (self.whole and value != int(value)):
            return None
        return int(value) if self.whole else value

    def __str__(self) -> str:
        what = "a whole number" if self.whole else "a number"
        unit = f" of {self.unit}" if self.unit else ""
        return f"{what}{unit}, {self.low:g} to {self.high:g}"


@dataclass(frozen=True)
class Numbers:
    """`least` numbers with commas between, or more: each within its bounds."""

    least: int
    bounds: tuple[tuple[float, float], ...]

    @property
    def schema(self) -> dict[str, Any]:
        """An array; in a query its numbers have commas between."""
        each = [{"type": "number", "minimum": low, "maximum": high} for low, high in self.bounds]
        about = {"minItems": self.least, "maxItems": len(each)}
        if all(one == each[0] for one in each):
            return {"type": "array", "items": each[0], **about}
        return {"type": "array", "prefixItems": each, "items": False, **about}

    def read(self, text: str) -> tuple[float, ...] | None:
        """The numbers."""
        words = text.split(",")
        if not self.least <= len(words) <= len(self.bounds):
            return None
        found = [Number(*b).read(word) for word, b in zip(words, self.bounds, strict=False)]
        return None if None in found else tuple(float(v) for v in found if v is not None)

    def __str__(self) -> str:
        most = len(self.bounds)
        count = f"{self.least}" if self.least == most else f"{self.least} to {most}"
        same = len(set(self.bounds)) == 1
        each = ", ".join(f"{a:g} to {b:g}" for a, b in self.bounds[: 1 if same else most])
        return f"{count} numbers with commas between: {each}"


@dataclass(frozen=True)
class Word:
    """One of some words."""

    words: tuple[str, ...]

    @property
    def schema(self) -> dict[str, Any]:
        """A string."""
        return {"type": "string", "enum": list(self.words)}

    def read(self, text: str) -> str | None:
        """The word."""
        return text if text in self.words else None

    def __str__(self) -> str:
        return f"one of {', '.join(self.words)}"


@dataclass(frozen=True)
class Flag:
    """True or false."""

    @property
    def schema(self) -> dict[str, Any]:
        """A boolean."""
        return {"type": "boolean"}

    def read(self, text: str) -> bool | None:
        """The value."""
        return {"true": True, "false": False}.get(text)

    def __str__(self) -> str:
        return "true or false"


@dataclass(frozen=True)
class Text:
    """A text of a pattern, which a whole value matches."""

    pattern: str
    most: int
    about: str

    @property
    def schema(self) -> dict[str, Any]:
        """A string."""
        return {"type": "string", "pattern": f"^(?:{self.pattern})$", "maxLength": self.most}

    def read(self, text: str) -> str | None:
        """The text."""
        fits = len(text) <= self.most and re.fullmatch(self.pattern, text, re.ASCII)
        return text if fits else None

    def __str__(self) -> str:
        return self.about


@dataclass(frozen=True)
class Parameter:
    """A parameter of a query."""

    name: str
    about: str  #: one sentence or more, for people
    kind: Kind
    default: Any = None
    needed: bool = False

    @classmethod
    def of(
        cls, kind: Any, field: str, name: str = "", about: str = "", default: Any = None
    ) -> "Parameter":
        """The parameter of an option, with the limits and the text of its one declaration.

        Examples
        --------
        >>> from imgloc.options import Options
        >>> Parameter.of(Options, "theta_step", "theta_step_deg").kind
        Number(low=0.05, high=180.0, unit='degrees', whole=False)
        """
        (one,) = (part for part in declared(kind) if part.name == field)
        limit, factor = one.limit, 180 / math.pi if one.in_degrees else 1.0
        found: Kind = Flag()
        if isinstance(limit, OneOf):
            found = Word(limit.names)
        elif limit is not None:
            low, high = (round(bound * factor, 9) for bound in (limit.low, limit.high))
            found = Number(low, high, "degrees" if one.in_degrees else limit.unit, one.kind is int)
        return cls(name or field, about or one.text, found, default)


def read_query(query: bytes, parameters: Sequence[Parameter]) -> dict[str, Any]:
    """The values of a query string by their names; defaults are not put in.

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
        value = known[name].kind.read(text) if len(text) <= _LONGEST else None
        if value is None:
            raise Refused(
                "bad-parameter", f"{name}: got {text[:60]!r}, expected {known[name].kind}"
            )
        out[name] = value
    for one in parameters:
        if one.needed and one.name not in out:
            raise Refused("bad-parameter", f"{one.name}: missing, expected {one.kind}")
    return out


def with_defaults(given: Mapping[str, Any], parameters: Sequence[Parameter]) -> dict[str, Any]:
    """The values with the defaults of those that were not given."""
    return {one.name: given.get(one.name, one.default) for one in parameters}
