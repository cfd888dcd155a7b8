"""A place is doubted if an error that was found makes it fit."""

import numpy as np
import pytest

from imgloc import MapFeatures, Options, Sensor, Shared, localize, simulate
from imgloc.search.adapt import price
from imgloc.simulation.worlds import WORLDS, render


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
