"""DXF as strokes: ezdxf unfolds blocks, layers, dashes and widths, as if it drew the model."""

import io
import logging
from collections import Counter
from collections.abc import Iterable
from functools import cache
from typing import Any

import numpy as np
from ezdxf import recover
from ezdxf.addons.acadctb import new_ctb
from ezdxf.addons.drawing.backend import Backend, BkPath2d, BkPoints2d
from ezdxf.addons.drawing.config import Configuration, HatchPolicy, LinePolicy
from ezdxf.addons.drawing.frontend import Frontend
from ezdxf.addons.drawing.properties import RenderContext
from ezdxf.audit import AuditError
from ezdxf.document import Drawing as Drawn
from ezdxf.entities.acis import Body
from ezdxf.entities.dxfentity import DXFEntity, DXFTagStorage
from ezdxf.entities.dxfgfx import DXFGraphic
from ezdxf.entities.insert import Insert
from ezdxf.lldxf.const import DXFError
from ezdxf.math import Vec2

from imgloc.errors import MapError
from imgloc.plans.drawn import role_of
from imgloc.plans.vectors import DEEP, UNITS, Drawing, Stroke, bounded, drawn

logging.getLogger("ezdxf").addHandler(logging.NullHandler())  # what it mends is no news
# Whatever ezdxf makes of a damaged file.
_ODD = DXFError, ValueError, TypeError, LookupError, AttributeError, ArithmeticError, AssertionError
_LINES = 3_000_000  # of a DXF as text, which takes half a minute; a large floor has 200,000
_FINE = 0.003  # of its size, that a line may stay away from its curve
_DRAWN = {
    "LINE", "LWPOLYLINE", "POLYLINE", "MLINE", "ARC", "CIRCLE", "ELLIPSE", "SPLINE", "HATCH",
    "MPOLYGON", "SOLID", "TRACE", "3DFACE", "MESH", "INSERT", "ACAD_PROXY_ENTITY",
}  # fmt: skip
_HOW = Configuration(line_policy=LinePolicy.SOLID, hatch_policy=HatchPolicy.SHOW_SOLID)


def read_dxf(data: bytes) -> Drawing:
    """Read what is drawn in the model of a DXF."""
    for start, what in ((b"AC10", "DWG"), (b"AutoCAD Binary DXF", "binary DXF")):
        if data.startswith(start):
            raise MapError(f"it is a {what}, expected a DXF as text: save it as ASCII DXF")
    if data.count(b"\n") > _LINES:
        raise MapError(f"it has more than {_LINES:,} lines, expected the drawing of a floor")
    if not data.rstrip(b"\r\n \x1a\0").endswith(b"EOF"):
        if b"SECTION" not in data:
            raise MapError("it is no DXF: it has no sections and no EOF")
        raise MapError("the file is cut off: it does not end with EOF; get the whole file")
    try:
        document, audit = recover.read(io.BytesIO(data))
        bounded(_unfold_to(document))
        pen, context = _Pen(), RenderContext(document, ctb=new_ctb())  # whichever it names
        _Unfolded(context, pen, _HOW).draw_layout(document.modelspace())
        bodies = Counter(filter(None, map(_undrawn, document.entitydb.values())))
    except _ODD as error:
        raise MapError(f"it cannot be read as DXF: {' '.join(str(error).split())[:200]}") from None
    files = [b.name for b in document.blocks if b.block is not None and b.block.is_xref]
    lacks = [f"references to {', '.join(files[:3])}, which is not in it: bind it"] if files else []
    absent = sum(fix.code == AuditError.UNDEFINED_BLOCK for fix in audit.fixes)
    lacks += [f"{absent} INSERT of blocks that are not in it: bind them"] if absent else []
    lacks += [f"{n} {what}: explode them to lines" for what, n in bodies.items()]
    if not pen.strokes and any(len(s) > 1 for s in document.layouts if s.is_any_paperspace):
        lacks.append("a layout: draw the floor in the model")
    unit = UNITS.get(document.header.get("$INSUNITS", 0))
    return Drawing(pen.strokes, (unit,) if unit else (), missing=tuple(lacks))


