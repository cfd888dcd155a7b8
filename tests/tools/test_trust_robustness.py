"""The oracle of the score, and the table of conditions beside it."""

import json

import numpy as np
import pytest
from command import run

from imgloc.features.pyramid import Level
from imgloc.io.maps import save_map
from imgloc.io.scans import save_scans
from imgloc.model import LaserScan, OccupancyGrid, Pose2D, compose
from imgloc.options import EvidenceModel, FusedOptions, Options, Sensor
from imgloc.pipeline import localize, prepare
from imgloc.runs.opening import ScanFiles
from imgloc.search.modes import Modes
from imgloc.search.rescore import Scores
from imgloc.simulation.scans import simulate, simulate_ranges
from imgloc.simulation.worlds import WORLDS, render
from tools.trust import robustness as room
from tools.trust.__main__ import main
from tools.trust.exhaustive import exhaustive, joined, propose_all, score_level
from tools.trust.robustness import (
    RobustnessTrial,
    recorded_row,
    robustness,
    robustness_table,
    row_of,
    tied,
    upside_down,
)


def test_all_poses_are_tried_and_the_best_come_first():
    image = np.zeros((5, 6), np.uint8)
    image[2, 4], image[3, 1] = 200, 100
    level = Level(image, np.ones((5, 6), bool), 1.0)
    poses = propose_all(level, np.array([[1.0, 0.0]]), np.pi / 2, 5)
    assert poses[:4].tolist() == [
        [3.5, 2.5, 0.0], [4.5, 1.5, np.pi / 2], [5.5, 2.5, np.pi], [4.5, 3.5, 3 * np.pi / 2],
    ]  # fmt: skip
    assert poses[4].tolist() == [0.5, 3.5, 0.0]


def test_the_level_is_the_logarithm_above_the_background():
    walls = np.zeros((20, 30), bool)
    walls[:, 20] = True
    features = prepare(OccupancyGrid(walls, ~walls, 0.1))
    level = score_level(features, EvidenceModel(), 1)
    assert level.image[10, 18:23].tolist() == sorted(level.image[10, 18:21]) + sorted(
        level.image[10, 21:23], reverse=True
    )
    assert level.image[:, 0].max() == 0
    assert level.image.max() == 255


@pytest.mark.parametrize(
    ("world", "sensor"),
    [
        ("double_wall", Sensor(fov=np.pi / 2)),
        ("curved", Sensor(range_max=5.0)),
        ("corridor", Sensor(outliers=0.5)),
    ],
    ids=["narrow", "short", "disturbed"],
)
def test_the_oracle_is_never_below_the_search(world, sensor):
    grid = render(WORLDS[world](), 0.1)
    features = prepare(grid)
    for scan in simulate(grid, 4, 7, sensor, render(WORLDS[world](), 0.01)).scans:
        best = exhaustive(features, scan, keep=3000)
        # The oracle takes the map as it is.
        options = Options(fused=FusedOptions(strained=float("inf")))
        answer = localize(features, scan, options)
        assert best.scores.things[0] >= answer.hypotheses[0].log_likelihood
        assert np.all(np.diff(best.scores.things) <= 0)
        assert best.scores.crossed.shape == (len(best.poses), len(best.readings))


def test_two_searches_are_joined_without_their_doubles():
    def found(*told):
        poses, score = np.array([t[:3] for t in told]), np.array([t[3] for t in told])
        seen = np.zeros((len(told), 2), bool)
        return Modes(poses, Scores(score, score, *[seen] * 5), np.arange(2))

    a = found((1.0, 1.0, 0.0, 5.0), (9.0, 1.0, 0.0, 4.0))
    b = found((9.1, 1.0, 0.1, 6.0), (3.0, 3.0, 0.0, 1.0))
    both = joined(a, b, FusedOptions())
    assert both.poses.tolist() == [[9.1, 1.0, 0.1], [1.0, 1.0, 0.0], [3.0, 3.0, 0.0]]
    assert both.scores.log_likelihood.tolist() == [6, 5, 1]


def test_a_lattice_with_too_many_poses_gets_larger_cells():
    grid = render(WORLDS["curved"](), 0.1)
    features = prepare(grid)
    assert score_level(features, EvidenceModel(), 2).resolution == pytest.approx(0.2)
    (scan,) = simulate(grid, 1, 3, Sensor(), render(WORLDS["curved"](), 0.01)).scans
    few = 360 * grid.occupied.size // 4
    best = [exhaustive(features, scan, keep=500, most=m).poses[0] for m in (4 * few, few)]
    np.testing.assert_allclose(best[0], best[1], atol=0.02)


