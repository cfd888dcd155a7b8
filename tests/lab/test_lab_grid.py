"""The grid filter against eq. 1 as loops over pairs of cells."""

import math

import numpy as np
import pytest
from places import POSES, features_of, room_with_a_post, scan_of

from imgloc import ConfigError, OccupancyGrid, Options, Pose2D, ScanSet, Shared, follow, prepare
from imgloc.filters.motion import MotionNoise, deviations
from imgloc.geometry import in_grid_frame, uniform_thetas, wrap
from imgloc.lab.grid import (
    GridFilter,
    GridOptions,
    _shift_far,
    _shift_near,
    gaussian,
    predict,
    turn,
)
from imgloc.lab.particle import ParticleFilter


def spread_1d(shift: float, sigma: float, count: int) -> dict[int, float]:
    """Weights of moving by `shift` cells and blurring, by whole cells moved."""
    whole = math.floor(shift)
    taps = np.asarray(gaussian(sigma), dtype=np.float64).ravel()
    half = len(taps) // 2
    out: dict[int, float] = {}
    for part, near in ((1 - (shift - whole), whole), (shift - whole, whole + 1)):
        for j, tap in enumerate(taps):
            to = near + j - half
            out[to] = out.get(to, 0.0) + part * tap
    assert count
    return out


def literal(belief, thetas, cell, free, increment, noise, likelihood):
    """eq. 1: the sum over all cells of where the robot was, times what the scan says."""
    K, H, W = belief.shape
    first, along, second = deviations(increment, noise)
    go = math.hypot(increment[0], increment[1])
    blur, turned = max(along, first * go) / cell, math.hypot(first, second)
    prediction = np.zeros((K, H, W))
    headings = spread_1d(increment[2] * K / (2 * math.pi), turned * K / (2 * math.pi), K)
    for k in range(K):
        c, s = math.cos(thetas[k]), math.sin(thetas[k])
        dx = round((c * increment[0] - s * increment[1]) / cell * 32) / 32
        dy = round((s * increment[0] + c * increment[1]) / cell * 32) / 32
        columns, rows = spread_1d(dx, blur, W), spread_1d(dy, blur, H)
        for row in range(H):
            for column in range(W):
                for dr, p in rows.items():
                    for dc, q in columns.items():
                        to = row + dr, column + dc
                        if not (0 <= to[0] < H and 0 <= to[1] < W and free[to]):
                            continue
                        for dk, t in headings.items():
                            mass = belief[k, row, column] * p * q * t
                            prediction[(k + dk) % K, to[0], to[1]] += mass
    posterior = prediction * likelihood
    return prediction / prediction.sum(), posterior / posterior.sum()


@pytest.mark.parametrize("increment", [(0.23, -0.11, 0.9), (-0.3, 0.0, -2.5), (0.0, 0.0, 0.2)])
def test_a_step_is_that_of_literal_loops(increment: tuple[float, float, float]) -> None:
    rng = np.random.default_rng(7)
    K, H, W, cell = 8, 6, 7, 0.1
    free = rng.random((H, W)) > 0.2
    belief = (rng.random((K, H, W)) * free).astype(np.float32)
    belief /= belief.sum()
    likelihood = rng.random((K, H, W)) + 0.05
    noise = MotionNoise(0.02, 0.05, 0.08, 0.01, (0.01, 0.05))
    thetas, step = uniform_thetas(2 * np.pi / K), np.array(increment)
    moved = predict(belief, thetas, cell, free, step, noise)
    expected, posterior = literal(belief, thetas, cell, free, step, noise, likelihood)
    np.testing.assert_allclose(moved, expected, atol=2e-6)
    updated = moved * likelihood
    np.testing.assert_allclose(updated / updated.sum(), posterior, atol=2e-6)


def test_mass_is_kept_and_none_is_in_walls() -> None:
    rng = np.random.default_rng(0)
    free = rng.random((40, 50)) > 0.3
    belief = (rng.random((12, 40, 50)) * free).astype(np.float32)
    belief /= belief.sum()
    for step in rng.uniform(-0.4, 0.4, (10, 3)):
        belief = predict(belief, uniform_thetas(np.pi / 6), 0.1, free, step, MotionNoise())
        assert belief.sum(dtype=np.float64) == pytest.approx(1, abs=1e-5)
        assert not belief[:, ~free].any()


def test_headings_turn_around_the_circle() -> None:
    stack = np.zeros((36, 1, 1), np.float32)
    stack[35] = 1
    assert int(turn(stack, np.deg2rad(20), 0.0).argmax()) == 1
    half = turn(stack, np.deg2rad(5), 0.0).ravel()
    np.testing.assert_allclose(half[[35, 0]], 0.5, atol=1e-6)
    assert turn(stack, 0.0, np.deg2rad(25)).sum() == pytest.approx(1, abs=1e-6)


def local(name: str) -> np.ndarray:
    p = in_grid_frame(Pose2D(*POSES[name]), features_of(name).grid)
    return np.array([p.x, p.y, p.theta])


