"""The numbers that were fitted or chosen by measurement, with their sources: ``numbers.json``.

Each number has a line: its value, its unit, its source, and what it costs to leave it out. A source
is by which command, on which data and when. A literal that is left in the code is mathematics, a
unit, a bound of memory that no answer depends on, or has the reason beside it.

>>> number("Trust.mass"), number("FusedOptions.keep")
(0.9, (1500, 4000, 4000, 16000))
>>> origin("tracker.most").by
'chosen, checked by python -m tools.sequences --metres 12 --cases tracker --starts 50 --kidnaps 20'
"""

import hashlib
import json
import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from imgloc.errors import ConfigError
from imgloc.ranges import Within, check_of

FILE = Path(__file__).with_name("numbers.json")
_WHOLE = Annotated[int, Within(1, 1e9, "")]
_SHARE = Annotated[float, Within(0, 1, "")]
_SIZE = Annotated[float, Within(0, 1e6, "")]
_NATS = Annotated[float, Within(0, math.inf, "")]
_FACTOR = Annotated[float, Within(1e-6, 1e6, "")]
#: Each unit, and the numbers that it has in the file.
UNITS: Mapping[str, Any] = {
    **dict.fromkeys(
        ("blocks", "cells", "components", "directions", "grey levels", "headings", "hypotheses",
         "maps", "nodes", "places", "poses", "readings", "scans", "searches"), _WHOLE,
    ),
    **dict.fromkeys(("share", "probability"), _SHARE),
    **dict.fromkeys(
        ("metres", "seconds", "metres and seconds", "square metres", "variance", "deviations",
         "square deviations", "odds", "logarithm", "per reading", "temperature per nat"), _SIZE,
    ),
    **dict.fromkeys(("nats", "nats per reading"), _NATS),
    **dict.fromkeys(("factor", "exponent", "temperature"), _FACTOR),
    "log-odds": Annotated[float, Within(-1e6, 1e6, "")],
    "radians": Annotated[float, Within(0, math.tau, "")],
    "degrees": Annotated[float, Within(0, 360, "")],
}  # fmt: skip


@dataclass(frozen=True)
class Origin:
    """Where a number is from."""

    by: str  #: the command that fitted it or measured it, or that it was chosen
    on: str  #: the data
    date: str  #: year, month and day


@dataclass(frozen=True)
class Number:
    """One line of the file; of several values each may have its own unit."""

    value: Any  #: a number or a tuple of numbers, SI units
    unit: Any  #: a name, or a tuple of names
    source: str  #: which :class:`Origin`
    costs: str  #: what it costs to leave it out or to change it, or that this was not measured


def number(name: str) -> Any:
    """The value of a number, or the values of several, in SI units; a KeyError for no such name."""
    return NUMBERS[name].value


def origin(name: str) -> Origin:
    """Where a number is from."""
    return SOURCES[NUMBERS[name].source]


def read(text: str) -> tuple[dict[str, Origin], dict[str, Number]]:
    """The sources and the numbers of a file's text, by name.

    A text that is not JSON, an entry with other keys than above, a source that is not there, a unit
    that is not one of :data:`UNITS`, or a value out of its range is a ConfigError that names it.
    """
    try:
        content = json.loads(text)
        entries, origins = content["numbers"], content["sources"]
    except (ValueError, TypeError, KeyError) as e:
        raise ConfigError(f"{FILE.name}: {e!r}, expected sources and numbers") from None
    sources = {name: _made(Origin, name, entry) for name, entry in origins.items()}
    numbers = {}
    for name, entry in entries.items():
        one = _made(Number, name, entry)
        if one.source not in sources:
            raise ConfigError(f"{FILE.name}: {name}.source: got {one.source!r}, expected a source")
        unit = tuple(one.unit) if isinstance(one.unit, list) else one.unit
        numbers[name] = Number(_value(name, one), unit, one.source, one.costs)
    return sources, numbers


def write(text: str, changed: Mapping[str, Any], source: str, made: Origin) -> str:
    """The text of a file in which some numbers have other values, of one source; it is checked.

    `changed` has the values by name, in the units of the file.
    """
    content = json.loads(text)
    content["sources"][source] = vars(made)
    for name, value in changed.items():
        content["numbers"][name] |= {"value": value, "source": source}
    parts = [
        f"{json.dumps(part)}: {{\n" + ",\n".join(map(_line, content[part].items())) + "\n}"
        for part in ("sources", "numbers")
    ]
    out = "{\n" + ",\n".join(parts) + "\n}\n"
    read(out)
    return out


def _line(item: tuple[str, Any]) -> str:
    return f"  {json.dumps(item[0])}: {json.dumps(item[1], ensure_ascii=False)}"


def _made(kind: Any, name: str, entry: Any) -> Any:
    """A line of the file as a dataclass."""
    keys = list(kind.__dataclass_fields__)
    if not isinstance(entry, dict) or sorted(entry) != sorted(keys):
        raise ConfigError(f"{FILE.name}: {name}: got {entry!r:.60}, expected {', '.join(keys)}")
    for key, value in entry.items():
        if key not in ("value", "unit") and not (isinstance(value, str) and value):
            raise ConfigError(f"{FILE.name}: {name}.{key}: got {value!r:.60}, expected a text")
    return kind(**entry)


def _value(name: str, one: Number) -> Any:
    """A value in SI units, checked by its unit."""
    several = isinstance(one.value, list)
    values, unit = one.value if several else [one.value], one.unit
    units: list[Any] = unit if isinstance(unit, list) else [unit] * len(values)
    if not values or len(units) != len(values):
        raise ConfigError(f"{FILE.name}: {name}: got {len(values)} values, {len(units)} units")
    for value, unit in zip(values, units, strict=True):
        if unit not in UNITS:
            raise ConfigError(f"{FILE.name}: {name}.unit: got {unit!r}, expected a unit of UNITS")
        if refused := _CHECKS[unit](value):
            expected = f"expected {unit}, {refused[1]}"
            raise ConfigError(f"{FILE.name}: {name}.value: got {value!r}, {expected}")
    out = [value if UNITS[unit] is _WHOLE
           else math.radians(value) if unit == "degrees" else float(value)
           for value, unit in zip(values, units, strict=True)]  # fmt: skip
    return tuple(out) if several else out[0]


_CHECKS = {unit: check_of(kind) or (lambda _: None) for unit, kind in UNITS.items()}
SOURCES, NUMBERS = read(FILE.read_text("utf-8"))


def digest(families: Collection[str]) -> str:
    """Hash of the values of some families, as ``Trust`` is that of ``Trust.mass``.

    Rows that were made with other numbers are not the same rows.
    """
    some = {name: one.value for name, one in NUMBERS.items() if name.split(".")[0] in families}
    return hashlib.blake2b(json.dumps(some, sort_keys=True).encode(), digest_size=8).hexdigest()
