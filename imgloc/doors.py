"""Doors in the wall: what earlier rooms use of the rooms behind it, by name, when it is used.

No room before the wall imports ``plans`` or ``lab``: whoever needs something of theirs asks here.
"""

from importlib import import_module
from typing import Any

_HOMES = {
    "imgloc.lab.atlas": "survey_part",
    "imgloc.lab.commands.atlas": "atlas",
    "imgloc.lab.commands.calibrate": "calibrate",
    "imgloc.lab.commands.evaluate": "evaluate",
    "imgloc.lab.grid": "GridFilter GridOptions",
    "imgloc.lab.jobs": "evaluate_item survey_item",
    "imgloc.lab.particle": "ParticleFilter ParticleOptions",
    "imgloc.lab.picture": "draw_survey",
    "imgloc.plans.command": "plan",
}
_HOME_OF = {name: module for module, names in _HOMES.items() for name in names.split()}


def behind(name: str) -> Any:
    """Return the object of that name from its room behind the wall.

    Examples
    --------
    >>> behind("plan").__module__
    'imgloc.plans.command'
    """
    return getattr(import_module(_HOME_OF[name]), name)