def _undrawn(entity: DXFEntity) -> str:
    """Name and layer of a solid, or of an object of another program, that may be a wall."""
    about = entity.graphic_properties() if isinstance(entity, Body | DXFTagStorage) else {}
    layer = str(about.get("layer", "0"))
    return f"{entity.dxftype()} on {layer}" * (bool(about) and role_of(layer) in ("", "wall"))


def _unfold_to(document: Drawn) -> int:
    """Number of the parts that blocks unfold to, before any is unfolded.

    Examples
    --------
    >>> import ezdxf
    >>> document = ezdxf.new()
    >>> for name, below in ("a", None), ("b", "a"), ("c", "b"):
    ...     for _ in range(10):
    ...         block = document.blocks.get(name) or document.blocks.new(name)
    ...         _ = block.add_blockref(below, (0, 0)) if below else block.add_line((0, 0), (1, 0))
    >>> _ = document.modelspace().add_blockref("c", (0, 0))
    >>> _unfold_to(document)
    1111
    """

    @cache
    def count(name: str, depth: int) -> int:
        if depth > DEEP:
            raise MapError(f"the block {name[:40]} is part of itself, or too deep in others")
        parts = list(document.blocks.get(name) or ()) if depth else list(document.modelspace())
        inserts = [e for e in parts if isinstance(e, Insert)]
        return len(parts) + sum(count(e.dxf.name, depth + 1) * max(1, e.mcount) for e in inserts)

    return count("", 0)


class _Unfolded(Frontend):
    """A model, block by block."""

    def draw_entities(self, entities: Iterable[DXFGraphic], **_: Any) -> None:
        """Draw what may be a part of a building."""
        some = (e for e in entities if e.dxftype() in _DRAWN)
        # Blocks on layers that are off are left out as a whole.
        off = {name for name, layer in self.ctx.layers.items() if not layer.is_visible}
        super().draw_entities(
            e for e in some if not (isinstance(e, Insert) and e.dxf.layer.lower() in off)
        )


class _Pen(Backend):
    """Lines that are drawn, as strokes."""

    def __init__(self) -> None:
        super().__init__()
        self.strokes: list[Stroke] = []

    def _keep(self, points: Iterable[Vec2], *, filled: bool = False) -> None:
        line, (_, own) = np.array([(p.x, p.y) for p in points]), self.entity_stack[-1]
        blocks = [e.dxf.name for e, _ in self.entity_stack if isinstance(e, Insert)]
        bounded(len(self.strokes))
        if drawn(line):
            where, dashed = " / ".join((own.layer, *blocks)), len(own.linetype_pattern) > 1
            self.strokes.append(Stroke(line, where, filled, dashed))

    def draw_line(self, start: Vec2, end: Vec2, _: object) -> None:
        """Keep a line."""
        self._keep((start, end))

    def draw_path(self, path: BkPath2d, _: object) -> None:
        """Keep a curve as straight lines."""
        self._keep(_flat(path))

    def draw_filled_paths(self, paths: Iterable[BkPath2d], _: object) -> None:
        """Keep the edges of an area."""
        for path in paths:
            self._keep(_flat(path), filled=True)

    def draw_filled_polygon(self, points: BkPoints2d, _: object) -> None:
        """Keep the edge of an area."""
        self._keep((*points.vertices(), points.vertices()[0]), filled=True)

    def _left_out(self, *_: Any, **__: Any) -> None:
        """Points, images and colours are no part of a building."""

    draw_point = draw_image = set_background = clear = _left_out


def _flat(path: BkPath2d) -> Iterable[Vec2]:
    """The points of a path."""
    corners = np.array(path.to_tuples())
    if len(corners) < 2 or not np.isfinite(corners).all():
        return ()
    return path.flattening(max(_FINE * float(np.ptp(corners, axis=0).max()), 1e-9), segments=2)
