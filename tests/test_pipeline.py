"""The recipe from end to end: verdicts, frames, options, errors, and real data."""

import dataclasses
import math

import numpy as np
import pytest
from command import MAPS
from hypothesis import given, settings
from hypothesis import strategies as st
from places import ANGLES, answer_of, error, features_of, grid_of, hall, room_with_a_post, scan_of

from imgloc import ConfigError, MapError, MapFeatures, likelihood, load_map, load_scans, simulate
from imgloc.geometry import rotate_covariance, wrap
from imgloc.model import LaserScan, OccupancyGrid, Pose2D, compose, inverse, to_json
from imgloc.options import ALL_METHODS, FusedOptions, Options, Trust
from imgloc.pipeline import localize, localize_many, prepare
from imgloc.search.modes import lead
from imgloc.simulation.scans import simulate_ranges
from imgloc.simulation.worlds import WORLDS, render

INF, NAN = float("inf"), float("nan")

# --- verdicts


@pytest.mark.parametrize("method", ALL_METHODS)
@pytest.mark.parametrize(
    "ranges",
    [
        [],
        [NAN] * 120,
        [INF] * 120,
        [-INF] * 120,
        [0.0] * 120,
        [99.0] * 120,
        [1.0] * 9 + [NAN] * 111,
    ],
    ids=["empty", "nan", "inf", "-inf", "zero", "beyond", "few"],
)
def test_a_scan_with_too_few_readings_is_invalid(method, ranges):
    scan = LaserScan(ranges, ANGLES[: len(ranges)], range_max=30.0)
    answer = localize(features_of("curved"), scan, Options(method=method))
    assert answer.verdict == "invalid"
    assert answer.pose is None
    assert (answer.entropy, answer.explained) == (0, 0)
    assert sum(answer.counts.values()) == len(ranges)


@pytest.mark.parametrize("method", ALL_METHODS)
def test_a_scan_of_another_place_is_no_match(method):
    scan = scan_of("curved")
    shuffled = np.random.default_rng(1).permutation(scan.ranges)
    answer = localize(
        features_of("curved"), LaserScan(shuffled, ANGLES, range_max=30.0), Options(method=method)
    )
    assert answer.verdict == "no-match"
    assert answer.explained < 0.5


@pytest.mark.parametrize("top", [1, 2, 5])
def test_a_room_that_looks_alike_from_both_ends_is_ambiguous(top):
    grid = hall(30, 50)
    pose, twin = (1.7, 1.3, 0.4), (5.4 - 1.7, 3.4 - 1.3, 0.4 - np.pi)
    ranges = simulate_ranges(grid, [pose], ANGLES, sigma=0.0, range_max=20.0)[0]
    answer = localize(prepare(grid), LaserScan(ranges, ANGLES, range_max=20.0), Options(top=top))
    assert answer.verdict == "ambiguous"
    assert len(answer.hypotheses) <= top
    # Two twins and what is left for elsewhere, as bare rooms are in every building; whatever is
    # listed.
    assert answer.hypotheses[0].mass == pytest.approx((1 - answer.elsewhere) / 2, abs=0.1)
    assert answer.elsewhere < 0.4
    assert math.log(2) <= answer.entropy < math.log(3)
    for place in (pose, twin)[: min(2, top)]:
        found = [error(h.pose, place) for h in answer.hypotheses[:2]]
        if top > 1:
            assert any(metres < 0.05 and radians < 0.02 for metres, radians in found)


def test_trust_is_an_option():
    scan, features = scan_of("curved"), features_of("curved")
    valid = int(scan.valid.sum())
    just = Options(trust=Trust(readings=valid))
    assert localize(features, scan, just).verdict == "unique"
    strict = Options(trust=Trust(readings=valid + 1))
    assert localize(features, scan, strict).verdict == "invalid"
    assert (
        localize(features, scan, Options(trust=Trust(elsewhere=(9.0, 0.0, 0.0)))).verdict
        == "no-match"
    )
    assert localize(features, scan, Options(trust=Trust(mass=1.0))).verdict == "ambiguous"


# --- frames


