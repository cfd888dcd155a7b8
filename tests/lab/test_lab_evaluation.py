"""Trials and their summary: frames, cells, zeros, cost."""

import gc

import numpy as np
import pytest
from places import room_with_two_posts as room

from imgloc import ConfigError, ScanSet, Sensor, evaluate, likelihood, localize, prepare, simulate
from imgloc.geometry import cell_of, pose_errors, theta_bin, transform_poses
from imgloc.io.maps import bundled_maps, load_map
from imgloc.lab.evaluation import PAPER_STEPS_DEG, Trial, method_options, run_trials, summarise
from imgloc.likelihoods.posterior import calibrated, posterior
from imgloc.model import LaserScan, Likelihood, OccupancyGrid, Pose2D, compose
from imgloc.options import ALL_METHODS, METHODS, Tolerance
from imgloc.simulation.scans import fine_image, refine_grid, sample_free_poses, simulate_ranges
from imgloc.simulation.worlds import WORLDS, render


def trials(method: str, grid: OccupancyGrid, scans: ScanSet) -> list[Trial]:
    step = None if method == "fused" else np.deg2rad(6.0)
    return list(run_trials(prepare(grid, n_rays=60), scans, method_options(method, step)))


@pytest.fixture(scope="module")
def scans() -> ScanSet:
    return simulate(room(), 3, 4, Sensor(rays=61))


@pytest.mark.parametrize("method", METHODS)
def test_a_trial_is_what_the_stack_says(method: str, scans: ScanSet) -> None:
    found = trials(method, room(), scans)
    features = prepare(room(), n_rays=60)
    for trial, scan, (x, y, theta) in zip(found, scans.scans, scans.poses, strict=True):
        stack = likelihood(features, scan, method_options(method, np.deg2rad(6.0)))
        everywhere = np.ones_like(features.free)
        row, col = cell_of(np.array([x, y]), 0.1)
        k = int(theta_bin(theta, 60))
        for space, p in ((features.free, trial.free), (everywhere, trial.box)):
            share = float(posterior(stack.values, method, space)[k, row, col])
            assert p == pytest.approx(share * 60 * np.count_nonzero(space), rel=1e-3, abs=1e-9)
        sure = calibrated(stack, features.free, 61)[k, row, col]
        poses = 60 * np.count_nonzero(features.free)
        assert trial.calibrated == pytest.approx(float(sure) * poses, rel=1e-3, abs=1e-9)
        masked = np.where(features.free, stack.values, -np.inf)
        best = np.array(np.unravel_index(masked.argmax(), masked.shape))
        gap = np.abs(best - (k, row, col))
        gap[0] = min(gap[0], 60 - gap[0])
        assert (trial.exact, trial.near) == (not gap.any(), gap.max() <= 1)
        assert 0 < trial.stack_ms <= trial.ms
        answer = localize(features, scan, method_options(method, np.deg2rad(6.0)))
        own = np.array([(h.pose.x, h.pose.y, h.pose.theta) for h in answer.hypotheses])
        np.testing.assert_array_equal(trial.errors, pose_errors(own, Pose2D(x, y, theta)))
        assert trial.verdict == answer.verdict


@pytest.mark.parametrize("method", ["fused", "cbml", "ght-v"])
def test_an_origin_with_a_yaw_changes_nothing(method: str, scans: ScanSet) -> None:
    origin = Pose2D(-7.0, 3.0, 2.5)
    moved = ScanSet(scans.scans, poses=transform_poses(origin, np.array(scans.poses)))
    for here, there in zip(
        trials(method, room(), scans), trials(method, room(origin), moved), strict=True
    ):
        assert there.free == pytest.approx(here.free, rel=1e-4)
        assert there.box == pytest.approx(here.box, rel=1e-4)
        assert there.calibrated == pytest.approx(here.calibrated, rel=1e-3)
        assert (there.exact, there.near, there.outside) == (here.exact, here.near, False)
        np.testing.assert_allclose(there.errors, here.errors, atol=1e-6)


