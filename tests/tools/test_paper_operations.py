"""The card's image operations beside each other: what is tried, and when one is called worse."""

import pytest

from imgloc.features.mapfeatures import MapFeatures
from imgloc.lab.evaluation import share
from imgloc.lab.performance_index import Index
from imgloc.likelihoods.correlate import ENGINES
from tools.paper.operations import OPERATIONS, OperationRow, compare, main, worse
from tools.paper.table import Gain


@pytest.fixture(scope="module")
def rows():
    found = compare(2, 3, worlds=["curved"])
    return {(row.method, row.operation): row for row in found}


def test_every_operation_of_the_card_is_tried_and_the_default_comes_first(rows):
    assert list(rows) == [(method, op) for method, some in OPERATIONS.items() for op in some]
    assert {op for _, op in rows} >= {*ENGINES, "image", "polar"}  # those that the card names
    defaults = {method: some[0] for method, some in OPERATIONS.items()}
    assert defaults == {
        "cbml": "auto", "cbml-o": MapFeatures.vmap_from, "ght-v": MapFeatures.visibility_by
    }  # fmt: skip
    assert {key for key, row in rows.items() if row.default} == set(defaults.items())


def test_exact_engines_give_the_same_and_other_operations_do_not(rows):
    exact = {rows["cbml", op].index.value for op in ("auto", "filter2d", "shift", "dft")}
    assert max(exact) - min(exact) < 1e-6
    for method in ("cbml-o", "ght-v"):
        one, other = (rows[method, op] for op in OPERATIONS[method])
        assert one.index != other.index
        assert abs(one.index.value - other.index.value) < 0.5
        paired = other.index.value - one.index.value
        assert other.gain.value == pytest.approx(paired, abs=1e-9)
    assert all(row.ms > 0 and row.prepare_ms > 0 for row in rows.values())


def made(gain=0.0, error=0.01, exact=20, prepare_ms=10.0, ms=5.0):
    """A row of 40 scans."""
    hits = share([True] * exact + [False] * (40 - exact))
    return OperationRow(
        "a", "cbml", "dft", Index(3.0, 0.1, 40, 0, 1e-3), Gain(gain, error),
        hits, share([True] * 40), prepare_ms, ms,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({}, ""),
        ({"gain": -0.019}, ""),
        ({"gain": -0.021}, "S by 0.02 ± 0.01"),
        ({"gain": -0.004, "error": 0.0}, ""),
        ({"gain": 1.0, "exact": 40, "ms": 1.0}, ""),
        ({"exact": 17}, ""),
        ({"exact": 10}, "hits (exact) 10 for 20 of 40"),
        ({"prepare_ms": 10.9, "ms": 10.0}, "time of a scan 2.0 x"),
        ({"prepare_ms": 31.0}, "time of a map 3.1 x"),
    ],
)
def test_worse_is_what_can_be_measured(changed, said):
    assert worse(made(**changed), made()) == said


def test_the_command_prints_a_line_for_each_and_refuses_one_scan(capsys):
    assert main(["-n", "2", "--worlds", "curved"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 2 + sum(map(len, OPERATIONS.values()))
    assert {line.count("|") for line in lines} == {11}
    assert sum(", default |" in line and line.endswith("|  |") for line in lines) == 3
    assert main(["-n", "1"]) == 2
    assert "n must be at least 2" in capsys.readouterr().err
