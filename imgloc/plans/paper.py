"""Drawings on paper as strokes: SVG and PDF, with curves by svgelements, and pdfium's objects.

Groups, copies, forms, styles and clips are unfolded.
"""

import re
from collections.abc import Iterator, Sequence
from ctypes import c_float, c_int, c_uint, c_ulong, c_ushort
from dataclasses import replace
from functools import lru_cache
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pypdfium2.raw as raw
import svgelements
from ezdxf.math import Vec2
from ezdxf.math.clipping import ClippingRect2d
from pypdfium2 import PdfDocument, PdfiumError
from svgelements import Close, Color, Length, Line, Matrix, Move, Path, Viewbox

from imgloc.errors import MapError
from imgloc.model import FloatArray
from imgloc.plans.building import ENOUGH
from imgloc.plans.vectors import DEEP, MOST, Drawing, Stroke, bounded, drawn

_ALL = np.array([(-np.inf, -np.inf), (np.inf, np.inf)])  # corners of what is not cut
_SCALE = re.compile(r"(?<![\d:.])1 ?[:/] ?(\d{1,4})(?![\d:\"])")
_INCHES = re.compile(r"(?<![\d/])(\d{1,2})(?:/(\d{1,2}))?\" ?= ?(\d{1,3})'")  # on paper, feet
_MM = {"mm": 1.0, "cm": 10.0, "in": 25.4, "pt": 25.4 / 72, "m": 1000.0}
_SHAPES = ("Path", "Line", "Rect", "Polyline", "Polygon", "Circle", "Ellipse")
_SHAPE = re.compile("d|r?[xy]|c[xy]|r|[xy][12]|width|height|points")
_INHERITED = {"fill", "stroke", "stroke-width", "stroke-dasharray", "visibility", "fill-opacity",
              "stroke-opacity"}  # fmt: skip
_NOTHING = re.compile(r"none|[0.]*(%|px|mm)?")  # as a colour, a width, an opacity
_PAGES = 30


