"""A place is doubted if few readings decide it, or if an error that was found makes it fit."""

import numpy as np
import pytest

from imgloc.features.mapfeatures import MapFeatures
from imgloc.features.scanpoints import one_per_place
from imgloc.model import OccupancyGrid
from imgloc.options import Options, Sensor, Shared
from imgloc.pipeline import localize
from imgloc.search.adapt import price
from imgloc.search.hypotheses import masses, steadied, steadiness
from imgloc.search.rescore import reading_evidence, score_poses
from imgloc.simulation.scans import simulate
from imgloc.simulation.worlds import WORLDS, render


def two_rooms(niche: bool = True) -> OccupancyGrid:
    """Two equal rooms of 6 x 4 m; one of them has a niche of 0.6 m in a wall."""
    walls = np.ones((70, 160), bool)
    walls[15:55, 10:70] = walls[15:55, 90:150] = False
    walls[55:61, 20:26] = not niche
    return OccupancyGrid(walls, ~walls, 0.1)


def test_evidence_of_readings_sums_to_the_score():
    features = MapFeatures(two_rooms())
    scan = simulate(features.grid, 1, 3, Sensor(fov=2 * np.pi, rays=121), features.grid)[0]
    readings = one_per_place(scan, 0.07)
    poses = np.random.default_rng(2).uniform((1.5, 2, -3), (6.5, 5, 3), (9, 3))
    each = reading_evidence(features, readings, poses, Options())
    assert each.shape == (9, len(readings))
    score = score_poses(features, readings, poses, Options()).log_likelihood
    np.testing.assert_allclose(each.sum(axis=1, dtype=np.float64), score, rtol=1e-6)


def test_a_share_is_less_if_neighbours_decide_it_and_stays_if_many_readings_do():
    everywhere, angles = np.zeros((3, 120), np.float32), np.linspace(-3, 3, 120)
    everywhere[0] = 0.1
    once = np.zeros((3, 120), np.float32)
    once[0, 40:44] = 3.0  # 12 nats as well
    for told, loses in ((everywhere, False), (once, True)):
        share = masses(told.sum(axis=1, dtype=np.float64), 2.0)
        least = steadiness(told, angles, 2.0)
        found = steadied(share, least)
        assert share[0] > 0.99
        assert (found[0] < 0.9) == loses
        assert found.sum() == pytest.approx(1)
        assert (np.diff(found) <= 1e-12).all()  # the best stays the best
        turned = np.random.default_rng(1).permutation(120)  # readings may come in any order
        assert steadiness(told[:, turned], angles[turned], 2.0) == pytest.approx(least)


def test_one_place_keeps_all_of_its_share():
    assert steadied(np.ones(1), 0.1).tolist() == [1.0]
    assert steadied(np.array([1.0, 0.0]), 0.1).tolist() == [1.0, 0.0]
    assert steadiness(np.ones((1, 30), np.float32), np.arange(30.0), 1.0) == 1.0


@pytest.mark.parametrize(
    ("found", "known", "nats"),
    [
        (Shared(), Shared(), 0.0),
        (Shared(0.95), Shared(), -120 * np.log(0.95)),
        (Shared(1.1), Shared(1.1), 0.0),
        (Shared(thinner=1), Shared(), 0.0),
        (Shared(thinner=4), Shared(), 3 * 0.1 * 40),
        (Shared(thinner=4), Shared(thinner=4), 0.0),
        (Shared(thinner=2, bent=0.1), Shared(), 0.0),
    ],
)
def test_an_error_that_is_found_has_a_price_and_a_known_one_has_none(found, known, nats):
    assert price(found, known, 0.1) == pytest.approx(nats)


def test_the_price_counts_against_the_pose():
    grid = render(WORLDS["curved"](), 0.1)
    scan = simulate(grid, 1, 4, Sensor(fov=2 * np.pi, rays=181), grid)[0].scaled(1.05)
    features = MapFeatures(grid)
    found = localize(features, scan).evidence
    known = localize(features, scan, Options(shared=Shared(scale=found.scale))).evidence
    assert found.scale == pytest.approx(1 / 1.05, abs=0.01)
    assert found.against - known.against == pytest.approx(-120 * np.log(found.scale), abs=0.1)
