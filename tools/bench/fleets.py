"""What the benchmark measures of folders: batches beside plain loops, and pages of many rows."""

import contextlib
import json
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np

from imgloc import load_map, load_scans, localize, prepare, run_batch, save_map
from imgloc.io.scanset import ScanSet
from imgloc.model import OccupancyGrid
from imgloc.runs.results import RESULTS, read_rows
from tools.bench.outside import ROOT, command
from tools.recorded import save_each

Cost = Mapping[str, float]
"""``seconds`` and ``processor`` seconds."""
_MAPS = 100  # of the rows


def batch_costs(
    grid: OccupancyGrid, scans: ScanSet, repeats: int
) -> tuple[Mapping[str, Cost], Mapping[str, float]]:
    """The command ``imgloc batch`` on a map and a file for each scan, by one worker and by two.

    Beside them, in turns, the same answers by a loop that does nothing else, and by two such loops
    at once with half each: what a second process is worth on this machine that shares nothing.

    Returns
    -------
    costs, ratios : dict
        By their names, medians of the repeats. Of loops the time begins when the map is prepared,
        of commands it is that of everything.
    """
    turns: list[dict[str, Cost]] = []
    with _site(grid, scans) as (yaml, files):
        for turn in range(repeats):
            costs: dict[str, Cost] = {}
            for n, name in ((1, "one worker"), (2, "two workers")):
                out = yaml.parent / f"{turn}-{n}"
                given = ("--out", out, "--workers", n, "--no-cache")
                costs[name] = command("batch", yaml, files, *given)
                said = sum(sum(row["cost"]["ms"]) for row in read_rows(out)) / 1e3
                costs[f"answers of {name}"] = {"seconds": said}
            costs |= {"one loop": _loops(yaml, files, 1), "two loops": _loops(yaml, files, 2)}
            turns.append(costs)
    middle = {
        name: {key: _median([t[name][key] for t in turns]) for key in cost}
        for name, cost in turns[0].items()
    }
    return middle, {
        f"{a} / {b}{of}": _median([t[a][key] / t[b][key] for t in turns])
        for a, b, key, of in _RATIOS
    }


_RATIOS = (
    ("one worker", "answers of one worker", "seconds", ""),
    ("one worker", "one loop", "processor", ", processor"),
    ("one worker", "two workers", "seconds", ""),
    ("one loop", "two loops", "seconds", ""),
    ("two workers", "one worker", "processor", ", processor"),
    ("two loops", "one loop", "processor", ", processor"),
)


@contextlib.contextmanager
def _site(grid: OccupancyGrid, scans: ScanSet) -> Iterator[tuple[Path, Path]]:
    """A map, and a folder with a file for each scan."""
    with TemporaryDirectory(prefix="imgloc-") as folder:
        yaml, files = Path(folder) / "map.yaml", Path(folder) / "scans"
        save_map(yaml, grid)
        save_each(files, scans)
        yield yaml, files


def _loops(yaml: Path, files: Path, count: int) -> Cost:
    """Answers to all scans by so many processes at once, each of which has prepared the map."""
    with contextlib.ExitStack() as stack:
        runs = [
            stack.enter_context(
                subprocess.Popen(  # noqa: S603  (our own interpreter)
                    [sys.executable, "-c", _LOOP, str(yaml), str(files), str(k), str(count)],
                    stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT,
                )
            )
            for k in range(count)
        ]  # fmt: skip
        for run in runs:
            assert run.stdout is not None
            run.stdout.readline()
        for run in runs:
            assert run.stdin is not None
            run.stdin.write("go\n")
            run.stdin.flush()
        found = [json.loads(run.stdout.readline()) for run in runs if run.stdout is not None]
    return {"seconds": max(f[0] for f in found), "processor": sum(f[1] for f in found)}


_LOOP = "import sys; from tools.bench.fleets import loop; loop(*sys.argv[1:])"


def loop(yaml: str, folder: str, first: str, step: str) -> None:
    """Answer every `step`-th file of scans, from when a line is read; print what that took."""
    cv2.setNumThreads(1)
    files = sorted(Path(folder).iterdir())[int(first) :: int(step)]
    scans = [load_scans(file)[0] for file in files]
    features = prepare(load_map(yaml))
    localize(features, scans[0])
    print("ready", flush=True)
    sys.stdin.readline()
    start = time.perf_counter(), time.process_time()
    for scan in scans:
        localize(features, scan)
    print(json.dumps([time.perf_counter() - start[0], time.process_time() - start[1]]))


def row_costs(grid: OccupancyGrid, scans: ScanSet, count: int) -> dict[str, Cost]:
    """``imgloc export`` and ``report`` of so many rows, and the page in a browser, if there is one.

    The rows are those of a scan, with other names, poses, errors and times. Of a browser's steps
    there is ``seconds`` alone.
    """
    out: dict[str, Cost] = {}
    with _site(grid, scans) as (yaml, files):
        found = yaml.parent / "found"
        with ThreadPoolExecutor(1) as pool:
            run_batch(yaml, files, found, executor=pool)
        _multiply(found, count)
        out["export"] = command("export", found)
        out["export, Parquet"] = command("export", found, "--format", "parquet")
        out["report"] = command("report", found)
        out |= in_browser(found / "report.html")
    return out


def _multiply(folder: Path, count: int) -> None:
    rng, real = np.random.default_rng(0), (folder / RESULTS).read_text("utf-8").splitlines()
    with (folder / RESULTS).open("w", encoding="utf-8") as file:
        for k in range(count):
            row = json.loads(real[k % len(real)])
            row |= {"map": f"site/floor-{k % _MAPS:03d}", "scans": f"run-{k:06d}.npz"}
            row["cost"] |= {"ms": [float(f"{rng.gamma(4, 30):.3f}")]}
            if k % 50 == 0:
                row |= {"status": "failed", "code": "scan", "answers": [],
                        "message": f"run-{k:06d}.npz: is empty"}  # fmt: skip
            for answer in row["answers"]:
                error = float(rng.gamma(1, 0.05))
                answer |= {"hit": error < 0.5, "error": {"position": error, "heading": 0.01}}
                answer["hypotheses"][0]["x"] += float(rng.normal())
                answer["verdict"] = "unique" if rng.random() < 0.9 else "ambiguous"
            file.write(json.dumps(row) + "\n")


def in_browser(page: Path) -> dict[str, Cost]:
    """What each step of a reader takes in chromium: nothing where Playwright or it is missing."""
    chromium = shutil.which("chromium")
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        return {}
    if chromium is None:
        return {}
    out: dict[str, Cost] = {}

    @contextlib.contextmanager
    def step(name: str) -> Iterator[None]:
        start = time.perf_counter()
        yield
        out[f"page: {name}"] = {"seconds": time.perf_counter() - start}

    with sync_playwright() as p, p.chromium.launch(executable_path=chromium) as browser:
        tab = browser.new_page()
        answers, shown = tab.locator("[data-table=answers]"), tab.locator("dialog")
        by_error = answers.get_by_role("button", name="error / m")
        with step("load"):
            tab.goto(page.as_uri())
        with step("sort"):
            by_error.click()
        with step("sort the other way"):
            by_error.click()
        with step("filter"):
            answers.locator("input").fill("floor-007")
            answers.locator("output", has_text=" of ").wait_for()
        with step("open an answer"):
            answers.locator("tbody button").first.click()
            shown.wait_for()
        with step("the next"):
            tab.keyboard.press("ArrowRight")
    return out


def _median(values: Sequence[float]) -> float:
    return float(np.median(values))
