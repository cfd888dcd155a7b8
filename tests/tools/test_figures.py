"""The figures of README and the docs are those of the measured pages."""

from tools import figures


def test_all_pages_have_the_figures_of_the_measured_pages(capsys):
    assert figures.main(["--check"]) == 0, capsys.readouterr().out


def test_the_figures_are_counted_from_the_rows() -> None:
    blocks = figures.figures()
    assert blocks["wrong"].startswith("Of 2,812 scans of a map's own building in 32 conditions")
    lines = blocks["hits"].splitlines()
    assert len(lines) == 2 + 8
    assert (
        "| problem A, 10 m (simulated office, 10 cm) | 33 | 46 | 46 | 0.01 m | 3.4 | 0.69 |"
        in lines
    )


def test_a_page_with_other_figures_is_named_and_mended(tmp_path, monkeypatch, capsys):
    page = tmp_path / "a.md"
    page.write_text("x\n<!-- figures: wrong -->\nOf 3 scans 1.\n<!-- end -->\ny\n")
    monkeypatch.setattr(figures, "PAGES", (page,))
    assert figures.main(["--check"]) == 1
    assert str(page) in capsys.readouterr().out
    assert figures.main([]) == 0
    assert "Of 2,812 scans" in page.read_text()
    assert figures.main(["--check"]) == 0
