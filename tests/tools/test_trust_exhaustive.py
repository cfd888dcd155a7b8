"""The oracle of the score."""

import numpy as np
import pytest

from imgloc import FusedOptions, OccupancyGrid, Options, Sensor, localize, prepare, simulate
from imgloc.features.pyramid import Level
from imgloc.options import EvidenceModel
from imgloc.search.modes import Modes
from imgloc.search.rescore import Scores
from imgloc.simulation.worlds import WORLDS, render
from tools.trust.exhaustive import exhaustive, joined, propose_all, score_level


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
    for scan in simulate(grid, 2, 7, sensor, render(WORLDS[world](), 0.01)).scans:
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
        return Modes(poses, Scores(score, score, 0 * score, *[seen] * 6), np.arange(2))

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
