"""The empty room that suits a scan best, against rooms that are known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from places import features_of, scan_of

from imgloc import Known, LaserScan, OccupancyGrid, Options, localize, prepare
from imgloc.features.distance import distance_image
from imgloc.features.raycast import cast_rays
from imgloc.features.scanpoints import Readings, one_per_place
from imgloc.numbers import number
from imgloc.options import EvidenceModel
from imgloc.search.background import best_room, unmapped_score
from imgloc.search.priors import prior_of

MODEL = EvidenceModel()


def points(box, n=30):
    """Points on the four sides of a box (left, right, bottom, top)."""
    left, right, bottom, top = box
    u, v = np.linspace(left, right, n), np.linspace(bottom, top, n)
    sides = [(u, 0 * u + bottom), (u, 0 * u + top), (0 * v + left, v), (0 * v + right, v)]
    return np.concatenate([np.stack(side, axis=1) for side in sides])


def mean_in_room(xy):
    """Nats per reading of endpoints in the room that suits them best."""
    return float(best_room(xy, MODEL).mean())


@given(
    st.tuples(st.floats(0.5, 6), st.floats(0.5, 6), st.floats(0.5, 6), st.floats(0.5, 6)),
    st.floats(-np.pi, np.pi),
)
@settings(max_examples=20)
def test_a_room_is_a_room_wherever_the_sensor_is_and_looks(sides, turn):
    left, right, bottom, top = sides
    xy = points((-left, right, -bottom, top))
    c, s = np.cos(turn), np.sin(turn)
    # Headings are 1.5 degrees apart: 0.75 degrees are 8 cm at the far corners of the largest.
    assert MODEL.best - mean_in_room(xy @ np.array([[c, s], [-s, c]])) < 0.5


def test_sides_that_are_not_seen_cost_nothing_and_what_is_no_wall_does():
    xy = points((-2.0, 3.0, -1.5, 1.5))
    whole = mean_in_room(xy)
    assert mean_in_room(xy[30:]) == pytest.approx(whole, abs=0.1)
    clutter = np.random.default_rng(0).uniform(-1.2, 1.2, (40, 2))
    assert mean_in_room(np.concatenate((xy, clutter))) < whole - 0.5
    assert mean_in_room(np.zeros((1, 2))) == pytest.approx(MODEL.best)  # a point on the sensor


def test_a_side_without_a_reading_has_no_wall_at_the_sensor():
    """Readings along a line through the sensor are no wall: a room has none there."""
    rng = np.random.default_rng(0)
    here = np.column_stack((rng.uniform(0.02, 0.1, 50), rng.uniform(1, 6, 50)))
    nearer, as_far = (mean_in_room(here + [d, 0.0]) for d in (0.0, 3.0))
    assert nearer == pytest.approx(as_far, abs=1e-3)


def test_a_wall_far_away_is_a_wall():
    y = np.linspace(-3.0, 3.0, 30)
    for x in (15.0, 25.0, -40.0):  # beyond 20 m they are not told apart
        assert mean_in_room(np.stack((0 * y + x, y), 1)) == pytest.approx(MODEL.best, abs=1e-4)


def seen_in(free, x, y, cell=0.02):
    """What is seen of a building, (H, W) free cells, from within."""
    angles = np.deg2rad(np.arange(-180, 180, 1.0))
    ranges = cast_rays(distance_image(~free), np.array([x, y]), angles, 20.0, cell)
    return LaserScan(np.where(ranges < 20.0, ranges, np.inf), angles, range_max=20.0)


def test_a_bare_room_of_another_building_is_never_unique():
    room = np.zeros((200, 260), bool)
    room[10:-10, 10:-10] = True
    answer = localize(features_of("curved"), seen_in(room, 2.1, 1.3))
    assert answer.verdict != "unique"
    assert answer.evidence.gained < 0


def test_the_places_of_a_map_beat_the_room():
    for name in ("curved", "double_wall"):
        answer = localize(features_of(name), scan_of(name))
        assert answer.verdict == "unique"
        assert answer.evidence.gained > 10


def test_the_only_room_of_a_map_is_not_told_from_one_that_is_on_no_map():
    wall = np.pad(np.zeros((30, 44), bool), 2, constant_values=True)
    free = np.repeat(np.repeat(~wall, 5, axis=0), 5, axis=1)
    answer = localize(prepare(OccupancyGrid(wall, ~wall, 0.1)), seen_in(free, 1.5, 1.1))
    assert abs(answer.evidence.gained) < 30
    assert answer.verdict != "unique"


@pytest.fixture(scope="module")
def hall():
    """A map with a bare room of 4 x 3 m beside a hall, and a scan of another room of that size."""
    wall = np.ones((80, 120), bool)
    wall[5:35, 5:45] = False
    wall[40:75, 5:110] = False
    wall[50:60, 30:34] = wall[45:48, 80:90] = True
    wall[35:40, 20:30] = False
    room = np.zeros((150, 200), bool)
    room[2:-2, 2:-2] = True
    return prepare(OccupancyGrid(wall, ~wall, 0.1)), seen_in(room, 1.1, 0.9)


@pytest.mark.parametrize("known", [Known(), Known(clearance=0.3), Known(heading=(0.0, 0.4))])
def test_a_bare_room_is_never_unique_whatever_is_known(hall, known):
    features, scan = hall
    answer = localize(features, scan, Options(prior=prior_of(known, features.grid)))
    assert answer.verdict != "unique"
    assert answer.evidence.net < 20


def test_a_prior_is_no_evidence_against_buildings_on_no_map(hall):
    features, scan = hall
    seen = one_per_place(scan, 0.07)
    free = localize(features, scan)
    here = Known(near=(free.best.x, free.best.y, free.best.theta, 1.0, 0.5))
    told = localize(features, scan, Options(prior=prior_of(here, features.grid)))
    assert told.evidence.unmapped == free.evidence.unmapped
    assert unmapped_score(seen, MODEL) <= MODEL.best + 1e-6


def test_a_thing_in_a_room_costs_once_and_no_more_than_that():
    """Half of the readings on something that stands in a room: it is one thing or two."""
    angles = np.deg2rad(np.arange(0.0, 360.0, 3.0))
    along, across = (np.maximum(np.abs(f(angles)), 1e-9) for f in (np.cos, np.sin))
    walls = np.minimum(2.0 / along, 1.5 / across)
    bare = unmapped_score(Readings(walls, angles), MODEL)
    less = [np.where(angles < np.deg2rad(turn), 0.5, walls) for turn in (18, 38)]
    one, two = (unmapped_score(Readings(r, angles), MODEL) for r in less)
    price, apart = number("rescore.price"), number("rescore.apart")
    assert bare > one > two
    assert (bare - one) * 120 < price + 6 * apart + 1
    assert (bare - two) * 120 < 2 * price + 13 * apart + 1
