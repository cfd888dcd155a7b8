"""The numbers that were fitted or chosen by measurement, with their sources: ``numbers.json``.

Each number has a line: its value, its unit, its source, and what it costs to leave it out. A source
is by which command, on which data and when. A literal that is left in the code is mathematics, a
unit, a bound of memory that no answer depends on, or has the reason beside it.

>>> number("Trust.mass"), number("FusedOptions.keep")
(0.9, (1500, 4000, 4000, 16000))
>>> SOURCES[NUMBERS["tracker.most"].source].by
'chosen, checked by python -m tools.sequences --metres 12 --cases tracker --starts 50 --kidnaps 20'
"""

import hashlib
import json
import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

FILE = Path(__file__).with_name("numbers.json")


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
    unit: Any  #: a name, or a list of names
    source: str  #: which :class:`Origin`
    costs: str  #: what it costs to leave it out or to change it, or that this was not measured


def number(name: str) -> Any:
    """The value of a number, or the values of several, in SI units; a KeyError for no such name."""
    return NUMBERS[name].value


def read(text: str) -> tuple[dict[str, Origin], dict[str, Number]]:
    """The sources and the numbers of a file's text, by name."""
    content = json.loads(text)
    sources = {name: Origin(**entry) for name, entry in content["sources"].items()}
    numbers = {
        name: Number(**entry | {"value": in_si(entry["value"], entry["unit"])})
        for name, entry in content["numbers"].items()
    }
    return sources, numbers


def in_si(value: Any, unit: Any) -> Any:
    """A value, or a tuple of several, with radians for degrees."""
    if isinstance(value, list):
        units = unit if isinstance(unit, list) else [unit] * len(value)
        return tuple(map(in_si, value, units))
    return math.radians(value) if unit == "degrees" else value


def write(text: str, changed: Mapping[str, Any], source: str, made: Origin) -> str:
    """The text of a file in which some numbers have other values, of one source.

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
    return "{\n" + ",\n".join(parts) + "\n}\n"


def _line(item: tuple[str, Any]) -> str:
    text = json.dumps(item[1], ensure_ascii=False, allow_nan=False)
    return f"  {json.dumps(item[0])}: {text}"


SOURCES, NUMBERS = read(FILE.read_text("utf-8"))


def digest(families: Collection[str]) -> str:
    """Hash of the values of some families, as ``Trust`` is that of ``Trust.mass``.

    Rows that were made with other numbers are not the same rows.
    """
    some = {name: one.value for name, one in NUMBERS.items() if name.split(".")[0] in families}
    return hashlib.blake2b(json.dumps(some, sort_keys=True).encode(), digest_size=8).hexdigest()
