"""A tool with one number of ``numbers.json`` at another value.

    python -m tools.vary floorplan.soft 1.0 tools.plans --sheets "escape plan,small house" -n 20
    python -m tools.vary GridOptions.share 0.9 tools.sequences ../data/fr079 --cases grid
    python -m tools.vary align.slack 0.3 tools.maps align ../data/*/map.yaml

The value is in the units of that file; lists are in brackets. Beside it stands what the tool prints
by itself. Processes that a tool starts have the number as it is.
"""

import argparse
import json
import runpy
import sys
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from imgloc.numbers import NUMBERS, in_si


def change(name: str, value: Any) -> None:
    """Put another value, SI units, in the place of a number, before what it decides is imported."""
    NUMBERS[name] = replace(NUMBERS[name], value=value)


def main(arguments: Sequence[str] | None = None) -> None:
    """Parse the command line, change the number, run the tool; it imports what decides answers."""
    raw = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser("tools.vary", description=__doc__, formatter_class=raw)
    parser.add_argument("name", choices=sorted(NUMBERS), metavar="NAME")
    parser.add_argument("value", type=json.loads, metavar="VALUE")
    parser.add_argument("tool", metavar="TOOL")
    given, words = parser.parse_known_args(arguments)
    change(given.name, in_si(given.value, NUMBERS[given.name].unit))
    sys.argv = [given.tool, *words]
    runpy.run_module(given.tool, run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main()
