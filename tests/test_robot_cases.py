"""Robots that misled imgloc: several in a log, lasers that move, noisy mounts, late odometry."""

import math
from pathlib import Path

import numpy as np
import pytest
from command import call, rows
from places import features_of, grid_of

import imgloc
from imgloc import LaserScan, OccupancyGrid, Odometry, Pose2D, Tracking
from imgloc.features.distance import distance_image
from imgloc.features.raycast import cast_rays
from imgloc.filters.follow import BLIND, STANDING
from imgloc.model import FloatArray
from imgloc.simulation.scans import simulate_ranges

ANGLES = np.deg2rad(np.arange(-135, 135.5, 1.5))
# Straight along a free row of the world "curved": metres, metres, radians.
WAY = np.column_stack((np.arange(2.0, 11.0, 0.1), np.full(90, 6.05), np.zeros(90)))


@pytest.fixture
def cases(shared: Path) -> Path:
    pytest.importorskip("rosbags", reason="reads bags: the extra ros")
    if not (shared / "cases").exists():
        pytest.skip("no cases beside the checkout")
    return shared / "cases"


@pytest.mark.parametrize(
    ("bag", "truth", "words", "taken"),
    [
        ("01-two-robots-one-bag/two.bag", "01-two-robots-one-bag/truth_tb3_1.csv",
         ("--topic", "/tb3_1/scan"), "/tb3_1/odom"),
        ("03-odom-frame-with-two-children/children.bag",
         "03-odom-frame-with-two-children/truth.csv", (), "tf odom -> base_footprint"),
        ("04-nodding-laser/pan.bag", "04-nodding-laser/truth.csv", (), "/odom"),
        ("18-odom-frame-names/odom_combined.bag", "03-odom-frame-with-two-children/truth.csv", (),
         "tf odom_combined -> base_link"),
        ("02-ground-truth-taken-for-odometry/gt.bag",
         "03-odom-frame-with-two-children/truth.csv", (), "/robot/odom"),
    ],
)  # fmt: skip
def test_logs_that_misled_give_right_poses(cases, bag, truth, words, taken) -> None:
    said = call("inspect", cases / bag, "--json", *words)
    assert rows(said.out)[0]["recording"]["odometry"] == taken
    if words:
        assert "--topic picks one of /tb3_0/scan,/tb3_1/scan" in call("inspect", cases / bag).out
    done = call("track", "large", cases / bag, "--json", *words).ends(0)
    true = np.loadtxt(cases / truth)
    found = [row for row in rows(done.out) if row["pose"] is not None]
    assert len(found) > 30
    for row in found:
        x, y, theta = true[row["index"] + len(true) - 60]
        assert math.hypot(row["pose"]["x"] - x, row["pose"]["y"] - y) < 0.3
        assert abs(math.remainder(row["pose"]["theta"] - theta, math.tau)) < math.radians(5)


def scan(ranges: FloatArray, k: int, mount: Pose2D | None = None) -> LaserScan:
    return LaserScan(ranges, ANGLES, range_max=12.0, stamp=0.1 * k, T_base_laser=mount)


@pytest.fixture(scope="module")
def drive() -> FloatArray:
    return simulate_ranges(grid_of("curved"), WAY, ANGLES, sigma=0.02, seed=2, range_max=12.0)


def followed(log, name="curved") -> list[tuple[str, str]]:
    """Verdict and what is withheld along scans with their odometry."""
    follower = Tracking().follower(features_of(name), imgloc.Options())
    moments = [follower.step(one, odom) for one, odom in log]
    return [(m.belief.verdict, m.withheld) for m in moments]


@pytest.mark.parametrize(("noise", "kind"), [(1e-9, "blind"), (1e-3, "frozen")])
def test_noise_in_a_mount_changes_no_verdict(drive, noise, kind) -> None:
    rng = np.random.default_rng(0)
    log = []
    for k in range(60):
        mount = Pose2D(noise * rng.standard_normal(), 0.0, noise * rng.standard_normal())
        ranges = drive[k] if k < 30 else drive[29] if kind == "frozen" else np.full(181, np.nan)
        log.append((scan(ranges, k, mount), np.array([0.1 * k, 0, 0])))
    told = followed(log)
    assert told[29][0] == "unique"
    assert {word for _, word in told[30:]} == {BLIND}


def test_a_driver_that_reuses_its_buffer_gives_the_same_poses(drive) -> None:
    buffer = np.empty(181)

    def reused():  # filled anew once the scan before has been followed
        for k in range(40):
            buffer[:] = drive[k]
            yield scan(buffer, k), WAY[k]

    assert followed(reused()) == followed((scan(drive[k].copy(), k), WAY[k]) for k in range(40))


def late(hz: float, delay: float, drive: FloatArray) -> list[FloatArray]:
    """Odometry at the scans, of poses that come `hz` times a second and `delay` s late."""
    times, odometry, out = 0.1 * np.arange(90), Odometry(), []
    come = iter(np.arange(0.0, 9.5, 1 / hz))
    for t in times:
        while odometry.waits(t):  # as a node waits for the next one
            r = next(come)
            odometry.add(r, (2.0 + r, 6.05, 0.0))
        out.append(odometry.at(t))
    return out


