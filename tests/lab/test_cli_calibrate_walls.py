"""`imgloc calibrate --scans` on maps that others drew, from the command line."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command import call, rows
from walls import GRID, THICK, N, drawn, thick_in
from walls import bent as bent_in

from imgloc.io.scans import load_scans, save_scans
from imgloc.search.adapt import BENT


@pytest.fixture(scope="module")
def thick(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a map whose walls are too thick."""
    return thick_in(tmp_path_factory.mktemp("thick"))


@pytest.fixture
def bent(tmp_path: Path) -> Path:
    """A folder with a map on which each block of 1.5 m stands 0.2 m off, any way."""
    return drawn(tmp_path, bent_in(GRID, 15))


def test_scans_that_fit_nowhere_alone_calibrate_a_map_together(bent: Path) -> None:
    files, kept = (bent / "map.yaml", bent / "log.npz"), bent / "map.calibration.json"
    alone = np.load(files[1])
    np.savez(bent / "alone.npz", **{name: alone[name] for name in alone if name != "odom"})
    run = call("calibrate", files[0], "--scans", bent / "alone.npz", "--scans-index", "::5")
    assert (run.code, run.out) == (2, "")
    assert "expected at least 5 to say what error they share" in run.err
    assert "Scans of a log with odometry need not fit one by one" in run.err
    run = call("calibrate", files[0], "--scans", files[1], "--scans-index", "::2").ends(0)
    content = json.loads(kept.read_text())
    shared, about = content["shared"], content["about"]["shared"]
    assert shared["bent"] == BENT
    assert 0.5 < shared["usual"] < 1.5
    assert about["asked"] == N // 2
    assert about["metres"] == pytest.approx(0.5 * (N - 2), abs=0.5)
    assert f"{about['used']} of {N // 2} are at sure places" in run.out
    assert "stands 0.15 m off" in run.out
    assert f"lack {shared['usual']:.1f} nats per reading here" in run.out
    for row in rows(call("localize", *files, "--json", "--sample", 1).out):
        assert row["parameters"]["shared"] == shared


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--scans", "log.npz", "--rays", 90], "--rays: is for calibrate without --scans"),
        (["--scans-index", "3"], "--scans-index: is for calibrate --scans"),
        (["--scans", "log.npz", "--scans-index", 99], "--scans-index: got 99, expected 0 to 23"),
        (["--range-scale", 0], "--range-scale: is no option here; imgloc convert LOG scans.npz"),
    ],
)
def test_calibrate_reads_a_log_as_localize_does(thick, words, expected):
    given = [thick / word if word == "log.npz" else word for word in words]
    run = call("calibrate", thick / "map.yaml", *given).ends(2, out="")
    assert expected in " ".join(run.err.split())


def test_calibrate_takes_what_convert_has_made(thick: Path) -> None:
    recorded = load_scans(thick / "log.npz")
    mirrored = tuple(scan.flipped.scaled(1000) for scan in recorded.scans)
    save_scans(thick / "mm.npz", replace(recorded, scans=mirrored))
    made = thick / "made.npz"
    call("convert", thick / "mm.npz", made, "--flipped", "--range-scale", 0.001).ends(0)
    words = ("--scans", made, "--scans-index", "::4", "--dry-run", "--json")
    (found,) = rows(call("calibrate", thick / "map.yaml", *words).ends(0).out)
    assert found["asked"] == N // 4
    assert found["shared"]["thinner"] == THICK
