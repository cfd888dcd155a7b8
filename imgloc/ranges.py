"""The declaration of an option: the annotation of a dataclass field.

It holds the type, the limits with their unit, and the text that explains the option. Range checks,
the command line (:mod:`imgloc.cli.command`) and the docs all read this one declaration.

>>> from typing import Annotated
>>> @dataclass(frozen=True)
... class Walk(Checked):
...     metres: Annotated[float, Within(0, 10, "metres")] = option(1.0, "Length of the walk.")
...     kind: Annotated[str, OneOf("there", "back"), Doc("Direction of the walk.")] = "there"
>>> Walk(2).metres, Walk(kind="back").kind
(2, 'back')
>>> Walk(-1)
Traceback (most recent call last):
    ...
imgloc.errors.ConfigError: Walk.metres: got -1, expected metres, 0 to 10
>>> [(part.name, part.option is not None, part.text) for part in declared(Walk)]
[('metres', True, 'Length of the walk.'), ('kind', False, 'Direction of the walk.')]
"""

import contextlib
import math
import re
import types
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass
from functools import cache
from numbers import Integral, Real
from pathlib import Path
from typing import Annotated, Any, Union, get_args, get_origin, get_type_hints

from imgloc.errors import ConfigError
from imgloc.texts import number, numbers

#: What stands for a value in the help, by its unit; for others their first letter.
METAVARS = {"": "N", "degrees": "DEG", "a share": "P", "a probability": "P", "a factor": "F",
            "bytes": "BYTES"}  # fmt: skip
_SHOWN = 1e5  # limits above are not worth showing
_VAST = 1e9  # a limit so far away is none to anybody


@dataclass(frozen=True)
class Within:
    """A number from `low` to `high`, both allowed, in a unit; NaN is not such a number."""

    low: float
    high: float
    unit: str

    def __str__(self) -> str:
        return self.words()

    def words(self, factor: float = 1.0, unit: str | None = None) -> str:
        """Unit and limits as a text, in another `unit` if its `factor` is given."""
        unit = self.unit if unit is None else unit
        return f"{unit}, {self.limits(factor)}" if unit else self.limits(factor)

    def limits(self, factor: float = 1.0) -> str:
        """The limits as a text: ``0 to 10``, or ``1 or more``."""
        low, high = self.low * factor, self.high * factor
        return f"{low:g} or more" if self.high >= _VAST else f"{low:g} to {high:g}"

    def admits(self, value: Any) -> bool:
        """Return whether the value is such a number."""
        number = isinstance(value, Real) and not isinstance(value, bool)
        return number and self.low <= value <= self.high


class OneOf:
    """One of some names."""

    def __init__(self, *names: str) -> None:
        self.names = names

    def __str__(self) -> str:
        return f"one of {', '.join(self.names)}"

    def admits(self, value: Any) -> bool:
        """Return whether the value is one of them."""
        return isinstance(value, str) and value in self.names


class Matches:
    """A text of at most so many characters that matches a pattern; `words` describe it."""

    def __init__(self, pattern: str, most: int, words: str) -> None:
        self.pattern, self.most, self.words = pattern, most, words

    def __str__(self) -> str:
        return self.words

    def admits(self, value: Any) -> bool:
        """Return whether the value is such a text."""
        return (
            isinstance(value, str)
            and len(value) <= self.most
            and (re.fullmatch(self.pattern, value, re.ASCII) is not None)
        )


class Some:
    """Numbers of a tuple, of which the last may be left out: these values are theirs then."""

    def __init__(self, *rest: float) -> None:
        self.rest = rest


class Doc:
    """A description of a field: a text that stands on its own, with the unit."""

    def __init__(self, text: str) -> None:
        self.text = text


class Option(Doc):
    """A field that commands have as an option, too.

    Parameters
    ----------
    text : str
        What the option does; it stands on its own, with the unit. ``[default: ...]`` at its end
        is what is used if the option is left out, unless the field has a default.
    *names : str
        How it is written; by default the name of the field. A name without dashes in front is that
        of an argument. An angle whose name ends in ``-deg`` is typed in degrees, kept in radians.
    metavar : str, optional
        What stands for the value in the help; by default a letter for the unit.
    parse : callable, optional
        Makes the value of the text that was typed, or raises a ConfigError with what it got
        and expected; by default the type of the field does.
    joined : bool
        The option may be repeated: its texts are joined by commas.
    """

    def __init__(
        self,
        text: str,
        *names: str,
        metavar: str = "",
        parse: Callable[[Any], Any] | None = None,
        joined: bool = False,
    ) -> None:
        super().__init__(text)
        self.names, self.metavar, self.parse, self.joined = names, metavar, parse, joined


Limit = Within | OneOf | Matches