@pytest.mark.parametrize("method", ["fused", "cbml-o"])
def test_the_scans_are_found(method: str) -> None:
    scans = simulate(room(), 3, 4, Sensor(rays=120, fov=2 * np.pi))
    found = trials(method, room(), scans)
    assert all(t.near for t in found)
    assert all(t.errors[0, 0] < 0.2 and t.errors[0, 1] < 0.1 for t in found)
    assert all(t.free > 5 for t in found)
    verdicts = {t.verdict for t in found}
    assert verdicts == {"unique"} if method == "fused" else verdicts <= {"unique", "ambiguous"}


@pytest.mark.parametrize("method", ALL_METHODS)
def test_a_pose_outside_free_space_costs_the_floor(method: str, scans: ScanSet) -> None:
    inside_wall, off_map = (0.05, 0.05, 0.0), (-3.0, 1.0, 0.0)
    wrong = ScanSet(scans.scans[:2], poses=np.array([inside_wall, off_map]))
    found = trials(method, room(), wrong)
    assert [t.outside for t in found] == [True, True]
    assert [t.free for t in found] == [t.calibrated for t in found] == [0, 0]
    assert found[1].box == 0
    assert not any(t.near for t in found)
    summary = summarise(found, method)
    assert summary.index.value == pytest.approx(np.log(0.001))
    assert (summary.index.floored, summary.outside) == (2, 2)


@pytest.mark.parametrize("method", ALL_METHODS)
def test_a_scan_without_readings_says_nothing(method: str) -> None:
    blind = LaserScan(np.full(30, np.inf), np.linspace(-1, 1, 30), range_max=10)
    (trial,) = trials(method, room(), ScanSet((blind,), poses=np.array([[1.0, 1.0, 0.5]])))
    assert trial.free == pytest.approx(1)
    assert trial.box == pytest.approx(1)
    summary = summarise([trial], method)
    assert summary.index.value == pytest.approx(0)
    assert summary.index_calibrated.value == pytest.approx(0, abs=1e-5)
    assert summary.position["p50"] == np.inf
    assert trial.verdict == "invalid"


def test_never_more_than_one_stack(scans: ScanSet) -> None:
    run = run_trials(prepare(room()), scans, method_options("cbml"))
    for _ in run:
        gc.collect()
        assert not any(isinstance(o, Likelihood) for o in gc.get_objects())


def made(errors: list[tuple[float, float]], verdict: str = "unique", ms: float = 1.0) -> Trial:
    xy = np.array(errors).reshape(-1, 2)
    return Trial(2.0, 4.0, 8.0, False, False, True, xy, verdict, ms, ms / 2)


def test_success_by_hand() -> None:
    near, turned, far = (0.1, 0.1), (0.1, 0.3), (9.0, 0.0)
    done = [
        made([near], "unique", 1.0), made([turned, near], "unique", 2.0),
        made([far] * 5 + [near], "ambiguous", 3.0), made([], "invalid", 4.0),
    ]  # fmt: skip
    edge = Tolerance(0.1, 1.0)
    s = summarise(done, "fused", tolerances=(Tolerance(0.25, 0.25), edge))
    strict, exact = s.success
    assert (strict.at_1.hits, strict.at_5.hits, strict.at_1.trials) == (1, 2, 4)
    assert strict.unique_wrong.hits == 1
    assert exact.at_1.hits == 0  # nearer, not as near
    assert {v: share.hits for v, share in s.verdicts.items()} == {
        "unique": 2, "ambiguous": 1, "no-match": 0, "invalid": 1,
    }  # fmt: skip
    assert s.position == {"p50": 0.1, "p90": np.inf, "p95": np.inf}
    assert s.heading["p50"] == 0.1
    assert (s.exact.value, s.near.value) == (0, 1)
    assert s.index.value == pytest.approx(np.log(2), abs=1e-3)
    assert s.index_box.value == pytest.approx(np.log(4), abs=1e-3)
    assert s.index_calibrated.value == pytest.approx(np.log(8), abs=1e-3)
    assert s.cost.ms.median == 2.5
    assert s.cost.ms.p99 == pytest.approx(3.97)


