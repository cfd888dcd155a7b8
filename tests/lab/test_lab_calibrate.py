"""Fitting a calibration: the sweep against the posterior itself, and what the fit chooses."""

import dataclasses

import cv2
import numpy as np
import pytest
from places import room_with_two_posts
from walls import redrawn

from imgloc import ConfigError, GridInfo, Likelihood, OccupancyGrid, Pose2D, likelihood, prepare
from imgloc.lab import calibrate
from imgloc.lab.calibrate import (
    EXPONENTS,
    SharedFit,
    Sweep,
    densities,
    disturbed_set,
    fit,
    fit_depth,
    fit_shared,
    sweep,
)
from imgloc.lab.evaluation import cell_of_pose
from imgloc.lab.performance_index import density_in_stack, performance_index
from imgloc.lab.tables import SHARP, shared_words
from imgloc.likelihoods.posterior import calibrated
from imgloc.options import METHODS, Calibration, Options, Sensor, Shared
from imgloc.simulation.scans import simulate
from imgloc.simulation.worlds import WORLDS, render

ROOM = room_with_two_posts(Pose2D(3.0, -2.0, 0.5))


@pytest.mark.parametrize("method", METHODS)
def test_a_sweep_has_what_the_posterior_says(method: str) -> None:
    features = prepare(ROOM, n_rays=72)
    scans = simulate(ROOM, 2, 4, Sensor(rays=61))
    options = Options(method=method, theta_step=float(np.deg2rad(15)))
    swept = sweep(features, scans, options)
    assert swept.logs.shape == (2, len(swept.configurations), len(EXPONENTS))
    assert len(swept.configurations) == (1 if method == "beam" else 12)
    for k, (scan, pose) in enumerate(zip(scans.scans, scans.poses, strict=True)):
        stack = likelihood(features, scan, options)
        at = cell_of_pose(features, Pose2D(*pose), 24)
        for c in (0, len(swept.configurations) - 1):
            for e in (0, 30, 48):
                how = Calibration(*swept.configurations[c], temperature=1 / EXPONENTS[e])
                p = calibrated(stack, features.free, 61, how)
                density = density_in_stack(p, at, features.free)
                expected = np.log(0.999 * density + 0.001)
                assert swept.logs[k, c, e] == pytest.approx(expected, abs=0.02)
        bare = density_in_stack(stack.values, at, features.free, log=method == "beam")
        assert swept.bare[k] == pytest.approx(np.log(0.999 * bare + 0.001), abs=0.02)


@pytest.mark.parametrize("method", ["ght", "beam"])
def test_densities_by_hand(method: str) -> None:
    walls = np.array([[0, 0, 0, 1]], bool)
    features = prepare(OccupancyGrid(walls, ~walls, 0.1))
    likely = np.array([[[1.0, 2.0, 4.0, 99.0]]], np.float32)
    values = np.log(likely) if method == "beam" else likely
    stack = Likelihood(values, np.zeros(1), GridInfo(1, 4, 0.1), method)
    powers = np.array([1.0, 2.0])
    got = densities(stack, (0, 0, 1), features, powers)
    assert got == pytest.approx([3 * 2 / 7, 3 * 4 / 21], rel=1e-4)
    assert densities(stack, (0, 0, 3), features, powers).tolist() == [0, 0]  # in the wall
    assert densities(stack, (0, 5, 0), features, powers).tolist() == [0, 0]  # off the map


def test_no_votes_say_nothing_and_none_at_the_pose_say_no() -> None:
    walls = np.array([[0, 0, 1]], bool)
    features = prepare(OccupancyGrid(walls, ~walls, 0.1))
    grid = GridInfo(1, 3, 0.1)
    for votes, expected in (([0, 0, 0], 1.0), ([5, 0, 0], 0.0), ([5, -1, 0], 0.0)):
        stack = Likelihood(np.array([[votes]], np.float32), np.zeros(1), grid, "ght")
        assert densities(stack, (0, 0, 1), features, np.ones(1)).tolist() == [expected]


def made(best: int, peak: float = 5.0, width: float = 1.0) -> Sweep:
    """Trials whose S falls off around an exponent, the same in each but for a shift."""
    curve = peak - width * np.abs(np.arange(len(EXPONENTS)) - best)
    both = np.stack([curve - 2.0, curve])
    shift = np.tile([-0.5, 0.5], 10)[:, None, None]
    return Sweep("ght", ((0.0, 0.0), (0.1, 0.2)), both + shift, np.zeros(20))


def test_the_fit_is_the_greatest_index_or_the_hottest_near_it() -> None:
    sharp = fit([made(30)])
    assert sharp.calibration == Calibration(0.1, 0.2, 1 / EXPONENTS[30])
    assert sharp.index.value == pytest.approx(5.0)
    assert sharp.bare.value == 0
    # Standard error 0.115: two steps of 0.05 down are within it, a third is not.
    flat = fit([made(30, width=0.05)])
    assert flat.calibration.temperature == pytest.approx(1 / EXPONENTS[28])
    assert flat.index.value == pytest.approx(4.9)
    assert flat.index.trials == 20


def test_each_map_counts_alike_in_a_joint_fit() -> None:
    few, many = made(20, width=5.0), made(40)
    many = dataclasses.replace(many, logs=np.tile(many.logs, (100, 1, 1)), bare=np.zeros(2000))
    joint = fit([few, many])
    assert joint.calibration.temperature == pytest.approx(1 / EXPONENTS[20])
    assert joint.index.trials == 2020


