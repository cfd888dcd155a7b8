"""Drawings of programs, read as strokes: DXF, SVG and PDF.

A stroke is a line of points and what the file states of it: the layer that it is on, the block that
it is part of, whether it is filled or dashed. Whatever else a file may hold is left where it is:
scripts, links, images, fonts. What a file can unfold to is bounded: blocks in blocks, copies, and
entities of entities.
"""

import logging
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from imgloc.errors import ConfigError, MapError
from imgloc.io.files import display, read_file
from imgloc.model import FloatArray

LOG = logging.getLogger("imgloc")

MAX_BYTES = 100_000_000  #: of a file
MOST = 400_000  #: strokes, and entities in the file; a large floor has some 20,000
DEEP = 24  #: blocks within blocks
_ALL = np.array([(-np.inf, -np.inf), (np.inf, np.inf)])  # corners of what is not cut
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
        drawing = READERS[kind](data)
        drawing.strokes[:] = (s for s in drawing.strokes if s.wide < _FAR)  # nor is it NaN
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


def clipped(stroke: Stroke, box: FloatArray) -> Iterator[Stroke]:
    """The parts of a stroke that are in a box, (2, 2) its low and its high corner.

    Examples
    --------
    >>> line = Stroke(np.array([(-1.0, 0.5), (3.0, 0.5)]), "WALL")
    >>> [part.points.tolist() for part in clipped(line, np.array([(0, 0), (2, 1)]))]
    [[[0.0, 0.5], [2.0, 0.5]]]
    >>> list(clipped(line, np.array([(0, 0.6), (2, 1)])))
    []
    """
    if (stroke.points >= box[0]).all() and (stroke.points <= box[1]).all():
        yield stroke
    elif (box[0] < box[1]).all():
        from ezdxf.math import Vec2
        from ezdxf.math.clipping import ClippingRect2d

        rest, way = ClippingRect2d(Vec2(box[0]), Vec2(box[1])), Vec2.list(stroke.points)
        for part in rest.clip_polygon(way) if stroke.filled else rest.clip_polyline(way):
            points = np.array([(p.x, p.y) for p in (*part, *part[: stroke.filled])])
            if drawn(points):
                yield replace(stroke, points=points)


def _within(box: FloatArray, points: Sequence[Any]) -> FloatArray:
    """A box, cut to that around some points; all of it without points."""
    around = np.array([(p[0], p[1]) for p in points] or box)
    low, high = around.min(axis=0), around.max(axis=0)
    return np.array([np.maximum(box[0], low), np.minimum(box[1], high)])


def drawn(points: FloatArray) -> bool:
    """Return whether points are a line that can be drawn: an infinite one cannot."""
    return len(points) > 1 and bool((abs(points) < _FAR).all() and np.ptp(points, axis=0).any())


def _dxf(data: bytes) -> Drawing:
    from imgloc.plans.dxf import read_dxf

    return read_dxf(data)


def bounded(count: int) -> None:
    """Refuse a file whose parts unfold to too many."""
    if count > MOST:
        raise MapError(f"its parts unfold to more than {MOST:,}: a bomb?")


_UNSEEN = {"defs", "clipPath", "mask", "symbol", "pattern", "marker", "script", "style", "image",
           "foreignObject", "metadata", "filter"}  # fmt: skip
_SCALE = re.compile(r"(?<![\d:.])1 ?[:/] ?(\d{1,4})(?![\d:\"])")
_INCHES = re.compile(r"(?<![\d/])(\d{1,2})(?:/(\d{1,2}))?\" ?= ?(\d{1,3})'")  # on paper, feet
_MM = {"mm": 1.0, "cm": 10.0, "in": 25.4, "pt": 25.4 / 72, "m": 1000.0}
_SHAPE = re.compile("d|r?[xy]|c[xy]|r|[xy][12]|width|height|points")
_INHERITED = {"fill", "stroke", "stroke-width", "stroke-dasharray", "visibility"}
_PAGES = 30  # of a PDF
_WHITE = 0.8  # an area as light hides what is under it, and is none of the building


