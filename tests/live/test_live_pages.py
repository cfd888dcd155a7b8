"""Pages that imgloc writes, in a real browser: the report of a batch, and why an answer is."""

from pathlib import Path
from typing import Any

import pytest
from command import call
from test_cli_explain import CURVED, scans  # noqa: F401  (a fixture)
from test_output_report import folder  # noqa: F401  (a fixture)

sync = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")


@pytest.mark.parametrize("width", [390, 1280])
def test_the_report_of_a_batch(folder: Path, browser: Any, width: int) -> None:  # noqa: F811
    assert call("report", folder).code == 0
    context = browser.new_context(viewport={"width": width, "height": 800}, offline=True)
    page = context.new_page()
    trouble: list[str] = []
    page.on("console", lambda m: trouble.append(m.text) if m.type in ("error", "warning") else None)
    page.on("pageerror", lambda e: trouble.append(str(e)))
    page.goto((folder / "report.html").as_uri())
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    ground = "getComputedStyle(document.querySelector('main')).backgroundColor"
    assert page.evaluate(ground) == "rgb(255, 255, 255)"
    page.emulate_media(color_scheme="dark")
    assert page.evaluate(ground) == "rgb(22, 27, 34)"
    answers, maps = (page.locator(f"[data-table={name}]") for name in ("answers", "maps"))
    count = sync.expect(answers.locator("output"))
    assert maps.locator("tbody tr").count() == 3
    assert answers.locator("tbody tr").count() == 100
    count.to_have_text("248 rows")

    # It sorts: the worst first, then the best.
    head = answers.get_by_role("button", name="error / m")
    head.click()
    assert answers.locator("th[aria-sort=descending]").count() == 1
    column = [th.inner_text() for th in answers.locator("th").all()].index("error / m")
    value = answers.locator("tbody tr").first.locator("td").nth(column)
    assert value.inner_text() == "3.000"
    head.focus()
    page.keyboard.press("Enter")
    assert value.inner_text() == "0.040"

    # It filters, by words and by verdict.
    answers.locator("input").fill("cellar run-0004")
    count.to_have_text("1 of 248 rows")
    answers.locator("input").fill("")
    answers.locator("select").select_option(label="wrong")
    sync.expect(answers.locator("tbody tr")).to_have_count(36)
    answers.locator("select").select_option(label="all")

    # It opens an item, by the keyboard, with its pictures; and the next one.
    answers.locator("input").fill("run-0004")
    count.to_have_text("1 of 248 rows")
    answers.locator("tbody button").first.focus()
    page.keyboard.press("Enter")
    dialog = page.locator("dialog")
    assert "run-0004.npz" in dialog.locator("h2").inner_text()
    assert dialog.locator("img").count() == 2
    page.wait_for_function(
        "[...document.querySelectorAll('dialog img')].every(i => i.complete && i.naturalWidth)"
    )
    page.keyboard.press("Escape")
    assert not dialog.is_visible()
    answers.locator("input").fill("")
    count.to_have_text("248 rows")
    answers.get_by_role("button", name="Next page").click()
    answers.locator("tbody button").first.click()
    title = dialog.locator("h2").inner_text()
    page.keyboard.press("ArrowRight")
    assert dialog.locator("h2").inner_text() != title
    page.keyboard.press("Escape")

    # The gallery has what has pictures, and the failures their messages.
    assert page.locator("#gallery button").count() == 1
    failures = page.locator("[data-table=failures] tbody")
    assert "run-0248.npz: is empty" in failures.inner_text()
    assert "</script><b>hall" in maps.inner_text()
    assert not trouble
    context.close()


@pytest.fixture(scope="module")
def told(scans: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:  # noqa: F811
    """A page about a scan in millimetres, which says what to look at next."""
    out = tmp_path_factory.mktemp("told") / "why.html"
    words = ["localize", CURVED, scans, "--scans-index", 0, "--range-scale", 1000, "--explain", out]
    assert "are they millimetres? Try --range-scale 1" in call(*words).err
    return out


@pytest.mark.parametrize("width", [390, 1400])
def test_a_browser_shows_the_page_without_scrolling_sideways(browser, told, width):
    page, said = browser.new_page(viewport={"width": width, "height": 900}), list[str]()
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.goto(told.as_uri())
    size = page.evaluate("[document.documentElement.scrollWidth, innerWidth]")
    hint = page.locator(".next li").inner_text()
    gap = page.evaluate("""[...document.querySelectorAll('main > *')].map(
        (e) => e.getBoundingClientRect()).reduce(([gap, end], {top, bottom}) =>
        [Math.max(gap, top - end), bottom], [0, 0])[0]""")
    page.close()
    assert said == []
    assert size[0] <= size[1] == width
    assert "Try --range-scale 1" in hint
    assert gap < 120  # pixels of nothing
