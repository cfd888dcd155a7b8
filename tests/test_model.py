"""The types that flow: what they refuse, what they derive, and that nobody can change them."""

import copy
import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from imgloc import ConfigError, Options, Prior
from imgloc.model import (
    Evidence,
    GridInfo,
    Hypothesis,
    LaserScan,
    Likelihood,
    Localization,
    OccupancyGrid,
    OrientedPoints,
    Pose2D,
)

INF, NAN = float("inf"), float("nan")


def grid(occupied, free, resolution=0.1):
    return OccupancyGrid(np.array(occupied, bool), np.array(free, bool), resolution)


def points(n=3):
    return OrientedPoints(np.arange(2.0 * n).reshape(n, 2), np.zeros(n), np.ones(n), [True] * n)


def frozen_arrays():
    scan = LaserScan([1.0, 2.0], [0.0, 0.1])
    hypothesis = Hypothesis(Pose2D(0, 0), -1.0, 0.5, np.eye(3))
    stack = Likelihood(np.zeros((2, 1, 3)), [0, np.pi], GridInfo(1, 3, 0.1), "cbml")
    p = points()
    return {
        "occupied": grid([[1]], [[0]]).occupied,
        "free": grid([[1]], [[0]]).free,
        "ranges": scan.ranges,
        "angles": scan.angles,
        "xy": p.xy,
        "alpha": p.alpha,
        "sigma_alpha": p.sigma_alpha,
        "valid": p.valid,
        "values": stack.values,
        "thetas": stack.thetas,
        "covariance": hypothesis.covariance,
    }


@pytest.mark.parametrize("name", frozen_arrays())
def test_arrays_are_read_only(name):
    array = frozen_arrays()[name]
    with pytest.raises(ValueError, match="read-only"):
        array[...] = 0


def test_what_the_caller_does_to_an_array_later_changes_nothing():
    walls, buffer = np.array([[True, False]]), np.array([1.0, 2.0])
    held, view = buffer.view(), buffer[:]
    held.flags.writeable = False  # but not what it is a view of
    made = OccupancyGrid(walls, ~walls, 0.1), LaserScan(buffer, held), Prior(walls)
    made += (Hypothesis(Pose2D(0, 0), 0.0, 1.0, np.broadcast_to(buffer[:1], (3, 3))),)
    before = copy.deepcopy(made)
    walls[:], view[:] = True, 7.0
    assert made == before
    assert walls.flags.writeable
    assert buffer.flags.writeable


def test_an_array_that_nobody_can_write_to_is_not_copied():
    ranges = np.array([1.0, 2.0, 3.0])
    ranges.flags.writeable = False
    scan = LaserScan(ranges, [0.0, 0.1, 0.2])
    assert scan.ranges is ranges
    assert np.shares_memory(LaserScan(scan.ranges[1:], scan.angles[1:]).ranges, ranges)
    other = LaserScan(scan.ranges.astype(np.float32), scan.angles)
    assert not np.shares_memory(other.ranges, ranges)
    assert not np.shares_memory(scan.flipped.angles, scan.angles)


def test_what_holds_the_same_is_equal_and_has_one_hash():
    for name in ("grid", "scan", "points", "stack", "answer", "prior"):
        one, same, other = (holding(name, at) for at in (1.0, 1.0, 2.0))
        assert one == same, name
        assert hash(one) == hash(same), name
        assert one != other, name
        assert one != "something else"
        assert same in [other, one], name
        assert len({one, same, other}) == 2, name


def holding(name: str, at: float):
    """Something with arrays in it, with NaN where that may be, made anew."""
    walls = np.eye(2, dtype=bool)
    return {
        "grid": lambda: OccupancyGrid(walls, ~walls, at),
        "scan": lambda: LaserScan([at, NAN], [0.0, 0.1], stamp=NAN),
        "points": lambda: OrientedPoints([[at, 0.0]], [NAN], [0.0], [True]),
        "stack": lambda: Likelihood(np.full((1, 1, 2), at), [0.0], GridInfo(1, 2, 0.1), "cbml"),
        "answer": lambda: Localization(
            (Hypothesis(Pose2D(at, 0.0), 1.0, 1.0, np.eye(3)),), "unique", 0.0, NAN,
            counts={"valid": 3, "nan": 1}, timings_ms={"search": np.random.default_rng().random()},
            parameters={"sigmas": [at, 2.0]}, evidence=Evidence(3, misfit=NAN),
        ),
        "prior": lambda: Options(prior=Prior(walls if at == 1 else ~walls, (0.0, at))),
    }[name]()  # fmt: skip


