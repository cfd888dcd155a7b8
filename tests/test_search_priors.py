"""Priors: which poses are in them, and what a search makes of them."""

import numpy as np
import pytest

from imgloc.errors import ConfigError
from imgloc.experiments.scansets import Sensor, simulate_set
from imgloc.experiments.worlds import WORLDS, render
from imgloc.features.pyramid import Level
from imgloc.model import GridInfo, OccupancyGrid
from imgloc.pipeline import ALL_METHODS, Options, localize, prepare
from imgloc.search.fused import FusedOptions
from imgloc.search.priors import Prior, clearance, near

# One row, 1 m cells: the sensor may be in the second and third.
CELLS = np.array([[False, True, True, False]])


def test_a_cell_holds_its_lower_edges():
    poses = np.array([[0.999, 0.5, 0], [1.0, 0.0, 0], [2.999, 0.999, 0], [3.0, 0.5, 0]])
    assert Prior(CELLS).admits(poses, 1.0).tolist() == [False, True, True, False]


def test_poses_off_the_map_are_not_in_it():
    poses = np.array([[1.5, -0.1, 0], [1.5, 1.1, 0], [-0.5, 0.5, 0], [9.0, 0.5, 0]])
    assert not Prior(CELLS).admits(poses, 1.0).any()
    assert Prior().admits(poses, 1.0).all()  # nothing is known


def test_headings_wrap_around():
    prior = Prior(heading=(np.pi, 0.2))
    thetas = np.array([np.pi - 0.1, -np.pi + 0.1, np.pi - 0.3, 0.0, 3 * np.pi])
    assert prior.headings(thetas).tolist() == [True, True, False, False, True]
    assert prior.headings(thetas, 0.15).tolist() == [True, True, True, False, True]


def test_both_must_allow_a_pose():
    both = Prior(CELLS, None, {"a": 1}) & Prior(~CELLS | [[0, 1, 0, 0]], (0.0, 1.0), {"b": 2})
    assert both.cells.tolist() == [[False, True, False, False]]
    assert both.heading == (0.0, 1.0)
    assert both.about == {"a": 1, "b": 2}
    with pytest.raises(ConfigError, match="twice"):
        both & both


def test_a_lattice_cell_stays_if_any_of_its_cells_does():
    free = np.array([[True, True]])
    assert Prior(CELLS).lattice(free, 2).tolist() == [[True, True]]
    assert Prior(np.array([[0, 0, 1, 0]], bool)).lattice(free, 2).tolist() == [[False, True]]
    levels = (Level(np.zeros((1, 2), np.uint8), free, 2.0),)
    assert Prior(np.array([[0, 0, 1, 0]], bool)).levels(levels, 1.0)[0].free.tolist() == [
        [False, True]
    ]


def test_around_covers_the_cells_and_their_neighbours():
    one = np.zeros((1, 12), bool)
    one[0, 6] = True  # x = 3.25 m at 0.5 m cells
    assert Prior(one).around((1, 6), 1.0, 0.5).tolist() == [[0, 0, 1, 1, 1, 0]]
    assert Prior().around((1, 6), 1.0, 0.5) is None


def test_near_is_a_disc_of_centres():
    disc = near(GridInfo(3, 3, 1.0), 1.5, 1.5, 1.0)
    assert disc.astype(int).tolist() == [[0, 1, 0], [1, 1, 1], [0, 1, 0]]


def test_clearance_is_from_walls_unknown_cells_and_the_edge():
    free = np.ones((7, 9), bool)
    free[:, 8] = False  # unknown
    roomy = clearance(OccupancyGrid(np.zeros((7, 9), bool), free, 0.5), 1.0)
    assert np.argwhere(roomy).min(axis=0).tolist() == [2, 2]
    assert np.argwhere(roomy).max(axis=0).tolist() == [4, 5]


@pytest.mark.parametrize("radius", [0.0, -1.0, np.nan, np.inf])
def test_radii_that_cannot_be_meant(radius):
    with pytest.raises(ConfigError, match="radius"):
        near(GridInfo(3, 3, 1.0), 0, 0, radius)


@pytest.fixture(scope="module")
def visibility():
    grid = render(WORLDS["visibility"](), 0.1)
    scans = simulate_set(grid, 3, 4, Sensor(), render(WORLDS["visibility"](), 0.01))
    return prepare(grid), scans


@pytest.mark.parametrize("method", [*ALL_METHODS, "exact"])
def test_no_hypothesis_leaves_the_prior(visibility, method):
    features, scans = visibility
    x, y, theta = scans.poses[0]
    prior = Prior(near(features.grid.info, x, y, 1.5), (float(theta), 0.5))
    exact = method == "exact"
    options = Options("cbml" if exact else method, top=20, exact=exact, prior=prior)
    answer = localize(features, scans[0], options)
    poses = np.array([(h.pose.x, h.pose.y, h.pose.theta) for h in answer.hypotheses])
    assert len(poses)
    slack = Prior(near(features.grid.info, x, y, 1.7), (float(theta), 0.6))
    assert slack.admits(poses, 0.1).all()
    assert np.hypot(poses[0, 0] - x, poses[0, 1] - y) < 0.3
    assert answer.parameters["prior"] == {}


def test_a_prior_makes_a_twin_impossible(visibility):
    features, scans = visibility
    free = localize(features, scans[0])
    assert free.verdict == "ambiguous"
    x, y, theta = scans.poses[0]
    known = Prior(near(features.grid.info, x, y, 2.0), (float(theta), 0.8), {"near": [x, y]})
    told = localize(features, scans[0], Options(prior=known))
    assert told.verdict == "unique"
    assert told.parameters["prior"] == {"near": [x, y]}
    assert np.hypot(told.pose.x - x, told.pose.y - y) < 0.1


def test_what_would_be_crowded_out_is_found(visibility):
    features, scans = visibility
    few = FusedOptions(keep=(2, 2, 2), vote_peaks=1, second_look=1)
    x, y, theta = scans.poses[0]
    known = Prior(near(features.grid.info, x, y, 0.5), (float(theta), 0.2))
    without = localize(features, scans[0], Options(fused=few))
    told = localize(features, scans[0], Options(fused=few, prior=known))
    assert np.hypot(without.pose.x - x, without.pose.y - y) > 1  # a twin took the places
    assert np.hypot(told.pose.x - x, told.pose.y - y) < 0.1


def test_a_prior_without_a_pose_is_refused(visibility):
    features, scans = visibility
    nowhere = Prior(np.zeros(features.grid.occupied.shape, bool))
    with pytest.raises(ConfigError, match="leaves no cell"):
        localize(features, scans[0], Options(prior=nowhere))
