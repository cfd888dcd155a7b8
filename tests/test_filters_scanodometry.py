"""Motion from scans alone: exact where walls tell it, uncertain where they do not, never wild."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imgloc import LaserScan, Pose2D, ScanOdometry, load_scans
from imgloc.filters.motion import compose_poses, increments, invert_poses
from imgloc.filters.scanodometry import Motion
from imgloc.geometry import wrap

ANGLES = np.deg2rad(np.linspace(-135, 135, 361))
# Corners of a room with a niche, and of one elsewhere; walls of a corridor.
ROOM = [(-2, -3), (6, -3), (6, 1), (4, 1), (4, 4), (-2, 4), (-2, -3)]
OTHER = [(-1, -1), (1.5, -2), (9, -1), (9, 9), (7, 9), (7, 2), (-1, 2), (-1, -1)]
CORRIDOR = [[(-99, -1), (99, -1)], [(-99, 1.5), (99, 1.5)]]


def scan_at(
    pose: Sequence[float],
    walls: list,
    *,
    stamp: float = math.nan,
    mount: Pose2D | None = None,
    noise: np.random.Generator | None = None,
    laser: str = "",
    reach: float = 12.0,
) -> LaserScan:
    """What the laser of a robot at a pose reads between walls, lines through corners."""
    lines = walls if isinstance(walls[0], list) else [walls]
    ends = np.array([(a, b) for line in lines for a, b in itertools.pairwise(line)], float)
    m = mount or Pose2D(0, 0)
    x, y, theta = compose_poses(np.array(pose, float), np.array([m.x, m.y, m.theta]))
    ray = np.stack((np.cos(ANGLES + theta), np.sin(ANGLES + theta)), axis=1)[:, None]
    from_, along = ends[:, 0] - (x, y), ends[:, 1] - ends[:, 0]

    def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]

    with np.errstate(divide="ignore", invalid="ignore"):
        far, share = cross(from_, along) / cross(ray, along), cross(from_, ray) / cross(ray, along)
    ranges = np.where((far > 0) & (share >= 0) & (share <= 1), far, np.inf).min(axis=1)
    if noise is not None:
        ranges = ranges + noise.normal(0, 0.02, len(ranges))
    ranges[ranges > reach] = np.inf
    scan = LaserScan(ranges, ANGLES, range_max=reach, stamp=stamp, T_base_laser=mount)
    object.__setattr__(scan, "laser", laser)
    return scan


def path(steps: int, step: Sequence[float], start: Sequence[float] = (0, 0, 0)) -> np.ndarray:
    poses = [np.array(start, float)]
    for _ in range(steps):
        poses.append(compose_poses(poses[-1], np.array(step, float)))
    return np.array(poses)


def follow(scans: Sequence[LaserScan]) -> tuple[np.ndarray, list[Motion]]:
    robot, poses, motions = ScanOdometry(), [], []
    for scan in scans:
        motions.append(robot.step(scan))
        poses.append(robot.pose)
    return np.array(poses), motions


def off(found: np.ndarray, true: np.ndarray) -> tuple[float, float]:
    """Metres and radians between the ways from the first pose to the last."""
    ways = [compose_poses(invert_poses(poses[0]), poses[-1]) for poses in (found, true)]
    apart = ways[0] - ways[1]
    return float(np.hypot(*apart[:2])), abs(float(wrap(apart[2])))


def total(motions: Sequence[Motion]) -> np.ndarray:
    return np.sqrt(np.diag(sum(m.covariance for m in motions)))


@pytest.mark.parametrize(
    "step", [(0.1, 0, 0), (-0.1, 0.05, 0), (0, 0, 0.2), (0.15, 0, -0.2), (0, 0, -0.4)]
)
@pytest.mark.parametrize("stamped", [True, False])
def test_the_way_of_a_robot(step: tuple, stamped: bool) -> None:
    true = path(12, step)
    scans = [scan_at(p, ROOM, stamp=0.2 * k if stamped else math.nan) for k, p in enumerate(true)]
    found, motions = follow(scans)
    metres, radians = off(found, true)
    assert metres < 0.01
    assert radians < 0.003
    assert not any(m.lost for m in motions)
    np.testing.assert_array_equal(found[0], 0)
    steps = increments(found)
    np.testing.assert_allclose([m.increment for m in motions[1:]], steps, atol=1e-9)


def test_the_pose_is_that_of_the_robot_and_not_of_its_sensor() -> None:
    true = path(15, (0.1, 0, 0.12))
    mounts = [Pose2D(0.4, -0.2, 1.0 + 0.3 * math.sin(k)) for k in range(len(true))]  # it pans
    scans = [
        scan_at(p, ROOM, stamp=0.1 * k, mount=m)
        for k, (p, m) in enumerate(zip(true, mounts, strict=True))
    ]
    metres, radians = off(follow(scans)[0], true)
    assert metres < 0.01
    assert radians < 0.005


def test_two_lasers_tell_of_one_robot() -> None:
    """Each is laid over its own earlier scan: those of the other show other walls."""
    true = path(30, (0.05, 0, 0.05))
    front, rear = Pose2D(0.3, 0, 0), Pose2D(-0.3, 0.1, math.pi)
    scans = [
        scan_at(p, ROOM, stamp=0.1 * k, mount=(front, rear)[k % 2], laser="fr"[k % 2])
        for k, p in enumerate(true)
    ]
    found, motions = follow(scans)
    metres, radians = off(found, true)
    assert metres < 0.02
    assert radians < 0.005
    assert not any(m.lost for m in motions)


@pytest.mark.parametrize("mount", [None, Pose2D(0.3, 0.1, 0.5)])
def test_a_robot_that_stands_does_not_drift(mount: Pose2D | None) -> None:
    rng = np.random.default_rng(1)
    scans = [scan_at((0, 0, 0.3), ROOM, stamp=0.1 * k, mount=mount, noise=rng) for k in range(90)]
    found, motions = follow(scans)
    assert np.abs(found[:, :2]).max() < 0.02
    assert np.abs(found[:, 2]).max() < 0.005
    assert np.hypot(*found[45:, :2].mean(axis=0)) < 0.005
    assert total(motions)[:2].max() < 0.05
    same, _ = follow([scans[0]] * 20)
    np.testing.assert_allclose(same, 0, atol=4e-3)


def test_a_corridor_does_not_tell_how_far_the_robot_went() -> None:
    """It says so, along the corridor alone."""
    true = path(40, (0.05, 0, 0), (0, 0, 0))
    rng = np.random.default_rng(2)
    scans = [scan_at(p, CORRIDOR, stamp=0.1 * k, noise=rng, reach=8.0) for k, p in enumerate(true)]
    found, motions = follow(scans)
    apart = np.abs(found[-1] - true[-1])
    sd = np.sqrt(np.diag(sum(m.covariance for m in motions)))
    assert apart[0] < 3 * sd[0]
    assert sd[0] > 0.5
    assert sd[1] < 0.2
    assert sd[2] < 0.15
    assert apart[1] < 0.05
    assert apart[2] < 0.01
    assert not any(m.lost for m in motions)


def test_into_a_corridor_it_goes_on_with_its_speed() -> None:
    """A door frame that goes out of sight has told how fast the robot drives."""
    door = [*CORRIDOR, [(1, -1), (1, -0.4)], [(1, 1), (1, 1.5)]]
    true = path(60, (0.05, 0, 0))
    scans = [scan_at(p, door, stamp=0.1 * k, reach=4.0) for k, p in enumerate(true)]
    found, motions = follow(scans)
    seen = np.sqrt(sum(m.covariance for m in motions[:30])[0, 0])
    metres, _ = off(found, true)
    whole = total(motions)[0]
    assert metres < 0.3
    assert seen < 0.4
    assert whole > 2 * seen


def test_a_blind_robot_knows_ever_less() -> None:
    true = path(30, (0.05, 0, 0.02))
    scans = [scan_at(p, ROOM, stamp=0.1 * k) for k, p in enumerate(true)]
    for k in range(12, 20):
        scans[k] = replace(scans[k], ranges=np.full(len(ANGLES), np.nan))
    found, motions = follow(scans)
    dark = [m.covariance[0, 0] for m in motions[12:20]]
    assert all(math.isnan(m.overlap) and not m.lost for m in motions[12:20])
    assert all(a < b for a, b in itertools.pairwise(dark))
    assert total(motions[12:20])[0] > 0.1
    metres, radians = off(found, true)
    assert metres < 0.02
    assert radians < 0.005


def test_a_robot_that_was_carried_off_is_lost_for_a_moment() -> None:
    true = path(20, (0.05, 0, 0))
    there = path(20, (0.05, 0, 0.03), (3, 0, 2.0))
    scans = [scan_at(p, ROOM, stamp=0.1 * k) for k, p in enumerate(true)]
    scans += [scan_at(p, OTHER, stamp=2.1 + 0.1 * k) for k, p in enumerate(there)]
    found, motions = follow(scans)
    lost = [k for k, m in enumerate(motions) if m.lost]
    assert lost == [21, 22]
    assert np.sqrt(np.diag(motions[21].covariance)).min() > 0.9
    assert max(np.hypot(*m.increment[:2]) for m in motions) < 0.1
    metres, radians = off(found[23:], there[2:])
    assert metres < 0.03
    assert radians < 0.01


def test_who_stands_in_the_way_for_a_moment_costs_no_reference() -> None:
    true = path(20, (0.05, 0, 0))
    scans = [scan_at(p, ROOM, stamp=0.1 * k) for k, p in enumerate(true)]
    near = 0.6 + 0.05 * np.sin(20 * ANGLES)
    scans[10] = replace(scans[10], ranges=near)
    found, motions = follow(scans)
    assert [k for k, m in enumerate(motions) if m.lost] == [10]
    assert off(found, true)[0] < 0.02


@pytest.mark.parametrize("gap", [-5.0, 0.0, 1e9])
def test_a_clock_that_leaps_is_forgotten(gap: float) -> None:
    true = path(20, (0.05, 0, 0.02))
    stamps = 0.1 * np.arange(len(true)) + np.where(np.arange(len(true)) > 8, gap, 0)
    found, motions = follow([scan_at(p, ROOM, stamp=t) for p, t in zip(true, stamps, strict=True)])
    metres, radians = off(found[12:], true[12:])
    assert metres < 0.02
    assert radians < 0.005
    assert np.isfinite(total(motions)).all()


def test_the_same_scans_give_the_same_way() -> None:
    scans = [scan_at(p, ROOM, stamp=0.1 * k) for k, p in enumerate(path(10, (0.1, 0, 0.1)))]
    np.testing.assert_array_equal(follow(scans)[0], follow(scans)[0])


def test_two_metres_between_scans() -> None:
    true = np.array([[0, 0, 0], [1.5, 0.5, 0.5], [3.3, 0, 1.4], [2.2, 1.4, 2.4], [0.4, 2, 3.1]])
    scans = [scan_at(p, ROOM, stamp=3.0 * k) for k, p in enumerate(true)]
    found, motions = follow(scans)
    assert not any(m.lost for m in motions)
    metres, radians = off(found, true)
    assert metres < 0.03
    assert radians < 0.02


def test_the_error_is_as_large_as_it_says() -> None:
    """Round a room, with noise and people."""
    turns = np.arange(0, 4 * math.pi, 0.1)
    true = np.column_stack((1 + 1.2 * np.sin(turns), -1.2 * np.cos(turns), turns))
    squares, errors = [], []
    for seed in range(2):
        rng = np.random.default_rng(seed)
        scans = [scan_at(p, ROOM, stamp=0.2 * k, noise=rng) for k, p in enumerate(true)]
        people = [rng.random(len(ANGLES)) < 0.1 for _ in scans]
        found, motions = follow(
            [
                replace(s, ranges=np.where(who, s.ranges * rng.random(len(ANGLES)), s.ranges))
                for s, who in zip(scans, people, strict=True)
            ]
        )
        assert not any(m.lost for m in motions)
        for first, last in ((0, 60), (60, 120)):  # 7 m
            errors.append(off(found[first : last + 1], true[first : last + 1]))
            squares.append(
                errors[-1][0] ** 2 / np.square(total(motions[first + 1 : last])[:2]).sum()
            )
    assert max(metres for metres, _ in errors) < 0.12
    assert max(radians for _, radians in errors) < 0.03
    assert np.mean(squares) < 3


def test_a_recorded_way_with_known_truth(shared: Path) -> None:
    """Pieces of 5 m, against the truth by reflectors, 0.135 s apart."""
    folder = shared / "data/jarvis_inesc"
    scans = load_scans(folder / "complex.npz")
    with np.load(folder / "complex.npz") as content:
        mount = Pose2D(*content["mount"])
    rows = np.loadtxt(folder / "complex_ground_truth.tum")
    heading = np.unwrap(2 * np.arctan2(rows[:, 6], rows[:, 7]))
    when = scans.stamps - 0.135
    true = np.column_stack(
        [np.interp(when, rows[:, 0], v) for v in (rows[:, 1], rows[:, 2], heading)]
    )
    found, motions = follow(
        [replace(s, stamp=t, T_base_laser=mount) for s, t in zip(scans, scans.stamps, strict=True)]
    )
    assert not any(m.lost for m in motions)
    way = np.append(0, np.cumsum(np.hypot(*np.diff(scans.odom[:, :2], axis=0).T)))
    pieces = [(i, int(np.searchsorted(way, way[i] + 5.0))) for i in range(0, len(way), 10)]
    errors = [off(found[[i, j]], true[[i, j]]) for i, j in pieces if j < len(way)]
    assert len(errors) > 5
    assert np.median([e[0] for e in errors]) < 0.06
    assert np.median([e[1] for e in errors]) < 0.01
