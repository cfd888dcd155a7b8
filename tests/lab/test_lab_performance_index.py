"""The performance index, eq. 12: by hand, its zeros, its pose spaces, footnote 4."""

import numpy as np
import pytest

from imgloc import METHODS, Hypothesis, Localization, OccupancyGrid, Pose2D, Sensor, prepare
from imgloc.geometry import cell_of, theta_bin, uniform_thetas
from imgloc.lab.evaluation import share
from imgloc.lab.performance_index import (
    density_at,
    density_in_cell,
    density_in_stack,
    global_maximum,
    performance_index,
)
from imgloc.likelihoods.stacks import stack_of
from imgloc.simulation.scans import simulate

# Two headings, two rows, three columns; the sums are 20 over the box and 16 over `FREE`.
STACK = np.array([[[0, 1, 2], [3, 0, 4]], [[1, 1, 0], [2, 6, 0]]], dtype=np.float32)
FREE = np.array([[False, True, True], [True, True, False]])


def test_s_by_hand() -> None:
    # N = 12 poses: 6 * 12 / 20 and 2 * 12 / 20
    p = [density_in_stack(STACK, cell) for cell in ((1, 1, 1), (0, 0, 2))]
    assert p == pytest.approx([3.6, 1.2])
    S = performance_index(p)
    a, b = np.log(0.999 * 3.6 + 0.001), np.log(0.999 * 1.2 + 0.001)
    assert S.value == pytest.approx((a + b) / 2)
    assert S.standard_error == pytest.approx(abs(a - b) / 2)  # sd |a-b|/sqrt(2), over sqrt(2)
    assert (S.trials, S.floored) == (2, 0)


def test_free_cells_are_a_smaller_pose_space() -> None:
    free = STACK[:, FREE].sum()
    assert free == 15
    # N = 8 poses in free cells
    assert density_in_stack(STACK, (1, 1, 1), FREE) == pytest.approx(6 * 8 / 15)
    assert density_in_stack(STACK, (0, 1, 2), FREE) == 0  # not a pose of that space
    assert density_in_stack(STACK, (0, 1, 2)) == pytest.approx(4 * 12 / 20)


@pytest.mark.parametrize("cell", [(-1, 0, 0), (2, 0, 0), (0, -1, 0), (0, 2, 0), (0, 0, 3)])
def test_off_the_map_there_is_no_density(cell: tuple[int, int, int]) -> None:
    assert density_in_stack(STACK, cell) == 0


def test_negative_values_count_as_zero_and_logarithms_as_what_they_are() -> None:
    signed = STACK.copy()
    signed[0, 0, 0] = -100
    assert density_in_stack(signed, (1, 1, 1)) == pytest.approx(3.6)
    with np.errstate(divide="ignore"):
        logs = np.log(STACK) + np.float32(500)  # would overflow; -inf is a zero
    assert density_in_stack(logs, (1, 1, 1), log=True) == pytest.approx(3.6, rel=1e-4)
    assert density_in_stack(logs, (1, 1, 1), FREE, log=True) == pytest.approx(3.2, rel=1e-4)
    assert density_in_stack(logs, (0, 0, 0), log=True) == 0


def test_a_stack_that_says_nothing_is_uniform() -> None:
    assert density_in_stack(np.zeros((3, 2, 2), np.float32), (1, 0, 1)) == 1
    assert density_in_stack(np.zeros((3, 2, 2), np.float32), (1, 0, 1), log=True) == 1
    S = performance_index([1.0, 1.0])
    assert (S.value, S.standard_error, S.floored) == (pytest.approx(0), 0, 0)


def test_all_in_the_right_cell_is_log_n() -> None:
    one = np.zeros((5, 4, 3), np.float32)
    one[2, 3, 1] = 7
    p = density_in_stack(one, (2, 3, 1))
    assert performance_index([p]).value == pytest.approx(np.log(60), abs=0.001)