@dataclass(frozen=True)
class Declared:
    """A declaration that was read: of a field, or of a parameter of a command."""

    name: str
    hint: Any  #: its annotation
    default: Any  #: MISSING if a value is needed
    kind: Any  #: its type, without None and without what the annotation adds
    limit: "Limit | None"
    text: str
    option: Option | None
    rest: tuple[float, ...] = ()  #: what the last numbers of a tuple are, if they are left out

    @property
    def flag(self) -> str:
        """The option as it is written; of an argument, what stands for it."""
        names = self.option.names if self.option else ()
        return names[0].partition("/")[0] if names else "--" + self.name.replace("_", "-")

    @property
    def in_degrees(self) -> bool:
        """True if the angle is typed in degrees."""
        return self.flag.endswith("-deg")

    @property
    def metavar(self) -> str | None:
        """The word for the value in the help; None for a switch."""
        if self.option is not None and self.option.metavar:
            return self.option.metavar
        if isinstance(self.limit, OneOf):
            return f"[{'|'.join(self.limit.names)}]"
        if self.kind is bool:
            return None
        unit = "degrees" if self.in_degrees else getattr(self.limit, "unit", "")
        return METAVARS.get(unit, unit[:1].upper())


def declaration(name: str, hint: Any, default: Any = MISSING) -> Declared:
    """Read the declaration of one field, or of a parameter that has this default."""
    kind, notes = hint, list[Any]()
    if isinstance(default, Field):
        notes += default.metadata.values()
        default = None if default.default_factory is not MISSING else default.default
    while True:
        parts = get_args(kind)
        if get_origin(kind) is Annotated:
            kind, notes = parts[0], [*notes, *parts[1:]]
        elif get_origin(kind) in (Union, types.UnionType):
            several = [part for part in parts if part is not types.NoneType]
            kind = several[0] if len(several) == 1 else Any
        else:
            break
    limit = next((note for note in notes if isinstance(note, Limit)), None)
    rest = next((note.rest for note in notes if isinstance(note, Some)), ())
    docs = [note for note in notes if isinstance(note, Doc)]
    option = next((note for note in docs if isinstance(note, Option)), None)
    return Declared(name, hint, default, kind, limit, docs[0].text if docs else "", option, rest)


@cache
def declared(kind: Any) -> tuple[Declared, ...]:
    """Read the declarations of a dataclass, or of a TypedDict, whose keys may be left out."""
    hints = get_type_hints(kind, include_extras=True)
    if not is_dataclass(kind):
        return tuple(declaration(name, hint, None) for name, hint in hints.items())
    return tuple(declaration(part.name, hints[part.name], part) for part in fields(kind))


def parts_of(field: Declared) -> tuple[Declared, ...]:
    """The numbers of a field that is a tuple."""
    return tuple(declaration("", part) for part in get_args(field.kind))


def value_of(field: Declared, text: str) -> Any:
    """The value that a text has for a field; a ConfigError, which does not name it, if none.

    >>> turn = declaration("turn", Annotated[float, Within(0, 1, ""), Option("", "--turn-deg")])
    >>> value_of(turn, "9")
    0.15707963267948966
    """
    option, kind = field.option, field.kind
    value: Any = text
    if kind is Path and not text:
        raise ConfigError("got nothing, expected a path")
    if option is not None and option.parse is not None:
        value = option.parse(Path(text) if kind is Path else text)
    elif get_origin(kind) is tuple:
        parts, rest = parts_of(field), field.rest
        angles = [k for k, part in enumerate(parts) if getattr(part.limit, "unit", "") == "radians"]
        value = numbers(len(parts) - len(rest), rest=rest, angles=angles)(text)
    elif kind in (int, float):
        with contextlib.suppress(ValueError):
            value = number(text)
            value = math.radians(value) if field.in_degrees else _whole(text, value, kind)
    elif kind is not str and kind is not Any:
        value = kind(text)
    check = check_of(field.hint)
    refused = None if check is None else check(value)
    if refused is None:
        return value
    at, expected = refused
    if isinstance(field.limit, Within) and field.in_degrees:
        expected = expected_of(kind, field.limit, 180 / math.pi, "degrees")
    got = repr(text) if isinstance(value, str) else _at(field, at, value) if at else text
    raise ConfigError(f"got {got}, expected {expected}")


def _whole(text: str, value: float, kind: Any) -> float | int:
    """A number as a whole one where that is wanted and it is one, however long."""
    if kind is int and value.is_integer():
        return int(text) if re.fullmatch(r"\s*[-+]?\d+\s*", text) else int(value)
    return value


def _at(field: Declared, at: str, value: Any) -> str:
    """One of several numbers of a value, by what stands for it in the help."""
    k, letters = int(at.strip("[]")), re.findall(r"[A-Z]\w*", field.metavar or "")
    return f"{letters[k] if k < len(letters) else at} {value[k]:g}"


def help_of(field: Declared) -> str:
    """The text of a field as the help and the docs show it: with its limits and its default."""
    text, limit, some = field.text, field.limit, list[str]()
    if isinstance(limit, Within) and limit.high <= _SHOWN:
        some.append(limit.limits(180 / math.pi if field.in_degrees else 1.0))
    if "[default:" in text:
        text, _, default = text.removesuffix("]").partition(" [default: ")
        some.append(f"default: {default}")
    elif field.default not in (None, MISSING, "", [], ()) and field.kind is not bool:
        some.append(f"default: {_shown(field)}")
    return text + (f"  [{'; '.join(some)}]" if some else "")


