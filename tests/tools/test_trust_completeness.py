"""What a search misses beside a far wider one is counted."""

from dataclasses import replace

import numpy as np
import pytest
from command import run

from imgloc import prepare
from tools.recorded import in_world
from tools.trust import completeness
from tools.trust.__main__ import main
from tools.trust.completeness import Compared, compared, completeness_table


def test_a_search_that_lists_nothing_misses_all_of_the_mass(monkeypatch) -> None:
    grid, scans = in_world("visibility", 12, 5)
    features = prepare(grid)
    scan, pose = next(scans.with_poses())
    full = compared("undisturbed", features, scan, pose)
    assert full.missed < 0.01
    assert not full.above
    assert full.right == full.wider_right
    whole = completeness.find_adapted_modes

    def without(kept):
        def found(*given):
            all_found = whole(*given)
            return replace(
                all_found, poses=all_found.poses[kept], scores=all_found.scores.select(kept)
            )

        monkeypatch.setattr(completeness, "find_adapted_modes", found)
        return compared("undisturbed", features, scan, pose)

    blind = without(np.arange(0))
    assert blind.missed == pytest.approx(1.0)
    assert not blind.right
    beheaded = without(np.arange(1, 4))
    assert 0.5 < beheaded.missed < 1.0
    assert beheaded.above


def test_a_table_counts_what_is_missed() -> None:
    some = [
        Compared("people", 0.0, False, True, True), Compared("people", 0.05, True, False, True)
    ]  # fmt: skip
    assert completeness_table(some).splitlines()[2] == "| people | 2 | 1 | 0 | 1 | 1 | 2 |"


def test_the_command_prints_a_table() -> None:
    found = run(main, "completeness", "-n", 1, "--worlds", "curved", "--workers", 1).ends(0)
    assert found.out.splitlines()[-1].startswith("| all | 1 |")
