"""What `--memory-budget` does to any command: words in which {} is a folder."""

import logging
from collections.abc import Sequence
from pathlib import Path

import pytest
from command import call


def words(command: Sequence[object], folder: Path) -> list[object]:
    return [w.format(folder) if isinstance(w, str) else w for w in command]


def check_refused(
    command: Sequence[object], budget: str, expected: Sequence[str], folder: Path
) -> None:
    """Over a budget it is refused with sizes, and nothing is left in the folder."""
    code, out, err = call(*words(command, folder), "--memory-budget", budget)
    assert (code, out) == (2, "")
    assert "curved.yaml: " in err
    assert f"the budget is {budget.removesuffix('M')} MiB" in err
    assert err.strip().endswith("or raise --memory-budget")
    for text in expected:
        assert text in err
    assert not list(folder.iterdir())


def check_done(command: Sequence[object], folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Within a budget it is done, and -v says what it may take."""
    with caplog.at_level(logging.INFO):
        code, _, err = call(*words(command, folder), "--memory-budget", "2G", "-v")
    assert code == 0
    said = [line for line in (err + caplog.text).splitlines() if "at most" in line]
    assert said
    assert all(line.endswith("MiB, the budget is 2048 MiB") for line in said)
