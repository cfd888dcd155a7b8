"""What each ray says about a pose, and the numbers behind a verdict."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from places import POSES, answer_of, error, features_of, hall, room_with_a_post, scan_of

from imgloc import LaserScan, OccupancyGrid, OrientedPoints, Pose2D, explain, localize, prepare
from imgloc.answers.explain import KINDS, RayFit, explain_rays, faced
from imgloc.features.raycast import cast_rays
from imgloc.options import ALL_METHODS, Options, Prior
from imgloc.search.priors import near

ANGLES = np.deg2rad(np.arange(-180, 180, 3.0))


def rays_at(features, scan, pose) -> RayFit:
    model = Options().fused.model
    return explain_rays(pose, scan, features, model)


@pytest.fixture(scope="module")
def room():
    return prepare(room_with_a_post())


def seen_from(features, pose, angles=ANGLES):
    ranges = cast_rays(features.walls, pose[:2], angles + pose[2], 20.0, 0.1)
    return LaserScan(ranges, angles, range_max=20.0)


def test_every_ray_of_a_perfect_scan_agrees(room) -> None:
    pose = (3.0, 2.4, 0.4)
    fit = rays_at(room, seen_from(room, pose), Pose2D(*pose))
    assert fit.counts["visibility"] == fit.counts["unexplained"] == 0
    assert fit.counts["agrees"] >= 0.95 * len(ANGLES)  # corners have no normal of their own
    assert sum(fit.counts.values()) == len(ANGLES)
    assert np.isinf(fit.wall).all()


def test_readings_that_are_no_distances_have_no_say(room) -> None:
    ranges = [1.0, np.inf, 25.0, np.nan, -np.inf, 0.05]
    scan = LaserScan(ranges, np.zeros(6), range_min=0.1, range_max=20.0)
    fit = rays_at(room, scan, Pose2D(1.0, 1.0))
    assert fit.kind[1:].tolist() == ["no_return"] * 2 + ["invalid"] * 3
    assert np.isfinite(fit.end).all(axis=1).tolist() == [True] + [False] * 5
    assert list(fit.counts) == list(KINDS)
    nothing = rays_at(room, LaserScan([np.nan], [0.0]), Pose2D(1.0, 1.0))
    assert nothing.counts["invalid"] == 1


def test_a_ray_through_a_wall_is_vetoed_where_it_meets_it(room) -> None:
    # The post begins at x = 2.0 m, up to y = 1.2 m.
    scan = LaserScan([2.5], [0.0], range_max=20.0)
    fit = rays_at(room, scan, Pose2D(0.6, 0.7))
    assert fit.kind.tolist() == ["visibility"]
    assert fit.wall[0] == pytest.approx(1.4, abs=0.01)
    np.testing.assert_allclose(fit.end, [[3.1, 0.7]])
    above = rays_at(room, scan, Pose2D(0.6, 2.0))
    assert above.kind.tolist() == ["unexplained"]
    assert np.isinf(above.wall[0])
    # The far side of the post is a surface, and faces away: the wall was in the way first.
    behind = rays_at(room, LaserScan([1.75], [0.0], range_max=20.0), Pose2D(0.6, 0.7))
    assert behind.kind.tolist() == ["visibility"]


def test_a_wall_seen_askew_is_vetoed_by_orientation(room) -> None:
    # Points of a wall at 45 degrees, laid with their middle on the wall at the left, x = 0.2 m.
    angles = np.deg2rad(np.arange(-8, 8.5, 0.5))
    slope = 1.0 / (np.cos(angles) + np.sin(angles))
    straight = 1.0 / np.cos(angles)
    pose = Pose2D(1.2, 2.0, np.pi)
    middle = len(angles) // 2
    askew = rays_at(room, LaserScan(slope, angles, range_max=20.0), pose)
    assert askew.kind[middle] == "orientation"
    flat = rays_at(room, LaserScan(straight, angles, range_max=20.0), pose)
    assert (flat.kind == "agrees").all()


def test_a_surface_that_faces_away_does_not_agree() -> None:
    wall = OrientedPoints([[1.0, 0.0], [1.3, 0.0]], [np.pi, 0.0], [0.1, 0.1], [True, True])
    one, unknown = np.zeros(1), np.full(1, np.inf)
    front = faced(np.array([[0.95, 0.0]]), one, one, unknown, wall, reach=0.5)
    back = faced(np.array([[1.32, 0.0]]), one, one, unknown, wall, reach=0.5)
    assert (front.tolist(), back.tolist()) == ([True], [False])
    blind = replace(wall, valid=np.zeros(2, bool))
    assert faced(np.array([[1.32, 0.0]]), one, one, unknown, blind, reach=0.5).all()


def test_only_what_is_near_both_ways_is_asked() -> None:
    # Two points of a wall face the ray and one has its back to it: the same x, three metres aside.
    xy, facing = [[1.0, 0.0], [1.0, 0.4], [1.0, 3.0]], [np.pi, np.pi, 0.0]
    wall = OrientedPoints(xy, facing, [0.1] * 3, [True] * 3)
    ends = np.array([[1.1, 0.1], [1.0, 2.9], [1.0, 1.7]])
    got = faced(ends, np.zeros(3), np.zeros(3), np.full(3, np.inf), wall, reach=0.5)
    assert got.tolist() == [True, False, True]  # the last has nothing near that objects
    assert faced(ends[:0], *np.zeros((3, 0)), wall, reach=0.5).tolist() == []
    none = wall.select(np.zeros(3, bool))
    assert faced(ends, np.zeros(3), np.zeros(3), np.ones(3), none, reach=0.5).all()


def test_an_uncertain_normal_is_given_more_room() -> None:
    end, psi, alpha = np.zeros((1, 2)), np.zeros(1), np.array([np.pi - 0.7])
    for sigma, agrees in ((0.05, False), (0.4, True)):
        wall = OrientedPoints([[0.0, 0.0]], [np.pi], [0.05], [True])
        assert faced(end, psi, alpha, np.array([sigma]), wall, reach=0.5).all() == agrees


@given(st.floats(-3.0, 3.0))
@settings(max_examples=10)
def test_where_the_sensor_looks_is_of_no_importance(turn) -> None:
    features = prepare(room_with_a_post())
    scan = seen_from(features, (3.0, 2.4, 0.0))
    plain = rays_at(features, scan, Pose2D(3.4, 2.5, 0.1))
    askew = LaserScan(scan.ranges, scan.angles - turn, range_max=20.0)
    turned = rays_at(features, askew, Pose2D(3.4, 2.5, 0.1 + turn))
    assert np.mean(plain.kind == turned.kind) > 0.98  # rounding at a border


@pytest.mark.parametrize("method", ALL_METHODS)
def test_the_numbers_are_those_of_the_answer(method) -> None:
    answer = answer_of("visibility", method)
    options = Options(method=method)
    why = explain(features_of("visibility"), scan_of("visibility"), answer, options)
    assert [f.pose for f in why.fits] == [h.pose for h in answer.hypotheses]
    masses = [f.before * (1 - answer.elsewhere) for f in why.fits]
    np.testing.assert_allclose(masses, [h.mass for h in answer.hypotheses])
    evidence = answer.evidence
    assert options.trust.mass_elsewhere(evidence.net, evidence.log_volume) == pytest.approx(
        answer.elsewhere
    )
    assert answer.evidence.misfit == pytest.approx(
        options.fused.model.best - why.fits[0].per_reading, abs=5e-3
    )  # of the best maximum of a mode, which stands at the mean of them
    assert answer.evidence.readings == 120
    if method == "fused":
        gap = [h.log_likelihood for h in answer.hypotheses]
        np.testing.assert_allclose(
            [f.per_reading * answer.evidence.readings for f in why.fits], gap, rtol=1e-6
        )
        odds = np.log(why.fits[0].before / why.fits[1].before) * answer.evidence.temperature.value
        assert odds == pytest.approx(gap[0] - gap[1])
    if answer.verdict == "unique":
        assert all(check.holds for check in answer.evidence.checks)


def test_the_best_likelihood_of_a_picture_is_near_the_pose() -> None:
    why = explain(features_of("curved"), scan_of("curved"), answer_of("curved", "fused"), Options())
    assert why.layer.name == "cbml"
    stack = why.layer.likelihood
    row, column = np.unravel_index(np.argmax(stack.values[0]), stack.grid.shape)
    at = Pose2D((column + 0.5) * stack.grid.resolution, (row + 0.5) * stack.grid.resolution)
    assert error(at, POSES["curved"])[0] < 0.5


def test_pictures_cover_the_map_however_coarse_their_cells(room) -> None:
    scan = seen_from(room, (3.0, 2.4, 0.4))
    layer = explain(room, scan, localize(room, scan), Options()).layer
    info = layer.likelihood.grid
    for n, cells in zip(info.shape, room.grid.occupied.shape, strict=True):
        assert 0 <= n * info.resolution - 0.1 * cells < 4 * info.resolution


def test_a_picture_that_is_too_large_is_left_out_with_the_reason() -> None:
    features, scan = features_of("curved"), scan_of("curved")
    answer = answer_of("curved", "fused")
    why = explain(features, scan, answer, Options(memory_budget=1 << 20))
    assert why.layer.likelihood is None
    assert "the budget is 1 MiB" in why.layer.about


def test_outside_the_prior_the_picture_is_empty(room) -> None:
    scan = seen_from(room, (3.0, 2.4, 0.4))
    cells = near(room.grid.info, 3.0, 2.4, 0.6)
    options = Options(prior=Prior(cells, None, {"near": "here"}))
    why = explain(room, scan, localize(room, scan, options), options)
    cell = why.layer.likelihood.grid.resolution
    rows, columns = np.nonzero(why.layer.likelihood.values[0])
    assert rows.size > 0
    apart = np.hypot((columns + 0.5) * cell - 3.0, (rows + 0.5) * cell - 2.4)
    assert apart.max() < 0.6 + 2.2 * cell


def test_headings_outside_the_prior_are_not_drawn(room) -> None:
    scan = seen_from(room, (3.0, 2.4, 0.4))
    options = Options(prior=Prior(None, (0.4, np.deg2rad(10.0)), {"heading": 0.4}))
    cbml = explain(room, scan, localize(room, scan, options), options).layer
    assert cbml.about.startswith("11 headings")  # every second degree


def test_the_check_that_fails_is_the_last_one(room) -> None:
    rng = np.random.default_rng(0)
    answer = localize(room, LaserScan(rng.uniform(0.3, 3.0, 120), ANGLES, range_max=20.0))
    assert answer.verdict == "no-match"
    assert [c.name for c in answer.evidence.checks] == ["readings", "elsewhere"]
    assert [c.holds for c in answer.evidence.checks] == [True, False]
    assert answer.evidence.checks[1].value == answer.elsewhere
    twins = prepare(hall(30, 30))
    answer = localize(twins, seen_from(twins, (1.0, 1.3, 0.2)))
    assert answer.verdict == "ambiguous"
    assert [c.holds for c in answer.evidence.checks] == [True, True, False]


def test_the_origin_moves_the_pose_and_not_the_rays() -> None:
    grid = room_with_a_post()
    moved = prepare(
        OccupancyGrid(grid.occupied, grid.free, grid.resolution, Pose2D(-5.0, 3.0, 2.0))
    )
    plain = prepare(grid)
    scan = seen_from(plain, (3.0, 2.4, 0.4))
    a, b = (explain(f, scan, localize(f, scan)).fits[0] for f in (plain, moved))
    assert abs(a.pose.theta - b.pose.theta) > 1
    assert a.hypothesis.pose.x == pytest.approx(b.hypothesis.pose.x)
    assert a.rays.kind.tolist() == b.rays.kind.tolist()
    np.testing.assert_allclose(a.hypothesis.covariance, b.hypothesis.covariance, atol=1e-12)


def test_a_scan_of_nothing_has_no_fits(room) -> None:
    far = LaserScan(np.full(120, 70.0), ANGLES, range_max=80.0)
    answer = localize(room, far)
    why = explain(room, far, answer)
    assert why.fits == ()
    assert np.isnan(answer.evidence.misfit)
    assert [c.holds for c in answer.evidence.checks] == [True, False]
