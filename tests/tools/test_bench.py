"""The benchmark: its references compute what the engines do, and its numbers are of its work."""

import json
import shutil
import sys
from dataclasses import astuple, replace

import numpy as np
import pytest

from imgloc import ConfigError, Pose2D, Sensor, prepare, save_map, save_scans, simulate
from imgloc.features.scanpoints import scan_points, scan_xy
from imgloc.geometry import in_grid_frame, uniform_thetas
from imgloc.likelihoods.cbml import cbml
from imgloc.likelihoods.ght import ght
from imgloc.simulation.worlds import WORLDS, render
from tools.bench.__main__ import (
    PAIR_HEADINGS,
    added,
    answer_times,
    bench_tables,
    gathered,
    huge_map,
    in_turns,
    main,
    stack_cases,
    vote_cases,
)
from tools.bench.arithmetic import STEPS, Kernels
from tools.bench.peers import beside


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
    assert [t["case"] for t in timings] == ["a", "b"]
    assert timings[0]["ns"] == pytest.approx(1e6 * timings[0]["ms"] / 2)
    with pytest.raises(ConfigError):
        in_turns([], 0)


def test_every_case_runs_and_counts_its_work(case):
    features, scan = case
    cases = stack_cases(features, scan, threads=2) + vote_cases(*case, threads=2)
    timings = in_turns(cases, 1)
    names = [t["case"] for t in timings]
    assert len(set(names)) == len(names)
    assert {"cbml auto", "cbml-o auto", "ght-v"} <= set(names)
    assert all(t["ns"] > 0 and t["ms"] > 0 for t in timings)


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_the_arithmetic_of_an_answer_in_c_has_its_results(case):
    features, scan = case
    steps = Kernels().replay(features, scan)
    assert set(steps) == set(STEPS)
    assert all(step.ms > 0 and len(step.differs) > 100 for step in steps.values())
    assert steps["correlate"].differs.max() == steps["sums_under"].differs.max() == 0
    assert np.quantile(steps["refine"].differs, 0.9) < 1e-3  # rounding decides where a few go
    assert np.quantile(steps["cast_along"].differs, 0.99) < 0.02


def test_answers_are_measured(case):
    times = answer_times(case[0].grid, [case[1]], 1)
    assert {"median_ms", "p99_over_median", "first_over_median", "prepare_s"} < set(times)
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


def peer_in(folder, answers):
    """A program of the protocol that answers what it is to, whatever the scan."""
    folder.mkdir(exist_ok=True)
    lines = [f"#!{sys.executable}", "import sys, cv2", "image = cv2.imread(sys.argv[1], -1)"]
    lines += [f"print(image.shape, float(sys.argv[2]), flush=True)\nanswers = {answers!r}"]
    lines += ["for line, answer in zip(sys.stdin, answers): print(answer, flush=True)"]
    (folder / "peer").write_text("\n".join(lines))
    (folder / "peer").chmod(0o755)
    (folder / "README").write_text("no program")


def test_a_peer_answers_beside_imgloc(tmp_path, capsys):
    grid = render(WORLDS["curved"](), 0.2)
    grid = replace(grid, origin=Pose2D(-3.0, 2.0, 0.5))
    told = simulate(grid, 4, 0, Sensor(rays=61))
    (x, y, theta), *_ = (astuple(in_grid_frame(Pose2D(*pose), grid)) for pose in told.poses)
    peer_in(tmp_path, [f"{x + 0.3} {y} {theta + 6.4}", "", "1 2 3", "1 2 3"])
    row = beside(grid, told, tmp_path, 60.0, 7)["peer"]
    assert (row["scans"], row["right"], row["own"]) == (4, 1, 4)
    assert row["ms"] >= 0
    assert row["own_ms"] > 1
    text = bench_tables({"machine": {"cores": 2}, "peers": {"A, peer": row | {"ms": 30.0}}})
    assert "| A, peer | 4 | 1 | 4 | 30 |" in text
    path = tmp_path / "set" / "map.yaml"
    path.parent.mkdir()
    save_map(path, grid)
    save_scans(path.with_name("scans.npz"), told)
    words = ["--parts", "", "--sets", str(path), "--scans", "2", "--repeats", "1"]
    assert main([*words, "--peers", str(tmp_path)]) == 0
    assert "| set, peer | 2 | " in capsys.readouterr().out


@pytest.mark.parametrize(
    ("answers", "expected"),
    [(["here"], "peer: expected x y theta, got 'here'"), ([], "peer ended before it answered")],
)
def test_a_peer_that_fails_ends_the_bench(answers, expected, tmp_path):
    grid = render(WORLDS["curved"](), 0.2)
    peer_in(tmp_path, answers)
    empty = tmp_path / "empty"
    empty.mkdir()
    with pytest.raises(ConfigError, match=expected):
        beside(grid, simulate(grid, 1, 0, Sensor(rays=61)), tmp_path, 60.0, 0)
    with pytest.raises(ConfigError, match="expected programs"):
        beside(grid, simulate(grid, 1, 0, Sensor(rays=61)), empty, 60.0, 0)