def test_zeros_are_floored_and_counted() -> None:
    S = performance_index([0.0, 1e-4, 1e-3, 2.0])
    assert S.floored == 2
    logs = np.log(np.array([1e-3, 1.0999e-3, 1.999e-3, 1.999]))
    assert S.value == pytest.approx(logs.mean(), rel=1e-6)
    assert performance_index([0.0]).value == pytest.approx(np.log(1e-3))


def test_the_floored_density_still_sums_to_one() -> None:
    p = np.array([density_in_stack(STACK, c) for c in np.ndindex(STACK.shape)])
    floored = np.exp([performance_index([x]).value for x in p])
    assert floored.mean() == pytest.approx(1)
    assert floored.min() == pytest.approx(0.001)


def test_what_makes_no_index_is_nan() -> None:
    assert np.isnan(performance_index([]).value)
    assert np.isnan(performance_index([2.0]).standard_error)


def test_the_first_of_equal_maxima() -> None:
    assert global_maximum(STACK) == (1, 1, 1)
    assert global_maximum(STACK, ~FREE) == (0, 1, 2)
    assert global_maximum(np.ones((2, 2, 2), np.float32), FREE[:, 1:]) == (0, 0, 0)


def answer(*hypotheses: tuple[Pose2D, float, list[float]]) -> Localization:
    found = tuple(Hypothesis(p, 0.0, m, np.diag(c)) for p, m, c in hypotheses)
    return Localization(found, "ambiguous", 0.0, 1.0)


def test_density_of_hypotheses_integrates_to_its_volume() -> None:
    spread = [0.04, 0.09, 0.05]
    two = answer((Pose2D(2, 2, 3.0), 0.5, spread), (Pose2D(4, 3, 0.5), 0.3, spread))
    size, n = (6.0, 5.0, 2 * np.pi), (30, 25, 32)
    axes = [(np.arange(k) + 0.5) * s / k for s, k in zip(size, n, strict=True)]
    volume = float(np.prod(size))
    p = [
        density_at(two, Pose2D(x, y, t), volume) for x in axes[0] for y in axes[1] for t in axes[2]
    ]
    assert np.mean(p) == pytest.approx(1, abs=0.01)
    assert min(p) == pytest.approx(0.2, abs=0.01)  # the mass that no hypothesis has


def test_density_in_cells_sums_to_their_number() -> None:
    # So narrow that a cell holds all of one and parts of the other.
    narrow, wide = [1e-6, 2.5e-5, 1e-6], [0.002, 0.003, 0.05]
    two = answer((Pose2D(0.55, 0.35, 3.1), 0.5, narrow), (Pose2D(0.42, 0.5, 0.1), 0.3, wide))
    n = (10, 10, 12)
    step = 2 * np.pi / n[2]
    p = np.array([
        density_in_cell(two, Pose2D(0.1 * x + 0.05, 0.1 * y + 0.05, k * step), 0.1, step, 1200)
        for x in range(n[0]) for y in range(n[1]) for k in range(n[2])
    ])  # fmt: skip
    assert p.mean() == pytest.approx(1, abs=0.005)
    assert p.max() == pytest.approx(0.5 * 1200 + 0.2, rel=0.01)  # never more than the poses


def test_density_in_a_small_cell_is_that_at_its_middle() -> None:
    wide = [0.04, 0.09, 0.05]
    one = answer((Pose2D(2, 2, 3.1), 0.7, wide))
    at = Pose2D(2.1, 1.8, -3.1)
    volume = 1000 * 0.01**2 * 0.02
    assert density_in_cell(one, at, 0.01, 0.02, 1000) == pytest.approx(
        density_at(one, at, volume), rel=1e-2
    )


def test_density_takes_theta_the_short_way_round() -> None:
    one = answer((Pose2D(0, 0, np.pi - 0.05), 1.0, [0.01, 0.01, 0.01]))
    left, right = (density_at(one, Pose2D(0, 0, np.pi - 0.05 + d), 1.0) for d in (-0.2, 0.2))
    assert left == pytest.approx(right)
    assert left == pytest.approx(np.exp(-2) / (2 * np.pi * 0.01) ** 1.5)


