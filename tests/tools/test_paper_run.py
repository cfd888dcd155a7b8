"""`python -m tools.paper` as a user runs it, and what it writes."""

import base64
import json
import re
import subprocess
import sys

import pytest
from command import ROOT, run

from imgloc.io.images import encode_png
from imgloc.model import to_json
from tools.paper.__main__ import TIMED_QUICK, as_dict, main, steps
from tools.paper.complexity import AXES
from tools.paper.figures import SETTINGS, figure, scene
from tools.paper.table import PAIRS, STEPS_DEG, table


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("paper") / "new" / "folder"
    words = ("--quick", "-n", "2", "--seed", "0", "--worlds", "curved", "curved")
    done = subprocess.run(
        [sys.executable, "-m", "tools.paper", "--out", out, *words],
        capture_output=True, text=True, check=False,
        cwd=ROOT, env={"PATH": "/usr/bin:/bin", "MPLBACKEND": "agg"},
    )  # fmt: skip
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
    rows = [(r["world"], r["method"]) for r in results["table"]]
    assert rows == [("curved", method) for method in STEPS_DEG]
    assert results["seed"] == 0
    assert results["holds"] == all(c["holds"] for c in results["claims"] if c["firm"])
    assert any("rho_m^2" in c["text"] for c in results["claims"])
    assert {f["axis"] for f in results["complexity"]["fits"]} == {"A", "rho_m", "rho_theta", "n"}
    assert [(r["method"], r["rival"]) for r in results["cost"]["ratios"]] == [p[:2] for p in PAIRS]
    assert len(results["cost"]["claims"]) == len(PAIRS)


def without_cost(value):
    """Plain values without what is under a key ``cost``."""
    if isinstance(value, dict):
        return {k: without_cost(v) for k, v in value.items() if k != "cost"}
    return [without_cost(v) for v in value] if isinstance(value, list) else value


def test_results_are_the_same_in_every_run_but_for_what_is_under_cost(results):
    again = table(2, 0, worlds=["curved"], threads=1)
    again = [json.loads(to_json(as_dict(row))) for row in again]
    assert without_cost(again) == without_cost(results["table"])
    assert not set(find_keys(without_cost(results))) & {"ms", "init_s", "run_s"}
    assert {"ms", "init_s", "run_s"} <= set(find_keys(results))


def find_keys(value):
    """All keys in plain values."""
    if isinstance(value, dict):
        yield from value
        value = list(value.values())
    if isinstance(value, list):
        for v in value:
            yield from find_keys(v)


def test_steps_are_counted_before_they_are_taken():
    taken = []
    scene("fig4", advance=lambda: taken.append(1))
    assert len(taken) == len(SETTINGS["fig4"].steps)
    stacks, axes = sum(len(s.steps) for s in SETTINGS.values()), sum(map(len, AXES.values()))
    one = ("curved",)
    in_turns = 2 * len(STEPS_DEG) + TIMED_QUICK[0] * len(PAIRS)
    assert steps(2, one, quick=True) == in_turns + stacks + axes
    assert steps(17, one) - steps(15, one) == 2 * len(STEPS_DEG)
    assert steps(9) > steps(9, quick=True)


def test_the_report_holds_all_pictures(folder):
    page = (folder / "report.html").read_text()
    for name in ("fig1", "fig2", "fig4", "fig5", "complexity"):
        png = base64.b64encode((folder / f"{name}.png").read_bytes()).decode()
        assert f"base64,{png}" in page
    sources = re.findall(r"(?:src|href)=\"([^\"]*)", page)
    assert all(source.startswith("data:image/png;base64,") for source in sources)  # no other file
    assert not re.search(r"<(script|link|iframe)\b|url\(", page)


def test_threads_change_no_picture(folder):
    assert encode_png(figure("fig4", threads=1)) == (folder / "fig4.png").read_bytes()


def test_nothing_is_overwritten_unless_forced(folder):
    before = (folder / "results.json").read_bytes()
    done = run(main, "--out", folder, "--quick", "-n", 2).ends(1)
    assert re.search(r"results\.json.*exists", done.err)
    assert (folder / "results.json").read_bytes() == before
