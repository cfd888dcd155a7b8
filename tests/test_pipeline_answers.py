"""What decides a verdict does not depend on what is listed, on time, or on repetition."""

from dataclasses import replace

import numpy as np
import pytest
from places import ANGLES, POSES, answer_of, facts, features_of, scan_of

from imgloc import ConfigError, explain, likelihood, localize, prepare, sample_poses, simulate
from imgloc.geometry import uniform_thetas
from imgloc.model import GridInfo, LaserScan, Likelihood, OccupancyGrid, Pose2D
from imgloc.options import Calibration, Options, Prior, Sensor, Shared, Trust
from imgloc.output.pages import svg  # with its filters
from imgloc.search.answer import log_volume
from imgloc.search.stacked import posterior_of
from imgloc.simulation.scans import simulate_ranges
from imgloc.simulation.worlds import WORLDS, render


@pytest.fixture(scope="module")
def double_wall():
    """Features and three scans that several places explain."""
    fine = render(WORLDS["double_wall"](), 0.01)
    scans = simulate(render(WORLDS["double_wall"](), 0.1), 3, 5, Sensor(range_max=5.0), fine)
    return features_of("double_wall"), scans.scans


# --- the list


@pytest.mark.parametrize(
    "options", [Options("cbml"), Options("ght-v"), Options()], ids=["cbml", "ght-v", "fused"]
)
def test_a_shorter_list_is_the_start_of_a_longer_one(double_wall, options):
    features, scans = double_wall
    for scan in scans:
        five = localize(features, scan, replace(options, top=5))
        one = localize(features, scan, replace(options, top=1))
        assert (one.verdict, one.entropy) == (five.verdict, five.entropy)
        assert facts(one)[0] == facts(five)[0][:1]
        assert len(five.hypotheses) == 5


# --- headings of the prior


@pytest.mark.parametrize("method", ["ght-v", "cbml"])
def test_a_heading_known_better_than_the_step_leaves_the_nearest_one(method):
    x, y, _ = POSES["curved"]
    step, right = np.deg2rad(8), POSES["curved"][2]
    assert 0.1 < right / step % 1 < 0.9  # between two headings
    prior = Prior(None, (right, np.deg2rad(0.5)))
    options = Options(method, theta_step=step, prior=prior)
    known = localize(features_of("curved"), scan_of("curved"), options)
    assert abs(known.pose.theta - right) < step
    assert np.hypot(known.pose.x - x, known.pose.y - y) < 0.5


# --- neighbours of a peak


HOT = Calibration(temperature=1 / 2)


def _bare():
    """Features of 40 x 60 cells with one wall, and a scan."""
    wall = np.zeros((40, 60), bool)
    wall[0] = True
    scan = LaserScan(np.full(120, 1.0), ANGLES, range_max=30.0)
    return prepare(OccupancyGrid(wall, ~wall, 0.1)), scan


def _stack_of(*peaks):
    """A stack of 36 headings over 40 x 60 free cells of 0.1 m with some values in it."""
    values = np.zeros((36, 40, 60), np.float32)
    for k, row, column, value in peaks:
        values[k, row, column] = value
    return Likelihood(values, uniform_thetas(2 * np.pi / 36), GridInfo(40, 60, 0.1), "cbml")


def test_the_mass_of_a_neighbouring_peak_goes_to_its_owner():
    (features, scan), options = _bare(), Options("cbml", calibration=HOT)
    stack = _stack_of((5, 20, 20, 5), (5, 20, 24, 4), (20, 10, 50, 3))
    found = localize(features, scan, options, stack=stack)
    p = posterior_of(features, scan, stack, options).astype(float)
    here, there = p[5, 20, 20] + p[5, 20, 24], p[20, 10, 50]
    assert len(found.hypotheses) == 2
    mass = np.array([h.mass for h in found.hypotheses])
    assert mass[1] / mass[0] == pytest.approx(there / here)
    assert mass.sum() == pytest.approx(1 - found.elsewhere)
    # About the pose that is named: the neighbour's share is 0.4 m away from it.
    share = p[5, 20, 24] / here
    spread = [h.covariance[0, 0] for h in found.hypotheses]
    assert spread[0] - spread[1] == pytest.approx(share * 0.4**2)
    assert found.hypotheses[0].covariance[1, 1] == pytest.approx(spread[1])


def test_the_log_likelihood_of_a_stack_is_relative_to_no_idea():
    (features, scan), options = _bare(), Options("cbml", calibration=HOT)
    stack = _stack_of((5, 20, 20, 5), (20, 10, 50, 3))
    best, second = localize(features, scan, options, stack=stack).hypotheses
    # 39 rows of 60 free cells, 36 headings: a pose is that often likelier than one among all.
    p = posterior_of(features, scan, stack, options).astype(float)
    poses = 36 * 39 * 60
    assert best.log_likelihood == pytest.approx(np.log(p[5, 20, 20] * poses))
    assert second.log_likelihood == pytest.approx(np.log(p[20, 10, 50] * poses))
    assert best.log_likelihood > 10