def _svg(data: bytes) -> Drawing:
    from xml.etree import ElementTree

    from svgelements import Matrix

    if re.search(rb"<!(ENTITY|ATTLIST|ELEMENT)", data):
        raise MapError("it declares entities, expected an SVG without them: save it as plain SVG")
    if data.count(b"<") > 4 * MOST:
        raise MapError(f"it has more than {2 * MOST:,} elements, expected the drawing of a floor")
    try:
        root = ElementTree.fromstring(data)  # noqa: S314  (without entities it cannot grow)
    except ElementTree.ParseError as error:
        raise MapError(f"it cannot be read as SVG: {error}") from None
    sheets = " ".join("".join(e.itertext()) for e in root.iter() if str(e.tag).endswith("style"))
    styles = _styles(sheets[:1_000_000])
    known = {e.get("id"): e for e in root.iter() if e.get("id")}
    strokes, texts, cuts, count = list[Stroke](), list[str](), dict[tuple[str, str], Any](), 0
    waiting: list[tuple[Any, Any, str, dict[str, str], tuple[str, ...], FloatArray]]
    waiting = [(root, Matrix("scale(1,-1)"), "", {}, (), _ALL)]
    while waiting:
        e, matrix, layer, style, path, box = waiting.pop()
        count += 1
        bounded(max(count, len(strokes)))
        tag = _tag(e)
        style = style | dict(e.attrib)
        classes = [f".{name}" for name in e.get("class", "").split()]
        for name in ("*", tag, *classes, f"#{e.get('id', '')}"):
            style |= styles.get(name, {})
        style |= _rules(e.get("style", ""))
        if (tag in _UNSEEN and not (tag == "symbol" and path)) or style.get("display") == "none":
            continue
        if tag in ("text", "tspan"):
            texts += e.itertext()
            continue
        try:
            matrix = Matrix(e.get("transform", "")) * matrix
            key = style.pop("clip-path", "").partition("#")[2].rstrip(")\"' "), str(matrix)
            if key[0] in known:
                if key not in cuts:
                    cuts[key] = [point for s in _cut(known[key[0]], matrix) for point in s.points]
                    count += len(cuts[key])
                box = _within(box, cuts[key])
            label = next((v for k, v in e.items() if k.endswith("}label")), e.get("id", ""))
            if tag in ("g", "svg", "a", "symbol", "switch"):
                layer = f"{label} / {layer}" if layer and label else layer or label
            elif tag == "use":
                name = next((v for k, v in e.items() if k.endswith("href")), "").lstrip("#")
                if name in path or len(path) >= DEEP:
                    raise MapError(f"the element {name[:40]} is part of itself")
                place = Matrix(f"translate({e.get('x', 0)},{e.get('y', 0)})")
                if name in known:
                    waiting.append((known[name], place * matrix, layer, style, (*path, name), box))
                continue
            inherited = {k: v for k, v in style.items() if k in _INHERITED}
            waiting += [(child, matrix, layer, inherited, path, box) for child in reversed(e)]
            shapes = _shaped(e, tag, matrix, layer, style)
            strokes += [part for stroke in shapes for part in clipped(stroke, box)]
        except (ValueError, TypeError, ArithmeticError, IndexError, AttributeError) as error:
            raise MapError(f"its element {tag} cannot be read: {str(error)[:80]}") from None
    return Drawing(strokes, _stated(_paper(root), texts), page=True)


def _paper(root: Any) -> float:
    """Metres on paper of a unit of an SVG; 0 if it is not stated."""
    sides = (
        re.fullmatch(r"\s*([\d.]+)\s*(mm|cm|in|pt|m)\s*", root.get(key, ""))
        for key in ("width", "height")
    )
    box = re.findall(r"[-+\d.eE]+", root.get("viewBox", ""))
    units = [
        float(side[1]) * _MM[side[2]] / float(whole) / 1000
        for side, whole in zip(sides, box[2:], strict=False)
        if side and float(whole) > 0
    ]
    return min(units, default=0.0)  # a page of another shape than its box has margins


