"""tools/reproduce_paper.py as a user runs it, and the page that it writes."""

import json
import re
import subprocess
import sys
from html.parser import HTMLParser

import pytest
from command import ROOT

from imgloc.experiments.reproduce import figure
from imgloc.io.output import encode_png
from imgloc.report.paper import render_report

TOOL = ROOT / "tools" / "reproduce_paper.py"


def run(*arguments):
    return subprocess.run(
        [sys.executable, TOOL, *map(str, arguments)],
        capture_output=True, text=True, check=False,
        env={"PYTHONPATH": str(ROOT), "PATH": "/usr/bin:/bin", "MPLBACKEND": "agg"},
    )  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("paper") / "new" / "folder"
    done = run("--out", out, "--quick", "-n", 2, "--seed", 0)
    assert "Traceback" not in done.stderr
    assert done.stdout.strip().endswith("report.html"), done.stderr
    return out


@pytest.fixture(scope="module")
def results(folder):
    return json.loads((folder / "results.json").read_text())


def test_all_files_are_there_and_pictures_are_pngs(folder):
    names = {"fig1.png", "fig2.png", "fig4.png", "fig5.png", "complexity.png"}
    assert {p.name for p in folder.iterdir()} == names | {"results.json", "report.html"}
    assert all((folder / name).read_bytes().startswith(b"\x89PNG") for name in names)


def test_results_hold_the_table_the_claims_and_the_exponents(results):
    rows = {(r["world"], r["method"]) for r in results["table"]}
    assert len(rows) == 3 * 7
    assert results["seed"] == 0
    assert results["holds"] == all(c["holds"] for c in results["claims"] if c["firm"])
    assert any("rho_m^2" in c["text"] for c in results["claims"])
    assert {f["axis"] for f in results["complexity"]["fits"]} == {"A", "rho_m", "rho_theta", "n"}


class Page(HTMLParser):
    """Collects tags, sources and text."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.sources, self.text = [], [], ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.sources += [v for k, v in attrs if k in ("src", "href")]

    def handle_data(self, data):
        self.text += data


def test_the_report_needs_no_other_file(folder):
    page = Page((folder / "report.html").read_text())
    assert page.tags.count("img") == 5
    assert all(source.startswith("data:image/png;base64,") for source in page.sources)
    assert not {"script", "link", "iframe"} & set(page.tags)
    assert "url(" not in (folder / "report.html").read_text()


def test_the_report_gives_the_numbers_of_the_results(folder, results):
    text = Page((folder / "report.html").read_text()).text
    for row in results["table"]:
        assert f"{row['index']['value']:.2f}".replace("-", "−") in text
    for claim in results["claims"]:
        assert claim["text"] in text


def test_names_in_the_report_are_escaped(results):
    evil = json.loads(json.dumps(results).replace("curved", "<b>x</b>&"))
    page = render_report(evil, {})
    assert "<b>x</b>&" not in page
    assert "&lt;b&gt;x&lt;/b&gt;&amp;" in page


def test_threads_change_no_picture(folder):
    assert encode_png(figure("fig4", threads=1)) == (folder / "fig4.png").read_bytes()
    assert encode_png(figure("fig2", threads=3)) == (folder / "fig2.png").read_bytes()


def test_nothing_is_overwritten_unless_forced(folder):
    before = (folder / "results.json").read_bytes()
    done = run("--out", folder, "--quick", "-n", 2)
    assert done.returncode == 1
    assert re.search(r"results\.json.*exists", done.stderr)
    assert (folder / "results.json").read_bytes() == before


@pytest.mark.parametrize(
    ("arguments", "message"),
    [(("-n", 1), "at least 2 trials"), (("--seed", -1), "a seed of 0 or more")],
)
def test_wrong_numbers_are_refused_at_once(tmp_path, arguments, message):
    done = run("--out", tmp_path / "x", *arguments)
    assert done.returncode == 2
    assert message in done.stderr
    assert not (tmp_path / "x").exists()