def test_evaluate_is_the_same_up_to_its_cost(scans: ScanSet) -> None:
    steps = []
    a, b = (
        evaluate(
            prepare(room(), threads=n),
            scans,
            method_options("ght-v", threads=n),
            advance=lambda: steps.append(1),
        )
        for n in (1, 2)
    )
    assert len(steps) == 6
    assert a.lattice == b.lattice
    assert a.lattice.poses == 12 * int(room().free.sum())
    assert a.lattice.log_poses == pytest.approx(np.log(a.lattice.poses))
    for name in ("index", "exact", "success"):
        assert getattr(a.summary, name) == getattr(b.summary, name)
    assert a.parameters == b.parameters
    with pytest.raises(ConfigError, match="true pose"):
        evaluate(prepare(room()), ScanSet(scans.scans), method_options("ght"))


def test_the_paper_s_steps_are_known_for_every_stack() -> None:
    assert set(PAPER_STEPS_DEG) == set(METHODS)
    assert method_options("fused").theta_step is None
    assert method_options("fused", 0.1).fused.theta_step == 0.1


def test_errors_go_the_short_way_round() -> None:
    e = pose_errors(np.array([[1, 1, np.pi - 0.1], [4, 5, 0]]), Pose2D(1, 1, -np.pi + 0.1))
    np.testing.assert_allclose(e, [[0, 0.2], [5, np.pi - 0.1]])


def test_only_bundled_worlds_are_drawn_finely() -> None:
    path = bundled_maps() / "curved.yaml"
    grid = load_map(path)
    fine = fine_image(path, grid)
    np.testing.assert_array_equal(fine.occupied, render(WORLDS["curved"](), 0.01).occupied)
    assert fine_image(path, load_map(path, resolution=0.05)) is None  # it is smaller now
    assert fine_image(path, load_map(path, origin=(1, 0, 0))) is None
    assert fine_image(path.parent.parent / "curved.yaml", grid) is None


def test_simulated_sets_are_in_the_map_frame() -> None:
    origin = Pose2D(5.0, -2.0, 0.7)
    here, there = (simulate(room(o), 4, 9, Sensor(rays=7)) for o in (None, origin))
    np.testing.assert_allclose(there.poses, transform_poses(origin, np.array(here.poses)))
    np.testing.assert_array_equal(here[2].ranges, there[2].ranges)
    assert here[0].range_max == 30


def test_a_mounted_sensor_sees_from_where_it_is() -> None:
    grid, mount = room(), Pose2D(0.2, -0.1, np.pi / 2)
    robots = sample_free_poses(grid, 30, 6)
    sensors = sample_free_poses(grid, 30, 6, mount=mount)
    for robot, sensor in zip(robots, sensors, strict=True):  # clearance: none is in a wall
        assert pose_errors(sensor, compose(Pose2D(*robot), mount)).max() < 1e-9
    np.testing.assert_array_equal(sample_free_poses(grid, 30, 6, mount=Pose2D(0, 0)), robots)
    kept = simulate(grid, 2, 3, Sensor(rays=5, mount=mount))
    assert kept[0].T_base_laser == mount
    assert kept.poses is not None
    exact = simulate_ranges(refine_grid(grid), kept.poses, kept[1].angles, sigma=0.0)
    np.testing.assert_allclose(kept[1].ranges, exact[1], atol=0.1)  # five sigma: seen from there
    assert len(kept[1].angles) == 5


def test_sensors_in_walls_are_drawn_again() -> None:
    grid, mount = room(), Pose2D(1.0, 0.0)
    sensors = sample_free_poses(grid, 200, 2, mount=mount)
    row, col = cell_of(sensors[:, :2], 0.1).T
    assert len(sensors) == 200
    assert grid.free[row, col].all()
    with pytest.raises(Exception, match=r"mounted at \(90, 0\) m"):
        sample_free_poses(grid, 2, 2, mount=Pose2D(90, 0))