@pytest.mark.parametrize("method", ["fused", "ght-v"])
@given(st.builds(Pose2D, st.floats(-50, 50), st.floats(-50, 50), st.floats(-np.pi, np.pi)))
@settings(max_examples=2)
def test_an_origin_with_a_yaw_takes_the_answer_along(method, origin):
    grid = grid_of("curved")
    there = OccupancyGrid(grid.occupied, grid.free, grid.resolution, origin)
    answer = localize(prepare(there, cell=0.2), scan_of("curved"), Options(method=method))
    before = answer_of("curved", method)
    assert answer.verdict == before.verdict
    for a, b in zip(answer.hypotheses, before.hypotheses, strict=True):
        expected = compose(origin, b.pose)
        assert (a.pose.x, a.pose.y) == pytest.approx((expected.x, expected.y), abs=1e-9)
        assert wrap(a.pose.theta - expected.theta) == pytest.approx(0, abs=1e-9)
        np.testing.assert_allclose(
            a.covariance, rotate_covariance(b.covariance, origin.theta), atol=1e-12
        )
        assert (a.mass, a.log_likelihood) == (b.mass, b.log_likelihood)


def test_a_covariance_long_along_the_corridor_stays_so_in_the_map_frame():
    wall = np.zeros((30, 400), bool)
    wall[[4, 25]] = True
    origin = Pose2D(3.0, -7.0, np.deg2rad(30))
    grid = OccupancyGrid(wall, ~wall, 0.1, origin)
    pose = (20.0, 1.4, 0.2)
    ranges = simulate_ranges(grid, [pose], ANGLES, sigma=0.0, range_max=8.0)[0]
    answer = localize(prepare(grid), LaserScan(ranges, ANGLES, range_max=8.0))
    long = np.linalg.eigh(answer.hypotheses[0].covariance[:2, :2])[1][:, 1]
    assert abs(long @ (math.cos(origin.theta), math.sin(origin.theta))) > 0.999
    # Across the corridor the pose is known, in the frame of the map.
    back = compose(inverse(origin), answer.best)
    assert min(abs(back.y - 1.4), abs(back.y - (3.0 - 1.4))) < 0.05


# --- errors


@pytest.mark.parametrize("missing", ["occupied", "free"])
def test_a_map_without_walls_or_floor_is_refused_by_its_name(missing):
    none, all_ = np.zeros((5, 6), bool), np.ones((5, 6), bool)
    grid = OccupancyGrid(none if missing == "occupied" else all_, none, 0.1)
    if missing == "occupied":
        grid = OccupancyGrid(none, all_, 0.1)
    with pytest.raises(MapError, match=f"floor 3.*{missing}"):
        prepare(grid, "floor 3")


def test_fused_has_no_stack():
    for asked in (Options(), "fused"):
        with pytest.raises(ConfigError, match="method"):
            likelihood(features_of("curved"), scan_of("curved"), asked)


@pytest.mark.parametrize("method", ALL_METHODS)
@pytest.mark.parametrize("shape", [(1, 2), (2, 1), (1, 40), (40, 1), (5, 7)])
def test_the_smallest_maps_are_maps(method, shape):
    wall = np.zeros(shape, bool)
    wall[0, 0] = True
    answer = localize(
        prepare(OccupancyGrid(wall, ~wall, 0.1)),
        LaserScan(np.linspace(1, 3, 60), ANGLES[:60], range_max=30.0),
        Options(method=method),
    )
    assert answer.verdict == "no-match"


@pytest.mark.parametrize("method", ALL_METHODS)
def test_a_small_room_at_the_default_cell(method):
    grid = room_with_a_post()
    pose = (1.25, 2.35, 1.0)
    ranges = simulate_ranges(grid, [pose], ANGLES, range_max=20.0)[0]
    scan = LaserScan(ranges, ANGLES, range_max=20.0)
    metres, radians = error(localize(prepare(grid), scan, Options(method=method)).pose, pose)
    assert metres < 0.2
    assert radians < np.deg2rad(8)


def test_unknown_space_is_no_place_to_be():
    # The same room twice; in the second one nobody has been.
    room = room_with_a_post()
    occupied = np.concatenate((room.occupied, room.occupied), axis=1)
    free = np.concatenate((room.free, np.zeros_like(room.free)), axis=1)
    pose = (1.25, 2.35, 1.0)
    ranges = simulate_ranges(room, [pose], ANGLES, range_max=20.0)[0]
    scan = LaserScan(ranges, ANGLES, range_max=20.0)
    for method in ALL_METHODS:
        answer = localize(prepare(OccupancyGrid(occupied, free, 0.1)), scan, Options(method=method))
        width = room.occupied.shape[1] * 0.1
        assert all(h.pose.x < width for h in answer.hypotheses)


