"""The benchmark: its references compute what the engines do, and its numbers are of its work."""

import numpy as np
import pytest

from imgloc.errors import ConfigError
from imgloc.experiments.bench import (
    PAIR_HEADINGS,
    added,
    gathered,
    in_turns,
    stack_cases,
    vote_cases,
)
from imgloc.experiments.bench_outside import floors, growth
from imgloc.experiments.scansets import Sensor, simulate_set
from imgloc.experiments.worlds import WORLDS, render
from imgloc.features.scanpoints import scan_points
from imgloc.geometry import uniform_thetas
from imgloc.likelihood.cbml import cbml
from imgloc.likelihood.ght import ght
from imgloc.pipeline import prepare
from imgloc.search.fused import scan_xy


@pytest.fixture(scope="module")
def case():
    grid = render(WORLDS["curved"](), 0.2)
    return prepare(grid, cell=0.2), simulate_set(grid, 1, 0, Sensor(rays=31)).scans[0]


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
    assert "".join(calls) == "abababab"
    assert [len(t.seconds) for t in timings] == [3, 3]
    assert timings[0].cost == pytest.approx(1e9 * timings[0].median / 2)
    with pytest.raises(ConfigError):
        in_turns([], 0)


def test_every_case_runs_and_counts_its_work(case):
    cases = stack_cases(*case, threads=2) + vote_cases(*case, threads=2)
    timings = in_turns(cases, 1)
    names = [t.name for t in timings]
    assert len(set(names)) == len(names)
    assert {"cbml auto", "cbml-o auto", "ght-v", "branch and bound, argmax"} <= set(names)
    assert all(t.work > 0 and t.median > 0 for t in timings)


def test_growth_is_measured_in_fresh_processes():
    one, four = growth("curved", (1, 2), 1)
    assert four["area"] == pytest.approx(4 * one["area"])
    assert one["ms"] > 0
    assert four["rss_mib"] > one["rss_mib"]


def test_floors_say_why_they_are_not_known(tmp_path):
    assert all(isinstance(value, str) for value in floors(tmp_path).values())


def test_floors_in_c(shared):
    found = floors(shared / "problem")
    assert set(found) == {"cbml", "ght", "ght-v"}
    assert all(isinstance(v, str) or 0 < v < 1000 for v in found.values())
