"""Drawings of programs, read as strokes: DXF, SVG and PDF.

A stroke is a line of points and what the file states of it: the layer that it is on, the block that
it is part of, whether it is filled or dashed. Whatever else a file may hold is left where it is:
scripts, links, images, fonts. What a file can unfold to is bounded: blocks in blocks, copies, and
entities of entities.
"""

import logging
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from imgloc.doors import opened
from imgloc.errors import ConfigError, MapError
from imgloc.io.files import display, read_file
from imgloc.model import FloatArray

LOG = logging.getLogger("imgloc")

MAX_BYTES = 100_000_000  #: of a file
MOST = 400_000  #: strokes, and entities in the file; a large floor has some 20,000
DEEP = 24  #: blocks within blocks
_FAR = 1e10  # units from the zero point: nothing that is built is farther away
#: metres of the units of a DXF and their names, by the number in its header
UNITS = {
    1: (0.0254, "inches"), 2: (0.3048, "feet"), 4: (0.001, "mm"), 5: (0.01, "cm"), 6: (1.0, "m"),
    10: (0.9144, "yards"), 14: (0.1, "dm"), 21: (0.3048, "feet"),
}  # fmt: skip
NAMES = dict(UNITS.values())


@dataclass(frozen=True, eq=False)
class Stroke:
    """A line of points as a file has it, with straight lines between them."""

    points: FloatArray  #: (N, 2), in the units of the file, y up
    layer: str  #: and the names of the blocks that it is part of
    filled: bool = False  #: it is the edge of an area
    dashed: bool = False
    wide: float = 0.0  #: in the units of the file, if it is a line with a width of its own
    pale: bool = False  #: it is as light as paper


@dataclass(frozen=True, eq=False)
class Drawing:
    """The lines of a file, and its units."""

    strokes: list[Stroke]
    #: metres that a unit may be as the file states it, the most likely first; and what states it
    units: tuple[tuple[float, str], ...]
    page: bool = False  #: its units are those of paper: a scale that is not stated cannot be found
    missing: tuple[str, ...] = ()  #: what it has and imgloc cannot draw, and what to do


def read_drawing(path: Path) -> Drawing:
    """Read a DXF, SVG or PDF.

    Raises
    ------
    MapError
        If the file is missing, damaged, cut off, too large, or has no lines.
    ConfigError
        If what reads such files is not installed.
    """
    name, kind = display(path), path.suffix.lower()
    data = read_file(path, limit=MAX_BYTES, error=MapError, what="drawing")
    try:
        drawing: Drawing = opened(READERS[kind])(data)
        some = [s for s in drawing.strokes if s.wide < _FAR]  # nor is it NaN
        dark = [s for s in some if not s.pale]
        drawing.strokes[:] = dark if 2 * len(dark) > len(some) else some  # light on dark
    except ImportError as error:
        need = f"{name}: {kind[1:].upper()} needs {error.name}: pip install 'imgloc[cad]'"
        raise ConfigError(need) from None
    except MapError as error:
        raise MapError(f"{name}: {error}") from None
    except RecursionError:
        raise MapError(f"{name}: its parts are nested too deeply to be read") from None
    lacks = "; ".join(drawing.missing[:3])
    if not drawing.strokes:
        why = f"; it has only {lacks}" if lacks else ""
        raise MapError(f"{name}: there is no line on it, expected the drawing of a floor{why}")
    if lacks:
        LOG.warning("%s: left out: %s", name, lacks)
    return drawing


def drawn(points: FloatArray) -> bool:
    """Return whether points are a line that can be drawn: an infinite one cannot."""
    return len(points) > 1 and bool((abs(points) < _FAR).all() and np.ptp(points, axis=0).any())


def bounded(count: int) -> None:
    """Refuse a file whose parts unfold to too many."""
    if count > MOST:
        raise MapError(f"its parts unfold to more than {MOST:,}: a bomb?")


READERS = {
    ".dxf": "imgloc.plans.dxf:read_dxf",
    ".svg": "imgloc.plans.paper:read_svg",
    ".pdf": "imgloc.plans.paper:read_pdf",
}
"""What reads a file, by the end of its name."""