def read_svg(data: bytes) -> Drawing:
    """Read what is drawn in an SVG."""
    if re.search(rb"<!(ENTITY|ATTLIST|ELEMENT)", data):
        raise MapError("it declares entities, expected an SVG without them: save it as plain SVG")
    bounded(data.count(b"<") // 4)
    try:
        root = ElementTree.fromstring(data)  # noqa: S314  (without entities it cannot grow)
    except ElementTree.ParseError as error:
        raise MapError(f"it cannot be read as SVG: {error}") from None
    sheets = " ".join("".join(e.itertext()) for e in root.iter() if _tag(e) == "style")
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
        style = style | e.attrib
        classes = [f".{name}" for name in e.get("class", "").split()]
        for name in ("*", tag, *classes, f"#{e.get('id', '')}"):
            style |= styles.get(name, {})
        style |= _rules(e.get("style", ""))
        if style.get("display") == "none" or _NOTHING.fullmatch(style.get("opacity", "1")):
            continue
        try:
            matrix = Matrix(e.get("transform", "")) * matrix
            key = style.pop("clip-path", "").partition("#")[2].rstrip(")\"' "), str(matrix)
            if key[0] in known:
                if key not in cuts:
                    cuts[key] = [
                        point for part in known[key[0]]
                        for s in _shaped(part, Matrix(part.get("transform", "")) * matrix, "", {})
                        for point in s.points
                    ]  # fmt: skip
                    count += len(cuts[key])
                box = _within(box, cuts[key])
            if tag in ("text", "tspan"):
                texts += e.itertext()
            elif tag in ("g", "svg", "a", "switch") or (tag == "symbol" and path):
                label = next((v for k, v in e.items() if k.endswith("}label")), e.get("id", ""))
                layer = f"{label} / {layer}" if layer and label else layer or label
                if tag in ("svg", "symbol") and e is not root:
                    matrix = _view(e, style) * matrix
                inherited = {k: v for k, v in style.items() if k in _INHERITED}
                waiting += [(child, matrix, layer, inherited, path, box) for child in reversed(e)]
            elif tag == "use":
                name = next((v for k, v in e.items() if k.endswith("href")), "").lstrip("#")
                if name in path or len(path) >= DEEP:
                    raise MapError(f"the element {name[:40]} is part of itself")
                place = Matrix(f"translate({e.get('x', 0)},{e.get('y', 0)})") * matrix
                if name in known:
                    waiting.append((known[name], place, layer, style, (*path, name), box))
            else:
                for stroke in _shaped(e, matrix, layer, style):
                    strokes += _clipped(stroke, box)
        except (ValueError, TypeError, ArithmeticError, IndexError, AttributeError) as error:
            raise MapError(f"its element {tag} cannot be read: {str(error)[:80]}") from None
    return Drawing(strokes, _stated(_paper(root), texts), page=True)


def _tag(e: Any) -> str:
    return str(e.tag).rpartition("}")[2]


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


def _view(e: Any, style: dict[str, str]) -> Matrix:
    """Where the parts of an SVG in another are, or of a symbol, which is as large as its use."""
    at = [Length(e.get(key, 0)).value(ppi=96) for key in ("x", "y")]
    own = [float(n) for n in re.findall(r"[-+\d.eE]+", e.get("viewBox", ""))]
    if len(own) != 4:
        return Matrix(f"translate({at[0]},{at[1]})")
    size = [
        Length(style.get(k, "100%")).value(96, own[n]) for n, k in ((2, "width"), (3, "height"))
    ]
    return Matrix(Viewbox.viewbox_transform(*at, *size, *own, e.get("preserveAspectRatio")))


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


def _shaped(e: Any, matrix: Any, layer: str, style: dict[str, str]) -> Iterator[Stroke]:
    """The strokes of one shape of an SVG."""
    kind, fill, seen = _tag(e).capitalize(), style.get("fill", "black"), dict[str, bool]()
    for key in _INHERITED:
        seen[key] = not _NOTHING.fullmatch(style.get(key, "none" if key == "stroke" else "1"))
    stroke = seen["stroke"] and seen["stroke-width"] and seen["stroke-opacity"]
    filled = seen["fill-opacity"] and seen["fill"] and not fill.startswith("url") and _dark(fill)
    if kind not in _SHAPES or not (filled or stroke) or style.get("visibility") == "hidden":
        return
    width = re.match(r"[\d.]+", style.get("stroke-width", "1"))
    wide = float(width[0]) * abs(matrix.determinant) ** 0.5 if width and stroke else 0.0
    dashed = "stroke-dasharray" in style and seen["stroke-dasharray"]
    known = {k: v for k, v in e.items() if _SHAPE.fullmatch(k)}
    shape = getattr(svgelements, "SimpleLine" if kind == "Line" else kind)(known)
    for points in _ways(shape, matrix):
        yield Stroke(points, layer, filled, dashed, wide, not filled and not _dark(style["stroke"]))


def _ways(d: Any, matrix: Any) -> Iterator[FloatArray]:
    """The lines of a path as SVG writes it, or of a shape."""
    points = list[Any]()
    for part in (*abs(Path(d) * matrix), Move(None)):
        if isinstance(part, Move):
            out = np.array(points)
            if drawn(out):
                yield out
            points = [part.end]
        elif isinstance(part, Line | Close):
            points += [part.end] if part.end is not None else []
        else:
            points += part.npoint(np.linspace(0, 1, 13)[1:]).tolist()


def read_pdf(data: bytes) -> Drawing:
    """Read what is drawn on the pages of a PDF, one below the other."""
    try:
        document = PdfDocument(data)
        strokes, texts, low, off = list[Stroke](), list[str](), 0.0, _hidden(data)
        for number in range(min(len(document), _PAGES)):
            page = document[number]
            texts.append(page.get_textpage().get_text_bounded()[:100_000])
            strokes += (s for s in _page(page, low) if s.layer not in off)
            low -= 3 * page.get_height()
            bounded(len(strokes))
    except PdfiumError as error:
        raise MapError(f"it cannot be read as PDF: {error}") from None
    lacks = () if strokes else ("images or text: save it as PNG, of which maps are made, too",)
    unit = re.search(rb"/UserUnit\s*([\d.]+)", data)
    units = _stated(_MM["pt"] / 1000 * float(unit[1] if unit else 1), texts)
    return Drawing(strokes, units, page=True, missing=lacks)


def _page(page: Any, low: float) -> Iterator[Stroke]:
    """The strokes of a page, `low` above where it is."""
    ends, first = np.array(page.get_cropbox()).reshape(2, 2), Matrix()
    first.post_rotate(-np.deg2rad(page.get_rotation()))
    turned = _within(_ALL, [first.point_in_matrix_space(end) for end in ends])
    first.post_translate(*(ends[0] - turned[0] + (0, low)))
    ends = turned + (ends[0] - turned[0] + (0, low))

    @lru_cache(DEEP)
    def frame(obj: Any) -> tuple[Matrix, FloatArray]:
        """Where the parts of an object are, and the box that they are cut to."""
        if obj is None:
            return first, ends
        (outer, box), clip = frame(obj.container), raw.FPDFPageObj_GetClipPath(obj)
        for k in range(raw.FPDFClipPath_CountPaths(clip)):
            n = min(raw.FPDFClipPath_CountPathSegments(clip, k), MOST)
            parts = (raw.FPDFClipPath_GetPathSegment(clip, k, at) for at in range(n))
            corners = [outer.point_in_matrix_space(_point(part)) for part in parts]
            box = _within(box, corners)
        return Matrix(*obj.get_matrix().get()) * outer, box

    for count, obj in enumerate(page.get_objects(max_depth=DEEP)):
        bounded(count)
        if obj.type != raw.FPDF_PAGEOBJ_PATH:
            continue
        mode, drawn, wide = c_int(), c_int(), c_float()
        rgba = [c_uint() for _ in range(4)]
        raw.FPDFPath_GetDrawMode(obj, mode, drawn)
        raw.FPDFPageObj_GetFillColor(obj, *rgba)
        raw.FPDFPageObj_GetStrokeWidth(obj, wide)
        filled = bool(mode.value) and _dark(Color(*(c.value for c in rgba)))
        raw.FPDFPageObj_GetStrokeColor(obj, *rgba)
        pale = bool(drawn.value) and not _dark(Color(*(c.value for c in rgba)))
        dashed = raw.FPDFPageObj_GetDashCount(obj) > 0
        if filled or drawn.value:
            matrix, box = frame(obj)
            width = wide.value * abs(matrix.determinant) ** 0.5 if drawn.value else 0.0
            for points in _ways(_path(obj), matrix):
                stroke = Stroke(points, _layer(obj), filled, dashed, width, pale and not filled)
                yield from _clipped(stroke, box)


def _layer(obj: Any) -> str:
    """The layer that an object is on; empty for none."""
    name, size = (c_ushort * 200)(), c_ulong()
    for k in range(raw.FPDFPageObj_CountMarks(obj)):
        mark = raw.FPDFPageObj_GetMark(obj, k)
        if raw.FPDFPageObjMark_GetParamStringValue(mark, b"Name", name, 400, size):
            return bytes(name)[: size.value].decode("utf-16-le", "replace").rstrip("\0")
    return ""


def _hidden(data: bytes) -> set[str]:
    """Layers of a PDF that are off, if it states them uncompressed."""
    off = re.search(rb"/OFF\s*\[([\d R\s]*)\]", data)
    names = set[str]()
    for number in re.findall(rb"(\d+) \d+ R", off[1] if off else b""):
        name = re.search(rb"\b%s 0 obj[^)]{0,200}?/Name\s*\(([^)]*)\)" % number, data)
        if name:
            wide = name[1].startswith(b"\xfe\xff")
            names.add(name[1].decode("utf-16" if wide else "latin-1", "replace"))
    return names


def _path(obj: Any) -> str:
    """A path of a PDF as SVG writes it."""
    letters = {raw.FPDF_SEGMENT_MOVETO: "M", raw.FPDF_SEGMENT_LINETO: "L"}
    out, curve = list[str](), 0
    for k in range(min(raw.FPDFPath_CountSegments(obj), MOST)):
        segment = raw.FPDFPath_GetPathSegment(obj, k)
        x, y = _point(segment)
        letter = letters.get(raw.FPDFPathSegment_GetType(segment), " " if curve % 3 else "C")
        curve = 0 if letter in "ML" else curve + 1
        out.append(f"{letter}{x:.9g},{y:.9g}")
        out.append("z" if raw.FPDFPathSegment_GetClose(segment) else "")
    return " ".join(out)


def _point(segment: Any) -> tuple[float, float]:
    x, y = c_float(), c_float()
    raw.FPDFPathSegment_GetPoint(segment, x, y)
    return x.value, y.value


def _dark(colour: Any) -> bool:
    """Return whether a colour is neither as light as paper nor lets it through."""
    tone = Color(colour)
    return bool(tone.red + tone.green + tone.blue < ENOUGH * 765 and tone.alpha >= 50)


def _clipped(stroke: Stroke, box: FloatArray) -> Iterator[Stroke]:
    """The parts of a stroke that are in a box, (2, 2) its low and its high corner.

    Examples
    --------
    >>> line = Stroke(np.array([(-1.0, 0.5), (3.0, 0.5)]), "WALL")
    >>> [part.points.tolist() for part in _clipped(line, np.array([(0, 0), (2, 1)]))]
    [[[0.0, 0.5], [2.0, 0.5]]]
    >>> list(_clipped(line, np.array([(0, 0.6), (2, 1)])))
    []
    """
    if (stroke.points >= box[0]).all() and (stroke.points <= box[1]).all():
        yield stroke
    elif (box[0] < box[1]).all():
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
