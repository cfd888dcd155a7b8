"""A robot that looks ahead and behind: two lasers, each with a place of its own."""

import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from command import MAPS, call, rows
from places import POSES, error, features_of

from imgloc import Every, LaserScan, Options, Pose2D, ScanSet, follow, make_filter
from imgloc.filters.evidence import NO_PLACES, search, sight, view_of
from imgloc.filters.follow import robot_poses
from imgloc.filters.motion import compose_poses, noisy_odometry
from imgloc.model import compose
from imgloc.simulation.scans import simulate_ranges
from imgloc.simulation.worlds import WORLDS, render

ANGLES, REACH = np.deg2rad(np.arange(-90, 90.5, 1.0)), 4.0
FRONT, REAR = Pose2D(0.3, 0.0, 0.0), Pose2D(-0.3, 0.1, math.pi)
# Out of a bay of the world "visibility", whose mouth only who looks back sees.
PATH = np.array(
    [
        [12.75, 8.85, 1.43],
        [12.82, 9.35, 1.38],
        [12.94, 9.83, 1.36],
        [13.03, 10.32, 1.22],
        [13.28, 10.75, 0.93],
        [13.62, 11.12, 0.80],
    ]
)


def at(poses: np.ndarray, mount: Pose2D) -> np.ndarray:
    return compose_poses(poses, np.array([mount.x, mount.y, mount.theta]))


@cache
def log(*mounts: Pose2D) -> ScanSet:
    """What the lasers see along the path, one after the other."""
    fine, odom = (
        render(WORLDS["visibility"](), 0.05),
        noisy_odometry(PATH, np.random.default_rng(5)),
    )
    n, scans, poses = len(mounts), [], []
    seen = [
        simulate_ranges(fine, at(PATH, mount), ANGLES, seed=k, range_max=REACH)
        for k, mount in enumerate(mounts)
    ]
    for i in range(len(PATH)):
        for k, mount in enumerate(mounts):
            ranges = seen[k][i]
            scans.append(
                LaserScan(ranges, ANGLES, range_max=REACH, T_base_laser=mount, laser=f"laser {k}")
            )
            poses.append(at(PATH[i], mount))
    stamps = np.add.outer(np.arange(float(len(PATH))), 0.1 * np.arange(n)).ravel()
    return ScanSet(tuple(scans), np.array(poses), stamps, np.repeat(odom, n, axis=0))


def carmen(path: Path) -> Path:
    """The log of both as CARMEN writes it."""
    scans = log(FRONT, REAR)
    lines = [f"PARAM robot_{side}_laser_max {REACH}" for side in ("front", "rear")]
    for scan, stamp, odom in zip(scans.scans, scans.stamps, scans.odom, strict=True):
        assert scan.T_base_laser is not None
        laser = compose(Pose2D(*odom), scan.T_base_laser)
        words = [*scan.ranges, laser.x, laser.y, laser.theta, *odom, stamp]
        kind = "FLASER" if scan.T_base_laser == FRONT else "RLASER"
        lines.append(" ".join([kind, "181", *(f"{word:.6f}" for word in words), "robot", "0"]))
    path.write_text("\n".join(lines) + "\n")
    return path


def test_two_lasers_find_what_one_does_not(tmp_path: Path) -> None:
    path, last = carmen(tmp_path / "a.log"), tuple(PATH[-1])
    words = ("track", MAPS / "visibility.yaml", path, "--json", "--no-cache", "--every", "0.4,30")
    front = call(*words).ends(0)
    assert len(rows(front.out)) == len(PATH)
    assert not any(row["verdict"] == "unique" for row in rows(front.out))
    both = call(*words, "--topic", "FLASER,RLASER").ends(0)
    got = rows(both.out)
    assert len(got) == 2 * len(PATH)
    assert [row["looked"] for row in got[:4]] == [True] * 4
    assert got[-1]["verdict"] == "unique"
    metres, radians = error(Pose2D(**got[-1]["pose"]), last)
    assert metres < 0.1
    assert radians < 0.05
    call(*words, "--topic", "FLASER,RLASER", "--sensor", "0.1,0,0").ends(2, "several lasers")


