"""`imgloc map plan` of drawings: DXF, SVG and PDF that the tests write themselves."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import ezdxf
import numpy as np
import pytest
from command import call, rows
from ezdxf.layouts import Modelspace
from ezdxf.xclip import XClip

from imgloc import FloorPlan, MapError, load_map, simulate
from imgloc.plans.drawn import drawing_to_maps, role_of
from imgloc.plans.vectors import MOST, Drawing, Stroke, read_drawing
from tools.plans.drawing import building
from tools.plans.drawings import write_dxf
from tools.plans.measure import AROUND, Row, judge, shares_found

REAL = Path(__file__).resolve().parents[3] / "shared/data/dxf"
# Two rooms of 5 x 4 m, walls of 0.2 m, a door of 0.9 m between them and one of 1.0 m outwards.
WALLS = [
    [(0, 0), (2, 0), (2, 0.2), (0.2, 0.2), (0.2, 4.2), (5.2, 4.2), (5.2, 2.9), (5.4, 2.9),
     (5.4, 4.2), (10.4, 4.2), (10.4, 0.2), (5.4, 0.2), (5.4, 2), (5.2, 2), (5.2, 0.2), (3, 0.2),
     (3, 0), (10.6, 0), (10.6, 4.4), (0, 4.4), (0, 0)],
]  # fmt: skip
HALF = '<g transform="scale(0.5)">{}%s</g>'
# Hinge, radius, first and last degree of the swing, the end at which the leaf is drawn.
SWINGS = [((5.2, 2.9), 0.9, 180, 270, 180), ((2, 0), 1.0, 270, 360, 270)]


def strokes() -> list[tuple[str, list[tuple[float, float]]]]:
    """Lines of the floor by layer, without its arcs, metres."""
    out = [("WALLS", w) for w in WALLS]
    for (x, y), r, _, _, leaf in SWINGS:
        a = np.deg2rad(leaf)
        out.append(("DOORS", [(x, y), (x + r * np.cos(a), y + r * np.sin(a))]))
    for x, y in ((1, 2), (7, 1), (8, 3)):
        table = [(x, y), (x + 1.2, y), (x + 1.2, y + 0.7), (x, y + 0.7), (x, y)]
        out.append(("FURNITURE", table))
    return [*out, ("DIM", [(0, -1), (10.6, -1)]), ("WALLS", [(4, -3), (4, 7.4)])]  # an axis


def dxf(path: Path, unit: float = 0.001, header: int = 4, names: dict[str, str] | None = None,
        shift: tuple[tuple[float, float], ...] = ((0, 0),)) -> Path:  # fmt: skip
    """Write the floor once for each shift, metres, as a DXF of that unit and header."""
    document = ezdxf.new(units=header)
    model = document.modelspace()
    for dx, dy in shift:
        for layer, points in strokes():
            where = {"layer": (names or {}).get(layer, layer)}
            model.add_lwpolyline([((x + dx) / unit, (y + dy) / unit) for x, y in points],
                                 dxfattribs=where)  # fmt: skip
        for (x, y), r, first, last, _ in SWINGS:
            centre = ((x + dx) / unit, (y + dy) / unit)
            where = {"layer": (names or {}).get("DOORS", "DOORS")}
            model.add_arc(centre, r / unit, first, last, dxfattribs=where)
    document.saveas(path)
    return path


def svg(path: Path, scale: str = "Scale 1:100") -> Path:
    """Write the floor as an SVG of paper: 10 mm are a metre."""
    shapes = []
    for layer, points in strokes():
        way = " ".join(f"{x:g},{y:g}" for x, y in points)
        to = 'transform="translate(20,80) scale(10,-10)" stroke-width="0.02"'
        shapes.append(f'<g id="{layer}" {to}><polyline points="{way}"/></g>')
    for (x, y), r, first, last, _ in SWINGS:
        a, b = np.deg2rad([first, last])
        ends = [(20 + 10 * (x + r * np.cos(t)), 80 - 10 * (y + r * np.sin(t))) for t in (a, b)]
        way = "M{},{}A{},{} 0 0 0 {},{}".format(*ends[0], 10 * r, 10 * r, *ends[1])
        shapes.append(f'<path d="{way}" class="d"/>')
    path.write_text(
        '<svg xmlns="http://www.w3.org/2000/svg" width="160mm" height="100mm" '
        'viewBox="0 0 160 100">'
        "<style>.d {stroke: black; fill: none}</style><script>alert(1)</script>"
        f'<g style="fill:none; stroke:#000; stroke-width:0.2">{"".join(shapes)}</g>'
        f'<text x="1" y="9">{scale}</text></svg>'
    )
    return path


def pdf(path: Path, scale: str = "Scale 1:100", page: str = "", off: str = "") -> Path:
    """Write the floor as a PDF of paper: 10 mm are a metre; with layers if one of them is off."""
    at = lambda x, y: f"{(20 + 10 * x) * 72 / 25.4:.4f} {(20 + 10 * y) * 72 / 25.4:.4f}"  # noqa: E731
    lines, layers = ["0.5 w"], ["WALLS", "DOORS", "FURNITURE", "DIM", "OLD WALLS"]
    old = [("OLD WALLS", [(x, 0.2), (x, 4.2)]) for x in (2.0, 2.2) if off]
    for layer, points in strokes() + old:
        line = f"{at(*points[0])} m " + " ".join(f"{at(*p)} l" for p in points[1:]) + " S"
        lines.append(f"/OC /L{layers.index(layer)} BDC {line} EMC" if off else line)
    k = 0.5523
    for (x, y), r, first, _, _ in SWINGS:
        c, s = np.cos(np.deg2rad(first)) * r, np.sin(np.deg2rad(first)) * r
        lines.append(f"{at(x + c, y + s)} m {at(x + c - k * s, y + s + k * c)} "
                     f"{at(x - s + k * c, y + c + k * s)} {at(x - s, y + c)} c S")  # fmt: skip
    lines.append(f"BT /F1 12 Tf 10 10 Td ({scale}) Tj ET")
    stream = "\n".join(lines).encode()
    parts = [
        b"<</Type/Catalog/Pages 2 0 R/OpenAction<</S/JavaScript/JS(app.alert(1))>>"
        b"/OCProperties<</D<</OFF[%d 0 R]>>>>>>" % (layers.index(off or "DIM") + 5),
        b"<</Type/Pages/Kids[3 0 R]/Count 1>>",
        b"<</Type/Page/Parent 2 0 R/MediaBox[0 0 500 300]%s/Contents 4 0 R/Resources<</Font<</F1"
        b"<</Type/Font/Subtype/Type1/BaseFont/NotHere>>>>/Properties<<%s>>>>>>"
        % (page.encode(), b"".join(b"/L%d %d 0 R" % (k, k + 5) for k in range(5))),
        b"<</Length %d>>stream\n%s\nendstream" % (len(stream), stream),
        *(b"<</Type/OCG/Name(%s)>>" % layer.encode() for layer in layers),
    ]
    objects = b"".join(b"%d 0 obj\n%s\nendobj\n" % (n, part) for n, part in enumerate(parts, 1))
    path.write_bytes(b"%PDF-1.4\n" + objects + b"trailer<</Root 1 0 R>>\n%%EOF")
    return path


@pytest.mark.parametrize(
    ("unit", "header", "said"),
    [
        (0.001, 4, "mm as the file states, and 2 doors fit"),
        (1.0, 4, "m, by the widths of 2 doors, and not mm as the file states"),
        (0.0254, 0, "inches, by the widths of 2 doors"),
        (0.01, 6, "cm, by the widths of 2 doors, and not m as the file states"),
    ],
)
def test_the_unit_is_that_of_the_header_if_doors_agree(tmp_path, unit, header, said):
    path = dxf(tmp_path / "a.dxf", unit, header)
    run = call("map", "plan", path, "-o", tmp_path / "a.yaml", "--json").ends(0)
    (row,) = rows(run.out)
    assert row["scale"] == said
    assert row["resolution"] == unit
    assert row["size"] == pytest.approx({"width": 10.6, "height": 4.4}, rel=0.01)
    assert row["rooms"] == 2
    assert row["doors"] == pytest.approx([0.9, 1.0], abs=0.01)
    assert row["free_area"] == pytest.approx(40, abs=1)
    grid = load_map(tmp_path / "a.yaml")
    # The frame is that of the drawing: the middle of the left room, and of its outer wall.
    for (x, y), free, occupied in (((2.7, 2.2), True, False), ((0.1, 2.2), False, True),
                                   ((5.3, 2.4), True, False), ((20, 9), False, False)):  # fmt: skip
        column = int((x - grid.origin.x) / grid.resolution)
        line = int((y - grid.origin.y) / grid.resolution)
        if column < grid.info.width:
            assert (grid.free[line, column], grid.occupied[line, column]) == (free, occupied)


@pytest.mark.parametrize(
    ("write", "page"), [(svg, ()), (pdf, ()), (pdf, ("/Rotate 90",))], ids=["svg", "pdf", "turned"]
)
def test_an_svg_and_a_pdf_have_the_scale_that_is_written_on_them(
    tmp_path: Path, write, page: tuple[str, ...]
) -> None:
    path = write(tmp_path / f"a.{write.__name__}", "Scale 1:100", *page)
    (found,) = drawing_to_maps(read_drawing(path))
    assert ("no name of a layer" in found.doubt) == (write is pdf)
    assert found.scale[1] == "1:100 as the file states, and 2 doors fit"
    assert found.size[:: -1 if page else 1] == pytest.approx((10.6, 4.4), rel=0.01)
    assert (found.rooms, len(found.doors)) == (2, 2)
    occupied = np.rot90(found.grid.occupied, -len(page))
    rows, columns = np.nonzero(occupied)
    middle = columns.min() + round(2.5 / 0.05)  # of the outer door, which is below
    assert occupied[[rows.min() + 2, rows.max() - 2], middle].tolist() == [False, True]
    write(path, "no scale")
    with pytest.raises(MapError, match="its scale is unknown"):
        drawing_to_maps(read_drawing(path))


@pytest.mark.parametrize(
    ("given", "rooms"), [(("/UserUnit 2",), 2), (("", "OLD WALLS"), 2), (("", "DIM"), 3)]
)
def test_a_page_has_a_unit_and_layers(tmp_path: Path, given: tuple[str, ...], rooms: int) -> None:
    path = pdf(tmp_path / "a.pdf", f"Scale 1:{100 if given[0] == '' else 50}", *given)
    (found,) = drawing_to_maps(read_drawing(path))
    assert found.size == pytest.approx((10.6, 4.4), rel=0.01)
    assert (found.rooms, "no name of a layer" in found.doubt) == (rooms, len(given) == 1)


@pytest.mark.parametrize(
    "inner",
    [
        '<svg x="5" y="9" width="80" height="50" viewBox="0 0 160 100">{}</svg>',
        '<symbol id="s" viewBox="0 0 160 100">{}</symbol><use href="#s" width="80" height="50"/>',
        HALF % '<g id="wall" opacity="0" stroke="red"><path d="M40 30V80"/></g>',
        HALF % '<g id="wall" fill-opacity="0" stroke="#fff"><path d="M40 30V80H44z"/></g>',
    ],
)
def test_parts_of_an_svg_are_as_large_as_their_views_and_seen(tmp_path: Path, inner: str) -> None:
    head, _, rest = svg(tmp_path / "a.svg", "Scale 1:200").read_text().partition(">")
    whole = f"{head}>{inner.format(rest.removesuffix('</svg>'))}</svg>"
    (tmp_path / "a.svg").write_text(whole)
    (found,) = drawing_to_maps(read_drawing(tmp_path / "a.svg"))
    assert (found.size, found.rooms) == (pytest.approx((10.6, 4.4), rel=0.01), 2)


def test_doors_are_open_closed_or_unknown_and_furniture_stays_if_asked(tmp_path: Path) -> None:
    drawing = read_drawing(dxf(tmp_path / "a.dxf"))
    maps = {
        how: drawing_to_maps(drawing, doors=how)[0].grid for how in ("open", "closed", "unknown")
    }
    door = slice(*(int((y - maps["open"].origin.y) / 0.05) for y in (2.1, 2.8)))
    column = int((5.2 - maps["open"].origin.x) / 0.05)
    across = slice(column - 2, column + 5)
    assert maps["open"].free[door, across].all()
    assert maps["closed"].occupied[door, across].any(axis=1).all()
    unknown = ~maps["unknown"].free & ~maps["unknown"].occupied
    assert unknown[door, across].any(axis=1).all()
    (kept,) = drawing_to_maps(drawing, furniture=True)
    more = np.count_nonzero(kept.grid.occupied) - np.count_nonzero(maps["open"].occupied)
    assert more > 3 * 3.8 / 0.05 * 0.8


def test_two_floors_in_one_file_are_two_maps(tmp_path: Path) -> None:
    path = dxf(tmp_path / "a.dxf", shift=((0, 0), (0, 8), (40, 3)))
    run = call("map", "plan", path, "-o", tmp_path / "m.yaml", "--json", "--picture",
               tmp_path / "seen.png").ends(0)  # fmt: skip
    assert [Path(row["map"]).name for row in rows(run.out)] == ["m.yaml", "m-2.yaml", "m-3.yaml"]
    corners = {round(load_map(tmp_path / f).origin.x) for f in ("m.yaml", "m-2.yaml", "m-3.yaml")}
    assert corners == {0, 40} or corners == {-1, 39}
    assert (tmp_path / "seen-3.png").is_file()
    out = ("-o", tmp_path / "n.yaml", "--picture", tmp_path / "n-4.png")
    (tmp_path / "n-4-3.png").touch()
    call("map", "plan", path, *out).ends(1, "n-4-3.png: exists already")
    assert not (tmp_path / "n.yaml").exists()


def test_layers_without_names_and_layers_that_are_said(tmp_path: Path) -> None:
    names = {"WALLS": "17", "DOORS": "18", "FURNITURE": "19", "DIM": "20"}
    path = dxf(tmp_path / "a.dxf", names=names)
    (guessed,) = drawing_to_maps(read_drawing(path))
    (said,) = drawing_to_maps(read_drawing(path), walls=["17"])
    assert "no name of a layer tells" in guessed.doubt
    assert said.doubt == ""
    for found in (guessed, said):
        assert found.size[0] == pytest.approx(10.6, abs=0.1)
        assert len(found.doors) == 2
    call("map", "plan", path, "-o", tmp_path / "a.yaml", "--walls", "no such").ends(
        2, "--walls: got no such, expected of the layers 17, 18"
    )


@pytest.mark.parametrize(
    ("name", "role"),
    [
        ("MURATURA sezioni - section wall", "wall"), ("Innenwände", "wall"), ("A-WALL", "wall"),
        ("x$0$墙体", "wall"), ("A-GLAZ", "window"), ("fenêtres", "window"), ("Türen", "door"),
        ("A-DOOR", "door"), ("мебель", "thing"), ("arredi", "thing"), ("quote", "note"),
        ("A-ANNO-DIMS", "note"), ("Treppe", "stairs"), ("0", ""), ("Layer 3", ""),
        ("ΤΟΙΧΟΙ", "wall"), ("أبواب", "door"), ("Ikkunat", "window"), ("ריהוט", "thing"),
        ("Muri portanti", "wall"), ("A-WALL-HEAD", "note"), ("A-WALL / LEVEL 1", "wall"),
        ("A-ANNO / wall tag", "note"), ("TƯỜNG 200", "wall"),
        ("CỬA SỔ", "window"), ("CỬA ĐI", "door"), ("벽체", "wall"),
    ],
)  # fmt: skip
def test_names_in_several_languages(name: str, role: str) -> None:
    assert role_of(name) == role


def changed(folder: Path, change: Callable[[Modelspace], None]) -> list[FloorPlan]:
    """The maps of the floor with more in its drawing."""
    document = ezdxf.readfile(dxf(folder / "whole.dxf"))
    change(document.modelspace())
    document.saveas(folder / "more.dxf")
    return drawing_to_maps(read_drawing(folder / "more.dxf"))


@pytest.mark.parametrize("layer", ["0", "WALLS"])
def test_a_frame_dimensions_and_a_hall_without_doors_are_no_floor(
    tmp_path: Path, layer: str
) -> None:
    ways = [[(x, -1700), (x, 0)] for x in (0, 4000, 10600)] + [[(-300, -1500), (10900, -1500)]]
    ways.append([(-9000, -9000), (30000, -9000), (30000, 20000), (-9000, 20000), (-9000, -9000)])
    for k in (0, 500):  # larger, and to the right
        x, u, v = 50_000 + k, 90_000 - k, 30_000 - k
        ways.append([(x, k), (u, k), (u, v), (x, v), (x, k)])
    at = {"layer": layer}
    (found,) = changed(tmp_path, lambda m: [m.add_lwpolyline(w, dxfattribs=at) for w in ways])
    assert (found.size, found.doubt) == (pytest.approx((10.6, 4.4), abs=0.06), "")


def test_lines_that_are_taken_for_axes_and_end_in_rooms_are_warned_of(tmp_path: Path) -> None:
    at = {"layer": "WALLS"}
    way = [(1500, 3500), (8000, 3500)]
    (found,) = changed(tmp_path, lambda m: [m.add_lwpolyline(way, dxfattribs=at)])
    assert found.rooms == 2
    assert "but end in rooms: 2 ends, at 1.5 3.5, 8.0 3.5 m" in found.doubt


def test_what_a_clipped_block_hides_is_no_floor(tmp_path: Path) -> None:
    document = ezdxf.readfile(dxf(tmp_path / "a.dxf", shift=((0, 0), (40, 0))))
    model, block = document.modelspace(), document.blocks.new("SITE")
    for entity in [*model]:
        model.move_to_layout(entity, block)
    clip = XClip(model.add_blockref("SITE", (0, 0)))
    clip.set_block_clipping_path([(-2000, -2000), (20000, 9000)])
    document.saveas(tmp_path / "clipped.dxf")
    (found,) = drawing_to_maps(read_drawing(tmp_path / "clipped.dxf"))
    assert found.size == pytest.approx((10.6, 4.4), rel=0.01)


def test_walls_across_doors_are_warned_of(tmp_path: Path) -> None:
    at = {"layer": "WALLS"}  # thresholds
    (found,) = changed(tmp_path, lambda m: [
        m.add_lwpolyline(points, dxfattribs=at)
        for points in ([(5200, 2000), (5200, 2900)], [(5400, 2000), (5400, 2900)],
                       [(2000, 0), (3000, 0)], [(2000, 200), (3000, 200)])
    ])  # fmt: skip
    assert "2 of 2 doors are in walls" in found.doubt


def test_a_scale_that_no_door_tells_is_warned_of() -> None:
    lines = [Stroke(np.array(w, float), "WALL") for w in WALLS]
    (found,) = drawing_to_maps(Drawing(lines, ((1.0, "m"),)))
    assert "no door tells whether its scale of 1 metres a unit is right" in found.doubt
    (given,) = drawing_to_maps(Drawing(lines, ()), resolution=1.0)
    assert not given.doubt


def test_lines_are_as_wide_as_they_are_drawn_and_end_where_they_end() -> None:
    ways = [[(0, 0), (8, 0), (8, 6), (0, 6), (0, 0)], [(3, 3), (5, 3)]]
    strokes = [Stroke(np.array(way, float), "wall", wide=0.4) for way in ways]
    (found,) = drawing_to_maps(Drawing(strokes, ()), resolution=1.0)
    assert found.size == pytest.approx((8.4, 6.4), abs=0.04)
    assert found.free_area == pytest.approx(7.6 * 5.6 - 2 * 0.4, abs=0.2)


def test_rules_of_a_style_sheet_add_up(tmp_path: Path) -> None:
    path = tmp_path / "a.svg"
    path.write_text(
        "<svg><style>/* .a {stroke: none} */ .a, .b {fill: none} g .a, rect {stroke: red}</style>"
        '<path class="a" d="M0 0L9 9"/><path class="b" d="M0 0L5 5"/><rect width="2" height="3"/>'
        "</svg>"
    )
    line, area = read_drawing(path).strokes
    assert (line.points[-1].tolist(), line.filled, area.filled) == ([9, -9], False, True)


def hostile(folder: Path) -> dict[str, tuple[bytes, str]]:
    """Inputs that must be refused, by name, and a part of the message."""
    document = ezdxf.new()
    for k in range(9):
        block = document.blocks.new(f"B{k}")
        for _ in range(9):
            block.add_blockref(f"B{k - 1}", (0, 0)) if k else block.add_line((0, 0), (1, 1))
    document.modelspace().add_blockref("B8", (0, 0))
    document.saveas(folder / "bomb")
    cycle = ezdxf.new()
    for name, other in (("A", "C"), ("C", "A")):
        cycle.blocks.new(name).add_blockref(other, (0, 0))
    cycle.modelspace().add_blockref("A", (0, 0))
    cycle.saveas(folder / "cycle")
    whole = dxf(folder / "whole.dxf").read_bytes()
    many = b"  0\nSECTION\n  2\nENTITIES\n" + b"  0\nPOINT\n 10\n1\n" * (3 * MOST + 9)
    use = "".join(f'<g id="u{k}">' + f'<use href="#u{k - 1}"/>' * 10 + "</g>" for k in range(1, 10))
    return {
        "bomb.dxf": ((folder / "bomb").read_bytes(), "unfold to more than"),
        "cycle.dxf": ((folder / "cycle").read_bytes(), "is part of itself"),
        "cut.dxf": (whole[: len(whole) // 2], "the file is cut off"),
        "many.dxf": (many, "lines, expected the drawing of a floor"),
        "no.dxf": (b"hello", "it is no DXF"),
        "dwg.dxf": (b"AC1032" + bytes(99), "it is a DWG"),
        "entities.svg": (b'<!DOCTYPE s [<!ENTITY a "b">]><svg>&a;</svg>', "declares entities"),
        "use.svg": (f'<svg><g id="u0"><path d="M0 0L1 1"/></g>{use}</svg>'.encode(), "unfold to"),
        "self.svg": (b'<svg><g id="a"><use href="#a"/></g></svg>', "is part of itself"),
        "broken.svg": (b"<svg><g>", "cannot be read as SVG"),
        "path.svg": (b'<svg><path d="M0 0 A 1 1"/></svg>', "its element path cannot be read"),
        "w.svg": (b'<svg><rect height="4" stroke="a" transform="scale(1e999)"/></svg>', "no line"),
        "no.pdf": (b"%PDF-1.4 nothing", "cannot be read as PDF"),
        "empty.svg": (b'<svg><script>while(1);</script><image href="file:///etc/passwd"/></svg>',
                      "there is no line on it"),
    }  # fmt: skip


def test_hostile_files_are_one_clear_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("imgloc.plans.vectors.MOST", MOST // 10)  # whose time is a tenth, too
    for name, (data, said) in hostile(tmp_path).items():
        (tmp_path / name).write_bytes(data)
        with pytest.raises(MapError) as caught:
            read_drawing(tmp_path / name)
        assert said in str(caught.value), name
        assert str(caught.value).startswith(str(tmp_path / name))
        assert "\n" not in str(caught.value)


def test_a_drawing_that_encloses_nothing_is_refused() -> None:
    line = Stroke(np.array([(0.0, 0.0), (9.0, 0.0)]), "wall")
    with pytest.raises(MapError, match="its lines enclose no room"):
        drawing_to_maps(Drawing([line], ((1.0, "m"),)))


def test_a_building_becomes_the_map_of_its_walls(tmp_path: Path) -> None:
    truth = building(3)
    write_dxf(truth, tmp_path / "a.dxf")
    (found,) = drawing_to_maps(read_drawing(tmp_path / "a.dxf"))
    assert found.size == pytest.approx(truth.size, abs=0.03)
    assert len(found.doors) == 16
    assert min(shares_found(found.grid, truth)) > 0.99
    # Scans are located among the furniture and the doors that are drawn.
    scans, row = simulate(found.grid.furnished, 6, 1, AROUND), Row("", "")
    judge(found.grid, scans, row, lambda: None)
    assert (row.right, row.wrong) == (6, 0)
    judge(replace(found.grid, movable=None), scans, bare := Row("", ""), lambda: None)
    assert bare.unique < row.unique


@pytest.mark.skipif(not REAL.is_dir(), reason=f"no drawings in {REAL}")
def test_real_drawings_become_maps_of_their_size_or_are_refused() -> None:
    sizes = {
        "schema-ufficio-2": [(17.6, 8.5), (18.8, 8.5)],
        "Aule-scolastiche-pianta-4": [(25.5, 11.3)],
    }
    for name, expected in sizes.items():
        found = drawing_to_maps(read_drawing(REAL / f"{name}.dxf"))
        assert [f.size for f in found] == [pytest.approx(size, rel=0.01) for size in expected]
    for name in ("A-A1-10-01", "A-A2-10-03"):
        with pytest.raises(MapError, match=r"no line on it|cut off"):
            read_drawing(REAL / f"{name}.dxf")


def test_a_door_that_is_in_no_map_is_warned_of(tmp_path: Path) -> None:
    at = {"layer": "DOORS"}  # of a wing without walls that enclose it
    (found,) = changed(tmp_path, lambda m: [
        m.add_lwpolyline([(14000, 0), (14000, 900)], dxfattribs=at),
        m.add_arc((14000, 0), 900, 0, 90, dxfattribs=at),
    ])  # fmt: skip
    assert "doors outside of what was found: 1" in found.doubt


@pytest.mark.parametrize("option", ["--ink 0.5", "--thinnest 0.1", "--memory-budget 1G"])
def test_options_of_images_are_refused_of_drawings(tmp_path: Path, option: str) -> None:
    words = ("map", "plan", dxf(tmp_path / "a.dxf"), "-o", tmp_path / "a.yaml", *option.split())
    call(*words).ends(2, option.split()[0], "expected an image")