def map_at(*origin):
    return OccupancyGrid([[True]], [[False]], 0.1, Pose2D(*origin))


def points_of(**shapes):
    shapes = {"xy": (3, 2), "alpha": 3, "sigma_alpha": 3, "valid": 3} | shapes
    return OrientedPoints(**{name: np.zeros(shape) for name, shape in shapes.items()})


def stack_of(*shape):
    return Likelihood(np.zeros(shape), np.zeros(2), GridInfo(3, 4, 0.1), "ght")


@pytest.mark.parametrize(
    ("make", "arguments", "words"),
    [
        *((map_at, at, "origin must be finite") for at in ((NAN, 0, 0), (0, -INF, 0), (0, 0, NAN))),
        *(
            (grid, (np.zeros(a), np.zeros(b)), "one shape")
            for a, b in (((2, 3), (3, 2)), ((4,), (4,)), ((1, 2, 3),) * 2)
        ),
        (grid, ([[1, 0, 0], [0, 0, 1]], [[0, 1, 1], [1, 0, 1]]), r"cell \[1, 2\] is both"),
        *((grid, ([[1]], [[0]], cell), "resolution") for cell in (0.0, -0.1, NAN, INF)),
        *(
            (LaserScan, (np.zeros(a), np.zeros(b)), "one length")
            for a, b in ((3, 4), ((2, 3), (2, 3)), ((), ()))
        ),
        *(
            (LaserScan, ([1.0, NAN, 2.0], [0.0, angle, 0.2]), r"angles\[1\] is")
            for angle in (NAN, INF, -INF)
        ),
        *(
            (stack_of, shape, "thetas, rows, columns")
            for shape in ((2, 4, 3), (3, 3, 4), (3, 12), (1, 3, 3, 4))
        ),
    ],
)
def test_what_cannot_be_is_refused(make, arguments, words):
    with pytest.raises(ValueError, match=words):
        make(*arguments)


@pytest.mark.parametrize(
    "other", [{"xy": (2, 2)}, {"xy": (3, 3)}, {"alpha": 2}, {"sigma_alpha": 2}, {"valid": 2}]
)
def test_oriented_points_agree_in_length(other):
    assert len(points_of()) == 3
    with pytest.raises(ValueError, match="agree in length"):
        points_of(**other)


@pytest.mark.parametrize("value", [Pose2D(0, 0), GridInfo(1, 1, 0.1), grid([[1]], [[0]]), points()])
def test_fields_cannot_be_assigned(value):
    name = dataclasses.fields(value)[0].name
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(value, name, 1)


def test_a_pose_holds_plain_floats_and_a_wrapped_heading():
    pose = Pose2D(np.float32(1), 2, np.int64(4))
    assert [type(v) for v in (pose.x, pose.y, pose.theta)] == [float] * 3
    assert pose.theta == pytest.approx(4 - 2 * np.pi)
    assert Pose2D(1, 2).theta == 0.0
    assert Pose2D(0, 0, np.pi) == Pose2D(0, 0, -np.pi)


def test_rows_come_before_columns():
    g = grid(np.zeros((2, 5)), np.ones((2, 5)))
    assert (g.info.height, g.info.width, g.info.shape) == (2, 5, (2, 5))
    assert g.info.resolution == 0.1
    assert g.info.origin == Pose2D(0, 0, 0)


def test_cells_are_bool_and_unknown_ones_neither_occupied_nor_free():
    g = OccupancyGrid(np.array([[2, 0, 0]]), np.array([[0, 1, 0]]), 1.0)
    assert (g.occupied.dtype, g.free.dtype) == (bool, bool)
    assert g.unknown.tolist() == [[False, False, True]]


# What each reading is, with range_min 0.5 and range_max 8 (REP 117).
READINGS = {
    0.5000001: "valid",
    7.9999: "valid",
    0.5: "too_close",
    0.0: "too_close",
    -1.0: "too_close",
    -INF: "too_close",
    8.0: "no_return",
    81.9: "no_return",
    INF: "no_return",
    NAN: "nan",
}


@pytest.mark.parametrize(("reading", "kind"), READINGS.items())
def test_each_reading_is_of_one_kind(reading, kind):
    scan = LaserScan([reading], [0.0], range_min=0.5, range_max=8.0)
    assert scan.counts == {"valid": 0, "no_return": 0, "too_close": 0, "nan": 0} | {kind: 1}
    assert scan.valid.tolist() == [kind == "valid"]
    assert scan.no_return.tolist() == [kind == "no_return"]


