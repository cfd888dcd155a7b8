"""The benchmark: its references compute what the engines do, and its numbers are of its work."""

import json
import shutil

import numpy as np
import pytest

from imgloc.errors import ConfigError
from imgloc.features.scanpoints import scan_points, scan_xy
from imgloc.geometry import uniform_thetas
from imgloc.io.maps import save_map
from imgloc.io.scans import save_scans
from imgloc.likelihoods.cbml import cbml
from imgloc.likelihoods.ght import ght
from imgloc.options import Sensor
from imgloc.pipeline import prepare
from imgloc.simulation.scans import simulate
from imgloc.simulation.worlds import WORLDS, render
from tools.bench.__main__ import (
    PAIR_HEADINGS,
    added,
    answer_summary,
    answer_times,
    as_row,
    bench_tables,
    exhaustive_search,
    gathered,
    huge_map,
    in_turns,
    main,
    stack_cases,
    vote_cases,
)


@pytest.fixture(scope="module")
def case():
    grid = render(WORLDS["curved"](), 0.2)
    return prepare(grid, cell=0.2), simulate(grid, 1, 0, Sensor(rays=31)).scans[0]


def test_the_plain_references_are_right(case):
    features, scan = case
    thetas, cell = uniform_thetas(np.pi / 2), features.lattice.resolution
    xy = scan_xy(scan)[scan.valid]
    plain = gathered(features.bmap, xy, thetas, cell)
    np.testing.assert_allclose(plain, cbml(features.bmap, xy, thetas, cell), atol=0.5 / 255 * 31)
    points = scan_points(scan.ranges, scan.angles, scan.valid)
    votes = ght(features.surface, points, PAIR_HEADINGS, features.lattice.shape, cell)
    same = (added(features, scan) == votes).mean()
    assert same > 0.99  # a vote on the border of a cell may be rounded into the next


def test_cases_take_turns():
    calls = []
    timings = in_turns(
        [("a", "call", 2, lambda: calls.append("a")), ("b", "call", 1, lambda: calls.append("b"))],
        3,
    )
    assert "".join(calls) == "ababbaab"
    assert [len(t.seconds) for t in timings] == [3, 3]
    assert timings[0].cost == pytest.approx(1e9 * timings[0].median / 2)
    with pytest.raises(ConfigError):
        in_turns([], 0)


def test_every_case_runs_and_counts_its_work(case):
    features, scan = case
    cases = stack_cases(features, scan, threads=2) + vote_cases(*case, threads=2)
    timings = in_turns(cases, 1)
    names = [t.name for t in timings]
    assert len(set(names)) == len(names)
    assert {"cbml auto", "cbml-o auto", "ght-v"} <= set(names)
    assert all(t.work > 0 and t.median > 0 for t in timings)


needs_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")


@needs_compiler
def test_a_search_in_c(shared):
    assert 1 < exhaustive_search(shared / "problem", 1) < 10_000


@needs_compiler
def test_the_least_of_some_runs_in_c_counts(tmp_path):
    (tmp_path / "floor").mkdir()
    counts = '#include <stdio.h>\nint main(int c, char **v) { FILE *f = fopen("%s", "a+"); '
    counts += 'fputs("x", f); printf("query median %%ld.5 ms", 10 - ftell(f)); return 0; }'
    (tmp_path / "floor" / "cbml.c").write_text(counts % (tmp_path / "runs"))
    assert exhaustive_search(tmp_path, 3) == 7.5
    assert exhaustive_search(tmp_path, 1) == 6.5


def test_the_first_answer_is_compared_with_the_median():
    summary = answer_summary([500.0, 100.0, 50.0, 50.0], 0.4)
    assert summary["prepare_s"] == 0.4
    assert summary["first_over_median"] == 10
    assert summary["median_ms"] == 50


def test_answers_are_measured(case):
    times = answer_times(case[0].grid, [case[1]], 1)
    assert set(times) == {"median_ms", "p99_over_median", "first_over_median", "prepare_s"}
    assert times["median_ms"] > 0
    assert times["p99_over_median"] == 1  # there is one
    with pytest.raises(ConfigError, match="scans"):
        answer_times(case[0].grid, [], 1)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--repeats", "0"], "repeats must be at least 1, got 0"),
        (["--threads", "0"], "threads must be at least 1, got 0"),
        (["--scans", "0"], "scans must be at least 1, got 0"),
        (["--parts", "cost"], "expected one of costs, localize, command, huge, got 'cost'"),
    ],
)
def test_the_tool_refuses_nonsense(words, expected, capsys):
    assert main(words) == 2
    assert capsys.readouterr() == ("", f"bench: error: {expected}\n")


def test_the_tool_prints_what_is_asked_for(tmp_path, capsys):
    grid = render(WORLDS["curved"](), 0.2)
    path = tmp_path / "office" / "map.yaml"
    path.parent.mkdir()
    save_map(path, grid)
    save_scans(path.with_name("scans.npz"), simulate(grid, 2, 0, Sensor(rays=31)))
    words = ["--parts", "localize", "--scans", "1", "--threads", "1", "--repeats", "1"]
    assert main([*words, "--sets", str(path)]) == 0
    out = capsys.readouterr().out
    assert "p99 / median" in out
    assert "| large |" in out
    assert "| office |" in out


def test_the_largest_map_by_itself(capsys):
    huge_map(300, 1)
    found = json.loads(capsys.readouterr().out)
    assert min(found.values()) > 0
    assert found["prepare"] + found["answer"] < 100
    text = bench_tables({"machine": {"cores": 2}, "huge": {"300 x 300": found}})
    assert f"| 300 x 300 | {found['prepare']:.1f} |" in text


def test_the_tables_of_the_tool(case):
    timings = in_turns([("nothing", "call", 1, lambda: None)], 1)
    answers = {"A": {"median_ms": 2.0, "p99_over_median": 1.5, "prepare_s": 0.5, "over_c": 0.256}}
    answers["A"]["first_over_median"] = 1.25
    command = {"help": 0.1, "localize_help": 0.12, "localize": 0.5, "item_ms": 60.4, "other": 0.9}
    command["one_over_two"] = 0.92
    text = bench_tables(
        {"machine": {"cores": 2}, "costs": [as_row(t) for t in timings],
         "localize": answers, "command": {"B": command},
         "yardstick": "no C compiler"}
    )  # fmt: skip
    assert "| nothing |" in text
    assert "| A | 2 | 1.50 | 1.25 | 0.50 | 0.26 |" in text
    assert "| B | 0.10 | 0.12 | 0.50 | 0.90 | 60 | 0.92 |" in text
    assert text.endswith("one thread: no C compiler")
    tables = [part.splitlines() for part in text.split("\n\n")[1:-1]]
    for lines in tables:  # as many cells in each line
        assert len({line.count("|") for line in lines}) == 1