def _shown(field: Declared) -> str:
    """The default of an option as it would be typed."""
    value = math.degrees(field.default) if field.in_degrees else field.default
    if isinstance(value, tuple | list):
        return ",".join(map(str, value))
    return f"{value:g}" if isinstance(value, float) else str(value)


def option(default: Any, text: str, *names: str, factory: Any = MISSING, **more: Any) -> Any:
    """Return the default of a field, or of a parameter of a command, that is an option.

    It is the default that stands there; ``...`` if a value is needed, or if `factory` makes the
    default. What follows is that of :class:`Option`.
    """
    made: dict[str, Any] = {} if default is ... else {"default": default}
    if factory is not MISSING:
        made = {"default_factory": factory}
    return field(metadata={"option": Option(text, *names, **more)}, **made)


class Checked:
    """A dataclass that refuses, by a ConfigError, a value that the annotation does not allow."""

    def __post_init__(self) -> None:
        kind: Any = type(self)
        for key, check in _checks(kind):
            if (refused := check(getattr(self, key))) is not None:
                at, expected = refused
                got = f"got {getattr(self, key)!r:.60}, expected {expected}"
                raise ConfigError(f"{kind.__name__}.{key}{at}: {got}")


def require(hint: Any, value: Any, name: str) -> None:
    """Raise a ConfigError, by the name of a value, where its annotation does not allow it.

    Examples
    --------
    >>> require(Annotated[int, Within(1, 9, "scans")], 0, "n")
    Traceback (most recent call last):
        ...
    imgloc.errors.ConfigError: n: got 0, expected a whole number, scans, 1 to 9
    """
    check = check_of(hint)
    if check is not None and (refused := check(value)) is not None:
        raise ConfigError(f"{name}{refused[0]}: got {value!r:.60}, expected {refused[1]}")


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
    made = [(part.name, check_of(hints[part.name])) for part in fields(kind)]
    return tuple((name, check) for name, check in made if check is not None)


def check_of(hint: Any) -> Check | None:
    """A function that checks a value by an annotation; None for one that limits nothing."""
    origin, parts = get_origin(hint), get_args(hint)
    if origin is Annotated:
        limits = [note for note in parts[1:] if isinstance(note, Limit)]
        return _limited(parts[0], limits[0]) if limits else check_of(parts[0])
    if origin in (Union, types.UnionType):
        inner = [check_of(part) for part in parts if part is not types.NoneType]
        one = inner[0] if len(inner) == 1 else None  # several kinds: their user tells them apart
        return None if one is None else lambda value: None if value is None else one(value)
    if origin is tuple or origin is Sequence:
        several = origin is Sequence or ... in parts
        return _each(parts, exact=not several, least=origin is Sequence)
    if hint not in _PLAIN and not is_dataclass(hint):
        return None
    kind, said = _PLAIN.get(hint, (hint, getattr(hint, "__name__", "")))

    def check(value: Any) -> Refused:
        fine = isinstance(value, kind) and (hint is bool or not isinstance(value, bool))
        return None if fine and not (hint is float and math.isnan(value)) else ("", said)

    return check


def _limited(kind: Any, limit: Limit) -> Check:
    """A function that checks a number or text that has a limit."""
    optional = types.NoneType in get_args(kind)
    kinds = [part for part in (get_args(kind) or (kind,)) if part is not types.NoneType]
    whole, expected = kinds == [int], expected_of(kinds[0], limit)

    def check(value: Any) -> Refused:
        if optional and value is None:
            return None
        fine = limit.admits(value) and not (whole and not isinstance(value, Integral))
        if isinstance(limit, Within) and isinstance(value, int) and value > limit.high >= _VAST:
            return "", f"{expected}, at most {limit.high:g}"  # shown where it matters
        return None if fine else ("", expected)

    return check


def expected_of(kind: Any, limit: Limit, factor: float = 1.0, unit: str = "") -> str:
    """Words for what a value has to be; in another `unit` if its `factor` is given."""
    words = limit.words(factor, unit) if unit and isinstance(limit, Within) else str(limit)
    return f"a whole number, {words}" if kind is int else words


def _each(parts: Any, *, exact: bool, least: int) -> Check:
    """A function that checks the parts of a tuple, or of a sequence of any length."""
    checks = [check_of(part) for part in parts if part is not ...]

    def check(value: Any) -> Refused:
        several = isinstance(value, tuple | list) or hasattr(value, "tolist")
        if exact and not (several and len(value) == len(checks)):
            return "", f"{len(checks)} values"
        if not several or len(value) < least:
            return "", "at least one value" if least else "several values"
        for k, one in enumerate(value):
            here = checks[k if exact else 0]
            if here is not None and (refused := here(one)) is not None:
                return f"[{k}]", refused[1]
        return None

    return check


Count = Annotated[int, Within(1, 1e12, "")]
Bytes = Annotated[int, Within(0, 1e18, "bytes")]