# --- what an answer carries


@pytest.mark.parametrize("method", ["fused", "cbml", "ght-v"])
def test_the_evidence_makes_the_masses(method):
    features, scan = features_of("curved"), scan_of("curved")
    options = Options(method, top=2)
    answer = localize(features, scan, options)
    evidence = answer.evidence
    assert evidence.listed == len(answer.hypotheses) == min(2, evidence.found)
    total = sum(h.mass for h in answer.hypotheses) + evidence.unlisted
    assert total + answer.elsewhere == pytest.approx(1)
    if method == "fused":
        a, b = answer.hypotheses
        gap = (a.log_likelihood - b.log_likelihood) / evidence.temperature.value
        assert np.log(a.mass / b.mass) == pytest.approx(gap)
        terms = evidence.temperature
        assert terms.base == options.trust.temperature
        assert terms.value == pytest.approx((terms.base + terms.strain) * terms.number * terms.cell)
        assert terms.cell == 1
        lacks = evidence.best - answer.hypotheses[0].log_likelihood / evidence.readings
        assert terms.strain == pytest.approx(options.trust.strain * max(0, lacks))
        assert lacks <= evidence.misfit  # a thing of its own costs less than its readings
    else:
        assert evidence.temperature.strain == 0
    # Moving the answer to the end of the list changes no more than the list.
    more = localize(features, scan, replace(options, top=50))
    assert more.evidence.unlisted < 1e-9 or more.evidence.found > 50 or method != "fused"
    assert more.evidence.found == evidence.found or method != "fused"
    metres, radians = options.fused.same
    volume = np.pi * metres**2 * 2 * radians
    space = np.count_nonzero(features.free) * features.lattice.resolution**2 * 2 * np.pi
    assert evidence.log_volume == pytest.approx(np.log(volume / space))
    known = replace(options, prior=Prior(heading=(0.0, np.pi / 8)))
    assert log_volume(features, known) == pytest.approx(np.log(8 * volume / space))


def test_the_mounting_travels_with_the_answer():
    mount = Pose2D(0.2, 0.0, 0.1)
    scan = replace(scan_of("curved"), T_base_laser=mount)
    assert localize(features_of("curved"), scan).T_base_laser == mount


def test_neighbouring_headings_are_joined_across_the_cut():
    features, scan = _bare()
    # Headings of 180 and 187.2 degrees: the cut of the circle lies between them.
    values = np.zeros((50, 40, 60), np.float32)
    values[25, 20, 20], values[26, 20, 23] = 5, 4
    stack = Likelihood(values, uniform_thetas(2 * np.pi / 50), GridInfo(40, 60, 0.1), "cbml")
    (only,) = localize(features, scan, Options("cbml"), stack=stack).hypotheses
    assert only.covariance[2, 2] < np.deg2rad(8) ** 2


# --- an early end


def test_an_answer_out_of_time_is_never_unique():
    features, scan = features_of("curved"), scan_of("curved")
    assert answer_of("curved", "fused").verdict == "unique"
    late = localize(features, scan, Options(time_budget=1e-9))
    assert not late.complete
    assert late.hypotheses[0].mass > 0.9
    assert late.verdict == "ambiguous"
    reason = explain(features, scan, late)
    assert [c.holds for c in late.evidence.checks] == [True, True, True, False]
    asked = svg.macro("question", "words.html", check=late.evidence.checks[-1])
    assert asked.split("<td>")[2] == "out of time"
    said = svg.macro("why", "words.html", e=reason)
    assert said.startswith("The best pose that the search reached")


# --- repetition


def test_repeated_directions_are_one_reading_each():
    features, scan = features_of("curved"), scan_of("curved")
    some = np.tile(np.arange(0, 120, 24), 60)  # five readings, sixty times
    again = LaserScan(scan.ranges[some], scan.angles[some], range_max=30.0)
    assert again.valid.sum() == 300
    assert again.directions == 5
    for method in ("fused", "cbml"):
        answer = localize(features, again, Options(method))
        assert (answer.verdict, answer.pose) == ("invalid", None)
    turns = replace(again, angles=again.angles + 2 * np.pi * np.repeat(np.arange(60) % 2, 5))
    assert localize(features, turns).verdict == "invalid"
    answer = localize(features, again, Options(trust=Trust(readings=5)))
    assert answer.verdict != "invalid"


