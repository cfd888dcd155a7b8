"""Batches that are stopped, killed or out of disk, by the real command: each row is there once."""

import os
import signal
import subprocess
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from batches import QUICK, in_threads, site_in, timeless
from command import call, command
from killers import Saboteur
from killloop import kill_loop

from imgloc import Options, ScanSet, load_scans, make_job, run_batch, save_scans
from imgloc.runs.results import RESULTS, read_rows
from imgloc.runs.workers import Supervised


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return site_in(tmp_path_factory.mktemp("site"))


def test_forty_items_with_killers(site: Path, tmp_path: Path) -> None:
    scans, all_scans = tmp_path / "scans", load_scans(site / "all.npz")
    scans.mkdir()
    names = [f"s{k:02d}.npz" for k in range(34)] + ["sigkill.npz", "sigsegv.npz", "hang.npz"]
    for k, name in enumerate(names):
        save_scans(scans / name, ScanSet(all_scans.scans[k : k + 1]))
    whole = (scans / "s00.npz").read_bytes()
    (scans / "torn.npz").write_bytes(whole[: len(whole) // 2])
    (scans / "empty.npz").write_bytes(b"")
    (scans / "text.csv").write_text("no numbers\n")
    with Supervised(2) as pool, Supervised(1, timeout=0.3) as impatient:
        summary = run_batch(
            site / "floors", scans, tmp_path / "out", QUICK, executor=Saboteur(pool, impatient)
        )
    assert summary.statuses == {"ok": 34, "failed": 3, "crashed": 2, "timeout": 1}
    rows = {row["scans"]: row for row in read_rows(tmp_path / "out")}
    assert len(rows) == 40
    assert {n for n, row in rows.items() if row["status"] == "ok"} == set(names[:34])
    assert (rows["sigkill.npz"]["status"], rows["sigkill.npz"]["code"]) == ("crashed", 9)
    assert (rows["sigsegv.npz"]["status"], rows["sigsegv.npz"]["code"]) == ("crashed", 11)
    assert (rows["hang.npz"]["status"], rows["hang.npz"]["message"]) == (
        "timeout", "took more than 0.3 s",
    )  # fmt: skip
    for name in ("torn.npz", "empty.npz", "text.csv"):
        assert (rows[name]["status"], rows[name]["code"]) == ("failed", "scan")
        assert name in rows[name]["message"]
    assert {rows[n]["cost"]["attempts"] for n in names[34:]} == {2}
    assert {rows[n]["cost"]["attempts"] for n in names[:34]} == {1}


@pytest.mark.skipif(os.name != "posix", reason="limits of POSIX")
def test_a_disk_that_is_full_loses_no_row(site: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = command(
        ["batch", site / "floors", site / "scans", "--out", out, "--method", "cbml", "--cell",
         0.2, "--workers", 1, "--top", 2, "--no-cache", "--resume"]
    )  # fmt: skip
    # Files may not grow beyond 5 KB: a write fails in the middle of a row.
    limited = ["bash", "-c", 'ulimit -f 5; PYTHONDONTWRITEBYTECODE=1 exec "$@"', "bash", *words]
    done = subprocess.run(limited, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 1
    assert f"{out}: results cannot be written: File too large" in done.stderr
    kept = (out / RESULTS).read_bytes()
    assert kept.endswith(b"}\n")
    before = timeless(out)
    assert 0 < len(before) < 6
    assert in_threads(site, out, resume=True).new >= 6 - len(before)
    assert (out / RESULTS).read_bytes().startswith(kept) or timeless(out)


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_a_run_that_is_stopped_goes_on(site: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = ["batch", site / "floors", site / "scans", "--out", out, "--method", "cbml"]
    words += ["--cell", "0.2", "--workers", "1", "--resume"]
    for number, code in ((signal.SIGINT, 130), (signal.SIGKILL, -9)):
        before = len(list(read_rows(out))) if out.exists() else 0
        with subprocess.Popen(command(words), stderr=subprocess.PIPE) as run:
            while run.poll() is None and not (
                (out / RESULTS).exists() and (out / RESULTS).read_bytes().count(b"\n") > before
            ):
                time.sleep(0.01)
            run.send_signal(number)
            _, err = run.communicate(timeout=60)
        if run.returncode != 0:  # else it was done already
            assert run.returncode == code
            assert number == signal.SIGKILL or b"--resume goes on" in err
    assert call(*words).code == 0
    assert len(timeless(out)) == 6
    with ThreadPoolExecutor(1) as pool:
        job = make_job(options=Options(method="cbml"), cell=0.2)
        run_batch(site / "floors", site / "scans", tmp_path / "whole", job, executor=pool)
    whole = {row["scans"]: row["answers"] for row in read_rows(tmp_path / "whole")}
    assert {row["scans"]: row["answers"] for row in read_rows(out)} == whole


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_a_batch_that_is_killed_again_and_again_in_short(site: Path, tmp_path: Path) -> None:
    words = ("--method", "cbml", "--cell", "0.2", "--workers", "1", "--no-cache")
    found = kill_loop(site / "floors", site / "scans", tmp_path, 2, 1, *words)
    assert (found.items, found.equal, len(found.after)) == (6, True, 2)
    assert found.ended >= 1