def test_density_uses_the_whole_covariance() -> None:
    along = Hypothesis(Pose2D(0, 0, 0), 0.0, 1.0, np.array([[1, 0.9, 0], [0.9, 1, 0], [0, 0, 1]]))
    one = Localization((along,), "unique", 0.0, 1.0)
    assert density_at(one, Pose2D(1, 1, 0), 1.0) > 5 * density_at(one, Pose2D(1, -1, 0), 1.0)


def test_no_answer_is_no_idea() -> None:
    assert density_at(answer(), Pose2D(1, 2, 3), 77.0) == pytest.approx(1)


def room() -> OccupancyGrid:
    """A closed room with two pillars, and unknown space that its scans do not leave."""
    walls, free = np.zeros((40, 50), bool), np.zeros((40, 50), bool)
    walls[1:39, 1:49] = True
    free[2:38, 2:48] = True
    free[10:14, 12:20] = free[25:33, 30:33] = False
    pad = np.pad(walls & ~free, 50), np.pad(free, 50)
    return OccupancyGrid(*pad, 0.1)


def twice(grid: OccupancyGrid) -> OccupancyGrid:
    return OccupancyGrid(np.tile(grid.occupied, 2), np.tile(grid.free, 2), grid.resolution)


# The beam model rotates the map about its middle: its rounding is another one.
@pytest.mark.parametrize("method", [m for m in METHODS if m != "beam"])
def test_footnote_4_a_map_tiled_twice_has_the_same_s(method: str) -> None:
    scans = simulate(room(), 3, 1, Sensor(rays=46))
    S = []
    for grid in (room(), twice(room())):
        features, p = prepare(grid), []
        thetas = uniform_thetas(np.deg2rad(10.0))
        for scan, (x, y, theta) in zip(scans.scans, scans.poses, strict=True):
            # One engine: `auto` chooses by size, and where nothing fits their rounding differs.
            values = stack_of(method, features, scan, thetas, engine="shift")
            row, col = cell_of(np.array([x, y]), 0.1)
            cell = int(theta_bin(theta, len(values))), int(row), int(col)
            p.append(density_in_stack(values, cell, features.free))
        S.append(performance_index(p).value)
    assert S[0] > 0.5
    assert S[1] == pytest.approx(S[0], abs=1e-3)


def test_footnote_4_for_log_likelihoods_and_the_box() -> None:
    with np.errstate(divide="ignore"):
        logs = np.log(STACK)
    for where in (None, FREE):
        one = density_in_stack(logs, (1, 1, 1), where, log=True)
        both = np.tile(logs, (1, 1, 2)), None if where is None else np.tile(where, 2)
        assert density_in_stack(both[0], (1, 1, 4), both[1], log=True) == pytest.approx(one)


def test_footnote_4_for_hypotheses() -> None:
    pose, spread = Pose2D(1, 2, 3), [0.01, 0.02, 0.03]
    one = answer((pose, 0.8, spread))
    both = answer((pose, 0.4, spread), (Pose2D(101, 2, 3), 0.4, spread))
    near = Pose2D(1.1, 2.1, 3.1)
    assert density_at(both, near, 20.0) == pytest.approx(density_at(one, near, 10.0))


@pytest.mark.parametrize(
    ("hits", "n", "low", "high"),
    # Newcombe (1998), Statistics in Medicine 17: table I, method 3
    [
        (81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ],
)  # fmt: skip
def test_wilson_intervals_of_the_literature(hits: int, n: int, low: float, high: float) -> None:
    s = share([True] * hits + [False] * (n - hits))
    assert (s.hits, s.trials, s.value) == (hits, n, hits / n)
    assert [s.low, s.high] == pytest.approx([low, high], abs=5e-5)
