"""Measures how soon score and readings follow while a scan is dragged on the page.

Run it with a map and a file of scans, while nothing else runs; it needs Playwright and chromium::

    python -m tools.drag ../data/fr079/map.yaml ../data/fr079/scans.npz

It opens `imgloc open` in a real browser, takes the scan with the mouse and moves it in steps of
some pixels. It prints the milliseconds from each pointer event to the score of that pose.
"""

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from imgloc.errors import ConfigError
from tools.script import at_least_one, ended, parser_of

_WATCH = """() => {
    window.lags = [];
    let moved = null;
    document.getElementById("canvas").addEventListener(
        "pointermove", (event) => { moved = event.timeStamp; }, { capture: true });
    new MutationObserver(() => {
        const begin = moved;
        if (begin === null) return;
        moved = null;
        requestAnimationFrame((now) => lags.push(Math.max(now, performance.now()) - begin));
    }).observe(document.getElementById("pose-score"),
               { childList: true, characterData: true, subtree: true });
}"""


def lags_of(address: str, moves: int) -> list[float]:
    """Milliseconds from each move of the mouse to the new score, in chromium."""
    from playwright.sync_api import expect, sync_playwright

    chromium = shutil.which("chromium")
    if chromium is None:
        raise ConfigError("expected chromium among the programs")
    with sync_playwright() as p:
        browser = p.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1400, "height": 900})
        page.goto(address)
        expect(page.locator("#pose-score")).not_to_be_empty(timeout=60_000)
        box = page.locator("#canvas").bounding_box()
        assert box is not None
        x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        page.mouse.dblclick(x, y)
        page.wait_for_timeout(1000)
        page.evaluate(_WATCH)
        page.mouse.move(x, y)
        page.mouse.down()
        for k in range(moves):
            turn = 2 * np.pi * k / moves
            page.mouse.move(x + 90 * np.sin(turn), y + 90 * (1 - np.cos(turn)))
            page.wait_for_timeout(150)
        page.mouse.up()
        lags = [float(lag) for lag in page.evaluate("lags")]
        browser.close()
    return lags


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print."""
    parser = parser_of("tools.drag", __doc__)
    parser.add_argument("map", type=Path)
    parser.add_argument("scans", type=Path)
    parser.add_argument("--moves", type=int, default=100)
    asked = parser.parse_args(arguments)

    def measure() -> int:
        at_least_one(moves=asked.moves)
        command = [sys.executable, "-m", "imgloc", "open", str(asked.map), str(asked.scans)]
        quiet = {**os.environ, "BROWSER": "true"}  # no other browser is opened
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=quiet) as process:  # noqa: S603
            assert process.stdout is not None
            try:
                lags = lags_of(process.stdout.readline().strip(), asked.moves)
            finally:
                process.terminate()
        half, most = np.percentile(lags, (50, 99))
        print(
            f"{len(lags)} of {asked.moves} moves changed the score: p50 {half:.0f} ms, "
            f"p99 {most:.0f} ms, at most {max(lags):.0f} ms"
        )
        return 0

    return ended("tools.drag", measure)


if __name__ == "__main__":
    sys.exit(main())
