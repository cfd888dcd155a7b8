"""The fuzzer finds what is planted, and goes on; its inputs are decided by the seed."""

import random
from pathlib import Path

import pytest
from command import run
from killers import stumble

pytest.importorskip("rosbags", reason="samples of bags: the extra ros")
pytest.importorskip("pyarrow", reason="a table of results: the extra parquet")

from tools.fuzz.__main__ import main
from tools.fuzz.mutate import mutate
from tools.fuzz.run import fuzz
from tools.fuzz.targets import TARGETS, Target

RUNS = 6
MEMORY = {"hang": 500 << 20, "die": 500 << 20, "swallow": 100 << 20}


def planted(kind: str) -> tuple[Target, int]:
    """A target that stumbles over nothing, and a seed that has it do so once."""

    def make(folder: Path) -> list[bytes]:
        (folder / f"planted-{kind}").touch()
        return [b"a"]

    def empty(seed: int, k: int) -> bool:
        return not mutate(random.Random(f"{seed} planted {k}"), [b"a"])

    seeds = (s for s in range(10_000) if [empty(s, k) for k in range(1, RUNS)].count(True) == 1)
    return Target("planted", make, stumble), next(seeds)


@pytest.mark.parametrize(
    ("kind", "found"),
    [
        ("hang", "overdue: "),
        ("die", "dead (the worker was ended by SIGSEGV)"),
        ("swallow", "memory: "),
    ],
)
def test_a_planted_defect_is_found_and_the_run_goes_on(tmp_path, kind, found):
    target, seed = planted(kind)
    count = fuzz(target, tmp_path / "out", seed=seed, runs=RUNS, limit=0.5, memory=MEMORY[kind])
    assert (count.executions, count.accepted, count.findings) == (RUNS, RUNS - 1, 1)
    (text,) = (tmp_path / "out").glob("planted-*.txt")
    assert text.read_text().startswith(found)
    assert "in stumble" in text.read_text() or kind == "swallow"
    assert text.with_suffix(".input").read_bytes() == b""


def test_the_command_says_a_line_a_target_and_whether_all_is_well(tmp_path, monkeypatch):
    target, seed = planted("key")
    monkeypatch.setitem(TARGETS, "planted", target)
    again = ("--runs", RUNS, "--seed", seed, "--out", tmp_path / "out")
    done = run(main, "planted", "pairs", *again).ends(1)
    first, second = done.out.splitlines()
    assert first.split()[:6] == ["planted", "6", "executions", "5", "accepted", "1"]
    assert " 0 findings" in second
    (text,) = (tmp_path / "out").glob("planted-*.txt")
    assert text.read_text().startswith("KeyError: ")
    alone = run(main, "pairs", *again)  # the same inputs
    assert (alone.code, alone.out.split()[-1]) == (0, second.split()[-1])
    assert run(main, "nonsense", *again).code == 2


@pytest.mark.parametrize("name", ["rows-localize", "map-index", "mcap"])
def test_samples_are_the_same_each_time(tmp_path: Path, name: str) -> None:
    made = []
    for k in range(2):
        (tmp_path / f"{k}").mkdir()
        made.append(TARGETS[name].make(tmp_path / f"{k}"))
    assert made[0] == made[1]
