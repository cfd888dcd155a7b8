"""Pictures and page of an explanation: right places, right words, nothing from outside."""

import base64
import re
import xml.etree.ElementTree as ET
from dataclasses import replace
from html.parser import HTMLParser

import cv2
import numpy as np
import pytest
from places import answer_of, features_of, room_with_a_post, scan_of

from imgloc import Hypothesis, LaserScan, OccupancyGrid, Options, Pose2D, explain, localize, prepare
from imgloc.answers.explain import KINDS, RayFit
from imgloc.output.canvas import INK, PAPER, SHADE
from imgloc.output.pages import DRAWN, HEADLINES, render_explanation
from imgloc.output.pictures import draw_likelihood
from imgloc.output.svg import View, draw_covariance, draw_rays, draw_scan, macro, map_image, window

VOID = {"meta", "img", "br"}
LOOSE = {"p", "li", "td", "th", "tr", "dt", "dd"}  # HTML closes them by itself


class Page(HTMLParser):
    """What a page is made of, and whether every element is closed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open, self.tags, self.sources, self.words = [], [], [], []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.sources += [
            v for k, v in attrs if k in ("src", "href", "xlink:href", "data", "action")
        ]
        if tag not in VOID | LOOSE:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in VOID | LOOSE:
            self.open.pop()

    def handle_endtag(self, tag):
        if tag not in LOOSE:
            assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())


def fit_of(*rays: tuple[str, float, float, float]) -> RayFit:
    kinds, x, y, wall = zip(*rays, strict=True)
    return RayFit(np.array(kinds), np.column_stack((x, y)), np.array(wall, np.float32))


def hypothesis(x=1.0, y=1.0, theta=0.0, covariance=None):
    matrix = np.diag([1e-4, 4e-4, 1e-3]) if covariance is None else covariance
    return Hypothesis(Pose2D(x, y, theta), -1.0, 0.5, matrix)


def page_of(features, scan, options=None, **more) -> tuple[str, Page]:
    options = options or Options()
    why = explain(features, scan, localize(features, scan, options), options)
    text = render_explanation(why, more.pop("title", "a title"), **more)
    return text, Page(text)


def numbers_of(d: str) -> list[float]:
    return [float(v) for v in re.findall(r"-?\d+\.?\d*", d)]


def png_of(image: ET.Element) -> np.ndarray:
    data = base64.b64decode(image.get("href").split(",")[1])
    return cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)


def test_up_in_the_map_is_up_in_the_picture() -> None:
    occupied = np.array([[1, 0, 0], [0, 0, 0]], dtype=bool)
    free = np.array([[0, 1, 0], [1, 1, 0]], dtype=bool)
    view = View(0.0, 0.0, 3.0, 2.0, 300.0)
    image = ET.fromstring(map_image(OccupancyGrid(occupied, free, 1.0), view))
    assert png_of(image).tolist() == [[[*PAPER], [*PAPER], [*SHADE]], [[*INK], [*PAPER], [*SHADE]]]
    assert map_image(OccupancyGrid(occupied, free, 1.0), View(4.0, 0.0, 3.0, 2.0, 300.0)) == ""


def test_a_thin_wall_is_still_there_when_a_map_is_large() -> None:
    wall = np.zeros((20, 6000), dtype=bool)
    wall[:, 3001] = True
    image = ET.fromstring(
        map_image(OccupancyGrid(wall, ~wall, 0.1), View(0.0, 0.0, 600.0, 2.0, 6000.0))
    )
    png = png_of(image)
    assert png.shape[1] <= 1400
    (column,) = np.flatnonzero((png == INK).all(axis=2).all(axis=0))
    width = float(image.get("width"))
    assert abs((column + 0.5) * width / png.shape[1] - 3001.5) < 5


def test_the_image_of_a_map_is_cut_to_the_view_and_put_in_its_place() -> None:
    grid = room_with_a_post()  # 4.4 by 3.4 m
    view = View(-1.0, 2.0, 2.0, 2.0, 200.0)
    image = ET.fromstring(map_image(grid, view))
    at = {k: float(image.get(k)) for k in ("x", "y", "width", "height")}
    # From x = 0 to 1 m and y = 2 to 3.4 m.
    assert at == {"x": 100, "y": 60, "width": 100, "height": 140}
    png = png_of(image)
    assert png.shape == (14, 10, 3)
    assert png[0, 5].tolist() == [*INK]  # the upper wall
    assert png[-1, 0].tolist() == [*INK]  # the left wall
    assert png[-1, -1].tolist() == [*PAPER]
    assert map_image(grid, View(10.0, 10.0, 2.0, 2.0, 200.0)) == ""


@pytest.mark.parametrize(("width", "label", "px"), [(20, "5 m", 50), (3, "50 cm", 100 / 3)])
def test_the_bar_is_as_long_as_it_says(width: float, label: str, px: float) -> None:
    bar = ET.fromstring(macro("rule", view=View(0, 0, width, width, 200.0)))
    assert bar.find("text").text == label
    length = float(re.search(r"h(\d+\.?\d*)", bar.find("path").get("d"))[1])
    assert length == pytest.approx(px, abs=0.06)


def test_each_ray_is_drawn_in_its_kind_and_place() -> None:
    grid, view = room_with_a_post(), View(0.0, 0.0, 4.0, 4.0, 400.0)
    fit = fit_of(
        ("agrees", 2.0, 1.0, np.inf),
        ("visibility", 3.0, 1.0, 0.5),
        ("no_return", np.nan, np.nan, np.inf),
    )
    root = ET.fromstring(draw_rays(grid, Pose2D(1.0, 1.0), fit, view, "1"))
    paths = {p.get("class"): p.get("d") for p in root.iter("path") if p.get("class")}
    assert numbers_of(paths["ray agrees"]) == [100, 300, 200, 300]
    assert numbers_of(paths["ray visibility"]) == [100, 300, 300, 300]
    assert numbers_of(paths["beyond"]) == [150, 300, 300, 300]  # from the wall to the end
    assert paths["end agrees"].startswith("M200 300")
    assert paths["end unexplained"] == ""
    assert not any("no_return" in name for name in paths)
    assert "1 agrees" in root.get("aria-label")


def test_marks_differ_in_shape_and_not_only_in_colour() -> None:
    shapes = {re.sub('class="[^"]*"', "", macro("swatch", kind=kind)) for kind in KINDS}
    assert len(shapes) == 5  # four marks; what is only counted has a box


def test_views_have_one_size_and_hold_pose_and_rays() -> None:
    fits = [fit_of(("agrees", 3, 1, np.inf)), fit_of(("agrees", 1, 9, np.inf))]
    poses = [Pose2D(1, 1), Pose2D(1, 1)]
    views = window(poses, fits, 100.0)
    assert (views[0].px, views[0].tall) == (views[1].px, views[1].tall)
    for view, fit in zip(views, fits, strict=True):
        for x, y in [(1, 1), *fit.end.tolist()]:
            assert 0 < x - view.x < view.width
            assert 0 < y - view.y < view.height
    stray = fit_of(("agrees", 3, 1, np.inf), ("agrees", 500, 1, np.inf))
    assert window(poses[:1], [stray], 100.0)[0].width < 10


def test_the_ellipse_is_two_standard_deviations_long() -> None:
    root = ET.fromstring(draw_covariance(hypothesis(theta=0.3)))
    outline = {
        p.get("class"): np.array(numbers_of(p.get("d"))).reshape(-1, 2)
        for p in root.iter("path")
        if p.get("class")
    }
    size = {name: np.ptp(outline[name], axis=0) for name in ("one", "two")}
    np.testing.assert_allclose(size["two"], 2 * size["one"], atol=0.3)
    np.testing.assert_allclose(size["one"][1] / size["one"][0], 2.0, atol=0.01)  # 2 cm and 1 cm
    degenerate = draw_covariance(hypothesis(covariance=np.zeros((3, 3))))
    assert "nan" not in degenerate


def test_a_scan_is_drawn_with_forward_up_and_left_at_the_left() -> None:
    scan = LaserScan([2.0, 1.0, np.inf], [0.0, np.pi / 2, -0.5], range_max=9.0)
    root = ET.fromstring(draw_scan(scan))
    at = {p.get("class"): numbers_of(p.get("d")) for p in root.iter("path") if p.get("class")}
    robot = next(g for g in root.iter("g") if (g.get("class") or "").startswith("robot"))
    x, y = numbers_of(robot.get("transform"))
    ahead, left = np.array(at["end agrees"]).reshape(-1, 3)[:, :2] - (x, y)
    assert ahead[0] == pytest.approx(0, abs=0.2)
    assert left[1] == pytest.approx(0, abs=0.2)
    assert ahead[1] == pytest.approx(2 * left[0], abs=0.3)
    assert ahead[1] < 0
    assert len(at["end no_return"]) == 4
    assert "nan" not in draw_scan(LaserScan([np.nan], [0.0]))


def test_the_bar_of_shares_is_full() -> None:
    fit = fit_of(*[("agrees", 0, 0, np.inf)] * 3, ("no_return", np.nan, np.nan, np.inf))
    boxes = [
        (r.get("class"), float(r.get("width")))
        for r in ET.fromstring(macro("share_bar", counts=fit.counts))
    ]
    assert [name for name, _ in boxes] == list(KINDS)
    assert dict(boxes)["agrees"] == 75
    assert sum(width for _, width in boxes) == pytest.approx(100)


@pytest.fixture(scope="module")
def why():
    return explain(
        features_of("visibility"), scan_of("visibility"), answer_of("visibility", "fused")
    )


@pytest.fixture(scope="module")
def text(why) -> str:
    return render_explanation(why, "scan 0", version="9.9")


@pytest.fixture(scope="module")
def page(text) -> Page:
    return Page(text)


def test_the_page_needs_nothing_from_outside(why, text, page) -> None:
    assert page.open == []
    assert "script" not in page.tags
    assert "link" not in page.tags
    assert len(page.sources) >= 2 + len(why.fits)
    assert all(source.startswith("data:image/png;base64,") for source in page.sources)
    assert not re.search(r"https?:|url\(|@import", text)
    for svg in re.findall(r"<svg.*?</svg>", text):
        ET.fromstring(svg)
    assert "imgloc 9.9" in page.text


def test_the_page_says_what_the_answer_says(why, page) -> None:
    assert HEADLINES[why.answer.verdict] in page.text
    assert page.tags.count("figure") >= 2 * len(why.fits) + 3
    for fit in why.fits:
        for kind, n in fit.rays.counts.items():
            if n and kind == "agrees":
                assert f"ends on a wall {n} " in page.text
    assert f"Misfit {why.answer.evidence.misfit:.3f} nats per reading." in page.text
    assert f"Temperature {why.answer.evidence.temperature.value:.2f}" in page.text
    margin = why.fits[0].hypothesis.log_likelihood - why.fits[1].hypothesis.log_likelihood
    assert f"the second is {margin:.1f} nats behind" in page.text
    assert page.text.count("this decides") == 1
    assert "fused.model.hit 0.8" in page.text


def test_of_many_hypotheses_the_first_are_drawn_and_all_are_in_the_table(why) -> None:
    many = replace(why, fits=why.fits[:1] * (DRAWN + 3))
    page = Page(render_explanation(many, "x"))
    assert f"The first {DRAWN} of {DRAWN + 3} are drawn" in page.text
    figures, rows = page.tags.count("figure"), page.tags.count("tr")
    fewer = Page(render_explanation(replace(many, fits=many.fits[:DRAWN]), "x"))
    assert "are drawn" not in fewer.text
    assert fewer.tags.count("figure") == figures
    assert rows == fewer.tags.count("tr") + 3


@pytest.mark.parametrize("cell", [None, 1.25])
def test_the_temperature_on_the_page_is_the_product_of_its_terms(why, cell) -> None:
    evidence = why.answer.evidence
    if cell:
        t = replace(evidence.temperature, cell=cell)
        evidence = replace(evidence, temperature=t)
    page = render_explanation(replace(why, answer=replace(why.answer, evidence=evidence)), "x")
    number = r"([\d.]+)"
    found = re.search(
        rf"Temperature {number} = \({number} \+ {number} × {number} that these lack\)"
        rf" × {number} \(√ of readings / 100\) × {number} \(cells of the map\)",
        Page(page).text,
    )
    value, base, strain, lacks, many, factor = map(float, found.groups())
    assert factor == (cell or 1.0)  # that of this scan is 1
    assert value == pytest.approx(evidence.temperature.value, abs=0.006)
    assert (base + strain * lacks) * many * factor == pytest.approx(value, abs=0.006)
    if not cell:  # and it is what the masses were made with
        best, second = (fit.hypothesis for fit in why.fits[:2])
        margin = best.log_likelihood - second.log_likelihood
        assert np.log(best.mass / second.mass) == pytest.approx(margin / value, rel=0.01)


def test_what_is_not_listed_is_on_the_page(why) -> None:
    def text_of(**counts):
        evidence = replace(why.answer.evidence, **counts)
        shown = replace(why, answer=replace(why.answer, evidence=evidence))
        return Page(render_explanation(shown, "x")).text

    said = "9 poses were found. Those that the table leaves out hold 10 % together."
    assert said in text_of(found=9, listed=2, unlisted=0.1)
    assert "poses were found" not in text_of(found=2, listed=2)


def test_the_log_odds_on_the_page_are_those_of_elsewhere(why, page) -> None:
    found = re.search(r"Log-odds .*? = (−?[\d.]+)\.", page.text)
    odds = np.log(why.answer.elsewhere / (1 - why.answer.elsewhere))
    assert float(found[1].replace("−", "-")) == pytest.approx(odds, abs=0.006)


def test_deviations_are_along_and_across_the_heading(why) -> None:
    # 30 cm along 45 degrees, 1 cm across.
    c = np.sqrt(0.5)
    turn = np.array([[c, -c, 0], [c, c, 0], [0, 0, 1]])
    matrix = turn @ np.diag([0.09, 1e-4, 1e-4]) @ turn.T
    fit = replace(why.fits[0], hypothesis=hypothesis(theta=np.pi / 4, covariance=matrix))
    text = Page(render_explanation(replace(why, fits=(fit,)), "x")).text
    assert "± 30.0 cm along, ± 1.0 cm across its heading, ± 0.57°" in text


def test_names_are_text_and_not_html(why) -> None:
    evil = '<script>alert("1")</script> & <b>'
    text = render_explanation(why, evil, version=evil)
    page = Page(text)
    assert "script" not in page.tags
    assert page.text.count(evil) == 3  # title twice, the version


def test_too_few_readings_are_explained() -> None:
    ranges = np.full(20, np.nan)
    ranges[:3], ranges[3:7] = 1.0, np.inf
    scan = LaserScan(ranges, np.linspace(-1, 1, 20), range_max=9.0)
    _, page = page_of(prepare(room_with_a_post()), scan)
    assert "3 of its 20 readings are valid; 10 are needed." in page.text
    assert "4 no return" in page.text
    assert "Ray by ray" not in page.text
    assert page.tags.count("img") == 1


def test_a_scan_of_elsewhere_is_a_best_guess_at_most() -> None:
    rng = np.random.default_rng(0)
    angles = np.deg2rad(np.arange(-180, 180, 3.0))
    features = prepare(room_with_a_post())
    _, page = page_of(features, LaserScan(rng.uniform(0.3, 3.0, 120), angles, range_max=9.0))
    assert HEADLINES["no-match"] in page.text
    assert "Best guess x " in page.text
    assert "Pose of the sensor" not in page.text
    _, nothing = page_of(features, LaserScan(np.full(120, 70.0), angles, range_max=80.0))
    assert "The search found no free place where" in nothing.text


@pytest.mark.parametrize("method", ["cbml", "ght-v", "beam"])
def test_a_stack_is_its_own_picture(method: str) -> None:
    features, scan = features_of("curved"), scan_of("curved")
    options = Options(method=method)
    why = explain(features, scan, answer_of("curved", method), options)
    layer = why.layer
    assert layer.likelihood is not None
    assert np.median(draw_likelihood(layer.likelihood).image.max(axis=2)) > 200  # few places fit
    page = Page(render_explanation(why, "x"))
    assert f"no finer than the cells and headings of the stack of {method}" in page.text
    assert "nan" not in page.text


def test_an_answer_out_of_time_says_so_and_what_was_known_is_listed(why, page) -> None:
    known = {**why.answer.parameters, "prior": {"near": [1.0, 2.0], "radius": 3.0}}
    given = replace(why, answer=replace(why.answer, parameters=known, complete=False))
    other = Page(render_explanation(given, "x")).text
    for said in ("ran out of time", "Known beforehand near [1.0, 2.0], radius 3.0"):
        assert said in other
        assert said not in page.text
