"""The page and the table of a batch: as a page, and by the programs that they are for.

The rows are written here, as a batch would: many, of every kind, without the time to compute them.
"""

import csv
import itertools
import json
from html.parser import HTMLParser
from pathlib import Path

import pytest
from command import call

from imgloc.output.report import histogram, render_report
from imgloc.runs.results import RESULTS

PNG = bytes.fromhex(
    "89504e470d0a1a0a0000000d49484452000000010000000108060000001f15c4890000000d49444154"
    "789c63f8cfc0f01f00050001ff56c72f0d0000000049454e44ae426082"
)


def answer(k: int, verdict: str = "unique", error: float | None = None, **more):
    pose = {"x": 1.0 + k, "y": 2.0, "theta": 0.5, "mass": 0.9, "log_likelihood": -1.5}
    pose["covariance"] = [[0.01, 0.0, 0.0], [0.0, 0.02, 0.0], [0.0, 0.0, 0.03]]
    out = {
        "index": 0, "verdict": verdict, "pose": pose, "hypotheses": [pose], "elsewhere": 0.05,
        "evidence": {"misfit": 0.25, "temperature": 2.0, "readings": 90, "found": 3},
        "explained": 0.8, "entropy": 0.1, "complete": True,
    }  # fmt: skip
    if error is not None:
        out |= {"truth": {"x": 1.0, "y": 2.0, "theta": 0.5}, "hit": error <= 0.5}
        out["error"] = {"position": error, "heading": 0.01}
    return out | more


def row(k: int, where: str, answers: list, status: str = "ok", **more):
    return {
        "map": where, "scans": f"run-{k:04d}.npz", "status": status, "code": None, "message": None,
        "answers": answers, "key": f"{k:032x}", "version": "1.2.3",
        "hashes": {"map": "a", "scans": "b", "parameters": "p"},
        "cost": {"seconds": 0.1, "attempts": 1, "ms": [50.0 + k] * len(answers)},
    } | more  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """250 items of three maps, two of which failed, and a name that would be markup."""
    names = ("attic", "cellar", "</script><b>hall")
    rows = [
        row(k, names[k % 3], [answer(k, "unique" if k % 5 else "ambiguous", 0.04 if k % 7 else 3)])
        for k in range(248)
    ]
    picture = {"pictures": ["a-0000-poses.png", "a-0000-likelihood.png"]}
    rows[4]["answers"][0] |= picture
    rows.append(row(248, "attic", [], "failed", code="scan", message="run-0248.npz: is empty"))
    rows.append(row(249, "cellar", [], "crashed", code=9, message="ended by SIGKILL"))
    write(tmp_path, "localize", rows)
    (tmp_path / "pictures").mkdir()
    for name in picture["pictures"]:
        (tmp_path / "pictures" / name).write_bytes(PNG)
    return tmp_path


def write(folder: Path, job: str, rows: list) -> None:
    about = {"format": 1, "imgloc": "1.2.3", "job": job, "maps": "floors", "scans": "scans"}
    about["parameters"] = {"p": {"options": {"method": "fused"}, "cell": 0.1}}
    (folder / "run.json").write_text(json.dumps(about))
    (folder / RESULTS).write_text("".join(json.dumps(r) + "\n" for r in rows))


class Links(HTMLParser):
    """Whatever a page would load from elsewhere."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.found += [v for k, v in attrs if k in ("src", "href") and not v.startswith("data:")]


def test_a_page_is_one_file(folder: Path) -> None:
    assert call("report", folder).code == 0
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert not Links(page).found
    assert "<b>hall" not in page
    assert "211" in page  # of 248 are right
    assert page.count("</script>") == 3
    assert call("report", folder).code == 0  # again, in place of its own
    (folder / "report.html").write_text("mine")
    again = call("report", folder)
    assert (again.code, (folder / "report.html").read_text()) == (1, "mine")
    assert "exists already" in again.err


def test_a_batch_without_any_answer_has_a_page(tmp_path: Path) -> None:
    failed = [row(k, "attic", [], "failed", code="scan", message="it is empty") for k in range(2)]
    write(tmp_path, "localize", failed)
    page = render_report(tmp_path)
    assert page.count("it is empty") == 1  # texts stand in the page once
    assert '"answers":{"columns":[],"count":0,"pictures":[],"pages":[]}' in page


def test_what_is_no_row_of_a_batch_is_an_error(tmp_path: Path) -> None:
    write(tmp_path, "localize", [{"map": "a", "scans": None, "key": "k", "status": "ok"}])
    for command in ("report", "export"):
        call(command, tmp_path).ends(1, "line 1: no row of a batch")
    write(tmp_path, "juggle", [])
    call("report", tmp_path).ends(1, "results of the job 'juggle', expected localize")


def test_bars_have_everything_in_them() -> None:
    bars = histogram([0.001, 0.05, 0.06, 1e6], 0.01, 100.0)
    assert sum(n for _, _, n in bars) == 4
    assert all(a[1] == pytest.approx(b[0]) for a, b in itertools.pairwise(bars))
    assert histogram([], 1, 2) == []


@pytest.mark.parametrize("job", ["check", "which"])
def test_other_jobs_have_a_page_and_a_table(tmp_path: Path, job: str) -> None:
    answers = {
        "check": {"width": 40, "height": 30, "resolution": 0.1, "free_area": 11.5,
                  "warnings": [{"code": "coarse", "text": "0.5 m per cell"}]},
        "which": {"index": 0, "verdict": "attic", "none": 0.1, "temperature": 2.0,
                  "maps": [{"map": "attic", "probability": 0.9, "pose": None}]},
    }  # fmt: skip
    write(tmp_path, job, [row(0, "attic", [answers[job]])])
    assert "Answer by answer" in render_report(tmp_path)
    assert call("export", tmp_path).code == 0
    (found,) = csv.DictReader((tmp_path / "results.csv").read_text().splitlines())
    assert (found["map"], found["status"]) == ("attic", "ok")


def test_a_table_has_a_row_for_each_scan(folder: Path) -> None:
    assert call("export", folder).code == 0
    text = (folder / "results.csv").read_text()
    found = list(csv.DictReader(text.splitlines()))
    assert len(found) == 250
    assert found[3]["map"] == "attic"
    assert [float(found[3][k]) for k in ("x", "theta", "covariance_yy", "error_position")] == [
        4.0, 0.5, 0.02, 0.04,
    ]  # fmt: skip
    assert (found[3]["verdict"], found[3]["hit"]) == ("unique", "True")
    assert (found[249]["status"], found[249]["code"], found[249]["x"]) == ("crashed", "9", "")
    again = call("export", folder)
    assert (again.code, (folder / "results.csv").read_text()) == (1, text)


def test_parquet_has_the_values_of_the_csv(folder: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet", reason="imgloc[parquet] is not installed")
    assert call("export", folder, "--out", folder / "results.parquet").code == 0
    table = parquet.read_table(folder / "results.parquet")
    assert table.num_rows == 250
    assert table.column("x").to_pylist()[3] == 4.0
    assert table.column("hit").to_pylist()[248] is None
    assert table.column("code").to_pylist()[249] == "9"
