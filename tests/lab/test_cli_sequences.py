"""`imgloc evaluate --sequence`: filters along a log."""

from pathlib import Path

import pytest
from command import call, rows
from test_cli_track import MAP, log  # noqa: F401  (a fixture)


def test_sequences_are_evaluated(log: Path) -> None:  # noqa: F811
    words = ("--scans", log, "--sequence", "--starts", 2, "--metres", 3)
    run = call("evaluate", MAP, *words, "--json")
    assert run.code == 0, run.err
    (row,) = rows(run.out)
    assert row["filter"] == "tracker"
    assert row["odometry"] == "recorded"
    assert row["right"]["2"]["value"] == 1.0
    assert row["wrong"] == 0
    assert call("evaluate", MAP, "--sequence").code == 2
    assert call("evaluate", MAP, *words, "--filter", "kalman").code == 2


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--sequence", "-n", 5), "-n: is for evaluate without --sequence, not for"),
        (("--sequence", "--method", "cbml"), "--method: is for evaluate without --sequence"),
        (("--sequence", "--sample", 5), "--sample: is for evaluate without --sequence"),
        (("--starts", 5), "--starts: is for evaluate --sequence, not for evaluate without"),
        (("--no-resets",), "--resets: is for evaluate --sequence, not for"),
    ],
)
def test_an_option_of_the_other_evaluation_is_refused(
    log: Path,  # noqa: F811
    words: tuple[object, ...],
    said: str,
) -> None:
    run = call("evaluate", MAP, "--scans", log, *words)
    assert (run.code, run.out) == (2, "")
    assert said in run.err