def test_it_finds_the_place_and_then_computes_a_box_only() -> None:
    grid = GridFilter(features_of("curved"), how=GridOptions(method="cbml"))
    assert grid.belief.verdict == "lost"
    for _ in range(3):
        grid.see(scan_of("curved"))
        grid.move(np.array([0.0, 0.0, 1e-9]))
        grid.move(np.array([0.0, 0.0, -1e-9]))
    assert grid._belief.shape[1:] != features_of("curved").lattice.shape
    best, truth = grid.belief.poses[0], local("curved")
    assert np.hypot(*(best - truth)[:2]) < 0.3
    assert abs(wrap(best[2] - truth[2])) < 0.2
    assert grid.stack.sum() == pytest.approx(1, abs=1e-5)


def test_a_wrong_place_is_noticed_and_left() -> None:
    features = features_of("visibility")
    grid = GridFilter(features, how=GridOptions(method="cbml"))
    grid.place(np.array([3.0, 3.0, 0.0]), (0.1, 0.1))
    scan, truth = scan_of("visibility"), local("visibility")
    for _ in range(8):
        grid.see(scan)
        grid.move(np.array([0.3, 0.0, 0.0]))
        grid.move(np.array([-0.3, 0.0, 0.0]))
    assert grid.belief.resets > 0
    assert np.hypot(*(grid.belief.poses[0] - truth)[:2]) < 0.5


def test_memory_is_estimated_before_it_is_taken() -> None:
    features = prepare(room_with_a_post())
    with pytest.raises(ConfigError, match="use larger cells"):
        GridFilter(features, Options(memory_budget=10_000))


def test_wide_blurs_are_as_narrow_ones_by_another_way() -> None:
    image = np.random.default_rng(0).random((30, 41), np.float32)
    for shift in ((3.25, -2.0), (-30.0, 12.5), (80.0, 0.0)):
        near, far = (f(image, np.array(shift), 16.0) for f in (_shift_near, _shift_far))
        np.testing.assert_allclose(far, near, atol=2e-3)


@pytest.mark.parametrize("seen", [False, True])
def test_motion_between_two_looks_takes_the_box_along(seen: bool) -> None:
    features = prepare(room_with_a_post(160, 60))
    grid = GridFilter(features)
    grid.place(np.array([0.5, 3.0, 0.0]), (0.05, 0.05))
    for _ in range(16):
        grid.move(np.array([0.25, 0.0, 0.0]))
        if seen:  # what a look does to the box
            grid._sparse()
        assert grid._belief.shape[2] < 0.6 * features.lattice.width
    np.testing.assert_allclose(grid.belief.poses[0], [4.5, 3.0, 0.0], atol=0.1)
    assert grid.stack.sum() == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize("metres", [12.0, 1e150])
def test_a_jump_of_the_odometry_costs_what_the_map_costs(metres: float) -> None:
    features = features_of("large")  # wide: loops over all that the jump may be take minutes
    grid = GridFilter(features)
    grid.place(local("large"), (0.1, 0.1))
    grid.move(np.array([metres, 0.0, 0.0]))
    lost = grid.belief.verdict == "lost" and not len(grid.belief.poses)
    assert lost == (metres > 100)
    assert grid.stack.sum() == pytest.approx(1, abs=1e-4)


def test_a_log_that_jumps_off_the_map_is_lost_and_found_again() -> None:
    features, three = features_of("curved"), tuple(scan_of("curved", seed) for seed in range(3))
    odom = np.array([[0.0, 0, 0], [0, 0, 0.01], [300.0, 0, 0]])
    scans = ScanSet(three, odom=odom, stamps=10.0 * np.arange(3))
    grid = GridFilter(features, how=GridOptions(method="cbml"))
    moments = list(follow(features, scans, grid, start=Pose2D(*POSES["curved"])))
    assert [m.belief.verdict for m in moments][2] != "unique"
    assert (
        np.hypot(moments[2].best.x - POSES["curved"][0], moments[2].best.y - POSES["curved"][1])
        < 0.5
    )


@pytest.mark.parametrize("kind", [GridFilter, ParticleFilter])
@pytest.mark.parametrize(("cells", "shared", "sure"), [
    (1, Shared(), (True, True)),
    (5, Shared(), (False, False)),
    (5, Shared(straight=True), (True, True)),
    (5, Shared(bent=0.1), (False, True)),
])  # fmt: skip
def test_where_walls_are_drawn_thick_nothing_is_unique(kind, cells, shared, sure) -> None:
    walls = np.pad(np.zeros((60, 80), bool), cells, constant_values=True)
    features = prepare(OccupancyGrid(walls, ~walls, 0.1))
    found = kind(features, Options(shared=shared))
    found._followed.metres = 10.0
    belief = found._belief_of(np.array([[3.0, 3.0, 0.0]]), np.ones(1), 1.0)
    known = sure[kind is ParticleFilter]
    assert belief.verdict == ("unique" if known else "ambiguous")
    assert bool(found.unsure) == (not known)
