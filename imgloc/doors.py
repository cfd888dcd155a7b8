"""Lazy imports of the rooms behind the wall: by name, when they are used.

No room before the wall imports ``plans`` or ``lab``: whoever needs something of theirs asks here.
"""

from importlib import import_module
from typing import Any

_HOME_OF = {
    "survey_part": "imgloc.lab.atlas",
    "aging_hint": "imgloc.lab.changes",
    "GridFilter": "imgloc.lab.grid",
    **dict.fromkeys(("ParticleFilter", "ParticleOptions"), "imgloc.lab.particle"),
}

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


def behind(name: str) -> Any:
    """Return the object of that name from its room behind the wall.

    Examples
    --------
    >>> behind("GridFilter").__module__
    'imgloc.lab.grid'
    """
    return getattr(import_module(_HOME_OF[name]), name)
