"""The oracle of the score, and the table of conditions beside it."""

import numpy as np
import pytest

from imgloc.errors import ConfigError
from imgloc.experiments import robustness as room
from imgloc.experiments.exhaustive import exhaustive, score_level
from imgloc.experiments.robustness import (
    CONDITIONS,
    base_pose,
    recorded_row,
    robustness,
    upright,
    upside_down,
)
from imgloc.experiments.scansets import Sensor, simulate_set
from imgloc.experiments.worlds import WORLDS, render
from imgloc.features.pyramid import Level
from imgloc.model import LaserScan, OccupancyGrid, Pose2D
from imgloc.pipeline import Options, localize, prepare
from imgloc.search.proposals import propose_all
from imgloc.search.rescore import EvidenceModel


def test_all_poses_are_tried_and_the_best_come_first():
    image = np.zeros((5, 6), np.uint8)
    image[2, 4], image[3, 1] = 200, 100
    level = Level(image, np.ones((5, 6), bool), 1.0)
    poses = propose_all(level, np.array([[1.0, 0.0]]), theta_step=np.pi / 2, keep=5)
    assert poses[:4].tolist() == [
        [3.5, 2.5, 0.0], [4.5, 1.5, np.pi / 2], [5.5, 2.5, np.pi], [4.5, 3.5, 3 * np.pi / 2],
    ]  # fmt: skip
    assert poses[4].tolist() == [0.5, 3.5, 0.0]


def test_the_level_is_the_logarithm_above_the_background():
    walls = np.zeros((20, 30), bool)
    walls[:, 20] = True
    features = prepare(OccupancyGrid(walls, ~walls, 0.1))
    level = score_level(features, EvidenceModel())
    assert level.image[10, 18:23].tolist() == sorted(level.image[10, 18:21]) + sorted(
        level.image[10, 21:23], reverse=True
    )
    assert level.image[:, 0].max() == 0
    assert level.image.max() == 255


def test_the_oracle_is_never_below_the_search():
    grid = render(WORLDS["double_wall"](), 0.1)
    features = prepare(grid)
    scans = simulate_set(grid, 3, 2, Sensor(), render(WORLDS["double_wall"](), 0.01))
    for scan in scans.scans:
        best = exhaustive(features, scan, keep=3000)
        answer = localize(features, scan, Options())
        assert best.evidence.log_likelihood[0] >= answer.hypotheses[0].log_likelihood - 1e-6


def test_an_upside_down_sensor_is_set_right():
    angles = np.linspace(-1.0, 1.0, 5)
    scan = LaserScan(np.arange(1.0, 6.0), angles, range_max=9.0)
    there = upside_down(scan)
    assert there.ranges.tolist() == [5, 4, 3, 2, 1]
    again = upright(there)
    pairs = {(a, r) for a, r in zip(again.angles, again.ranges, strict=True)}
    assert pairs == set(zip(angles, scan.ranges, strict=True))


def test_the_base_of_a_mounted_sensor():
    scan = LaserScan([1.0], [0.0], range_max=9.0, T_base_laser=Pose2D(0.3, 0.0, np.pi / 2))
    base = base_pose(Pose2D(1.0, 2.0, np.pi / 2), scan)
    assert [base.x, base.y, base.theta] == pytest.approx([0.7, 2.0, 0.0])


def test_a_row_for_each_condition_and_a_call_for_each_trial(monkeypatch):
    monkeypatch.setattr(room, "exhaustive", lambda *a, **k: exhaustive(*a, **k, keep=500))
    calls = []
    names = ("as in the paper", "sensor upside down", "map at 5 cm")
    rows = robustness(2, 3, worlds=["curved"], conditions=names, advance=lambda: calls.append(1))
    assert [row.condition for row in rows] == list(names)
    assert len(calls) == 6
    for row in rows:
        assert row.localize.hits == row.oracle.hits == 2
        assert row.behind == 0
        assert row.wrong.hits == 0


def test_recorded_scans_are_compared_in_the_map_frame(monkeypatch):
    monkeypatch.setattr(room, "exhaustive", lambda *a, **k: exhaustive(*a, **k, keep=500))
    here = render(WORLDS["curved"](), 0.1)
    grid = OccupancyGrid(here.occupied, here.free, 0.1, Pose2D(3.0, -2.0, 2.5))
    scans = simulate_set(grid, 2, 3, Sensor(), render(WORLDS["curved"](), 0.01))
    row = recorded_row("a set", prepare(grid), scans)
    assert (row.condition, row.localize.hits, row.oracle.hits) == ("a set", 2, 2)


def test_conditions_are_those_of_users():
    names = " ".join(CONDITIONS)
    for words in ("stopped short", "dropped", "reach", "view", "rays", "map at", "upside down"):
        assert words in names


@pytest.mark.parametrize("wrong", [{"n": 0}, {"worlds": ["moon"]}, {"conditions": ["in the rain"]}])
def test_refuses(wrong):
    with pytest.raises(ConfigError):
        robustness(**wrong)