def test_a_sensor_upside_down_sweeps_the_other_way():
    grid, pose = render(WORLDS["curved"](), 0.1), [(2.9, 4.8, 0.3)]
    angles = np.linspace(-1.0, 1.0, 41)
    up, down = (
        simulate_ranges(grid, pose, a, sigma=0.0, range_max=9.0)[0] for a in (angles, -angles)
    )
    assert not np.allclose(up, down)
    hanging = upside_down(LaserScan(up, angles, range_max=9.0))
    np.testing.assert_allclose(hanging.ranges, down, atol=1e-3)
    # The command's own remedy.
    told = ScanFiles(flipped=True).mounted(hanging)
    order = np.argsort(told.angles)
    np.testing.assert_allclose(told.angles[order], angles)
    np.testing.assert_allclose(told.ranges[order], up)
    assert ScanFiles().mounted(hanging) == hanging


def test_the_robots_of_mounted_sensors_are_compared():
    mount = Pose2D(5.0, 0.0, 0.0)
    # Sensors 0.87 m apart, on robots at one place turned by 10 degrees; and the other way.
    turned = compose(Pose2D(0.0, 0.0, np.deg2rad(9.9)), mount)
    assert tied([turned], np.zeros(1), mount, mount) == (True,)
    beside = Pose2D(mount.x, mount.y, np.deg2rad(9.9))
    assert tied([beside], np.zeros(1), mount, mount) == (False,)


def test_equal_scores_are_equally_right():
    here, there, none = Pose2D(0.0, 0.0), Pose2D(9.0, 0.0), Pose2D(0.0, 0.0)
    scores = np.array([7.0, 6.91, 6.89])
    assert tied([there, here, here], scores, here, none) == (False, True)
    assert tied([there, there, here], scores, here, none) == (False, False)
    assert tied([], np.empty(0), here, none) == ()
    row = row_of(
        "some",
        [
            RobustnessTrial((False, True), (True, False), unique=False),
            RobustnessTrial((False,), (True,), unique=True),
            RobustnessTrial((), (False, False), unique=False),
            RobustnessTrial((True,), (True,), unique=True),
        ],
    )
    assert (row.localize.hits, row.oracle.hits) == (2, 3)
    assert (row.localize_first.hits, row.oracle_first.hits, row.behind) == (1, 3, 50)
    assert (row.ties.hits, row.unique.hits, row.wrong.hits) == (1, 2, 1)
    assert "| 25 % [5, 70] | 75 % [30, 95] | 50 | 50 %, 75 % | 25 % | 50 % | 1 of 4 |" in (
        robustness_table([row])
    )


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
    scans = simulate(grid, 2, 3, Sensor(), render(WORLDS["curved"](), 0.01))
    row = recorded_row("a set", prepare(grid), scans)
    assert (row.condition, row.localize.hits, row.oracle.hits) == ("a set", 2, 2)


# --- the tool


@pytest.fixture
def recorded_set(tmp_path):
    """A map with three scans beside it."""
    grid = render(WORLDS["curved"](), 0.1)
    (tmp_path / "here").mkdir()
    save_map(tmp_path / "here" / "map.yaml", grid)
    save_scans(tmp_path / "here" / "scans.npz", simulate(grid, 3, 3, Sensor()))
    return tmp_path / "here" / "map.yaml"


def run_tool(*words):
    return run(main, "robustness", "--threads", 1, *words)


def test_the_tool_measures_recorded_sets(recorded_set, tmp_path):
    out = tmp_path / "out.json"
    words = ("-n", 1, "--sets", recorded_set, recorded_set, "--out", out)
    done = run_tool(*words)
    assert done.code == 0, done.err
    assert done.out.count("\n| here | 100 % ") == 2
    found = json.loads(out.read_text())
    assert (found["n"], found["sets"], found["range_max"]) == (1, ["here", "here"], 20.0)
    assert [row["oracle"]["trials"] for row in found["rows"]] == [1, 1]
    again = run_tool(*words)
    assert (again.code, "Traceback" in again.err) == (1, False)
    assert "exists already" in again.err
    # Within 0.4 m of a robot with a clearance of 0.3 m there is little to see.
    short = run_tool(*words, "--range-max", 0.4, "--force")
    assert (short.code, "| here | 0 % " in short.out) == (0, True)
    assert json.loads(out.read_text())["range_max"] == 0.4