@pytest.mark.parametrize("hz", [10, 20, 50])
@pytest.mark.parametrize("delay", [0.0, 0.3])
def test_late_odometry_is_waited_for_and_exact(drive, hz, delay) -> None:
    """At a metre a second, held odometry would be up to 0.4 m behind."""
    np.testing.assert_allclose(late(hz, delay, drive), WAY, atol=1e-6)


def corridor(length: float, reach: float, noise: float, n: int) -> tuple[OccupancyGrid, list]:
    """A bare corridor with rooms at its ends, and scans along it."""
    res, cells = 0.05, round(length / 0.05)
    free = np.zeros((160, cells + 200), bool)
    free[60:100, 20 : cells + 100] = True
    free[30:130, cells + 100 : cells + 180] = True
    free[30:60, 20:60] = free[40:70, cells + 120 : cells + 128] = True
    free[40:70, cells + 120 : cells + 128] = False
    grid = OccupancyGrid(~free, free, res)
    walls, rng, log = distance_image(grid.occupied), np.random.default_rng(0), []
    for k in range(n):
        x = (cells + 140) * res - 0.1 * k
        seen = cast_rays(walls, [x, 4.05], math.pi + ANGLES, reach, res).astype(float)
        seen = np.where(seen < reach, seen + rng.normal(0, noise, len(ANGLES)), np.inf)
        one = LaserScan(seen, ANGLES, range_max=reach, stamp=0.1 * k)
        log.append((one, np.array([0.1 * k, 0, 0])))
    return grid, log


@pytest.mark.parametrize(("noise", "reach"), [(0.003, 3.5), (0.01, 8.0)])
def test_a_good_lidar_in_a_bare_corridor_is_not_blind(noise, reach) -> None:
    grid, log = corridor(10.0, reach, noise, 100)
    follower = Tracking().follower(imgloc.prepare(grid), imgloc.Options(threads=1))
    told = [follower.step(one, odom) for one, odom in log]
    assert sum(m.withheld == BLIND for m in told) <= 1
    assert sum(m.belief.verdict == "unique" for m in told) > 60
    again = [follower.step(log[-1][0], [0.1 * k, 0, 0], 0.1 * k) for k in range(100, 210)]
    assert BLIND in {m.withheld for m in again}  # a frozen one is, once it should see the end


def test_a_parked_robot_in_a_simulator_without_noise_is_not_blind() -> None:
    grid = grid_of("large")
    walls = distance_image(grid.occupied)
    follower = Tracking().follower(features_of("large"), imgloc.Options(threads=1))
    told = []
    for k in range(70):
        x = 45.0 - 0.1 * min(k, 40)
        seen = cast_rays(walls, [x, 20.3], math.pi + ANGLES, 12.0, grid.resolution).astype(float)
        one = LaserScan(seen, ANGLES, range_max=12.0, stamp=0.1 * k)
        told.append(follower.step(one, np.array([-x, 0, 0])))
    assert told[40].belief.verdict == "unique"
    assert {(m.belief.verdict, m.withheld) for m in told[41:]} == {("unique", "")}


@pytest.mark.parametrize("trembles", [0.0, 0.01])
def test_a_robot_that_stands_is_told_nothing_however_often_it_looks(drive, trembles) -> None:
    """For 15 s; its odometry trembles by a centimetre, which is no way."""
    rng, log = np.random.default_rng(1), []
    for k in range(150):
        ranges = drive[0] + rng.normal(0, 0.01, 181)
        log.append((scan(ranges, k), rng.normal(0, trembles, 3) * (1, 1, 0.5)))
    told = followed(log)
    assert "unique" not in {verdict for verdict, _ in told}
    assert trembles or {word for _, word in told[1:]} == {STANDING}


def test_the_given_odometry_must_be_finite_and_nothing_changes_if_it_is_not(drive) -> None:
    follower = Tracking().follower(features_of("curved"), imgloc.Options())
    with pytest.raises(imgloc.ScanError, match=r"odom\[0\]: got \[nan"):
        follower.step(scan(drive[0], 0), np.array([math.nan, 0, 0]))
    assert follower.step(scan(drive[0], 0), WAY[0]).index == 0


def test_odometry_that_stops_and_comes_back_is_counted_once(drive) -> None:
    """What nobody measured confirms nothing, and no way is driven twice."""
    follower = Tracking().follower(features_of("curved"), imgloc.Options(threads=1))
    for k in range(40):
        odom = None if k in (5, 20, 21) else WAY[k]
        moment = follower.step(scan(drive[k], k), odom)
        assert moment.metres == pytest.approx(0.1 * k, abs=0.35)
    assert moment.belief.verdict == "unique"
    assert math.hypot(moment.best.x - WAY[39, 0], moment.best.y - WAY[39, 1]) < 0.1


def test_a_damaged_odometry_costs_two_scans(drive) -> None:
    follower = Tracking().follower(features_of("curved"), imgloc.Options(threads=1))
    follower.step(scan(drive[0], 0), np.array([1e9, 0, 0]))
    with pytest.raises(imgloc.ScanError, match="the log is damaged"):
        follower.step(scan(drive[1], 1), WAY[1])
    assert follower.step(scan(drive[2], 2), WAY[2]).metres == pytest.approx(0.1)