def test_without_a_range_max_every_distance_counts_that_a_sensor_may_reach():
    for range_max in (INF, 3.4e38):
        scan = LaserScan([0.0, 1e-9, 9e5, INF, NAN, 1e6, 1.7e308], np.zeros(7), 0.0, range_max)
        assert scan.valid.tolist() == [False, True, True, False, False, False, False]
        assert scan.no_return.tolist() == [False, False, False, True, False, True, True]
        assert sum(scan.counts.values()) == 7


@given(
    arrays(float, st.integers(0, 30), elements=st.floats(width=32)),
    st.floats(-1, 5),
    st.floats(-1, 10) | st.just(INF),
)
def test_the_counts_add_up(ranges, range_min, range_max):
    scan = LaserScan(ranges, np.zeros(len(ranges)), range_min=range_min, range_max=range_max)
    assert sum(scan.counts.values()) == len(ranges)
    assert not (scan.valid & scan.no_return).any()
    assert scan.valid.dtype == scan.no_return.dtype == bool
    kept = scan.ranges[scan.valid]
    assert np.all((kept > range_min) & (kept < range_max) & np.isfinite(kept))


def test_the_readings_are_kept_as_recorded():
    raw = [1.0, INF, NAN, 99.0]
    np.testing.assert_array_equal(LaserScan(raw, np.zeros(4), range_max=10).ranges, raw)


def test_oriented_points_are_selected_together():
    p = OrientedPoints([[0, 1], [2, 3], [4, 5]], [0.1, 0.2, 0.3], [1, 2, 3], [True, False, True])
    assert len(p) == 3
    for index in (np.array([2, 0]), np.array([False, True, True])):
        some = p.select(index)
        assert len(some) == 2
        for name in ("xy", "alpha", "sigma_alpha", "valid"):
            np.testing.assert_array_equal(getattr(some, name), getattr(p, name)[index])
    assert p.select(np.array([2, 0])).xy.tolist() == [[4, 5], [0, 1]]


def test_a_stack_is_single_precision():
    assert stack_of(2, 3, 4).values.dtype == np.float32


def test_the_pose_of_an_answer_is_that_of_its_first_hypothesis():
    first, second = (Hypothesis(Pose2D(x, 0), -x, 0.5, np.eye(3)) for x in (1, 2))
    assert Localization((first, second), "ambiguous", 0.69, 0.9).pose == Pose2D(1, 0)
    nothing = Localization((), "invalid", 0.0, 0.0)
    assert nothing.pose is None
    assert dict(nothing.counts) == dict(nothing.timings_ms) == dict(nothing.parameters) == {}


@pytest.mark.parametrize("factor", [0.97, 1.05, 0.001])
def test_codes_for_nothing_seen_stay_codes_when_ranges_are_scaled(factor: float) -> None:
    unit = 1.0 if factor > 0.1 else 1000.0
    ranges = np.concatenate((np.full(60, 81.91), np.linspace(2.9, 3.1, 40))) * unit
    scan = LaserScan(ranges, np.linspace(0, 3, 100), range_max=80.0 * unit)
    assert scan.counts["valid"] == 40
    assert scan.scaled(factor).counts == scan.counts
    assert scan.scaled(factor).range_max == pytest.approx(80 * unit * factor)
    blind = LaserScan(np.full(100, 81.91 * unit), scan.angles, range_max=80.0 * unit)
    assert blind.scaled(factor).counts["valid"] == 0


def test_a_limit_in_metres_beside_ranges_in_millimetres_stays() -> None:
    ranges = np.concatenate((np.arange(1000.0, 4000, 50), np.full(90, 81910.0), np.zeros(9)))
    scan = LaserScan(ranges, np.linspace(0, 3, len(ranges)), range_max=30.0).scaled(0.001)
    assert (scan.range_max, scan.counts["valid"], scan.counts["no_return"]) == (30.0, 60, 90)


@pytest.mark.parametrize("at", [(100.0, 0.0), (0.0, -6.0), (np.nan, 0.0)])
def test_no_sensor_sits_farther_from_its_base_than_robots_are_large(at) -> None:
    with pytest.raises(ConfigError, match="are these centimetres"):
        LaserScan([1.0], [0.0], T_base_laser=Pose2D(*at))
    assert LaserScan([1.0], [0.0], T_base_laser=Pose2D(-3.0, 4.0)).T_base_laser is not None
