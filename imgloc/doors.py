"""Lazy imports of the rooms behind the wall: by name, when they are used.

No room before the wall imports ``plans`` or ``lab``: whoever needs something of theirs asks here.
"""

from importlib import import_module
from typing import Any

_HOMES = {
    "imgloc.lab.atlas": "survey_part",
    "imgloc.lab.changes": "aging_hint",
    "imgloc.lab.commands.align": "align",
    "imgloc.lab.commands.atlas": "atlas",
    "imgloc.lab.commands.calibrate": "calibrate",
    "imgloc.lab.commands.changes": "changes",
    "imgloc.lab.commands.evaluate": "evaluate",
    "imgloc.lab.grid": "GridFilter GridOptions",
    "imgloc.lab.particle": "ParticleFilter ParticleOptions",
    "imgloc.lab.picture": "draw_aged draw_survey",
    "imgloc.plans.command": "plan",
}
_HOME_OF = {name: module for module, names in _HOMES.items() for name in names.split()}


#: Jobs of a batch by their names, and their classes.
JOBS = {
    "localize": "imgloc.runs.localize:Localize",
    "evaluate": "imgloc.lab.jobs:Evaluate",
    "check": "imgloc.runs.check:Check",
    "which": "imgloc.runs.which:Which",
    "atlas": "imgloc.lab.jobs:Atlas",
    "changes": "imgloc.lab.jobs:Aging",
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


def behind(name: str) -> Any:
    """Return the object of that name from its room behind the wall.

    Examples
    --------
    >>> behind("plan").__module__
    'imgloc.plans.command'
    """
    return getattr(import_module(_HOME_OF[name]), name)