def _styles(sheet: str) -> dict[str, dict[str, str]]:
    """Properties by `tag`, `.class` and `#id`, the last part of each selector."""
    out = dict[str, dict[str, str]]()
    for rule in re.sub(r"(?s)/\*.*?(\*/|$)", " ", sheet).split("}"):  # without comments
        selectors, _, rules = rule.rpartition("{")
        for selector in selectors.split(","):
            if last := re.search(r"([.#]?[\w-]+|\*)$", selector.rstrip()[-99:]):
                out.setdefault(last[1], {}).update(_rules(rules))
    return out


def _rules(text: str) -> dict[str, str]:
    """Properties in a style, by their names."""
    return dict(re.findall(r"([\w-]+)\s*:\s*([^;]*[^;\s])", text))


def _shaped(e: Any, tag: str, matrix: Any, layer: str, style: dict[str, str]) -> Iterator[Stroke]:
    """The strokes of one shape of an SVG."""
    import svgelements

    kind = {"line": "SimpleLine"}.get(tag, tag.capitalize())
    if kind not in ("Path", "SimpleLine", "Rect", "Polyline", "Polygon", "Circle", "Ellipse"):
        return
    shape = getattr(svgelements, kind)({k: v for k, v in e.items() if _SHAPE.fullmatch(k)})
    fill = style.get("fill", "black")
    tone = None if fill == "none" or fill.startswith("url") else svgelements.Color(fill)
    filled = tone is not None and tone.red + tone.green + tone.blue < _WHITE * 765
    drawn = style.get("stroke", "none") != "none"
    if not (filled or drawn) or style.get("visibility") == "hidden":
        return
    width = re.match(r"[\d.]+", style.get("stroke-width", "1"))
    wide = float(width[0]) * abs(matrix.determinant) ** 0.5 if width and drawn else 0.0
    dashed = style.get("stroke-dasharray", "none") not in ("none", "0", "")
    for points in _ways(shape, matrix):
        yield Stroke(points, layer, filled, dashed, wide)


def _cut(clip: Any, matrix: Any) -> Iterator[Stroke]:
    """The lines of what others are cut to."""
    from svgelements import Matrix

    for part in clip:
        at = Matrix(part.get("transform", "")) * matrix
        yield from _shaped(part, _tag(part), at, "", {"fill": "none", "stroke": "black"})


def _tag(e: Any) -> str:
    return str(e.tag).rpartition("}")[2]


def _ways(d: Any, matrix: Any) -> Iterator[FloatArray]:
    """The lines of a path as SVG writes it, or of a shape."""
    from svgelements import Close, Line, Move, Path

    points = list[Any]()
    for part in (*abs(Path(d) * matrix), None):
        if part is None or isinstance(part, Move):
            out = np.array(points)
            if drawn(out):
                yield out
            points = [] if part is None else [tuple(part.end)]
        elif isinstance(part, Line | Close):
            points += [tuple(part.end)] if part.end is not None else []
        else:
            points += part.npoint(np.linspace(0, 1, 13)[1:]).tolist()


def _stated(paper: float, texts: Sequence[str]) -> tuple[tuple[float, str], ...]:
    """Metres of a unit by each of the scales in texts, and at full size; on paper it is `paper`."""
    text = re.sub("[\u201d\u2033]|''", '"', re.sub("[\u2019\u2032]", "'", " ".join(texts)))
    scales = [float(n) for n in _SCALE.findall(text) if int(n) >= 5]
    scales += [
        12 * int(feet) * int(parts or 1) / int(n)
        for n, parts, feet in _INCHES.findall(text)
        if int(n)
    ]
    return tuple((paper * n, f"1:{n:g}") for n in (*dict.fromkeys(scales), 1) if paper > 0)


def _pdf(data: bytes) -> Drawing:
    import pypdfium2
    import pypdfium2.raw as raw

    try:
        document = pypdfium2.PdfDocument(data)
        strokes, texts, low = list[Stroke](), list[str](), 0.0
        for number in range(min(len(document), _PAGES)):
            page = document[number]
            texts.append(page.get_textpage().get_text_bounded()[:100_000])
            strokes += _page(raw, page, low)
            low -= 3 * page.get_height()
            bounded(len(strokes))
    except pypdfium2.PdfiumError as error:
        raise MapError(f"it cannot be read as PDF: {error}") from None
    lacks = () if strokes else ("images or text: save it as PNG, of which maps are made, too",)
    return Drawing(strokes, _stated(_MM["pt"] / 1000, texts), page=True, missing=lacks)