@pytest.mark.parametrize("name", ["tracker", "particle", "grid"])
def test_every_filter_follows_the_robot_not_its_lasers(name: str) -> None:
    features, scans = features_of("visibility"), log(FRONT, REAR)
    chosen = make_filter(name, features, Options(), seed=1, find=lambda _: NO_PLACES)
    start = Pose2D(*PATH[0])
    moments = list(follow(features, scans, chosen, start=start, deviation=(0.2, 0.1)))
    truth = robot_poses(scans)
    np.testing.assert_allclose(truth[::2], PATH)
    worst = max(error(m.best, t)[0] for m, t in zip(moments, truth, strict=True) if m.best)
    assert worst < 0.25
    assert all(m.metres == n.metres for m, n in zip(moments[::2], moments[1::2], strict=True))


def test_a_grid_is_filled_with_places_of_the_robot() -> None:
    """The likelihood of the sensor's poses, moved to where the robot is then."""
    features, mount = features_of("curved"), Pose2D(0.5, 0.3, 1.2)
    pose, angles = POSES["curved"], np.deg2rad(np.arange(-180, 180, 3.0))
    ranges = simulate_ranges(
        render(WORLDS["curved"](), 0.05), at(np.array([pose]), mount), angles, range_max=30.0
    )
    scan = LaserScan(ranges[0], angles, range_max=30.0, T_base_laser=mount)
    for name in ("grid", "particle"):
        chosen = make_filter(name, features, Options(), seed=1)
        chosen.see(scan)
        away = [math.hypot(x - pose[0], y - pose[1]) for x, y, _ in chosen.belief.poses]
        assert min(away[:3]) < 0.35, name


def test_a_lever_is_in_the_covariance() -> None:
    """Who does not know which way the sensor looks knows less well where the robot is."""
    features, scan = features_of("curved"), log(Pose2D(0.0, 0.0))[0]
    pose = np.array([[5.0, 5.0, 0.7]])
    near = sight(features, view_of(scan, Options()), pose, Options())
    mount = Pose2D(2.0, 1.0, 0.4)
    mounted = LaserScan(scan.ranges, scan.angles, range_max=REACH, T_base_laser=mount)
    robot = view_of(mounted, Options()).robot(pose)
    far = sight(features, view_of(mounted, Options()), robot, Options())
    np.testing.assert_allclose(far.log_likelihood, near.log_likelihood)
    rng = np.random.default_rng(0)
    draws = rng.multivariate_normal(pose[0], 1e-4 * near.covariance[0], 4000)
    spread = np.cov(view_of(mounted, Options()).robot(draws).T)
    np.testing.assert_allclose(far.covariance[0], 1e4 * spread, rtol=0.15, atol=0.01)


def test_one_laser_sees_for_both() -> None:
    """The front one goes blind: what the rear one sees is enough, at every moment."""
    features, scans = features_of("visibility"), log(FRONT, REAR)
    some = [
        replace(scan, ranges=np.full_like(scan.ranges, np.nan)) if k % 2 == 0 and k >= 4 else scan
        for k, scan in enumerate(scans.scans)
    ]
    chosen = make_filter("tracker", features, Options(), find=lambda _: NO_PLACES)
    half = replace(scans, scans=tuple(some))
    moments = list(follow(features, half, chosen, start=Pose2D(*PATH[0]), deviation=(0.2, 0.1)))
    assert {m.withheld for m in moments} <= {"", "unconfirmed"}
    assert [m.age for m in moments[4:6]] == [pytest.approx(0.9), 0.0]
    assert [m.belief.verdict for m in moments[-4:]] == ["unique"] * 4
    blind = [replace(scan, ranges=np.full_like(scan.ranges, np.nan)) for scan in some[8:]]
    none = replace(scans, scans=(*some[:8], *blind))
    moments = list(follow(features, none, chosen, start=Pose2D(*PATH[0]), deviation=(0.2, 0.1)))
    assert [m.withheld for m in moments[8:]] == ["", "blind", "blind", "blind"]


def test_each_laser_is_looked_at_by_its_own_way() -> None:
    features, scans = features_of("visibility"), log(FRONT, REAR)
    found = search(features, scans[0], Options())
    chosen = make_filter("tracker", features, Options(), find=lambda _: found)
    run = follow(features, scans, chosen, every=Every(0.9, 9.0), start=Pose2D(*PATH[0]))
    assert [m.looked for m in run][:6] == [True, True, False, False, True, True]
