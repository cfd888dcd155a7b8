"""The tools that measure and draw tracks."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from imgloc import LaserScan, Options, ScanSet, load_map, load_scans, prepare, save_map, save_scans
from imgloc.filters.evidence import Places
from imgloc.filters.follow import with_odometry
from imgloc.simulation.scans import simulate_ranges
from imgloc.simulation.worlds import WORLDS, render
from tools import blackouts, drive, old_maps, sequences
from tools.filters import Run, Searches, Trials, measure

ANGLES = np.deg2rad(np.arange(-180, 180, 4.0))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("data") / "hall"
    path.mkdir()
    grid = render(WORLDS["visibility"](), 0.1)
    save_map(path / "map.yaml", grid)
    poses = np.array([[4.0 + 0.5 * k, 8.0, 0.0] for k in range(7)])
    ranges = simulate_ranges(render(WORLDS["visibility"](), 0.05), poses, ANGLES, seed=1)
    scans = tuple(LaserScan(r, ANGLES, range_max=30.0) for r in ranges)
    save_scans(path / "scans.npz", ScanSet(scans, poses, np.arange(7.0)))
    return path


def test_a_table_and_a_track(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    words = f"x {folder} --out {tmp_path} --starts 1 --seconds inf --kidnaps 0 --metres 2"
    monkeypatch.setattr(sys, "argv", [*words.split(), "--cases", "tracker;particle, G*"])
    sequences.main()
    rows = [json.loads(line) for line in (tmp_path / "sequences.jsonl").read_text().splitlines()]
    names = ["tracker", "particle, GHT-V"]
    assert [row["filter"] for row in rows] == names
    assert all(row["odometry"].startswith("of the poses") for row in rows)
    assert rows[0]["right"]["1"]["value"] == 1.0
    assert "| hall | tracker |" in (tmp_path / "sequences.md").read_text()


def test_searches_that_are_shared_change_nothing_but_the_time(folder: Path, tmp_path: Path) -> None:
    """However many starts and kidnappings: each scan is searched once, or on another day."""
    features = prepare(load_map(folder / "map.yaml"), cell=0.2)
    log = with_odometry(load_scans(folder / "scans.npz"))[0]
    trials = Trials(starts=3, metres=2.0, kidnaps=1, seconds=np.inf)
    done: list[int] = []

    class Forgets(Searches):
        def __call__(self, scan: LaserScan) -> Places:
            done.append(id(scan))
            return self.anew(scan)[0]

    def run(searches: Searches) -> dict[str, object]:
        found = measure(features, log, "tracker", trials, Options(), searches=searches)
        return {key: repr(value) for key, value in found.items() if key != "speed"}

    expected = run(Forgets(features, Options()))
    assert len(done) > len(set(done))
    assert run(Searches(features, Options())) == expected
    first = Searches(features, Options(), tmp_path / "kept")
    assert run(first) == expected
    first.save()
    again = Searches(features, Options(), tmp_path / "kept")
    again.features = None  # type: ignore[assignment]  # of no use: nothing is searched
    assert run(again) == expected
    assert again.clock == first.clock > 0
    other = Searches(features, Options(top=1), tmp_path / "kept")
    other.features = None  # type: ignore[assignment]
    with pytest.raises(AttributeError):
        other(log[0])


def test_what_was_found_is_kept_when_it_is_stopped(folder: Path, tmp_path: Path) -> None:
    def stop() -> None:
        raise KeyboardInterrupt

    trials = Trials(starts=1, metres=1.0, kidnaps=0, seconds=np.inf)
    rows = sequences.measure_log(folder, sequences.CASES[:1], trials, stop, tmp_path)
    with pytest.raises(KeyboardInterrupt):
        next(rows)
    (kept,) = tmp_path.glob("*.npz")
    with np.load(kept) as found:
        assert len(found) >= 1


def test_scans_are_cut_and_stopped() -> None:
    scan, rng = LaserScan(np.full(90, 8.0), ANGLES, range_max=30.0), np.random.default_rng(0)
    near = sequences.near(scan, rng)
    assert np.rad2deg(np.abs(near.angles)).max() <= 45
    assert near.range_max == 5.0
    assert not near.valid.any()
    stopped = sequences.stopped(scan, rng)
    assert 0.15 < np.mean(stopped.ranges < 8.0) < 0.45
    assert stopped.ranges.min() > 0.5


def test_a_way_keeps_off_the_walls() -> None:
    grid = render(WORLDS["corridor"](), 0.1)
    poses = drive.path_between(grid, np.array(drive.STOPS[0]), 0.25)
    cells = np.floor(poses[:, 1::-1] / 0.1).astype(int)
    assert grid.free[tuple(cells.T)].all()
    steps = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    assert steps.max() < 0.27
    heading = np.arctan2(*np.diff(poses[:, :2], axis=0).T[::-1])
    assert np.median(np.abs(heading - poses[:-1, 2])) < 0.1
    with pytest.raises(ValueError, match="free"):
        drive.path_between(grid, np.array([[0.1, 0.1], [14.0, 5.0]]), 0.25)


def test_a_blind_sensor_says_what_its_kind_says(folder: Path) -> None:
    scans = load_scans(folder / "scans.npz")
    for kind in blackouts.KINDS:
        dark = blackouts.blinded(scans, range(2, 4), kind)
        same = [np.array_equal(a.ranges, b.ranges, equal_nan=True)
                for a, b in zip(scans.scans, dark.scans, strict=True)]  # fmt: skip
        assert same == [True, True, False, False, True, True, True]
    frozen = blackouts.blinded(scans, range(2, 4), "frozen")
    np.testing.assert_array_equal(frozen[3].ranges, scans[1].ranges)


def test_moments_of_a_blackout_are_counted() -> None:
    """Blind at 2 and 3; unique but for 3; wrong at 2; too wide at 4; right but there."""
    error, spread = np.zeros((8, 2)), np.zeros((8, 2))
    error[2, 0], spread[4, 1] = 1.5, 3.0
    unique, square = np.ones(8), np.zeros(8)
    unique[3], square[:3] = 0.0, 100.0
    metres = np.arange(8) * 2.0
    run = Run(metres, metres, error, unique, np.zeros(8), 0.0, spread, square, unique)
    row = blackouts.row_of("hall", "NaN", "4 m", [(run, range(2, 4))])
    counts = {k: row[k] for k in ("trials", "unique", "wrong", "late", "dark", "moments", "worst")}
    assert list(counts.values()) == [1, 7, 1, 1, 1, 2, 1.5]
    assert (row["found"], row["published"]) == (1.0, 1.0)
    assert row["inside"] == pytest.approx(4 / 7)


def test_old_maps_have_a_row_for_the_true_start_and_one_for_starts_from_anywhere(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    scans = with_odometry(load_scans(folder / "scans.npz"))[0]
    old = folder.parent / "old"
    old.mkdir()
    (old / "map.yaml").write_text((folder / "map.yaml").read_text())
    (old / "map.png").write_bytes((folder / "map.png").read_bytes())
    save_scans(old / "scans.npz", scans)
    monkeypatch.setattr(sys, "argv", ["old_maps", str(old), "--starts", "2"])
    assert old_maps.main() == 0
    head, _, true, anywhere = capsys.readouterr().out.splitlines()
    assert head == f"| {old_maps.HEAD} |"
    assert true.split(" | ")[1:3] == ["true", "1.00"]
    assert anywhere.split(" | ")[1] == "2 from anywhere"
    assert anywhere.split(" | ")[5] == "0 of 0"  # no run is 30 m long
    monkeypatch.setattr(sys, "argv", ["old_maps", str(old), "--scale", "1.05", "--fit"])
    assert old_maps.main() == 0
    _, _, fitted = capsys.readouterr().out.splitlines()
    assert 1.05 * float(fitted.split(" | ")[3]) == pytest.approx(1, abs=0.02)
