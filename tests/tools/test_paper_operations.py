"""The card's image operations beside each other: what is tried, and when one is called worse."""

import json
from dataclasses import replace

import pytest

from imgloc.errors import ConfigError
from imgloc.features.mapfeatures import MapFeatures
from imgloc.lab.evaluation import share
from imgloc.lab.performance_index import Index
from imgloc.likelihoods.correlate import ENGINES
from tools.paper.operations import (
    CARD,
    OPERATIONS,
    OperationRow,
    compare,
    main,
    markdown,
    render_operations,
    worse,
)
from tools.paper.table import Gain


@pytest.fixture(scope="module")
def rows():
    found = compare(2, 3, worlds=["curved"])
    return {(row.method, row.operation): row for row in found}


def test_every_operation_of_the_card_is_tried_and_the_default_comes_first(rows):
    assert list(rows) == [(method, op) for method, some in OPERATIONS.items() for op in some]
    assert {op for _, op in rows} >= {*CARD} & {*ENGINES, "image", "polar"}
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
        "a", "Fig.", "cbml", "dft", False, False, Index(3.0, 0.1, 40, 0, 1e-3), Gain(gain, error),
        hits, share([True] * 40), prepare_ms, ms, "",
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


def test_the_table_and_the_page_have_a_line_for_each(rows):
    some = [replace(row, worse="time of a scan < 2.0 x") for row in rows.values()]
    assert markdown(some).count("\n") == len(some) + 1
    page = render_operations(some, 2, 3)
    assert page.count("<tr>") == len(some) + len(OPERATIONS)
    assert page.count("●") == 1 + sum(row.card for row in some)  # and where it is explained
    assert "time of a scan &lt; 2.0 x" in page


def test_the_command_writes_both_files_and_overwrites_none(tmp_path, capsys):
    words = ["--out", str(tmp_path / "new"), "-n", "2", "--worlds", "curved"]
    assert main(words) == 0
    assert "| curved | ght-v | " in capsys.readouterr().out
    found = json.loads((tmp_path / "new" / "operations.json").read_text())
    assert len(found["rows"]) == sum(map(len, OPERATIONS.values()))
    assert (tmp_path / "new" / "operations.html").read_text().startswith("<!doctype html>")
    assert main(words) == 1
    assert "exists already" in capsys.readouterr().err
    assert main(["--out", str(tmp_path), "-n", "1"]) == 2
    with pytest.raises(ConfigError):
        compare(1)
