"""A batch on a Dask cluster over loopback: the rows of one machine, and a worker that is killed."""

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from command import ROOT, call, command
from killers import Saboteur, double
from places import room_with_a_post

from imgloc import ConfigError, Options, ScanSet, Sensor, make_job, run_batch, save_map, save_scans
from imgloc.features.budget import default_budget
from imgloc.runs.cluster import cluster
from imgloc.runs.results import read_rows
from imgloc.simulation.scans import simulate

distributed = pytest.importorskip(
    "distributed", reason="the extra imgloc[cluster] is not installed"
)
JOB = make_job(options=Options(method="cbml", top=2), cell=0.2)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a small map, twelve files with a scan each, and one that is damaged."""
    folder = tmp_path_factory.mktemp("site")
    (folder / "scans").mkdir()
    grid = room_with_a_post()
    save_map(folder / "post.yaml", grid)
    scans = simulate(grid, 12, 1, Sensor(rays=60, fov=6.0, range_max=9.0))
    for k in range(12):
        save_scans(folder / "scans" / f"s{k:02d}.npz", ScanSet(scans.scans[k : k + 1]))
    (folder / "scans" / "torn.npz").write_bytes(b"PK")
    return folder


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A cluster for all that leave it as it is."""
    with started(tmp_path_factory.mktemp("dask")) as (found, _):
        yield found


@contextlib.contextmanager
def started(folder: Path) -> Iterator[tuple[str, int]]:
    """A scheduler and two workers, started by the commands of the README, but for the port.

    Gives the address of the scheduler, and the number of its process.
    """
    file = folder / "scheduler.json"
    known = ["--scheduler-file", str(file), "--no-dashboard"]
    commands = (
        ["scheduler", "--host", "127.0.0.1", "--port", "0", *known],
        ["worker", "--nworkers", "2", "--nthreads", "1", "--host", "127.0.0.1", *known],
    )
    with contextlib.ExitStack() as stack:
        pids = []
        for words in commands:
            run = stack.enter_context(
                subprocess.Popen(
                    [sys.executable, "-m", "dask", *words],
                    cwd=file.parent,
                    env={**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'tests'}"},
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                )
            )
            stack.callback(run.terminate)
            pids.append(run.pid)
        while not (file.exists() and file.read_text().endswith("}")):  # it is not written at once
            time.sleep(0.02)
        found = json.loads(file.read_text())["address"]
        with distributed.Client(found) as client:
            client.wait_for_workers(2, timeout=60)
        yield found, pids[0]


def timeless(folder: Path) -> list[str]:
    return sorted(json.dumps({**row, "cost": None}) for row in read_rows(folder))


def test_the_rows_are_those_of_one_machine_even_if_a_worker_is_killed(site, address, tmp_path):
    with ThreadPoolExecutor(1) as pool:
        run_batch(site / "post.yaml", site / "scans", tmp_path / "here", JOB, executor=pool)
    with distributed.Client(address) as client:
        pids = list(client.run(os.getpid).values())

    def kill_one(_row: object) -> None:
        if pids:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pids.pop(), signal.SIGKILL)
            pids.clear()

    with cluster(address, timeout=600.0) as executor:
        there = tmp_path / "there"
        summary = run_batch(
            site / "post.yaml", site / "scans", there, JOB, executor=executor, on_row=kill_one
        )
    assert summary.statuses == {"ok": 12, "failed": 1}
    assert timeless(there) == timeless(tmp_path / "here")


def test_one_worker_is_a_cluster_and_two_run_side_by_side() -> None:
    with cluster("local", workers=1) as one, cluster("local", workers=1) as other:
        assert [pool.submit(double, 4).result(60) for pool in (one, other)] == [8, 8]


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_what_kills_its_worker_or_hangs_is_told(site: Path, address: str, tmp_path: Path) -> None:
    (tmp_path / "scans").mkdir()
    for name in ("good", "hang", "sigkill", "sigsegv"):
        shutil.copy(site / "scans" / "s00.npz", tmp_path / "scans" / f"{name}.npz")
    with cluster(address) as pool, cluster(address, timeout=0.5) as impatient:
        there, both = tmp_path / "there", Saboteur(pool, impatient)
        run_batch(site / "post.yaml", tmp_path / "scans", there, JOB, executor=both)
    found = {row["scans"]: (row["status"], row["code"]) for row in read_rows(there)}
    assert found == {
        "good.npz": ("ok", None), "hang.npz": ("timeout", None), "sigkill.npz": ("crashed", 9),
        "sigsegv.npz": ("crashed", 11),
    }  # fmt: skip


def test_the_command_runs_there(site: Path, address: str, tmp_path: Path) -> None:
    words = ["batch", site / "post.yaml", site / "scans" / "s00.npz", "--out", tmp_path / "out"]
    run = call(*words, "--dask", address, "--method", "cbml", "--cell", 0.2, "--no-cache")
    assert (run.code, run.out.splitlines()[0]) == (0, "1 items: 1 ok"), run.err


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_a_scheduler_that_ends_answers_for_no_item(site: Path, tmp_path: Path) -> None:
    (tmp_path / "scans").mkdir()
    for k in range(16):
        shutil.copy(site / "scans" / f"s{k % 12:02d}.npz", tmp_path / "scans" / f"s{k:02d}.npz")
    words = ["batch", site / "post.yaml", tmp_path / "scans", "--out", tmp_path / "out"]
    words += ["--method", "cbml", "--cell", 0.05, "--no-cache"]
    rows = tmp_path / "out" / "results.jsonl"
    with started(tmp_path) as (there, scheduler):
        run = subprocess.Popen(command([*words, "--dask", there]), stderr=subprocess.PIPE)
        while run.poll() is None and not (rows.exists() and rows.stat().st_size):
            time.sleep(0.005)
        os.kill(scheduler, signal.SIGKILL)
        _, said = run.communicate(timeout=60)
    assert run.returncode == 1
    assert said.decode().splitlines() == [
        "imgloc: 16 items: 1 maps, 16 files of scans",
        "imgloc: error: the cluster is lost; what is done is kept, --resume goes on",
    ]
    statuses = [row["status"] for row in read_rows(tmp_path / "out")]
    assert 1 <= len(statuses) < 16
    assert set(statuses) == {"ok"}
    again = call(*words, "--resume", "--workers", 2)
    assert again.out.startswith("16 items: 16 ok"), again.err
    assert f"\n{16 - len(statuses)} new rows" in again.out


def test_no_cluster_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("imgloc.runs.cluster._WAIT", 0.5)
    with pytest.raises(ConfigError, match="no cluster with a worker"), cluster("tcp://127.0.0.1:9"):
        pass


def test_items_share_the_memory_of_their_machine(address: str) -> None:
    with cluster(address) as executor:
        # Two workers of a thread each on one machine, which others use, too.
        assert default_budget() / 4 < executor.memory_share < default_budget()
