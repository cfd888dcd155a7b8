"""Robots that are watched, restarted and soaked, in bundled worlds and along a recorded log."""

import sys

import numpy as np
import pytest

from imgloc import ConfigError, save_map, save_scans
from imgloc.filters.watch import DISAGREES
from tools.robot import restart, soak, watch
from tools.robot.__main__ import main
from tools.robot.places import Place, known, recorded, simulated


@pytest.fixture(scope="module")
def place() -> Place:
    """A drive of 50 s in a world that has changed."""
    return simulated("curved", 25.0, 3, changed=True)


@pytest.fixture(scope="module")
def folder(place: Place, tmp_path_factory: pytest.TempPathFactory):
    """The same as a recorded log."""
    path = tmp_path_factory.mktemp("data") / "hall"
    path.mkdir()
    save_map(path / "map.yaml", place.features.grid)
    save_scans(path / "scans.npz", place.log)
    return path


def test_a_recorded_log_is_a_place_with_true_poses(place: Place, folder) -> None:
    (one,) = recorded([folder], [])
    for a, b in zip(known(one.log), known(place.log), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-6)
    begin = ",".join(map(str, known(place.log)[0][0]))
    (followed,) = recorded([], [(str(folder / "scans.npz"), f"{folder / 'map.yaml'}@{begin}")])
    off = known(followed.log)[0] - known(place.log)[0]
    assert np.hypot(*off[:, :2].T).max() < 0.3


@pytest.mark.parametrize("fault", watch.FAULTS)
def test_each_fault_makes_wrong_poses_after_right_ones(place: Place, fault: str) -> None:
    other = simulated("double_wall", 15.0, 1)
    log, truth, claims, k = watch.spoiled(place, other, fault, np.random.default_rng(5))
    assert len(log) == len(truth) == len(claims)
    wrong = watch.off(claims, truth)
    assert not wrong[:k].any()
    assert wrong[k:].any()


def test_a_fault_is_noticed_and_a_right_localizer_is_left_alone(place: Place) -> None:
    one = watch.noticed(place, None, "jumped", np.random.default_rng(1))
    assert one.sure
    assert one.seconds <= 5
    assert one.false == 0
    assert watch.noticed(place, None, "wrong floor", np.random.default_rng(1)) is None
    assert watch.began(["agrees", DISAGREES, DISAGREES, "agrees", DISAGREES]) == 2


def test_an_hour_is_soaked_in_short(place: Place) -> None:
    """A minute of it: switched on, carried off, blind, switched off; nothing is wrong."""
    rng, so = np.random.default_rng(1), soak.Soaked()
    for _ in soak.live(place, 60.0, rng, so):
        assert so.took
    sums = so.sums
    assert sums["seconds"] >= 60
    assert sums["unique"] > 20
    assert sums["wrong"] == sums["restored wrong"] == sums["false"] == 0
    assert sums["carried"] >= 1
    assert sums["alarms"] >= sums["carried"] - sums["not noticed"]
    name, *cells = next(iter(soak.rows_of({"hall": so})))
    assert (name, cells[2]) == ("hall", "0.0")
    assert len(cells) == soak.HEAD.count(" | ")
    short = Place("short", place.features, place.log.take(range(20)))
    with pytest.raises(ConfigError, match="short"):
        next(soak.live(short, 10.0, rng, so))


def test_along_a_recorded_log_nothing_is_restored_wrong(folder, monkeypatch, capsys) -> None:
    words = f"x restart {folder} -n {len(restart.CASES)} --seed 1"
    monkeypatch.setattr(sys, "argv", words.split())
    assert main() == 0
    rows = capsys.readouterr().out.splitlines()[2:]
    names = [row.split(" | ")[0].strip("| ") for row in rows]
    assert names == ["stayed", "stayed, people", "map redrawn", "moved", "half a map", "all"]
    assert rows[-1].split(" | ")[5] == "0"
