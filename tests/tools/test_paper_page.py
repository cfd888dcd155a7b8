"""The page of the paper's experiment, from plain values that are made up."""

import copy
import re
from html.parser import HTMLParser

import pytest

from tools.paper.page import render_report

PNG = b"\x89PNG not really"


def share(value):
    return {"hits": 0, "trials": 10, "value": value, "low": value - 0.1, "high": value + 0.1}


def row(world, method, s, **more):
    return {
        "place": "Fig. 2", "world": world, "method": method, "step_deg": 3.0, "log_poses": 14.9,
        "index": {"value": s, "standard_error": 0.02, "floored": 0}, "bare": None, "gain": None,
        "interval": [s - 0.04, s + 0.04], "exact": share(0.2), "wide": share(0.3),
        "near": share(0.4), "paper": None, "cost": {"ms": 12.34}, **more,
    }  # fmt: skip


def fit(method, quantity, axis, exponent):
    return {
        "method": method, "quantity": quantity, "axis": axis, "exponent": exponent, "paper": 1,
    }  # fmt: skip


ROWS = [
    row("visibility", "cbml", -0.001, paper=-0.47),
    row("visibility", "ght-v once", 3.5, gain={"value": 0.123, "standard_error": 0.01}),
    row("visibility", "beam", 12.9, bare={"value": 7.77, "floored": 3}),
]
SAMPLES = [
    {"method": m, "axis": axis, "value": v, "storage": 83200, "init_work": 1, "work": 165_280_000}
    for m in ("cbml", "ght")
    for axis, v in (("A", 208.0), ("A", 416.0), ("n", 90.0))
]
TIMES = [{**{k: s[k] for k in ("method", "axis", "value")}, "init_s": 0.00123, "run_s": None}
         for s in SAMPLES]  # fmt: skip
RESULTS = {
    "version": "9.9", "n": 10, "seed": 5, "table": ROWS,
    "claims": [{"text": "work grows with rho_m^2", "holds": False, "found": "rho_m^1.98"}],
    "complexity": {
        "world": "curved", "samples": SAMPLES,
        "fits": [fit("cbml", "storage", "A", -1e-9)],
    },
    "cost": {
        "claims": [{"text": "CBML-O is as fast", "holds": True, "found": "1.20 x"}],
        "ratios": [{"world": "visibility", "method": "cbml-o", "rival": "cbml", "most": 1.3,
                    "ms": 12.0, "rival_ms": 10.0, "value": 1.2}],
        "complexity": {
            "samples": TIMES,
            "fits": [fit("beam", "run_s", "n", 0.98)]
        },
    },
}  # fmt: skip


class Page(HTMLParser):
    """Collects tags, sources and text, and checks that what is opened is closed."""

    VOID = ("meta", "img", "br", "path", "circle")

    def __init__(self, text):
        super().__init__()
        self.tags, self.sources, self.text, self.closed = [], [], "", []
        self.feed(re.sub(r"\s*\n\s*", " ", str(text)).replace("> <", "><"))

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.sources += [v for k, v in attrs if k in ("src", "href")]

    def handle_endtag(self, tag):
        self.closed.append(tag)

    def handle_data(self, data):
        self.text += data


@pytest.fixture(scope="module")
def page():
    return Page(render_report(RESULTS, {"fig1": PNG, "fig4": PNG, "complexity": PNG}))


def test_the_page_needs_no_other_file(page):
    assert page.tags.count("img") == 3
    assert all(source.startswith("data:image/png;base64,") for source in page.sources)
    assert not {"script", "link", "iframe"} & set(page.tags)
    assert "url(" not in page.text
    for tag in ("table", "figure", "div", "svg", "ul", "span", "sup", "sub", "p", "tr"):
        assert page.tags.count(tag) == page.closed.count(tag), tag


def test_the_page_says_what_was_run_and_captions_its_figures(page):
    assert "imgloc 9.9 · 10 trials in each world · seed 5" in page.text
    assert "Fig. 1. Not taking into account the orientation of surfaces" in page.text
    assert "Fig. 4. Surface points (a)" in page.text
    assert "Fig. 2. Visibility constraints" not in page.text  # not drawn


@pytest.mark.parametrize("key", ["world", "method"])
def test_names_are_escaped(key):
    evil = copy.deepcopy(RESULTS)
    for r in evil["table"]:
        r[key] += "<b>x</b>&"
    page = render_report(evil, {})
    assert "<b>x</b>&" not in page
    assert "&lt;b&gt;x&lt;/b&gt;&amp;" in page