def _page(raw: Any, page: Any, low: float) -> Iterator[Stroke]:
    """The strokes of a page of a PDF, `low` above where it is."""
    from ctypes import c_float, c_int, c_uint

    from svgelements import Matrix

    first, count = Matrix(f"translate(0,{low})"), 0
    n, ends = raw.FPDFPage_CountObjects(page.raw), np.array(page.get_cropbox()).reshape(2, 2)
    waiting = [(raw.FPDFPage_GetObject(page.raw, k), first, 0, ends + (0, low)) for k in range(n)]
    while waiting:
        obj, outer, deep, box = waiting.pop()
        count += 1
        bounded(count)
        m, kind = raw.FS_MATRIX(), raw.FPDFPageObj_GetType(obj)
        clip = raw.FPDFPageObj_GetClipPath(obj)
        for k in range(raw.FPDFClipPath_CountPaths(clip)):
            n = min(raw.FPDFClipPath_CountPathSegments(clip, k), MOST)
            parts = (raw.FPDFClipPath_GetPathSegment(clip, k, at) for at in range(n))
            box = _within(box, [outer.point_in_matrix_space(_point(raw, part)) for part in parts])
        raw.FPDFPageObj_GetMatrix(obj, m)
        matrix = Matrix(m.a, m.b, m.c, m.d, m.e, m.f) * outer
        if kind == raw.FPDF_PAGEOBJ_FORM and deep < DEEP:
            n = raw.FPDFFormObj_CountObjects(obj)
            objects = (raw.FPDFFormObj_GetObject(obj, k) for k in range(n))
            waiting += [(inner, matrix, deep + 1, box) for inner in objects]
        elif kind == raw.FPDF_PAGEOBJ_PATH:
            mode, drawn, wide = c_int(), c_int(), c_float()
            rgba = [c_uint() for _ in range(4)]
            raw.FPDFPath_GetDrawMode(obj, mode, drawn)
            raw.FPDFPageObj_GetFillColor(obj, *rgba)
            raw.FPDFPageObj_GetStrokeWidth(obj, wide)
            light = sum(c.value for c in rgba[:3]) >= _WHITE * 765 or rgba[3].value < 50
            filled, dashed = bool(mode.value) and not light, raw.FPDFPageObj_GetDashCount(obj) > 0
            width = wide.value * abs(matrix.determinant) ** 0.5 if drawn.value else 0.0
            if filled or drawn.value:
                for points in _ways(_path(raw, obj), matrix):
                    yield from clipped(Stroke(points, "", filled, dashed, width), box)


def _path(raw: Any, obj: Any) -> str:
    """A path of a PDF as SVG writes it."""
    letters = {raw.FPDF_SEGMENT_MOVETO: "M", raw.FPDF_SEGMENT_LINETO: "L"}
    out, curve = list[str](), 0
    for k in range(min(raw.FPDFPath_CountSegments(obj), MOST)):
        segment = raw.FPDFPath_GetPathSegment(obj, k)
        x, y = _point(raw, segment)
        letter = letters.get(raw.FPDFPathSegment_GetType(segment), " " if curve % 3 else "C")
        curve = 0 if letter in "ML" else curve + 1
        out.append(f"{letter}{x:.9g},{y:.9g}")
        out.append("z" if raw.FPDFPathSegment_GetClose(segment) else "")
    return " ".join(out)


def _point(raw: Any, segment: Any) -> tuple[float, float]:
    from ctypes import c_float

    x, y = c_float(), c_float()
    raw.FPDFPathSegment_GetPoint(segment, x, y)
    return x.value, y.value


READERS: dict[str, Callable[[bytes], Drawing]] = {".dxf": _dxf, ".svg": _svg, ".pdf": _pdf}
"""What reads a file, by the end of its name."""