def test_the_page_says_that_directions_are_repeated():
    features, scan = features_of("curved"), scan_of("curved")
    again = LaserScan(np.full(90, 2.0), np.tile([0.0, 0.5, 1.0], 30), range_max=30.0)
    for given, said in ((again, ", in 3 different directions"), (scan, "")):
        invalid = localize(features, given, Options(trust=Trust(readings=999)))
        reason = explain(features, given, invalid, Options(trust=Trust(readings=999)))
        text = svg.macro("why", "words.html", e=reason)
        assert f"readings are valid{said};" in text


# --- what is recorded, and what is taken


# --- what is listed


def test_sixty_four_rooms_alike_are_all_found_and_drawn_from():
    room = np.pad(np.zeros((46, 46), bool), 2, constant_values=True)
    room[10:14, 20:35] = room[30:45, 36:39] = True  # no symmetry of its own
    wall = np.pad(np.tile(room, (8, 8)), 2, constant_values=True)  # outer walls as thick as inner
    features = prepare(OccupancyGrid(wall, ~wall, 0.1))
    fine = np.pad(room, 2, constant_values=True).repeat(10, axis=0).repeat(10, axis=1)
    angles = np.deg2rad(np.arange(-180, 180, 2.0))
    truth = (1.5, 3.3, 0.4)
    ranges = simulate_ranges(OccupancyGrid(fine, ~fine, 0.01), [truth], angles, range_max=20.0)[0]
    scan = LaserScan(ranges, angles, range_max=20.0)
    answer = localize(features, scan)
    assert answer.verdict == "ambiguous"
    rooms = {(int(h.pose.x // 5), int(h.pose.y // 5)) for h in answer.hypotheses}
    assert len(rooms) == len(answer.hypotheses) == 61  # 60 of 64 equals hold less than 95 %
    assert localize(features, scan, Options(top=3)).evidence.listed == 3
    poses = sample_poses(features, scan, 6400, np.random.default_rng(0))
    at = np.mod(poses[:, :2] - 0.2, 5.0) + 0.2
    near = np.hypot(*(at - truth[:2]).T) < 0.2
    counts = np.bincount(
        (8 * (poses[near, 0] // 5) + poses[near, 1] // 5).astype(int), minlength=64
    )
    assert counts.min() > 50
    assert counts.max() < 150


def test_a_stack_is_of_the_scan_the_method_and_the_map_that_are_asked():
    features, scan = features_of("curved"), scan_of("curved")
    stack = likelihood(features, scan, "cbml")
    again = replace(scan, ranges=scan.ranges.copy(), stamp=3.0)
    for same in (scan, again):
        answer = localize(features, same, Options("cbml"), stack=stack)
        assert facts(answer) == facts(localize(features, scan, Options("cbml")))
    for there, asked, options, says in (
        (features, scan, Options("ght-v"), "stack: got one of cbml, expected one of ght-v"),
        (features, scan, Options(), "stack: got one of cbml, expected one of fused"),
        (features, scan_of("corridor"), Options("cbml"), "stack: got one of another scan"),
        (features, replace(scan, range_max=2.0), Options("cbml"), "of another scan"),
        (features_of("corridor"), scan, Options("cbml"), "of another map"),
    ):
        with pytest.raises(ConfigError, match=says):
            localize(there, asked, options, stack=stack)


def test_parameters_of_a_stack_do_not_say_what_it_does_not_use():
    features, scan = features_of("curved"), scan_of("curved")
    shared = Shared(1.05, 2)
    assert "shared" not in localize(features, scan, Options("ght-v", shared=shared)).parameters
    said = localize(features, scan, Options(shared=shared)).parameters["shared"]
    assert said == vars(shared)


@pytest.mark.parametrize("method", ["fused", "cbml"])
def test_what_is_explained_is_a_share_of_the_rays_that_were_recorded(method):
    """Half of them end on the robot itself: in a few squares, of which the score asks each once."""
    ranges, angles = scan_of("curved").ranges.repeat(2), ANGLES.repeat(2)
    whole = LaserScan(ranges, angles, range_max=30.0)
    ranges = np.where(np.arange(len(ranges)) % 2, 0.35, ranges)
    half = LaserScan(ranges, angles, range_max=30.0)
    features, options = features_of("curved"), Options(method)
    one, other = (localize(features, scan, options) for scan in (whole, half))
    assert other.explained == pytest.approx(one.explained / 2, abs=0.1)  # some by chance
    if method == "fused":
        counts = explain(features, half, other, options).fits[0].rays.counts
        ended = counts["agrees"] + counts["orientation"]
        assert other.explained == pytest.approx(ended / half.counts["valid"], abs=1e-9)
