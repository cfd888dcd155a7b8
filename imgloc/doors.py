"""Lazy imports of the rooms behind the wall: by name, when they are used.

No room before the wall imports ``plans`` or ``lab``: whoever needs something of theirs asks here.
"""

from importlib import import_module
from typing import Any

#: What finds that a map has aged, where scans do not fit it.
AGING = "imgloc.lab.changes:aging_hint"
#: Commands behind the wall by their names, and their functions.
COMMANDS = {
    "align": "imgloc.lab.commands.align:align",
    "atlas": "imgloc.lab.commands.atlas:atlas",
    "calibrate": "imgloc.lab.commands.calibrate:calibrate",
    "changes": "imgloc.lab.commands.changes:changes",
    "evaluate": "imgloc.lab.commands.evaluate:evaluate",
    "plan": "imgloc.plans.command:plan",
}
#: Jobs of a batch by their names, and their classes.
JOBS = {
    "localize": "imgloc.runs.localize:Localize",
    "check": "imgloc.runs.check:Check",
    "which": "imgloc.runs.which:Which",
}


def opened(place: str) -> Any:
    """Return the object at a place, ``module:name``.

    Examples
    --------
    >>> opened(JOBS["check"]).name
    'check'
    """
    module, _, name = place.partition(":")
    return getattr(import_module(module), name)