def test_fused_options_reach_the_search():
    few = Options(fused=FusedOptions(rays=31))
    answer = localize(features_of("curved"), scan_of("curved"), few)
    assert answer.parameters["fused"]["rays"] == 31
    assert answer.evidence.readings <= 31


# --- real data


@pytest.mark.parametrize("name", ["fr079", "gh25"])
def test_recorded_scans_are_located(shared, name):
    folder = shared / "data" / name
    features = prepare(load_map(folder / "map.yaml"), name)
    recorded = load_scans(folder / "scans.npz")
    for i in np.linspace(0, len(recorded.scans) - 1, 7).astype(int)[1:-1]:
        scan = recorded.scans[i]
        scan = dataclasses.replace(scan, range_max=min(scan.range_max, 20.0))
        answer = localize(features, scan)
        metres, radians = error(answer.pose, recorded.poses[i])
        assert metres < 0.5, (i, answer.pose)
        assert radians < np.deg2rad(10), (i, answer.pose)
        assert answer.verdict in ("unique", "ambiguous")
        assert answer.counts["valid"] == scan.valid.sum()


def test_a_prepared_map_has_all_that_a_hard_scan_looks_at() -> None:
    grid = render(WORLDS["large"](), 0.1)
    features, lazy = prepare(grid), prepare(grid, ready=False)

    def made(features: MapFeatures) -> dict[int, set[str]]:
        thinner = vars(features).get("_thinner", {})
        return {0: set(vars(features))} | {n: set(vars(there)) for n, there in thinner.items()}

    before, few = made(features), made(lazy)
    scan = LaserScan(np.random.default_rng(0).uniform(1, 9, 181), np.linspace(-1.5, 1.5, 181))
    answers = [localize(which, scan) for which in (features, lazy)]
    assert made(features) == before
    assert few[0] < before[0]
    assert made(lazy) != few
    assert answers[0].verdict == "no-match" == answers[1].verdict
    assert answers[0].evidence.misfit == answers[1].evidence.misfit


@pytest.mark.parametrize(("k", "seed"), [(0, 3), (3, 1), (9, 8)])
def test_a_scan_that_hardly_fits_is_searched_for_by_its_parts(k, seed) -> None:
    features = prepare(load_map(MAPS / "large.yaml"))
    scans = simulate(features.grid, 12, seed=2)
    # More than half of the rays are stopped anywhere before the wall.
    hit, where = np.random.default_rng(seed).random((2, len(scans[k].ranges)))
    ranges = np.where(hit < 0.55, where, 1) * scans[k].ranges
    short = dataclasses.replace(scans[k], ranges=ranges)
    with_less = localize(features, short, Options(fused=FusedOptions(unfit=1e6)))
    found = localize(features, short)
    assert found.evidence.misfit < with_less.evidence.misfit - 0.3
    x, y, _ = scans.poses[k]
    assert math.hypot(found.best.x - x, found.best.y - y) < 0.1
    assert math.hypot(with_less.best.x - x, with_less.best.y - y) > 0.3


@pytest.mark.parametrize("options", [None, Options("cbml", top=3)])
def test_many_scans_are_answered_as_each_alone(options) -> None:
    features, scan = features_of("curved"), scan_of("curved")
    scans = [scan, dataclasses.replace(scan, ranges=scan.ranges + 0.01), scan]
    taken = iter(scans)
    answers = localize_many(features, taken, options)
    found = [next(answers)]
    assert list(taken) == scans[1:]  # one is taken for one answer
    found += localize_many(features, scans[1:], options)
    for one, many in zip((localize(features, s, options) for s in scans), found, strict=True):
        rows = [dataclasses.replace(answer, timings_ms={}).as_row(0) for answer in (one, many)]
        assert to_json(rows[0]) == to_json(rows[1])
    with pytest.raises(TypeError, match="scan must be LaserScan"):
        list(localize_many(features, [scan, scan.ranges]))
    with pytest.raises(ConfigError, match="time budget"):
        localize_many(features, [], Options("ght", time_budget=1.0))


def test_a_place_leads_other_places_not_the_poses_beside_it() -> None:
    poses = np.array([[1.0, 1.0, 0.0], [1.1, 1.0, 0.1], [1.0, 1.0, 1.0], [5.0, 1.0, 0.0]])
    score = np.array([9.0, 8.0, 6.0, 2.0])
    assert lead(poses, score, Options()) == 3.0  # another heading is another hypothesis
    assert lead(poses[:2], score[:2], Options()) == np.inf
    assert lead(poses[:0], score[:0], Options()) == 0.0
