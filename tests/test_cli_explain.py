"""`imgloc localize --explain`, from file to file."""

from pathlib import Path

import pytest
from command import MAPS, call, simulating

CURVED = MAPS / "curved.yaml"


scans = simulating(CURVED, "-n", 2, name="two & <b>.npz")


def test_one_scan_is_one_page(scans: Path, tmp_path: Path) -> None:
    out = tmp_path / "why.html"
    words = ["localize", CURVED, scans, "--scans-index", 1, "--explain", out]
    plain = call(*words[:-2])
    code, text, err = call(*words)
    assert (code, err) == (0, "")
    assert text.splitlines()[:3] == plain.out.splitlines()[:3]  # the answer is the same
    page = out.read_text(encoding="utf-8")
    assert page.startswith("<!doctype html>")
    assert "two &amp; &lt;b&gt;.npz, scan 1, on curved" in page
    assert "One pose explains this scan." in page
    assert "True pose of the sensor" in page
    assert [p.name for p in tmp_path.iterdir()] == ["why.html"]


def test_several_scans_are_numbered_pages(scans: Path, tmp_path: Path) -> None:
    words = ["localize", CURVED, scans, "--json", "--explain", tmp_path / "why.html"]
    assert call(*words).code == 0
    assert sorted(p.name for p in tmp_path.iterdir()) == ["why-0000.html", "why-0001.html"]
    (tmp_path / "why-0000.html").unlink()
    code, text, err = call(*words)
    assert (code, text) == (1, "")  # before anything is computed
    assert "why-0001.html: exists already" in err
    assert not (tmp_path / "why-0000.html").exists()


@pytest.mark.parametrize(
    ("name", "code", "expected"),
    [("why.htm", 2, "ends in .html"), ("no/why.html", 1, "there is no folder")],
)
def test_bad_names_are_refused_at_once(name, code, expected, scans, tmp_path):
    call("localize", CURVED, scans, "--explain", tmp_path / name).ends(code, expected, out="")
    assert not list(tmp_path.iterdir())


def test_the_mounting_and_the_prior_are_on_the_page(scans: Path, tmp_path: Path) -> None:
    out = tmp_path / "why.html"
    words = ["--scans-index", 0, "--sensor", "0.2,0,0", "--clearance", 0.1, "--explain", out]
    assert call("localize", CURVED, scans, *words).code == 0
    page = out.read_text(encoding="utf-8")
    assert "Pose of the robot" in page
    assert "Known beforehand" in page
    assert "clearance" in page


def test_a_real_scan_on_a_real_map(shared: Path, tmp_path: Path) -> None:
    here, out = shared / "data" / "fr079", tmp_path / "why.html"
    words = ("--scans-index", 100, "--explain", out, "--no-cache")
    call("localize", here / "map.yaml", here / "scans.npz", *words).ends(0)
    page = out.read_text(encoding="utf-8")
    assert "<span class=word>unique</span>" in page
    assert len(page) < 3_000_000
