"""Workers that die, hang and fail: each costs its task, and no other."""

import importlib
import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import CancelledError

import pytest
from command import ROOT
from killers import complain, die, double, fail, hang, leave, process, swallow

from imgloc.runs.workers import CrashError, OverdueError, Supervised, call_in_child

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")


def test_what_dies_costs_itself_alone() -> None:
    with Supervised(2) as pool:
        good = [pool.submit(double, k) for k in range(10)]
        killed, torn = pool.submit(die, signal.SIGKILL), pool.submit(die, signal.SIGSEGV)
        left, failed = pool.submit(leave, 3), pool.submit(fail, "lost")
        good += [pool.submit(double, k) for k in range(10, 20)]
        assert [f.result() for f in good] == [2 * k for k in range(20)]
        for future, code, number in ((killed, -9, 9), (torn, -11, 11), (left, 3, None)):
            error = future.exception()
            assert isinstance(error, CrashError)
            assert (error.code, error.signal) == (code, number)
        assert "SIGSEGV" in str(torn.exception())
        with pytest.raises(LookupError, match="lost"):
            failed.result()


def test_the_last_words_of_a_worker_are_kept_and_are_few() -> None:
    with Supervised(1) as pool:
        error = pool.submit(complain, "first " + "word\n" * 200 + "last").exception()
    assert isinstance(error, CrashError)
    assert error.last_words.endswith("word word last")
    assert len(error.last_words) == 400
    with Supervised(1) as pool:  # what a library prints is no result
        error = pool.submit(complain, "printed", to=1).exception()
    assert isinstance(error, CrashError)
    assert (error.code, error.last_words) == (3, "printed")


def test_what_hangs_is_ended() -> None:
    with Supervised(1, timeout=0.5) as pool:
        hung = pool.submit(hang)
        with pytest.raises(OverdueError, match=r"more than 0\.5 s"):
            hung.result()
    with Supervised(1) as pool:  # without a limit a task is not ended
        assert pool.submit(double, 1).result() == 2


def test_what_a_task_needs_to_begin_is_not_of_its_time(tmp_path, monkeypatch):
    lines = ("import sys, time", "if sys.argv[0] == '-c':  # in a worker", "    time.sleep(2.0)",
             "def triple(value):", "    return 3 * value")  # fmt: skip
    (tmp_path / "slow_to_import.py").write_text("\n".join(lines))
    monkeypatch.syspath_prepend(tmp_path)
    with Supervised(1, timeout=1.5) as pool:
        assert pool.submit(importlib.import_module("slow_to_import").triple, 2).result() == 6


def test_memory_has_a_limit() -> None:
    with Supervised(1, memory_limit=64 << 20) as pool:
        assert pool.submit(swallow, 8).result() == 8 << 20
        with pytest.raises(MemoryError):
            pool.submit(swallow, 256).result()
        assert pool.submit(swallow, 8).result() == 8 << 20


def test_a_pool_ends_at_once_when_it_is_told_so() -> None:
    pool = Supervised(1)
    running, waiting = pool.submit(hang), pool.submit(double, 1)
    while not running.running():
        time.sleep(0.01)
    pool.shutdown(cancel_futures=True)  # waits for its threads: that it comes back is the test
    assert isinstance(running.exception(), CrashError)
    with pytest.raises(CancelledError):
        waiting.result()
    with pytest.raises(RuntimeError, match="closed"):
        pool.submit(double, 1)


class Held:
    """Is pickled once it may be: until then there is no worker."""

    def __init__(self) -> None:
        self.asked, self.may = threading.Event(), threading.Event()

    def __reduce__(self):
        self.asked.set()
        self.may.wait(60)
        return float, ("600",)


def test_a_worker_that_is_not_there_yet_is_ended_too() -> None:
    pool, held = Supervised(1), Held()
    running = pool.submit(hang, held)
    assert held.asked.wait(60)
    pool.shutdown(wait=False, cancel_futures=True)
    held.may.set()
    assert isinstance(running.exception(60), CrashError)


def test_there_are_no_more_workers_than_tasks() -> None:
    with Supervised(64, module="killers") as pool:
        assert len(pool._threads) == 1
        assert pool.submit(double, 1).result() == 2
        both = [pool.submit(hang), pool.submit(hang)]
        while not all(future.running() for future in both):
            time.sleep(0.01)
        assert len(pool._threads) == 2
        pool.shutdown(cancel_futures=True)


def test_what_cannot_be_pickled_is_an_error() -> None:
    with Supervised(1) as pool:
        with pytest.raises((AttributeError, TypeError)):
            pool.submit(lambda: 1).result()
        with pytest.raises((AttributeError, TypeError)):
            pool.submit(double, threading.Lock()).result()
        assert pool.submit(double, 2).result() == 4


class Task:
    def __init__(self, group):
        self.group = group


def test_a_worker_has_tasks_of_one_group_as_long_as_there_are_any() -> None:
    tasks = [Task(group) for group in "aaaabbbb"]
    with Supervised(2) as pool:
        with pool._more:  # no worker looks before all are there
            found = [(t.group, pool.submit(process, t)) for t in tasks]
        pids = {g: {f.result() for group, f in found if group == g} for g in "ab"}
    # Whoever is done first may help the other one, but begins with what nobody has.
    assert min(len(p) for p in pids.values()) == 1


def test_a_cluster_s_thread_has_a_worker_of_its_own() -> None:
    first = call_in_child(None, None, process, 0)
    assert first != os.getpid()
    assert call_in_child(None, None, process, 0) == first
    with pytest.raises(CrashError):
        call_in_child(None, None, die, signal.SIGKILL)
    with pytest.raises(OverdueError):
        call_in_child(0.5, None, hang)
    assert call_in_child(None, None, double, 4) == 8


def test_a_program_ends_though_it_has_not_closed_its_pool() -> None:
    code = (
        "import sys; sys.path[:0] = sys.argv[1:]\n"
        "from killers import double\n"
        "from imgloc.runs.workers import Supervised\n"
        "pool = Supervised(1)\n"
        "print(pool.submit(double, 2).result())\n"
    )
    words = [sys.executable, "-c", code, str(ROOT), str(ROOT / "tests")]
    done = subprocess.run(words, capture_output=True, timeout=30, check=True)
    assert done.stdout.split() == [b"4"]


def test_workers_do_not_outlive_a_program_that_is_killed() -> None:
    code = (
        "import sys; sys.path[:0] = sys.argv[1:]\n"
        "from killers import hang, process\n"
        "from imgloc.runs.workers import Supervised\n"
        "pool = Supervised(1)\n"
        "print(pool.submit(process, 0).result(), flush=True)\n"
        "pool.submit(hang).result()\n"
    )
    words = [sys.executable, "-c", code, str(ROOT), str(ROOT / "tests")]
    with subprocess.Popen(words, stdout=subprocess.PIPE) as run:
        pid = int(run.stdout.readline())
        os.kill(pid, 0)  # it is there
        run.kill()
    for _ in range(1000):
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            return
        with open(f"/proc/{pid}/stat") as file:  # noqa: PTH123
            if file.read().rsplit(") ")[-1].startswith("Z"):
                return  # ended; whoever is its parent now has not noticed
        time.sleep(0.02)
    pytest.fail(f"process {pid} is still there")