@pytest.mark.parametrize("count", [1, 19])
def test_a_few_scans_fit_nothing(count: int) -> None:
    few = dataclasses.replace(made(30), logs=made(30).logs[:count], bare=np.zeros(count))
    with pytest.raises(ConfigError, match=f"got {count} in all, expected at least 20"):
        fit([few])
    assert fit([few] * 20).index.trials == 20 * count


def test_a_third_of_the_scans_is_as_the_sensor_says() -> None:
    sensor = Sensor(rays=200, sigma=0.01)
    clean, mixed = (make(ROOM, 6, 5, sensor) for make in (simulate, disturbed_set))
    assert clean.poses is not None
    np.testing.assert_array_equal(mixed.poses, clean.poses)
    for k, (a, b) in enumerate(zip(clean.scans, mixed.scans, strict=True)):
        error = np.abs(a.ranges - b.ranges)
        nearer = np.mean(error[np.isfinite(error)] > 0.5)
        if k % 3 == 0:
            np.testing.assert_array_equal(a.ranges, b.ranges)
        elif k % 3 == 1:
            assert 0.2 < nearer < 0.5
        else:
            assert 0.04 < np.isnan(b.ranges).mean() < 0.2
            close = error[error < 0.4]
            assert 0.04 < np.sqrt(np.mean(close**2)) < 0.2


def test_neighbouring_readings_share_the_error_of_a_wall() -> None:
    pair = [make(ROOM, 3, 5, Sensor(rays=400, sigma=0.0)) for make in (simulate, disturbed_set)]
    error = pair[1].scans[2].ranges - pair[0].scans[2].ranges
    near = np.abs(error) < 0.4
    both = near[1:] & near[:-1]
    assert np.corrcoef(error[1:][both], error[:-1][both])[0, 1] > 0.9


def test_the_same_seed_the_same_scans() -> None:
    one, two = (disturbed_set(ROOM, 3, 8, Sensor(rays=20)) for _ in range(2))
    for a, b in zip(one.scans, two.scans, strict=True):
        np.testing.assert_array_equal(a.ranges, b.ranges)


def test_a_calibrated_posterior_knows_more_than_the_bare_stack() -> None:
    features = prepare(ROOM)
    options = Options(method="ght-v")
    fitted = fit([sweep(features, simulate(ROOM, 20, 1, Sensor(rays=91)), options)])
    fresh = simulate(ROOM, 5, 77, Sensor(rays=91))
    bare, sure = [], []
    for scan, pose in zip(fresh.scans, fresh.poses, strict=True):
        stack = likelihood(features, scan, options)
        at = cell_of_pose(features, Pose2D(*pose), len(stack.thetas))
        p = calibrated(stack, features.free, 91, fitted.calibration)
        bare.append(density_in_stack(stack.values, at, features.free))
        sure.append(density_in_stack(p, at, features.free))
    assert performance_index(sure).value > performance_index(bare).value + 2


def test_an_error_that_few_scans_share_in_the_end_is_none(monkeypatch) -> None:
    features, told = prepare(ROOM), simulate(ROOM, 5, 4, Sensor(rays=181, fov=6.2))
    assert fit_shared(features, told.scans).shared.scale == pytest.approx(1, abs=0.01)
    # Each fits at an error of its own, none at that of all.
    monkeypatch.setattr(calibrate, "_placed", lambda *given: iter(()))
    with pytest.raises(ConfigError, match="0 of 5 scans fit this map at one place"):
        fit_shared(features, told.scans)


@pytest.mark.parametrize("peeled", [0, 10**7])
def test_scans_together_part_thick_walls_from_a_scale(peeled: int, monkeypatch) -> None:
    monkeypatch.setattr("imgloc.features.mapfeatures.PEELED_CELLS", peeled)
    there = render(WORLDS["curved"](), 0.05)
    scans = simulate(there, 12, 4, Sensor(rays=181, fov=6.2)).scans
    walls = cv2.dilate(there.occupied.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    drawn = prepare(redrawn(there, walls), ready=False)
    for factor in (1.0, 1.06):
        found = fit_shared(drawn, [scan.scaled(factor) for scan in scans])
        assert found.shared.thinner in (2, 3)
        assert found.shared.scale * factor == pytest.approx(1, abs=0.01)
        assert found.used > 8


def test_scans_show_how_deep_in_the_walls_the_faces_are() -> None:
    features, told = prepare(ROOM), simulate(ROOM, 6, 4, Sensor(rays=181, fov=6.2))
    sharp, error = fit_depth(features, told.scans)
    assert abs(sharp) < SHARP
    assert 0 < error < 0.01
    deeper = [dataclasses.replace(scan, ranges=scan.ranges + 0.04) for scan in told.scans]
    blurred, _ = fit_depth(features, deeper)
    assert blurred == pytest.approx(sharp + 0.04, abs=0.015)
    for depth, word in ((sharp, "sharp"), (blurred, "blurred")):
        words = shared_words(SharedFit(Shared(depth=depth), 0.01, error, 6, 6), 0.05)
        assert (
            f"faces  {depth:.3f} +- {error:.3f} m behind the border of the walls: {word}" in words
        )
    with pytest.raises(ConfigError, match="of 2 scans fit"):
        fit_depth(features, told.scans[:2])
